"""Record a scan, regions of the field, frames of a target, or positions until H is accurate enough."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Judgement, LfcalError, Work, announce, note, read_text
from lfcal.records import opt, read_names, read_share, record, required, rows_of, show_names, show_planes, value_at
from lfcal.tasks._recording import Cover, check_ready, followed, list_suspects, pairs, stoppable
from lfcal.tasks.cameras import note_assumed
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.acquire import Options, Outcome, RedoList, SessionForecast
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.campaign import Adapted, Goal
    from lfcal.devices import Rig
    from lfcal.frames import Position
    from lfcal.targets import TargetPlan
    from lfcal.tasks.assembly import Assemble, AssembleTarget

__all__ = ["ACQUIRE", "Acquire", "AcquireRegions", "AcquireTarget", "AcquireUntil", "PlannedSession", "RecordedSession"]

TARGET, SESSION = "lfcal-target-plan", "session.json"

NAMES = {"margin": "margin_px", "steady": "steady_s", "tolerance": "tolerance_um", "overshoot": "overshoot_um"}
"""Names of options in a session that contain the unit, by the name of the field."""


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected(
            "numbers", "numbers separated by commas", text, "write them in the form 1,0.25"
        ) from None


NUMBERS: dict[str, Any] = {"read": _numbers, "show": show_planes, "more": True}
"""Attributes of a field with several numbers, as keyword arguments of `opt`."""


def _groups() -> tuple[str, ...]:
    from lfcal.fit import GROUPS

    return ("auto", *GROUPS.names())


def read_plan(path: Path) -> ScanPlan | TargetPlan | RegionPlan:
    """Return the plan of a scan, a target or regions from a plan file, or from the ``session.json`` of a session."""
    from lfcal.base import parse_json
    from lfcal.camera import RegionPlan, ScanPlan

    data = parse_json(read_text(path), "scan plan")
    if path.name == SESSION:
        from lfcal.acquire import SessionFile

        session = SessionFile.read(path.parent)
        return session.target or session.plan  # type: ignore[return-value]  # a session's frame plan is a target's
    if isinstance(data, dict) and data.get("format") == TARGET:
        from lfcal.targets import TargetPlan

        return TargetPlan.from_dict(data)
    return RegionPlan.from_dict(data) if RegionPlan.is_one(data) else ScanPlan.from_dict(data)


@dataclass(frozen=True, kw_only=True)
class PlannedSession(TaskResult):
    """Forecast of a recording into the folder ``out``, from a dry run that moves and writes nothing.

    ``assumed`` lists the paths of the camera's assumed values. ``optics`` states how a simulated camera computes its
    frames; it is empty for a real camera.
    """

    out: Path
    forecast: SessionForecast
    assumed: tuple[str, ...]
    optics: str

    def _values(self) -> dict[str, Any]:
        from lfcal.base import plain

        return {**plain(self.forecast), "assumed": self.assumed}


@dataclass(frozen=True, kw_only=True)
class RecordedSession(TaskResult):
    """A recorded session, which is complete or was stopped by a signal.

    ``ended_by`` is the number of the signal; it has no meaning for a complete session. ``out`` is the folder,
    ``outcome`` states how the recording ended, and ``alarms`` are the alarms raised during it. ``facts`` contains
    observations and output files by name. If the session records until H reaches a target error, ``adapted`` states why
    it ended; otherwise it is None. ``error`` is an error in the assembly or compression of the complete recording, None
    if there is none.
    """

    out: Path
    outcome: Outcome
    facts: Mapping[str, Any]
    alarms: tuple[Any, ...]
    adapted: Adapted | None
    ended_by: int
    error: LfcalError | None

    def exit_code(self) -> int:
        """Return 0 for a complete session, or 128 plus the number of the signal that stopped it.

        If ``error`` is not None, it is raised.
        """
        if self.error is not None:
            announce(f"the recording is complete; make H from it with lfcal assemble {self.out}")
            raise self.error
        return 0 if self.outcome.how == "complete" else 128 + self.ended_by

    def _values(self) -> dict[str, Any]:
        judgement = Judgement.of("recording", self.alarms, "without an alarm")
        return {"session": self.out, "outcome": self.outcome, **self.facts, **judgement.to_dict()}


@record
class _Acquire(Task):
    """Fields of all kinds of recordings."""

    name: ClassVar[str] = "acquire"
    resumes: ClassVar[bool] = True

    plan: Path = required(
        "Plan made by lfcal plan (.json) for a scan, regions of the field or a target; or a session.json.",
        argument=True,
        file="in",
    )
    out: Path = required("Folder for the session.", label="Session folder", short="-o", file="out")
    backend: str = opt(
        "sim",
        "Backend that controls camera and stage; sim is the simulator. lfcal doctor lists all backends.",
        label="Devices",
        short="-b",
    )
    stage: str = opt(
        "",
        "Backend of the stage, if it differs from that of the camera.",
        label="Stage",
        empty="same as the camera",
        more=True,
    )
    option: tuple[str, ...] = opt(
        (), "Setting of the devices, as NAME=VALUE. May be repeated.", label="Device settings", empty="none"
    )
    bracket: str | tuple[float, ...] | None = opt(
        None,
        "Exposures at each position, as multiples of the planned exposure, one of which is 1, such as 1,0.25. They are "
        "merged into one frame of high dynamic range.",
        label="Exposure bracket",
        empty="1",
        **NUMBERS,
    )
    darks: int | None = opt(
        None,
        "Number of frames to average for each dark frame. 0 records no dark frames.",
        label="Dark frames",
        at_least=0,
        empty="8",
    )
    dark_every: int | None = opt(
        None,
        "Interval, in positions, at which dark frames are recorded again. 0 records them only at the start.",
        label="Positions between dark frames",
        at_least=0,
        empty="0",
        more=True,
    )
    cover: bool = opt(
        False,
        "Pause before dark frames, so that you can cover the lens if the light has no switch.",
        label="Pause to cover the lens",
        more=True,
    )
    reference_every: int | None = opt(
        None,
        "Interval, in positions, between reference frames, which show the drift of the lamp. 0 records none.",
        label="Positions between reference frames",
        at_least=0,
        empty="100",
        more=True,
    )
    retries: int | None = opt(
        None, "Number of further attempts after a temporary fault of a device.", at_least=0, empty="2", more=True
    )
    on_suspect: str | None = opt(
        None,
        "Action if a repeated frame still looks wrong. stop: end the recording. flag: mark the position and continue.",
        label="Suspicious frames",
        choices=("stop", "flag"),
        empty="stop",
        more=True,
    )
    allow_automatic: bool = opt(
        False,
        "Record even if the camera controls exposure, gain or black level automatically, or applies a gamma curve.",
        label="Allow automatic settings",
        more=True,
    )
    suspend: tuple[str, ...] = opt(
        (),
        "Pause the recording while a reading is out of bounds: GAUGE=LOW:HIGH, where LOW or HIGH may be omitted. GAUGE "
        "is a gauge of the devices, or a file that ends with the newest number. May be repeated.",
        label="Pause by gauges",
        empty="none",
        more=True,
    )
    steady: float | None = opt(
        None,
        "Time for which all gauges must be within their bounds before the recording continues.",
        label="Steady time",
        unit="s",
        at_least=0,
        empty="30",
        needs=("suspend", ""),
        more=True,
    )
    tolerance: str | tuple[float, ...] | None = opt(
        None,
        "Largest allowed position error X,Y,Z of the stage.",
        unit="µm",
        empty="a tenth of the lateral step; in depth, the full lateral step",
        **NUMBERS,
    )
    overshoot: str | tuple[float, ...] | None = opt(
        None,
        "Distance X,Y,Z over which every position is approached from the same side. 0,0,0 approaches "
        "positions directly.",
        unit="µm",
        empty="20,20,20",
        **NUMBERS,
    )
    keep_free: float | None = opt(
        None,
        "Disk space to keep free.",
        unit="GB",
        at_least=0,
        empty="a tenth of the recording, at least 16 MiB",
        more=True,
    )
    origin: str | tuple[float, ...] | None = opt(
        None,
        "Stage coordinates X,Y,Z at which the source is imaged onto the centre of the sensor.",
        unit="µm",
        empty="as planned",
        **NUMBERS,
    )
    check_stage: bool | None = opt(
        None,
        "Before the scan, measure the directions, the repeatability and the scale of the stage, including the scale in "
        "depth.",
        label="Check the stage",
        empty="yes for a new session, else as before",
        more=True,
    )
    check_origin: bool = opt(
        True,
        "Check the origin of the stage with a new frame of the last position when a session is continued.",
        label="Check the origin",
        more=True,
    )
    assemble: Path | None = opt(
        None, "H file (.h5) to assemble after the recording.", label="H file", file="out", empty="not assembled"
    )
    pack: bool = opt(True, "Compress the finished recording.", label="Compress the recording", more=True)
    dry_run: bool = opt(
        False,
        "Check everything and show the time and disk space, without moving the stage or recording.",
        label="Check only",
    )
    frame_rate: float | None = opt(
        None,
        "Largest frame rate of the camera, used to predict the recording time.",
        unit="frames/s",
        above=0,
        empty="the readout time is ignored",
        needs=("dry_run", ""),
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value, and reject values that would have no effect."""
        super().__post_init__()
        for name, given in (("--dark-every", self.dark_every is not None), ("--cover", self.cover)):
            if self.darks == 0 and given:
                raise InputError.expected(
                    name, "dark frames", "--darks 0", "leave this option out, or record dark frames"
                )
        if isinstance(self.origin, tuple) and len(self.origin) != 3:
            raise InputError.expected(
                "--origin", "X,Y,Z in µm", show_planes(self.origin), "write them in the form 100,-20,1500"
            )

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The folder of the session is not included, because the recording creates or continues it.
        """
        if way == "out":
            return () if self.assemble is None else (self.assemble,)
        return (*super().files("in"), self.out)

    def options(self, session: Path | None = None) -> Options:
        """Return the options with which ``session`` began, or the defaults, updated by those that are given."""
        from lfcal.acquire import Options, SessionFile

        values = {NAMES.get(row.name, row.name): (value_at(self, row), row.default) for row in rows_of(self)}
        given = {name: value for name, (value, default) in values.items() if value != default}
        if self.keep_free is not None:
            given["keep_free_bytes"] = int(1e9 * self.keep_free)
        if not self.check_origin:
            given["origin_tolerance_px"] = None
        base = Options() if session is None else SessionFile.read(session).options
        return replace(base, **{one.name: given[one.name] for one in fields(Options) if one.name in given})

    def iter_session(self, plan: Any, rig: Rig, options: Options, **how: Any) -> Any:
        """Record with open devices; takes the arguments of `lfcal.acquire.iter_record`, and returns its generator."""
        from lfcal.acquire import RedoList, iter_record

        again, only = self._listed("redo"), self._listed("positions")
        return iter_record(
            self.out,
            plan,
            rig,
            options,
            redo=None if again is None else again.positions,
            only=None if only is None else only.positions,
            kept_aside=(again or only or RedoList((), ())).kept_aside,
            task=self._kept,
            **how,
        )

    @property
    def _kept(self) -> dict[str, Any]:
        """The entries of the task that are stored in the session."""
        return self.to_dict(absolute=True, outputs=False)

    def _listed(self, name: str) -> RedoList | None:
        """Return the positions in the file that a field names; None if it names none."""
        from lfcal.acquire import RedoList

        path = self._given(name)
        return None if path is None else RedoList.read(path)

    def _given(self, name: str) -> Any:
        """Return the value of the field ``name``; None if this class has no such field."""
        return next((value_at(self, row) for row in rows_of(self) if row.name == name), None)

    def _plan(self) -> Any:
        """Return the plan, with the stage origin of the task if it is given."""
        found: Any = read_plan(self.plan)
        if self.origin is None:
            return found
        origin: Any = self.origin
        scan = replace(found.scan, stage=replace(found.scan.stage, origin_um=origin))
        return scan if scan.__class__ is found.__class__ else replace(found, scan=scan)

    def _devices(self, plan: Any) -> dict[str, str]:
        return pairs(self.option)

    def _begun(self, run: RunSettings) -> Path | None:
        """Return the session whose options apply: the one to continue; None for a new one."""
        return self.out if run.resume or self._given("redo") is not None else None

    def work(self, run: RunSettings | None = None) -> Work[tuple[TaskResult, ...]]:
        """Record until the scan is complete or a signal is received; with `dry_run`, only predict the cost.

        From a complete recording, H is assembled if requested. The recording is then compressed, unless `pack` is off.
        """
        from lfcal.acquire import Control, optics_of
        from lfcal.devices import open_rig

        run = run or RunSettings()
        plan, begun = self._plan(), self._begun(run)
        scan: ScanPlan = plan.scan
        devices = self._devices(plan)
        note_assumed(scan.camera, "plan", light=False)
        options = self.options(begun)
        assumed = tuple(scan.camera.marks.paths("assumed"))
        with open_rig(scan, self.backend, devices, stage=self.stage) as rig:
            optics = optics_of(rig)
            # with a switchable light, the lens need not be covered.
            if self.cover and rig.light is None:
                rig = replace(rig, light=Cover())
            if self.dry_run:
                forecast = self._forecast(plan, rig, options)
                return (PlannedSession(out=self.out, forecast=forecast, assumed=assumed, optics=optics),)
            check_ready(scan, rig, options, resumed=run.resume, begun=begun is not None)
            control = Control()
            observers, seen = self._watching(plan, options, begun)
            how = {"resume": run.resume, "control": control, "observers": observers}
            with stoppable(control) as asked:
                work = self.iter_session(plan, rig, options, **how)
                found = yield from followed(work, control, lambda: seen()["alarms"])
        facts: dict[str, Any] = {"optics": optics} if optics else {}
        facts |= {**seen(), "assumed": assumed}
        return ((yield from self._iter_ended(found, facts, next(iter(asked), signal.SIGINT), run)),)

    def _watching(self, plan: Any, options: Options, begun: Path | None) -> tuple[Any, Callable[[], dict[str, Any]]]:
        """Return the observers of a recording, and a function that returns the facts they collected."""
        from lfcal.acquire import LiveQuality, window_shape

        quality = LiveQuality(plan, window_shape(plan, options))
        if begun is not None:
            quality.remember(begun)
        return (quality,), lambda: {"alarms": quality.state().alarms}

    def _iter_ended(self, found: Any, facts: dict[str, Any], ended_by: int, run: RunSettings) -> Work[RecordedSession]:
        """Return the result of a recording; assemble and compress a complete session before, as requested."""
        from lfcal.acquire import Outcome

        adapted, outcome = (None, found) if isinstance(found, Outcome) else (found, found.outcome)
        alarms = tuple(facts.pop("alarms"))
        facts |= self._suspects(outcome) | (adapted.to_dict() if adapted else {})
        error: LfcalError | None = None
        if outcome.how == "complete":
            try:
                facts |= {} if self.assemble is None else (yield from self._iter_assembled(self.assemble, run))
                facts |= (yield from self._iter_packed()) if self.pack else {}
            except LfcalError as caught:  # the frames are complete even if H failed
                error = caught
        known: dict[str, Any] = {"facts": facts, "alarms": alarms, "adapted": adapted, "error": error}
        return RecordedSession(out=self.out, outcome=outcome, ended_by=ended_by, **known)

    def _suspects(self, outcome: Outcome) -> dict[str, Any]:
        return list_suspects(self.out, outcome)

    def _iter_assembled(self, out: Path, run: RunSettings) -> Work[dict[str, Any]]:
        """Assemble H of the session; return facts about it by name."""
        (made,) = yield from self._assembly(out).work(run)
        with made.report.matrix as matrix:
            found = {"H": out, "shape": matrix.shape, "saturated_positions": made.report.saturated}
        return found if made.facts is None else found | {"target": made.facts}

    def _assembly(self, out: Path) -> Assemble | AssembleTarget:
        from lfcal.acquire import SessionFile
        from lfcal.records import AssemblySettings
        from lfcal.tasks.assembly import Assemble

        # a complete session has every position once: a gap would be a defect, which must not be filled silently.
        settings = AssemblySettings(strict=not SessionFile.read(self.out).redo[0])
        return Assemble(frames=self.out, out=out, settings=settings)

    def _sessions(self) -> Iterable[Path]:
        return (self.out,)

    def _iter_packed(self) -> Work[dict[str, Any]]:
        """Compress the recordings; return the number of bytes saved as the fact ``bytes_gained``."""
        from lfcal.acquire import iter_finish

        gained = 0
        for folder in self._sessions():
            packed = yield from iter_finish(folder)
            gained += packed.bytes_gained
            for one in packed.left:
                note(one)
        return {"bytes_gained": gained}

    def _forecast(self, plan: Any, rig: Rig, options: Options) -> SessionForecast:
        from lfcal.acquire import forecast

        return forecast(plan, rig, options, self.out, only=self._places(plan), frames_per_s=self.frame_rate)

    def _places(self, plan: Any) -> tuple[Position, ...]:
        """Return the positions that a forecast includes; empty: all."""
        only = self._listed("positions")
        return () if only is None else only.positions


def _again() -> Path | None:
    return opt(
        None,
        "List of positions (.json) to record again, or to add, from lfcal inspect, lfcal verify or lfcal plan fit.",
        label="Positions to record again",
        file="in",
        empty="none",
    )


@record
class AcquireTarget(_Acquire):
    """Record the frames of a target of many points."""

    input_words: ClassVar[str] = "a target of many points"

    redo: Path | None = _again()

    def _devices(self, plan: Any) -> dict[str, str]:
        """Return the options of the devices; the simulator gets the planned target unless another is named."""
        if plan.lit is not None and self.backend != "sim":
            remedy = "show its images (lfcal plan target --patterns), record them, and assemble the folder of frames"
            raise InputError.expected(
                str(self.plan), "a target that is moved by a stage", "a plan for a display", remedy
            )
        planned = {"target": str(self.plan)} if self.backend == "sim" else {}
        return planned | pairs(self.option)

    def _watching(self, plan: Any, options: Options, begun: Path | None) -> tuple[Any, Callable[[], dict[str, Any]]]:
        from lfcal.acquire import LiveCoverage

        coverage = LiveCoverage(plan, begun)
        if begun is not None:
            coverage.remember(begun)

        def seen() -> dict[str, Any]:
            state = coverage.state()
            return {"alarms": state.alarms, "shown": state.to_dict()}

        return (coverage,), seen

    def _assembly(self, out: Path) -> Assemble | AssembleTarget:
        from lfcal.tasks.assembly import AssembleTarget

        # missing or displaced holes leave positions without a point, so gaps are allowed
        return AssembleTarget(frames=self.out, out=out)


@record
class _AcquireScan(_Acquire):
    """Fields of recordings of single points."""

    order: str | None = opt(
        None,
        "Order of the positions. plan: as planned. coarse: first a few positions of all planes, then the "
        "positions between them.",
        choices=("plan", "coarse"),
        empty="plan",
    )
    margin: int | None = opt(
        None,
        "Number of pixels to record around the cutout on each side.",
        unit="px",
        at_least=0,
        empty="12 if the anchor is between pixels or frames are resampled, else 0",
        more=True,
    )
    controls: int | None = opt(
        None,
        "Largest number of control frames for each plane and direction. They are recorded a whole number of "
        "periods away from the scan, and show whether H is periodic.",
        label="Control frames",
        at_least=0,
        empty="0",
        more=True,
    )


@record
class AcquireRegions(_AcquireScan):
    """Record several regions of the field in one session."""

    input_words: ClassVar[str] = "several regions"

    def _begun(self, run: RunSettings) -> Path | None:
        from lfcal.campaign import first_begun, is_regions

        # the recording itself refuses any session that does not consist of regions
        return first_begun(self.out) if run.resume and is_regions(self.out) else None

    def iter_session(self, plan: Any, rig: Rig, options: Options, **how: Any) -> Any:
        """Record every region of ``plan``; ``how`` are keyword arguments of `lfcal.campaign.iter_record_regions`."""
        from lfcal.campaign import iter_record_regions

        return iter_record_regions(self.out, plan, rig, options, task=self._kept, **how)

    def _watching(self, plan: Any, options: Options, begun: Path | None) -> tuple[Any, Callable[[], dict[str, Any]]]:
        from lfcal.acquire import LiveQuality, window_shape

        watched: dict[str, LiveQuality] = {}

        def watching(k: int) -> tuple[LiveQuality]:
            watched[plan.names[k]] = LiveQuality(plan.plan(k), window_shape(plan.plan(k), options))
            return (watched[plan.names[k]],)

        def seen() -> dict[str, Any]:
            found = [(name, alarm) for name, quality in watched.items() for alarm in quality.state().alarms]
            named = tuple(replace(alarm, remedy=f"{alarm.remedy} (region {name})") for name, alarm in found)
            return {"alarms": named, "regions": plan.names}

        return watching, seen

    def _suspects(self, outcome: Outcome) -> dict[str, Any]:
        return {}

    def _forecast(self, plan: Any, rig: Rig, options: Options) -> SessionForecast:
        from lfcal.campaign import forecast_regions

        return forecast_regions(plan, rig, options, self.out, frames_per_s=self.frame_rate)

    def _iter_assembled(self, out: Path, run: RunSettings) -> Work[dict[str, Any]]:
        from lfcal.records import AssemblySettings
        from lfcal.tasks.assembly import AssembleRegions

        made = yield from AssembleRegions(frames=self.out, out=out, settings=AssemblySettings(strict=True)).work(run)
        return {"H": out, "shape": made[0].report.matrix.shape}

    def _sessions(self) -> Iterable[Path]:
        from lfcal.campaign import region_sessions

        return (folder for _, folder in region_sessions(self.out))


@record
class AcquireUntil(_AcquireScan):
    """Record positions of a scan, fit, and choose the next ones, until H is accurate enough.

    Examples
    --------
    >>> from lfcal.tasks import AcquireUntil
    >>> task = AcquireUntil(plan="session/plan.json", out="new", until_error="0.5%", most=60)
    >>> print(task.until_error, task.unknowns)
    0.005 ()
    """

    input_words: ClassVar[str] = "a scan until H is good enough (--until-error)"

    until_error: float = required(
        "Record, fit and choose the next positions until the error of H is at most this value, such as 0.5%.",
        label="Error of H",
        read=read_share,
    )
    most: int | None = opt(
        None,
        "Largest number of positions. 0 allows all positions of the plan.",
        label="Largest number of positions",
        at_least=0,
        empty="all of the plan",
    )
    unknowns: str | tuple[str, ...] = opt(
        (),
        "Groups of unknowns to fit, separated by commas. auto: the groups that reduce the error of held-out patterns.",
        choices=_groups,
        read=read_names,
        show=show_names,
        empty="auto",
    )

    def __post_init__(self) -> None:
        """Check every value, including those of the fit."""
        super().__post_init__()
        self.goal  # noqa: B018 it is checked

    @property
    def goal(self) -> Goal:
        """Target error of H, largest number of positions, and groups of unknowns to fit."""
        from lfcal.campaign import Goal

        groups: Any = "auto" if self.unknowns in ((), ("auto",)) else self.unknowns
        return Goal(self.until_error, most=self.most or None, unknowns=groups)

    def iter_session(self, plan: Any, rig: Rig, options: Options, **how: Any) -> Any:
        """Record until `goal` is reached or the plan is complete.

        ``how`` are keyword arguments of `lfcal.campaign.iter_adaptive`.
        """
        from lfcal.campaign import iter_adaptive

        how = {"seen": lambda step: announce(str(step)), **how}
        return iter_adaptive(self.out, plan, rig, self.goal, options, task=self._kept, **how)

    def _places(self, plan: Any) -> tuple[Position, ...]:
        from lfcal.frames import Position

        note(
            "the forecast is for the largest number of positions; the session ends earlier if H reaches the target "
            "error"
        )
        most = self.most or plan.n_positions
        return tuple(Position(*place) for place in plan.order_indices()[:most].tolist())


@record
class Acquire(_AcquireScan):
    """Record a frame at each position of a plan; a crash loses no completed frame.

    Dark frames are taken first, with the light switched off. Ctrl-C stops after the current position, a second Ctrl-C
    immediately. `--resume` continues the session.

    Examples
    --------
    >>> from lfcal.tasks import Acquire, AcquireRegions, AcquireTarget
    >>> task = Acquire(plan="session/plan.json", out="new", darks=0, dry_run=True, option=("optics=pattern",))
    >>> (planned,) = task.run()
    >>> print(planned.forecast.positions, "positions")
    1254 positions
    >>> others = AcquireRegions(plan="regions.json", out="new"), AcquireTarget(plan="target.json", out="new")
    """

    input_words: ClassVar[str] = "a scan of one region"

    redo: Path | None = _again()
    positions: Path | None = opt(
        None,
        "Record only the positions in this list (from lfcal plan fit or lfcal plan).",
        label="Positions",
        file="in",
        empty="all positions of the plan",
    )

    def __post_init__(self) -> None:
        """Check every value, and that a list of positions is given only for a new session."""
        super().__post_init__()
        self._begun(RunSettings())

    def _begun(self, run: RunSettings) -> Path | None:
        begun = super()._begun(run)
        if self.positions is not None and begun is not None:
            got, remedy = (
                "--redo" if self.redo else "--resume",
                "leave --positions out; --redo records further positions",
            )
            raise InputError.expected("--positions", "a new session", got, remedy)
        return begun


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that records the plan in the file ``given["plan"]``."""
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
