"""A volume from any side, checked against a brute-force maximum along each ray by `scipy.ndimage`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter

from lfcal.base.errors import InputError
from lfcal_gui.models.solid import BEGIN, Solid, Viewpoint, project_solid, turned

UNEVEN = np.array([-30.0, -22.0, -19.0, -9.0, 0.0, 4.0, 15.0])


def random_turn(rng: np.random.Generator) -> NDArray[np.float64]:
    found, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return found * np.sign(np.linalg.det(found))


def blobs(shape: tuple[int, int, int], seed: int = 0, sigma: float = 1.5) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    points = np.zeros(shape)
    points[tuple(rng.integers(0, n, 12) for n in shape)] = rng.uniform(0.5, 1, 12)
    smooth = gaussian_filter(points, (0.7, sigma, sigma))
    return np.asarray(smooth / smooth.max(), np.float32)


def rays(solid: Solid, scene: Viewpoint, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the maximum and its depth by samples every ``step`` along each ray: slow, and written another way."""
    top, left = scene.origin
    down, right = np.meshgrid(*(o + scene.pixel * np.arange(n) for o, n in zip((top, left), scene.shape, strict=True)))
    best, depth = np.full(scene.shape, -np.inf), np.full(scene.shape, np.nan)
    for far in np.arange(-solid.radius, solid.radius + step, step):
        at = right.T[..., None] * scene.turn[0] + down.T[..., None] * scene.turn[1] + far * scene.turn[2]
        inside = (np.abs(at) <= solid.half).all(-1)
        z, y, x = solid.values.shape
        index = (
            np.interp(at[..., 2] + solid.middle, solid.depths, np.arange(z)),
            at[..., 1] / solid.sides[0] + (y - 1) / 2,
            at[..., 0] / solid.sides[1] + (x - 1) / 2,
        )
        found = np.where(inside, map_coordinates(solid.values, index, order=1, mode="nearest"), -np.inf)
        depth = np.where(found > best, at[..., 2] + solid.middle, depth)
        best = np.maximum(best, found)
    return best, depth


def around(solid: Solid, turn: NDArray[np.float64], pixels: int = 96) -> Viewpoint:
    pixel = 2 * solid.radius / pixels
    return Viewpoint(turn, (-solid.radius + pixel / 2,) * 2, pixel, (pixels, pixels))


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_maximum_along_each_ray(seed: int) -> None:
    """Random turns, voxels that are no cubes, planes at uneven depths that run downwards in every other case."""
    rng = np.random.default_rng(seed)
    order = slice(None, None, -1 if seed % 2 else 1)
    solid = Solid.of(blobs((7, 24, 30), seed), UNEVEN[order], (1.3, 1.7))
    scene = around(solid, random_turn(rng))
    found = project_solid(solid, scene)
    wanted, _ = rays(solid, scene, 0.2)
    off = ~np.isfinite(wanted)
    assert np.mean(np.isfinite(found.values) == ~off) > 0.95, "they differ by half a pixel of the outline"
    both = np.isfinite(found.values) & ~off
    assert np.sqrt(np.mean((found.values - wanted)[both] ** 2)) < 0.011
    least, most = (f(np.where(off, 0, wanted), 3) for f in (minimum_filter, maximum_filter))
    inside = (found.values >= least - 0.06) & (found.values <= most + 0.01)
    assert inside[both & ~maximum_filter(off, 3)].all(), "nowhere further from the truth than from what is a pixel away"


