"""What has changed since H was made, followed beyond the first step: derivatives hold for small changes only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.fit._suspects import Changes, Left, Suspect, best_step, shows, sorted_suspects
from lfcal.fit.expected import Behind
from lfcal.fit.model import Fineness, predict
from lfcal.fit.problem import STEP, STEP_PX
from lfcal.simulate.engines import EnergyError

__all__ = ["followed"]

F8 = NDArray[np.float64]

FOLLOWED = 4
"""Suspects that are followed: those that explain the frames best."""

RIVAL = 0.3
"""Share of what the best suspect gains that others must, for a further step could make them the best."""

TURNS = 3
"""Steps that are taken beyond the first."""

ENOUGH = 1e-3
"""Share of the sum of squares that a step must gain for another."""

LONGEST = 5.0
"""Longest step of an unknown, in its scales."""


FARTHEST_PX = 0.4
"""By how much a source is displaced in one step at most."""


@dataclass(frozen=True, eq=False)
class _State:
    """Frames beside a changed camera.

    Attributes
    ----------
    u
        The suspect's unknowns, in scales.
    offsets
        Displacements of the sources ``(n, 2)`` (pixels).
    left
        What the frames show beside it, ``light`` with the change.
    squares
        Sum of squares in sigmas, without what nuisances make up for.
    """

    u: F8
    offsets: F8
    left: Left
    squares: float


class _Frames:
    """Frames, H's light there, and the camera by which that changes."""

    def __init__(self, camera: Behind, index: NDArray[np.intp], offsets: F8, changes: Changes, left: Left) -> None:
        self.camera, self.index, self.changes, self.start = camera, index, changes, left
        self.offsets = offsets
        self.base = self._unit(np.zeros(len(changes.vector)), offsets)
        light = left.light.reshape(self.base.shape)
        self.gains = (light * self.base).sum(1) / np.square(self.base).sum(1)
        self.values = left.light + left.residual

    def _unit(self, u: F8, offsets: F8) -> F8:
        """Return the patterns of unit gain ``(n, m)``."""
        setup = self.changes.vector.setup_at(u)
        found = predict(setup, self.camera.plan, self.index, offsets, Fineness.coarse)
        return found.reshape(len(self.index), -1).astype(np.float64)

    def light(self, u: F8, offsets: F8) -> F8:
        """Return H's light ``(n, m)`` with the change, and its sources displaced."""
        found: F8 = self.start.light + self.gains[:, None] * (self._unit(u, offsets) - self.base)
        return found

    def at(self, u: F8, offsets: F8) -> _State:
        """Return the frames beside a changed camera."""
        light = self.light(u, offsets)
        moved = np.empty((len(light), 2, light.shape[1]))
        for axis in (0, 1):
            by = np.zeros(2)
            by[axis] = STEP_PX
            moved[:, axis] = (self.light(u, offsets + by) - light) / STEP_PX
        flat = light[:, None]
        nuisance = np.concatenate([flat, np.ones_like(flat), moved], axis=1)
        left = Left(self.values - light, light, self.start.noise, self.start.weight, nuisance)
        residual = left.without_nuisance(left.residual[None])[0]
        return _State(u, offsets, left, float(residual @ residual))

    def columns(self, state: _State, own: Sequence[int]) -> F8:
        """Return the derivatives ``(k, n, m)`` of the light by the vector's unknowns ``own``."""
        vector, found = self.changes.vector, []
        for k in own:
            step = STEP if np.isclose(vector.clipped(_moved(state.u, k, STEP))[k], state.u[k] + STEP) else -STEP
            found.append((self.light(_moved(state.u, k, step), state.offsets) - state.left.light) / step)
        return np.array(found)


def _moved(u: F8, k: int, by: float) -> F8:
    out = u.copy()
    out[k] += by
    return out


def followed(
    suspects: Sequence[Suspect], camera: Behind, index: NDArray[np.intp], offsets_px: F8, changes: Changes, left: Left
) -> tuple[Suspect, ...]:
    """Return the suspects, those that explain the frames best with further steps, each by derivatives where it stands.

    Parameters
    ----------
    suspects
        As told by one step from H's own camera.
    camera, index
        Behind H, and the frames' positions of it ``(n, 3)``.
    offsets_px
        Where the frames' sources were found beside these ``(n, 2)``.
    changes
        By which the first step was told, in the units of the frames.
    left
        What the frames show beside H.
    """
    frames = _Frames(camera, index, offsets_px, changes, left)
    most = max((one.gained for one in suspects), default=0.0)
    told = [one for one in suspects if one.shows and one.gained > RIVAL * most][:FOLLOWED]
    found = {one.name: _one(one, frames) for one in told}
    return sorted_suspects([found.get(one.name, one) for one in suspects])


def _one(suspect: Suspect, frames: _Frames) -> Suspect:
    """Return a suspect after further steps; as it is where there is no camera, or none is better."""
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
        return _told(suspect, frames, begun, best, which, own)
    except (InputError, EnergyError):
        return suspect


def _stepped(frames: _Frames, state: _State, which: Sequence[int], step: F8) -> _State | None:
    """Return the frames beside the camera a step on, or half or a quarter of it; None where none is better."""
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


def _displaced(left: Left, change: F8) -> F8:
    """Return by how much each source lies elsewhere ``(n, 2)`` once the light has changed."""
    found = np.empty((len(change), 2))
    for k in range(len(change)):
        made, *_ = np.linalg.lstsq(
            (left.nuisance[k] * left.weight[k]).T, (left.residual[k] - change[k]) * left.weight[k], rcond=None
        )
        found[k] = np.clip(made[2:], -FARTHEST_PX, FARTHEST_PX)
    return found


def _step(state: _State, columns: F8) -> tuple[F8, F8, F8]:
    """Return the best step, its covariance, and the columns in sigmas, without what nuisances make up for."""
    x = state.left.without_nuisance(columns)
    residual = state.left.without_nuisance(state.left.residual[None])[0]
    return *best_step(x, residual), x


def _told(
    suspect: Suspect, frames: _Frames, begun: _State, best: _State, which: Sequence[int], own: Sequence[int]
) -> Suspect:
    """Return what a suspect explains where it was followed to."""
    changes, left = frames.changes, best.left
    _, inverse, x = _step(best, frames.columns(best, which))
    good = left.weight.ravel() > 0
    sigmas = np.where(good, 1.0 / np.where(good, left.weight.ravel(), 1.0), 0.0)
    power = float(np.square(left.light.ravel()[good]).sum())
    grown = max(1.0, best.squares / max(1, int(good.sum())))
    sigma = np.sqrt(np.maximum(np.diag(inverse), 0.0) * grown)
    parts = x * sigmas
    before, residual = (one.left.without_nuisance(one.left.residual[None])[0] * sigmas for one in (begun, best))
    # what frames show beside H, and no longer with the change: sources in their best places either time
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
        shows=shows(gained, len(own)),
    )
