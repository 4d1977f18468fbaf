"""The check of the stage before recording: faults are refused, good stages pass, and omitted checks are reported."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire._motion import Motion, Mover, check_limits
from lfcal.acquire.control import Aborted, Control
from lfcal.acquire.options import Options
from lfcal.acquire.runner import Outcome
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.acquire.setup import StageCheck, iter_stage_check
from lfcal.base.errors import Cancelled, InputError
from lfcal.base.progress import drain
from lfcal.camera import RegionPlan, ScanPlan, StageAxes, preset
from lfcal.campaign import iter_record_regions
from lfcal.devices.errors import FrameTimeout, LimitError, NotInPosition, StageError
from lfcal.devices.protocols import Point
from lfcal.devices.registry import open_rig
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._camera import LightPatch, Renderer
from lfcal.devices.simulated._optics import PatternRenderer, simulated_optics
from lfcal.devices.simulated._stage import SimStage, StageModel, VirtualTime
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames.source import Position
from tests.acquire.rigs import CAREFUL, Deceived, deceived_rig, rig_for, scaled, small_plan, stopped

PLAN = ScanPlan.for_camera(preset("bench"), virtual_depths=[2.0, 4.0])
CHECKED = replace(CAREFUL, check_stage=True)
FEW = [Position(0, 3, 4), Position(1, 5, 6)]
STEP = PLAN.step_um(0)[0]


def jittered(pixels: float, seed: int = 3) -> Callable[[int, Point], Point]:
    """Return what a stage makes of a target that stops anywhere around it."""
    rng = np.random.default_rng(seed)

    def true(_: int, target: Point) -> Point:
        x, y = pixels * STEP * rng.standard_normal(2)
        return target[0] + x, target[1] + y, target[2]

    return true


def turned(degrees: float) -> Callable[[int, Point], Point]:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return lambda _, at: (cos * at[0] - sin * at[1], sin * at[0] + cos * at[1], at[2])


def stuck(_: int, target: Point) -> Point:
    return target[0], target[1], PLAN.depths_um[0]


WRONG: dict[str, tuple[Callable[[int, Point], Point], str]] = {
    "scale 1.09": (
        scaled(1.09, 1.09, 1.0),
        "image movement to the right: expected 33 ± 0.25 px for a stage movement of one period",
    ),
    "scale of one axis": (
        scaled(1.0, 1.02, 1.0),
        "image movement down: expected 19 ± 0.25 px for a stage movement of one period",
    ),
    "angle": (turned(0.8), "angle between stage and sensor"),
    "sign": (scaled(-1.0, 1.0, 1.0), "stage axes .right, down.: expected"),
    "jitter": (jittered(0.5), "image at one position, visited 5 times: expected a scatter of at most 0.25 px rms"),
    "depth scale 1.1": (scaled(1.0, 1.0, 1.1), r"depth axis z of the stage: expected a move of 12294.8 µm .* 1.1\d\d"),
    "depth scale 0.9": (scaled(1.0, 1.0, 0.9), r"depth axis z of the stage: .* got 0.89\d times that"),
    "depth scale 2": (scaled(1.0, 1.0, 2.0), r"depth axis z of the stage: .* got 2.1\d\d times that"),
    "depth reversed": (scaled(1.0, 1.0, -1.0), "the axis is reversed: set the opposite sense in the plan"),
    "depth stands still": (stuck, "the image of one plane in both; axis z does not move"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_stage_is_refused_by_recording_and_leaves_nothing(tmp_path: Path, kind: str) -> None:
    """Without the check H was up to 28 % off, and of a wrong depth in any case."""
    true, words = WRONG[kind]
    with pytest.raises(InputError, match=words) as caught:
        record(tmp_path / "s", PLAN, deceived_rig(PLAN, true), CHECKED, only=FEW)
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


PRESETS: dict[str, dict[str, Any]] = {
    "r29": {"virtual_depths": (2.0, 5.5)},
    "bench": {"virtual_depths": (2.0, 4.0)},
    "lfm_20x05": {"depths_um": (-40.0, 0.0, 40.0)},
    "lfm_60x12": {"depths_um": (0.0, 4.0)},
}


def checked(rig: Rig, plan: ScanPlan, options: Options = CHECKED) -> StageCheck:
    return drain(iter_stage_check(rig, plan, options))


@pytest.mark.long
@pytest.mark.parametrize("name", PRESETS)
def test_a_good_stage_passes_with_the_true_optics_of_every_preset(name: str) -> None:
    plan = ScanPlan.for_camera(preset(name), **PRESETS[name])
    with open_rig(plan, "sim") as rig:
        found = checked(rig, plan)
    noted = ("sense of the depth axis z of the stage not checked: the camera is telecentric",)
    # spots of lenslets land up to a pixel from the straight line: some cameras are looked at again
    assert found.notes == noted * name.startswith("lfm") and 16 <= found.frames <= 46
    assert found.depth is not None and found.depth.scale == pytest.approx(1.0, abs=0.02)
    assert np.abs(np.array(found.fits[0].scale) - 1).max() * max(plan.period) < 0.1


@pytest.mark.parametrize("name", PRESETS)
def test_a_good_stage_passes_with_the_quick_pattern(name: str) -> None:
    camera = preset(name)
    # a part of the large sensors has room enough
    rows, columns = (min(640, n) for n in camera.sensor.shape)
    plan = ScanPlan.for_camera(
        replace(camera, sensor=replace(camera.sensor, shape=(rows, columns))), **PRESETS[name], cutout=101
    )
    notes = checked(rig_for(plan), plan).notes
    assert all("not checked" in note for note in notes) and bool(notes) == name.startswith("lfm")


OTHER_AXES = replace(PLAN, stage=StageAxes("-y", "+z", "+x", (10.0, 20.0, 30.0)))
GOOD: dict[str, Callable[[], tuple[ScanPlan, Rig]]] = {
    "another seed": lambda: (PLAN, rig_for(PLAN, seed=9)),
    "backlash": lambda: (PLAN, rig_for(PLAN, model=StageModel(backlash_um=(15.0, 15.0, 15.0)))),
    "scatter of 0.1 px": lambda: (PLAN, deceived_rig(PLAN, jittered(0.1))),
    "scale off by 0.1 px over the cell": lambda: (PLAN, deceived_rig(PLAN, scaled(1.003, 1.003, 1.0))),
    "small plan": lambda: (small_plan((3, 3), 3), rig_for(small_plan((3, 3), 3))),
    "one plane": lambda: (small_plan((11, 19), 1), rig_for(small_plan((11, 19), 1))),
    "faint": lambda: (PLAN, rig_for(PLAN, optics=PatternRenderer(PLAN, peak=0.03))),
    "saturated": lambda: (PLAN, rig_for(PLAN, optics=PatternRenderer(PLAN, peak=3.0))),
    "other axes": lambda: (OTHER_AXES, rig_for(OTHER_AXES)),
    "short travel": lambda: (PLAN, rig_for(PLAN, model=StageModel(limits=((-1500, 1500), (-1500, 1500), (-3e4, 1e3))))),
}


@pytest.mark.parametrize("kind", GOOD)
def test_a_good_stage_is_never_refused(kind: str) -> None:
    plan, rig = GOOD[kind]()
    assert checked(rig, plan).fits


@pytest.fixture(scope="module")
def lenslets() -> Renderer:
    """Return the plan's camera as it is simulated."""
    return simulated_optics(PLAN, "auto", "auto")


