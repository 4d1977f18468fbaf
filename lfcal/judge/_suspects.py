"""Find suspect positions by metrics without a model; each is then compared with the camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.judge.quality import QualityReport

__all__ = ["suspects"]

MAPS = ("step", "flicker", "jitter", "misplaced", "missing", "duplicates")
"""Keys of metrics whose maps show single patterns that differ from their neighbours."""

FAR = 6.0
"""Multiple of the typical scatter of a map above which a position is suspect."""


def suspects(quality: QualityReport) -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` (z, y, x) that stand out from their planes, the most unusual first."""
    found: list[tuple[float, tuple[int, ...]]] = []
    for metric in quality.metrics:
        if metric.key not in MAPS:
            continue
        found += [(np.inf, tuple(place)) for place in metric.positions.tolist()]
        for z, plane in enumerate(() if metric.map is None else metric.map):
            known = np.isfinite(plane)
            if known.sum() < 8:
                continue
            away = np.where(known, np.abs(plane - np.median(plane[known])), 0.0)
            usual = max(1.4826 * float(np.median(away[known])), 1e-9 * float(away.max()))
            odd = np.argwhere(away > FAR * usual)
            found += [(float(away[y, x] / usual), (z, y, x)) for y, x in odd.tolist()]
    chosen = list(dict.fromkeys(place for _, place in sorted(found, key=lambda one: (-one[0], one[1]))))
    return np.array(chosen, np.intp).reshape(-1, 3)
