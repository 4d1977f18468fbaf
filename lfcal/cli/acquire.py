"""``lfcal acquire``: record a session from plan to H without a window."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from lfcal.cli._acquire_outcome import list_suspects, show_outcome, simulated_optics, simulated_words
from lfcal.cli._acquire_until import adapted_facts, parse_goal, show_adapted, tell_step
from lfcal.cli._acquire_words import numbers, options_of, pairs, read_plan, reported_holds
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption
from lfcal.tasks import WITHOUT_READOUT

if TYPE_CHECKING:
    from lfcal.acquire import Control, LiveCoverage, LiveQuality, Options, Outcome, RedoList
    from lfcal.base import Work
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.campaign import Adapted, Goal
    from lfcal.devices import Rig
    from lfcal.targets import TargetPlan

R = TypeVar("R")
ALARM_EVERY_S = 5.0


def register(app: typer.Typer) -> None:
    """Add ``acquire`` to the app."""
    app.command("acquire")(command)


def command(
    context: typer.Context,
    plan: Path = typer.Argument(help="Plan of a scan or of a target (.json), made with lfcal plan."),
    *,
    out: Path = typer.Option(..., "--out", "-o", help="Session folder."),
    backend: str = typer.Option("sim", "--backend", "-b", help="Devices; lfcal doctor lists them."),
    stage: str = typer.Option("", "--stage", help="Backend of the stage, if it is another one."),
    option: list[str] = typer.Option([], "--option", help="Option of the backend, NAME=VALUE; may be repeated."),
    resume: bool = typer.Option(False, "--resume", help="Go on where an interrupted session was."),
    redo: Path | None = typer.Option(
        None, "--redo", help="Record these positions again, or further ones (list from lfcal inspect or lfcal plan)."
    ),
    positions: Path | None = typer.Option(
        None, "--positions", help="Record these positions and no others (list from lfcal plan fit)."
    ),
    until_error: str = typer.Option(
        "", "--until-error", help="Record, fit, choose the next positions, until H is this good, e.g. 0.5%."
    ),
    most: int = typer.Option(0, "--most", min=0, help="With --until-error: positions at most; 0: all of the plan."),
    unknowns: str = typer.Option("", "--unknowns", help="With --until-error: groups A,B,C, or auto (default)."),
    order: str | None = typer.Option(None, "--order", help="plan, or coarse for a first look at all planes."),
    bracket: str | None = typer.Option(None, "--bracket", help="Exposures as factors, merged to HDR, e.g. 1,0.25."),
    margin: int | None = typer.Option(None, "--margin", help="Pixels kept around the cutout."),
    darks: int | None = typer.Option(
        None, "--darks", help="Frames averaged into each dark frame (default 8); 0: none."
    ),
    dark_every: int | None = typer.Option(None, "--dark-every", help="Darks every so many positions; 0: at the start."),
    cover: bool = typer.Option(False, "--cover", help="Ask to cover the lens for dark frames: no light to switch."),
    reference_every: int | None = typer.Option(
        None, "--reference-every", help="Lamp-drift frame every so many positions (default 100); 0: none."
    ),
    controls: int | None = typer.Option(None, "--controls", help="Control frames per plane and direction."),
    retries: int | None = typer.Option(None, "--retries", help="Further attempts after a transient fault."),
    on_suspect: str | None = typer.Option(
        None, "--on-suspect", help="Frames whose content stays suspicious: stop (default), or flag the position."
    ),
    allow_automatic: bool = typer.Option(
        False,
        "--allow-automatic",
        help="Record although the camera's exposure, gain or black level stays automatic, or its gamma on.",
    ),
    suspend: list[str] = typer.Option(
        [],
        "--suspend",
        help="Hold while a gauge, or the last number of a file, is out of bounds: GAUGE=LOW:HIGH; may be repeated.",
    ),
    steady: float | None = typer.Option(
        None, "--steady", help="With --suspend: seconds within bounds before going on."
    ),
    tolerance: str | None = typer.Option(None, "--tolerance", help="Position tolerance X,Y,Z (µm)."),
    overshoot: str | None = typer.Option(
        None, "--overshoot", help="Approach from one side, X,Y,Z (µm); 0,0,0 for none."
    ),
    keep_free: float | None = typer.Option(
        None, "--keep-free", min=0, help="Disk space that stays free (GB); by default a tenth of the recording."
    ),
    origin: str = typer.Option("", "--origin", help="Stage coordinates of the sensor's centre X,Y,Z (µm)."),
    check_stage: bool | None = typer.Option(
        None, "--check-stage/--no-check-stage", help="Measure sign, scale, scatter and depth of the stage first (on)."
    ),
    check_origin: bool = typer.Option(True, help="On resume, compare the last position with its frame."),
    assemble: Path | None = typer.Option(None, "--assemble", help="Assemble H into this file at the end (.h5)."),
    pack: bool = typer.Option(True, help="Compress the finished recording."),
    dry_run: bool = typer.Option(False, "--dry-run", help="Check everything and say what it will cost; move nothing."),
    frame_rate: float | None = typer.Option(
        None, "--frame-rate", help="Largest frame rate of the camera (frames/s); without it readout is not counted."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Move the point source through a scan plan and record a frame at each position, safe against any crash.

    Dark frames are taken first, with the light switched off. Ctrl-C ends after the position under way, a second one at
    once; `--resume` goes on.

    Example: `lfcal acquire plan.json --backend sim --out session/ --assemble H.h5`
    """
    from lfcal.acquire import Outcome, RedoList
    from lfcal.base import InputError, LfcalError
    from lfcal.camera import RegionPlan
    from lfcal.cli._acquire_regions import check_region_options
    from lfcal.cli._acquire_target import check_target_options, simulated_options
    from lfcal.cli._console import report
    from lfcal.cli._usage import refuse
    from lfcal.devices import open_rig
    from lfcal.tasks import check_output, tell_assumed

    if frame_rate is not None and not dry_run:
        raise InputError("--frame-rate: is for the time that --dry-run tells; leave it out, or add --dry-run")
    if assemble is not None:
        check_output(assemble, plan, redo, positions, out, force=force)
    if positions is not None and (resume or redo is not None):
        raise InputError("--positions: is of a new session; one that goes on has its own, and --redo adds to them")
    if not suspend:
        refuse(context, "--suspend", "none", "steady")
    if darks == 0:
        refuse(context, "dark frames", "--darks 0", "dark_every", "cover")
    goal = parse_goal(until_error, most, unknowns)
    if goal is not None and (positions is not None or redo is not None):
        raise InputError("--until-error: chooses positions itself; leave --positions and --redo out")
    recorded = read_plan(plan, origin)
    scan = recorded.scan
    single = {
        "--positions": positions is not None,
        "--until-error": goal is not None,
        "--order": order == "coarse",
        "--controls": bool(controls),
        "--margin": margin is not None,
    }
    sim: dict[str, str] = pairs(option)
    if isinstance(recorded, RegionPlan):
        one = {"--redo": redo is not None, "--positions": positions is not None, "--until-error": goal is not None}
        check_region_options(one)
    else:
        check_target_options(recorded, single)
        sim = simulated_options(recorded, plan, backend, sim)
    tell_assumed(scan.camera, plan.name, quiet=json)
    given = {
        "order": order,
        "bracket": numbers(bracket, "--bracket"),
        "margin_px": margin,
        "darks": darks,
        "dark_every": dark_every,
        "reference_every": reference_every,
        "controls": controls,
        "retries": retries,
        "on_suspect": on_suspect,
        "allow_automatic": allow_automatic or None,
        "suspend": tuple(suspend) or None,
        "steady_s": steady,
        "tolerance_um": numbers(tolerance, "--tolerance"),
        "overshoot_um": numbers(overshoot, "--overshoot"),
        "keep_free_bytes": None if keep_free is None else int(1e9 * keep_free),
        "check_stage": check_stage,
    }
    # a session that goes on keeps the options it began with; those given now replace single ones.
    options = options_of(out if resume or redo is not None else None, given, check_origin)
    again, only = (None if path is None else RedoList.read(path) for path in (redo, positions))
    task = _Task(out, recorded, options, resume, again, only, goal, json)
    with open_rig(scan, backend, sim, stage=stage) as rig:
        optics = simulated_optics(rig)
        # a light that can be switched needs nobody to cover the lens, whatever was asked for.
        if cover and rig.light is None:
            rig = replace(rig, light=_Cover())
        if dry_run:
            _show_forecast(task, rig, frame_rate)
            return
        found, seen, ended_by = _run(task, rig)
    adapted = None if isinstance(found, Outcome) else found
    outcome = found if isinstance(found, Outcome) else found.outcome
    result: dict[str, Any] = {"session": out, "outcome": outcome, **optics, **seen}
    if not isinstance(recorded, RegionPlan):
        result |= list_suspects(out, outcome)
    result["assumed"] = scan.camera.marks.paths("assumed")
    result |= {} if adapted is None else adapted_facts(adapted)
    if outcome.how == "complete":
        try:
            result |= _ending(recorded)(out, assemble, pack, json)
        except LfcalError:
            # the frames are safe whatever became of H
            show_outcome(result, outcome, out, json)
            report(f"the recording is whole: lfcal assemble {out} makes H of it")
            raise
    show_outcome(result, outcome, out, json)
    if adapted is not None and not json:
        show_adapted(adapted, out)
    if outcome.how != "complete":
        # a session that was stopped is not a success: scripts must be able to see it.
        raise typer.Exit(128 + ended_by)


