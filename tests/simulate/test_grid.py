"""The whole array on one grid: converges to the reference, at every depth, with everything a scene may have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.simulate.engines._nodes import MANY_ANGLES, conserving_rule
from lfcal.simulate.engines.base import Displaceable, EnergyError, PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import PupilIris, Scene
from tests.simulate.common import BASE, small_plan
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, relative_error

FINE = Sampling(samples_per_px=8, margin_px=40)
JUDGE = Sampling(samples_per_px=8)
AT = (2 * PIXEL, -3 * PIXEL)


def both(scene: Scene, at: tuple[float, float] = AT) -> tuple[np.ndarray, np.ndarray]:
    """Return a response on the grid and by the reference."""
    found = GridPlane(replace(scene, period=(1, 1)), FINE).point(*at)
    return found, ReferencePlane(scene, JUDGE).point(*at)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "v", [4.0, 0.0, 0.4, *(pytest.param(v, marks=pytest.mark.long) for v in (-0.7, 1.2, -3.0, 2.0))]
)
@pytest.mark.parametrize("exact", [False, True])
def test_it_converges_to_the_reference(v: float, exact: bool) -> None:
    scene = camera_scene(v, cutout=(41, 41), exact_rays=exact, exact_defocus=exact)
    assert relative_error(*both(scene)) < 0.0015


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "changes",
    [
        {"aperture": "cell"},
        {"lenslet_waves": 0.4},
        {"defects": ((0, 0, 0.3), (1, 0, 0.0))},
        {"wavefront": ((3, 1, 0.2), (4, 0, 0.15))},
        {"pixel_fill": 0.7},
        {"pupil_um": 9000.0},
        {"iris": PupilIris(blades=6, rotation_rad=0.3)},
        {"glass": (300.0, 1.52), "exact_rays": True, "exact_defocus": True},
        {"accept": (6.0, 0.1, -0.05)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_what_a_scene_may_have_is_in_it(changes: dict) -> None:
    scene = camera_scene(3.0, cutout=(35, 35), **changes)
    found, reference = both(scene)
    assert relative_error(found, reference) < 0.0015
    plain = GridPlane(camera_scene(3.0, cutout=(35, 35)), FINE).point(*AT)
    # each changes the image by more than the grid errs
    assert relative_error(plain, reference) > 0.004


@pytest.mark.few(1)
@pytest.mark.parametrize("per_px", [4, 5])
def test_a_source_between_pixels(per_px: int) -> None:
    """Even and odd numbers of samples lie differently about a pixel's middle."""
    scene, at = camera_scene(3.0, cutout=(35, 35)), (2.3 * PIXEL, -3.4 * PIXEL)
    found = GridPlane(scene, Sampling(samples_per_px=per_px, margin_px=20)).point(*at)
    assert relative_error(found, ReferencePlane(scene, JUDGE).point(*at)) < 0.012


def test_positions_are_read_off_one_table() -> None:
    """A position beyond the table has one of its own; both are the same light."""
    scene = camera_scene(3.0, cutout=(31, 31))
    engine = GridPlane(scene, Sampling(samples_per_px=4, margin_px=12))
    ny, nx = scene.period
    rows = engine.rows([0, 3, ny - 1], [0, nx - 1], workers=2)
    for i, y in enumerate((0, 3, ny - 1)):
        for j, x in enumerate((0, nx - 1)):
            alone = GridPlane(replace(scene, period=(1, 1)), engine.sampling).rows([y], [x])[0, 0]
            np.testing.assert_allclose(rows[i, j], alone, atol=2e-6 * rows.max())
    beyond = engine.rows([ny + 2], [-1])[0, 0]
    wanted = ReferencePlane(scene, JUDGE).rows([ny + 2], [-1])[0, 0]
    assert relative_error(beyond, wanted) < 0.012


