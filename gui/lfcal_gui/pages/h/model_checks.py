"""Checks of H: settings, table rows, texts, images, and the work that makes them. No Qt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, any_of
from lfcal.records import rows
from lfcal.tasks import Inspect
from lfcal_gui.models import (
    Field,
    FittedCamera,
    PageSettings,
    ProjectState,
    Stamp,
    Verdict,
    capital,
    fields_of,
    stamp_of,
    stated_order,
    verdict_of,
)
from lfcal_gui.pages.h.model import PositionMap, places_in

if TYPE_CHECKING:
    from lfcal.fit import Setup
    from lfcal.judge import FoundFault, Inspection
    from lfcal.judge.quality import Metric, QualityReport

SECONDS_0_1 = 10.0
"""Default limit of version 0.1 (s)."""

CAMERAS = (("fitted", "fitted, else described"), ("own", "as H describes it"))
"""Cameras with which patterns are compared; the folder of a saved fit is a third choice."""

HELD = frozenset({"source", "mat_order", "report", "reference", "fit", "every", "strict"})
"""Fields of `lfcal.tasks.Inspect` that other widgets show, or that do not apply in the window."""

ROWS = {row.name: row for row in rows(Inspect) if row.name not in HELD}

FIELDS = (
    *fields_of(Inspect, without=HELD),
    Field(
        "camera",
        "Camera",
        kind="choice",
        choices=CAMERAS,
        default="fitted",
        tip="Camera that the patterns are compared with: as fitted to this H, or as described in H",
    ),
)

MARKED = 2000
"""Largest number of positions in a plane that are marked individually."""

RANK = {"bad": 0, "fair": 1, "unknown": 2, "good": 3}
"""Order of the checks: failed ones first."""

REPEAT = "repeat"
"""Rating of a check that is good except for positions to record again."""

YES_NO = "yes / no"
"""Unit of maps whose values are 0 or 1."""

ERRORS = ("position", "step")
"""Metrics that give the error of a position, in order of preference: from the lenslet lattice, from its neighbours."""

NO_CURVE = "This check has one value for all of H, so there is no curve over depth."
NO_PICTURE = "There is no image for this fault."


@dataclass(frozen=True)
class QualitySettings(PageSettings):
    """Settings of the checks.

    Attributes
    ----------
    seconds, patterns, session
        As in `lfcal.tasks.Inspect`; an empty session: none.
    camera
        One of `CAMERAS`, or ``"saved"``: the camera of ``fit``.
    fit
        Folder of a saved fit.
    by_number
        Whether planes of two H are paired by number instead of depth.
    """

    page: ClassVar[str] = "quality"

    seconds: float = ROWS["seconds"].default
    patterns: int = ROWS["patterns"].default
    session: str = ""
    camera: str = "fitted"
    fit: str = ""
    by_number: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain JSON types; the time limit has another name than in version 0.1."""
        stored = super().to_dict()
        return {**stored, "most_s": stored.pop("seconds")}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the settings in ``data``, which may be of version 0.1."""
        if isinstance(data, Mapping):
            # 10 s was the default of 0.1, for a part of H; now it ends before H is fully judged
            old = {} if data.get("seconds") == SECONDS_0_1 else {key: data[key] for key in ("seconds",) if key in data}
            new = {"seconds": data["most_s"]} if "most_s" in data else old
            data = {**{key: value for key, value in data.items() if key != "seconds"}, **new}
        return super().from_dict(data)

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one field changed; None becomes an empty string."""
        return super().changed(key, "" if value is None else value)

    def __post_init__(self) -> None:
        """Check every value."""
        for name, row in ROWS.items():
            row.value(getattr(self, name), row.label)
        if self.camera not in (*dict(CAMERAS), "saved"):
            raise InputError.expected("camera", any_of(dict(CAMERAS)), self.camera, "choose one of these")


