"""Find changes of the camera since H was recorded that explain how new frames differ from H.

Derivatives are valid only for small changes, so the best explanations are refined by further steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit import GROUPS, STEP, STEP_PX, Fineness, ScanScales, Unknown, Vector, predict
from lfcal.judge.expected import Behind
from lfcal.simulate.engines import EnergyError

__all__ = ["Changes", "FrameResiduals", "Suspect", "changes_of", "explained_by", "refined"]

F8 = NDArray[np.float64]

APART = {
    "gap_um": "gap of the array",
    "rotation_rad": "array rotated",
    "offset_y_um": "array displaced",
    "offset_x_um": "array displaced",
}
"""Unknowns of the group of the array, which may change independently."""

OF_THE_SCAN = ("depths", "stage_scale", "stage_zero")
"""Groups of unknowns whose effect on a single frame cannot be distinguished from the effect of other groups."""

SHOWS = 4.0
"""Significance, in standard deviations of noise, above which a suspect is reported."""


@dataclass(frozen=True, slots=True)
class Suspect:
    """A possible change of the camera, and how well it explains the frames.

    Attributes
    ----------
    name
        The changed part.
    values
        Name of each unknown, its change, the standard deviation of the change, and the unit.
    error, sigma
        Resulting change of H (relative L2 of the light), and its standard deviation due to noise.
    left
        Remaining error beyond noise (relative L2).
    gained
        Decrease of the sum of squares of the residuals, which are in standard deviations.
    shows
        Whether the change is significant.
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
    """Derivatives of patterns at unit gain with respect to the unknowns of each suspect.

    Attributes
    ----------
    names
        Name of the suspect for each column.
    unknowns, scales, units
        Unknown of each column, its change for a step of 1, and its unit.
    columns
        Derivatives ``(k, n, nt, ns)``.
    start
        Unchanged patterns ``(n, nt, ns)``.
    vector, which
        All unknowns, and the index of the unknown of each column.
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
        """Return the changes rescaled to patterns ``light`` ``(n, nt, ns)`` with other gains."""
        gains = (light * self.start).sum((1, 2)) / np.square(self.start).sum((1, 2))
        return replace(self, columns=self.columns * gains[:, None, None], start=light)


def changes_of(camera: Behind, index: NDArray[np.intp], offsets_px: F8) -> Changes:
    """Return the derivatives of patterns with respect to the fitted unknowns of a camera, per step of each unknown."""
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
    reported = [_in_words(one, camera.setup.camera.sensor.pixel_um) for one in used]
    unknowns, scales, units = (tuple(column) for column in zip(*reported, strict=True))
    return Changes(names, unknowns, scales, units, np.array(columns), start, vector, tuple(which))


def _in_words(one: Unknown, pixel_um: float) -> tuple[str, float, str]:
    """Return the name, step size and unit of a column; displacements are in pixels."""
    if one.name in ("offset_y_um", "offset_x_um"):
        return one.name.removesuffix("_um"), one.scale / pixel_um, "px"
    if one.squared:
        return f"{one.name} squared", one.scale**2, f"{one.unit}²" if one.unit else ""
    return one.name, one.scale, one.unit


@dataclass(frozen=True, eq=False)
class FrameResiduals:
    """Frames compared with the predictions of H.

    Attributes
    ----------
    residual, light
        Frames minus prediction, and predicted light, each ``(n, m)``.
    noise, weight
        Variance, and 1/sigma of each sample (0: no measurement).
    nuisance
        Derivatives of each frame with respect to nuisance parameters ``(n, j, m)``: gain, background, position of the
        source.
    """

    residual: F8
    light: F8
    noise: F8
    weight: F8
    nuisance: F8

    def without_nuisance(self, columns: F8) -> F8:
        """Return columns ``(k, n, m)`` in sigmas ``(k, n m)``, minus the part that nuisance parameters explain."""
        out = np.empty(columns.shape)
        for k in range(len(self.residual)):
            q, _ = np.linalg.qr((self.nuisance[k] * self.weight[k]).T)
            own = columns[:, k] * self.weight[k]
            out[:, k] = own - (own @ q) @ q.T
        return out.reshape(len(columns), -1)


def explained_by(changes: Changes, left: FrameResiduals) -> tuple[Suspect, ...]:
    """Return all suspects, the best explanation first; ``changes`` must be in the units of the frames."""
    columns = left.without_nuisance(changes.columns.reshape(len(changes.names), len(left.residual), -1))
    residual = left.without_nuisance(left.residual[None])[0]
    found = []
    for name in dict.fromkeys(changes.names):
        own = [k for k, one in enumerate(changes.names) if one == name]
        found.append(_one(changes, own, columns[own], residual, left))
    return _sorted_suspects(found)


def _sorted_suspects(found: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Return the suspects, sorted by decreasing ``gained`` minus 2 for each unknown."""
    return tuple(sorted(found, key=lambda one: 2 * len(one.values) - one.gained))


def _is_significant(gained: float, unknowns: int) -> bool:
    """Return whether a change of this number of unknowns explains more than it would of noise."""
    return gained > unknowns + SHOWS * math.sqrt(2.0 * unknowns) + SHOWS


