"""What the user chose on the Quality page, and what it shows: rows, words and maps. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.records import rows
from lfcal.tasks import Inspect
from lfcal_gui.models import Field, PageSettings, Verdict, capital, fields_of, verdict_of

if TYPE_CHECKING:
    from lfcal.judge import FoundFault, Inspection
    from lfcal.judge.quality import Metric

__all__ = [
    "CAMERAS",
    "FIELDS",
    "HELD",
    "FaultRow",
    "MetricRow",
    "QualitySettings",
    "concerned",
    "count_words",
    "fault_rows",
    "fault_words",
    "kept_of",
    "listed_metrics",
    "map_of",
    "marked",
    "merit_of",
    "metric_rows",
    "metric_words",
    "planes_of",
    "summary_of",
    "title_of",
    "weight_of",
    "worst_positions",
]

SECONDS_0_1 = 10.0
"""Default limit of version 0.1 (s)."""

CAMERAS = (("fitted", "fitted, else described"), ("own", "as H describes it"))
"""Which camera patterns are compared with; the folder of a fit that was saved stands beside these."""

HELD = frozenset({"source", "mat_order", "report", "reference", "fit", "every", "strict"})
"""Fields of `lfcal.tasks.Inspect` that other widgets show, or that have no meaning in a window."""

ROWS = {row.name: row for row in rows(Inspect) if row.name not in HELD}

FIELDS = (
    *fields_of(Inspect, without=HELD),
    Field(
        "camera",
        "Camera",
        kind="choice",
        choices=CAMERAS,
        default="fitted",
        tip="The camera that patterns are compared with: as page Fit found it for this H, or as H describes it.",
    ),
)

MARKED = 2000
"""Positions of a plane up to which each is marked."""


@dataclass(frozen=True)
class QualitySettings(PageSettings):
    """What the user chose.

    Attributes
    ----------
    seconds, patterns, session
        As of `lfcal.tasks.Inspect`; an empty session: none.
    camera
        One of `CAMERAS`, or ``"saved"``: that of ``fit``.
    fit
        Folder of a fit that was saved.
    by_number
        Whether planes of two H belong together by their numbers, not by their depths.
    """

    page: ClassVar[str] = "quality"

    seconds: float = ROWS["seconds"].default
    patterns: int = ROWS["patterns"].default
    session: str = ""
    camera: str = "fitted"
    fit: str = ""
    by_number: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types; the limit has another name than in 0.1."""
        stored = super().to_dict()
        return {**stored, "most_s": stored.pop("seconds")}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the settings in ``data``, of 0.1 too."""
        if isinstance(data, Mapping):
            # 10 s was the default of 0.1, for a part of H; now it ends before H is fully judged
            old = {} if data.get("seconds") == SECONDS_0_1 else {key: data[key] for key in ("seconds",) if key in data}
            new = {"seconds": data["most_s"]} if "most_s" in data else old
            data = {**{key: value for key, value in data.items() if key != "seconds"}, **new}
        return super().from_dict(data)

    def __post_init__(self) -> None:
        """Check every value."""
        for name, row in ROWS.items():
            row.value(getattr(self, name), row.label)
        if self.camera not in (*dict(CAMERAS), "saved"):
            raise InputError.expected("camera", " or ".join(dict(CAMERAS)), self.camera, "choose one of these")


@dataclass(frozen=True)
class FaultRow:
    """One fault as a row: its name, what was found, its weight, how sure it is, and the merit it stands for."""

    title: str
    detail: str
    weight: str
    sure: str
    merit: str


@dataclass(frozen=True)
class MetricRow:
    """One metric as a row; ``merit`` colours it, ``told`` is said of it."""

    key: str
    title: str
    value: str
    good: str
    bad: str
    merit: str
    told: str
    cost: str


# -- faults ------------------------------------------------------------------------------------------------
def weight_of(inspection: Inspection, finding: FoundFault) -> str:
    """Return how much a fault matters: what it makes of a reconstruction's error, else the light that it changes."""
    from lfcal.base import format_share
    from lfcal.judge import cost_words

    if finding.cost is None:
        return f"{format_share(min(finding.share, 1.0))} of light"
    return cost_words(inspection, finding)


def merit_of(finding: FoundFault) -> str:
    """Return the merit that a fault stands for; unknown: too small to matter."""
    from lfcal.judge import is_bad, is_fair

    return "bad" if is_bad(finding) else "fair" if is_fair(finding) else "unknown"


def sure_of(finding: FoundFault) -> str:
    """Return how sure a fault is, in per cent that never claim certainty."""
    percent = 100 * finding.confidence
    return "> 99.9 %" if percent > 99.9 else f"{percent:.1f} %"


def fault_rows(inspection: Inspection) -> tuple[FaultRow, ...]:
    """Return the faults in the inspection's order: what matters most comes first."""
    return tuple(
        FaultRow(one.title, one.detail, weight_of(inspection, one), sure_of(one), merit_of(one))
        for one in inspection.faults
    )


def fault_words(inspection: Inspection, finding: FoundFault) -> str:
    """Return what a fault is, what it costs and what to do, as rich text."""
    from lfcal.base import format_share
    from lfcal.judge import cost_words

    parts = [f"<b>{capital(finding.title)}</b>: {finding.detail}"]
    stands = f"stands out by {min(finding.sigmas, 999):.0f} sigma"
    share = format_share(min(finding.share, 1.0))
    parts.append(f"It changes {share} of the light; {stands}. {place_words(finding)}")
    if finding.cost is not None:
        words = "Error of a reconstruction (NRMSE), by noise alone → with the fault"
        parts.append(f"{words}: {cost_words(inspection, finding)}.")
    parts.append(f"<b>What to do:</b> {finding.fault.advice} {atlas_link(finding.name)}")
    return "<br>".join(parts)


