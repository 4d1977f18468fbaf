"""What depends on assumed values, compared with whole simulations of cameras that differ."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import drain
from lfcal.camera import Camera, Forecast, MainLens, Marks, ScanPlan, cutout_for, preset, quantities_of
from lfcal.simulate import iter_assumed_effects, simulate_psf
from lfcal.simulate.effects import IrisShape, LensTypeDefocus


def assumed(camera: Camera, *paths: str) -> Camera:
    return replace(camera, marks=Marks.of(dict.fromkeys(paths, "assumed")))


def test_the_effect_of_an_f_number_is_the_difference_of_simulations() -> None:
    camera = assumed(preset("bench"), "optics.f_number", "sensor.prnu")
    plan = ScanPlan.for_camera(camera, virtual_depths=(4.0,), cutout=55)
    found = drain(iter_assumed_effects(plan))
    assert [one.path for one in found] == ["optics.f_number", "sensor.prnu"]
    assert found[1].largest == 0 and found[1].words == "no change"
    assert isinstance(camera.optics, MainLens)
    Hs = []
    for share in (1.0, 0.88, 1.12):
        other = replace(camera, optics=replace(camera.optics, f_number=camera.optics.f_number * share))
        Hs.append(np.asarray(simulate_psf(replace(plan, camera=other), (LensTypeDefocus(), IrisShape()), "geometric")))
    off = max(np.abs(H - Hs[0]).sum() / Hs[0].sum() for H in Hs[1:])
    assert found[0].pattern == pytest.approx(off, rel=0.1)
    assert found[0].words == f"H by up to {100 * found[0].pattern:.0f} %"
    sides = [cutout_for(replace(camera, optics=replace(camera.optics, f_number=n)), plan.depths_um) for n in (3.52, 4)]
    assert found[0].cutout == pytest.approx(sides[0] / sides[1] - 1)


def test_a_pixel_pitch_changes_the_time() -> None:
    camera = assumed(preset("lfm_20x05"), "sensor.pixel_um")
    plan = ScanPlan.for_camera(camera, depths_um=(-10.0, 10.0), cutout=55)
    (found,) = drain(iter_assumed_effects(plan))
    hours = Forecast.of(plan).hours
    other = replace(camera, sensor=replace(camera.sensor, pixel_um=camera.sensor.pixel_um * 0.9))
    changed = Forecast.of(ScanPlan.for_camera(other, depths_um=(-10.0, 10.0), cutout=55)).hours
    assert found.seconds == pytest.approx(changed / hours - 1) and found.seconds > 0.1


def test_a_value_that_may_make_the_scan_impossible_comes_first() -> None:
    camera = preset("bench")
    camera = replace(camera, lattice=replace(camera.lattice, rotation_rad=math.radians(1.9)))
    camera = assumed(camera, "optics.f_number", "lattice.rotation_rad")
    first, second = drain(iter_assumed_effects(ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0))))
    assert (first.path, second.path) == ("lattice.rotation_rad", "optics.f_number")
    assert first.words == "the scan may not be possible"


@pytest.mark.parametrize("name", ["bench", "lfm_20x05"])
def test_the_effect_of_every_value_of_a_camera_is_estimated(name: str) -> None:
    camera = preset(name)
    paths = [one.path for one in quantities_of(camera)]
    plan = ScanPlan.for_camera(
        assumed(camera, *paths), depths_um=(camera.depth_of(3.0),) if name == "bench" else (5.0,)
    )
    found = {one.path: one for one in drain(iter_assumed_effects(plan))}
    assert set(found) == set(paths) and all(one.largest >= 0 for one in found.values())
    assert found["lattice.kind"].largest > 1, "another array is another H"
    assert found["sensor.read_noise_e"].largest == 0 and found["lattice.gap_um"].pattern > 0.1
