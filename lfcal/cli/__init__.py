"""The command line: one module per command, each with ``register(app)``."""

from __future__ import annotations

import os
import sys

__all__ = ["main"]


def main() -> None:
    """Run ``lfcal``: bad input ends with one clear line and exit code 2."""
    # Imported late: a package that only asks where the command line is must not load every library.
    from lfcal.cli.app import build_app
    from lfcal.cli.console import report
    from lfcal.errors import Cancelled, LfcalError

    try:
        build_app()()
    except (KeyboardInterrupt, Cancelled):
        report("stopped; nothing half-written stays behind")
        # 128 + SIGINT: what shells expect of an interrupted program.
        sys.exit(130)
    except LfcalError as error:
        report(str(error))
        sys.exit(2)
    except MemoryError:
        report("memory: not enough for this; choose a smaller region, or a machine with more")
        sys.exit(2)
    except BrokenPipeError:
        # The reader of the pipe has gone (head, less): without this Python's own flush at exit fails once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
