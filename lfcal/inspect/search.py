"""Faults one after the other: what is found is taken out of the patterns before the next is looked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from lfcal.inspect.evidence import Evidence
from lfcal.inspect.finding import FAULTS, Fault, Finding
from lfcal.progress import Clock, Work

__all__ = ["iter_search"]

Look = Callable[[Evidence], Iterable[Finding]]


def iter_search(evidence: Evidence) -> Work[tuple[tuple[Finding, ...], Evidence]]:
    """Look for every fault; return what was found, and the evidence without it."""
    found: list[Finding] = []
    explained: set[str] = set()
    looks = _looks()
    clock = Clock("looking for faults", len(looks))
    for k, (fault, look) in enumerate(looks):
        yield clock.at(k)
        if fault.name in explained:
            continue
        own = tuple(look(evidence))
        for one in own:
            evidence = _without(evidence, one)
        if own:
            explained.update(fault.explains)
        found += own
    yield clock.at(len(looks))
    return tuple(found), evidence


def _looks() -> list[tuple[Fault, Look]]:
    """Return every fault with what looks for it, in their order; some are looked for twice."""
    both = [(fault.rank, fault, fault.found) for fault in FAULTS]
    both += [(fault.strong_rank, fault, fault.strong) for fault in FAULTS if fault.strong_rank is not None]
    return [(fault, look) for _, fault, look in sorted(both, key=lambda one: (one[0], one[1].name))]


def _without(evidence: Evidence, finding: Finding) -> Evidence:
    if finding.repair is None and not finding.blinds and finding.masked is None and finding.extent is None:
        return evidence
    data = evidence.data if finding.repair is None else finding.repair(evidence.index, evidence.data)
    valid = evidence.valid & ~_blinded(evidence, finding.pixels) if finding.blinds else evidence.valid
    if finding.masked is not None:
        valid = valid & ~finding.masked(evidence.data)
    if finding.extent is not None:  # single frames that are none of their places tell nothing more
        bad = set(map(tuple, finding.positions.tolist()))
        valid = valid & ~np.array([place in bad for place in map(tuple, evidence.index.tolist())])[:, None, None]
    return evidence.with_data(data, valid)


def _blinded(evidence: Evidence, pixels: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return which samples ``(n, nt, ns)`` fall on pixels of the sensor."""
    ny, nx = evidence.plan.period
    nt, ns = evidence.plan.cutout
    blind = np.zeros((ny + nt - 1, nx + ns - 1), np.bool_)
    blind[tuple(pixels.T)] = True
    return np.stack([blind[r : r + nt, c : c + ns] for r, c in evidence.corners().tolist()])
