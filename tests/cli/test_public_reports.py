"""Commands on frames as other programs write them, after public reports."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.psf import open_psf
from tests.cli.conftest import DARK, Run

Lfcal = Callable[..., Run]


def patterns(path: Path) -> np.ndarray:
    with open_psf(path) as H:
        return np.asarray(H, np.float64)


@pytest.mark.parametrize("dtype", [np.float32, np.int16])
def test_frames_whose_dark_is_subtracted_already(
    lfcal: Lfcal, session: Path, tmp_path: Path, dtype: type[np.number]
) -> None:
    """Noise is then negative in half of the dark pixels (flatironinstitute/CaImAn#652)."""
    rng = np.random.default_rng(0)
    plain = lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "plain.h5")
    assert plain.code == 0, plain.err
    shutil.copytree(session / "frames", tmp_path / "f")
    for path in (tmp_path / "f").glob("*.png"):
        values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64) - DARK
        tifffile.imwrite(path.with_suffix(".tif"), (values + rng.normal(0, 3, values.shape)).astype(dtype))
        path.unlink()
    listed = tmp_path / "f/manifest.csv"
    listed.write_text(listed.read_text().replace(".png", ".tif"))
    done = lfcal("assemble", tmp_path / "f", "--plan", session / "plan.json", "-o", tmp_path / "H.h5")
    assert done.code == 0, done.err
    wanted, found = patterns(tmp_path / "plain.h5"), patterns(tmp_path / "H.h5")
    assert np.abs(found - wanted).max() < 20 and wanted.max() > 15000


def test_a_frame_with_nan_and_negative_values_is_reconstructed(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    """A subtracted background leaves negative values, a bad pixel NaN (roman-corgi/corgidrp#988)."""
    made = lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "H.h5")
    assert made.code == 0, made.err
    light = cv2.imread(str(session / "frames/z0_y0_x1.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) - DARK
    light += np.random.default_rng(1).normal(0, 5, light.shape).astype(np.float32)
    volumes = []
    for name, bad in (("whole", False), ("spoiled", True)):
        frame = light.copy()
        if bad:
            frame[3, 4], frame[2, 20] = np.nan, -4000
        tifffile.imwrite(tmp_path / f"{name}.tif", frame)
        done = lfcal(
            "reconstruct",
            tmp_path / "H.h5",
            tmp_path / f"{name}.tif",
            "-o",
            tmp_path / f"{name}.npy",
            "-n",
            4,
            "--resample",
            "never",
        )
        assert done.code == 0, done.err
        volumes.append(np.load(tmp_path / f"{name}.npy"))
    whole, spoiled = volumes
    assert np.isfinite(spoiled).all() and spoiled.min() >= 0
    assert abs(spoiled.sum() / whole.sum() - 1) < 0.02
    lost = np.zeros(light.shape, np.uint8)
    lost[3, 4] = lost[2, 20] = 1
    tifffile.imwrite(tmp_path / "lost.tif", lost)
    words = ("-o", tmp_path / "masked.npy", "-n", 4, "--resample", "never", "--mask", tmp_path / "lost.tif")
    masked = lfcal("reconstruct", tmp_path / "H.h5", tmp_path / "whole.tif", *words)
    assert masked.code == 0 and masked.err.count("2 non-finite pixels were left out") == 1, masked.err
    resampled = lfcal("reconstruct", tmp_path / "H.h5", tmp_path / "spoiled.tif", "-o", tmp_path / "r.npy", "-n", 4)
    assert resampled.code == 0 and np.isfinite(np.load(tmp_path / "r.npy")).all(), resampled.err


def test_frames_that_the_camera_delivered_twice_are_named(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    """A buffer is read before the next frame is there (pymmcore-plus/pymmcore-plus#445)."""
    frames = session / "frames"
    for x in (2, 3):
        shutil.copy(frames / "z0_y0_x1.png", frames / f"z0_y0_x{x}.png")
    made = lfcal("assemble", frames, "--dark", session / "dark", "-o", tmp_path / "H.h5")
    assert made.code == 0, made.err
    done = lfcal("inspect", tmp_path / "H.h5", "--seconds", 5)
    assert "duplicate" in done.out, done.out
