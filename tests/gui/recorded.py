"""A recorded session of few frames, for windows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from tests.cli.conftest import SHAPE, small_plan, true_frame

__all__ = ["write_recorded"]


def write_recorded(folder: Path) -> Path:
    """Write frames with their list, a dark frame and the plan into ``folder``; return it."""
    for name in ("frames", "dark"):
        (folder / name).mkdir(parents=True)
    rows = ["file,z,y,x"]
    for z, y, x in np.ndindex(SHAPE):
        name = f"z{z}_y{y}_x{x}.png"
        cv2.imwrite(str(folder / "frames" / name), true_frame(z, y, x) + np.uint16(100))
        rows.append(f"{name},{z},{y},{x}")
    (folder / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n")
    cv2.imwrite(str(folder / "dark" / "0.png"), np.full((40, 48), 100, np.uint16))
    (folder / "plan.json").write_text(small_plan().to_json())
    return folder