@pytest.mark.parametrize("seed", range(2))
def test_points_are_where_they_belong_in_place_and_depth(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    depths = UNEVEN[::-1] if seed % 2 else UNEVEN
    for _ in range(6):
        turn, volume = random_turn(rng), np.zeros((7, 21, 26), np.float32)
        plane, row, column = (int(rng.integers(0, n)) for n in volume.shape)
        volume[plane, row, column] = 5.0
        solid = Solid.of(volume, depths, (1.3, 1.7))
        scene = around(solid, turn, 240)
        found = project_solid(solid, scene)
        peak = np.unravel_index(np.nanargmax(found.values), scene.shape)
        place = np.array([(column - 12.5) * 1.7, (row - 10) * 1.3, depths[plane] - solid.middle])
        right, down, _ = turn @ place
        assert math.hypot(*(scene.origin + scene.pixel * np.array(peak) - (down, right))) < 2.0
        assert found.depths[peak] == pytest.approx(depths[plane], abs=1.5)
        assert solid.voxel_at(place) == (plane, row, column)
        np.testing.assert_allclose(solid.place_of(plane, row, column), place)
        np.testing.assert_allclose(found.place_at(scene, *map(int, peak)), place, atol=2.5)


def test_from_the_front_and_the_sides_it_is_exact() -> None:
    """Along the axes of the array there is nothing to interpolate."""
    volume = np.random.default_rng(3).random((6, 8, 10)).astype(np.float32)
    solid = Solid.of(volume)
    x, y, z = np.eye(3)
    for turn, wanted in (
        ((x, y, z), volume.max(0)),
        ((x, z, -y), volume.max(1)),
        ((z, y, -x), volume.max(2).T),
        ((-x, y, -z), volume.max(0)[:, ::-1]),
    ):
        rows, columns = wanted.shape
        found = project_solid(
            solid, Viewpoint(np.array(turn), (-(rows - 1) / 2, -(columns - 1) / 2), 1.0, wanted.shape)
        )
        np.testing.assert_allclose(found.values, wanted, atol=2e-6)
    front = project_solid(solid, Viewpoint(np.eye(3), (-3.5, -4.5), 1.0, (8, 10)))
    np.testing.assert_allclose(front.depths, volume.argmax(0), atol=1e-6)


def test_planes_that_run_downwards_show_the_same() -> None:
    volume = blobs((7, 20, 22))
    up, down = Solid.of(volume, UNEVEN, (1.0, 1.0)), Solid.of(volume[::-1], UNEVEN[::-1], (1.0, 1.0))
    for one, other in zip(*(project_solid(solid, around(solid, BEGIN)) for solid in (up, down)), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_same_comes_out_each_time_with_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    solid = Solid.of(blobs((7, 40, 44)), UNEVEN, (1.0, 1.0))
    scene, found = around(solid, turned(BEGIN, 0.3, 0.2), 90), []
    for workers in ("1", "2", "3"):
        monkeypatch.setenv("LFCAL_WORKERS", workers)
        found.append(project_solid(solid, scene))
    for other in found[1:]:
        for a, b in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_the_quick_picture_is_of_the_same_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarser by half, at the same place and with the same peaks."""
    monkeypatch.setattr("lfcal_gui.models.solid.QUICK", 2e4)
    solid = Solid.of(blobs((7, 40, 44), sigma=3), UNEVEN, (1.0, 1.0))
    for turn in (BEGIN, turned(BEGIN, 1.2, 0.1), turned(BEGIN, 0, 1.2)):
        scene = around(solid, turn)
        sharp, quick = project_solid(solid, scene), project_solid(solid, scene, quick=True)
        both = np.isfinite(sharp.values) & np.isfinite(quick.values)
        assert both.sum() > 0.9 * np.isfinite(sharp.values).sum()
        assert np.corrcoef(sharp.values[both], quick.values[both])[0, 1] > 0.93
        assert np.nanmax(quick.values) == pytest.approx(np.nanmax(sharp.values), abs=0.15)


def dice(*shape: int) -> NDArray[np.float64]:
    return np.random.default_rng(0).random(shape)


HARD = {
    **{"dark": np.zeros((3, 8, 9)), "constant": np.full((3, 8, 9), 7.0), "negative": -np.ones((2, 4, 4))},
    **{"one plane": dice(1, 8, 9), "one row": dice(1, 1, 9), "one column of planes": dice(9, 1, 1)},
    **{"one voxel": np.ones((1, 1, 1)), "nearly beyond float32": 1e38 * dice(3, 8, 9)},
}


@pytest.mark.parametrize("name", HARD)
def test_hard_cases(name: str) -> None:
    volume = HARD[name]
    for turn in (np.eye(3), BEGIN, turned(np.eye(3), math.pi / 2, 0), turned(np.eye(3), 0, 1.5)):
        solid = Solid.of(volume, np.linspace(0, 9, len(volume)), (1.0, 1.0))
        found = project_solid(solid, around(solid, turn, 40))
        inside = np.isfinite(found.values)
        seen, depths = found.values[inside], found.depths[inside]
        assert seen.size and seen.min() >= solid.values.min() * (1 + 1e-6 * (volume.min() < 0)) - 1e-6
        assert seen.max() <= solid.values.max() + 1e-6 * abs(solid.values.max())
        if np.ptp(volume) == 0:
            np.testing.assert_allclose(seen, volume.flat[0], rtol=1e-6)
        assert ((depths >= solid.depths[0] - 6) & (depths <= solid.depths[-1] + 6)).all()


def test_what_is_no_number_is_dark_and_infinite_light_as_bright_as_the_brightest() -> None:
    volume = np.full((2, 4, 5), 3.0)
    volume[0, 0, 0], volume[1, 1, 1], volume[0, 2, 2], volume[0, 3, 3] = np.nan, 9.0, np.inf, -np.inf
    with np.errstate(all="raise"):
        solid = Solid.of(volume)
    assert solid.values[0, 0, 0] == 3 and solid.values[0, 2, 2] == 9 and solid.values[0, 3, 3] == 3
    assert not Solid.of(np.full((2, 3, 4), np.nan)).values.any()
    assert np.isnan(volume[0, 0, 0]), "what was given is left alone"


def test_a_volume_of_no_known_size_has_cubes_for_voxels_and_bad_ones_are_refused() -> None:
    solid = Solid.of(np.zeros((3, 4, 5)), [1.0, 2.0, 9.0])
    assert not solid.measured and solid.half.tolist() == [2.5, 2.0, 1.0]
    with pytest.raises(InputError, match="three axes"):
        Solid.of(np.zeros((3, 4)))
    for depths in ([1.0, 2.0], [1.0, np.nan, 2.0]):
        with pytest.raises(InputError, match="a depth for each plane"):
            Solid.of(np.zeros((3, 4, 4)), depths, (1.0, 1.0))
    with pytest.raises(InputError, match="sides above 0 µm, got 0 x 1 µm"):
        Solid.of(np.zeros((3, 4, 4)), [1.0, 2.0, 3.0], (0.0, 1.0))


def test_turning_moves_the_near_side_with_the_mouse_and_stays_a_rotation() -> None:
    near = np.array([0.0, 0.0, -1.0])
    right, down, _ = turned(np.eye(3), 0.1, 0) @ near
    assert right > 0 and down == 0
    right, down, _ = turned(np.eye(3), 0, 0.1) @ near
    assert right == 0 and down > 0
    turn = BEGIN
    for k in range(2000):
        turn = turned(turn, 0.01 * (k % 7), 0.013)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1)
