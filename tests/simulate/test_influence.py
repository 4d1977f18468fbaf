"""What an effect changes, by running it: both responses come from the same engine."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.simulate.accuracy._estimates import Influence
from lfcal.simulate.effects import ArrayTilt, Bandwidth, Effect, LensletSpherical
from tests.simulate.common import BASE, small_camera


def changed(name: str, depth: float, effect: Effect) -> float:
    camera = preset(name) if name != "small" else small_camera()
    depths = {"depths_um": [depth]} if name != "small" else {"virtual_depths": [depth]}
    plan = ScanPlan.for_camera(camera, cutout=41, **depths)
    found = Influence(replace(plan, period=(5, 5)), 0, BASE).of(effect)
    assert found is not None
    return found


@pytest.mark.long
def test_off_the_separable_path_a_small_effect_changes_little() -> None:
    """Engines differ by 0.1 to 1 %: an effect that calls for another one must not be taken for that."""
    one, hundred = (changed("lfm_20x05", 5.0, LensletSpherical(waves)) for waves in (1e-4, 1e-2))
    assert 0 < one < 1e-3
    assert one == pytest.approx(hundred / 100, rel=0.1)


def test_a_tilt_is_compared_with_an_array_computed_alike() -> None:
    assert changed("small", 3.0, ArrayTilt(1e-7)) < 0.002


def test_what_would_take_minutes_is_not_measured() -> None:
    """A spectrum of a microscope with cutouts of 1001 px took minutes, and gigabytes."""
    plan = ScanPlan.for_camera(preset("lfm_60x12"), cutout=131, depths_um=[-20.0])
    effect = Bandwidth(0.05)
    assert Influence(plan, 0, BASE).of(effect) is not None
    camera = replace(plan.camera, sensor=replace(plan.camera.sensor, shape=(1400, 1400)))
    large = ScanPlan.for_camera(camera, cutout=1301, depths_um=[-20.0])
    assert Influence(large, 0, BASE).of(Bandwidth(0.5)) is None, "its formula stays"