def test_displaced_sources_share_the_table() -> None:
    scene = camera_scene(3.0, cutout=(31, 31))
    offsets = np.random.default_rng(5).uniform(-0.6, 0.6, (*scene.period, 2)) * PIXEL
    wide = replace(scene, offsets_um=offsets)
    engine = GridPlane(wide, Sampling(samples_per_px=6, margin_px=30))
    assert isinstance(engine, Displaceable) and isinstance(engine, PlaneEngine)
    moved = engine.displaced(-offsets)
    assert moved._array is engine._array
    for one, other in ((engine, wide), (moved, replace(scene, offsets_um=-offsets))):
        found = one.rows([4], [7])[0, 0]
        assert relative_error(found, ReferencePlane(other, JUDGE).rows([4], [7])[0, 0]) < 0.004
    # those of a large source lie farther aside than the table holds: one other serves them all
    far, farther = (engine.displaced(np.full_like(offsets, k * PIXEL)) for k in (3, 5))
    assert far._array is not engine._array and farther._array is far._array
    beside = replace(scene, offsets_um=np.full_like(offsets, 3 * PIXEL))
    assert relative_error(far.rows([4], [7])[0, 0], ReferencePlane(beside, JUDGE).rows([4], [7])[0, 0]) < 0.004


@pytest.mark.long
@pytest.mark.parametrize("vectorial", [False, True])
def test_a_microscope_and_its_dipoles(vectorial: bool) -> None:
    scene = microscope_scene(4.0, cutout=(31, 31), vectorial=vectorial)
    found = engine_for(scene, "grid", Sampling(samples_per_px=8, margin_px=40)).rows([2], [3])[0, 0]
    assert relative_error(found, engine_for(scene, "reference", JUDGE).rows([2], [3])[0, 0]) < 0.003


def test_light_is_kept() -> None:
    scene = camera_scene(3.0, cutout=(121, 121))
    engine = GridPlane(scene, Sampling(samples_per_px=5, margin_px=30))
    found = engine.rows([0, 5], [1])
    book = engine.certificate
    assert (found > 0).all()
    assert book.responses == 2 and 0.97 * book.energy_in < book.energy_out < 1.0005 * book.energy_in
    assert float(found.sum()) == pytest.approx(book.energy_out, rel=1e-5)
    with pytest.raises(EnergyError, match="energy on the sensor"):
        engine._certify(1.0, 1.01)


@pytest.mark.parametrize(("samples", "error"), [(4, 0.015), (6, 0.005)])
def test_few_samples_are_not_taken_for_light_too_much(samples: int, error: float) -> None:
    plan = small_plan(3.0, cutout=55)
    found, finer = (
        PlaneResponse(plan, 0, BASE, level="grid", sampling=Sampling(n)).rows([1, 9], [2, 9, 23]) for n in (samples, 10)
    )
    assert relative_error(found, finer) < error


def test_single_and_double_precision_agree() -> None:
    scene = camera_scene(-2.0, cutout=(41, 41))
    single, double = (
        GridPlane(scene, Sampling(samples_per_px=4, margin_px=12, double=double)).point(*AT) for double in (False, True)
    )
    assert relative_error(single, double) < 2e-6


def test_what_no_grid_holds_is_refused() -> None:
    with pytest.raises(InputError, match="samples per pixel of a grid: expected a whole number"):
        GridPlane(camera_scene(3.0), Sampling(samples_per_px=4.5))
    with pytest.raises(
        InputError, match="sampling grid of one position of the source: expected at most 4096 samples on each side"
    ):
        GridPlane(camera_scene(3.0), Sampling(samples_per_px=64, margin_px=500))


@pytest.mark.parametrize(("per_px", "band"), [(9, 0.3), (16, 3.0), (30, 3.0), (40, 16.0), (4, 2.0)])
def test_pixels_take_all_nodes_alike_however_many_there_are(per_px: int, band: float) -> None:
    """The best fit leaves nodes out where the light needs fewer: weights of what is left were no numbers."""
    rule = conserving_rule(per_px, band, MANY_ANGLES)
    taken = [rule.weights[first::per_px].sum() for first in range(per_px)]
    np.testing.assert_allclose(taken, 1 / per_px, rtol=1e-9)
    x = (np.arange(rule.weights.size) - (rule.weights.size - 1) / 2) / per_px
    f = np.linspace(0, band, 300)
    seen = np.cos(2 * np.pi * np.outer(f, x)) @ rule.weights
    trust = np.clip(1 - f / band, 0, None) ** MANY_ANGLES
    assert np.abs(seen - np.sinc(f)) @ trust / trust.sum() < 3e-3


def test_what_is_no_number_is_refused() -> None:
    plane = GridPlane(camera_scene(3.0, cutout=(21, 21)), Sampling(samples_per_px=4, margin_px=8))
    plane._weights = plane._weights * np.float32(np.nan)
    with pytest.raises(EnergyError, match="energy on the sensor"):
        plane.rows([1], [2])
