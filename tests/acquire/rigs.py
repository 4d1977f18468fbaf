"""Small plans and simulated rigs for the tests of acquisition."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.options import Options
from lfcal.acquire.recording.source import RecordingSource
from lfcal.camera import ScanPlan, preset
from lfcal.devices.rig import Rig
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.devices.simulated.faults import Fault

CAREFUL = Options(darks=0, reference_every=0, origin_tolerance_px=0.5, keep_free_bytes=0)
"""Positions alone, all checks on."""


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


def rig_for(plan: ScanPlan, *faults: Fault, **options: Any) -> Rig:
    return simulated_rig(plan, faults=faults, **options)


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
