"""The command line: one module per command, each with ``register(app)``."""

from __future__ import annotations

import importlib
import os
import pkgutil
import sys
from types import ModuleType

__all__ = ["main"]

ORDER = ("demo", "plan", "white", "simulate", "acquire", "assemble", "inspect", "transpose", "export", "reconstruct",
         "multiplex", "bench", "doctor")  # fmt: skip
"""The order of the data; commands not named here come after."""


def modules(package: ModuleType, order: tuple[str, ...] = ()) -> list[ModuleType]:
    """Import the public modules of ``package`` that register commands, in ``order`` and then by name."""
    names = sorted(m.name for m in pkgutil.iter_modules(package.__path__) if not m.name.startswith("_"))
    names.sort(key=lambda name: order.index(name) if name in order else len(order))
    loaded = [importlib.import_module(f"{package.__name__}.{name}") for name in names]
    return [module for module in loaded if hasattr(module, "register")]


def main() -> None:
    """Run ``lfcal``: bad input ends with one clear line and exit code 2."""
    from lfcal.cli._common import build_app, report
    from lfcal.errors import Cancelled, LfcalError

    try:
        build_app()()
    except (KeyboardInterrupt, Cancelled):
        report("stopped; nothing half-written stays behind")
        sys.exit(130)
    except LfcalError as error:
        report(str(error))
        sys.exit(2)
    except MemoryError:
        report("memory: not enough for this; choose a smaller region, or a machine with more")
        sys.exit(2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
