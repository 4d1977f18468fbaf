"""Recording: a scan, regions of the field, frames of a target, or positions until H is good enough."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from lfcal.base import InputError, LfcalError, Work
from lfcal.records import opt, read_names, read_share, record, required, show_names, show_planes
from lfcal.tasks._recording import (
    Cover,
    coverage_facts,
    iter_finished,
    list_suspects,
    pairs,
    recorded_before,
    reported_holds,
    simulated_optics,
    simulated_options,
    stoppable,
    tell_automatic,
    watched,
)
from lfcal.tasks.cameras import tell_assumed
from lfcal.tasks.notes import note, tell
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.acquire import Control, LiveCoverage, LiveQuality, Options, Outcome, RedoList, SessionForecast
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.campaign import Adapted, Goal
    from lfcal.devices import Rig
    from lfcal.frames import Position
    from lfcal.targets import TargetPlan

__all__ = [
    "ACQUIRE",
    "Acquire",
    "AcquireRegions",
    "AcquireTarget",
    "AcquireUntil",
    "PlannedSession",
    "RecordedSession",
]

TARGET = "lfcal-target-plan"

Seen: TypeAlias = "Work[tuple[Any, dict[str, Any]]]"
"""A recording: how it ended, and what was seen of it."""


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected("numbers", "numbers separated by commas", text, "correct it") from None


def _groups() -> tuple[str, ...]:
    from lfcal.fit import GROUPS

    return ("auto", *GROUPS.names())


def read_plan(path: Path) -> ScanPlan | TargetPlan | RegionPlan:
    """Return the plan of a scan, a target or regions in a file."""
    from lfcal.base import parse_json, read_text
    from lfcal.camera import RegionPlan, ScanPlan

    data = parse_json(read_text(path), "scan plan")
    if isinstance(data, dict) and data.get("format") == TARGET:
        from lfcal.targets import TargetPlan

        return TargetPlan.from_dict(data)
    return RegionPlan.from_dict(data) if RegionPlan.is_one(data) else ScanPlan.from_dict(data)


@dataclass(frozen=True, kw_only=True)
class PlannedSession(TaskResult):
    """What a recording would cost; nothing was moved or written.

    Attributes
    ----------
    out
        The session's folder.
    forecast
        What it costs.
    assumed
        What of the camera is assumed.
    optics
        How the simulator would compute the frames; empty: real devices.
    """

    out: Path
    forecast: SessionForecast
    assumed: tuple[str, ...]
    optics: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        from lfcal.base import plain

        return {**plain(self.forecast), "assumed": self.assumed}


@dataclass(frozen=True, kw_only=True)
class RecordedSession(TaskResult):
    """A session that was recorded, or stopped.

    Attributes
    ----------
    out
        The session's folder.
    outcome
        How it ended.
    facts
        What was seen and made, by name.
    alarms
        Alarms of the recording.
    adapted
        Of a session that ends by the error of H: how it ended.
    ended_by
        The signal that stopped it.
    error
        What went wrong after the last frame; the recording is whole.
    """

    out: Path
    outcome: Outcome
    facts: Mapping[str, Any]
    alarms: tuple[Any, ...]
    adapted: Adapted | None = None
    ended_by: int = signal.SIGINT
    error: LfcalError | None = None

    def exit_code(self) -> int:
        """Return 128 and the signal of a session that was stopped: scripts must be able to see it.

        Raises what went wrong after the last frame.
        """
        if self.error is not None:
            tell(f"the recording is whole: lfcal assemble {self.out} makes H of it")
            raise self.error
        return 0 if self.outcome.how == "complete" else 128 + self.ended_by

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        from lfcal.base import Judgement

        judgement = Judgement.of("recording", self.alarms, "without an alarm")
        return {"session": self.out, "outcome": self.outcome, **self.facts, **judgement.to_dict()}


@record
class _Acquire(Task):
    """What all kinds have."""

    name: ClassVar[str] = "acquire"

    plan: Path = required(
        "Plan of a scan, of regions of the field, or of a target (.json), made by lfcal plan.", argument=True, file="in"
    )
    out: Path = required("Session folder.", label="Session folder", short="-o", file="out")
    backend: str = opt("sim", "Devices; lfcal doctor lists them.", label="Devices", short="-b")
    stage: str = opt("", "Devices of the stage, if they are others.", label="Stage", empty="as the camera", more=True)
    option: tuple[str, ...] = opt(
        (), "Option of the devices, NAME=VALUE.", label="Options of the devices", empty="none"
    )
    resume: bool = opt(False, "Continue an interrupted session.")
    bracket: str | tuple[float, ...] | None = opt(
        None,
        "Exposures of each position as factors of the planned one, merged to a high dynamic range, e.g. 1,0.25.",
        label="Exposure bracket",
        read=_numbers,
        show=show_planes,
        empty="1",
        more=True,
    )
    darks: int | None = opt(
        None, "Number of frames averaged into each dark frame; 0: none.", label="Dark frames", at_least=0, empty="8"
    )
    dark_every: int | None = opt(
        None,
        "Take dark frames again after this number of positions; 0: at the start only.",
        label="Dark frames every",
        at_least=0,
        empty="0",
        more=True,
    )
    cover: bool = opt(
        False,
        "Ask to cover the lens for dark frames, if no light can be switched.",
        label="Cover the lens",
        more=True,
    )
    reference_every: int | None = opt(
        None,
        "Take a frame that shows the drift of the lamp after this number of positions; 0: none.",
        label="Reference frame every",
        at_least=0,
        empty="100",
        more=True,
    )
    retries: int | None = opt(
        None, "Number of further attempts after a transient fault.", at_least=0, empty="2", more=True
    )
    on_suspect: str | None = opt(
        None,
        "What to do with frames whose content stays suspicious: stop, or flag the position.",
        label="Suspicious frames",
        choices=("stop", "flag"),
        empty="stop",
        more=True,
    )
    allow_automatic: bool = opt(
        False,
        "Record although the exposure, gain or black level of the camera stays automatic, or its gamma on.",
        label="Allow automatic",
        more=True,
    )
    suspend: tuple[str, ...] = opt(
        (),
        "Hold while a gauge, or the last number of a file, is out of bounds: GAUGE=LOW:HIGH.",
        label="Hold by gauges",
        empty="none",
        more=True,
    )
    steady: float | None = opt(
        None,
        "Time that all gauges must be within bounds before a hold ends.",
        label="Steady for",
        unit="s",
        at_least=0,
        empty="30",
        needs=("suspend", ""),
        more=True,
    )
    tolerance: str | tuple[float, ...] | None = opt(
        None,
        "Position tolerance X,Y,Z of the stage.",
        unit="µm",
        read=_numbers,
        show=show_planes,
        empty="a tenth of a step, and one plane step in depth",
        more=True,
    )
    overshoot: str | tuple[float, ...] | None = opt(
        None,
        "Approach positions from one side by this distance X,Y,Z; 0,0,0: directly.",
        unit="µm",
        read=_numbers,
        show=show_planes,
        empty="20,20,20",
        more=True,
    )
    keep_free: float | None = opt(
        None, "Disk space that stays free.", unit="GB", at_least=0, empty="a tenth of the recording", more=True
    )
    origin: str | tuple[float, ...] | None = opt(
        None,
        "Stage coordinates X,Y,Z of the sensor's centre.",
        unit="µm",
        read=_numbers,
        show=show_planes,
        empty="as planned",
        more=True,
    )
    check_stage: bool | None = opt(
        None,
        "Measure sign, scale, scatter and depth of the stage first.",
        label="Check the stage",
        empty="measured, or as the session began",
        more=True,
    )
    check_origin: bool = opt(
        True,
        "Do not compare the last position with its frame where a session continues.",
        label="Check the origin",
        more=True,
    )
    assemble: Path | None = opt(
        None, "Assemble H into this file at the end (.h5).", label="H file", file="out", empty="not assembled"
    )
    pack: bool = opt(True, "Do not compress the finished recording.", label="Compress the recording", more=True)
    dry_run: bool = opt(False, "Check everything and show the cost; move nothing.", label="Only check")
    frame_rate: float | None = opt(
        None,
        "Largest frame rate of the camera, for the time of a dry run.",
        unit="frames/s",
        above=0,
        empty="readout is not counted",
        needs=("dry_run", ""),
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value, and those that would have no effect."""
        super().__post_init__()
        for name, given in (("--dark-every", self.dark_every is not None), ("--cover", self.cover)):
            if self.darks == 0 and given:
                raise InputError.expected(name, "dark frames", "--darks 0", "leave it out")
        if isinstance(self.origin, tuple) and len(self.origin) != 3:
            raise InputError.expected("--origin", "X,Y,Z in µm", show_planes(self.origin), "give three numbers")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return its files: the session's folder is made, or continued, by the recording itself."""
        if way == "out":
            return () if self.assemble is None else (self.assemble,)
        return (*super().files("in"), self.out)

    @property
    def _redo(self) -> RedoList | None:
        return None

    @property
    def _only(self) -> RedoList | None:
        return None

    @property
    def _continues(self) -> bool:
        """Whether a session is continued, which keeps the options that it began with."""
        return self.resume

    def _of_single_points(self) -> dict[str, Any]:
        """Return the options that frames of many points do not have."""
        return {}

    def _options(self) -> Options:
        """Return the options that an existing session began with, or the defaults, changed by what is given."""
        from lfcal.acquire import Options, SessionFile
        from lfcal.campaign import first_begun, is_regions

        session = self.out if self._continues else None
        if session is not None and is_regions(session):
            session = first_begun(session)
        given: dict[str, Any] = {
            **self._of_single_points(),
            "bracket": self.bracket,
            "darks": self.darks,
            "dark_every": self.dark_every,
            "reference_every": self.reference_every,
            "retries": self.retries,
            "on_suspect": self.on_suspect,
            "allow_automatic": self.allow_automatic or None,
            "suspend": self.suspend or None,
            "steady_s": self.steady,
            "tolerance_um": self.tolerance,
            "overshoot_um": self.overshoot,
            "keep_free_bytes": None if self.keep_free is None else int(1e9 * self.keep_free),
            "check_stage": self.check_stage,
        }
        base = Options() if session is None else SessionFile.read(session).options
        options = replace(base, **{k: v for k, v in given.items() if v is not None})
        return options if self.check_origin else replace(options, origin_tolerance_px=None)

    def _plan(self) -> Any:
        """Return the plan, with the stage where it is given."""
        found: Any = read_plan(self.plan)
        if self.origin is None:
            return found
        scan = found.scan
        origin: Any = self.origin
        scan = replace(scan, stage=replace(scan.stage, origin_um=origin))
        return scan if scan.__class__ is found.__class__ else replace(found, scan=scan)

    def _devices(self, plan: Any) -> dict[str, str]:
        return pairs(self.option)

    def work(self, run: RunSettings | None = None) -> Work[tuple[TaskResult, ...]]:
        """Record until the end or a signal, and assemble H where asked."""
        from lfcal.devices import open_rig

        plan = self._plan()
        devices = self._devices(plan)
        scan: ScanPlan = plan.scan
        tell_assumed(scan.camera, self.plan.name)
        options = self._options()
        with open_rig(scan, self.backend, devices, stage=self.stage) as rig:
            optics = simulated_optics(rig)
            # a light that can be switched makes it unnecessary to cover the lens.
            if self.cover and rig.light is None:
                rig = replace(rig, light=Cover())
            if self.dry_run:
                forecast = self._forecast(plan, rig, options)
                assumed = tuple(scan.camera.marks.paths("assumed"))
                return (
                    PlannedSession(out=self.out, forecast=forecast, assumed=assumed, optics=optics.get("optics", "")),
                )
            found, seen, ended_by = yield from self._iter_stoppable(plan, rig, options)
        return ((yield from self._iter_ended(plan, found, optics | seen, ended_by)),)

    def _iter_stoppable(self, plan: Any, rig: Rig, options: Options) -> Work[tuple[Any, dict[str, Any], int]]:
        """Check the light, then record until the end or a signal; return how it ended, what was seen, the signal."""
        from lfcal.acquire import Control, check_light

        tell_automatic(plan, rig, options, resumed=self.resume)
        # a session that continues has its darks already, and its positions are compared with the frames themselves.
        if options.darks and not self._continues:
            check_light(rig)
        control = Control()
        with stoppable(control) as asked:
            found, seen = yield from self._iter_recorded(plan, rig, options, control)
        return found, seen, next(iter(asked), signal.SIGINT)

    def _iter_ended(self, plan: Any, found: Any, seen: dict[str, Any], ended_by: int) -> Work[RecordedSession]:
        """Assemble and pack a session that is complete."""
        adapted, outcome = (None, found) if hasattr(found, "acknowledged") else (found, found.outcome)
        alarms = tuple(seen.pop("alarms"))
        facts = {**seen, **self._suspects(outcome), "assumed": plan.scan.camera.marks.paths("assumed")}
        facts |= {} if adapted is None else adapted_facts(adapted)
        error: LfcalError | None = None
        if outcome.how == "complete":
            try:
                facts |= yield from self._iter_finished()
            except LfcalError as caught:  # the frames are safe whatever became of H
                error = caught
        known: dict[str, Any] = {"facts": facts, "alarms": alarms, "adapted": adapted, "error": error}
        return RecordedSession(out=self.out, outcome=outcome, ended_by=ended_by, **known)

    def _suspects(self, outcome: Outcome) -> dict[str, Any]:
        return list_suspects(self.out, outcome)

    def _iter_finished(self) -> Work[dict[str, Any]]:
        return (yield from iter_finished(self.out, self.assemble, self.pack))

    def _places(self, plan: Any) -> tuple[Position, ...]:
        """Return the positions that are counted in a forecast; empty: all."""
        return () if self._only is None else self._only.positions

    def _forecast(self, plan: Any, rig: Rig, options: Options) -> SessionForecast:
        from lfcal.acquire import forecast

        only = self._places(plan)
        return forecast(plan, rig, options, self.out, only=only, frames_per_s=self.frame_rate)

    def _iter_recorded(self, plan: Any, rig: Rig, options: Options, control: Control) -> Seen:
        """Record; return how it ended, and what was seen."""
        from lfcal.acquire import QualityState, RedoList, iter_record

        quality = self._quality(plan, options)
        redo, only = self._redo, self._only
        work = iter_record(
            self.out,
            plan,
            rig,
            options,
            resume=self.resume,
            redo=None if redo is None else redo.positions,
            only=None if only is None else only.positions,
            kept_aside=(redo or only or RedoList((), ())).kept_aside,
            control=control,
            observers=(quality,),
        )
        outcome = yield from watched(reported_holds(work, control), quality)
        state = quality.state()
        more = {} if isinstance(state, QualityState) else {"shown": coverage_facts(state)}
        return outcome, {"alarms": state.alarms, **more}

    def _quality(self, plan: Any, options: Options) -> LiveQuality | LiveCoverage:
        from lfcal.acquire import LiveQuality, window_shape

        return LiveQuality(plan, window_shape(plan, options))


