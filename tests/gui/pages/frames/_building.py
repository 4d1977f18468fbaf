"""Scans on disk that the page opens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from tests.cli.conftest import SHAPE, small_plan, true_frame

Place = tuple[int, int, int]


def as_png(path: Path, frame: np.ndarray) -> None:
    cv2.imwrite(str(path), frame)


def write_scan(
    folder: Path, gone: Place | None = None, suffix: str = "npy", write: Callable[[Path, np.ndarray], None] = np.save
) -> Path:
    """Write a scan of two planes with its list and plan, without the frame of the position ``gone``."""
    folder.mkdir()
    rows = ["file,z,y,x"]
    for z, y, x in np.ndindex(SHAPE):
        if (z, y, x) != gone:
            write(folder / f"{z}_{y}_{x}.{suffix}", true_frame(z, y, x))
            rows.append(f"{z}_{y}_{x}.{suffix},{z},{y},{x}")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")
    (folder / "plan.json").write_text(small_plan().to_json())
    return folder
