from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gui.models.display import Display, bin_max, colour_table, levels_of, to_uint8
from gui.models.frame_view import MAX_PIXELS, frame_numbers, lattice_points, render_tile, visible_tile
from gui.pages.psf.model import LoadedPlane, PSFIntent, linked_pixel, resolve, turn_pixel
from lfcal.camera import preset
from lfcal.errors import InputError
from lfcal.psf import transpose

SHAPE = (3, 4, 5, 7, 9)


def plane() -> LoadedPlane:
    return LoadedPlane(1, np.random.default_rng(0).random(SHAPE[1:]).astype(np.float32))


@given(st.tuples(*(st.integers(0, n - 1) for n in SHAPE[1:])))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_linked_pixels_hold_the_same_entry(index: tuple[int, int, int, int]) -> None:
    y, x, t, s = index
    H = plane().values
    HT = transpose(H[None])[0]
    there, mark = linked_pixel((y, x), (t, s), SHAPE[1:3], SHAPE[3:])
    assert HT[there][mark] == H[index]
    assert linked_pixel(there, mark, SHAPE[1:3], SHAPE[3:]) == ((y, x), (t, s))
    wrong = (there[1] % 4, there[0] % 5)
    assert wrong == there or HT[wrong][mark] != H[index]


@pytest.mark.parametrize("transposed", [False, True])
def test_the_picture_follows_the_intent(transposed: bool) -> None:
    loaded = plane()
    H, HT = loaded.values, transpose(loaded.values[None])[0]
    main, other = (HT, H) if transposed else (H, HT)
    intent = PSFIntent(1, 2, 3, transposed)
    picture = resolve(intent, loaded)
    np.testing.assert_array_equal(picture.main, main[2, 3])
    np.testing.assert_array_equal(picture.linked, other[2, 3])
    assert picture.main_cursor is None and picture.linked_cursor is None
    picture = resolve(replace(intent, pixel=(1, 4)), loaded)
    assert picture.linked_cursor is not None
    assert picture.linked[picture.linked_cursor] == picture.main[1, 4]
    np.testing.assert_array_equal(picture.linked, other[picture.linked_position])


def test_differences_are_at_equal_energy() -> None:
    loaded = plane()
    twice = LoadedPlane(1, 2 * loaded.values)
    picture = resolve(PSFIntent(show="difference"), loaded, twice)
    assert picture.signed and np.abs(picture.main).max() < 1e-6
    np.testing.assert_array_equal(resolve(PSFIntent(show="reference"), loaded, twice).main, twice.values[0, 0])


def test_intents_stay_inside() -> None:
    intent = PSFIntent(99, -3, 77, pixel=(7, 0)).clamped(SHAPE)
    assert (intent.z, intent.y, intent.x, intent.pixel) == (2, 0, 4, None)
    assert PSFIntent(0, 0, 0).moved(-1, -1, (4, 5)).y == 3
    assert turn_pixel((0, 0), (7, 9)) == (6, 8)


@pytest.mark.parametrize("scale", ["linear", "log", "gamma"])
def test_scaling_is_monotonic_and_total(scale: str) -> None:
    values = np.array([[-np.inf, np.nan, 0, 1e-5, 0.01, 0.5, 1, np.inf]], np.float32)
    shown = to_uint8(values, Display(scale), (0.0, 1.0))[0]
    assert shown[1] == 0 and shown[0] == 0 and shown[-1] == 255 and shown[6] == 255
    assert (np.diff(shown[2:7].astype(int)) >= 0).all()
    assert levels_of(np.zeros((2, 2))) == (0.0, 1.0)
    assert levels_of(np.array([[np.nan]])) == (0.0, 1.0)
    assert levels_of(np.array([[-3.0, 1.0]]), signed=True) == (-3.0, 3.0)


def test_bad_displays() -> None:
    for options in ({"scale": "cube"}, {"colour_map": "jet"}):
        with pytest.raises(InputError):
            Display(**options)
    assert colour_table("viridis").shape == (256, 4)


@pytest.mark.parametrize("step", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("dtype", ["uint16", "float32", "uint8"])
def test_binning_keeps_every_point_source(step: int, dtype: str) -> None:
    image = (np.random.default_rng(1).random((29, 31)) * 200).astype(dtype)
    binned = bin_max(image, step)
    rows, columns = 29 // step, 31 // step
    blocks = image[: rows * step, : columns * step].reshape(rows, step, columns, step)
    np.testing.assert_array_equal(binned, blocks.max((1, 3)))
    assert bin_max(image, 100) is image


@given(
    st.tuples(st.integers(1, 5000), st.integers(1, 7000)),
    st.floats(-500, 5000),
    st.floats(0.1, 9000),
    st.floats(-500, 7000),
    st.floats(0.1, 9000),
    st.tuples(st.integers(0, 2000), st.integers(0, 3000)),
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_tiles_stay_on_the_frame_and_small(
    shape: tuple[int, int], top: float, height: float, left: float, width: float, screen: tuple[int, int]
) -> None:
    tile = visible_tile(shape, (top, top + height), (left, left + width), screen)
    assert 0 <= tile.rows[0] < tile.rows[1] <= shape[0]
    assert 0 <= tile.columns[0] < tile.columns[1] <= shape[1]
    assert tile.step >= 1
    rows, columns = ((b - a) // tile.step for a, b in (tile.rows, tile.columns))
    assert rows * columns <= max(MAX_PIXELS, 1)


def test_a_visible_tile_shows_what_is_asked_for() -> None:
    frame = np.random.default_rng(2).integers(0, 4000, (400, 600)).astype(np.uint16)
    tile = visible_tile((400, 600), (100, 150), (200, 280), (500, 800))
    assert tile.step == 1 and tile.rows[0] <= 100 and tile.rows[1] >= 150
    picture = render_tile(frame, tile, Display(), (0, 4000))
    part = frame[tile.rows[0] : tile.rows[1], tile.columns[0] : tile.columns[1]]
    np.testing.assert_array_equal(picture, to_uint8(part, Display(), (0, 4000)))
    far = visible_tile((400, 600), (0, 400), (0, 600), (100, 150))
    assert far.step == 4


def test_every_pixel_is_counted() -> None:
    rng = np.random.default_rng(3)
    for frame in (rng.integers(0, 4096, (50, 60)).astype(np.uint16), rng.normal(size=(50, 60)).astype(np.float32)):
        numbers = frame_numbers(frame, 4000)
        assert numbers.counts.sum() == frame.size
        assert numbers.high == frame.max() and numbers.saturated == (frame >= 4000).sum()
        assert math.isclose(numbers.mean, float(frame.mean(dtype=float)))


def test_lattice_overlay() -> None:
    camera = preset("bench")
    points, types = lattice_points(camera, (100, 160), (90, 200))
    assert len(points) == len(types) > 50 and set(types) == {0, 1, 2}
    assert points[:, 0].min() >= 99 and points[:, 1].max() <= 201
    row, column = ((n - 1) / 2 for n in camera.sensor.shape)
    nearest = np.abs(points - [row, column]).sum(1).min()
    assert nearest < 1e-6, "a type-0 lenslet sits at the sensor's centre"
    empty, _ = lattice_points(preset("bench"), (0, 1e5), (0, 1e5))
    assert len(empty) == 0, "too many to draw"