def _read_list(path: Path | None) -> RedoList | None:
    from lfcal.acquire import RedoList

    return None if path is None else RedoList.read(path)


def _again() -> Path | None:
    return opt(
        None,
        "Record the positions of this list again, or further ones (from lfcal inspect or lfcal plan fit).",
        label="Positions to record again",
        file="in",
        empty="none",
    )


@record
class AcquireTarget(_Acquire):
    """Record the frames of a target of many points.

    Examples
    --------
    >>> from lfcal.tasks import AcquireTarget
    >>> task = AcquireTarget(plan="target.json", out="session", darks=0)
    >>> print(task.backend, task.resume)
    sim False
    """

    input_words: ClassVar[str] = "a target of many points"

    redo: Path | None = _again()

    @property
    def _redo(self) -> RedoList | None:
        return _read_list(self.redo)

    @property
    def _continues(self) -> bool:
        return self.resume or self.redo is not None

    def _devices(self, plan: Any) -> dict[str, str]:
        return simulated_options(plan, self.plan, self.backend, pairs(self.option))

    def _quality(self, plan: Any, options: Options) -> LiveQuality | LiveCoverage:
        return recorded_before(plan, self.out if self._continues else None)

    def _iter_finished(self) -> Work[dict[str, Any]]:
        from lfcal.tasks.assemble import AssembleTarget

        result: dict[str, Any] = {}
        if self.assemble is not None:
            # holes that are missing, or displaced, leave positions that nothing showed: not strict
            (made,) = yield from AssembleTarget(frames=self.out, out=self.assemble).work()
            with made.report.matrix as matrix:
                saturated = made.report.saturated
                result = {
                    "H": self.assemble,
                    "shape": matrix.shape,
                    "saturated_positions": saturated,
                    "target": made.facts,
                }
        return result | (yield from iter_finished(self.out, None, self.pack))


