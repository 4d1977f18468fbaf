"""What has changed since H was made: the usual suspects, each held against what new frames show beside H."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit.expected import Behind
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import GROUPS, ScanScales, Unknown, Vector
from lfcal.fit.problem import STEP
from lfcal.simulate.engines import EnergyError

__all__ = ["Changes", "Left", "Suspect", "best_step", "changes_of", "held_against", "shows", "sorted_suspects"]

F8 = NDArray[np.float64]

APART = {
    "gap_um": "gap of the array",
    "rotation_rad": "array turned",
    "offset_y_um": "array displaced",
    "offset_x_um": "array displaced",
}
"""Unknowns of the array's own group, which change for reasons of their own."""

OF_THE_SCAN = ("depths", "stage_scale", "stage_zero")
"""Groups of unknowns that say nothing of one frame which others do not say."""

SHOWS = 4.0
"""Standard deviations of what noise alone does, beyond which a suspect is taken for one."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A change of the camera, and what of the frames it explains.

    Attributes
    ----------
    name
        What has changed.
    values
        By how much: of each unknown its change, its standard deviation and its unit.
    error, sigma
        The change of H that it makes (relative L2 of the light), and what noise alone would be taken for.
    left
        Error beyond noise that is left with it (relative L2).
    gained
        By how much it lowers the sum of squares in sigmas.
    shows
        Whether that is more than noise does.
    """

    name: str
    values: tuple[tuple[str, float, float, str], ...]
    error: float
    sigma: float
    left: float
    gained: float
    shows: bool


@dataclass(frozen=True, eq=False)
class Changes:
    """How patterns of unit gain change with each suspect.

    Attributes
    ----------
    names
        Of the suspect that each column belongs to.
    unknowns, scales, units
        What each column is by, how much of it a step of 1 is, and its unit.
    columns
        Derivatives ``(k, n, nt, ns)``.
    start
        The patterns ``(n, nt, ns)``.
    vector, which
        All unknowns, and the place among them of each column's.
    """

    names: tuple[str, ...]
    unknowns: tuple[str, ...]
    scales: tuple[float, ...]
    units: tuple[str, ...]
    columns: F8
    start: F8
    vector: Vector
    which: tuple[int, ...]

    def in_units_of(self, light: F8) -> Changes:
        """Return the same for patterns ``(n, nt, ns)`` of another gain each."""
        gains = (light * self.start).sum((1, 2)) / np.square(self.start).sum((1, 2))
        return replace(self, columns=self.columns * gains[:, None, None], start=light)


def changes_of(camera: Behind, index: NDArray[np.intp], offsets_px: F8) -> Changes:
    """Return the derivatives of patterns by everything that a fit can find, by steps of each unknown."""
    plan = camera.plan
    groups = [group.name for group in GROUPS if group.name not in OF_THE_SCAN and not (group.late or group.held)]
    vector = Vector(camera.setup, ScanScales.of(plan), groups)
    titles = {group.name: group.title for group in GROUPS}
    start = predict(camera.setup, plan, index, offsets_px, Fineness.coarse).astype(np.float64)
    used, columns, which = [], [], []
    for k, one in enumerate(vector.unknowns):
        for step in (STEP, -STEP):
            u = np.zeros(len(vector))
            u[k] = step
            if not np.isclose(vector.clipped(u)[k], step):
                continue
            try:
                moved = predict(vector.setup_at(u), plan, index, offsets_px, Fineness.coarse)
            except (InputError, EnergyError):
                continue
            used.append(one)
            which.append(k)
            columns.append((moved - start) / step)
            break
    names = tuple(APART.get(one.name, titles[one.group]) for one in used)
    told = [_in_words(one, camera.setup.camera.sensor.pixel_um) for one in used]
    unknowns, scales, units = (tuple(column) for column in zip(*told, strict=True))
    return Changes(names, unknowns, scales, units, np.array(columns), start, vector, tuple(which))


def _in_words(one: Unknown, pixel_um: float) -> tuple[str, float, str]:
    """Return name, size of a step, and unit of a column; displacements are told in pixels."""
    if one.name in ("offset_y_um", "offset_x_um"):
        return one.name.removesuffix("_um"), one.scale / pixel_um, "px"
    if one.squared:
        return f"{one.name} squared", one.scale**2, f"{one.unit}²" if one.unit else ""
    return one.name, one.scale, one.unit


