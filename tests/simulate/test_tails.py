"""Light beyond the windows of lenslets: as much as they lack, where the whole array on one grid has it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lfcal.camera import LensletLattice, LensType
from lfcal.simulate.engines import _tails as tails
from lfcal.simulate.engines import _wave as wave
from lfcal.simulate.engines._tail_kernels import add_tails
from lfcal.simulate.engines._tails import Tail
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.scene import Scene
from tests.simulate.scenes import PIXEL, camera_scene, relative_error

NARROW = Sampling(nodes_per_px=4, margin_px=1, coherent=False)
WIDE = Sampling(nodes_per_px=4, margin_px=30, coherent=False)
AT = (2 * PIXEL, -3 * PIXEL)


def square_scene() -> Scene:
    """Return square lenslets of 20 px that fill their cells, 0.3 out of focus."""
    pitch = 20 * PIXEL
    lattice = LensletLattice("square", pitch, 6 * pitch, (LensType.focused_at(3.5, 6 * pitch),))
    return camera_scene(3.0, lattice=lattice, image_um=18 * pitch, f_number=6.0, aperture="cell", cutout=(81, 81))


def without(patch: pytest.MonkeyPatch) -> None:
    """Leave tails out."""
    patch.setattr(tails, "add_tails", lambda *given: None)


def point(scene: Scene, sampling: Sampling) -> np.ndarray:
    """Return a response as float64."""
    return WavePlane(scene, sampling).point(*AT).astype(np.float64)


@pytest.mark.few(1)
@pytest.mark.parametrize("scene", [camera_scene(4.0, cutout=(91, 91)), square_scene()], ids=["round", "square"])
def test_narrow_windows_have_the_light_of_wide_ones(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow, wide = point(scene, NARROW), point(scene, WIDE)
    without(monkeypatch)
    cut = point(scene, NARROW)
    assert abs(narrow.sum() / wide.sum() - 1) < 0.006
    assert cut.sum() / wide.sum() < 0.98
    assert relative_error(narrow, wide) < 0.6 * relative_error(cut, wide)


@pytest.mark.long
def test_against_the_grid_they_do_most_of_what_wide_windows_do(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = camera_scene(4.0, cutout=(91, 91))
    truth = GridPlane(scene, Sampling(samples_per_px=6, margin_px=40)).point(*AT)
    narrow, wide = (relative_error(point(scene, s), truth) for s in (NARROW, WIDE))
    without(monkeypatch)
    cut = relative_error(point(scene, NARROW), truth)
    assert narrow - wide < 0.45 * (cut - wide)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("change", [{"pixel_fill": 0.7}, {"accept": (4.0, 0.0, 0.0)}], ids=["fill", "angles"])
def test_pixels_take_their_share_of_tails(change: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    scene = camera_scene(4.0, cutout=(91, 91), **change)
    wide, narrow = point(scene, WIDE).sum(), point(scene, NARROW).sum()
    without(monkeypatch)
    assert abs(narrow - wide) < 0.25 * (wide - point(scene, NARROW).sum())


def test_sums_of_fields_have_none() -> None:
    scene = camera_scene(4.0)
    assert WavePlane(scene, Sampling(coherent=True))._tails == ()
    assert len(WavePlane(scene, NARROW)._tails) == 3


def test_a_window_that_has_all_light_adds_none() -> None:
    spots = np.zeros(1, wave.SPOT)
    spots["energy_in"], spots["energy_out"] = 1.0, 1.1
    image = np.zeros((1, 9, 9), np.float32)
    assert Tail(np.ones((5, 5), np.float32), 1.05, 0.1, True).add(spots, 1, image) == 0
    assert not image.any()


@pytest.mark.parametrize("corner", [(-4, -4), (7, 7), (-30, 2), (2, 30)])
def test_tails_end_with_the_cutout(corner: tuple[int, int]) -> None:
    spots = np.zeros(1, wave.SPOT)
    spots["top"], spots["left"] = corner
    pattern = np.arange(49, dtype=np.float32).reshape(7, 7)
    image = np.zeros((1, 9, 9), np.float32)
    add_tails(spots, np.array([2.0]), pattern, 2, image)
    wanted = np.zeros((109, 109), np.float32)
    top, left = corner[0] - 2 + 50, corner[1] - 2 + 50
    wanted[top : top + 7, left : left + 7] = 2 * pattern
    assert np.array_equal(image[0], wanted[50:59, 50:59])


def test_a_small_cutout_has_the_tails_of_lenslets_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = camera_scene(4.0, cutout=(9, 9)), camera_scene(4.0, cutout=(91, 91))
    wanted = point(large, NARROW)[41:50, 41:50]
    found = relative_error(point(small, NARROW), wanted)
    monkeypatch.setattr(Tail, "add_far", lambda *given: None)
    assert found < 0.2 * relative_error(point(small, NARROW), wanted)


def test_energy_is_accounted_for() -> None:
    """But for what lies farther than tails are followed."""
    engine = WavePlane(camera_scene(4.0, cutout=(151, 151)), NARROW)
    light = float(engine.rows([2], [3, 9]).sum(dtype=np.float64))
    told = engine.certificate
    assert light == pytest.approx(told.energy_out, rel=2e-3)
    assert 0.99 < told.energy_out / told.energy_in < 1