@record
class _AcquireScan(_Acquire):
    """What recordings of single points have."""

    order: str | None = opt(
        None,
        "plan: as planned. coarse: a first look at all planes, then finer.",
        choices=("plan", "coarse"),
        empty="plan",
    )
    margin: int | None = opt(
        None, "Pixels kept around the cutout.", unit="px", at_least=0, empty="0, or 12 between pixels", more=True
    )
    controls: int | None = opt(
        None,
        "Number of control frames for each plane and direction.",
        label="Control frames",
        at_least=0,
        empty="0",
        more=True,
    )

    def _of_single_points(self) -> dict[str, Any]:
        return {"order": self.order, "margin_px": self.margin, "controls": self.controls}


@record
class AcquireRegions(_AcquireScan):
    """Record several regions of the field in one session.

    Examples
    --------
    >>> from lfcal.tasks import AcquireRegions
    >>> task = AcquireRegions(plan="regions.json", out="session", assemble="H.h5")
    >>> print(task.files("out"))
    (PosixPath('H.h5'),)
    """

    input_words: ClassVar[str] = "several regions"

    def _suspects(self, outcome: Outcome) -> dict[str, Any]:
        return {}

    def _forecast(self, plan: Any, rig: Rig, options: Options) -> SessionForecast:
        """Return what all regions cost together; each is checked."""
        from lfcal.acquire import forecast

        rate = self.frame_rate
        found = [
            forecast(plan.plan(k), rig, options, self.out / name, frames_per_s=rate)
            for k, name in enumerate(plan.names)
        ]
        names = ("positions", "other_frames", "seconds", "recording_bytes")
        sums = {name: sum(getattr(one, name) for one in found) for name in names}
        if rate is not None:
            sums["readout_seconds"] = sum(one.readout_seconds or 0.0 for one in found)
        return replace(found[0], **sums)

    def _iter_recorded(self, plan: Any, rig: Rig, options: Options, control: Control) -> Seen:
        from lfcal.acquire import LiveQuality, window_shape
        from lfcal.campaign import iter_record_regions

        seen: dict[int, LiveQuality] = {}

        def watching(k: int) -> tuple[LiveQuality]:
            seen[k] = LiveQuality(plan.plan(k), window_shape(plan.plan(k), options))
            return (seen[k],)

        how: dict[str, Any] = {"resume": self.resume, "control": control, "observers": watching}
        work = iter_record_regions(self.out, plan, rig, options, **how)
        outcome = yield from reported_holds(work, control)
        alarms = [
            replace(alarm, remedy=f"{alarm.remedy} (region {plan.names[k]})")
            for k, quality in seen.items()
            for alarm in quality.state().alarms
        ]
        return outcome, {"alarms": alarms, "regions": plan.names}

    def _iter_finished(self) -> Work[dict[str, Any]]:
        """Assemble H of every region into one file, and pack the recordings, as asked for."""
        from lfcal.acquire import iter_assemble_session, iter_finish
        from lfcal.campaign import read_regions, region_sessions, save_parts, temporary_parts
        from lfcal.psf import AssemblySettings, open_psf

        result: dict[str, Any] = {}
        if self.assemble is not None:
            settings = AssemblySettings(strict=True)
            with temporary_parts(self.assemble, read_regions(self.out).names) as parts:
                for name, folder in region_sessions(self.out):
                    made = yield from iter_assemble_session(folder, parts[name], settings=settings)
                    made.matrix.close()
                save_parts(parts, self.assemble, dtype="rounded")
            with open_psf(self.assemble) as matrix:
                result |= {"H": self.assemble, "shape": matrix.shape}
        if self.pack:
            gained = 0
            for _, folder in region_sessions(self.out):
                packed = yield from iter_finish(folder)
                gained += packed.bytes_gained
            result["bytes_gained"] = gained
        return result