def _best_step(x: F8, residual: F8) -> tuple[F8, F8]:
    """Return the best-fit step along columns ``(k, n)`` for a residual ``(n,)``, both in sigmas, and its covariance."""
    size = np.sqrt(np.square(x).sum(1))
    size[size == 0] = 1.0
    scaled = x / size[:, None]
    inverse = np.linalg.pinv(scaled @ scaled.T, rcond=1e-9, hermitian=True) / np.outer(size, size)
    return inverse @ (x @ residual), inverse


def _one(changes: Changes, own: list[int], x: F8, residual: F8, left: FrameResiduals) -> Suspect:
    """Return the suspect to which the columns ``own`` belong, with its best-fit change.

    ``x`` (these columns) and ``residual`` are in sigmas, without the part that nuisance parameters explain.
    """
    good = left.weight.ravel() > 0
    power = float(np.square(left.light.ravel()[good]).sum())
    step, inverse = _best_step(x, residual)
    gained = float(step @ (x @ residual))
    # the change itself, in samples, and its standard deviation due to noise
    sigmas = np.where(good, 1.0 / np.where(good, left.weight.ravel(), 1.0), 0.0)
    parts = x * sigmas
    change = step @ parts
    made = float(np.trace(inverse @ (parts @ parts.T)))
    squares = float((np.square(residual * sigmas - change) - np.where(good, left.noise.ravel(), 0.0)).sum())
    # a large residual makes a step less certain by the same factor
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
        _is_significant(gained / grown, len(own)),
    )


# -- beyond the first step ---------------------------------------------------------------------------------
FOLLOWED = 4
"""Number of suspects that are refined, the best explanations first."""

RIVAL = 0.3
"""Fraction of the gain of the best suspect above which others are refined too, as they might become the best."""

TURNS = 3
"""Number of further steps."""

ENOUGH = 1e-3
"""Fraction of the sum of squares that a step must gain for another step."""

LONGEST = 5.0
"""Longest step of an unknown, in its scales."""


FARTHEST_PX = 0.4
"""Largest displacement of a source in one step (pixels)."""


@dataclass(frozen=True, eq=False)
class _State:
    """Frames compared with a changed camera.

    Attributes
    ----------
    u
        All unknowns of the camera, in multiples of their scales.
    offsets
        Displacements of the sources ``(n, 2)`` (pixels).
    left
        Comparison of the frames with the prediction of the changed camera; ``light`` includes the change.
    squares
        Sum of squares in sigmas, after fitting the nuisance parameters.
    """

    u: F8
    offsets: F8
    left: FrameResiduals
    squares: float


class _Frames:
    """Frames, the light of H at their positions, and the camera with which the light is changed."""

    def __init__(
        self, camera: Behind, index: NDArray[np.intp], offsets: F8, changes: Changes, left: FrameResiduals
    ) -> None:
        self.camera, self.index, self.changes, self.start = camera, index, changes, left
        self.offsets = offsets
        self.base = self._unit(np.zeros(len(changes.vector)), offsets)
        light = left.light.reshape(self.base.shape)
        self.gains = (light * self.base).sum(1) / np.square(self.base).sum(1)
        self.values = left.light + left.residual

    def _unit(self, u: F8, offsets: F8) -> F8:
        """Return the patterns ``(n, m)`` at unit gain."""
        setup = self.changes.vector.setup_at(u)
        found = predict(setup, self.camera.plan, self.index, offsets, Fineness.coarse)
        return found.reshape(len(self.index), -1).astype(np.float64)

    def light(self, u: F8, offsets: F8) -> F8:
        """Return the light ``(n, m)`` of H with the change and the displacements of the sources."""
        found: F8 = self.start.light + self.gains[:, None] * (self._unit(u, offsets) - self.base)
        return found

    def at(self, u: F8, offsets: F8) -> _State:
        """Return the frames compared with a changed camera."""
        light = self.light(u, offsets)
        moved = np.empty((len(light), 2, light.shape[1]))
        for axis in (0, 1):
            by = np.zeros(2)
            by[axis] = STEP_PX
            moved[:, axis] = (self.light(u, offsets + by) - light) / STEP_PX
        flat = light[:, None]
        nuisance = np.concatenate([flat, np.ones_like(flat), moved], axis=1)
        left = FrameResiduals(self.values - light, light, self.start.noise, self.start.weight, nuisance)
        residual = left.without_nuisance(left.residual[None])[0]
        return _State(u, offsets, left, float(residual @ residual))

    def columns(self, state: _State, own: Sequence[int]) -> F8:
        """Return the derivatives ``(k, n, m)`` of the light with respect to the unknowns ``own`` of the vector."""
        vector, found = self.changes.vector, []
        for k in own:
            step = STEP if np.isclose(vector.clipped(_moved(state.u, k, STEP))[k], state.u[k] + STEP) else -STEP
            found.append((self.light(_moved(state.u, k, step), state.offsets) - state.left.light) / step)
        return np.array(found)


def _moved(u: F8, k: int, by: float) -> F8:
    out = u.copy()
    out[k] += by
    return out


