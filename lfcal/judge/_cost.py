"""Measure the cost of faults, by reconstructing a fixed scene with patterns with and without a fault."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work
from lfcal.judge._patch import Patch, patch_of
from lfcal.judge._scenes import SceneTrial
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import FoundFault
from lfcal.simulate.engines import EnergyError

__all__ = ["Costs", "iter_costs"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

SIDE_PX = 48
"""Smallest side of the image (pixels), so that light of distant points hardly overlaps."""

LARGE_PX = 96
"""Smallest side of the image of a trial on a whole plane, because effects vary from voxel to voxel."""

PLANES = 3
"""Largest number of planes that are reconstructed."""

FEWEST, MOST = 64, 2600
"""Smallest and largest number of positions of H in a patch."""

CUTOUT_PX = 191
"""Largest number of rows and columns of cutouts, because dark surroundings also take time."""

CUTOUT = (CUTOUT_PX, CUTOUT_PX)

MOST_SAMPLES = 24_000_000
"""Largest number of samples of a patch, of which several copies are in memory."""

SAMPLE = 64
"""Number of compared patterns that determine how much of a fault a patch shows."""

MOST_OF_REST = 3.0
"""Largest ratio of a fault's cost to its estimate, if H costs more than its known faults."""

SHOWN = 0.3
"""Fraction of its typical strength that a fault must have in a patch; otherwise it gets a separate patch."""


@dataclass(frozen=True)
class Costs:
    """Costs of faults.

    Attributes
    ----------
    clean
        Error of a reconstruction due to the noise of H alone, relative to one with noise-free patterns.
    as_it_is
        Error of a reconstruction due to the noise and faults of H.
    costs
        Additional error due to each finding; errors add in quadrature. None: not measured.
    whole
        Whether the errors apply to all of H instead of a part of it.
    """

    clean: float | None
    as_it_is: float | None
    costs: tuple[float | None, ...]
    whole: bool = False


def iter_costs(evidence: Evidence, faults: Sequence[FoundFault], many: int | None = None) -> Work[Costs]:
    """Measure the error of a reconstruction that each finding adds to the noise of H.

    A patch of neighbouring positions in up to three planes is computed as the camera should show it, as large as
    `MOST` and `MOST_SAMPLES` allow. If that is less than all of H, the error is scaled to the strength of the fault in
    all of H. Errors come from `SceneTrial`, between volumes from the same image: with ideal patterns, and with the
    noise of H and the fault in them.

    Parameters
    ----------
    evidence
        The compared patterns, without the faults.
    faults
        The faults found.
    many
        Number of positions of a smaller patch, whose image is smaller too. None: the largest allowed number. It never
        depends on time, so that costs are the same on every machine.
    """
    clock = Clock("measuring the cost of faults", len(faults) + 2)
    yield clock.at(0)
    if not faults:
        return Costs(None, None, ())
    order = sorted(range(len(faults)), key=lambda k: -faults[k].share)
    try:
        worst = [faults[k] for k in order]
        trial = _Trial.at(evidence, worst, _planes(evidence, faults), many)
        yield clock.at(1)
        as_it_is = trial.error(trial.patch.recorded)
        costs: list[float | None] = [None] * len(faults)
        for done, k in enumerate(order):
            yield clock.at(2 + done)
            if faults[k].wider > 1:
                costs[k] = _wider(evidence, faults[k], many)
                continue
            own, factor = trial, trial.factor(faults[k])
            if factor > 1 / SHOWN:
                own = _own_trial(evidence, faults[k], many)
                factor = own.factor(faults[k])
            costs[k] = own.cost(faults[k], factor)
    except (InputError, EnergyError):  # the camera can be computed for the patterns, but not for a patch
        return Costs(None, None, (None,) * len(faults))
    if trial.sample is None:
        costs = _consistent(costs, faults, _beyond(as_it_is, trial.clean))
    yield clock.at(len(faults) + 2)
    return Costs(trial.clean, as_it_is, tuple(costs), trial.sample is None)


def _beyond(error: float, clean: float) -> float:
    """Return the part of an error that is not due to noise; independent errors add in quadrature."""
    return math.sqrt(max(0.0, error**2 - clean**2))


def _consistent(costs: Sequence[float | None], faults: Sequence[FoundFault], all_of_it: float) -> list[float | None]:
    """Return costs whose squares add up to at most the square of ``all_of_it``, the cost of H itself.

    The remainder is assigned to faults that the patterns only sample: single frames, of which some were compared, and
    scatter. Light that only larger cutouts show is not part of the H.
    """
    here = [k for k, one in enumerate(faults) if one.wider == 1 and costs[k] is not None]
    sampled = [k for k in here if faults[k].extent is not None or faults[k].scatters]

    def power(which: Sequence[int]) -> float:
        return sum((costs[k] or 0.0) ** 2 for k in which)

    out = list(costs)
    total, some = power(here), power(sampled)
    if total > all_of_it**2:
        which, factor = here, all_of_it / math.sqrt(total)
    elif some > 0:
        which, factor = sampled, min(MOST_OF_REST, math.sqrt((all_of_it**2 - total + some) / some))
    else:
        return out
    for k in which:
        out[k] = factor * (costs[k] or 0.0)
    return out


def _own_trial(evidence: Evidence, finding: FoundFault, many: int | None) -> _Trial:
    return _Trial.at(evidence, (finding,), _planes(evidence, (finding,)), many, finding.wider)


