"""Supervision, stop and completion of a recording of any kind of plan."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from lfcal.base import Finding, InputError, Work, announce, note

if TYPE_CHECKING:
    from lfcal.acquire import Control, Options, Outcome
    from lfcal.camera import ScanPlan
    from lfcal.devices import Rig

__all__ = ["Cover", "check_ready", "followed", "list_suspects", "pairs", "stoppable"]

R = TypeVar("R")
ALARM_EVERY_S = 5.0
SUSPECTS = "suspects.json"


def pairs(options: tuple[str, ...]) -> dict[str, str]:
    """Return the options of a backend by name, from texts NAME=VALUE."""
    found = {}
    for text in options:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError.expected("--option", "NAME=VALUE", text, "write the name of the option, = and its value")
        found[key.strip()] = value.strip()
    return found


def check_ready(plan: ScanPlan, rig: Rig, options: Options, *, resumed: bool, begun: bool) -> None:
    """Raise an error if the camera changes pixel values automatically, or if dark frames need a switchable light.

    Settings that are allowed to stay automatic are reported. A ``resumed`` session is first compared with its stored
    camera settings, which gives the clearer message. A session that has ``begun`` already has its dark frames.
    """
    from lfcal.acquire import check_devices, check_fixed, check_light

    devices = check_devices(plan, rig)
    if not resumed:
        check_fixed(devices, options)
    if devices.automatic and options.allow_automatic:
        note(f"{devices.automatic_words}: frames, and an H made from them, may not be proportional to the light")
    if options.darks and not begun:
        check_light(rig)


class Cover:
    """A person who covers the lens, instead of a switchable light."""

    waits = False  # a person, not a driver, covers the lens, and may take any time

    def switch(self, on: bool) -> None:
        """Ask the person to cover or uncover the lens, and wait for the Enter key."""
        from lfcal.devices import DeviceError

        announce(f"{'uncover' if on else 'cover'} the lens, then press Enter")
        # end of input: no one can cover the lens, so the dark frames would be wrong.
        if not sys.stdin.readline():
            raise DeviceError(
                "lens cover: no answer; run the command in a terminal, or record without dark frames (--darks 0)"
            )


@contextmanager
def stoppable(control: Control) -> Iterator[list[int]]:
    """Stop cleanly at Ctrl-C, hang-up or a request to end, and abort at a second one; yield the signals received."""
    came: list[int] = []

    def asked(number: int, _: object) -> None:
        came.append(number)
        if control.stopping:
            control.abort()
        else:
            control.stop()
            announce("stopping after this position; Ctrl-C again stops immediately")

    before = {}
    if threading.current_thread() is threading.main_thread():
        # Windows has no hang-up signal
        names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
        before = {name: signal.signal(getattr(signal, name), asked) for name in names}
    try:
        yield came
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def followed(work: Work[R], control: Control, alarms: Callable[[], tuple[Finding, ...]]) -> Work[R]:
    """Pass on the progress of a recording; report each kind of alarm once, pauses, and notes of the stage check."""
    from lfcal.acquire.setup import STAGE

    held, reported, look = "", set[str](), time.monotonic() + ALARM_EVERY_S
    try:
        while True:
            record = next(work)
            # the words before the numbers stay the same while a wait counts down
            if control.held.partition(":")[0] != held.partition(":")[0]:
                announce(f"on hold: {control.held}" if control.held else "recording again")
                held = control.held
            if record.stage == STAGE and record.note:
                note(record.note)
            if time.monotonic() > look:
                look = time.monotonic() + ALARM_EVERY_S
                for alarm in alarms():
                    if alarm.kind not in reported:
                        reported.add(alarm.kind)
                        announce(alarm.line)
            yield record
    except StopIteration as stop:
        found: R = stop.value
        return found
    finally:
        work.close()


def list_suspects(out: Path, outcome: Outcome) -> dict[str, Any]:
    """Write the list of suspect positions, if any, into the folder of the session; return the list and its path."""
    from lfcal.acquire import read_suspects

    path = out / SUSPECTS
    found = read_suspects(out) if outcome.acknowledged else None
    if found is None or not found.positions:
        path.unlink(missing_ok=True)  # from an earlier run: these positions have been recorded again
        return {}
    found.write(path)
    return {"suspects": found, "redo": path}
