"""How a recording is watched, stopped and finished, whatever its plan is."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lfcal.base import InputError, LfcalError, Work
from lfcal.tasks.notes import note, tell

if TYPE_CHECKING:
    from lfcal.acquire import Control, CoverageState, LiveCoverage, LiveQuality, Options, Outcome
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.devices import Rig
    from lfcal.targets import TargetPlan

__all__ = [
    "Cover",
    "coverage_facts",
    "iter_finished",
    "list_suspects",
    "pairs",
    "recorded_before",
    "reported_holds",
    "simulated_optics",
    "simulated_options",
    "stoppable",
    "tell_automatic",
    "watched",
]

R = TypeVar("R")
ALARM_EVERY_S = 5.0
SUSPECTS = "suspects.json"


def pairs(options: tuple[str, ...]) -> dict[str, str]:
    """Return the options of a backend, written as NAME=VALUE."""
    found = {}
    for text in options:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError.expected("--option", "NAME=VALUE", text, "correct it")
        found[key.strip()] = value.strip()
    return found


def simulated_options(plan: TargetPlan, path: Path, backend: str, options: dict[str, str]) -> dict[str, str]:
    """Return the options of the backend, with the planned target before the simulator unless another is named."""
    if plan.lit is not None and backend != "sim":
        remedy = "show its pictures (lfcal plan target --patterns), and assemble the folder of frames"
        raise InputError.expected(str(path), "a target that a stage moves", "frames of a display", remedy)
    if backend != "sim" or "target" in options:
        return options
    return {**options, "target": str(path)}


def simulated_optics(rig: Rig) -> dict[str, str]:
    """Return how frames of the simulator are computed, as the session records it; nothing for real devices."""
    from lfcal.acquire import optics_of

    optics = optics_of(rig)
    return {"optics": optics} if optics else {}


def tell_automatic(plan: ScanPlan | TargetPlan | RegionPlan, rig: Rig, options: Options, *, resumed: bool) -> None:
    """Refuse a camera that changes samples automatically before anything moves, or report what is allowed to stay so.

    A session that continues is compared with its own camera settings first, which gives the clearer message.
    """
    from lfcal.acquire import check_devices, check_fixed

    devices = check_devices(plan.scan, rig)
    if not resumed:
        check_fixed(devices, options)
    if devices.automatic and options.allow_automatic:
        note(f"{devices.automatic_words}: frames may not be proportional to light, and H with them")


class Cover:
    """A person who covers the lens, in place of a light that can be switched."""

    waits = False  # no driver: a person may take any time

    def switch(self, on: bool) -> None:
        """Ask for it and wait for the Enter key."""
        from lfcal.devices import DeviceError

        tell(f"{'uncover' if on else 'cover'} the lens, then press Enter")
        # end of input: without a person, the frames would be taken of a lens that is not covered.
        if not sys.stdin.readline():
            raise DeviceError("lens cover: nobody answered; run in a terminal, or record without darks (--darks 0)")


@contextmanager
def stoppable(control: Control) -> Iterator[list[int]]:
    """Let Ctrl-C, a hang-up and the request to terminate stop in order, a second one abort; yield those that came."""
    came: list[int] = []

    def asked(number: int, _: object) -> None:
        came.append(number)
        if control.stopping:
            control.abort()
        else:
            control.stop()
            tell("stopping after this position; Ctrl-C again stops at once")

    before = {}
    if threading.current_thread() is threading.main_thread():
        # Windows has no hang-up
        names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        before = {name: signal.signal(getattr(signal, name), asked) for name in names}
    try:
        yield came
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def watched(work: Work[R], quality: LiveQuality | LiveCoverage) -> Work[R]:
    """Yield the progress of ``work``, and report every alarm once while there is time to act on it."""
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
                    tell(alarm.line)
        yield record


def reported_holds(work: Work[R], control: Control) -> Work[R]:
    """Pass on a recording; what was not checked, and each hold and its end, is told."""
    from lfcal.acquire.setup import STAGE

    held = ""
    try:
        while True:
            record = next(work)
            # of a wait that counts down the words before the figures stay
            if control.held.partition(":")[0] != held.partition(":")[0]:
                tell(f"on hold: {control.held}" if control.held else "recording again")
                held = control.held
            if record.stage == STAGE and record.note:
                note(record.note)
            yield record
    except StopIteration as stop:
        found: R = stop.value
        return found
    finally:
        work.close()


def recorded_before(plan: TargetPlan, folder: Path | None) -> LiveCoverage:
    """Return what watches a session of a target, with the frames that a session in ``folder`` has already."""
    from lfcal.acquire import LiveCoverage, TargetRecording

    watching = LiveCoverage(plan)
    if folder is not None:
        # a session that was stopped before its first frame has none to open
        with suppress(LfcalError), TargetRecording(folder, skip_damaged=True) as source:
            if source.target == plan:
                for z, k in source.frames:
                    watching.know(z, k)
    return watching


def coverage_facts(state: CoverageState) -> dict[str, Any]:
    """Return what a session of a target shows, for scripts."""
    return {
        "frames": state.done,
        "coverage": state.coverage,
        "coverage_of_planes": [float((plane > 0).mean()) for plane in state.shown],
        "mean_repeats": float(state.shown.mean()),
    }


def list_suspects(out: Path, outcome: Outcome) -> dict[str, Any]:
    """Write the list of suspect positions into the session's folder; return it, and where it is, if there are any."""
    from lfcal.acquire import read_suspects

    path = out / SUSPECTS
    found = read_suspects(out) if outcome.acknowledged else None
    if found is None or not found.positions:
        path.unlink(missing_ok=True)  # of an earlier run: recorded again since
        return {}
    found.write(path)
    return {"suspects": found, "redo": path}


def iter_finished(out: Path, assemble: Path | None, pack: bool) -> Work[dict[str, Any]]:
    """Assemble H of a complete session, and pack its recording, as asked for; return what was made."""
    from lfcal.acquire import SessionFile, iter_assemble_session, iter_finish
    from lfcal.psf import AssemblySettings

    result: dict[str, Any] = {}
    if assemble is not None:
        # a complete session has every position once: a gap would be a defect, and is not to be filled quietly.
        settings = AssemblySettings(strict=not SessionFile.read(out).redo[0])
        made = yield from iter_assemble_session(out, assemble, settings=settings)
        with made.matrix as matrix:
            result |= {"H": assemble, "shape": matrix.shape, "saturated_positions": made.saturated}
    if pack:
        packed = yield from iter_finish(out)
        result["bytes_gained"] = packed.bytes_gained
        for one in packed.left:
            note(one)
    return result