def _wider(evidence: Evidence, finding: FoundFault, many: int | None) -> float | None:
    """Return the cost of a fault that only larger cutouts show; None if they do not fit on the sensor."""
    try:
        own = _own_trial(evidence, finding, many)
    except (InputError, EnergyError):
        return None
    return own.cost(finding, own.factor(finding))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A patch, and the reconstruction of a scene with its patterns."""

    patch: Patch
    shape: tuple[int, int, int]
    scene: SceneTrial
    clean: float
    sample: Patch | None

    @classmethod
    def at(
        cls, evidence: Evidence, faults: Sequence[FoundFault], planes: list[int], many: int | None, wider: float = 1.0
    ) -> _Trial:
        """Return the trial on a patch around the first of the faults."""
        side = LARGE_PX if many is None else SIDE_PX
        place, period = _place(evidence, faults[0]), evidence.plan.period
        many = min(MOST if many is None else many, max(FEWEST, MOST_SAMPLES // _samples(evidence, wider)))
        # the whole period of fewer planes, because a part of the period differs more from the whole
        while len(planes) > 1 and many < len(planes) * period[0] * period[1]:
            planes = planes[:-1]
        planes = sorted(planes)
        block = _block(period, many // len(planes))
        whole = block == period and len(planes) == evidence.plan.shape[0]
        first = [
            0 if b == n else int(np.clip(p - b // 2, 0, n - b)) for p, b, n in zip(place, block, period, strict=True)
        ]
        y, x = (f + np.arange(b) for f, b in zip(first, block, strict=True))
        index = np.stack([a.ravel() for a in np.meshgrid(planes, y, x, indexing="ij")], 1).astype(np.intp)
        patch = patch_of(evidence, index, CUTOUT, wider=wider)
        sample = None
        if not whole:
            every = np.linspace(0, len(evidence) - 1, min(SAMPLE, len(evidence))).astype(int)
            sample = patch_of(evidence, evidence.index[every], CUTOUT, wider=wider)
        shape = (len(planes), *block)
        scene = SceneTrial(patch.light.reshape(*shape, *patch.light.shape[1:]), side)
        bare = cls(patch, shape, scene, 0.0, sample)
        return replace(bare, clean=bare.error(patch.light))

    def error(self, light: F4) -> float:
        """Return the error of a reconstruction with the patterns ``light`` and the noise of H."""
        return self.scene.error((light + self.patch.noise).reshape(*self.shape, *light.shape[1:]))

    def factor(self, finding: FoundFault) -> float:
        """Return the ratio of the power of a fault in all of H to that in the patch."""
        if finding.put_in is None:
            return 1.0
        if finding.extent is not None:
            here = len(_within(finding.positions, self.patch.index)) / len(self.patch.index)
            return finding.extent / here if here else np.inf
        if self.sample is None:
            return 1.0
        own = _power(self.patch, finding)
        return _power(self.sample, finding) / own if own > 0 else np.inf

    def cost(self, finding: FoundFault, factor: float) -> float | None:
        if finding.put_in is None or not np.isfinite(factor):
            return None
        return math.sqrt(factor) * _beyond(self.error(finding.put_in(self.patch)), self.clean)


def _power(patch: Patch, finding: FoundFault) -> float:
    assert finding.put_in is not None
    change = np.square(finding.put_in(patch) - patch.light).sum(dtype=np.float64)
    return float(change / max(1e-300, np.square(patch.light).sum(dtype=np.float64)))


def _within(positions: NDArray[np.intp], index: NDArray[np.intp]) -> list[tuple[int, ...]]:
    inside = set(map(tuple, index.tolist()))
    return [p for p in map(tuple, positions.tolist()) if p in inside]


def _planes(evidence: Evidence, faults: Sequence[FoundFault]) -> list[int]:
    """Return the planes that the faults affect most, then others spread over H."""
    nz = evidence.plan.shape[0]
    if nz <= PLANES:
        return list(range(nz))
    votes = np.zeros(nz)
    for one in faults:
        own, counts = np.unique(one.positions[:, 0], return_counts=True)
        votes[own] += one.share * counts / max(1, counts.sum())
    wanted = [int(z) for z in np.argsort(-votes, kind="stable")[: PLANES - 1] if votes[z] > 0]
    for z in np.rint(np.linspace(0, nz - 1, PLANES)).astype(int).tolist():
        if len(wanted) < PLANES and z not in wanted:
            wanted.append(z)
    return wanted


def _place(evidence: Evidence, finding: FoundFault) -> tuple[int, int]:
    """Return the position (y, x) around which a fault is strongest."""
    ny, nx = evidence.plan.period
    if finding.extent is not None:
        y, x = finding.positions[len(finding.positions) // 2, 1:].tolist()
        return y, x
    if len(finding.pixels):
        # cutouts around a pixel have it in their middle
        row, column = np.median(finding.pixels, axis=0) - (np.array(evidence.plan.cutout) - 1) / 2
        return int(np.clip(row, 0, ny - 1)), int(np.clip(column, 0, nx - 1))
    return ny // 2, nx // 2


def _samples(evidence: Evidence, wider: float) -> int:
    """Return the number of samples in one pattern of a patch."""
    rows, columns = evidence.plan.cutout
    return round(min(wider * rows, CUTOUT_PX) * min(wider * columns, CUTOUT_PX))


def _block(period: tuple[int, int], many: int) -> tuple[int, int]:
    """Return the rows and columns of a block of at most ``many`` positions, as square as the period allows."""
    ny, nx = period
    if many >= ny * nx:
        return period
    rows = min(ny, max(1, int(np.sqrt(many))))
    columns = min(nx, max(1, many // rows))
    return min(ny, max(1, many // columns)), columns
