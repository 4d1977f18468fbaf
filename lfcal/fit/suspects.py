"""What has changed since H was made: the usual suspects, each held against what new frames show beside H."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.fit.expected import Behind
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import GROUPS, Frame, Unknown, Vector
from lfcal.fit.problem import STEP
from lfcal.simulate.engines.base import EnergyError

__all__ = ["Changes", "Suspect", "changes_of", "held_against"]

F8 = NDArray[np.float64]

APART = {
    "gap_um": "gap of the array",
    "rotation_rad": "array turned",
    "offset_y_um": "array displaced",
    "offset_x_um": "array displaced",
}
"""Unknowns of the array's own group, which change for reasons of their own."""

OF_THE_SCAN = ("depths", "stage_scale")
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
    """

    names: tuple[str, ...]
    unknowns: tuple[str, ...]
    scales: tuple[float, ...]
    units: tuple[str, ...]
    columns: F8
    start: F8

    def in_units_of(self, light: F8) -> Changes:
        """Return the same for patterns ``(n, nt, ns)`` of another gain each."""
        gains = (light * self.start).sum((1, 2)) / np.square(self.start).sum((1, 2))
        return replace(self, columns=self.columns * gains[:, None, None], start=light)


def changes_of(camera: Behind, index: NDArray[np.intp], offsets_px: F8) -> Changes:
    """Return the derivatives of patterns by everything that a fit can find, by steps of each unknown."""
    plan = camera.plan
    middle = np.array(plan.anchor) + (np.array(plan.period) - 1) / 2
    y, x = (middle - np.array(plan.camera.sensor.centre_px)) * plan.camera.sensor.pixel_um
    groups = [group.name for group in GROUPS if group.name not in OF_THE_SCAN and not group.late]
    frame = Frame(plan.shape[0], max(plan.cutout) / 2, (float(x), float(y)))
    vector = Vector(camera.setup, frame, groups)
    titles = {group.name: group.title for group in GROUPS}
    start = predict(camera.setup, plan, index, offsets_px, Fineness.coarse).astype(np.float64)
    used, columns = [], []
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
            columns.append((moved - start) / step)
            break
    names = tuple(APART.get(one.name, titles[one.group]) for one in used)
    told = [_in_words(one, camera.setup.camera.sensor.pixel_um) for one in used]
    unknowns, scales, units = (tuple(column) for column in zip(*told, strict=True))
    return Changes(names, unknowns, scales, units, np.array(columns), start)


def _in_words(one: Unknown, pixel_um: float) -> tuple[str, float, str]:
    """Return name, size of a step, and unit of a column; displacements are told in pixels."""
    if one.name in ("offset_y_um", "offset_x_um"):
        return one.name.removesuffix("_um"), one.scale / pixel_um, "px"
    if one.squared:
        return f"{one.name} squared", one.scale**2, f"{one.unit}²" if one.unit else ""
    return one.name, one.scale, one.unit


def held_against(
    changes: Changes, residual: F8, weight: F8, light: F8, noise: F8, nuisance: Sequence[F8]
) -> tuple[Suspect, ...]:
    """Return all suspects, the one that explains the frames best first.

    Parameters
    ----------
    changes
        In the units of the frames.
    residual, weight, light, noise
        Frames minus what H says, 1/sigma of each sample (0: it carries no measurement), the light that H says, and the
        variance; each ``(n, m)``.
    nuisance
        Of each frame, what may be otherwise without a change of H ``(j, m)``: gain, background, place of the source.
    """
    n = len(residual)
    columns = changes.columns.reshape(len(changes.names), n, -1)
    x, r = np.zeros(columns.shape), np.zeros(residual.shape)
    for k in range(n):
        q, _ = np.linalg.qr((nuisance[k] * weight[k]).T)
        r[k] = residual[k] * weight[k]
        r[k] -= q @ (q.T @ r[k])
        own = columns[:, k] * weight[k]
        x[:, k] = own - (own @ q) @ q.T
    flat = r.ravel()
    good = weight > 0
    power = float(np.square(light[good]).sum())
    before = float(flat @ flat)
    found = []
    for name in dict.fromkeys(changes.names):
        own = [k for k, one in enumerate(changes.names) if one == name]
        found.append(_one(name, own, changes, x[own].reshape(len(own), -1), flat, good, power, weight, noise, before))
    return tuple(sorted(found, key=lambda one: -one.gained + 2 * len(one.values)))


def _one(
    name: str,
    own: list[int],
    changes: Changes,
    x: F8,
    flat: F8,
    good: NDArray[np.bool_],
    power: float,
    weight: F8,
    noise: F8,
    before: float,
) -> Suspect:
    size = np.sqrt(np.square(x).sum(1))
    size[size == 0] = 1.0
    inverse = np.linalg.pinv((x / size[:, None]) @ (x / size[:, None]).T, rcond=1e-9, hermitian=True)
    inverse = inverse / np.outer(size, size)
    step = inverse @ (x @ flat)
    gained = float(step @ (x @ flat))
    # the change itself, less what nuisances make up for, in samples
    with np.errstate(divide="ignore", invalid="ignore"):
        parts = np.where(good.ravel(), x / weight.ravel(), 0.0)
    change = step @ parts
    made = float(np.trace(inverse @ (parts @ parts.T)))
    left_over = np.where(good.ravel(), flat / np.where(good.ravel(), weight.ravel(), 1.0), 0.0) - change
    squares = float((np.square(left_over) - np.where(good, noise, 0.0).ravel()).sum())
    # where much is left, a step is as much less sure
    grown = max(1.0, (before - gained) / max(1, int(good.sum())))
    sigma = np.sqrt(np.maximum(np.diag(inverse), 0.0) * grown)
    values = tuple(
        (changes.unknowns[k], float(step[j]) * changes.scales[k], float(sigma[j]) * changes.scales[k], changes.units[k])
        for j, k in enumerate(own)
    )
    return Suspect(
        name,
        values,
        math.sqrt(float(change @ change) / power),
        math.sqrt(made * grown / power),
        math.sqrt(max(0.0, squares) / power),
        gained / grown,
        gained / grown > len(own) + SHOWS * math.sqrt(2.0 * len(own)) + SHOWS,
    )