@dataclass(frozen=True, eq=False)
class CheckRow:
    """A fault found with the camera model, or a metric without a model, as a table row.

    Attributes
    ----------
    found
        Fault or metric.
    title, value
        Name and value; for a fault the value is its error of a reconstruction or its fraction of the light.
    good, bad
        Limits of the value; empty for a fault.
    merit
        Resulting merit of H.
    rating, cost
        Merit in a word, or confidence of a fault; and the error of a reconstruction caused by the fault
        or by the deviation of the metric.
    words
        Meaning and remedy, as rich text.
    """

    found: FoundFault | Metric
    title: str
    value: str
    good: str
    bad: str
    merit: str
    rating: str
    cost: str
    words: str

    @property
    def positions(self) -> NDArray[np.intp]:
        """Affected positions (z, y, x) ``(n, 3)``."""
        found: NDArray[np.intp] = np.asarray(self.found.positions, np.intp).reshape(-1, 3)
        return found

    @property
    def plane(self) -> int | None:
        """Plane with most of the affected positions; None if there are none."""
        return int(np.bincount(self.positions[:, 0]).argmax()) if len(self.positions) else None


def checks_of(inspection: Inspection, *, every: bool = False) -> tuple[CheckRow, ...]:
    """Return faults and metrics, failed ones first; ``every`` includes metrics that do not apply."""
    metrics = (m for m in inspection.quality.metrics if every or m.applies)
    found = [
        *(_of_fault(inspection, one) for one in inspection.faults),
        *(_of_metric(inspection, one) for one in metrics),
    ]
    return tuple(sorted(found, key=lambda check: RANK[check.merit]))


# -- faults ------------------------------------------------------------------------------------------------
def _of_fault(inspection: Inspection, one: FoundFault) -> CheckRow:
    from lfcal.base import format_share
    from lfcal.judge import cost_words, is_bad, is_fair

    share = format_share(min(one.share, 1.0))
    cost = "–" if one.cost is None else cost_words(inspection, one)
    sure = f"{100 * one.confidence:.1f} %" if 100 * one.confidence <= 99.9 else "> 99.9 %"  # never 100 %
    parts = [f"<b>{capital(one.title)}</b>: {one.detail}"]
    where = place_words(one)
    parts.append(f"It affects {share} of the light, {min(one.sigmas, 999):.0f} sigma above the noise. {where}")
    if one.cost is not None:
        parts.append(f"Error of a reconstruction (NRMSE), noise alone → with the fault: {cost}.")
    parts.append(f"<b>What to do:</b> {one.fault.advice} {_atlas_link(one.name)}")
    merit = "bad" if is_bad(one) else "fair" if is_fair(one) else "unknown"
    value = f"{share} of light" if one.cost is None else cost
    return CheckRow(one, capital(one.title), value, "", "", merit, sure, cost, "<br>".join(parts))


def _atlas_link(name: str) -> str:
    """Return a link to the fault's section of the fault atlas."""
    return f"<a href='fault:{name}'>See it in the fault atlas</a>"


def place_words(one: FoundFault) -> str:
    """Return the number of positions and pixels that a fault affects, as text."""
    many, pixels = len(one.positions), len(one.pixels)
    where = f"{many} position{'s' * (many != 1)} affected" if many else "All positions are affected"
    more = f", {pixels} pixel{'s' * (pixels != 1)} of the sensor" if pixels else ""
    again = "; record again" if one.redo and many else ""
    return f"{where}{more}{again}."


# -- metrics -----------------------------------------------------------------------------------------------
def count_words(inspection: Inspection) -> str:
    """Return the number of checks of each merit, and of metrics that do not apply, as text."""
    found = Counter(REPEAT if check.rating == REPEAT else check.merit for check in checks_of(inspection))
    found["not applicable"] = sum(not metric.applies for metric in inspection.quality.metrics)
    shown = {"bad": "", "fair": "", REPEAT: "to repeat", "unknown": "not rated", "good": "", "not applicable": ""}
    return ", ".join(f"{found[key]} {words or key}" for key, words in shown.items() if found[key])


