"""Frames that were suspicious during the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _suspect(measures: MatrixMeasures) -> Sequence[Reading]:
    """Return the positions that the session flagged, as stored in H."""
    nz, ny, nx = measures.matrix.shape[:3]
    named = np.zeros((nz, ny, nx), bool)
    words: set[str] = set()
    entries: Any = measures.matrix.provenance.get("suspect")
    for entry in entries if isinstance(entries, list) else ():
        if _is_entry(entry, (nz, ny, nx)):
            named[tuple(entry[:3])] = True
            words.add(str(entry[3])[:80])
    # without flags the value is unknown: the frames may come from another program without supervision
    if not named.any():
        return [UNKNOWN]
    detail = "; ".join(sorted(words)[:8])
    return [Reading(float(plane.sum()), positions=plane, detail=detail if plane.any() else "") for plane in named]


def _is_entry(entry: Any, shape: tuple[int, int, int]) -> bool:
    """Return whether ``entry`` is (z, y, x, words), because provenance comes from a file and may contain anything."""
    return (
        isinstance(entry, list)
        and len(entry) == 4
        and all(type(v) is int and 0 <= v < n for v, n in zip(entry[:3], shape, strict=True))
    )


METRICS = (
    MetricSpec(
        key="suspect",
        title="Suspect frames",
        subject="frames",
        unit="frames",
        limits=Limits(good=0, bad=0),
        cost=CostModel(at_bad=1.2, worst=2.0, per_frame=True),
        plot="map",
        meaning="Frames whose content was suspicious during the recording, and again when they were repeated.",
        advice="Remove the cause, then record these positions again.",
        overall="sum",
        redo=True,
        of_matrix=_suspect,
    ),
)
