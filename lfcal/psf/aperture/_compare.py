"""Least-squares fit of outlines to the harmonics of an edge: circle, iris, stuck blade, second rim."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture._arcs import Arcs
from lfcal.psf.aperture._edge import Edge, harmonics

__all__ = [
    "BLADES",
    "CURVATURE",
    "ROTATION",
    "STUCK",
    "OutlineFit",
    "circle",
    "irises",
    "rims",
    "stuck_blades",
]

Values = NDArray[np.float64]

BLADES = range(4, 16)
"""Blade counts that are distinguished; 3 is not, because a tilted lens's trefoil looks the same."""

RAYS: Values = np.linspace(0.0, 2 * math.pi, 360, endpoint=False)
"""Directions in which outlines are computed, from +column towards +row (rad)."""

LEADING = 3
"""Number of blade counts that are tried with a second rim, and of starts for a stuck blade from each count."""

ENOUGH = 0.05
"""Decrease of chi-square below which the iteration ends."""

APOTHEM, COLUMN, ROW, STRETCH, SHEAR, ROTATION, CURVATURE, STUCK = range(8)
"""Indices of an outline's parameters; the three of a rim follow the others."""


@dataclass(frozen=True, slots=True)
class OutlineFit:
    """A fitted outline.

    Attributes
    ----------
    arcs
        The outline.
    row, column
        Centre of the outline, relative to the origin of the edge (pixels).
    chi2
        Sum of squared residuals of the harmonics, weighted by their errors.
    parameters, covariance
        Fitted parameters, in the order of this module; direction, distance and curvature of the rim come last.
    """

    arcs: Arcs
    row: float
    column: float
    chi2: float
    parameters: Values
    covariance: Values

    @property
    def blades(self) -> int:
        """Number of blades, 0 for a circle."""
        return self.arcs.blades


@dataclass(frozen=True, slots=True)
class _Family:
    """A family of outlines with the same unknowns."""

    blades: int = 0
    stuck: int = -1
    rim: bool = False

    @property
    def unknowns(self) -> int:
        return 5 + 2 * bool(self.blades) + (self.stuck >= 0) + 3 * self.rim

    def arcs(self, p: Values) -> Arcs:
        a, stretch, shear = float(p[APOTHEM]), float(p[STRETCH]), float(p[SHEAR])
        rim = (float(p[-3]), float(p[-2]), float(p[-1])) if self.rim else None
        if not self.blades:
            return Arcs(a, rim=rim, stretch=stretch, shear=shear)
        share = float(p[STUCK]) if self.stuck >= 0 else 0.0
        turn, curvature = float(p[ROTATION]), float(p[CURVATURE])
        return Arcs(a, curvature, self.blades, turn, self.stuck, share, rim, stretch, shear)

    def bounds(self, radius: float) -> tuple[Values, Values, Values]:
        """Return the lowest and highest parameters, and the steps for finite differences."""
        low, high = [0.6 * radius, *[-0.3 * radius] * 2, *[-0.1] * 2], [1.4 * radius, *[0.3 * radius] * 2, *[0.1] * 2]
        step = [1e-3 * radius] * 3 + [1e-3] * 2
        if self.blades:
            low, high, step = [*low, -50.0, 0.0], [*high, 50.0, 0.97], [*step, 1e-3, 1e-3]
        if self.stuck >= 0:
            low, high, step = [*low, -0.6], [*high, 0.6], [*step, 1e-3]
        if self.rim:
            low, high, step = [*low, -50.0, 0.3, 0.0], [*high, 50.0, 1.2, 2.0], [*step, 1e-3, 1e-3, 1e-3]
        return np.array(low), np.array(high), np.array(step)


def circle(edge: Edge) -> OutlineFit:
    """Return the best circle, which may be slightly elliptic."""
    return _fit(edge, _Family(), np.array([edge.harmonics[0].real, 0.0, 0.0, 0.0, 0.0]))


def irises(edge: Edge, about: OutlineFit) -> list[OutlineFit]:
    """Return the best regular iris for each blade count, best first."""
    found = []
    for blades in BLADES:
        # harmonic n of an iris has its maxima at the vertices
        damping = edge.damping[blades]
        turn = -float(np.angle(edge.harmonics[blades] * (1.0 if damping >= 0 else -1.0))) / blades
        # it is 2/(n² - 1) of the radius with straight blades, and less with curved ones
        share = 2 * abs(edge.harmonics[blades]) / max(abs(damping), 0.05) / edge.radius * (blades**2 - 1) / 2
        start = np.append(about.parameters[:5], [turn, min(max(1 - share, 0.05), 0.9)])
        found.append(_fit(edge, _Family(blades), start))
    return sorted(found, key=_chi2)


def stuck_blades(edge: Edge, regular: list[OutlineFit], cut: list[OutlineFit]) -> list[OutlineFit]:
    """Return irises with one displaced blade: the best of each count and blade, best first.

    The fits start from the slopes at the regular iris, and from outlines ``cut`` by a rim. A blade that reaches far
    inwards cuts the others like a rim.
    """
    starts = [start for iris in regular for start in _linear_starts(edge, iris)]
    starts.sort(key=lambda entry: entry[0])
    chosen = [(family, start) for _, family, start in starts[: 5 * LEADING]]
    for fit in cut:
        if fit.blades and fit.arcs.rim is not None:
            direction, distance, _ = fit.arcs.rim
            step = 2 * math.pi / fit.blades
            # the two blades nearest to the rim
            nearest = (direction - fit.arcs.rotation_rad) / step - 0.5
            for stuck in {math.floor(nearest) % fit.blades, math.ceil(nearest) % fit.blades}:
                start = np.append(fit.parameters[:STUCK], distance - 1)
                chosen.append((_Family(fit.blades, stuck), start))
    return _best_of_each(_fit(edge, family, start) for family, start in chosen)


