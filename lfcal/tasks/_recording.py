"""How a recording is watched, stopped and finished, whatever its plan is."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lfcal.base import Finding, InputError, Work, note, tell

if TYPE_CHECKING:
    from lfcal.acquire import Control, Options, Outcome
    from lfcal.camera import ScanPlan
    from lfcal.devices import Rig

__all__ = ["Cover", "check_ready", "followed", "list_suspects", "pairs", "stoppable"]

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


def check_ready(plan: ScanPlan, rig: Rig, options: Options, *, resumed: bool, begun: bool) -> None:
    """Raise for a camera that changes samples automatically, or dark frames without a switched light.

    What is allowed to stay automatic is reported. A session that is ``resumed`` is compared with its own camera
    settings first, which gives the clearer message; one that was ``begun`` has its dark frames.
    """
    from lfcal.acquire import check_devices, check_fixed, check_light

    devices = check_devices(plan, rig)
    if not resumed:
        check_fixed(devices, options)
    if devices.automatic and options.allow_automatic:
        note(f"{devices.automatic_words}: frames may not be proportional to light, and H with them")
    if options.darks and not begun:
        check_light(rig)


class Cover:
    """A person who covers the lens, in place of a light that can be switched."""

    waits = False  # no driver: a person may take any time

    def switch(self, on: bool) -> None:
        """Ask for it and wait for the Enter key."""
        from lfcal.devices import DeviceError

        tell(f"{'uncover' if on else 'cover'} the lens, then press Enter")
        # end of input: without a person, the frames would be taken of a lens that is not covered.
        if not sys.stdin.readline():
            raise DeviceError("lens cover: no answer; run in a terminal, or record without darks (--darks 0)")


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


def followed(work: Work[R], control: Control, alarms: Callable[[], tuple[Finding, ...]]) -> Work[R]:
    """Pass on a recording; report each alarm once, each hold and its end, and what of the stage was not checked."""
    from lfcal.acquire.setup import STAGE

    held, reported, look = "", set[str](), time.monotonic() + ALARM_EVERY_S
    try:
        while True:
            record = next(work)
            # the words before the figures stay while a wait counts down
            if control.held.partition(":")[0] != held.partition(":")[0]:
                tell(f"on hold: {control.held}" if control.held else "recording again")
                held = control.held
            if record.stage == STAGE and record.note:
                note(record.note)
            if time.monotonic() > look:
                look = time.monotonic() + ALARM_EVERY_S
                for alarm in alarms():
                    if alarm.kind not in reported:
                        reported.add(alarm.kind)
                        tell(alarm.line)
            yield record
    except StopIteration as stop:
        found: R = stop.value
        return found
    finally:
        work.close()


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