def refined(
    suspects: Sequence[Suspect],
    camera: Behind,
    index: NDArray[np.intp],
    offsets_px: F8,
    changes: Changes,
    left: FrameResiduals,
) -> tuple[Suspect, ...]:
    """Return the suspects; those that explain the frames best are refined by further steps.

    Parameters
    ----------
    suspects
        Suspects after the first step from the camera of H.
    camera, index
        Camera of H, and the positions of the frames in H ``(n, 3)``.
    offsets_px
        Displacements of the frames' sources from these positions ``(n, 2)``.
    changes
        Derivatives of the first step, in the units of the frames.
    left
        Comparison of the frames with H.
    """
    frames = _Frames(camera, index, offsets_px, changes, left)
    most = max((one.gained for one in suspects), default=0.0)
    reported = [one for one in suspects if one.shows and one.gained > RIVAL * most][:FOLLOWED]
    found = {one.name: _refined_one(one, frames) for one in reported}
    return _sorted_suspects([found.get(one.name, one) for one in suspects])


def _refined_one(suspect: Suspect, frames: _Frames) -> Suspect:
    """Return a suspect after further steps, unchanged if no such camera is possible or none is better."""
    changes = frames.changes
    own = [k for k, name in enumerate(changes.names) if name == suspect.name]
    which = [changes.which[k] for k in own]
    first = np.array([value / changes.scales[k] for (_, value, _, _), k in zip(suspect.values, own, strict=True)])
    try:
        begun = frames.at(np.zeros(len(changes.vector)), frames.offsets)
        best, step = begun, first
        for turn in range(1 + TURNS):
            if turn:
                step = _step(best, frames.columns(best, which))[0]
            better = _stepped(frames, best, which, step)
            if better is None:
                break
            best, before = better, best.squares
            if turn and before - best.squares < ENOUGH * before:
                break
        if best is begun:
            return suspect
        return _reported(suspect, frames, begun, best, which, own)
    except (InputError, EnergyError):
        return suspect


def _stepped(frames: _Frames, state: _State, which: Sequence[int], step: F8) -> _State | None:
    """Return the frames compared with the camera after a step, or a half or quarter of it; None if none is better."""
    for share in (1.0, 0.5, 0.25):
        u = state.u.copy()
        u[list(which)] += np.clip(share * step, -LONGEST, LONGEST)
        u = frames.changes.vector.clipped(u)
        change = frames.light(u, state.offsets) - state.left.light
        try:
            found = frames.at(u, state.offsets + _displaced(state.left, change))
        except (InputError, EnergyError):
            continue
        if found.squares < state.squares:
            return found
    return None


def _displaced(left: FrameResiduals, change: F8) -> F8:
    """Return the displacement of each source ``(n, 2)`` that follows from the changed light."""
    found = np.empty((len(change), 2))
    for k in range(len(change)):
        made, *_ = np.linalg.lstsq(
            (left.nuisance[k] * left.weight[k]).T, (left.residual[k] - change[k]) * left.weight[k], rcond=None
        )
        found[k] = np.clip(made[2:], -FARTHEST_PX, FARTHEST_PX)
    return found


def _step(state: _State, columns: F8) -> tuple[F8, F8, F8]:
    """Return the best step, its covariance, and columns in sigmas without the part that nuisance parameters explain."""
    x = state.left.without_nuisance(columns)
    residual = state.left.without_nuisance(state.left.residual[None])[0]
    return *_best_step(x, residual), x


def _reported(
    suspect: Suspect, frames: _Frames, begun: _State, best: _State, which: Sequence[int], own: Sequence[int]
) -> Suspect:
    """Return the explanation by a suspect after its last step."""
    changes, left = frames.changes, best.left
    _, inverse, x = _step(best, frames.columns(best, which))
    good = left.weight.ravel() > 0
    sigmas = np.where(good, 1.0 / np.where(good, left.weight.ravel(), 1.0), 0.0)
    power = float(np.square(left.light.ravel()[good]).sum())
    grown = max(1.0, best.squares / max(1, int(good.sum())))
    sigma = np.sqrt(np.maximum(np.diag(inverse), 0.0) * grown)
    parts = x * sigmas
    before, residual = (one.left.without_nuisance(one.left.residual[None])[0] * sigmas for one in (begun, best))
    # residuals relative to H that the change removes, each with the best positions of the sources
    made = before - residual
    squares = float((np.square(residual) - np.where(good, left.noise.ravel(), 0.0)).sum())
    gained = (begun.squares - best.squares) / grown
    values = tuple(
        (name, float(best.u[k]) * changes.scales[j], float(s) * changes.scales[j], unit)
        for (name, _, _, unit), k, j, s in zip(suspect.values, which, own, sigma, strict=True)
    )
    return replace(
        suspect,
        values=values,
        error=math.sqrt(float(made @ made) / power),
        sigma=math.sqrt(float(np.trace(inverse @ (parts @ parts.T))) * grown / power),
        left=math.sqrt(max(0.0, squares) / power),
        gained=gained,
        shows=_is_significant(gained, len(own)),
    )
