"""The first lines of both programs of a bundle, ``lfcal`` and ``lfcal-gui``: which one it is, its name tells.

A bundle has no Python beside it. What lfcal starts as a program of its own is therefore started here, too, by a first
word that no command has.
"""

import logging
import multiprocessing
import os
import sys
import types
from pathlib import Path

SCREENSHOTS = "--screenshots"
"""First word after which pictures of the pages are taken, see `lfcal_gui.screenshots`; the bundle's check does."""


def main() -> int:
    """Run what was asked for; return the exit code."""
    multiprocessing.freeze_support()  # a worker process ends here
    # filters of HDF5 that no H file may have are left out of the bundle, which their package calls an error
    logging.getLogger("hdf5plugin").setLevel(logging.CRITICAL)
    _stand_in_for_opengl()
    _keep_compiled()
    from lfcal.base.h5.probe import EXAMINE

    first = sys.argv[1] if len(sys.argv) > 1 else ""
    if first == EXAMINE:
        from lfcal.base.h5 import _examine

        _examine.main()
    elif first == SCREENSHOTS:
        from lfcal_gui.screenshots import main as screenshots

        return screenshots(sys.argv[2:])
    elif Path(sys.executable).stem.lower() == "lfcal-gui":
        from lfcal_gui.app import main as window

        return window()
    else:
        from lfcal.cli import main as command_line

        command_line()
    return 0


def _stand_in_for_opengl() -> None:
    """Answer pyqtgraph, which asks for OpenGL before it knows whether anybody draws with it; nobody does."""
    for name in ("QtOpenGL", "QtOpenGLWidgets"):
        module = types.ModuleType(f"PySide6.{name}")
        module.QOpenGLWidget = object
        sys.modules[module.__name__] = module


def _keep_compiled() -> None:
    """Let compiled modules and kernels be kept with the user's files: the bundle may be read-only, and signed."""
    from platformdirs import user_cache_path

    place = user_cache_path("lfcal", appauthor=False) / "compiled"
    sys.pycache_prefix, sys.dont_write_bytecode = str(place / "modules"), False
    os.environ.setdefault("NUMBA_CACHE_DIR", str(place / "kernels"))


if __name__ == "__main__":
    sys.exit(main())
