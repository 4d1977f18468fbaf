"""Small plans and simulated rigs for the tests of acquisition."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.runner import Outcome
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan, preset
from lfcal.devices.protocols import Point
from lfcal.devices.rig import Rig
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.devices.simulated.faults import DeviceFault

CAREFUL = Options(darks=0, reference_every=0, origin_tolerance_px=0.5, keep_free_bytes=0, check_stage=False)
"""Positions alone, with all checks of frames; the check of the stage would shift the counts at which faults begin."""


def small_plan(
    period: tuple[int, int] = (3, 3),
    planes: int = 3,
    cutout: tuple[int, int] = (21, 21),
    shape: tuple[int, int] = (96, 96),
    **options: Any,
) -> ScanPlan:
    """27 positions on a small sensor."""
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=shape))
    depths = tuple(sorted(camera.depth_of(3.0 + 0.5 * k) for k in range(planes)))
    anchor = (float(shape[0] // 2), float(shape[1] // 2))
    return ScanPlan(camera, period, cutout, depths, anchor, **options)


def rig_for(plan: ScanPlan, *faults: DeviceFault, **options: Any) -> Rig:
    return simulated_rig(plan, faults=faults, **options)


def stopped(
    folder: Path, plan: Any, count: int, options: Options | None = CAREFUL, rig: Rig | None = None, how: str = "stop"
) -> Outcome:
    """Record, and stop (or abort) the session when it has so many frames."""
    control, frames = Control(), 0

    def watch(*_: object) -> None:
        nonlocal frames
        frames += 1
        if frames == count:
            getattr(control, how)()

    return record(folder, plan, rig or rig_for(plan), options, control=control, observers=(watch,))


def intercept(rig: Rig, device: str, call: str, act: Callable[..., Any]) -> None:
    """Let ``act(works, *arguments)`` answer a call of a device; ``works`` is the device's own answer."""
    own = getattr(rig, device).device
    works = getattr(own, call)
    setattr(own, call, lambda *arguments: act(works, *arguments))


class Deceived:
    """A stage whose encoders do not see where its mechanics put the source; ``true`` is given move and target."""

    waits = False

    def __init__(self, stage: Any, true: Callable[[int, Point], Point]) -> None:
        self._stage, self._true, self._moves = stage, true, 0
        self._asked: Point = stage.position()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def move(self, target: Point) -> None:
        self._moves += 1
        self._asked = target
        self._stage.move(self._true(self._moves, target))

    def position(self) -> Point:
        return self._asked


def deceived_rig(plan: ScanPlan, true: Callable[[int, Point], Point], **options: Any) -> Rig:
    """Return a simulated rig with such a stage."""
    rig = rig_for(plan, **options)
    return replace(rig, stage=Deceived(rig.stage, true))


def scaled(x: float, y: float, z: float) -> Callable[[int, Point], Point]:
    """Return what a stage of other scales makes of a target."""
    return lambda _, target: (x * target[0], y * target[1], z * target[2])


def frames_of(folder: Path) -> dict[tuple[int, int, int], NDArray[Any]]:
    """All recorded frames by position."""
    with RecordingSource(folder) as source:
        return {tuple(source.info(k).position): source.read(k) for k in range(len(source))}


def assert_same_frames(
    a: dict[tuple[int, int, int], NDArray[Any]], b: dict[tuple[int, int, int], NDArray[Any]]
) -> None:
    assert a.keys() == b.keys()
    wrong = [key for key in a if not np.array_equal(a[key], b[key])]
    assert not wrong, f"{len(wrong)} frames differ, first {wrong[:3]}"


def positions(plan: ScanPlan) -> Iterable[tuple[int, int, int]]:
    return (tuple(p) for p in plan.positions())
