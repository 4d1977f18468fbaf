"""Changes of H along the principal axes of a fit's covariance, which describe how uncertain the fitted H is.

If the unknowns of a fit have the covariance C, H is uncertain by ``sum_k xi_k D_k`` with independent standard normal
``xi_k``. Each ``D_k`` is the change of H for one step along an axis. A rotation of the axes does not change this
distribution. The axes are rotated such that a few of them contain nearly the whole change of H. This is possible
because H hardly depends on some combinations of correlated unknowns, although these are very uncertain.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, FileFormatError, InputError, Work, note
from lfcal.camera import ScanPlan
from lfcal.fit.earlier import NAMES, Earlier, read_earlier
from lfcal.fit.model import Fineness, ModelPlanes, open_model, predict
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.fit.setup import Setup
from lfcal.fit.spread import spread_out
from lfcal.fit.stored import read_fit
from lfcal.psf import Facts, Header, Plane, PlaneSource, PSFMatrix, Reopening, Stored, Zeros, iter_write, open_psf
from lfcal.work import RunChoice

__all__ = ["DeviationPlanes", "iter_write_deviations", "principal_axes"]

F8 = NDArray[np.float64]
Pair = tuple[Setup, Setup]

FILE = "deviations.h5"
"""Name of the file with the changes of H, in the folder of the fit."""

MOST_AXES = 6
"""Largest number of principal axes."""

ENOUGH = 0.99
"""Fraction of the squared change of H that the axes have to contain, unless there are `MOST_AXES`."""

SAMPLES = 6
"""Positions of each plane from which the axes are found."""


def principal_axes(setup: Setup, plan: ScanPlan, earlier: Earlier) -> list[Pair]:
    """Return the setups one step before and after ``setup`` along each principal axis, the most important first.

    ``plan`` is the scan of H, and ``earlier`` contains the covariance of the fit. The sources are at the positions of
    H. If further axes are left out, the steps are longer, so that the mean squared change of H remains the same.

    Raises
    ------
    InputError
        If no unknown of the fit changes H.
    """
    vector = Vector(setup, ScanScales.of(plan), earlier.groups)
    every = np.argwhere(np.ones(plan.shape[:3], bool))
    index = every[spread_out(every, SAMPLES * plan.shape[0], plan.period)]
    roots = earlier.roots(vector.unknowns)
    changes = np.array([_change(vector, root, plan, index).ravel() for root in roots])
    sizes = np.zeros(0)
    if len(roots):
        turn, sizes, _ = np.linalg.svd(changes, full_matrices=False)
    if not (sizes > 0).any():
        raise InputError.expected(
            "fit", "unknowns with uncertainties that change H", "none", "fit groups such as geometry (--unknowns)"
        )
    share = np.cumsum(sizes**2) / np.sum(sizes**2)
    count = min(int(np.searchsorted(share, ENOUGH)) + 1, MOST_AXES)
    axes = (turn.T @ roots)[:count] / math.sqrt(share[count - 1])
    return [(_ideal(vector, -axis), _ideal(vector, axis)) for axis in axes]


def _ideal(vector: Vector, u: F8) -> Setup:
    return replace(vector.setup_at(vector.clipped(u)), stage_scale=0.0, travel_rad=(0.0, 0.0))


def _change(vector: Vector, root: F8, plan: ScanPlan, index: NDArray[np.intp]) -> F8:
    """Return the change ``(n, nt, ns)`` of the patterns at positions ``index`` for the step ``root`` of unknowns.

    It is half the difference between the patterns at ``root`` and at ``-root``.
    """
    ends = []
    for sign in (-1, 1):
        light = predict(_ideal(vector, sign * root), plan, index, np.zeros((len(index), 2)), Fineness.coarse)
        total = np.bincount(index[:, 0], light.sum((1, 2), dtype=np.float64))
        ends.append(light / total[index[:, 0], None, None])
    return (ends[1] - ends[0]) / 2


class DeviationPlanes(PlaneSource):
    """Changes of H along several axes: all planes for the first axis, then all for the second.

    Each plane of H contains the recorded amount of light, because the gain of the plane was fitted to the recorded
    patterns. The changes are therefore those at constant light in each plane, as fractions of this light.

    Parameters
    ----------
    pairs
        Setups before and after a step along each axis, as from `principal_axes`.
    plan
        Scan of H.
    provenance
        Provenance of the file.
    """

    title = "compute"

    def __init__(self, pairs: Sequence[Pair], plan: ScanPlan, provenance: Mapping[str, Any]) -> None:
        nz, *sizes = plan.shape
        self.header = Header((len(pairs) * nz, *sizes), anchor=plan.anchor, provenance=provenance)
        part, gains = Header(plan.shape), [1.0] * nz
        self._pairs = [tuple(ModelPlanes(part, one, plan, gains, Fineness.coarse) for one in pair) for pair in pairs]
        self._planes = nz

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute the change along one axis of one plane; progress counts rows of this plane, or of all planes."""
        axis, own = divmod(z, self._planes)
        count, rows = self.header.shape[:2]
        clock = Clock("uncertainty of H", 2 * rows * (1 if alone else count))
        values, found = zeros(), []
        for k, model in enumerate(self._pairs[axis]):
            work = model.iter_plane(own, lambda: np.zeros_like(values), workers, alone=True)
            before = rows * (k + 2 * (0 if alone else z))
            while True:
                try:
                    yield clock.at(before + next(work).done)
                except StopIteration as stop:
                    plane: Plane = stop.value
                    break
            found.append(plane.values / plane.values.sum(dtype=np.float64))
        values[:] = (found[1] - found[0]) / 2
        return Plane(values, Facts.of(values.shape[:2], values.shape[2:]))

    def reopening(self, z: int, stored: Stored) -> Reopening:
        """Return both setups of the axis as plain JSON types, and the name of the function that reads them."""
        axis, own = divmod(z, self._planes)
        pair = [model.reopening(own, stored).values for model in self._pairs[axis]]
        return Reopening(f"{__name__}:{open_deviations.__name__}", {"pair": pair, "axis": axis})

    def named(self, out: Path) -> str:
        """Return the title of a run of units that writes ``out``, for messages."""
        return "uncertainty of H"