@pytest.mark.long
@pytest.mark.hard_case
@pytest.mark.parametrize("scale", [1.1, 0.9, 1.0])
def test_the_depth_scale_is_found_with_lenslets_whose_pattern_does_not_follow_the_source(
    lenslets: Renderer, scale: float
) -> None:
    """Between whole periods a centroid moves by two thirds of what the source does: 1.1 looked like 1.06."""
    rig = deceived_rig(PLAN, scaled(1.0, 1.0, scale), optics=lenslets)
    if scale == 1.0:
        found = checked(rig, PLAN)
        assert found.notes == () and found.frames == 16
        return
    with pytest.raises(InputError, match="depth axis z of the stage") as caught:
        checked(rig, PLAN)
    got = re.search(r"got ([\d.]+) times", str(caught.value))
    assert got is not None and float(got[1]) == pytest.approx(scale, abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize(("scale", "how"), [(1.1, "noted"), (2.0, "refused")])
def test_the_depth_scale_of_a_microscope_is_found_by_the_spread(scale: float, how: str) -> None:
    plan = ScanPlan.for_camera(preset("lfm_60x12"), depths_um=(0.0, 4.0))
    with open_rig(plan, "sim") as rig:
        wrong = replace(rig, stage=Deceived(rig.stage, scaled(1.0, 1.0, scale)))
        if how == "noted":
            assert re.search(r"moves 1.0\d\d ± .* times as far as planned", checked(wrong, plan).notes[-1])
            return
        with pytest.raises(InputError, match=r"got (1.9|2.0)\d* times that"):
            checked(wrong, plan)


# -- what cannot be measured --------------------------------------------------------------------------------------
class _Dark:
    """No light at all."""

    def __init__(self, plan: ScanPlan) -> None:
        self._pattern = PatternRenderer(plan)

    def render(self, *args: Any) -> LightPatch:
        patch = self._pattern.render(*args)
        return patch._replace(counts=np.zeros_like(patch.counts))


class _Focused(_Dark):
    """Light in two single pixels, as ideal optics make it."""

    def render(self, *args: Any) -> LightPatch:
        patch = super().render(*args)
        patch.counts[len(patch.counts) // 2, 2::5] = 900
        return patch


class _Trembling(_Dark):
    """An image that is never twice at one place, though nothing moves."""

    rng = np.random.default_rng(1)

    def render(self, *args: Any) -> LightPatch:
        patch = self._pattern.render(*args)
        return patch._replace(row=patch.row + int(self.rng.integers(-1, 2)))


def elsewhere() -> Rig:
    rig = rig_for(PLAN)
    rig.stage.device.moved_elsewhere = True  # type: ignore[attr-defined]
    return rig


def narrow() -> tuple[ScanPlan, Rig]:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(70, 90)))
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0])
    return plan, rig_for(plan)


