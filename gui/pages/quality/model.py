"""What the Quality page shows of a report: rows, words and maps. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.progress import Work

if TYPE_CHECKING:
    from lfcal.psf.quality import Metric, QualityReport

__all__ = [
    "Measured",
    "MetricRow",
    "iter_measure",
    "iter_write_report",
    "map_of",
    "planes_of",
    "report_files",
    "rows_of",
    "title_of",
    "words_of",
    "worst_positions",
]


@dataclass(frozen=True)
class MetricRow:
    """One metric as a row of the table."""

    key: str
    title: str
    value: str
    limits: str
    merit: str
    cost: str


@dataclass(frozen=True, eq=False)
class Measured:
    """A report, and the depths of the planes it is about (µm)."""

    report: QualityReport
    depths: NDArray[np.float64]


def iter_measure(psf: str) -> Work[Measured]:
    """Return the work that opens the H in a file and inspects it."""
    from lfcal.psf import open_psf
    from lfcal.psf.quality import iter_inspect

    with open_psf(psf) as matrix:
        report = yield from iter_inspect(matrix)
        return Measured(report, np.array(matrix.depths))


def iter_write_report(psf: str, folder: str, measured: QualityReport | None) -> Work[Path]:
    """Return the work that opens the H in a file and writes its report; ``measured`` is not measured again."""
    from lfcal.psf import open_psf
    from lfcal.psf.report import iter_report

    with open_psf(psf) as matrix:
        page = yield from iter_report(matrix, Path(folder), quality=measured)
        return page


def report_files(folder: str) -> list[Path]:
    """Return the files of a report that somebody may have put into ``folder`` before."""
    return [Path(folder) / name for name in ("index.html", "quality.json", "redo.json")]


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