def _of_metric(inspection: Inspection, m: Metric) -> CheckRow:
    from lfcal.judge.report import limits

    merit, reading = _reading_of(inspection, m)
    cost = m.cost_text if m.cost > 0 else "–"
    return CheckRow(m, m.spec.title, m.text, *limits(m), merit, reading, cost, _metric_words(inspection, m, reading))


def _reading_of(inspection: Inspection, metric: Metric) -> tuple[str, str]:
    """Return the merit of a metric and its word; a fault may explain it, or the camera may refute it."""
    from lfcal.judge.quality import merit_of, merit_word

    if metric.merit in ("bad", "fair"):
        if inspection.settled(metric) is not None:
            return "unknown", "see fault"
        if inspection.withdrawn(metric):
            return "unknown", "not confirmed"
    merit, word = merit_of(metric), merit_word(metric)
    return "fair" if word == REPEAT else merit, word  # positions to record again are not marked as good


def _metric_words(inspection: Inspection, metric: Metric, reading: str) -> str:
    parts = [f"<b>{metric.spec.title}: {metric.text}</b>, {reading} ({metric.limits})", metric.spec.meaning]
    if metric.detail:
        parts.append(metric.detail)
    if metric.merit in ("fair", "bad"):
        cause = inspection.settled(metric)
        if cause is not None:
            parts.append(f"<b>See the fault “{cause.title}”</b>, which causes it. {_atlas_link(cause.name)}")
        elif inspection.withdrawn(metric):
            parts.append("<b>Not confirmed</b>: the comparison with the camera found no such fault.")
        else:
            parts.append(f"<b>What to do:</b> {metric.spec.advice}")
    return "<br>".join(parts)


# -- what shows a check ------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class CheckPicture:
    """Image or curve of a check.

    Attributes
    ----------
    title
        Title; without ``values``, why there are none.
    axes, unit
        Names of the axes (vertical, horizontal for a map), and quantity of the values.
    values
        Curve ``(n,)`` at ``across``, or map ``(rows, columns)`` with first index ``origin``. None: neither.
    """

    title: str
    axes: tuple[str, ...] = ()
    unit: str = ""
    values: NDArray[np.float64] | None = None
    across: NDArray[np.float64] | None = None
    origin: tuple[float, float] = (0.0, 0.0)


def picture_of(inspection: Inspection, check: CheckRow) -> CheckPicture:
    """Return the image of a fault, or the curve of a metric over depth."""
    from lfcal.judge.quality import Metric

    one = check.found
    if isinstance(one, Metric):
        depths, values = inspection.quality.depths, np.asarray(one.per_plane, float)
        if values.size < 2 or values.size != len(depths):
            return CheckPicture(NO_CURVE)
        axis, places = "plane", np.arange(values.size, dtype=float)
        if inspection.quality.extent:
            axis, places = "depth z (mm)", depths / 1e3
        return CheckPicture("Over depth", (axis,), one.spec.unit or "value", values, places)
    if one.picture is None:
        return CheckPicture(NO_PICTURE)
    values = np.asarray(one.picture.values, float)
    across = None
    if values.ndim == 1:
        across = np.asarray(np.arange(len(values)) if one.picture.across is None else one.picture.across, float)
    named = capital(one.picture.title), one.picture.axes, one.picture.unit or "value"
    return CheckPicture(*named, values, across, one.picture.origin)


def map_of(inspection: Inspection, check: CheckRow, z: int) -> PositionMap | None:
    """Return the map of a check over the positions of plane ``z``; None if it has no values per position."""
    from lfcal.judge.quality import Metric

    one, positions = check.found, check.positions
    here = positions[positions[:, 0] == z, 1:]
    marked = here if len(here) <= MARKED else here[:0]  # more would hide the map
    if isinstance(one, Metric):
        return _metric_map(one, z, marked)
    if not len(positions):
        return None
    values = np.zeros(inspection.quality.shape[1:3])
    values[here[:, 0], here[:, 1]] = 1.0
    note = f"{len(here)} in this plane"
    return PositionMap(capital(one.title), values, ringed=marked, name=one.name, levels=(0.0, 1.0), note=note)


