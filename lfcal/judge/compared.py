"""Patterns of an H compared with what its camera should give: which, how many, and where their models are computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_number
from lfcal.fit import QUICK_PATTERN, Setup, of_quick_pattern, spread_out
from lfcal.judge._modelled import Starts, correlation, depths_seen, modelled, parts, windows_seen
from lfcal.judge._scatter import rounding_of
from lfcal.judge.evidence import Evidence, Unlike, fitted
from lfcal.judge.expected import Behind, behind, plan_of
from lfcal.psf import PSFMatrix, copied_positions
from lfcal.simulate.engines import EnergyError

__all__ = ["PATTERNS", "iter_evidence", "iter_fitted", "patterns_of"]

F8 = NDArray[np.float64]

MOST_SAMPLES = 6_000_000
"""Samples of patterns that are compared at most: each takes some forty bytes."""

PATTERNS = 60
"""Patterns that are compared: a fixed number, so that the same file has the same verdict on every machine."""

LEAST_FEW = 4
"""Recorded positions that a comparison needs."""

FEWEST = 24
"""Patterns that are compared however large they are."""

TURNS = 3
"""Times that models follow what was fitted."""

ALIKE = 0.5
"""Correlation with the best fit by a camera that most patterns have if they are its own."""

LEAST, MOST = 1e-12, 1e15
"""Largest value that patterns may have: variances of others are no numbers of single precision."""


def iter_evidence(
    matrix: PSFMatrix,
    *,
    setup: Setup | None = None,
    patterns: int = PATTERNS,
    suspected: NDArray[np.intp] | None = None,
    more_suspected: int = 0,
) -> Work[Evidence | Unlike]:
    """Compare patterns of H with its camera; without one, or where it does not explain H, say why not.

    Which patterns are compared depends on H alone, never on the time that they take.

    Parameters
    ----------
    matrix
        H.
    setup
        The camera as it was found by a fit; None takes what H says of it.
    patterns
        Patterns that are compared, spread evenly; fewer where H has fewer, or where they are very large.
    suspected
        Positions ``(n, 3)`` that are compared too, for what is known of them.
    more_suspected
        How many more are suspected like these.

    Examples
    --------
    >>> from lfcal.judge import iter_evidence
    >>> from lfcal.base import drain
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     evidence = drain(iter_evidence(H, patterns=24))
    >>> print(f"{len(evidence)} patterns, off by {evidence.misfit:.0%} of the light beside noise")
    24 patterns, off by 1% of the light beside noise
    """
    check_number("patterns that are compared", patterns, at_least=1, integer=True)
    clock = Clock("comparing with the camera", 100)
    yield clock.at(0)
    recorded = np.argwhere((matrix.recorded > 0) & ~copied_positions(matrix))
    if len(recorded) < LEAST_FEW:
        return Unlike(f"only {len(recorded)} positions were recorded")
    if matrix.camera is None:
        return Unlike("H has no camera")
    if of_quick_pattern(matrix):
        return Unlike(QUICK_PATTERN, stated=True)
    if matrix.pixel_scale != (1.0, 1.0):
        return Unlike("H is on resampled pixels; assemble it without resampling to compare it")
    try:
        known = _camera_behind(matrix, recorded, setup)
    except (InputError, EnergyError) as error:
        return Unlike(str(error), stated=True)
    if known is None:
        return Unlike("no engine computes its camera")
    many = min(patterns, max(FEWEST, MOST_SAMPLES // int(np.prod(matrix.cutout))), len(recorded))
    index = recorded[spread_out(recorded, many, matrix.period)] if many < len(recorded) else recorded
    asked = np.zeros(len(index), np.bool_)
    if suspected is not None and len(suspected):
        chosen = set(map(tuple, index.tolist()))
        odd = set(map(tuple, suspected.tolist())) & set(map(tuple, recorded.tolist()))
        index = np.array(sorted(chosen | odd), np.intp)
        asked = np.array([place not in chosen for place in map(tuple, index.tolist())], np.bool_)
    data, valid = patterns_of(matrix, index)
    largest = float(np.abs(data).max())
    if not data.max(initial=0.0) > 0:
        return Unlike("H shows no light")
    if not LEAST <= largest <= MOST:
        words = f"its values reach {largest:.0e}: expected between {LEAST:.0e} and {MOST:.0e}; scale H to counts"
        return Unlike(words, stated=True)
    found = yield from iter_fitted(matrix, known, index, data, valid, clock)
    yield clock.at(100)
    if not np.median(found.values[:, 0]) > 0:
        return Unlike("H shows no light where its camera has some", stated=True, camera=known)
    alike = float(np.median(_alike(found)))
    if alike < ALIKE:
        words = f"patterns have little in common with those of the camera (correlation {alike:.2f})"
        return Unlike(words, stated=True, camera=known, correlation=alike)
    return replace(found, asked=asked, more_suspected=more_suspected)


def _camera_behind(matrix: PSFMatrix, recorded: NDArray[np.intp], setup: Setup | None) -> Behind | None:
    """Return the camera behind H, or None where no engine computes it; raises for a description that fits no H."""
    first = recorded[spread_out(recorded, LEAST_FEW, matrix.period)]
    plan = plan_of(matrix)  # says what is wrong with the description
    assert plan is not None
    known = behind(matrix, first) if setup is None else Behind(setup, plan, 0.0)
    if known is not None:
        modelled(known, first)
    return known


def patterns_of(matrix: PSFMatrix, index: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return patterns of positions ``(n, 3)`` and which of their samples carry a measurement ``(n, nt, ns)``."""
    data = np.stack([np.asarray(matrix[z, y, x], np.float32) for z, y, x in index.tolist()])
    valid = np.stack([matrix.valid(z, y, x) for z, y, x in index.tolist()]) & np.isfinite(data)
    data[~valid] = 0.0
    return data, valid