@record
class AcquireUntil(_AcquireScan):
    """Record positions of a scan, fit, and choose the next ones, until H is good enough.

    Examples
    --------
    >>> from lfcal.tasks import AcquireUntil
    >>> task = AcquireUntil(plan="session/plan.json", out="new", until_error="0.5%", most=60)
    >>> print(task.until_error, task.unknowns)
    0.005 ()
    """

    input_words: ClassVar[str] = "a scan until H is good enough (--until-error)"

    until_error: float = required(
        "Record, fit, and choose the next positions, until the error of H is this small, e.g. 0.5%.",
        label="Error of H",
        read=read_share,
    )
    most: int = opt(0, "Largest number of positions; 0: all of the plan.", label="Positions, at most", at_least=0)
    unknowns: str | tuple[str, ...] = opt(
        (), "Groups of unknowns of the fit, A,B,C.", choices=_groups, read=read_names, show=show_names, empty="auto"
    )

    def __post_init__(self) -> None:
        """Check every value, also those of the fit."""
        super().__post_init__()
        self._goal  # noqa: B018 it is checked

    @property
    def _goal(self) -> Goal:
        from lfcal.campaign import Goal

        groups: Any = "auto" if self.unknowns in ((), ("auto",)) else self.unknowns
        return Goal(self.until_error, most=self.most or None, unknowns=groups)

    def _places(self, plan: Any) -> tuple[Position, ...]:
        from lfcal.frames import Position

        note("at most so much: the session ends when the wanted error of H is reached")
        most = self.most or plan.n_positions
        return tuple(Position(*place) for place in plan.order_indices()[:most].tolist())

    def _iter_recorded(self, plan: Any, rig: Rig, options: Options, control: Control) -> Seen:
        from lfcal.campaign import iter_adaptive

        quality = self._quality(plan, options)
        work = iter_adaptive(
            self.out,
            plan,
            rig,
            self._goal,
            options,
            resume=self.resume,
            control=control,
            observers=(quality,),
            seen=lambda step: tell(str(step)),
        )
        found = yield from watched(reported_holds(work, control), quality)
        return found, {"alarms": quality.state().alarms}


