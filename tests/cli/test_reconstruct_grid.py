"""Frames go onto H's period by a lenslet of the type that H counts from, wherever the frame's middle lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.cli.reconstruct_grid import view_of
from lfcal.cli.white_files import save_lattice
from lfcal.errors import InputError
from lfcal.lattice import fit_lattice
from lfcal.psf import PSFMatrix
from tests.lattice.white_frames import WhiteFrame, draw_white

PITCH = 16.0


def drawn(phase: int) -> tuple[WhiteFrame, PSFMatrix]:
    """Return a white frame whose lenslet of type ``phase`` lies in the middle, and an H of its camera."""
    truth = draw_white((330, 400), pitch=PITCH, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.0, phase=phase, dark=0.0)
    middle = (np.array(truth.frame.shape) - 1) / 2
    # the place of a lenslet of type 0, as the description knows it
    row, column = (np.array([phase, 0]) @ truth.basis)[::-1] + np.array(truth.origin) - middle
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 5 * PITCH, 400.0, types, offset_um=(5 * column, 5 * row))
    camera = Camera("c", MainLens(), lattice, Sensor(truth.frame.shape, 5.0))
    return truth, PSFMatrix(np.ones((1, 28, 48, 3, 3)), depths=[-500.0], camera=camera, anchor=(100.0, 120.0))


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("phase", [0, 1, 2])
def test_the_origin_is_a_lenslet_of_type_0(tmp_path: Path, phase: int) -> None:
    truth, H = drawn(phase)
    white = tmp_path / "white.tif"
    tifffile.imwrite(white, truth.frame)
    save_lattice(fit_lattice(truth.frame), tmp_path)
    for view in (view_of(H, white), view_of(H, None, tmp_path / "lattice.json")):
        ((q, r),) = truth.indices(np.array([view.origin]))
        assert truth.distance_to_lattice(view.origin) < 0.05
        assert (q - r - phase) % 3 == 0


def test_a_white_frame_of_another_sensor_is_refused(tmp_path: Path) -> None:
    truth, H = drawn(0)
    tifffile.imwrite(tmp_path / "white.tif", truth.frame[:-20])
    with pytest.raises(InputError, match="white image"):
        view_of(H, tmp_path / "white.tif")
