"""Pictures as large as those of real cameras: H of an R29, and frames of 29 megapixels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal.camera import preset
from lfcal.frames import Position
from lfcal.psf import PSFMatrix
from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["large"]

NAME = "R29_main_lens_100mm_f2.8_2026-03-16_second_alignment_after_cleaning"
"""Long, as people call their files."""

PITCH, CUTOUT = 27.6, 181


def large(stage: Stage) -> Iterator[Capture]:
    """Show PSF and scan of an R29, then one of its frames."""
    window = stage.window
    window.project.update("R29", camera=preset("r29"), plan=None, frames="", psf="", reference="")
    page = stage.page("setup")
    page.make_default()
    stage.tidy()
    yield Capture("setup_r29")
    window.context.matrices.put(f"/data/psf/{NAME}.h5", _matrix())
    window.project.update("open", psf=f"/data/psf/{NAME}.h5")
    stage.page("psf")
    stage.tidy()
    yield Capture("psf_r29")
    page = stage.page("frames")
    page.open_folder(str(_frames(stage.folder / NAME)))
    stage.settle()
    page.panel.lattice_box.setChecked(True)
    stage.settle()
    stage.tidy()
    yield Capture("frames_r29_missing")
    page.go_to(Position(0, 27, 47))
    stage.settle()
    yield Capture("frames_r29")
    page.panel.follow.setChecked(True)
    stage.settle()
    yield Capture("frames_r29_follow")
    page.panel.follow.setChecked(False)


def _matrix() -> PSFMatrix:
    """Return two planes that look like H of such a camera: blurred discs behind a hexagonal array, one row for all."""
    ny, nx = 55, 95
    planes = []
    for radius in (70.0, 45.0):
        row = np.stack([_pattern(x, radius) for x in range(nx)])
        planes.append(np.broadcast_to(row, (ny, *row.shape)))
    return PSFMatrix(np.stack(planes))


def _pattern(x: float, radius: float) -> NDArray[np.float32]:
    t, s = np.mgrid[:CUTOUT, :CUTOUT] - CUTOUT // 2
    light = np.zeros((CUTOUT, CUTOUT), np.float32)
    for k in range(-4, 5):
        for j in range(-4, 5):
            row, column = k * PITCH * np.sqrt(0.75), (j + k % 2 / 2) * PITCH - x % PITCH
            if row**2 + column**2 < radius**2:
                light += np.exp(-((t - 0.9 * row) ** 2 + (s - 0.9 * column) ** 2) / 18)
    return 1000 * light


def _frames(folder: Path) -> Path:
    """Write three frames of 29 megapixels with their list; return the folder."""
    if (folder / "manifest.csv").is_file():
        return folder
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    frame = rng.integers(90, 110, (4384, 6576), np.uint16)
    at = 2192 - CUTOUT // 2, 3288 - CUTOUT // 2
    frame[at[0] : at[0] + CUTOUT, at[1] : at[1] + CUTOUT] += _pattern(0.0, 70.0).astype(np.uint16)
    rows = ["file,z,y,x"]
    for x in (46, 47, 48):
        cv2.imwrite(str(folder / f"z0_y27_x{x}.tif"), np.roll(frame, x - 47, axis=1))
        rows.append(f"z0_y27_x{x}.tif,0,27,{x}")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder
