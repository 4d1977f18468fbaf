"""What each point of a target has to itself: the size of its hole, its own depth, the optics of its own place.

A part of the field is computed with the optics of its middle: derivatives by all unknowns need one set of tables a
part. What a point's pattern has beside that hardly changes while the unknowns move, so it is computed now and then
and held in between (`Measured.beside`): at the end it is that of the camera as found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk, one_blas_thread
from lfcal.campaign.points import Points
from lfcal.fit import Problem, Regional, RegionPlace, Setup, predict
from lfcal.simulate import Sampling
from lfcal.simulate.effects import FiniteSource

__all__ = ["OwnOptics", "iter_with_own_light"]

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OwnOptics:
    """What points have that is known of each by itself.

    Attributes
    ----------
    middles
        Pixel ``(n, 2)`` at the middle of each cutout.
    farther_um
        How much farther away than the plane each hole is ``(n,)`` (µm).
    hole_um
        Diameter of the holes, where no unknown says another (µm).
    parts_um
        How much farther away the middle of each part of the field is (µm).
    """

    middles: NDArray[np.intp]
    farther_um: F8
    hole_um: float
    parts_um: F8

    @classmethod
    def of(cls, points: Points, measured: Regional) -> OwnOptics:
        """Return what is known of ``measured`` points; ``points`` are those that they are made of, in any order."""
        scan, middles = points.plan.scan, np.zeros((len(measured), 2), np.intp)
        for plan, own, _ in measured.parts():
            middles[own] = np.floor(np.array(plan.anchor) + 0.5).astype(np.intp) + measured.index[own, 1:]
        depths = np.array(scan.depths_um)
        farther = points.away_um - depths[points.z]
        known = {
            (z, *at): away
            for z, at, away in zip(points.z.tolist(), points.middles.tolist(), farther.tolist(), strict=True)
        }
        found = np.array([known[z, *at] for z, at in zip(measured.index[:, 0].tolist(), middles.tolist(), strict=True)])
        return cls(middles, found, points.plan.target.hole_um, _plane(points.pixels, farther, _middles(measured)))

    def beyond(self, measured: Regional, setup: Setup) -> F8:
        """Return how much farther away points ``(n,)`` are where a setup tilts the target beside its pose."""
        parts = np.array([place.farther_um for place in setup.regions]) - self.parts_um
        return _plane(_middles(measured), parts, self.middles.astype(np.float64))

    @property
    def regions(self) -> tuple[RegionPlace, ...]:
        """The parts of the field as a setup has them."""
        return tuple(RegionPlace(farther_um=float(farther)) for farther in self.parts_um)


def _middles(measured: Regional) -> F8:
    """Return the middle pixel of each part of the field ``(parts, 2)``."""
    return np.array([np.array(plan.anchor) + (np.array(plan.period) - 1) / 2 for plan in measured.plans])


def _plane(pixels: F8, values: F8, at: F8) -> F8:
    """Return the values ``(m,)`` at pixels ``at`` ``(m, 2)`` of the plane that lies best through others."""
    found = np.linalg.lstsq(np.c_[pixels, np.ones(len(pixels))], values, rcond=None)[0]
    there: F8 = np.c_[at, np.ones(len(at))] @ found
    return there


def iter_with_own_light(
    problem: Problem, own: OwnOptics, u: F8, offsets_px: F8, sampling: Sampling, note: str
) -> Work[Problem]:
    """Return the problem with what each point's pattern has to itself at a vector; yields progress in points.

    Parameters
    ----------
    problem
        Of points.
    own
        What each has to itself.
    u, offsets_px
        Where it is computed: the unknowns, and each point's displacement.
    sampling
        How finely.
    note
        What progress is told of.
    """
    measured = problem.measured
    assert isinstance(measured, Regional)  # points are those of parts of the field
    plain = replace(measured, beside=None)
    setup, offsets = problem.vector.setup_at(u), offsets_px + measured.places_px
    holes = _Holes.of(setup, own)
    light = np.zeros(measured.patterns.shape, np.float32)
    blur = np.zeros_like(light) if holes.told else None
    farther: F8 = own.farther_um + own.beyond(measured, setup)
    places = [(plan, setup.of_region(k), setup.regions[k].farther_um, own_of) for plan, own_of, k in plain.parts()]
    tasks = [(plan, at, away, j) for plan, at, away, which in places for j in which.tolist()]
    clock = Clock(note, len(tasks))
    yield clock.at(0)

    def some(start: int, stop: int) -> None:
        for plan, at, away, j in tasks[start:stop]:
            place = np.array(plan.anchor) + measured.index[j, 1:]
            alone = replace(plan, period=(1, 1), anchor=(float(place[0]), float(place[1])))
            index = np.array([[measured.index[j, 0], 0, 0]])
            mine = _at_depth(at, float(farther[j]) - away)
            light[j] = predict(holes.put(mine), alone, index, offsets[j : j + 1], sampling)[0]
            if blur is not None:
                other = predict(holes.put(mine, holes.other_um), alone, index, offsets[j : j + 1], sampling)[0]
                blur[j] = (light[j] - other) / np.float32(holes.um**2 - holes.other_um**2)

    with one_blas_thread():
        for first in range(0, len(tasks), 4 * problem.workers):
            last = min(len(tasks), first + 4 * problem.workers)
            for_each_chunk(lambda a, b, at=first: some(at + a, at + b), last - first, problem.workers)  # type: ignore[misc]
            yield clock.at(last)
    base = problem.with_measured(plain).model(u, offsets_px, sampling).reshape(light.shape)
    return problem.with_measured(replace(measured, beside=light - base, blur=blur, blurred_um=holes.um))


def _at_depth(setup: Setup, farther_um: float) -> Setup:
    """Return the setup of a part as it is for a hole so much farther away."""
    return replace(setup, depth_errors_um=tuple(error + farther_um for error in setup.depth_errors_um))


@dataclass(frozen=True, slots=True)
class _Holes:
    """Diameter of the holes, another by which its rate is told, and whether it is an unknown.

    Light changes with the square of the diameter, and little beyond that: one other size gives the rate.
    """

    um: float
    other_um: float
    told: bool

    @classmethod
    def of(cls, setup: Setup, own: OwnOptics) -> _Holes:
        if setup.hole_um is None:
            return cls(own.hole_um, 0.0, told=False)
        least = setup.camera.step_um(0.0)
        # to the point source, which takes one run; a smaller hole hardly differs from that
        return cls(setup.hole_um, 0.0 if setup.hole_um > 0.5 * least else least, told=True)

    def put(self, setup: Setup, um: float | None = None) -> Setup:
        """Return a setup with holes of this diameter, or another."""
        size = self.um if um is None else um
        return setup.with_effect(FiniteSource(size)) if size > 0 else setup