UNMEASURED: dict[str, tuple[Callable[[], tuple[ScanPlan, Rig]], str]] = {
    "in focus": (lambda: (PLAN, rig_for(PLAN, optics=_Focused(PLAN))), "stage not checked: source: expected light"),
    "elsewhere": (lambda: (PLAN, elsewhere()), "stage not checked: another program moves it"),
    "no room": (narrow, "stage scale checked only to 10 %, depth axis not checked: the sensor has no room"),
    "no travel": (
        lambda: (PLAN, rig_for(PLAN, model=StageModel(limits=((-600, 600), (-600, 600), (-3e4, 1e3))))),
        "stage not checked: stage axis x: expected -600 to 600 µm",
    ),
    "trembling": (
        lambda: (PLAN, rig_for(PLAN, optics=_Trembling(PLAN))),
        "the repeatability of the stage was not checked: the image scatters by",
    ),
    "period": (
        lambda: (small_plan((11, 19), 2), rig_for(small_plan((11, 19), 2))),
        "stage scale checked only to 25 %, depth axis not checked: the plan's period is not the lenslets'",
    ),
}


@pytest.mark.parametrize("kind", UNMEASURED)
def test_what_cannot_be_measured_is_noted_and_refuses_nothing(tmp_path: Path, kind: str) -> None:
    plan, rig = UNMEASURED[kind][0]()
    with rig:
        outcome = record(tmp_path, plan, rig, replace(CHECKED, on_suspect="flag"), only=FEW[:1])
    assert outcome.how == "complete"
    assert any(note.startswith(UNMEASURED[kind][1]) for note in outcome.notes), outcome.notes
    assert re.search("not checked|only", SessionFile.read(tmp_path).runs[0].stage)


def test_a_source_without_light_is_refused() -> None:
    with pytest.raises(InputError, match=r"stage: source: expected light above .* check lamp, exposure and position"):
        checked(rig_for(PLAN, optics=_Dark(PLAN)), PLAN)


