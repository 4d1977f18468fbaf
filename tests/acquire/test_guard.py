"""Frames that come in order and are wrong: each is taken again, stopped at or named; good sessions raise nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.errors import AcquisitionStopped, SuspectFrame
from lfcal.acquire.options import Options
from lfcal.acquire.recording.records import Note, Suspicion
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
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

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
    named = suspects_of(folder)
    silent = [
        place
        for place, frame in frames_of(folder).items()
        if place not in named and not np.array_equal(frame, undisturbed[place])
    ]
    assert not silent


@pytest.mark.parametrize("kind", [kind for kind in FAULTS if kind != "loses steps"])
def test_a_fault_of_one_frame_is_cured_by_taking_it_again(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str
) -> None:
    notes: list[Note] = []
    rig = rig_for(PLAN, DeviceFault(kind, BEGIN))
    assert record(tmp_path, PLAN, rig, CAREFUL, observers=(lambda _s, note, _f: notes.append(note),)).how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    assert sum(note.attempts > 1 for note in notes) == 1
    assert not suspects_of(tmp_path)


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_that_lasts_stops_with_reason_and_position(
    tmp_path: Path, undisturbed: dict[tuple[int, int, int], np.ndarray], kind: str
) -> None:
    rig = rig_for(PLAN, DeviceFault(kind, BEGIN, 10**6))
    if kind in CURED:
        assert record(tmp_path, PLAN, rig, CAREFUL).how == "complete"
    else:
        with pytest.raises(AcquisitionStopped, match=r"position \(z, y, x\) = .* by the content guard: ") as caught:
            record(tmp_path, PLAN, rig, CAREFUL)
        assert isinstance(caught.value.cause, SuspectFrame)
        assert FAULTS[kind] in caught.value.cause.what
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 500
        assert 0 < caught.value.acknowledged < PLAN.n_positions
        assert record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True).how == "complete"
    assert_same_frames(frames_of(tmp_path), undisturbed)
    assert not suspects_of(tmp_path)


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize("times", [3, 10**6])
@pytest.mark.few(10)
def test_a_fault_that_lasts_is_named_where_the_session_goes_on(
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


def dimmed(plan: ScanPlan, peak: float, **options: Any) -> Rig:
    return rig_for(plan, optics=PatternRenderer(plan, peak=peak), **options)


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


@pytest.mark.few(5)
@pytest.mark.parametrize("name", CLEAN)
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
    notes: list[Note] = []
    rig = rig_for(PLAN, optics=_Vignetted(PLAN))
    record(tmp_path, PLAN, rig, CAREFUL, observers=(lambda _s, note, _f: notes.append(note),))
    assert not suspects_of(tmp_path)
    assert any(note.attempts > 1 for note in notes)


def test_a_resumed_session_and_one_recorded_again_raise_nothing(tmp_path: Path) -> None:
    for _ in range(3):
        with pytest.raises(AcquisitionStopped):
            record(
                tmp_path,
                PLAN,
                rig_for(PLAN, DeviceFault("vanishes", 40)),
                CAREFUL,
                resume=bool(list(tmp_path.iterdir())),
            )
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    record(tmp_path, PLAN, rig_for(PLAN), replace(CAREFUL, reference_every=0), redo=[(1, 6, 8), (0, 3, 3), (0, 0, 0)])
    assert not suspects_of(tmp_path)


def test_positions_recorded_again_are_held_against_those_around_them(tmp_path: Path) -> None:
    """Steps were lost, the list is recorded again, and nobody homed the stage: nothing of that run may count."""
    options = replace(CAREFUL, on_suspect="flag")
    record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("loses steps", 90)), options)
    named = sorted(suspects_of(tmp_path))
    assert named
    with pytest.raises(AcquisitionStopped, match="content guard: image: expected a displacement"):
        record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("loses steps", 0)), CAREFUL, redo=named)
    assert sorted(suspects_of(tmp_path)) == named


def test_a_frame_that_an_earlier_run_kept_is_known_after_a_resume(tmp_path: Path) -> None:
    """The camera hands out an image of before: nothing in the memory of this run shows it, but the recording does."""
    with pytest.raises(AcquisitionStopped):
        record(tmp_path, PLAN, rig_for(PLAN, DeviceFault("vanishes", 40)), CAREFUL)
    old = frames_of(tmp_path)[0, 0, 0]
    schedule = Schedule.of(PLAN, CAREFUL)
    step = list(schedule.steps())[43]
    rig = rig_for(PLAN)
    works, calls = rig.camera.device.grab, 0  # type: ignore[attr-defined]

    def from_before(timeout_s: float) -> Any:
        nonlocal calls
        calls += 1
        frame = works(timeout_s)
        if calls > 4:
            frame.data[Roi(step.row, step.column, *old.shape).within(schedule.roi)] = old
        return frame

    rig.camera.device.grab = from_before  # type: ignore[attr-defined]
    with pytest.raises(AcquisitionStopped, match=r"got the content of \(z, y, x\) = \(0, 0, 0\)"):
        record(tmp_path, PLAN, rig, CAREFUL, resume=True)


SIMULATED: dict[str, dict[str, Any]] = {
    "r29": {"virtual_depths": (4.0,)},
    "bench": {"virtual_depths": (2.0, 3.0, 4.0)},
    "lfm_20x05": {"depths_um": (-40.0, 0.0, 40.0)},
    "lfm_60x12": {"depths_um": (0.0, 4.0)},
}


@pytest.mark.long
@pytest.mark.parametrize("name", SIMULATED)
def test_whole_planes_of_every_preset_raise_no_alarm_with_the_default_optics(tmp_path: Path, name: str) -> None:
    """The README's R29 ended with "the camera mixes its buffers": two frames had the same noise."""
    plan = ScanPlan.for_camera(preset(name), **SIMULATED[name])
    with open_rig(plan, "sim") as rig:
        assert record(tmp_path, plan, rig, CAREFUL).how == "complete"
    assert not suspects_of(tmp_path)


@pytest.mark.long
def test_no_plane_of_the_r29_raises_an_alarm_with_the_quick_pattern(tmp_path: Path) -> None:
    """Two frames of these eight planes were called torn, with sampled rows of equal noise."""
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=np.arange(2.0, 5.6, 0.5).tolist())
    with open_rig(plan, "sim", {"optics": "pattern"}) as rig:
        assert record(tmp_path, plan, rig, CAREFUL).how == "complete"
    assert not suspects_of(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("kind", FAULTS)
def test_faults_that_last_are_named_with_the_default_optics(tmp_path: Path, kind: str) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0])
    with open_rig(plan, "sim", {"faults": DeviceFault(kind, 200, 10**6).text()}) as rig:
        assert record(tmp_path, plan, rig, replace(CAREFUL, on_suspect="flag")).how == "complete"
    named = suspects_of(tmp_path)
    if kind in CURED:
        return
    assert len(named) > plan.n_positions // 2
    assert any(FAULTS[kind] in what for what in named.values())


def test_sessions_of_before_have_no_policy_and_take_the_default() -> None:
    old = Options().to_dict()
    del old["on_suspect"]
    assert Options.from_dict(old).on_suspect == "stop"
