"""The whole array on one grid: it converges to the reference; its fused transforms and sums."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.fft as sf

from lfcal.base import InputError
from lfcal.simulate import Sampling
from lfcal.simulate.engines import Displaceable, EnergyError, Extent, PlaneEngine
from lfcal.simulate.engines._fused import FusedResponse, frequency_order, way_of
from lfcal.simulate.engines._fused_llvm import LANES, RADICES
from lfcal.simulate.engines._nodes import MANY_ANGLES, conserving_rule
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import PupilIris, Scene
from tests.simulate.common import long
from tests.simulate.scenes import PIXEL, camera_scene, relative_error

FINE = Sampling(samples_per_px=8, margin_px=40)
JUDGE = Sampling(samples_per_px=8)
AT = (2 * PIXEL, -3 * PIXEL)


def both(scene: Scene, at: tuple[float, float] = AT) -> tuple[np.ndarray, np.ndarray]:
    """Return a response on the grid and by the reference."""
    found = GridPlane(replace(scene, period=(1, 1)), FINE).point(*at)
    return found, ReferencePlane(scene, JUDGE).point(*at)


@pytest.mark.few(1)
@pytest.mark.parametrize("v", [4.0, 0.4, *(long(v) for v in (0.0, -0.7, 1.2, -3.0, 2.0))])
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


def test_positions_are_read_off_one_table() -> None:
    """A position beyond the table has its own one; both give the same light."""
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


@pytest.mark.long
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
    # sources of a large source lie beyond the table: one other table serves them all
    far, farther = (engine.displaced(np.full_like(offsets, k * PIXEL)) for k in (3, 5))
    assert far._array is not engine._array and farther._array is far._array
    displaced = replace(scene, offsets_um=np.full_like(offsets, 3 * PIXEL))
    assert relative_error(far.rows([4], [7])[0, 0], ReferencePlane(displaced, JUDGE).rows([4], [7])[0, 0]) < 0.004


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


def test_single_and_double_precision_agree() -> None:
    scene = camera_scene(-2.0, cutout=(41, 41))
    single, double = (
        GridPlane(scene, Sampling(samples_per_px=4, margin_px=12, double=double)).point(*AT) for double in (False, True)
    )
    assert relative_error(single, double) < 2e-6


def test_what_no_grid_can_compute_is_refused() -> None:
    for sampling, expected in (
        (Sampling(samples_per_px=4.5), "samples per pixel of a grid: expected a whole number"),
        (
            Sampling(samples_per_px=64, margin_px=500),
            "one position of the source: expected at most 4096 samples on each",
        ),
    ):
        with pytest.raises(InputError, match=expected):
            GridPlane(camera_scene(3.0), sampling)
    plane = GridPlane(camera_scene(3.0, cutout=(21, 21)), Sampling(samples_per_px=4, margin_px=8))
    plane._weights = plane._weights * np.float32(np.nan)
    with pytest.raises(EnergyError, match="energy on the sensor"):
        plane.rows([1], [2])


@pytest.mark.parametrize(("per_px", "band"), [(9, 0.3), (16, 3.0), (30, 3.0), (40, 16.0), (4, 2.0)])
def test_pixels_take_all_nodes_alike_however_many_there_are(per_px: int, band: float) -> None:
    """The best fit leaves nodes out where the light needs fewer: the weights of the others were NaN."""
    rule = conserving_rule(per_px, band, MANY_ANGLES)
    taken = [rule.weights[first::per_px].sum() for first in range(per_px)]
    np.testing.assert_allclose(taken, 1 / per_px, rtol=1e-9)
    x = (np.arange(rule.weights.size) - (rule.weights.size - 1) / 2) / per_px
    f = np.linspace(0, band, 300)
    seen = np.cos(2 * np.pi * np.outer(f, x)) @ rule.weights
    trust = np.clip(1 - f / band, 0, None) ** MANY_ANGLES
    assert np.abs(seen - np.sinc(f)) @ trust / trust.sum() < 3e-3


SIZES = (16, 18, 21, 22, 25, 27, 44, 49, 70, 96, 99, 108, 120, 121, 132, 144, 200, 210, 343)
CORNER = (7, 3)


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(np.complex64)


def made(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a field, a table of which the grid is a part, and a transfer function."""
    rng = np.random.default_rng(seed)
    turn = np.exp(2j * np.pi * rng.random((n, n))).astype(np.complex64)
    return noise(rng, n, n), noise(rng, n + 11, n + 5), turn


def light(lit: np.ndarray, table: np.ndarray, step: np.ndarray, kind: type) -> tuple[float, np.ndarray]:
    """Return the power behind the array and the light on all samples, by scipy in single or double precision."""
    n = lit.shape[0]
    behind = lit.astype(kind) * table[CORNER[0] : CORNER[0] + n, CORNER[1] : CORNER[1] + n].astype(kind)
    field = sf.ifft2(sf.fft2(behind) * step.astype(kind))
    return float((np.abs(behind.astype(complex)) ** 2).sum()), np.abs(field) ** 2


def pixels(
    light: np.ndarray, weights: np.ndarray, per: int, start: tuple[int, int], shape: tuple[int, int]
) -> np.ndarray:
    """Return the light on pixels, summed sample by sample."""
    found = np.zeros(shape)
    for i, w in enumerate(weights):
        for j, v in enumerate(weights):
            rows, columns = (s + k + per * np.arange(c) for s, k, c in zip(start, (i, j), shape, strict=True))
            found += float(w) * float(v) * light[np.ix_(rows, columns)]
    return found


def error(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))


