"""The level of no light: numbers, patterns as RAW files state them, maps; and what counts where several are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Sensor
from lfcal.multiplex import pixel_weights, without_black_level
from lfcal.multiplex._sensor_noise import black_level_map
from lfcal.multiplex.recorded import RecordedFrame


def test_levels_of_a_pattern_lie_at_their_places() -> None:
    frame = np.arange(35, dtype=np.uint16).reshape(5, 7) + 100
    light = without_black_level(frame, (1.0, 2.0, 3.0, 4.0))
    assert light.dtype == np.float32
    for y, x in np.ndindex(frame.shape):
        assert light[y, x] == frame[y, x] - (1, 2, 3, 4)[y % 2 * 2 + x % 2]
    np.testing.assert_array_equal(without_black_level(frame, 7), frame - 7.0)
    np.testing.assert_array_equal(without_black_level(frame, (7,)), frame - 7.0)
    assert black_level_map((7,), frame.shape).shape == black_level_map(7, frame.shape).shape == ()
    assert without_black_level(frame.astype(float), frame / 2).dtype == np.float64
    np.testing.assert_array_equal(without_black_level(frame, frame / 2), frame / 2)
    for bad in ((), (1, 2), (1, 2, 3), np.nan, np.ones((4, 7))):
        with pytest.raises(InputError, match="black level"):
            without_black_level(frame, bad)
    with pytest.raises(InputError, match="frame"):
        without_black_level(np.zeros((3, 4, 5)), 1)


def test_the_given_level_counts_then_the_files_then_the_sensors() -> None:
    sensor, raw = Sensor(black_level=64.0), np.zeros((2, 2), np.uint16)
    stated, silent = (RecordedFrame(Path("a.tif"), raw, "", level) for level in ((10.0, 20.0, 20.0, 10.0), None))
    assert stated.level(0.0, sensor) == 0.0, "0 is a level"
    assert stated.level(None, sensor) == (10.0, 20.0, 20.0, 10.0)
    assert silent.level(None, sensor) == 64.0 and silent.level() == 0.0


def test_weights_take_shot_noise_from_the_level_that_the_file_states() -> None:
    sensor = Sensor(bit_depth=12, full_well_e=4095.0, read_noise_e=3.0, black_level=0.0)
    frame = np.array([[110.0, 220.0], [120.0, 210.0]])
    level = (100.0, 200.0, 100.0, 200.0)
    weights = pixel_weights(frame, sensor, black_level=level)
    np.testing.assert_allclose(1 / weights, 9 + 1 / 12 + np.array([[10.0, 20.0], [20.0, 10.0]]), rtol=1e-9)
    assert (pixel_weights(frame, sensor) < weights).all(), "without it the level is taken for light"
