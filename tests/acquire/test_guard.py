"""Frames that come in order and are wrong: each is taken again, stopped at or named; good sessions raise nothing."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.errors import AcquisitionStopped, SuspectFrame
from lfcal.acquire.options import Options
from lfcal.acquire.recording.records import Suspicion
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.schedule import Schedule
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan, preset
from lfcal.devices.protocols import Roi
from lfcal.devices.registry import open_rig
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._optics import PatternRenderer
from lfcal.devices.simulated._stage import StageModel
from lfcal.devices.simulated.faults import DeviceFault
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, intercept, rig_for, small_plan

PLAN = small_plan((7, 9), 2, cutout=(25, 25))
BEGIN = 50
FAULTS = {
    "blank": Suspicion.BLANK,
    "repeats": Suspicion.REPEATED,
    "frozen": Suspicion.REPEATED,
    "torn": Suspicion.TORN,
    "region slips": Suspicion.DISPLACED,
    "dark level": Suspicion.DARK_LEVEL,
    "clamps exposure": Suspicion.EXPOSURE,
    "lamp dims": Suspicion.LIGHT,
    "encoder off": Suspicion.DISPLACED,
    "loses steps": Suspicion.DISPLACED,
}
CURED = ("repeats", "torn")
"""A buffer behind by one frame holds the right content when the frame is taken again."""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, int, int], np.ndarray]:
    folder = tmp_path_factory.mktemp("undisturbed")
    record(folder, PLAN, rig_for(PLAN), CAREFUL)
    return frames_of(folder)


def suspects_of(folder: Path) -> dict[tuple[int, int, int], Suspicion]:
    with RecordingSource(folder) as source:
        return {tuple(position): what for position, what in source.suspects()}


def check_nothing_silent(folder: Path, undisturbed: dict[tuple[int, int, int], np.ndarray]) -> None:
    """Every frame is right, or named."""
    wrong = {place for place, frame in frames_of(folder).items() if not np.array_equal(frame, undisturbed[place])}
    assert not wrong - suspects_of(folder).keys()


@pytest.mark.few(5)
@pytest.mark.parametrize("kind", [kind for kind in FAULTS if kind != "loses steps"])
def test_a_fault_of_one_frame_is_cured_by_taking_it_again(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str
) -> None:
    attempts: list[int] = []
    watch = lambda _step, note, _frame: attempts.append(note.attempts)  # noqa: E731
    outcome = record(tmp_path, PLAN, rig_for(PLAN, DeviceFault(kind, BEGIN)), CAREFUL, observers=(watch,))
    assert outcome.how == "complete" and sum(one > 1 for one in attempts) == 1
    assert_same_frames(frames_of(tmp_path), undisturbed)
    assert not suspects_of(tmp_path)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_lasting_fault_stops_with_reason_and_position(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str
) -> None:
    rig = rig_for(PLAN, DeviceFault(kind, BEGIN, 10**6))
    if kind in CURED:
        assert record(tmp_path, PLAN, rig, CAREFUL).how == "complete"
    else:
        with pytest.raises(AcquisitionStopped, match=r"position \(z, y, x\) = .* by the content guard: ") as caught:
            record(tmp_path, PLAN, rig, CAREFUL)
        assert isinstance(caught.value.cause, SuspectFrame) and FAULTS[kind] in caught.value.cause.what
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
        assert 0 < caught.value.acknowledged < PLAN.n_positions
        assert record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True).how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    assert not suspects_of(tmp_path)


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("times", [3, 10**6])
@pytest.mark.few(6)
def test_a_lasting_fault_is_named_where_the_session_continues(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str, times: int
) -> None:
    options = replace(CAREFUL, on_suspect="flag")
    assert record(tmp_path, PLAN, rig_for(PLAN, DeviceFault(kind, BEGIN, times)), options).how == "complete"
    check_nothing_silent(tmp_path, undisturbed)
    named = suspects_of(tmp_path)
    if kind not in CURED and times > 3:
        assert len(named) > PLAN.n_positions // 2
        assert any(FAULTS[kind] in what for what in named.values())
    if named:
        record(tmp_path, PLAN, rig_for(PLAN), options, redo=list(named))
        assert not suspects_of(tmp_path)


def dimmed(plan: ScanPlan, peak: float) -> Rig:
    return rig_for(plan, optics=PatternRenderer(plan, peak=peak))


def with_sensor(plan: ScanPlan, **values: Any) -> ScanPlan:
    camera = plan.camera
    return replace(plan, camera=replace(camera, sensor=replace(camera.sensor, **values)))


EIGHT_BITS = with_sensor(PLAN, bit_depth=8, black_level=2.0)
WITHOUT_NOISE = with_sensor(PLAN, bit_depth=8, black_level=0.0, read_noise_e=0.0, full_well_e=1e9)
RASTER = replace(PLAN, order="raster")
AVERAGED = replace(PLAN, frames_averaged=3)
EXPOSURES = replace(PLAN, exposure_s=(0.02, 0.005))
FIRST_AND_REFERENCES = {"darks": 2, "reference_every": 20}
CLEAN: dict[str, tuple[ScanPlan, Rig, dict[str, Any]]] = {
    "plain": (PLAN, rig_for(PLAN), FIRST_AND_REFERENCES),
    "another seed": (PLAN, rig_for(PLAN, seed=7), {}),
    "raster": (RASTER, rig_for(RASTER), {}),
    "coarse": (PLAN, rig_for(PLAN), {"order": "coarse"}),
    "averaged": (AVERAGED, rig_for(AVERAGED), FIRST_AND_REFERENCES),
    "bracket": (PLAN, rig_for(PLAN), {"bracket": (1.0, 0.25)}),
    "8 bits": (EIGHT_BITS, rig_for(EIGHT_BITS), {}),
    "no noise": (WITHOUT_NOISE, rig_for(WITHOUT_NOISE), FIRST_AND_REFERENCES),
    "exposures": (EXPOSURES, rig_for(EXPOSURES), FIRST_AND_REFERENCES),
    "a few counts": (PLAN, dimmed(PLAN, 0.002), {}),
    "less than the noise": (PLAN, dimmed(PLAN, 1e-4), {}),
    "saturated": (PLAN, dimmed(PLAN, 3.0), {}),
    "sloppy stage": (
        PLAN,
        rig_for(PLAN, model=StageModel(ringing_um=12.0, ringing_s=0.2)),
        {"tolerance_um": (40.0, 40.0, 40.0)},
    ),
}


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.long) if one == "no noise" else one for one in CLEAN]
)
def test_a_good_session_raises_nothing(tmp_path: Path, name: str) -> None:
    plan, rig, options = CLEAN[name]
    assert record(tmp_path, plan, rig, replace(CAREFUL, **options)).how == "complete"
    assert not suspects_of(tmp_path)


class _Vignetted:
    """Light that fades to nothing across the cell, in a pattern that jumps by half its width in the middle of it."""

    def __init__(self, plan: ScanPlan) -> None:
        self._pattern = PatternRenderer(plan)
        self._middle = float(plan.object_um(np.array([0, 3, 4]))[0])

    def render(self, source_um: Any, exposure_s: float, roi: Any) -> Any:
        patch = self._pattern.render(source_um, exposure_s, roi)
        _, column = np.unravel_index(int(patch.counts.argmax()), patch.counts.shape)
        share = max(0.0, 1 - 0.11 * (patch.column + column - roi.column - 12))
        jump = 5 if source_um[0] > self._middle else 0
        return patch._replace(column=patch.column + jump, counts=patch.counts * np.float32(share))


def test_a_pattern_that_jumps_and_fades_to_black_costs_frames_and_raises_nothing(tmp_path: Path) -> None:
    attempts: list[int] = []
    watch = lambda _step, note, _frame: attempts.append(note.attempts)  # noqa: E731
    record(tmp_path, PLAN, rig_for(PLAN, optics=_Vignetted(PLAN)), CAREFUL, observers=(watch,))
    assert not suspects_of(tmp_path) and max(attempts) > 1


def test_a_resumed_session_and_one_recorded_again_raise_nothing(tmp_path: Path) -> None:
    for begun in (False, True, True):
        with pytest.raises(AcquisitionStopped):
            record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("vanishes", 40)), CAREFUL, resume=begun)
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    record(tmp_path, PLAN, rig_for(PLAN), replace(CAREFUL, reference_every=0), redo=[(1, 6, 8), (0, 3, 3), (0, 0, 0)])
    assert not suspects_of(tmp_path)


def test_positions_recorded_again_are_compared_with_those_around_them(tmp_path: Path) -> None:
    """Steps were lost, the list is recorded again without homing the stage: nothing of that run may count."""
    options = replace(CAREFUL, on_suspect="flag")
    record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("loses steps", 90)), options)
    named = sorted(suspects_of(tmp_path))
    assert named
    with pytest.raises(AcquisitionStopped, match="content guard: image: expected a displacement"):
        record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("loses steps", 0)), CAREFUL, redo=named)
    assert sorted(suspects_of(tmp_path)) == named


def test_a_resumed_session_knows_the_frames_of_the_earlier_run(tmp_path: Path) -> None:
    """The camera returns an old image. Nothing in the memory of this run shows it, but the recording does."""
    with pytest.raises(AcquisitionStopped):
        record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("vanishes", 40)), CAREFUL)
    old, schedule = frames_of(tmp_path)[0, 0, 0], Schedule.of(PLAN, CAREFUL)
    step, calls, rig = list(schedule.steps())[43], itertools.count(1), rig_for(PLAN)

    def from_before(works: Any, timeout_s: float) -> Any:
        frame = works(timeout_s)
        if next(calls) > 4:
            frame.data[Roi(step.row, step.column, *old.shape).within(schedule.roi)] = old
        return frame

    intercept(rig, "camera", "grab", from_before)
    with pytest.raises(AcquisitionStopped, match=r"got the content of \(z, y, x\) = \(0, 0, 0\)"):
        record(tmp_path, PLAN, rig, CAREFUL, resume=True)


SIMULATED: dict[str, dict[str, Any]] = {
    "r29": {"virtual_depths": (4.0,)},
    "bench": {"virtual_depths": (2.0, 3.0, 4.0)},
    "lfm_20x05": {"depths_um": (-40.0, 0.0, 40.0)},
    "lfm_60x12": {"depths_um": (0.0, 4.0)},
    # two frames of these eight planes were called torn, with sampled rows of equal noise
    "r29, quick": {"virtual_depths": np.arange(2.0, 5.6, 0.5).tolist()},
}


@pytest.mark.long
@pytest.mark.parametrize("name", SIMULATED)
def test_whole_planes_of_every_preset_raise_no_alarm(tmp_path: Path, name: str) -> None:
    """The README's R29 ended with "the camera mixes its buffers": two frames had the same noise."""
    camera, _, quick = name.partition(", ")
    plan = ScanPlan.for_camera(preset(camera), **SIMULATED[name])
    with open_rig(plan, "sim", {"optics": "pattern"} if quick else {}) as rig:
        assert record(tmp_path, plan, rig, CAREFUL).how == "complete"
    assert not suspects_of(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("kind", [kind for kind in FAULTS if kind not in CURED])
def test_lasting_faults_are_named_with_the_default_optics(tmp_path: Path, kind: str) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0])
    with open_rig(plan, "sim", {"faults": DeviceFault(kind, 200, 10**6).text()}) as rig:
        assert record(tmp_path, plan, rig, replace(CAREFUL, on_suspect="flag")).how == "complete"
    named = suspects_of(tmp_path)
    assert len(named) > plan.n_positions // 2 and any(FAULTS[kind] in what for what in named.values())


def test_options_without_a_policy_take_the_default() -> None:
    old = Options().to_dict()
    del old["on_suspect"]
    assert Options.from_dict(old).on_suspect == "stop"
