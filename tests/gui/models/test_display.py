"""Values as grey levels and colours, the visible part of a frame, and what is measured in pictures, by closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import colormaps

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal_gui.models.display import (
    COLOUR_MAPS,
    DIVERGING,
    UNTINTED,
    DisplaySettings,
    bin_max,
    colour_table,
    levels_of,
    tinted,
    to_uint8,
)
from lfcal_gui.models.frame_view import MAX_PIXELS, frame_numbers, lattice_points, render_tile, visible_tile
from lfcal_gui.models.measure import MOST, fwhm, line_profile, region_numbers, value_histogram

SCALES = ("linear", "log", "gamma")


def test_scaling_is_monotonic_and_total() -> None:
    values = np.array([[-np.inf, np.nan, 0, 1e-5, 0.01, 0.5, 1, np.inf]], np.float32)
    for scale in SCALES:
        shown = to_uint8(values, DisplaySettings(scale), (0.0, 1.0))[0]
        assert (shown[[0, 1, 6, 7]] == [0, 0, 255, 255]).all() and (np.diff(shown[2:7].astype(int)) >= 0).all(), scale
    assert levels_of(np.zeros((2, 2))) == levels_of(np.array([[np.nan]])) == (0.0, 1.0)
    assert levels_of(np.array([[-3.0, 1.0]]), signed=True) == (-3.0, 3.0)
    for options in ({"scale": "cube"}, {"colour_map": "jet"}):
        with pytest.raises(InputError):
            DisplaySettings(**options)


def test_colours_are_those_of_matplotlib() -> None:
    pytest.importorskip("matplotlib", "3.10", reason="the diverging colours are not in older versions")
    for name in (*COLOUR_MAPS, DIVERGING):
        wanted = colormaps[name](np.arange(256), bytes=True)
        np.testing.assert_array_equal(colour_table(name), wanted, err_msg=name)


@pytest.mark.parametrize("dtype", ["uint16", "float32", "uint8"])
def test_binning_keeps_every_point_source(dtype: str) -> None:
    image = (np.random.default_rng(1).random((29, 31)) * 200).astype(dtype)
    for step in (1, 2, 3, 4, 7):
        rows, columns = 29 // step, 31 // step
        blocks = image[: rows * step, : columns * step].reshape(rows, step, columns, step)
        np.testing.assert_array_equal(bin_max(image, step), blocks.max((1, 3)), err_msg=str(step))
    assert bin_max(image, 100) is image


def test_zero_light_is_dark_whatever_noise_takes_below_it() -> None:
    values = np.array([[-20.0, 0.0, 1.0, 100.0, 10_000.0]])
    assert to_uint8(values, DisplaySettings("log"), (-20.0, 10_000.0)).tolist() == [[0, 0, 0, 128, 255]]
    assert to_uint8(values, DisplaySettings("gamma"), (-20.0, 10_000.0))[0, :2].tolist() == [0, 0]
    offset = np.array([[100.0, 1000.0, 10_000.0]])
    assert to_uint8(offset, DisplaySettings("log"), (100.0, 10_000.0)).tolist() == [[0, 128, 255]]
    for scale in ("log", "gamma"):  # no light at all
        assert to_uint8(-values, DisplaySettings(scale), (-10_000.0, 0.0)).tolist()[0][0] == 255
        assert to_uint8(np.full((1, 2), 3.0), DisplaySettings(scale), (3.0, 3.0)).shape == (1, 2)


def extreme_pictures() -> dict[str, np.ndarray]:
    """Return images that crash or mislead other viewers (pyqtgraph#1162, Dioptas#98)."""
    rng = np.random.default_rng(0)
    one = np.eye(8) > 0
    return {
        "constant": np.full((20, 30), 7, np.uint16),
        "NaN": np.full((5, 5), np.nan, np.float32),
        "infinity": np.where(one, np.inf, 1.0).astype(np.float32),
        "negative": np.full((9, 9), -5, np.int16) + rng.integers(0, 3, (9, 9), np.int16),
        "two extremes": np.where(one, 1e12, 0.0),
        "float32 range": np.where(one, 3.4e38, -3.4e38).astype(np.float32),
        "one pixel": np.ones((1, 1), np.float32),
        "row": np.arange(50.0)[None],
        "int32": rng.integers(-5, 10**9, (9, 9)).astype(np.int32),
        "uint64": np.full((4, 4), 2**63, np.uint64),
        "next numbers": np.where(one, 2.0**60, 2.0**60 + 256),
        "tiny": rng.random((9, 9)).astype(np.float32) * 1e-38,
        "truth": one,
    }


@pytest.mark.parametrize("name", extreme_pictures())
def test_extreme_pictures_are_shown(name: str) -> None:
    image = extreme_pictures()[name]
    low, high = levels = levels_of(image)
    assert low < high and np.isfinite(levels).all()
    for scale in SCALES:
        assert to_uint8(image, DisplaySettings(scale), levels).shape == image.shape, scale
    middles, counts = value_histogram(image)
    finite = np.asarray(image, np.float64)[np.isfinite(image)]
    assert counts.sum() == len(finite) and np.isfinite(middles).all() and (np.diff(middles) >= 0).all()
    assert not len(finite) or (middles[0] >= finite.min() and middles[-1] >= middles[0])
    region_numbers(image, (0, image.shape[0]), (0, image.shape[1]))


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


def test_every_pixel_is_counted_unless_it_is_no_number() -> None:
    rng = np.random.default_rng(3)
    for frame in (rng.integers(0, 4096, (50, 60)).astype(np.uint16), rng.normal(size=(50, 60)).astype(np.float32)):
        numbers = frame_numbers(frame, 7)
        assert (numbers.low, numbers.high) == (frame.min(), frame.max()) and numbers.saturated == 7
        assert math.isclose(numbers.mean, float(frame.mean(dtype=float)))
    image = np.array([[0.0, 1.0, 1.0], [np.nan, 4.0, np.inf]])
    middles, counts = value_histogram(image, 4)
    assert counts.tolist() == [1, 2, 0, 1] and middles[0] == 0.5
    assert len(value_histogram(np.full((2, 2), np.nan))[0]) == 0
    assert 1 << 16 < value_histogram(np.zeros((3000, 2000), np.uint16))[1].sum() <= MOST, "quick for a large frame"


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


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 200.0])
def test_the_width_of_a_round_spot_is_the_same_along_every_line(angle: float) -> None:
    r, c = np.mgrid[:61, :61]
    sigma, centre = 4.0, (30.0, 30.0)
    image = 50 + 1000 * np.exp(-((r - centre[0]) ** 2 + (c - centre[1]) ** 2) / (2 * sigma**2))
    along = 25 * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
    found = line_profile(image, tuple(centre - along), tuple(centre + along))
    assert found.distance[-1] == pytest.approx(50)
    assert found.fwhm == pytest.approx(2 * math.sqrt(2 * math.log(2)) * sigma, rel=0.02)
    assert found.fwhm is not None and f"FWHM {found.fwhm:.2f} px" in found.words()


