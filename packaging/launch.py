"""Start of both programs of a bundle, ``lfcal`` and ``lfcal-gui``, distinguished by the name of the file.

A bundle contains no Python executable. Programs that lfcal starts as separate processes are therefore started here too,
selected by a first word that is no command.
"""

import logging
import multiprocessing
import os
import sys
import types
from pathlib import Path

SCREENSHOTS = "--screenshots"
"""First word that starts `lfcal_gui.screenshots`; the check of the bundle uses it."""


def main() -> int:
    """Run the requested program; return the exit code."""
    multiprocessing.freeze_support()  # a worker process ends here
    # hdf5plugin logs an error for each filter that the bundle does not contain, because no H file may have it
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
    """Replace the OpenGL modules of Qt, which pyqtgraph imports but lfcal never uses."""
    for name in ("QtOpenGL", "QtOpenGLWidgets"):
        module = types.ModuleType(f"PySide6.{name}")
        module.QOpenGLWidget = object
        sys.modules[module.__name__] = module


def _keep_compiled() -> None:
    """Store compiled modules and kernels in the cache of the user, because the bundle may be read-only or signed."""
    from platformdirs import user_cache_path

    place = user_cache_path("lfcal", appauthor=False) / "compiled"
    sys.pycache_prefix, sys.dont_write_bytecode = str(place / "modules"), False
    os.environ.setdefault("NUMBA_CACHE_DIR", str(place / "kernels"))


if __name__ == "__main__":
    sys.exit(main())