def iter_fitted(
    matrix: PSFMatrix,
    known: Behind,
    index: NDArray[np.intp],
    data: NDArray[np.float32],
    valid: NDArray[np.bool_],
    clock: Clock,
    *,
    elsewhere: bool = True,
) -> Work[Evidence]:
    """Return patterns ``(n, nt, ns)`` of positions ``(n, 3)``, fitted where source, cutout and plane look to be.

    ``clock`` counts hundredths; with ``elsewhere`` planes are looked for far from their stated depths, too.
    """
    model, columns = (np.empty((len(index), *shape), np.float32) for shape in (matrix.cutout, (5, *matrix.cutout)))
    starts = Starts.none(len(index), len(matrix))
    if elsewhere:
        starts = replace(starts, depth=depths_seen(known, index, data))
    for part in parts(index, np.arange(len(index))):
        model[part], columns[part] = modelled(known, index[part], starts.of(part))
        yield clock.at(int(80 * (part[-1] + 1) / len(index)))
    starts = replace(starts, window=windows_seen(index, data, model))
    again = starts.window.any(1)
    rounding = rounding_of(data, model, valid)
    for turn in range(TURNS):
        for part in parts(index, np.flatnonzero(again)):
            model[part], columns[part] = modelled(known, index[part], starts.of(part))
            yield clock.at(80 + 5 * turn)
        found = fitted(
            matrix, known, index, data, valid, model=model, columns=columns, starts=starts, rounding=rounding
        )
        moved = starts.nearer(found.values, index[:, 0])
        again = moved.apart_from(starts, index[:, 0])
        if not again.any():
            break
        starts = starts.only(moved, again)
    return found


def _alike(found: Evidence) -> F8:
    """Return the correlation of each pattern with what fits it best ``(n,)``."""
    return correlation(np.where(found.valid, found.data - found.left, np.float32(0)), found.data)