def _ending(plan: ScanPlan | TargetPlan | RegionPlan) -> Callable[[Path, Path | None, bool, bool], dict[str, Any]]:
    """Return what is done after the last frame of such a session."""
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.cli._acquire_outcome import finish
    from lfcal.cli._acquire_regions import finish_regions
    from lfcal.cli._assemble_target import finish_target

    if isinstance(plan, ScanPlan):
        return finish
    return finish_regions if isinstance(plan, RegionPlan) else finish_target


@dataclass(frozen=True)
class _Task:
    """A session to record: where, by which plan, how, and what of it."""

    out: Path
    plan: ScanPlan | TargetPlan | RegionPlan
    options: Options
    resume: bool
    redo: RedoList | None
    only: RedoList | None
    goal: Goal | None
    quiet: bool


def _run(task: _Task, rig: Rig) -> tuple[Outcome | Adapted, dict[str, Any], int]:
    """Check the light, then record until the end or a signal; return what came of it and was seen, and the signal."""
    from lfcal.acquire import Control, check_light
    from lfcal.cli._acquire_words import tell_automatic

    tell_automatic(task.plan, rig, task.options, goes_on=task.resume)
    # a session that goes on has its darks already, and its positions are compared with the frames themselves.
    if task.options.darks and not task.resume and task.redo is None:
        check_light(rig)
    control = Control()
    with _stoppable(control) as asked:
        outcome, seen = _record(task, rig, control)
    return outcome, seen, next(iter(asked), signal.SIGINT)


