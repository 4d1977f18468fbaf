from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.camera import preset
from lfcal_gui.models.display import UNTINTED, DisplaySettings, tinted, to_uint8
from lfcal_gui.models.frame_view import MAX_PIXELS, frame_numbers, lattice_points, render_tile, visible_tile


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
    picture = render_tile(frame, tile, DisplaySettings(), (0, 4000))
    part = frame[tile.rows[0] : tile.rows[1], tile.columns[0] : tile.columns[1]]
    np.testing.assert_array_equal(picture, to_uint8(part, DisplaySettings(), (0, 4000)))
    far = visible_tile((400, 600), (0, 400), (0, 600), (100, 150))
    assert far.step == 4


def test_a_tinted_tile_takes_light_and_depth_of_the_same_pixels() -> None:
    frame = np.arange(70.0).reshape(7, 10)
    tint = np.where(frame % 3 == 0, np.nan, frame / 70)
    tile = visible_tile(frame.shape, (0, 7), (0, 10), (3, 5))
    assert tile.step == 2
    shown = render_tile(frame, tile, DisplaySettings(colour_map="gray"), (0, 70), tint)
    display = DisplaySettings(colour_map="gray")
    np.testing.assert_array_equal(shown, tinted(frame[:6:2, ::2], tint[:6:2, ::2], display, (0, 70)))
    grey = shown[np.isnan(tint[:6:2, ::2])]
    light = to_uint8(frame, display, (0, 70))[:6:2, ::2][np.isnan(tint[:6:2, ::2])]
    assert len(grey) and (grey == grey[:, :1]).all(), "unknown depths have no colour"
    np.testing.assert_allclose(grey[:, 0], light * (UNTINTED / 255), atol=1.5)


def test_every_pixel_is_counted() -> None:
    rng = np.random.default_rng(3)
    for frame in (rng.integers(0, 4096, (50, 60)).astype(np.uint16), rng.normal(size=(50, 60)).astype(np.float32)):
        numbers = frame_numbers(frame, 7)
        assert (numbers.low, numbers.high) == (frame.min(), frame.max()) and numbers.saturated == 7
        assert math.isclose(numbers.mean, float(frame.mean(dtype=float)))


def test_lattice_overlay() -> None:
    camera = preset("bench")
    points, types = lattice_points(camera, (100, 160), (90, 200))
    assert len(points) == len(types) > 50 and set(types) == {0, 1, 2}
    assert points[:, 0].min() >= 99 and points[:, 1].max() <= 201
    row, column = ((n - 1) / 2 for n in camera.sensor.shape)
    nearest = np.abs(points - [row, column]).sum(1).min()
    assert nearest < 1e-6, "a type-0 lenslet sits at the sensor's centre"
    empty, _ = lattice_points(preset("r29"), (0, 1e5), (0, 1e5))
    assert len(empty) == 0, "too many to draw"
