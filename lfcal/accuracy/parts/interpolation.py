"""Interpolation in assembly: error of patterns between pixels versus time for the whole H."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import Position
from lfcal.camera import ScanPlan
from lfcal.psf import INTERPOLATIONS, Cutout
from lfcal.simulate import PlaneResponse, plan_effects
from lfcal.simulate.effects import Effect

__all__ = ["PART"]

SHIFTS = ((0.5, 0.5), (0.25, -0.4), (-0.15, 0.3))
"""Displacements of the image from whole pixels (rows, columns): the worst case, and two others."""

WIDE = 24
"""Margin of the simulated frame (pixels), because interpolation uses pixels beyond the cutout."""

TOLERANCE = 0.05
ROUNDS = 3


@dataclass(frozen=True, eq=False)
class _Moved:
    """A frame whose image is displaced from whole pixels by ``shift`` (rows, columns)."""

    frame: NDArray[np.float32]
    shift: tuple[float, float]


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and time of each interpolation, for simulated images displaced by fractions of a pixel."""
    plan = replace(subject.planned, resample=False)
    z, (nt, ns) = subject.middle, plan.cutout
    effects = plan_effects(plan, TOLERANCE).effects
    whole = replace(plan, anchor=(float(round(plan.anchor[0])), float(round(plan.anchor[1]))))
    yield AccuracyStep("pattern on whole pixels")
    # one response determines the sampling of all, so that only the part of the pixels differs
    first = PlaneResponse(whole, z, effects, tolerance=TOLERANCE)
    at = plan.period[0] // 2, plan.period[1] // 2
    true = first.rows([at[0]], [at[1]], 1)[0, 0]
    moved = []
    for shift in SHIFTS:
        yield AccuracyStep(f"shifted by {shift[0]:+g}, {shift[1]:+g} px")
        moved.append(_moved(whole, z, effects, first, at, shift))
    where = "; ".join(f"{y:+g}, {x:+g}" for y, x in SHIFTS)
    yield Truth(
        "the simulation with pixels, lenslets and source shifted together",
        (
            f"middle position of plane {z}, {nt} x {ns} px, image displaced from whole pixels by {where} px "
            "(rows, columns)",
        ),
    )
    count = plan.n_positions
    for name in INTERPOLATIONS:
        yield AccuracyStep(name)
        error, took = _tried(name, moved, true)
        yield CostPoint(name, {"interpolation": name}, error, took * count, "seconds", {"pattern (ms)": 1e3 * took})


def _moved(
    plan: ScanPlan,
    z: int,
    effects: tuple[Effect, ...],
    like: PlaneResponse,
    at: tuple[int, int],
    shift: tuple[float, float],
) -> _Moved:
    """Return the frame at the same position, with all optics displaced by ``shift`` relative to the pixels."""
    lattice, pixel = plan.camera.lattice, plan.camera.sensor.pixel_um
    offset = (lattice.offset_um[0] + shift[1] * pixel, lattice.offset_um[1] + shift[0] * pixel)
    camera = replace(plan.camera, lattice=replace(lattice, offset_um=offset))
    anchor = (plan.anchor[0] + shift[0], plan.anchor[1] + shift[1])
    there = replace(plan, camera=camera, anchor=anchor)
    nt, ns = plan.cutout
    response = PlaneResponse(there, z, effects, cutout=(nt + 2 * WIDE, ns + 2 * WIDE))
    response.adopt(like)
    # the window follows the source by whole pixels
    rest = (shift[0] - math.ceil(shift[0] - 0.5), shift[1] - math.ceil(shift[1] - 0.5))
    return _Moved(response.rows([at[0]], [at[1]], 1)[0, 0], rest)


def _tried(name: str, moved: list[_Moved], true: NDArray[np.float32]) -> tuple[float, float]:
    """Return the relative L1 error of an interpolation, and its time for one pattern (s)."""
    error, took = 0.0, float("inf")
    for one in moved:
        rows, columns = ((n - 1) / 2 for n in one.frame.shape)
        # the image of the source is displaced from the middle pixel of the frame by its shift
        cutout = Cutout(true.shape, (rows + one.shift[0], columns + one.shift[1]), name)
        for _ in range(ROUNDS):  # the first run loads libraries
            start = time.perf_counter()
            window = cutout.window(Position(0, 0, 0))
            values = cutout.resample(one.frame[cutout.region(window)], window)
            took = min(took, time.perf_counter() - start)
        error += float(np.abs(values.astype(np.float64) - true).sum())
    return error / (len(moved) * float(np.abs(true).sum(dtype=np.float64))), took


PART = AccuracyPart(
    "interpolation",
    "Assembly: interpolation",
    "relative L1 error of a pattern whose image is between pixels",
    "time for all patterns of H, on one processor",
    "seconds",
    measure,
    rank=50,
)
