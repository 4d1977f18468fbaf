"""Pictures of the pages of the workstation, taken from the window itself while the site is built."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

__all__ = ["SIZE", "THEME", "take_screens"]

SIZE = "1280x800"
THEME = "light"


def take_screens(out: Path) -> dict[str, bytes]:
    """Return a PNG of every page of the window with the sample session open, by the page's key.

    Raises
    ------
    RuntimeError
        With what the window said, where it does not come up.
    """
    words = [sys.executable, "-m", "gui.screenshots", str(out), "--theme", THEME, "--size", SIZE]
    env = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env)
    if done.returncode:
        raise RuntimeError(f"the window's pages could not be shown: {done.stdout}")
    return {path.name.split(f"_{THEME}_")[0]: path.read_bytes() for path in sorted(out.glob("*.png"))}
