"""What the Quality page shows of a report: rows, words and maps. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from lfcal.psf.quality import Metric, QualityReport

__all__ = ["MetricRow", "map_of", "planes_of", "rows_of", "title_of", "words_of", "worst_positions"]


@dataclass(frozen=True)
class MetricRow:
    """One metric as a row of the table."""

    key: str
    title: str
    value: str
    limits: str
    merit: str
    cost: str


def rows_of(report: QualityReport) -> tuple[MetricRow, ...]:
    """Return the metrics in the report's order: what costs most comes first."""
    return tuple(
        MetricRow(m.key, m.spec.title, m.text, m.limits, m.merit, f"{m.cost:.3f}" if m.cost > 0 else "–")
        for m in report.metrics
    )


def title_of(metric: Metric) -> str:
    """Return the title for an axis, with the unit."""
    return f"{metric.spec.title} ({metric.spec.unit})" if metric.spec.unit else metric.spec.title


def planes_of(report: QualityReport) -> int:
    """Return how many planes the maps have; 1 where there is no map."""
    return max((len(m.map) for m in report.metrics if m.map is not None), default=1)


def words_of(metric: Metric) -> str:
    """Return what the metric means and what to do, as rich text."""
    parts = [f"<b>{metric.spec.title}: {metric.text}</b> ({metric.merit}; {metric.limits})", metric.spec.meaning]
    if metric.detail:
        parts.append(metric.detail)
    if metric.merit in ("fair", "bad"):
        parts.append(f"<b>What to do:</b> {metric.spec.advice}")
    return "<br>".join(parts)


def map_of(metric: Metric, z: int) -> NDArray[np.float32] | None:
    """Return the value per position ``(ny, nx)`` of plane ``z``, None where the metric has no map."""
    if metric.map is None or not 0 <= z < len(metric.map):
        return None
    plane: NDArray[np.float32] = metric.map[z]
    return plane if np.isfinite(plane).any() else None


def worst_positions(report: QualityReport) -> tuple[tuple[int, int, int], ...]:
    """Return the positions that should be recorded again, each once, in the order of the scan."""
    return tuple(sorted({position for position, _ in report.redo()}))