# -- sessions -----------------------------------------------------------------------------------------------------
def test_the_session_states_the_result_of_the_check_or_that_it_was_omitted(tmp_path: Path) -> None:
    record(tmp_path / "on", PLAN, rig_for(PLAN), CHECKED, only=FEW)
    record(tmp_path / "off", PLAN, rig_for(PLAN), CAREFUL, only=FEW[:1])
    on, off = (SessionFile.read(tmp_path / name) for name in ("on", "off"))
    assert re.match(r"checked: scale right 1.0000, .* depth scale 1.0\d\d ± 0.0\d\d$", on.runs[0].stage)
    assert off.runs[0].stage == "stage not checked: check_stage is off" and not off.options.check_stage
    for name, value in (("check_stage", 1), ("allow_automatic", "no")):
        with pytest.raises(InputError, match=f"{name.replace('_', ' ')}: expected"):
            Options(**{name: value})
    # positions recorded again are checked too, and a refusal adds nothing
    folder = tmp_path / "on"
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".json", ".h5")}
    with pytest.raises(InputError, match="image movement"):
        record(folder, PLAN, deceived_rig(PLAN, scaled(1.05, 1.05, 1.0)), CHECKED, redo=FEW)
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".json", ".h5")} == before
    rig = rig_for(PLAN)
    assert record(folder, PLAN, rig, CHECKED, resume=True).how == "complete"
    assert rig.stage.moves == 0, "a complete session is resumed without a move"


def test_a_session_is_resumed_only_with_the_scale_and_origin_it_began_with(tmp_path: Path) -> None:
    stopped(tmp_path, PLAN, 1, CHECKED)
    before, off = (tmp_path / "session.json").read_bytes(), 3 * STEP
    for true, words in (
        (scaled(1.05, 1.05, 1.0), "image movement to the right"),
        (lambda _, at: (at[0] + off, at[1], at[2]), "image of the last recorded position"),
    ):
        with pytest.raises(InputError, match=words):
            record(tmp_path, PLAN, deceived_rig(PLAN, true), CHECKED, resume=True)
        assert (tmp_path / "session.json").read_bytes() == before
    control = Control()
    record(tmp_path, PLAN, rig_for(PLAN), CHECKED, resume=True, control=control, observers=(lambda *_: control.stop(),))
    assert [run.stage[:8] for run in SessionFile.read(tmp_path).runs] == ["checked:"] * 2


def test_limits_are_refused_before_the_check_moves_anything(tmp_path: Path) -> None:
    rig = rig_for(PLAN, model=StageModel(limits=((-100.0, 100.0), (-1e5, 1e5), (-1e5, 1e5))))
    with pytest.raises(LimitError):
        record(tmp_path / "s", PLAN, rig, CHECKED)
    assert rig.stage.moves == 0 and not list(tmp_path.iterdir())  # type: ignore[attr-defined]


def test_a_fault_that_passes_is_met_again_and_one_that_stays_ends_it(tmp_path: Path) -> None:
    for fault in (
        DeviceFault("times out", 3),
        DeviceFault("incomplete", 4, 2),
        DeviceFault("move fails", 5),
        DeviceFault("stops short", 7),
    ):
        assert checked(rig_for(PLAN, fault), PLAN).fits, fault
    with pytest.raises(FrameTimeout):
        record(tmp_path / "s", PLAN, rig_for(PLAN, DeviceFault("times out", 3, 99)), CHECKED)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("how", ["stop", "abort"])
def test_the_check_ends_when_asked_and_leaves_nothing(tmp_path: Path, how: str) -> None:
    control = Control()
    with pytest.raises(Cancelled):
        for progress in iter_record(tmp_path / "s", PLAN, rig_for(PLAN), CHECKED, control=control):
            if progress.done == 4:
                getattr(control, how)()
    assert not list(tmp_path.iterdir())


def test_regions_are_each_checked_and_say_a_note_once(tmp_path: Path) -> None:
    scan = replace(small_plan((1, 2), 1, shape=(320, 320)), anchor=(159.0, 159.0))
    found: Outcome = drain(iter_record_regions(tmp_path, RegionPlan.spread(scan, (1, 2)), rig_for(scan), CHECKED))
    assert found.how == "complete" and len(found.notes) == 1


# -- moves of the stage: backlash, limits, settling, drift -----------------------------------------------
PATH = [(float(x), float(y), float(z)) for z in (0, 50) for y in (0, 30, 10) for x in (0, 20, 40, 30, 10)]


def mover(stage: SimStage, time: VirtualTime, control: Control | None = None, **options: object) -> Mover:
    return Mover(stage, time, Motion(**options), control or Control())  # type: ignore[arg-type]


