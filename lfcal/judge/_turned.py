"""Find out in which of the eight orientations patterns match those of their camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work
from lfcal.fit import spread_out
from lfcal.judge._modelled import modelled
from lfcal.judge.expected import Behind
from lfcal.psf import AS_IS, ORIENTATIONS, PSFMatrix

__all__ = ["OrientationMatch", "few_positions", "iter_matches"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

FEW = 8
"""Number of positions whose patterns are compared."""

EVERY = 97
"""Step between samples of a row that are used to estimate the background."""


@dataclass(frozen=True, eq=False)
class OrientationMatch:
    """Patterns of H that, in one orientation, best match those of the camera at some positions.

    Attributes
    ----------
    name
        The orientation, one of `ORIENTATIONS`.
    alike
        Median correlation with the patterns of the camera.
    index
        Positions ``(n, 3)`` as (z, y, x) of the camera.
    found
        Positions ``(n, 3)`` in H with the best matching patterns.
    """

    name: str
    alike: float
    index: NDArray[np.intp]
    found: NDArray[np.intp]


def few_positions(matrix: PSFMatrix, recorded: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return a few of the ``recorded`` positions ``(n, 3)``, from the first and last plane (the most defocused)."""
    ends = recorded[np.isin(recorded[:, 0], (recorded[0, 0], recorded[-1, 0]))]
    return ends[spread_out(ends, min(FEW, len(ends)), matrix.period)]


def iter_matches(matrix: PSFMatrix, known: Behind, index: NDArray[np.intp]) -> Work[list[OrientationMatch]]:
    """Return the match of each orientation, the best first; all patterns of the planes in ``index`` are compared.

    Parameters
    ----------
    matrix, known
        H, and its camera.
    index
        Positions ``(n, 3)`` as (z, y, x) whose patterns are computed.
    """
    model, _ = modelled(known, index)
    side = min(model.shape[1:])
    alike = np.zeros((len(ORIENTATIONS), len(index)))
    places = np.zeros((len(ORIENTATIONS), len(index), 2), np.intp)
    rows = matrix.period[0]
    planes = np.unique(index[:, 0]).tolist()
    clock = Clock("comparing orientations", rows * len(planes))
    for done, z in enumerate(planes):
        own = np.flatnonzero(index[:, 0] == z)
        # the delivered pattern is the upright one turned back
        wanted = [one.inverse.apply(middle(p, side)) for one in ORIENTATIONS.values() for p in model[own]]
        wanted_unit = _units(np.stack(wanted))
        for y in range(rows):
            yield clock.at(done * rows + y)
            there = np.flatnonzero(matrix.recorded[z, y] > 0)
            if not there.size:
                continue
            values = np.nan_to_num(np.asarray(matrix[z, y], np.float32)[there], posinf=0.0, neginf=0.0)
            values -= np.median(values.ravel()[::EVERY])
            score = (_units(np.stack([middle(p, side) for p in values])) @ wanted_unit.T).T
            best = score.argmax(1)
            top = np.take_along_axis(score, best[:, None], 1)[:, 0].reshape(len(ORIENTATIONS), len(own))
            columns = there[best].reshape(top.shape)
            better = top > alike[:, own]
            alike[:, own] = np.where(better, top, alike[:, own])
            places[:, own, 0] = np.where(better, y, places[:, own, 0])
            places[:, own, 1] = np.where(better, columns, places[:, own, 1])
    found = [
        OrientationMatch(name, float(np.median(alike[k])), index, np.column_stack([index[:, 0], places[k]]))
        for k, name in enumerate(ORIENTATIONS)
    ]
    return sorted(found, key=lambda one: (-one.alike, one.name != AS_IS))


def middle(pattern: F4, side: int) -> F4:
    """Return the square in the middle of a pattern, which a rotation by 90° maps onto itself."""
    t, s = ((n - side) // 2 for n in pattern.shape)
    return pattern[t : t + side, s : s + side]


def _units(patterns: F4) -> F4:
    """Return patterns ``(n, a, b)`` as rows of length 1."""
    flat = patterns.reshape(len(patterns), -1)
    size = np.sqrt(np.einsum("ij,ij->i", flat, flat, dtype=np.float64))
    found: F4 = flat / np.maximum(size, 1e-30)[:, None].astype(np.float32)
    return found