def _linear_starts(edge: Edge, iris: OutlineFit) -> list[tuple[float, _Family, Values]]:
    """Return the `LEADING` best starts of a displaced blade: chi-square expected from slopes, family, parameters."""
    regular, found = _Family(iris.blades), []
    low, high, step = regular.bounds(edge.radius)
    p = np.clip(iris.parameters, low, high)
    left = _left(edge, regular, p)
    slopes = _slopes(edge, regular, p, left, np.where(p + step <= high, step, -step))
    for stuck in range(iris.blades):
        family = _Family(iris.blades, stuck)
        for share in (0.04, -0.04):
            own = (_left(edge, family, np.append(p, share)) - left) / share
            terms = np.column_stack([slopes, own])
            change = np.linalg.lstsq(terms, -left, rcond=1e-9)[0]
            # a blade further out and a blade further in have different slopes
            if change[-1] * share > 0:
                start = np.append(p, 0.0) + change
                start[-1] = np.clip(start[-1], -0.25, 0.25)
                found.append((float(np.square(left + terms @ change).sum()), family, start))
    return sorted(found, key=lambda entry: entry[0])[:LEADING]


def rims(edge: Edge, regular: list[OutlineFit], round_one: OutlineFit) -> list[OutlineFit]:
    """Return a circle and the best irises, each cut by a second rim, best first."""
    found = []
    for base in (round_one, *regular[:LEADING]):
        family = _Family(base.blades, rim=True)
        starts = []
        for direction in np.arange(12) * (math.pi / 6):
            for distance in (0.95, 0.8, 0.65):
                for curvature in (0.4, 0.9):
                    start = np.append(base.parameters, [direction, distance, curvature])
                    # a stretched circle resembles a circle cut by a rim
                    start[STRETCH] = start[SHEAR] = 0.0
                    # the mean radius is that of the cut outline: the base is larger, and its centre is displaced
                    gap = (1 - distance) * edge.radius / 2
                    start[APOTHEM] += gap
                    start[COLUMN] += gap * math.cos(direction)
                    start[ROW] += gap * math.sin(direction)
                    starts.append(start)
        order = np.argsort(np.square(_left_of_each(edge, family, np.stack(starts))).sum(1), kind="stable")
        found += [_fit(edge, family, starts[k]) for k in order[:2]]
    # an iris with strongly curved blades, cut by a rim, is a cut circle; starting from the whole circle may miss it
    least = min((fit for fit in found if fit.blades), key=_chi2)
    found.append(_fit(edge, _Family(rim=True), np.delete(least.parameters, [ROTATION, CURVATURE])))
    return _best_of_each(found)


def _best_of_each(fits: Iterable[OutlineFit]) -> list[OutlineFit]:
    best: dict[tuple[int, int], OutlineFit] = {}
    for fit in sorted(fits, key=_chi2):
        best.setdefault((fit.blades, fit.arcs.stuck), fit)
    return list(best.values())


def _chi2(fit: OutlineFit) -> float:
    return fit.chi2


def _left(edge: Edge, family: _Family, p: Values) -> Values:
    """Return the residual harmonics in units of their errors, as real and imaginary parts."""
    return np.asarray(_left_of_each(edge, family, p[None])[0])


def _left_of_each(edge: Edge, family: _Family, parameters: Values) -> Values:
    """Return the residual harmonics of several outlines, one in each row."""
    outlines = np.stack([family.arcs(p).radius(RAYS, -float(p[ROW]), -float(p[COLUMN])) for p in parameters])
    left = (edge.harmonics - harmonics(outlines) * edge.damping) / edge.sigma
    return np.concatenate([left.real, left.imag[:, 1:]], axis=1)


def _fit(edge: Edge, family: _Family, start: Values, steps: int = 25) -> OutlineFit:
    """Return the outline fitted by Levenberg-Marquardt, with slopes by differences, kept within bounds."""
    low, high, step = family.bounds(edge.radius)
    p = np.clip(start, low, high)
    left = _left(edge, family, p)
    cost, damping = float(left @ left), 1e-3
    for _ in range(steps):
        slopes = _slopes(edge, family, p, left, np.where(p + step <= high, step, -step))
        normal, gradient = slopes.T @ slopes, slopes.T @ left
        diagonal = np.diag(normal) + 1e-12 * np.trace(normal)
        if not diagonal.any():  # so blurred or uncertain that no outline is better than another
            break
        while damping < 1e7:
            trial = np.clip(p - np.linalg.solve(normal + damping * np.diag(diagonal), gradient), low, high)
            new = _left(edge, family, trial)
            lower = cost - float(new @ new)
            if lower > 0:
                break
            damping *= 8
        else:
            break
        p, left, cost, damping = trial, new, cost - lower, max(1e-7, damping / 5)
        if lower < ENOUGH:
            break
    slopes = _slopes(edge, family, p, left, np.where(p + step <= high, step, -step))
    normal = slopes.T @ slopes
    # the parameters have different units: scale them, so that only truly undetermined ones are singular
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    covariance = scale[:, None] * np.linalg.pinv(normal * np.outer(scale, scale), rcond=1e-10, hermitian=True) * scale
    return OutlineFit(family.arcs(p), float(p[ROW]), float(p[COLUMN]), cost, p, covariance)


def _slopes(edge: Edge, family: _Family, p: Values, left: Values, step: Values) -> Values:
    moved = _left_of_each(edge, family, p + np.diag(step))
    return np.asarray(((moved - left) / step[:, None]).T)
