"""Search for faults one after the other; each is removed from the patterns before the next is searched for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import FAULTS, Fault, FoundFault

__all__ = ["iter_search"]

STRONG, MOST, SURELY = 0.04, 0.5, 6.0
"""Misfit above which strong faults are searched for first, fraction of the misfit that a strong fault must explain, and
its required significance in standard deviations."""


def iter_search(evidence: Evidence) -> Work[tuple[tuple[FoundFault, ...], Evidence]]:
    """Search for all kinds of fault in turn; return the faults found, and the evidence after their removal.

    Kinds that a fault found earlier explains are skipped.

    Examples
    --------
    >>> from lfcal.judge import iter_evidence, iter_search
    >>> from lfcal.base import drain
    >>> from lfcal.psf import PSFMatrix, open_psf
    >>> with open_psf("H.h5") as H:
    ...     values, own = H[:], {"depths": H.depths, "camera": H.camera, "anchor": H.anchor}
    >>> for x in range(33):
    ...     values[:, :, x, :, 40 - x] += 200.0
    >>> evidence = drain(iter_evidence(PSFMatrix(values, **own), patterns=24))
    >>> faults, rest = drain(iter_search(evidence))
    >>> for one in faults:
    ...     print(f"{one.title}: {one.detail}")
    hot line of the sensor: column 40 of the scanned region: 200 counts too high
    """
    found: list[FoundFault] = []
    explained: set[str] = set()
    whole: set[str] = set()
    looks = _looks()
    clock = Clock("searching for faults", len(looks))
    for k, (fault, strong) in enumerate(looks):
        yield clock.at(k)
        if fault.name in explained or (strong and evidence.misfit < STRONG):
            continue
        for one in tuple(fault.found(evidence)):
            without = _without(evidence, one)
            if strong and (one.sigmas < SURELY or without.misfit > (1 - MOST) * evidence.misfit):
                continue
            # a strong fault may have looked like displacements, which models have followed
            evidence = without.followed() if strong else without
            explained.update(fault.explains)
            # the remainder of a strong fault is not a second fault
            if fault.name not in whole:
                found.append(one)
        if strong and any(one.fault is fault for one in found):
            whole.add(fault.name)
    yield clock.at(len(looks))
    return tuple(found), evidence


def _looks() -> list[tuple[Fault, bool]]:
    """Return every fault in the order of the search; strong faults that are searched for first appear twice."""
    both = [(fault.rank, fault.name, fault, False) for fault in FAULTS]
    both += [(fault.strong_rank, fault.name, fault, True) for fault in FAULTS if fault.strong_rank is not None]
    return [(fault, strong) for _, _, fault, strong in sorted(both, key=lambda one: one[:2])]


def _without(evidence: Evidence, finding: FoundFault) -> Evidence:
    if finding.repair is None and not finding.blinds and finding.masked is None and finding.extent is None:
        return evidence
    data = evidence.data if finding.repair is None else finding.repair(evidence.index, evidence.data)
    valid = evidence.valid & ~_blinded(evidence, finding.pixels) if finding.blinds else evidence.valid
    if finding.masked is not None:
        valid = valid & ~finding.masked(evidence.data)
    if finding.extent is not None:  # foreign frames contain no further information
        bad = set(map(tuple, finding.positions.tolist()))
        valid = valid & ~np.array([place in bad for place in map(tuple, evidence.index.tolist())])[:, None, None]
    return evidence.with_data(data, valid)


def _blinded(evidence: Evidence, pixels: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask ``(n, nt, ns)`` of the samples that show these pixels of the sensor."""
    ny, nx = evidence.plan.period
    nt, ns = evidence.plan.cutout
    blind = np.zeros((ny + nt - 1, nx + ns - 1), np.bool_)
    blind[tuple(pixels.T)] = True
    return np.stack([blind[r : r + nt, c : c + ns] for r, c in evidence.corners().tolist()])
