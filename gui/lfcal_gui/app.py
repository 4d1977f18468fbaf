"""Start the window: ``lfcal-gui [PROJECT] [--demo]``."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal_gui.window import MainWindow


def parse(arguments: list[str]) -> argparse.Namespace:
    """Return the parsed command line."""
    parser = argparse.ArgumentParser(
        prog="lfcal-gui",
        description="The lfcal workstation.",
        epilog="Example: lfcal-gui --demo",
    )
    parser.add_argument("project", nargs="?", type=Path, help="project to open (.lfcal)")
    parser.add_argument("--demo", action="store_true", help="open the sample project")
    parser.add_argument("--theme", choices=("light", "dark", "night"), help="colours")
    return parser.parse_args(arguments)


def main(arguments: list[str] | None = None) -> int:
    """Run the window until it is closed, and return the exit code."""
    options = parse(sys.argv[1:] if arguments is None else arguments)
    lacking = _lacking()
    if lacking:
        return _refused(lacking)
    from PySide6.QtWidgets import QApplication

    app = QApplication.instance() or QApplication(sys.argv[:1])
    assert isinstance(app, QApplication)
    from lfcal.base import LfcalError, bounded_threads, check_regular
    from lfcal_gui.crash_dialog import CrashGuard
    from lfcal_gui.log import Log, log_folder

    log = Log(log_folder())
    try:
        if options.project is not None:
            check_regular(options.project)
        window = make_window(app, options)
    except LfcalError as error:
        log.close()
        return _refused(str(error))
    guard = CrashGuard(window, log.path, lambda: safe_now(window))
    guard.install()
    _end_on_signals(window)
    window.show()
    if log.problem:
        window.log(log.problem)
    begin(window, options)
    with bounded_threads():
        code = app.exec()
    window.shut_down()
    guard.close()
    log.close()
    return code


def _refused(message: str) -> int:
    """Report why the window cannot open, and return the exit code."""
    if sys.stderr is None and sys.platform == "win32":  # a program without a console
        import ctypes

        error_icon = 0x10
        ctypes.windll.user32.MessageBoxW(None, message, "lfcal", error_icon)
    else:
        print(f"lfcal-gui: {message}", file=sys.stderr)
    return 2


def _lacking() -> str:
    """Return which requirement of the window is missing, with the remedy; empty if none is."""
    from lfcal.base import ON_X11, missing_libraries, shows_on_x11, why_no_window, without

    try:
        import PySide6.QtWidgets  # noqa: F401
    except ImportError as error:
        return why_no_window(error)
    # Qt itself aborts without a helpful message
    missing = missing_libraries(ON_X11) if shows_on_x11() else ()
    return without(missing) if missing else ""


def make_window(app: object, options: argparse.Namespace, *, folder: Path | None = None) -> MainWindow:
    """Return the window; ``folder`` contains the list of recent projects and copies of unsaved work.

    Call `begin` to open the requested project.
    """
    from platformdirs import user_state_path
    from PySide6.QtCore import QSettings
    from PySide6.QtWidgets import QApplication

    from lfcal_gui.models import Project
    from lfcal_gui.preferences import apply_threads
    from lfcal_gui.theme import LIGHT, THEMES, apply_theme
    from lfcal_gui.window import MainWindow

    assert isinstance(app, QApplication)
    app.setApplicationName("lfcal")
    app.setOrganizationName("lfcal")
    place = folder or user_state_path("lfcal", ensure_exists=True)
    settings = QSettings(str(place / "window.ini"), QSettings.Format.IniFormat)
    apply_threads(settings)
    theme = options.theme or settings.value("theme", "light")
    apply_theme(app, THEMES.get(str(theme), LIGHT))
    return MainWindow(Project(), place, settings)


def begin(window: MainWindow, options: argparse.Namespace) -> None:
    """Open the requested project in the background, or show the welcome dialog."""
    window.files.begin(options.project)
    if options.project is None:
        (window.tools.sample if options.demo else window.tools.begin)()
    window.import_pages()


def safe_now(window: MainWindow) -> Sequence[str]:
    """Store a copy of unsaved work, and return sentences that state which data are safe."""
    from lfcal_gui.models import safe_words

    project, at_work = window.project, [job for job in window.jobs.jobs() if job.active]
    return safe_words(
        unsaved=project.unsaved,
        project=str(project.path or ""),
        copy=window.files.rescue.keep(),
        jobs=[job.title for job in at_work],
        recording=any(job.page == "acquire" for job in at_work),
    )


def _end_on_signals(window: MainWindow) -> None:
    """Close properly on a signal of the system: stop recordings, release devices, store a copy of unsaved work."""
    from PySide6.QtWidgets import QApplication

    def end(number: int, _: object) -> None:
        window.shut_down()
        QApplication.exit(128 + number)

    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(getattr(signal, name), end)


if __name__ == "__main__":
    sys.exit(main())