def open_deviations(values: Mapping[str, Any], workers: int) -> DeviationPlanes:
    """Return the planes of the axis in ``values`` of `DeviationPlanes.reopening`, repeated for all axes before it."""
    before, after = (open_model(one, workers) for one in values["pair"])
    pairs = [(before.setup, after.setup)] * (int(values["axis"]) + 1)
    return DeviationPlanes(pairs, before.planned, {})


def iter_write_deviations(
    folder: Path, H: PSFMatrix, *, workers: int | None = None, run: RunChoice | None = None
) -> Work[Path]:
    """Write the changes of ``H`` along the principal axes of the fit in ``folder`` to a file there; return its path.

    An existing file for the same scan and fit is used again. A note is issued if the fit is incomplete.

    Parameters
    ----------
    folder
        Folder that ``lfcal fit`` wrote.
    H
        H of the scan that was fitted.
    workers
        Number of threads. None: all processors.
    run
        Executor that computes the planes as units. None: one after another.

    Raises
    ------
    InputError
        If the fit belongs to another scan, or none of its unknowns changes H.
    StorageError, FileFormatError
        If a file of the fit cannot be read, or the new file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.fit import iter_write_deviations
    >>> from lfcal.psf import open_psf
    >>> def uncertain_planes(fit: str, psf: str):
    ...     with open_psf(psf) as H:
    ...         return (yield from iter_write_deviations(Path(fit), H))
    """
    earlier, fit = read_earlier(folder), read_fit(folder)
    plan = ScanPlan(fit.setup.camera, H.period, H.cutout, tuple(map(float, H.depths)), H.anchor)
    fit.check(replace(plan, resample=bool(_stated_plan(H).get("resample", False))))
    out = folder / FILE
    known = {"fit": _digest(folder), "shape": list(H.shape)}
    if not earlier.complete:
        note(f"{folder.name}: the model does not explain all patterns; H has errors beyond the covariance of its fit")
    if out.is_file() and _is_current(out, known):
        return out
    pairs = principal_axes(fit.setup, plan, earlier)
    source = DeviationPlanes(pairs, plan, {"deviations": known})
    return (yield from iter_write(source, out, run=run, workers=workers))


def _stated_plan(H: PSFMatrix) -> Mapping[str, Any]:
    found = H.provenance.get("plan")
    return found if isinstance(found, Mapping) else {}


def _digest(folder: Path) -> str:
    return hashlib.sha256(b"".join((folder / name).read_bytes() for name in NAMES)).hexdigest()[:16]


def _is_current(out: Path, known: Mapping[str, Any]) -> bool:
    try:
        with open_psf(out) as there:
            return bool(there.provenance.get("deviations") == known)
    except FileFormatError:
        return False  # damaged
