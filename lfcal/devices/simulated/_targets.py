"""Place a target of many points in front of the simulated camera, with a quick pattern at every hole or with optics."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, parse_json, read_text
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Point, Rendered, Roi
from lfcal.devices.simulated._camera import LightPatch, Renderer
from lfcal.devices.simulated._optics import PatternRenderer, chosen_effects, lit
from lfcal.targets import Target, TargetCamera, TargetPlan, uneven

__all__ = ["SwitchedRenderer", "TargetPattern", "TargetRenderer", "simulated_target"]


TOLERANCE = 0.05
"""Relative L1 error of the optics of a hole; a frame shows tens or hundreds of holes."""

SAME_PX = 0.01
"""Largest distance of the stage from an offset at which its points are shown (pixels in the image)."""


class TargetPattern:
    """The quick pattern of `PatternRenderer` at the image of every hole.

    Parameters
    ----------
    plan
        Camera, period and depths.
    target
        The target; the stage position is the position of its middle.
    brightness
        Relative light of each hole ``(n,)``, in the order of `Target.holes`.
    """

    optics = PatternRenderer.optics

    def __init__(self, plan: ScanPlan, target: Target, brightness: NDArray[np.float64]) -> None:
        self._point = PatternRenderer(plan)
        self._places = target.pose.points(target.flat_um(target.holes)).tolist()
        self._light = brightness.astype(np.float32).tolist()

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return the light of all holes on ``roi`` with the target's middle at ``source_um``."""
        x, y, z = source_um
        out = np.zeros(roi.shape, np.float32)
        for (right, down, away), light in zip(self._places, self._light, strict=True):
            top, left, counts = self._point.render((x + right, y + down, z + away), exposure_s, roi)
            row, column = top - roi.row, left - roi.column
            first, beside = max(row, 0), max(column, 0)
            bottom, end = min(row + counts.shape[0], roi.rows), min(column + counts.shape[1], roi.columns)
            if first < bottom and beside < end:
                part = counts[first - row : bottom - row, beside - column : end - column]
                out[first:bottom, beside:end] += np.float32(light) * part
        return LightPatch(roi.row, roi.column, out)


class TargetRenderer:
    """Simulated optics of a target, with every hole at its depth and position in the field.

    Parameters
    ----------
    frames
        The simulated camera.
    """

    def __init__(self, frames: TargetCamera) -> None:
        self._frames = frames
        # a live view and repeated exposures show the same position repeatedly
        self._light = functools.lru_cache(maxsize=2)(frames.light_at)

    @property
    def optics(self) -> str:
        """Level of the simulator."""
        return self._frames.single.level

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return the whole frame with the target's middle at ``source_um``, in the nearest plane; ``roi`` is ignored.

        Raises
        ------
        InputError
            If the stage is not in a plane of the plan.
        """
        scan = self._frames.plan.scan
        z = int(np.argmin(np.abs(np.array(scan.depths_um) - source_um[2])))
        step = scan.camera.step_um(scan.depths_um[z])
        if abs(source_um[2] - scan.depths_um[z]) > step:
            depth = f"{source_um[2]:.0f} µm"
            raise InputError.expected(
                "depth of the simulated target", "a plane of the plan", depth, ("move to a planned plane")
            )
        offset = round(source_um[1] / step, 6), round(source_um[0] / step, 6)
        factor = exposure_s / scan.exposures[z] / scan.camera.sensor.electrons_per_count
        return LightPatch(0, 0, self._light(z, offset) * np.float32(factor))


class SwitchedRenderer:
    """Display in front of the camera; at the stage position of frame ``k``, it shows all points lit in frame ``k``.

    Parameters
    ----------
    target
        Optics of the target at one position.
    plan
        Plan of a target with switched points, which states the offsets in each frame.
    """

    def __init__(self, target: Renderer, plan: TargetPlan) -> None:
        self._target, self._plan = target, plan
        self._offsets = [plan.offsets_um(z) for z in range(len(plan.scan.depths_um))]

    @property
    def optics(self) -> str:
        """Optics of the target."""
        return self._target.optics if isinstance(self._target, Rendered) else ""

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return the light of the frame whose offset is at the stage position; else, of the target alone."""
        z = int(np.argmin(np.abs(np.array(self._plan.scan.depths_um) - source_um[2])))
        away = np.abs(self._offsets[z] - np.array(source_um[:2])).max(axis=1)
        step = self._plan.scan.camera.step_um(self._plan.scan.depths_um[z])
        if not len(away) or away.min() > SAME_PX * step:
            return self._target.render(source_um, exposure_s, roi)
        lit = self._plan.lit_in(z, int(np.argmin(away)))
        places = [(float(x), float(y), source_um[2]) for x, y in self._offsets[z][list(lit)]]
        patches = [self._target.render(place, exposure_s, roi) for place in places]
        return LightPatch(
            patches[0].row, patches[0].column, sum((one.counts for one in patches[1:]), patches[0].counts)
        )


def simulated_target(
    plan: ScanPlan, path: str, level: str, effects: str = "", *, spread: float = 0.0, seed: int = 0
) -> Renderer:
    """Return the optics of the plan's camera with a target in front of them.

    Parameters
    ----------
    plan
        The scan that the target replaces.
    path
        JSON file of a target, or of a target's plan.
    level, effects
        ``"pattern"``, or as in `simulated_optics`.
    spread, seed
        Relative standard deviation of the brightness of the holes, and random seed.
    """
    target, stated = _target_in(Path(path))
    brightness = uneven(target, spread, seed)
    if level == "pattern":
        if effects:
            raise InputError.expected("option effects", "a level of the simulator", "pattern", "give optics=auto")
        return _switched(TargetPattern(plan, target, brightness), stated)
    planes = len(plan.depths_um)
    stands = TargetPlan(lit(plan), target, ((),) * planes, 0.1, (0.0,) * planes, "geometric")
    chosen = chosen_effects(stands.scan, effects, TOLERANCE) if effects else ()
    frames = TargetCamera(stands, chosen, brightness=brightness, level=level, tolerance=TOLERANCE)
    return _switched(TargetRenderer(frames), stated)


def _switched(renderer: Renderer, plan: TargetPlan | None) -> Renderer:
    return renderer if plan is None or plan.lit is None else SwitchedRenderer(renderer, plan)


def _target_in(path: Path) -> tuple[Target, TargetPlan | None]:
    text = read_text(path)
    data = parse_json(text, str(path))
    if isinstance(data, dict) and data.get("format") == "lfcal-target-plan":
        plan = TargetPlan.from_dict(data)
        return plan.target, plan
    return Target.from_dict(data), None