def test_line_profiles_are_linear_and_have_the_width_of_a_peak() -> None:
    image = np.add.outer(10.0 * np.arange(5), np.arange(6))
    found = line_profile(image, (1.5, 0.0), (1.5, 8.0))
    np.testing.assert_allclose(found.values[:6], 15 + np.arange(6))
    assert np.isnan(found.values[6:]).all() and found.fwhm is None
    assert "no peak" in found.words()
    x = np.arange(5.0)
    assert fwhm(x, x) is None and fwhm(x, np.ones(5)) is None and fwhm(x[:2], x[:2]) is None
    assert fwhm(x, np.array([0.0, 0, 1, 0, 0])) == pytest.approx(1.0)


def test_a_region_has_the_numbers_of_its_pixels() -> None:
    image = np.random.default_rng(1).random((20, 30)) * 1000
    part = image[4:9, 10:16]
    found = region_numbers(image, (3.2, 8.4), (9.5, 15.0))
    assert (found.rows, found.columns) == ((4, 9), (10, 16))
    assert (found.mean, found.deviation) == (pytest.approx(part.mean()), pytest.approx(part.std()))
    assert (found.low, found.high, found.total) == (part.min(), part.max(), pytest.approx(part.sum()))
    size, statistics = found.words("light (counts)").splitlines()[:2]
    assert size == "6 × 5 px, rows 4 to 8, columns 10 to 15", "width × height, as of a frame"
    assert statistics.startswith(f"light (counts): mean {part.mean():.5g}, ")
    assert region_numbers(image, (-5, -1), (0, 5)) is None and region_numbers(image, (3.1, 3.9), (0, 5)) is None


def test_the_centroid_is_where_the_light_is() -> None:
    image = np.full((9, 9), 7.0)
    image[2, 5], image[3, 5] = 8.0, 10.0
    found = region_numbers(image, (0, 8), (0, 8))
    assert found.centre == (pytest.approx(2.75), pytest.approx(5.0))
    flat = region_numbers(np.ones((3, 3)), (0, 2), (0, 2))
    assert flat.centre is None and "centroid" not in flat.words("light")