def error_map(
    inspection: Inspection, z: int, worst: Iterable[tuple[int, ...]], missing: NDArray[Any]
) -> PositionMap | None:
    """Return the map of the error of each position of a plane; None if it was not measured.

    Positions ``missing`` ``(ny, nx)`` are crossed out, the ``worst`` (z, y, x) are ringed.
    """
    metrics = {one.key: one for one in inspection.quality.metrics}
    found = (_metric_map(metrics[key], z, places_in(z, worst)) for key in ERRORS if key in metrics)
    shown = next(filter(None, found), None)
    return None if shown is None else replace(shown, missing=np.argwhere(missing))


def _metric_map(metric: Metric, z: int, ringed: NDArray[Any]) -> PositionMap | None:
    values = None if metric.map is None or not 0 <= z < len(metric.map) else metric.map[z]
    if values is None or not np.isfinite(values).any():
        return None
    unit = metric.spec.map_unit or metric.spec.unit
    found = PositionMap(metric.spec.title, values, unit, ringed=ringed, name=metric.key)
    if unit != YES_NO:
        return found
    return replace(found, levels=(0.0, 1.0), note=f"{np.count_nonzero(values > 0)} in this plane")


# -- the whole ---------------------------------------------------------------------------------------------
def summary_of(inspection: Inspection, source: str) -> str:
    """Return how many patterns were compared with which camera, or why none were, as text."""
    from lfcal.judge import compared_words

    words = capital(compared_words(inspection))
    return f"{words}. {source}." if inspection.compared and source else f"{words}."


def worst_positions(inspection: Inspection) -> tuple[tuple[int, int, int], ...]:
    """Return the positions to record again, without duplicates, in scan order."""
    return tuple(place for place, _ in inspection.redo())


def kept_of(inspection: Inspection) -> Verdict:
    """Return the verdict to store in the project."""
    from lfcal.judge import judgement_of

    _, ny, nx = inspection.shape[:3]
    checks = sum(metric.applies for metric in inspection.quality.metrics)
    return verdict_of(judgement_of(inspection), worst_positions(inspection), ny * nx, checks)


def camera_choices(settings: QualitySettings) -> tuple[tuple[str, str], ...]:
    """Return the cameras to choose from, including that of a chosen fit folder."""
    return (*CAMERAS, ("saved", f"of the fit {Path(settings.fit).name}")) if settings.fit else CAMERAS


@dataclass(frozen=True, eq=False)
class InspectionRequest:
    """Request for an inspection of H.

    Attributes
    ----------
    stamp
        Stamp of the file of H at the time of the request.
    seconds, patterns
        Time limit (s) of the comparison with the camera (0: no comparison), and number of patterns compared.
    session
        Session whose control frames are checked; empty: none.
    setup
        Camera found by the fit. None: another camera is used.
    folder
        Folder of the fit whose camera is used; empty: none.
    mat_order
        As in `lfcal.psf.open_psf`.
    """

    stamp: Stamp
    seconds: float
    patterns: int
    session: str
    setup: Setup | None
    folder: str
    mat_order: str = ""

    @property
    def choices(self) -> tuple[object, ...]:
        """All fields except the file."""
        return self.seconds, self.patterns, self.session, self.setup, self.folder, self.mat_order

    @property
    def name(self) -> str:
        """Name of the file."""
        return Path(self.stamp[0]).name

    @property
    def source(self) -> str:
        """Camera with which H is compared, in words."""
        if self.setup is not None:
            return "The camera is as the fit found it"
        if self.folder:
            return f"The camera is as in the fit {Path(self.folder).name}"
        return "The camera is as H describes it"