def true_errors(overshoot: float) -> np.ndarray:
    """Return the range of the true errors on each axis along a path of moves."""
    time = VirtualTime()
    stage = SimStage(time, StageModel(backlash_um=(4.0, 5.0, 6.0)))
    drive, errors = mover(stage, time, overshoot_um=(overshoot,) * 3), []
    for target in PATH:
        assert drive.go(target) == pytest.approx(target, abs=1e-3), "the read-back cannot show the backlash"
        errors.append(np.subtract(stage.true_position(), target))
    return np.ptp(errors, axis=0)


def test_backlash_is_taken_up_by_approaching_from_one_side() -> None:
    assert true_errors(20.0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert true_errors(0.0)[:2] == pytest.approx([4.0, 5.0], abs=1e-9), "without the approach the backlash shows"


def test_moves_in_the_positive_sense_need_no_detour() -> None:
    time = VirtualTime()
    stage = SimStage(time)
    drive = mover(stage, time)
    for x in range(10):
        drive.go((10.0 * x, 0.0, 0.0))
    assert stage.moves == 10 + 1
    drive.go((0.0, 0.0, 0.0))
    assert stage.moves == 10 + 1 + 2


def test_arrival_is_waited_for_and_ringing_dies_out() -> None:
    time = VirtualTime()
    stage = SimStage(time, StageModel(velocity_um_s=100.0, ringing_um=5.0, ringing_s=0.02))
    mover(stage, time, settle_s=0.3, overshoot_um=(0.0,) * 3).go((300.0, 0.0, 0.0))
    assert time.monotonic() >= 3.3
    assert stage.position()[0] == pytest.approx(300.0, abs=0.01)
    with pytest.raises(NotInPosition, match=r"400 ± 0\.1 µm, got 40\d"):
        mover(stage, time, settle_s=0.0, overshoot_um=(0.0,) * 3, tolerance_um=(0.1,) * 3).go((400.0, 0.0, 0.0))


def test_limits_are_checked_with_the_approach_and_before_anything_moves() -> None:
    limits = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))
    targets = np.array([[10.0, 50.0, 50.0], [60.0, 50.0, 50.0]])
    check_limits(targets, limits, (10.0, 10.0, 10.0))
    with pytest.raises(LimitError, match=r"axis x.*-1 to 60"):
        check_limits(targets, limits, (11.0, 10.0, 10.0))
    with pytest.raises(LimitError, match="axis z"):
        check_limits(targets + np.array([0, 0, 51]), limits, (0.0, 0.0, 0.0))
    time = VirtualTime()
    stage = SimStage(time, StageModel(limits=limits))
    with pytest.raises(InputError):
        mover(stage, time).go((5.0, 50.0, 50.0))
    assert stage.moves == 0


def test_faults_of_the_stage_are_detected() -> None:
    for kind, error in (
        ("move fails", StageError),
        ("stops short", NotInPosition),
        ("drifts", NotInPosition),
        ("never arrives", StageError),
    ):
        time = VirtualTime()
        with pytest.raises(error):
            stage = SimStage(time, faults=[DeviceFault(kind, 1)])
            mover(stage, time, timeout_s=5.0, settle_s=0.1).go((100.0, 100.0, 100.0))


def test_abort_is_heard_on_the_way() -> None:
    class Impatient(VirtualTime):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            if self.monotonic() > 1.0:
                control.abort()

    control, time = Control(), Impatient()
    stage = SimStage(time, StageModel(velocity_um_s=1.0))
    with pytest.raises(Aborted):
        mover(stage, time, control).go((1000.0, 0.0, 0.0))
    assert time.monotonic() < 1.1


def test_stopped_stage_stays_where_it_was_stopped() -> None:
    time = VirtualTime()
    stage = SimStage(time, StageModel(velocity_um_s=100.0))
    stage.move((100.0, -50.0, 0.0))
    time.sleep(0.4)
    stage.stop()
    time.sleep(10.0)
    assert not stage.moving()
    assert stage.position() == pytest.approx((40.0, -40.0, 0.0))
    stage.home()
    time.sleep(10.0)
    assert stage.position() == (0.0, 0.0, 0.0)