@dataclass(frozen=True, eq=False)
class Left:
    """What frames show beside H.

    Attributes
    ----------
    residual, light
        Frames minus what H says, and the light that it says, each ``(n, m)``.
    noise, weight
        Variance, and 1/sigma of each sample (0: it carries no measurement).
    nuisance
        Of each frame, what may be otherwise without a change of H ``(n, j, m)``: gain, background, place of the source.
    """

    residual: F8
    light: F8
    noise: F8
    weight: F8
    nuisance: F8

    def without_nuisance(self, columns: F8) -> F8:
        """Return columns ``(k, n, m)`` in sigmas ``(k, n m)``, less what the nuisances make up for."""
        out = np.empty(columns.shape)
        for k in range(len(self.residual)):
            q, _ = np.linalg.qr((self.nuisance[k] * self.weight[k]).T)
            own = columns[:, k] * self.weight[k]
            out[:, k] = own - (own @ q) @ q.T
        return out.reshape(len(columns), -1)


def held_against(changes: Changes, left: Left) -> tuple[Suspect, ...]:
    """Return all suspects, the one that explains the frames best first; ``changes`` in the units of the frames."""
    columns = left.without_nuisance(changes.columns.reshape(len(changes.names), len(left.residual), -1))
    residual = left.without_nuisance(left.residual[None])[0]
    found = []
    for name in dict.fromkeys(changes.names):
        own = [k for k, one in enumerate(changes.names) if one == name]
        found.append(_one(changes, own, columns[own], residual, left))
    return sorted_suspects(found)


def sorted_suspects(found: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return suspects, the one that explains the frames best first; each unknown must gain something."""
    return tuple(sorted(found, key=lambda one: 2 * len(one.values) - one.gained))


def shows(gained: float, unknowns: int) -> bool:
    """Return whether a change of so many unknowns gains more than noise does."""
    return gained > unknowns + SHOWS * math.sqrt(2.0 * unknowns) + SHOWS


def best_step(x: F8, residual: F8) -> tuple[F8, F8]:
    """Return the step by columns ``(k, n)`` in sigmas that explains a residual ``(n,)`` best, and its covariance."""
    size = np.sqrt(np.square(x).sum(1))
    size[size == 0] = 1.0
    scaled = x / size[:, None]
    inverse = np.linalg.pinv(scaled @ scaled.T, rcond=1e-9, hermitian=True) / np.outer(size, size)
    return inverse @ (x @ residual), inverse


def _one(changes: Changes, own: list[int], x: F8, residual: F8, left: Left) -> Suspect:
    """Return what the columns ``own`` explain; ``x`` are these, and ``residual``, in sigmas without nuisances."""
    good = left.weight.ravel() > 0
    power = float(np.square(left.light.ravel()[good]).sum())
    step, inverse = best_step(x, residual)
    gained = float(step @ (x @ residual))
    # the change itself in samples, and what noise alone would be taken for
    sigmas = np.where(good, 1.0 / np.where(good, left.weight.ravel(), 1.0), 0.0)
    parts = x * sigmas
    change = step @ parts
    made = float(np.trace(inverse @ (parts @ parts.T)))
    squares = float((np.square(residual * sigmas - change) - np.where(good, left.noise.ravel(), 0.0)).sum())
    # where much is left, a step is as much less sure
    grown = max(1.0, (float(residual @ residual) - gained) / max(1, int(good.sum())))
    sigma = np.sqrt(np.maximum(np.diag(inverse), 0.0) * grown)
    values = tuple(
        (changes.unknowns[k], float(step[j]) * changes.scales[k], float(sigma[j]) * changes.scales[k], changes.units[k])
        for j, k in enumerate(own)
    )
    return Suspect(
        changes.names[own[0]],
        values,
        math.sqrt(float(change @ change) / power),
        math.sqrt(made * grown / power),
        math.sqrt(max(0.0, squares) / power),
        gained / grown,
        shows(gained / grown, len(own)),
    )
