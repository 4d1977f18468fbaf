"""Drawn frames of a target as a source, with their plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfcal.camera import ScanPlan
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.targets import Target, TargetPlan
from lfcal.targets.frames import TargetFrames
from tests.targets.common import bench, scan_of
from tests.targets.drawn import drawn

__all__ = ["SCAN", "array_of", "frames_of_drawn", "moved", "plan_of", "view_of"]

SCAN: ScanPlan = replace(scan_of(bench(360)), cutout=(49, 49))
PX = SCAN.camera.step_um(SCAN.depths_um[0])
Z = SCAN.depths_um[0]


def array_of(**more: object) -> Target:
    return Target("square", (5, 5), (57.0 * PX, 57.0 * PX), absent=((0, 0), (0, 1), (1, 0)), **more)


def plan_of(offsets: list[tuple[float, float]], target: Target | None = None, tolerance: float = 0.5) -> TargetPlan:
    return TargetPlan(SCAN, target or array_of(), (tuple(offsets),), tolerance, (0.004,), "geometric")


def moved(target: Target, offset: tuple[float, float]) -> Target:
    pose = target.pose
    return replace(
        target, pose=replace(pose, right_um=pose.right_um + offset[1] * PX, down_um=pose.down_um + offset[0] * PX)
    )


def frames_of_drawn(plan: TargetPlan, really: Target | None = None, **more: object) -> np.ndarray:
    """Return a drawn frame for each offset, ``(frames, rows, columns)`` of uint16."""
    target = really or plan.target
    frames = [
        drawn(moved(target, offset), SCAN.camera, Z, seed=k, **more) for k, offset in enumerate(plan.offsets_px[0])
    ]
    return np.stack(frames).astype(np.uint16)


def view_of(plan: TargetPlan, frames: np.ndarray) -> FrameSource:
    """Return the frames as a corrected view: their dark level is the sensor's."""
    source = ArraySource(frames, [(0, 0, k) for k in range(len(frames))])
    return corrected_view(TargetFrames(source, plan), CorrectionRecipe(), plan.scan)
