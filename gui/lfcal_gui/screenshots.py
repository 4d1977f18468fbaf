"""Pictures of every page: ``python -m lfcal_gui.screenshots OUT``, each state in both themes at all sizes."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal_gui.scenes import Capture, Stage

SIZES = ("1280x800", "1920x1080", "3840x2160@2")
"""Sizes of the pictures (px); ``@2``: on a screen with twice the pixel density."""


def main(arguments: list[str] | None = None) -> int:
    """Write ``STATE_THEME_WIDTHxHEIGHT.png`` for every state of the window; return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m lfcal_gui.screenshots",
        description=main.__doc__,
        epilog="Example: python -m lfcal_gui.screenshots shots --scene sample --size 1280x800 --theme dark",
    )
    parser.add_argument("out", type=Path, help="folder to write into")
    parser.add_argument("--scene", action="append", help="only this scene; may be repeated")
    parser.add_argument("--only", help="only states whose names contain these words, such as h, frames_r29")
    parser.add_argument("--theme", choices=("light", "dark"), action="append", help="only this theme")
    parser.add_argument("--size", action="append", help=f"only this size, by default {', '.join(SIZES)}")
    options = parser.parse_args(arguments)
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    sizes = options.size or list(SIZES)
    scaled = [size for size in sizes if "@" in size]
    code = 0
    if scaled != sizes and not os.environ.get("QT_SCALE_FACTOR"):
        code = _play(options, [size for size in sizes if "@" not in size])
    for size in scaled:  # a screen's scale is one for the whole process
        code = code or _apart(size, options)
    return code


def _apart(size: str, options: argparse.Namespace) -> int:
    """Take the pictures of a size with a screen scale in a separate process."""
    scale = size.partition("@")[2]
    if os.environ.get("QT_SCALE_FACTOR") == scale:
        return _play(options, [size])
    words = [sys.executable, "-m", "lfcal_gui.screenshots", str(options.out), "--size", size]
    for name in ("scene", "theme"):
        words += [word for value in getattr(options, name) or () for word in (f"--{name}", value)]
    words += ["--only", options.only] if options.only else []
    return subprocess.run(words, env={**os.environ, "QT_SCALE_FACTOR": scale}, check=False).returncode


def _play(options: argparse.Namespace, sizes: Sequence[str]) -> int:
    from PySide6.QtWidgets import QApplication

    from lfcal_gui.app import make_window, parse
    from lfcal_gui.scenes import SCENES, Stage

    unknown = [name for name in options.scene or () if name not in SCENES]
    if unknown:
        print(f"--scene: expected some of {', '.join(SCENES)}, got {', '.join(unknown)}; correct it", file=sys.stderr)
        return 2
    out: Path = options.out
    out.mkdir(parents=True, exist_ok=True)
    app = QApplication.instance() or QApplication(["lfcal"])
    assert isinstance(app, QApplication)
    window = make_window(app, parse([]), folder=out / ".state")
    window.show()
    stage = Stage(app, window, out / ".made")
    try:
        for name in options.scene or SCENES:
            for shot in SCENES[name](stage):
                if not options.only or f"_{options.only}_" in f"_{shot.name}_":
                    _write(stage, shot, sizes, options.theme or ("light", "dark"), out)
    finally:
        window.shut_down()
    return 0


def _write(stage: Stage, shot: Capture, sizes: Sequence[str], themes: Sequence[str], out: Path) -> None:
    window = stage.window
    for theme in (shot.theme,) if shot.theme else themes:
        window.set_theme(theme)
        for size in sizes:
            pixels, _, scale = size.partition("@")
            width, height = (int(n) // int(scale or 1) for n in pixels.split("x"))
            stage.resize(width, height)
            stage.turn(30)
            path = out / f"{shot.name}_{theme}_{pixels}.png"
            stage.seen(shot).grab().save(str(path), "PNG")
            print(path, flush=True)


if __name__ == "__main__":
    sys.exit(main())
