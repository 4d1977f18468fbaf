"""What a session of a target shows so far."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lfcal.acquire.live_coverage import LiveCoverage
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan
from lfcal.devices.simulated._targets import TargetPattern
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.targets import Target, TargetPlan, Wishes, plan_target
from tests.acquire.rigs import CAREFUL
from tests.targets.common import small


def small_target() -> TargetPlan:
    scan = ScanPlan.for_camera(small(160), virtual_depths=(4.0, 5.0), cutout=31)
    step = scan.camera.step_um(scan.depths_um[0])
    target = Target("square", (3, 3), (41 * step, 43 * step))
    return plan_target(scan, target, Wishes(most_frames=4, level="geometric"))


def watched(folder: Path, plan: TargetPlan, *faults: DeviceFault, light: float = 1.0) -> LiveCoverage:
    watching = LiveCoverage(plan)
    optics = TargetPattern(plan.scan, plan.target, np.full(9, light))
    rig = simulated_rig(plan.scan, optics=optics, faults=faults)
    record(folder, plan, rig, replace(CAREFUL, reference_every=4, on_suspect="flag"), observers=(watching,))
    return watching


def test_it_shows_in_the_end_what_the_plan_shows(tmp_path: Path) -> None:
    plan = small_target()
    watching = LiveCoverage(plan)
    assert watching.state().coverage == 0 and watching.state().total == 8
    state = watched(tmp_path / "s", plan).state()
    for z in range(2):
        np.testing.assert_array_equal(state.shown[z], plan.shown(z))
    assert state.done == state.total == 8 and not state.alarms
    assert np.isfinite(state.light).all() and len(state.lamp) == 3


def test_frames_of_earlier_runs_are_counted_once() -> None:
    plan = small_target()
    watching = LiveCoverage(plan)
    for _ in range(2):
        watching.know(1, 2)
    state = watching.state()
    assert state.done == 1 and state.shown.max() == 1 and state.shown[0].max() == 0
    assert state.shown[1].sum() == (replace(plan, offsets_px=((), (plan.offsets_px[1][2],))).shown(1) > 0).sum()


def test_references_of_an_earlier_run_are_compared_with_those_of_the_next(tmp_path: Path) -> None:
    before = watched(tmp_path / "s", small_target()).state().lamp
    watching = LiveCoverage(small_target())
    watching.remember(tmp_path / "s")
    np.testing.assert_allclose(watching.state().lamp, before)
    watching.remember(tmp_path / "nothing")
    assert len(watching.state().lamp) == len(before) == 3


def test_saturation_is_told(tmp_path: Path) -> None:
    state = watched(tmp_path / "s", small_target(), light=3.0).state()
    assert [alarm.kind for alarm in state.alarms] == ["saturated"]
    assert (state.saturated > 0).any()