def _record(task: _Task, rig: Rig, control: Control) -> tuple[Outcome | Adapted, dict[str, Any]]:
    from lfcal.acquire import LiveQuality, QualityState, RedoList, iter_record, window_shape
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.cli._acquire_regions import record_regions
    from lfcal.cli._acquire_target import coverage_facts, recorded_before
    from lfcal.cli._console import run_work

    if isinstance(task.plan, RegionPlan):
        how = {"resume": task.resume, "quiet": task.quiet}
        return record_regions(task.plan, task.out, rig, task.options, control, **how)
    quality: LiveQuality | LiveCoverage
    if isinstance(task.plan, ScanPlan):
        quality = LiveQuality(task.plan, window_shape(task.plan, task.options))
    else:
        quality = recorded_before(task.plan, task.out if task.resume or task.redo is not None else None)
    if task.goal is not None:
        return _adapted(task, rig, control, quality), {"alarms": quality.state().alarms}
    work = iter_record(
        task.out,
        task.plan,
        rig,
        task.options,
        resume=task.resume,
        redo=None if task.redo is None else task.redo.positions,
        only=None if task.only is None else task.only.positions,
        kept_aside=(task.redo or task.only or RedoList((), ())).kept_aside,
        control=control,
        observers=(quality,),
    )
    outcome = run_work(_watched(reported_holds(work, control), quality), quiet=task.quiet)
    state = quality.state()
    more = {} if isinstance(state, QualityState) else {"shown": coverage_facts(state)}
    return outcome, {"alarms": state.alarms, **more}


