"""Which pitch of a target shows all phases with the fewest frames."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.targets._lines import line_offsets
from lfcal.targets.phases import Phases
from lfcal.targets.target import Target

__all__ = ["Proposal", "proposed_target"]

WIDEST = 2.5
"""Pitches up to so many times the least one are looked at: wider ones put too few holes on the sensor."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A pitch along one axis.

    Attributes
    ----------
    pitch_px
        Distance of the images (pixels): a whole number of the array's periods, and ``step`` pixels.
    step
        By how many phases a hole differs from the one before it.
    holes
        So many fit on the sensor with whole cutouts, wherever in a period the target stands.
    frames
        Offsets along this axis that show all phases of it.
    """

    pitch_px: float
    step: int
    holes: int
    frames: int


def proposed_axis(phases: Phases, axis: int, least_px: float, tolerance_px: float) -> Proposal:
    """Return the pitch of images along an axis that needs the fewest frames; of equal ones that with most holes.

    Holes a whole number p of pixels apart show phases 0, p, 2p … modulo the period, all of them where the two have
    no common divisor. The array's period is no whole number, so each time round leaves its residual. The pitch is
    therefore taken as whole periods and a few whole pixels (a vernier): phases follow each other, and a target goes
    round its period once or not at all.
    """
    plan, length, count = phases.plan, float(phases.period[axis]), phases.plan.period[axis]
    # offsets reach half a period either way, and a pixel is left for rounding
    room = plan.camera.sensor.shape[axis] - plan.cutout[axis] - length - 1
    best: Proposal | None = None
    for pitch, step in _pitches(length, least_px):
        holes = 1 + max(0, math.floor(room / pitch))
        fewest = math.ceil(count / holes)
        if best is not None and (fewest, -holes) > (best.frames, -best.holes):
            continue
        at = np.mod((np.arange(holes) - (holes - 1) / 2) * pitch, length)
        offsets, whole = line_offsets(at, count, length, tolerance_px)
        if whole and (best is None or (len(offsets), -holes) < (best.frames, -best.holes)):
            best = Proposal(pitch, step, holes, len(offsets))
    assert best is not None  # one hole shows every phase, at an offset each
    return best


def _pitches(length: float, least_px: float) -> list[tuple[float, int]]:
    """Return pitches of whole periods and whole pixels, and the pixels, from the least one upwards (pixels)."""
    steps = range(-math.floor(length / 2), math.floor(length / 2) + 1)
    turns = range(math.floor(least_px / length), math.ceil(WIDEST * max(least_px, length) / length) + 1)
    found = [(turn * length + step, step) for turn in turns for step in steps]
    return sorted(pair for pair in found if pair[0] >= least_px and pair[1])


def proposed_target(
    plan: ScanPlan, z: int, least_px: float, tolerance_px: float, *, hole_um: float = 0.0
) -> tuple[Target, tuple[Proposal, Proposal]]:
    """Return the array of holes, parallel to the sensor, that shows all phases of plane ``z`` with the fewest frames.

    Its rows and columns have pitches of their own: the period of a hexagonal array is wider than high by an irrational
    number, and no single pitch suits both.

    Parameters
    ----------
    plan, z
        The scan and the number of the plane: another plane has another magnification, and images another pitch.
    least_px
        Least distance of images (pixels).
    tolerance_px
        How far off a phase may be.
    hole_um
        Diameter of the holes (µm).

    Raises
    ------
    InputError
        If the sensor has no room for two cutouts.
    """
    phases = Phases.of(plan)
    rows, columns = (proposed_axis(phases, axis, least_px, tolerance_px) for axis in (0, 1))
    if rows.holes * columns.holes < 2:
        room = f"a sensor with room for two cutouts {least_px:g} px apart"
        raise InputError.expected("target", room, plan.camera.sensor.shape, "record a single point")
    step = plan.camera.step_um(plan.depths_um[z])
    pitch = (rows.pitch_px * step, columns.pitch_px * step)
    return Target("square", (rows.holes, columns.holes), pitch, hole_um), (rows, columns)
