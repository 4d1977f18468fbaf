"""Frames whole periods away: where they agree, and what their difference says of the period."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.judge.quality import inspect, periodicity
from lfcal.psf import PSFMatrix

from .scenes import Scene, hexagonal, recorded, square


def at(scene: Scene, places: np.ndarray, z: int = 0) -> np.ndarray:
    """Return the patterns of a source at sensor ``places (n, 2)`` (row, column)."""
    ny, nx = scene.period
    frames = []
    for row, column in places:
        offset = np.zeros((ny, nx, 2))
        offset[0, 0] = row, column
        frames.append(scene.plane(z, stage=offset, cutouts=offset)[0, 0])
    return np.stack(frames)


def stretched(scene: Scene, factor: float) -> Scene:
    """Return the scene with lenslets ``factor`` farther apart: what the edge of a field looks like."""
    lattice = scene.camera.lattice
    wider = dataclasses.replace(
        lattice,
        pitch_um=lattice.pitch_um * factor,
        row_pitch_um=lattice.row_step_um * factor,
        offset_um=tuple(v * factor for v in lattice.offset_um),
    )
    return Scene(dataclasses.replace(scene.camera, lattice=wider), scene.virtual_depths, scene.cutout, scene.blur_px)


def test_frames_one_period_away_agree_where_the_lattice_is_regular():
    scene = square()
    ny, nx = scene.period
    places = np.array([[3 + ny, 4], [3, 4 - nx], [7 + 2 * ny, 2 + nx]])
    found = periodicity(at(scene, places), places, scene.planes[0])
    assert found.away.tolist() == [[1, 0], [0, -1], [2, 1]]
    assert found.difference.max() < 0.01 and np.abs(found.shift).max() < 0.05


def test_the_period_of_a_wider_or_narrower_lattice_is_found():
    scene = square()
    ny, nx = scene.period
    wide, narrow = stretched(scene, 1.01), stretched(scene, 0.99)
    places = np.array([[3 + 4 * ny, 4], [3, 4 - 5 * nx], [3 + 3 * ny, 4 + 6 * nx]])
    found = periodicity(at(wide, places), places, wide.planes[0])
    assert found.fitting_period == pytest.approx((15.15, 15.15), abs=0.03)
    assert (found.best < found.difference).all()
    places = np.array([[3 + 5 * ny, 4]])
    found = periodicity(at(narrow, places), places, narrow.planes[0])
    assert found.period[0, 0] == pytest.approx(14.85, abs=0.03) and np.isnan(found.period[0, 1])


def test_another_pattern_is_no_match_and_a_wrong_shape_is_refused():
    scene = square()
    places = np.array([[3 + 15, 4]])
    assert periodicity(at(scene, places, z=1), places, scene.planes[0]).difference[0] > 0.3
    with pytest.raises(InputError, match="control frames"):
        periodicity(np.zeros((2, 5, 5)), np.zeros((2, 2)), np.zeros((3, 3, 7, 7)))


def test_a_cell_of_unequal_sides_and_an_anchor():
    scene = hexagonal()
    ny, nx = scene.period
    places = np.array([[2 + ny, 5 + nx]])
    found = periodicity(at(scene, places), places + 100.0, scene.planes[0], anchor=(100.0, 100.0))
    assert found.away.tolist() == [[1, 1]]
    assert found.difference[0] < 0.1


def test_the_inspection_takes_control_frames_along():
    scene = square()
    places = np.array([[3 + 15, 4], [3, 4 + 30]])
    values = recorded(scene.planes, 0, 3.0)
    far = at(stretched(scene, 1.02), places) * scene.scale
    H = PSFMatrix(values, depths=scene.depths, camera=scene.camera)
    good = inspect(H, controls={0: (at(scene, places) * scene.scale, places)})
    bad = inspect(H, controls={0: (far, places)})
    assert good["tiling"].merit == "good" and good.tilings[0] is not None
    assert bad["tiling"].merit == "bad"
    assert "fits best" in bad["tiling"].detail
