"""What is told of a measurement is what a camera takes over, and what it has otherwise is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.camera import Camera, Sensor, preset
from lfcal.frames.photon_transfer.result import SensorMeasurement, figures_of, sensor_differences

from .sensor_model import vignetting
from .test_measurement import LEVELS, PLAIN, SHAPE, measured

BENCH: Camera = preset("bench")


@pytest.fixture(scope="module")
def dim() -> SensorMeasurement:
    """Return a measurement whose brightest flat is half full."""
    return measured(PLAIN.flats(LEVELS[:4], 2, vignetting(SHAPE)), PLAIN.darks(4))


@pytest.fixture(scope="module")
def clipped() -> SensorMeasurement:
    truth = PLAIN.but(well_e=12_000.0)
    return measured(truth.flats([0.1, 0.3, 0.5, 0.7, 0.9, 1.05, 1.3, 1.6]), truth.darks(4))


def rows(found: SensorMeasurement, known: Sensor | None = None) -> dict[str, str]:
    return dict(figures_of(found, known))


def test_a_full_well_that_no_flat_reached_is_said_with_what_it_is_above(dim: SensorMeasurement) -> None:
    told = rows(dim)
    assert dim.full_well_e is None and dim.electrons_per_count is not None
    assert told["full well"].startswith("above ") and told["full well"].endswith(" e⁻ (not reached)")
    above = float(told["full well"].split()[1].replace(",", ""))
    counts = float(told["saturated from"].split()[1].replace(",", ""))
    assert above == pytest.approx((counts - 64) * dim.electrons_per_count.value, rel=0.01) and 5_000 < above < 10_000
    assert any("not reached" in note for note in dim.notes)
    assert "  for the camera" not in told


def test_the_full_well_told_for_the_camera_is_the_one_it_takes(
    dim: SensorMeasurement, clipped: SensorMeasurement
) -> None:
    """Also where pixels are full far below the highest sample value: both figures are told, by their names."""
    for found in (dim, clipped):
        taken, _ = found.sensor(BENCH.sensor)
        told = rows(found, BENCH.sensor)["  for the camera"]
        assert told.startswith(f"{taken.full_well_e:.0f} ± ") and told.endswith("e⁻ at its highest count, 4095")
    assert clipped.full_well_e is not None
    assert rows(clipped, BENCH.sensor)["full well"] == f"{clipped.full_well_e} e⁻"


def test_nothing_is_told_for_the_camera_where_nothing_is_taken(dim: SensorMeasurement) -> None:
    doubtful = replace(dim, doubts=("smoothed",))
    assert "  for the camera" not in rows(doubtful, BENCH.sensor)
    blind = rows(replace(dim, gain=None), BENCH.sensor)
    assert blind["full well"] == blind["saturated from"] == "unknown" and "  for the camera" not in blind


def test_a_stated_saturation_stays_unless_the_frames_contradict_it(
    dim: SensorMeasurement, clipped: SensorMeasurement
) -> None:
    known = replace(BENCH.sensor, bit_depth=12, saturation=3900.0)
    assert dim.sensor(known)[0].saturation == 3900.0
    assert dim.sensor(replace(known, saturation=dim.brightest - 1))[0].saturation is None
    assert dim.sensor(replace(known, bit_depth=10, saturation=900.0))[0].saturation is None
    assert clipped.saturation is not None and clipped.sensor(known)[0].saturation == clipped.saturation.value


def test_frames_of_another_size_or_gain_are_said(dim: SensorMeasurement) -> None:
    own = replace(BENCH.sensor, shape=SHAPE, black_level=64.0, full_well_e=4031 * 5.0)
    assert sensor_differences(dim, own) == []
    assert dim.shape == SHAPE
    (size,) = sensor_differences(dim, replace(own, shape=(320, 320)))
    assert "120 × 160" in size and "320 × 320" in size
    (gain,) = sensor_differences(dim, replace(own, full_well_e=4031 * 20.0))
    assert "times as many electrons per count" in gain and "averaged" in gain


def test_each_channel_has_its_gain() -> None:
    mosaic = PLAIN.but(white_balance=(1.0, 1.5, 1.5, 2.0))
    found = measured(mosaic.flats(LEVELS[:4], 2, vignetting(SHAPE)), mosaic.darks(4), "RGGB")
    told = rows(found)
    for name, factor in (("R", 1.0), ("B", 2.0)):
        assert float(told[f"  {name}"].split()[0]) == pytest.approx(0.2 * factor, rel=0.1)
        assert told[f"  {name}"].endswith("counts per e⁻")
