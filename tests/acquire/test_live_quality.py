"""Alarms while a session is recorded: early where something is wrong, and none in a good session."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.live_quality import LiveQuality, QualityState
from lfcal.acquire.schedule import window_shape
from lfcal.acquire.session import record
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, StageAxes
from lfcal.devices.protocols import Point
from lfcal.devices.simulated._stage import StageModel
from lfcal.frames.source import Position
from tests.acquire.rigs import CAREFUL, deceived_rig, intercept, rig_for, small_plan

PLAN = small_plan((11, 19), 2, cutout=(31, 31))


def watched(folder: Path, plan: ScanPlan, rig: Any, count: int = 10**6, **options: Any) -> QualityState:
    quality = LiveQuality(plan, window_shape(plan, CAREFUL))
    control = Control()

    def enough(*_: Any) -> None:
        if quality.state().done >= count:
            control.stop()

    record(folder, plan, rig, replace(CAREFUL, **options), control=control, observers=(quality, enough))
    return quality.state()


def named(state: QualityState) -> set[str]:
    return {alarm.kind for alarm in state.alarms}


def test_a_good_session_raises_no_alarm_and_its_depth_sum_is_that_of_h(tmp_path: Path) -> None:
    state = watched(tmp_path, PLAN, rig_for(PLAN), reference_every=50)
    assert state.alarms == ()
    assert state.done == PLAN.n_positions
    assert np.isfinite(state.energy).all()
    assert np.abs(state.follow_px).max() < 0.1
    assert state.lamp.shape[1] == 2
    assert np.ptp(state.lamp[:, 1]) / state.lamp[0, 1] < 0.02
    matrix = drain(iter_assemble_session(tmp_path)).matrix
    for z in range(2):
        want = matrix.depth_sum(z)
        assert np.abs(state.depth_sums[z] - want).max() < 0.02 * want.max()


def test_the_lamp_is_followed_over_several_recordings(tmp_path: Path) -> None:
    """Each recording counts its seconds from 0; the course of the lamp is one."""
    plan = small_plan()
    quality, options = LiveQuality(plan, window_shape(plan, CAREFUL)), replace(CAREFUL, reference_every=2)
    spent: list[float] = []
    for k in range(3):
        again = [Position(0, y, x) for y in range(3) for x in range(3)] if k else None
        outcome = record(tmp_path, plan, rig_for(plan), options if not k else None, redo=again, observers=(quality,))
        spent.append(outcome.seconds)
    lamp = quality.state().lamp
    assert len(lamp) > 12 and (np.diff(lamp[:, 0]) > 0).all()
    assert lamp[-1, 0] == pytest.approx(sum(spent), rel=0.2)


def test_a_wrong_sign_raises_an_alarm_within_three_rows(tmp_path: Path) -> None:
    state = watched(tmp_path, PLAN, rig_for(PLAN, axes=StageAxes("+y", "+x")), count=60)
    assert "follow" in named(state) and abs(state.follow_px[0, 1]) > 0.5


def dimming(rig: Any, light: Callable[[int], float]) -> None:
    """Let the lamp of a rig have so much light at each frame."""
    renderer, frames = rig.camera._renderer, itertools.count(1)

    def render(*args: Any) -> Any:
        patch = renderer.render(*args)
        return patch._replace(counts=patch.counts * np.float32(light(next(frames))))

    rig.camera.device._renderer = SimpleNamespace(render=render)


def fading(frame: int) -> float:
    """Return light that falls by 30 % over the session."""
    return 1 - 0.3 * frame / PLAN.n_positions


def test_a_lamp_that_fails_raises_an_alarm(tmp_path: Path) -> None:
    rig = rig_for(PLAN)
    dimming(rig, lambda frame: 1 - frame / 400)
    assert "lamp" in named(watched(tmp_path, PLAN, rig, count=200, reference_every=25))


@pytest.mark.parametrize("gain", [1.0, 1.14])
def test_a_lamp_that_changed_before_a_session_was_resumed_is_found(tmp_path: Path, gain: float) -> None:
    """References of the second run were compared only with each other, so that a jump between the runs was missed."""
    watched(tmp_path, PLAN, rig_for(PLAN), count=60, reference_every=25)
    rig = rig_for(PLAN)
    rig.camera._renderer._rate *= gain  # type: ignore[attr-defined]
    quality = LiveQuality(PLAN, window_shape(PLAN, CAREFUL))
    quality.remember(tmp_path)
    before = quality.state().lamp
    record(tmp_path, PLAN, rig, None, resume=True, observers=(quality,))
    state = quality.state()
    assert len(before) == 3 < len(state.lamp) and (np.diff(state.lamp[:, 0]) > 0).all()
    found = [one.size for one in state.alarms if one.kind == "lamp"]
    assert found == ([] if gain == 1 else [pytest.approx(0.14, abs=0.01)])
    assert {one.kind for one in state.alarms} <= {"lamp"}


def test_saturation_and_a_sloppy_stage_raise_alarms(tmp_path: Path) -> None:
    rig = rig_for(PLAN)
    rig.camera._renderer._rate *= 4
    state = watched(tmp_path / "bright", PLAN, rig, count=40)
    alarm = next(a for a in state.alarms if a.kind == "saturated")
    assert alarm.size == (state.saturated > 0).sum() and "bracket" in alarm.remedy
    rig = rig_for(PLAN, model=StageModel(ringing_um=12.0, ringing_s=0.2))
    state = watched(tmp_path / "sloppy", PLAN, rig, count=40, tolerance_um=(40.0, 40.0, 40.0))
    assert "position" in named(state)


@pytest.mark.parametrize("reference_every", [0, 25])
def test_a_lamp_that_fades_slowly_is_found_with_and_without_references(tmp_path: Path, reference_every: int) -> None:
    rig = rig_for(PLAN)
    dimming(rig, fading)
    state = watched(tmp_path, PLAN, rig, reference_every=reference_every)
    lamp = next(alarm for alarm in state.alarms if alarm.kind == "lamp")
    # without references: the loss over one of the two planes
    assert lamp.size == pytest.approx(0.3 if reference_every else 0.17, abs=0.03)


def test_a_steady_lamp_without_references_raises_no_alarm(tmp_path: Path) -> None:
    for order in ("serpentine", "raster"):
        plan = replace(PLAN, order=order)
        assert watched(tmp_path / order, plan, rig_for(plan)).alarms == ()


def test_a_dark_level_that_creeps_raises_an_alarm(tmp_path: Path) -> None:
    """Sixty counts over the session: no frame differs from the one before, so the guard has nothing to report."""
    rig, frames = rig_for(PLAN), itertools.count(1)

    def warmer(works: Any, timeout_s: float) -> Any:
        frame = works(timeout_s)
        frame.data[...] += np.uint16(60 * next(frames) / PLAN.n_positions)
        return frame

    intercept(rig, "camera", "grab", warmer)
    assert named(watched(tmp_path, PLAN, rig, reference_every=50)) == {"dark"}


STEP = PLAN.step_um(0)[0]


def drifting(pixels: float) -> Any:
    """Return a stage that creeps away to the right over the session, which has about a move for each frame."""
    return lambda move, target: (target[0] + pixels * STEP * move / PLAN.n_positions, target[1], target[2])


@pytest.mark.parametrize("pixels", [2.0, -1.0])
def test_a_stage_that_drifts_is_not_taken_for_a_lamp(tmp_path: Path, pixels: float) -> None:
    """Two pixels move the light under another part of the lenslets, its amount changes, and the lamp was blamed."""
    rig = deceived_rig(PLAN, drifting(pixels))
    state = watched(tmp_path, PLAN, rig, reference_every=25)
    moves = rig.stage.device._moves
    assert named(state) == {"drift"}
    assert state.alarms[0].size == pytest.approx(abs(pixels) * moves / PLAN.n_positions, rel=0.2)


def test_a_stage_and_a_lamp_that_drift_raise_two_alarms(tmp_path: Path) -> None:
    rig = deceived_rig(PLAN, drifting(1.0))
    dimming(rig, fading)
    assert named(watched(tmp_path, PLAN, rig, reference_every=25)) == {"drift", "lamp"}


def test_a_stage_that_scatters_is_not_taken_for_one_that_drifts(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)

    def scattered(_: int, target: Point) -> Point:
        x, y = 0.5 * STEP * rng.standard_normal(2)
        return target[0] + x, target[1] + y, target[2]

    state = watched(tmp_path, PLAN, deceived_rig(PLAN, scattered), reference_every=25, on_suspect="flag")
    assert "scatter" in named(state) and not named(state) & {"drift", "lamp"}
    assert state.alarms[0].size == pytest.approx(0.5, rel=0.5)


def heated(rig: Any, pixels: list[tuple[int, int]], after: int) -> None:
    """Let pixels of the sensor be hot from a frame on."""
    frames, camera = itertools.count(1), rig.camera.device

    def hot(works: Any, timeout_s: float) -> Any:
        frame = works(timeout_s)
        if next(frames) > after:
            for row, column in pixels:
                frame.data[row - camera._roi.row, column - camera._roi.column] = 2500
        return frame

    intercept(rig, "camera", "grab", hot)


@pytest.mark.parametrize("reference_every", [0, pytest.param(25, marks=pytest.mark.long)])
def test_hot_pixels_raise_no_alarm_of_the_lamp(tmp_path: Path, reference_every: int) -> None:
    """Hot pixels in the dark frames, which are subtracted, are in some cutouts and not in others."""
    rig = rig_for(PLAN)
    heated(rig, [(40, 34), (41, 60)], 0)
    assert watched(tmp_path, PLAN, rig, reference_every=reference_every, darks=2).alarms == ()


def test_pixels_that_become_hot_are_named(tmp_path: Path) -> None:
    rig = rig_for(PLAN)
    heated(rig, [(40, 45), (54, 60)], 250)
    state = watched(tmp_path, PLAN, rig, reference_every=25, on_suspect="flag", darks=2)
    assert named(state) == {"hot"} and state.alarms[0].size == 2