@record
class Acquire(_AcquireScan):
    """Record a frame at each position of a plan, safe against any crash.

    Dark frames are taken first, with the light switched off. Ctrl-C ends after the current position, a second one
    immediately; resume continues.

    Examples
    --------
    >>> from lfcal.tasks import Acquire
    >>> task = Acquire(plan="session/plan.json", out="new", darks=0, dry_run=True, option=("optics=pattern",))
    >>> (planned,) = task.run()
    >>> print(planned.forecast.positions, "positions")
    1254 positions
    """

    input_words: ClassVar[str] = "a scan of one region"

    redo: Path | None = _again()
    positions: Path | None = opt(
        None,
        "Record the positions of this list and no others (from lfcal plan fit).",
        label="Positions",
        file="in",
        empty="all of the plan",
    )

    def __post_init__(self) -> None:
        """Check every value, and that positions are of a new session."""
        super().__post_init__()
        if self.positions is not None and (self.resume or self.redo is not None):
            raise InputError("--positions: is of a new session; one that goes on has its own, and --redo adds to them")

    @property
    def _redo(self) -> RedoList | None:
        return _read_list(self.redo)

    @property
    def _continues(self) -> bool:
        return self.resume or self.redo is not None

    @property
    def _only(self) -> RedoList | None:
        return _read_list(self.positions)


def adapted_facts(found: Adapted) -> dict[str, Any]:
    """Return what ``--json`` says of a session that ends by the error of H."""
    steps = [
        {
            "positions": step.positions,
            "expected_error": step.expected_error,
            "left_out_error": step.held_out_error.value if step.held_out_error.known else None,
            "left_out_limit": step.held_out_error.limit,
            "chi2": step.chi2,
            "complete": step.complete,
            "groups": step.groups,
            "outliers": step.outliers,
        }
        for step in found.steps
    ]
    return {"ended": found.how, "steps": steps}


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return which kind of recording the plan asks for."""
    from lfcal.camera import RegionPlan, ScanPlan

    plan = read_plan(Path(given["plan"]))
    if isinstance(plan, RegionPlan):
        return AcquireRegions
    if not isinstance(plan, ScanPlan):
        return AcquireTarget
    return AcquireUntil if "until_error" in given else Acquire


ACQUIRE = TaskSet(
    "acquire",
    (Acquire, AcquireRegions, AcquireTarget, AcquireUntil),
    kind_of,
    "lfcal acquire plan.json --backend sim --out session/ --assemble H.h5",
)