def atlas_link(name: str) -> str:
    """Return a link to the fault's section of the atlas: its path is the fault's name."""
    return f"<a href='fault:{name}'>See it in the fault atlas</a>"


def place_words(finding: FoundFault) -> str:
    """Return how many positions and pixels a fault concerns."""
    many = len(finding.positions)
    where = f"{many} position{'s' * (many != 1)} concerned" if many else "All positions are concerned"
    pixels = len(finding.pixels)
    more = f", {pixels} pixel{'s' * (pixels != 1)} of the sensor" if pixels else ""
    again = "; record again" if finding.redo and many else ""
    return f"{where}{more}{again}."


def concerned(finding: FoundFault, shape: tuple[int, ...], z: int) -> NDArray[np.float32] | None:
    """Return 1 where a fault concerns positions ``(ny, nx)`` of plane ``z``, else 0; None: it concerns them all."""
    if not len(finding.positions):
        return None
    plane = np.zeros(shape[1:3], np.float32)
    here = finding.positions[finding.positions[:, 0] == z]
    plane[here[:, 1], here[:, 2]] = 1.0
    return plane


def marked(positions: NDArray[np.intp], z: int) -> NDArray[np.intp]:
    """Return the positions (y, x) of plane ``z`` that are marked ``(n, 2)``; none where they would hide the map."""
    here = positions[positions[:, 0] == z, 1:]
    return here if len(here) <= MARKED else here[:0]


# -- metrics -----------------------------------------------------------------------------------------------
def listed_metrics(inspection: Inspection, *, every: bool = False) -> tuple[Metric, ...]:
    """Return the metrics that are listed, in the report's order; with ``every`` also those that do not apply."""
    return tuple(m for m in inspection.quality.metrics if every or m.applies)


def count_words(inspection: Inspection) -> str:
    """Return how many metrics are good, and how many do not apply."""
    from lfcal.judge.quality import counted_words

    return capital(counted_words(inspection.quality.metrics))


def metric_rows(inspection: Inspection, *, every: bool = False) -> tuple[MetricRow, ...]:
    """Return `listed_metrics` as rows; with a note where a fault causes it or the camera refutes it."""
    from lfcal.judge.report import limits

    rows = []
    for m in listed_metrics(inspection, every=every):
        cost = m.cost_text if m.cost > 0 else "–"
        merit, told = told_of(inspection, m)
        rows.append(MetricRow(m.key, m.spec.title, m.text, *limits(m), merit, told, cost))
    return tuple(rows)


def told_of(inspection: Inspection, metric: Metric) -> tuple[str, str]:
    """Return the merit by which a metric is coloured, and the word for it."""
    from lfcal.judge.quality import merit_of as merit_of_metric
    from lfcal.judge.quality import merit_word

    if metric.merit in ("bad", "fair"):
        if inspection.settled(metric) is not None:
            return "unknown", "see fault"
        if inspection.withdrawn(metric):
            return "unknown", "not confirmed"
    return merit_of_metric(metric), merit_word(metric)


def metric_words(inspection: Inspection, metric: Metric) -> str:
    """Return what a metric means and what to do, as rich text."""
    parts = [f"<b>{metric.spec.title}: {metric.text}</b> ({metric.merit}; {metric.limits})", metric.spec.meaning]
    if metric.detail:
        parts.append(metric.detail)
    if metric.merit in ("fair", "bad"):
        cause = inspection.settled(metric)
        if cause is not None:
            parts.append(f"<b>See the fault “{cause.title}”</b>, which makes it. {atlas_link(cause.name)}")
        elif inspection.withdrawn(metric):
            parts.append("<b>Not confirmed</b>: the comparison with the camera measured it, and found nothing of it.")
        else:
            parts.append(f"<b>What to do:</b> {metric.spec.advice}")
    return "<br>".join(parts)


def title_of(metric: Metric) -> str:
    """Return the title for an axis, with the unit."""
    return f"{metric.spec.title} ({metric.spec.unit})" if metric.spec.unit else metric.spec.title


def planes_of(inspection: Inspection) -> int:
    """Return how many planes the maps have."""
    return inspection.quality.shape[0]


def map_of(metric: Metric, z: int) -> NDArray[np.float32] | None:
    """Return the value per position ``(ny, nx)`` of plane ``z``, None where the metric has no map."""
    if metric.map is None or not 0 <= z < len(metric.map):
        return None
    plane: NDArray[np.float32] = metric.map[z]
    return plane if np.isfinite(plane).any() else None


# -- the whole ---------------------------------------------------------------------------------------------
def summary_of(inspection: Inspection, source: str) -> str:
    """Return how much was compared, with which camera, or why nothing was."""
    from lfcal.judge import compared_words

    words = capital(compared_words(inspection))
    return f"{words}. {source}." if inspection.compared and source else f"{words}."


def worst_positions(inspection: Inspection) -> tuple[tuple[int, int, int], ...]:
    """Return the positions that should be recorded again, each once, in the order of the scan."""
    return tuple(place for place, _ in inspection.redo())


def kept_of(inspection: Inspection) -> Verdict:
    """Return the verdict that the project keeps."""
    from lfcal.judge import judgement_of

    _, ny, nx = inspection.shape[:3]
    checks = sum(metric.applies for metric in inspection.quality.metrics)
    return verdict_of(judgement_of(inspection), worst_positions(inspection), ny * nx, checks)


def camera_choices(settings: QualitySettings) -> tuple[tuple[str, str], ...]:
    """Return the cameras to compare with: also that of a fit whose folder was chosen."""
    return (*CAMERAS, ("saved", f"of the fit {Path(settings.fit).name}")) if settings.fit else CAMERAS