@dataclass(eq=False)
class InspectionRun:
    """Results so far of an inspection that runs in a thread.

    Attributes
    ----------
    report, depths
        Metrics that need no camera, and depths of the planes (µm).
    camera
        Whether H states a camera.
    inspection
        Result of the comparison with the camera.
    """

    report: QualityReport | None = None
    depths: NDArray[np.float64] | None = None
    camera: bool = False
    inspection: Inspection | None = None


def asked_of(
    stamp: Stamp, settings: QualitySettings, fitted: FittedCamera | None, mat_order: str = ""
) -> InspectionRequest:
    """Return the request for the checks of a file. A camera fitted to another file is not used."""
    setup = None
    if settings.camera == "fitted" and fitted is not None and fitted.stamp == stamp:
        setup = fitted.setup
    folder = settings.fit if settings.camera == "saved" else ""
    return InspectionRequest(stamp, settings.seconds, settings.patterns, settings.session, setup, folder, mat_order)


def iter_judge(asked: InspectionRequest, kept: InspectionRun) -> Work[None]:
    """Measure H and compare it with its camera; store the results in ``kept``, because ended jobs stay in the list."""
    from lfcal.judge import fitted_setup, iter_inspection
    from lfcal.judge.quality import control_frames, iter_inspect
    from lfcal.psf import open_psf

    with open_psf(asked.stamp[0], mat_order=asked.mat_order) as opened:
        matrix = opened.T if opened.is_transposed else opened
        setup = fitted_setup(Path(asked.folder), matrix) if asked.folder and asked.seconds else asked.setup
        controls = control_frames(Path(asked.session), matrix) if asked.session else None
        report = yield from iter_inspect(matrix, controls=controls)
        kept.depths, kept.report, kept.camera = np.array(matrix.known_depths), report, matrix.camera is not None
        work = iter_inspection(matrix, report, setup=setup, seconds=asked.seconds, patterns=asked.patterns)
        found = yield from work
        # repair functions keep references to the patterns
        kept.inspection = replace(found, faults=tuple(replace(one, repair=None) for one in found.faults))


@dataclass(frozen=True, eq=False)
class JudgedH:
    """Result of judging an H, its request, and the verdict to store in the project."""

    asked: InspectionRequest
    inspection: Inspection
    verdict: Verdict


def iter_judged(project: ProjectState, fitted: FittedCamera | None) -> Work[JudgedH]:
    """Judge the H of a project with its settings."""
    stamp, kept = stamp_of(project.psf), InspectionRun()
    if stamp is None:
        raise InputError.expected("H", "a file", project.psf or "none", "open or assemble one")
    asked = asked_of(stamp, QualitySettings.of(project), fitted, stated_order(project, project.psf))
    yield from iter_judge(asked, kept)
    found = judged(kept, "it was omitted")
    assert found is not None  # it has ended
    return JudgedH(asked, found, kept_of(found))


def judged(kept: InspectionRun, why_not: str) -> Inspection | None:
    """Return the inspection so far: with the comparison, or with metrics only and the reason; None if neither."""
    from lfcal.judge import Inspection

    if kept.inspection is not None or kept.report is None:
        return kept.inspection
    unfinished = f"the comparison with the camera is missing ({why_not})" if kept.camera else ""
    return Inspection(kept.report, (), 0, 0.0, why_not, 0.0, unfinished=unfinished)


def iter_write_report(psf: str, folder: str, inspection: Inspection | None, mat_order: str = "") -> Work[Path]:
    """Write the report on the H file ``psf`` into ``folder``, and reuse the results of ``inspection``."""
    from lfcal.judge.report import iter_report
    from lfcal.psf import open_psf

    with open_psf(psf, mat_order=mat_order) as matrix:
        page = yield from iter_report(matrix, Path(folder), inspection=inspection)
        return page


def report_files(folder: str) -> list[Path]:
    """Return the paths of the report files in ``folder``, some of which may already exist."""
    return [Path(folder) / name for name in ("index.html", "report.pdf", "quality.json", "redo.json")]