def test_every_sample_is_as_accurate_as_single_precision_can_be() -> None:
    for n in SIZES:
        field, table, step = made(n)
        response, one, out = FusedResponse(step), np.ones(1, np.float32), np.empty((n, n), np.float32)
        power = response.respond(field, (table, CORNER), one, (1, 0, 0), response.workspace(n), out)
        wanted, exact = light(field, table, step, np.complex128)
        assert power == pytest.approx(wanted, rel=1e-6), n
        assert error(out, exact) < min(5e-7, 2 * error(light(field, table, step, np.complex64)[1], exact)), n
    # every butterfly is tried, and columns at the end that overlap those before or do not
    assert {int(radix) for n in SIZES for stages in way_of(n) for radix in stages.radices} == set(RADICES)
    assert {len(way_of(n).then.radices) for n in SIZES} == {1, 2} and {n % LANES == 0 for n in SIZES} == {False, True}


@pytest.mark.parametrize(
    ("per", "taps", "start", "shape"), [(4, 6, (9, 31), (20, 15)), (3, 5, (0, 0), (5, 35)), (5, 7, (61, 2), (8, 20))]
)
def test_pixels_of_a_cutout_anywhere(per: int, taps: int, start: tuple[int, int], shape: tuple[int, int]) -> None:
    field, table, step = made(108)
    weights = np.random.default_rng(2).random(taps).astype(np.float32)
    response, out = FusedResponse(step), np.empty(shape, np.float32)
    work = response.workspace(shape[0])
    response.respond(field, (table, CORNER), weights, (per, *start), work, out)
    wanted = pixels(light(field, table, step, np.complex128)[1], weights, per, start, shape)
    np.testing.assert_allclose(out, wanted, rtol=2e-6)
    # nothing of another position is left behind
    other = np.empty_like(out)
    response.respond(*[made(108, 5)[0], (table, CORNER), weights, (per, *start), work, other])
    response.respond(field, (table, CORNER), weights, (per, *start), work, other)
    np.testing.assert_array_equal(other, out)


def test_many_positions_in_one_call_are_each_alone() -> None:
    field, table, step = made(108)
    weights, corners = np.random.default_rng(2).random(5).astype(np.float32), [(0, 0), (11, 5), (7, 3), (7, 3)]
    response, shape = FusedResponse(step), (20, 15)
    work, out = response.workspace(shape[0]), np.empty((4, *shape), np.float32)
    powers = response.each(field, (table, corners), weights, (4, 9, 31), work, out)
    for corner, power, one in zip(corners, powers, out, strict=True):
        alone = np.empty(shape, np.float32)
        assert response.respond(field, (table, corner), weights, (4, 9, 31), work, alone) == power
        np.testing.assert_array_equal(one, alone)
    assert len(set(powers)) == 3
    with pytest.raises(ValueError, match="expected one for each of 4 cutouts, got 3"):
        response.each(field, (table, corners[:3]), weights, (4, 9, 31), work, out)
    with pytest.raises(ValueError, match="grid at 12, 5: expected"):
        response.each(field, (table, [*corners[:3], (12, 5)]), weights, (4, 9, 31), work, out)


def test_stages_are_few_and_visit_every_frequency_once() -> None:
    for n in (16, 132, 588):
        np.testing.assert_array_equal(np.sort(frequency_order(n)), np.arange(n))
    assert [len(way_of(n).then.radices) + 1 for n in (144, 588, 1728, 4096)] == [2, 3, 3, 4]
    assert [math.prod((*way_of(n).first.radices, *way_of(n).then.radices)) for n in (144, 588)] == [144, 588]
    assert not any(FusedResponse.transforms(n) for n in (8, 26, 17 * 32))
    for n in (7, 26):
        with pytest.raises(ValueError, match=f"expected a product of two or more primes up to 11, got {n}"):
            way_of(n)
    sides = {Extent(k / 3, 0.0, k / 3, 12.0).side(4, 10) for k in range(1, 1500)}
    assert len(sides) > 50 and all(FusedResponse.transforms(side) for side in sides)


def test_nothing_is_read_beyond_the_arrays() -> None:
    field, table, step = made(27)
    response, out, weights = FusedResponse(step), np.empty((8, 8), np.float32), np.ones(5, np.float32)
    for corner, start, expected in (
        ((0, 0), (-1, 0), r"expected samples within 27 x 27, got \[-1, 0\] to \[25, 26\] of 27 x 27"),
        ((0, 0), (0, 2), r"got \[0, 2\] to \[26, 28\]"),
        ((12, 0), (0, 0), "grid at 12, 0: expected 27 x 27 samples within 38 x 32"),
        ((0, 6), (0, 0), "grid at 0, 6: expected"),
        ((-1, 0), (0, 0), "grid at -1, 0: expected"),
    ):
        with pytest.raises(ValueError, match=expected):
            response.respond(field, (table, corner), weights, (3, *start), response.workspace(8), out)


def test_an_engine_takes_the_passes_and_gets_the_same_bits_every_time() -> None:
    scene = camera_scene(3.0, cutout=(31, 25))
    engine = GridPlane(scene, Sampling(samples_per_px=4, margin_px=12))
    assert isinstance(engine._gap.way(6), FusedResponse)
    first = engine.rows([0, 2, 5], [1, 4], workers=1)
    np.testing.assert_array_equal(engine.rows([0, 2, 5], [1, 4], workers=2), first)
    np.testing.assert_array_equal(engine.point(2 * PIXEL, 4 * PIXEL), engine.rows([2], [4])[0, 0])
    # what lies around it in memory is left alone
    around = np.full((3, 2, 33, 25), np.float32(-1))
    engine.rows([0, 2, 5], [1, 4], around[:, :, 1:-1])
    np.testing.assert_array_equal(around[:, :, 1:-1], first)
    assert (around[:, :, [0, -1]] == -1).all()