def _adapted(task: _Task, rig: Rig, control: Control, quality: LiveQuality | LiveCoverage) -> Adapted:
    from lfcal.campaign import iter_adaptive
    from lfcal.cli._console import run_work

    assert task.goal is not None
    work = iter_adaptive(
        task.out,
        task.plan.scan,
        rig,
        task.goal,
        task.options,
        resume=task.resume,
        control=control,
        observers=(quality,),
        seen=(lambda _: None) if task.quiet else tell_step,
    )
    return run_work(_watched(reported_holds(work, control), quality), quiet=task.quiet)


def _watched(work: Work[R], quality: LiveQuality | LiveCoverage) -> Work[R]:
    """Yield the progress of ``work``, and report every alarm once while there is time to act on it."""
    from lfcal.cli._console import report

    reported: set[str] = set()
    look = time.monotonic() + ALARM_EVERY_S
    while True:
        try:
            record = next(work)
        except StopIteration as stop:
            result: R = stop.value
            return result
        if time.monotonic() > look:
            look = time.monotonic() + ALARM_EVERY_S
            for alarm in quality.state().alarms:
                if alarm.kind not in reported:
                    reported.add(alarm.kind)
                    report(alarm.line)
        yield record


@contextmanager
def _stoppable(control: Control) -> Iterator[list[int]]:
    """Let Ctrl-C, a hang-up and the request to terminate stop in order, a second one abort; yield those that came."""
    from lfcal.cli._console import report

    came: list[int] = []

    def asked(number: int, _: object) -> None:
        came.append(number)
        if control.stopping:
            control.abort()
        else:
            control.stop()
            report("stopping after this position; Ctrl-C again stops at once")

    # Windows has no hang-up
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), asked) for name in names}
    try:
        yield came
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


class _Cover:
    """A person who covers the lens, in place of a light that can be switched."""

    waits = False  # no driver: a person may take any time

    def switch(self, on: bool) -> None:
        """Ask for it and wait for the Enter key."""
        from lfcal.cli._console import report
        from lfcal.devices import DeviceError

        report(f"{'uncover' if on else 'cover'} the lens, then press Enter")
        # end of input: without a person, the frames would be taken of a lens that is not covered.
        if not sys.stdin.readline():
            raise DeviceError("lens cover: nobody answered; run in a terminal, or record without darks (--darks 0)")


def _show_forecast(task: _Task, rig: Rig, frame_rate: float | None) -> None:
    from lfcal.acquire import forecast
    from lfcal.base import format_bytes, format_seconds, plain
    from lfcal.camera import RegionPlan
    from lfcal.cli._acquire_regions import forecast_regions
    from lfcal.cli._console import print_json, print_table, report
    from lfcal.frames import Position

    only: tuple[Position, ...] = () if task.only is None else task.only.positions
    if task.goal is not None:
        scan = task.plan.scan
        most = task.goal.most or scan.n_positions
        only = tuple(Position(*place) for place in scan.order_indices()[:most].tolist())
        report("note: at most so much: the session ends when the wanted error of H is reached")
    if isinstance(task.plan, RegionPlan):
        found = forecast_regions(task.plan, rig, task.options, task.out, frame_rate)
    else:
        found = forecast(task.plan, rig, task.options, task.out, only=only, frames_per_s=frame_rate)
    if task.quiet:
        print_json(plain(found) | {"assumed": task.plan.scan.camera.marks.paths("assumed")})
        return
    unread = f" {WITHOUT_READOUT}" if found.readout_seconds is None else ""
    optics = [["frames", simulated_words(optics)] for optics in simulated_optics(rig).values()]
    rows = [
        *optics,
        ["positions", f"{found.positions}"],
        ["other frames (dark, reference, control)", f"{found.other_frames}"],
        ["time at least", format_seconds(found.seconds) + unread],
        ["recording", format_bytes(found.recording_bytes)],
        ["free on the disk", format_bytes(found.free_bytes)],
        ["camera", found.camera],
        ["stage", found.stage],
    ]
    print_table(["what", "value"], rows, title=f"{task.out}: nothing was moved or written")
