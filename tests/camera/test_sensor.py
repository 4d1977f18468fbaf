from __future__ import annotations

import json
from dataclasses import replace

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan, Sensor, preset


def test_what_was_measured_is_kept_with_the_camera() -> None:
    camera = preset("bench")
    sensor = replace(camera.sensor, saturation=3900.0, dsnu_e=2.5, linearity=0.004)
    known = replace(camera, sensor=sensor)
    assert Camera.from_json(known.to_json()) == known
    assert (sensor.saturated_from, camera.sensor.saturated_from) == (3900.0, 4095.0)


def test_descriptions_of_version_1_open_without_it() -> None:
    data = json.loads(preset("bench").to_json())
    for name in ("saturation", "dsnu_e", "linearity"):
        del data["sensor"][name]
    del data["marks"]
    camera = Camera.from_dict(data | {"version": 1})
    assert camera == preset("bench") and camera.sensor.saturation is None and camera.sensor.dsnu_e is None


@pytest.mark.parametrize(
    "values", [{"saturation": 4096.0}, {"saturation": 60.0, "black_level": 64.0}, {"dsnu_e": -1.0}, {"linearity": -0.1}]
)
def test_values_that_cannot_be_are_refused(values: dict[str, float]) -> None:
    with pytest.raises(InputError):
        Sensor(**values)


@pytest.mark.hard_case
@pytest.mark.parametrize("huge", [1e300, -1e300, 10**400, float("inf")])
def test_numbers_that_overflow_are_refused(huge: float) -> None:
    """Of a damaged description: a read noise of 1e300 electrons was an infinite sample value."""
    for change in ("read_noise_e", "full_well_e", "dark_current_e_s", "dsnu_e", "linearity"):
        with pytest.raises(InputError, match="expected a number"):
            Sensor((4, 6), 5.5, **{change: huge})
    with pytest.raises(InputError, match="anchor"):
        ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], anchor=(huge, 10.0))
