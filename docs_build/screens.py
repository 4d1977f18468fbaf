"""Pictures of the pages of the workstation, taken from the window itself while the site is built."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

__all__ = ["SCENES", "SHOWN", "SIZE", "THEME", "take_screens"]

SIZE = "1280x800"
THEME = "light"
SCENES = ("sample", "recording")
SHOWN = {"acquire": "acquire_record_complete", "accuracy": "accuracy_simulation"}
"""State of the window that shows a page, if its name is not that of the page."""


def take_screens(out: Path) -> dict[str, bytes]:
    """Return a PNG of every state of the window with the sample session and a recording, by its name and page.

    Raises
    ------
    RuntimeError
        With what the window said, where it does not come up.
    """
    words = [sys.executable, "-m", "lfcal_gui.screenshots", str(out), "--theme", THEME, "--size", SIZE]
    words += [word for scene in SCENES for word in ("--scene", scene)]
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env)
    if done.returncode:
        raise RuntimeError(f"the window's pages could not be shown: {done.stdout}")
    taken = {path.name.split(f"_{THEME}_")[0]: path.read_bytes() for path in sorted(out.glob("*.png"))}
    return taken | {key: taken[name] for key, name in SHOWN.items()}
