"""Responses in passes on lanes: what numpy makes of them in double precision, for all sizes of grids and cutouts."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.fft as sf

from lfcal.simulate.engines._fused import FusedResponse, frequency_order, way_of
from lfcal.simulate.engines._fused_llvm import LANES, RADICES
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.extent import Extent
from lfcal.simulate.engines.grid import GridPlane
from tests.simulate.scenes import PIXEL, camera_scene

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


@pytest.mark.parametrize("n", SIZES)
def test_every_sample_is_as_right_as_single_precision_can_be(n: int) -> None:
    field, table, step = made(n)
    response, one, out = FusedResponse(step), np.ones(1, np.float32), np.empty((n, n), np.float32)
    power = response.respond(field, (table, CORNER), one, (1, 0, 0), response.workspace(n), out)
    wanted, exact = light(field, table, step, np.complex128)
    assert power == pytest.approx(wanted, rel=1e-6)
    assert error(out, exact) < 5e-7
    assert error(out, exact) < 2 * error(light(field, table, step, np.complex64)[1], exact)


def test_every_butterfly_is_tried() -> None:
    used = {int(radix) for n in SIZES for stages in way_of(n) for radix in stages.radices}
    assert used == set(RADICES)
    assert {len(way_of(n).then.radices) for n in SIZES} == {1, 2}
    # the last columns overlap those before, or do not
    assert {n % LANES == 0 for n in SIZES} == {False, True}


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


@pytest.mark.parametrize("n", [16, 132, 588])
def test_frequencies_come_each_once(n: int) -> None:
    np.testing.assert_array_equal(np.sort(frequency_order(n)), np.arange(n))


def test_stages_are_few() -> None:
    assert [len(way_of(n).then.radices) + 1 for n in (144, 588, 1728, 4096)] == [2, 3, 3, 4]
    assert [math.prod((*way_of(n).first.radices, *way_of(n).then.radices)) for n in (144, 588)] == [144, 588]


def test_what_has_no_stages_is_told() -> None:
    assert not any(FusedResponse.transforms(n) for n in (8, 26, 17 * 32))
    for n in (7, 26):
        with pytest.raises(ValueError, match=f"expected a product of two or more primes up to 11, got {n}"):
            way_of(n)


@pytest.mark.parametrize(
    ("corner", "start", "told"),
    [
        ((0, 0), (-1, 0), r"expected samples within 27 x 27, got \[-1, 0\] to \[25, 26\] of 27 x 27"),
        ((0, 0), (0, 2), r"got \[0, 2\] to \[26, 28\]"),
        ((12, 0), (0, 0), "grid at 12, 0: expected 27 x 27 samples within 38 x 32"),
        ((0, 6), (0, 0), "grid at 0, 6: expected"),
        ((-1, 0), (0, 0), "grid at -1, 0: expected"),
    ],
)
def test_nothing_is_read_beyond_what_there_is(corner: tuple[int, int], start: tuple[int, int], told: str) -> None:
    field, table, step = made(27)
    response, out = FusedResponse(step), np.empty((8, 8), np.float32)
    with pytest.raises(ValueError, match=told):
        response.respond(field, (table, corner), np.ones(5, np.float32), (3, *start), response.workspace(8), out)


def test_every_grid_has_stages() -> None:
    sides = {Extent(k / 3, 0.0, k / 3, 12.0).side(4, 10) for k in range(1, 1500)}
    assert len(sides) > 50 and all(FusedResponse.transforms(side) for side in sides)


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


def test_a_tilted_array_and_double_precision_take_one_step_after_the_other() -> None:
    scene = camera_scene(3.0, cutout=(21, 21))
    double = GridPlane(scene, Sampling(samples_per_px=4, margin_px=8, double=True))
    tilted = GridPlane(camera_scene(3.0, cutout=(21, 21), tilt=(1e-3, 0.0)), Sampling(samples_per_px=4, margin_px=8))
    assert not any(isinstance(engine._gap.way(6), FusedResponse) for engine in (double, tilted))
    assert tilted.point(0.0, 0.0).min() > 0
