"""Expected information of patterns about the unknowns, and the effect of errors in the unknowns on H."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, check_number, drain
from lfcal.camera import ScanPlan
from lfcal.fit._weighing import Response
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Columns, Local, normal_equations
from lfcal.fit.parameters import Unknown
from lfcal.fit.problem import Point, Problem
from lfcal.fit.setup import Setup

__all__ = ["Expected", "Information", "iter_information"]

F8 = NDArray[np.float64]

AT_ONCE = 200e6
"""Largest size of the derivatives that are kept in memory at a time (bytes)."""

PRIOR_SIGMA = 10.0
"""Prior standard deviation of every unknown, in scales, so that covariances are finite without patterns."""


@dataclass(frozen=True, slots=True)
class Expected:
    """Expected conditions of a recording.

    Attributes
    ----------
    full
        Signal of the brightest pixel of the scan, as a fraction of the full well.
    stage_px
        Source position error (rms along an axis, pixels); 0: none.
    lamp
        Relative rms fluctuation of the lamp; 0: stable.
    response
        Rms variation of the response of pixels, relative to its mean; 0: all are equal.
    """

    full: float = 0.8
    stage_px: float = 0.0
    lamp: float = 0.0
    response: float = 0.0

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("brightest pixel (fraction of the full well)", self.full, above=0, at_most=1)
        check_number("source position error (px rms)", self.stage_px, at_least=0, at_most=5)
        check_number("rms variation of the lamp", self.lamp, at_least=0, at_most=1)
        check_number("rms variation of the pixel response", self.response, at_least=0, at_most=1)


@dataclass(frozen=True, eq=False)
class Information:
    """Information of single patterns about the unknowns, and weights of the error to minimise.

    Attributes
    ----------
    index
        Positions ``(n, 3)`` as (z, y, x).
    unknowns
        The unknowns to fit; all matrices are in units of their scales.
    patterns
        ``(n, k + 2, k + 2)``: J^T V^-1 J of each pattern. J are the derivatives of its samples with respect to the
        ``k`` unknowns, then the gain and the background of its plane. V is the covariance of the samples. The unknowns
        of the single pattern are eliminated.
    wanted
        ``(k, k)``: for the covariance C of the unknowns, trace(C wanted) is the squared relative error (L2) of H.
    prior
        ``(k, k)``: prior information about the unknowns.
    pattern_error
        Relative error (L2) of an H in which every position was recorded once, due to the noise of each pattern.
    """

    index: NDArray[np.intp]
    unknowns: tuple[Unknown, ...]
    patterns: F8
    wanted: F8
    prior: F8
    pattern_error: float


def iter_information(
    plan: ScanPlan,
    index: NDArray[np.intp],
    setup: Setup,
    groups: Sequence[str],
    expected: Expected,
    *,
    workers: int | None = None,
) -> Work[Information]:
    """Compute the Fisher information about the unknowns from patterns at given positions; progress counts patterns.

    Parameters
    ----------
    plan
        The scan; its exposures determine the relative brightness of planes.
    index
        Positions ``(n, 3)`` as (z, y, x); they should be evenly spread, because the error of H is computed at them.
    setup, groups
        Assumed camera, effects, depths and stage, and names of the groups of unknowns.
    expected
        Expected light, and stability of stage and lamp.
    workers
        Number of threads that compute derivatives. None: all processors.

    Notes
    -----
    The error of each plane of H is computed at its best overall brightness: D^T D - D^T m m^T D / m^T m. Here m is the
    model of a plane, and D are its derivatives with respect to the unknowns.
    """
    vector = _problem(plan, index[:0], np.zeros((0, *plan.cutout)), setup, groups, workers).vector
    k, m = len(vector), int(np.prod(plan.cutout))
    clock = Clock("information of patterns", 2 * len(index))
    yield clock.at(0)
    size = max(1, int(AT_ONCE / (8.0 * m * (k + 4))))
    parts, light = list(_parts(index[:, 0], size)), np.zeros((len(index), m), np.float32)
    for done, own in _counted(parts):
        light[own] = _light(plan, setup, index[own]).reshape(len(own), m)
        yield clock.at(done)
    gains = _gains(plan, index, light, expected)
    matrices, sums = np.zeros((len(index), k + 2, k + 2)), _Sums(k, plan.shape[0])
    for done, own in _counted(parts):
        z = int(index[own[0], 0])
        problem = _problem(plan, index[own], gains[z] * light[own], setup, groups, workers)
        response = Response(expected.response**2)
        local = Local(np.zeros((len(own), 2)), expected.stage_px, expected.lamp, response)
        point = problem.point(np.zeros(k), local, Fineness.coarse)
        # parts are fast, so progress counts patterns
        columns = drain(problem.columns(point, range(k), "", displaced=expected.stage_px > 0, both=True))
        for p, at in enumerate(own.tolist()):
            matrices[at] = _pattern_information(problem, point, columns, p)
        sums.add(z, columns, point, gains[z], _noise(plan))
        yield clock.at(len(index) + done)
    precision, _ = vector.prior()
    prior = np.diag(precision + PRIOR_SIGMA**-2)
    return Information(index, vector.unknowns, matrices, sums.wanted, prior, sums.pattern_error)


def _pattern_information(problem: Problem, point: Point, columns: Columns, p: int) -> F8:
    """Return the information ``(k + 2, k + 2)`` from pattern ``p`` about unknowns, gain and background."""
    only, k, nz = np.arange(len(problem.planes)) == p, len(columns.shared), problem.measured.plan.shape[0]
    part = Columns(columns.shared[:, only], None if columns.displacements is None else columns.displacements[:, only])
    local = replace(point.local, offsets_px=point.local.offsets_px[only])
    levels = replace(point.levels, lamps=point.levels.lamps[only])
    whole = normal_equations(part, point.model[only], point.seen.of(only), levels, problem.planes[only], local).matrix
    z = int(problem.planes[p])
    used = np.r_[0:k, k + z, k + nz + z]
    found: F8 = whole[np.ix_(used, used)]
    return found


class _Sums:
    """Sums of squares and products of the model and its derivatives for each plane, with the noise."""

    def __init__(self, k: int, planes: int) -> None:
        self._inner, self._cross, self._power = np.zeros((planes, k, k)), np.zeros((planes, k)), np.zeros(planes)
        self._noise = 0.0

    def add(self, z: int, columns: Columns, point: Point, gain: float, noise: tuple[float, float]) -> None:
        """Add patterns of plane ``z``."""
        model = point.model.reshape(-1).astype(np.float64)
        by = columns.shared.reshape(len(columns.shared), -1).astype(np.float64)
        self._inner[z] += by @ by.T
        self._cross[z] += by @ model
        self._power[z] += float(model @ model)
        constant, slope = noise
        self._noise += float((constant + slope * gain * model).sum()) / gain**2

    @property
    def wanted(self) -> F8:
        """`Information.wanted` for the patterns added so far."""
        power = np.where(self._power > 0, self._power, 1.0)
        scaled = self._cross[:, :, None] * self._cross[:, None, :] / power[:, None, None]
        found: F8 = (self._inner - scaled).sum(0) / self._power.sum()
        return found

    @property
    def pattern_error(self) -> float:
        """`Information.pattern_error` for the patterns added so far."""
        return float(np.sqrt(self._noise / self._power.sum()))


def _parts(planes: NDArray[np.intp], size: int) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of each plane, at most ``size`` at a time."""
    for z in np.unique(planes).tolist():
        own = np.flatnonzero(planes == z)
        for first in range(0, len(own), size):
            yield own[first : first + size]


