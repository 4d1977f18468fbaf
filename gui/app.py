"""Start the workstation: ``lfcal-gui [PROJECT] [--demo]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gui.window import MainWindow

__all__ = ["main", "make_window"]


def parse(arguments: list[str]) -> argparse.Namespace:
    """Return the parsed command line."""
    parser = argparse.ArgumentParser(
        prog="lfcal-gui",
        description="The lfcal workstation.",
        epilog="Example: lfcal-gui --demo",
    )
    parser.add_argument("project", nargs="?", type=Path, help="project to open (.lfcal)")
    parser.add_argument("--demo", action="store_true", help="open the sample project")
    parser.add_argument("--theme", choices=("light", "dark"), help="colours")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run the window until it is closed; return the exit code."""
    options = parse(sys.argv[1:] if arguments is None else arguments)
    try:
        from PySide6.QtWidgets import QApplication
    except ImportError:
        print("lfcal-gui: PySide6 is not installed; run: pip install 'lfcal[gui]'", file=sys.stderr)
        return 2
    app = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(app, QApplication)
    from lfcal.errors import LfcalError

    try:
        window = make_window(app, options)
    except LfcalError as error:
        print(f"lfcal-gui: {error}", file=sys.stderr)
        return 2
    window.show()
    code = app.exec()
    window.shut_down()
    return code


def make_window(app: object, options: argparse.Namespace, *, folder: Path | None = None) -> MainWindow:
    """Return the window with the asked project; ``folder`` keeps recent projects and autosave."""
    from platformdirs import user_state_path
    from PySide6.QtCore import QSettings
    from PySide6.QtWidgets import QApplication

    from gui.models.project import Project
    from gui.theme import DARK, LIGHT, apply_theme
    from gui.window import MainWindow

    assert isinstance(app, QApplication)
    app.setApplicationName("lfcal")
    app.setOrganizationName("lfcal")
    kept = folder is None
    place = folder or user_state_path("lfcal", ensure_exists=True)
    settings = QSettings(str(place / "window.ini"), QSettings.Format.IniFormat) if kept else None
    theme = options.theme or (settings.value("theme", "light") if settings is not None else "light")
    apply_theme(app, DARK if theme == "dark" else LIGHT)
    project = Project()
    if options.project is not None:
        project.open(options.project)
    elif options.demo:
        from gui.demo import demo_state

        project.start(demo_state(place / "demo"))
    return MainWindow(project, place, settings)


if __name__ == "__main__":
    sys.exit(main())
