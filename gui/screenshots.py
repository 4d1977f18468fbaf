"""Pictures of every page: ``python -m gui.screenshots OUT [--demo]``, light and dark, at two sizes."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

SIZES = ((1280, 800), (1920, 1080))
SETTLE_S = 0.5
IDLE_S = 60.0


def main(arguments: list[str] | None = None) -> int:
    """Write ``PAGE_THEME_WIDTHxHEIGHT.png`` for all pages; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m gui.screenshots", description=main.__doc__)
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--page", action="append", help="only these pages")
    parser.add_argument("--theme", choices=("light", "dark", "night"), action="append", help="only this theme")
    parser.add_argument("--size", action="append", help="only this size, e.g. 1280x800")
    parser.add_argument("--settle", type=float, default=SETTLE_S, help="seconds to wait for each page")
    options = parser.parse_args(arguments)
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    from PySide6.QtWidgets import QApplication

    from gui.app import begin, make_window, parse

    options.out.mkdir(parents=True, exist_ok=True)
    app = QApplication.instance() or QApplication(["lfcal"])
    sizes = [tuple(int(n) for n in size.split("x")) for size in options.size] if options.size else list(SIZES)
    demo = parse(["--demo"])
    window = make_window(app, demo, folder=options.out / ".state")
    window.show()
    begin(window, demo)
    try:
        while window.jobs.busy:
            wait(app, 0.1)
        for spec in window.specs:
            if options.page and spec.key not in options.page:
                continue
            window.go(spec.key)
            wait(app, 0.3)
            end = time.monotonic() + IDLE_S
            while window.jobs.busy and time.monotonic() < end:
                wait(app, 0.1)
            wait(app, options.settle)
            for theme in options.theme or ("light", "dark"):
                window.set_theme(theme)
                for size in sizes:
                    _write(app, window, size, options.out / f"{spec.key}_{theme}_{size[0]}x{size[1]}.png")
    finally:
        window.shut_down()
    return 0


def _write(app: object, window: Any, size: tuple[int, ...], path: Path) -> None:
    window.resize(*size)
    wait(app, 0.6)
    window.grab().save(str(path), "PNG")
    print(path, f"{window.width()}x{window.height()}")


def wait(app: object, seconds: float) -> None:
    """Let the window work for a while."""
    from PySide6.QtWidgets import QApplication

    assert isinstance(app, QApplication)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        app.processEvents()
        time.sleep(0.01)


if __name__ == "__main__":
    sys.exit(main())