def _counted(parts: Sequence[NDArray[np.intp]]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    done = 0
    for own in parts:
        done += len(own)
        yield done, own


def _light(plan: ScanPlan, setup: Setup, index: NDArray[np.intp]) -> NDArray[np.float32]:
    return np.maximum(predict(setup, plan, index, np.zeros((len(index), 2)), Fineness.coarse), 0)


def _gains(plan: ScanPlan, index: NDArray[np.intp], light: NDArray[np.float32], expected: Expected) -> F8:
    """Return the gain of each plane: electrons per unit of the predicted light."""
    exposures = np.array(plan.exposures)
    brightest = float((light.max(1) * exposures[index[:, 0]]).max())
    return np.asarray(expected.full * plan.camera.sensor.full_well_e * exposures / brightest)


def _noise(plan: ScanPlan) -> tuple[float, float]:
    """Return the constant (read noise, dark current, rounding) and slope of the variance of electrons in a pixel."""
    sensor, times = plan.camera.sensor, plan.frames_averaged
    dark = sensor.dark_current_e_s * max(plan.exposures)
    return (sensor.read_noise_e**2 + dark + sensor.electrons_per_count**2 / 12) / times, 1.0 / times


def _problem(
    plan: ScanPlan,
    index: NDArray[np.intp],
    electrons: NDArray[np.floating],
    setup: Setup,
    groups: Sequence[str],
    workers: int | None,
) -> Problem:
    """Return the problem of fitting the expected patterns without noise."""
    n = len(index)
    patterns = electrons.reshape(n, *plan.cutout).astype(np.float32)
    noise = np.tile(_noise(plan), (n, 1))
    nowhere, nobody = np.zeros((n, 2)), np.zeros(n, np.bool_)
    whole = np.ones(patterns.shape, np.bool_)
    measured = Measured(setup.plan(plan), index, patterns, noise, nowhere, whole, nobody)
    return problem_of(measured, setup, groups, workers)
