"""Pictures of the pages of the window: ``python -m docs_build.screens OUT`` writes one PNG for each page."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

__all__ = ["PICTURES", "take_screens"]

ROOT = Path(__file__).resolve().parents[1]
SIZE = (1280, 800)
THEME = "light"
PICTURES = {
    "setup": ("sample.setup", "setup"),
    "frames": ("sample.frames", "frames"),
    "h": ("sample.h", "h"),
    "simulate": ("sample.simulate", "simulate"),
    "reconstruct": ("sample.reconstruct", "reconstruct"),
    "multiplex": ("sample.multiplex", "multiplex"),
    "accuracy": ("sample.accuracy", "accuracy_simulation"),
    "depth": ("sample.depth", "depth"),
    "watch": ("sample.watch", "watch"),
    "sessions": ("sample.sessions", "sessions"),
    "acquire": ("recording.recording", "acquire_record_paused"),
}
"""Scene of each page in ``lfcal_gui.scenes``, and its state. The last scene replaces the camera of the sample."""

LONG = ("accuracy", "acquire")
"""Pages whose scene ends with the state to show, because later states take long."""


def take_screens(out: Path) -> dict[str, bytes]:
    """Return PNGs of all pages of the window with the sample session and a recording, by the name of the page.

    Raises
    ------
    RuntimeError
        If the window could not be shown; the message contains its output.
    """
    command = [sys.executable, "-m", "docs_build.screens", str(out.resolve())]
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    # tutorials that run at the same time change the current folder
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env, cwd=ROOT)
    if done.returncode:
        raise RuntimeError(f"the pages of the window could not be shown: {done.stdout}")
    return {key: (out / f"{key}.png").read_bytes() for key in PICTURES}


def main(out: Path) -> None:
    """Play the scenes, and write the pictures to the folder ``out``."""
    from PySide6.QtWidgets import QApplication

    from lfcal_gui.app import make_window, parse
    from lfcal_gui.scenes import Stage

    app = QApplication(["lfcal"])
    window = make_window(app, parse([]), folder=out / ".state")
    window.show()
    window.set_theme(THEME)
    stage = Stage(app, window, out / ".made")
    try:
        import_module("lfcal_gui.scenes.sample").open_sample(stage)
        for key, (scene, state) in PICTURES.items():
            module, _, function = scene.partition(".")
            play = getattr(import_module(f"lfcal_gui.scenes.{module}"), function)
            for shot in play(stage):
                if shot.name == state:
                    stage.resize(*SIZE)
                    stage.turn(30)
                    stage.seen(shot).grab().save(str(out / f"{key}.png"), "PNG")
                    if key in LONG:
                        break
    finally:
        window.shut_down()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
