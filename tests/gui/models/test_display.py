from __future__ import annotations

import numpy as np
import pytest
from matplotlib import colormaps

from lfcal.base.errors import InputError
from lfcal_gui.models.display import COLOUR_MAPS, DIVERGING, DisplaySettings, bin_max, colour_table, levels_of, to_uint8
from lfcal_gui.models.measure import region_numbers, value_histogram


@pytest.mark.parametrize("scale", ["linear", "log", "gamma"])
def test_scaling_is_monotonic_and_total(scale: str) -> None:
    values = np.array([[-np.inf, np.nan, 0, 1e-5, 0.01, 0.5, 1, np.inf]], np.float32)
    shown = to_uint8(values, DisplaySettings(scale), (0.0, 1.0))[0]
    assert shown[1] == 0 and shown[0] == 0 and shown[-1] == 255 and shown[6] == 255
    assert (np.diff(shown[2:7].astype(int)) >= 0).all()
    assert levels_of(np.zeros((2, 2))) == (0.0, 1.0)
    assert levels_of(np.array([[np.nan]])) == (0.0, 1.0)
    assert levels_of(np.array([[-3.0, 1.0]]), signed=True) == (-3.0, 3.0)


def test_bad_displays() -> None:
    for options in ({"scale": "cube"}, {"colour_map": "jet"}):
        with pytest.raises(InputError):
            DisplaySettings(**options)
    assert colour_table("viridis").shape == (256, 4)


@pytest.mark.parametrize("name", [*COLOUR_MAPS, DIVERGING])
def test_colours_are_those_of_matplotlib(name: str) -> None:
    np.testing.assert_array_equal(colour_table(name), colormaps[name](np.arange(256), bytes=True))


@pytest.mark.parametrize("step", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("dtype", ["uint16", "float32", "uint8"])
def test_binning_keeps_every_point_source(step: int, dtype: str) -> None:
    image = (np.random.default_rng(1).random((29, 31)) * 200).astype(dtype)
    binned = bin_max(image, step)
    rows, columns = 29 // step, 31 // step
    blocks = image[: rows * step, : columns * step].reshape(rows, step, columns, step)
    np.testing.assert_array_equal(binned, blocks.max((1, 3)))
    assert bin_max(image, 100) is image


def test_zero_light_is_dark_whatever_noise_takes_below_it() -> None:
    """Log is of the value, not of its distance to the lowest one: that drew zero counts in the middle of the scale."""
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


@pytest.mark.parametrize("scale", ["linear", "log", "gamma"])
@pytest.mark.parametrize("name", extreme_pictures())
def test_extreme_pictures_are_shown(name: str, scale: str) -> None:
    image = extreme_pictures()[name]
    low, high = levels = levels_of(image)
    assert low < high and np.isfinite(levels).all()
    assert to_uint8(image, DisplaySettings(scale), levels).shape == image.shape
    middles, counts = value_histogram(image)
    finite = np.asarray(image, np.float64)[np.isfinite(image)]
    assert counts.sum() == len(finite) and np.isfinite(middles).all() and (np.diff(middles) >= 0).all()
    assert not len(finite) or (middles[0] >= finite.min() and middles[-1] >= middles[0])
    region_numbers(image, (0, image.shape[0]), (0, image.shape[1]))
