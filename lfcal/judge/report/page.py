"""The report as a self-contained HTML page."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import (
    format_bytes,
    format_length,
    format_plane,
    format_seconds,
    format_share,
    html_page,
    html_section,
    html_table,
    html_text,
    one_line,
)
from lfcal.judge.comparison import Comparison
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import Metric, QualityReport, counted_words, merit_of, merit_word
from lfcal.judge.report._pictures import ReportPicture, fault_pictures, figures
from lfcal.judge.telling import compared_words, cost_words
from lfcal.psf import PSFMatrix
from lfcal.psf.aperture import KINDS, Aperture, with_error

__all__ = ["limits", "page"]

FULL = 1190
"""Width of a picture of three panels, which fills the page (pixels)."""

LISTED = 24
"""Number of positions that are listed; the file redo.json has all."""


def page(
    H: PSFMatrix,
    inspection: Inspection,
    pictures: Sequence[ReportPicture],
    comparison: Comparison | None = None,
    reference: str = "",
    *,
    every: bool = False,
) -> str:
    """Return the report on ``H`` as one HTML document without scripts or external links.

    ``pictures`` are embedded in the sections that they name. ``comparison`` is the comparison with another H, whose
    path is ``reference``; None: there is none. With ``every``, metrics that do not apply are listed as well.
    """
    quality = inspection.quality
    name = one_line(Path(H.path).name) or "PSF matrix"
    sections = [
        _verdict(inspection),
        _facts(H, quality, inspection.redo()),
        html_section("Compared with the camera's model", _faults(inspection)) if inspection.asked else "",
        _actions(inspection),
        html_section("Checks", _metrics(quality, every)),
        html_section("Aperture", _apertures(H, quality) + figures(pictures, "aperture")),
        html_section("H and its transpose", figures(pictures, "slices")),
        html_section("Maps over source positions", figures(pictures, "maps")),
        html_section("Tiling over the field", _tilings(quality) + figures(pictures, "tiling")),
    ]
    if comparison is not None:
        sections.append(html_section("Comparison with the reference", _compared(H, comparison, reference, pictures)))
    sections.append(html_section("Provenance", _provenance(H)))
    return html_page(
        name,
        f"{name}: PSF quality",
        "PSF quality report",
        sections,
        f"inspected in {format_seconds(quality.seconds)}",
    )


def _merit(metric: Metric) -> str:
    return f'<span class="merit {merit_of(metric)}">{merit_word(metric)}</span>'


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "—"


def _verdict(inspection: Inspection) -> str:
    quality = inspection.quality
    cost = f"Estimated error of a reconstruction from these faults: {quality.cost:.2f} NRMSE." if quality.cost else ""
    none = "" if inspection.merit == "unknown" else "No fault was found that affects a reconstruction."
    more = f"{_compared_sentence(inspection)}." if inspection.asked else cost or none
    verdict = html_text(inspection.verdict)
    return f'<section class="verdict {inspection.merit}">{verdict}<p>{html_text(more)}</p></section>'


ERROR = "error of a reconstruction (NRMSE), from noise alone → with the fault"
"""Heading of the column of costs."""


def _compared_sentence(inspection: Inspection) -> str:
    words = compared_words(inspection)
    return words[0].upper() + words[1:]


def _faults(inspection: Inspection) -> str:
    """Return the faults that a comparison with the camera found, each with its picture."""
    rows = []
    for one in inspection.faults:
        share, cost = format_share(min(one.share, 1.0)), cost_words(inspection, one)
        rows.append(
            [f'<b class="nb">{html_text(one.title)}</b>', *map(html_text, (one.detail, share, cost, one.fault.advice))]
        )
    if not rows:
        return f"<p>{html_text(_compared_sentence(inspection))}.</p>"
    shown = fault_pictures(inspection)
    head = ["fault", "what", "of the light", ERROR, "what to do"]
    return html_table(head, rows, numeric=[2, 3]) + figures(shown, "faults")


def _facts(H: PSFMatrix, quality: QualityReport, redo: Sequence[object]) -> str:
    nz, ny, nx, nt, ns = quality.shape
    facts = [
        ("source positions y × x", f"{ny} × {nx}"),
        (f"depth planes, {quality.extent or 'depths not stated'}", str(nz)),
        ("cutout t × s", f"{nt} × {ns} px"),
        (f"of values, {H.dtype}", format_bytes(H.nbytes)),
        ("checks", counted_words(quality.metrics)),
        ("positions to record again", str(len(redo))),
    ]
    return (
        '<div class="facts">'
        + "".join(f"<div><b>{html_text(v)}</b><span>{html_text(k)}</span></div>" for k, v in facts)
        + ("</div>")
    )


def _actions(inspection: Inspection) -> str:
    """Return findings by subject with what to do about each, and the positions to record again."""
    redo = inspection.redo()
    if not inspection.judgement.findings and not redo:
        return ""
    rows = [
        [
            html_text(subject),
            f'<span class="merit {one.merit}">{one.merit}</span>',
            f"<b>{html_text(one.what)}</b>",
            html_text("; ".join(filter(None, (one.detail, one.where)))),
            html_text(one.cost_words),
            html_text(one.remedy),
        ]
        for subject, found in inspection.judgement.by_subject().items()
        for one in found
    ]
    body = html_table(["subject", "merit", "finding", "what was found", "cost", "what to do"], rows) if rows else ""
    if redo:
        places = ", ".join(f"({z}, {y}, {x})" for (z, y, x), _ in redo[:LISTED])
        more = f" and {len(redo) - LISTED} more" if len(redo) > LISTED else ""
        body += f"<p>Record again (z, y, x): {places}{more}. <code>redo.json</code> holds the list for "
        body += "<code>lfcal acquire --redo redo.json</code>.</p>"
    return html_section("What to do", body)


def _metrics(quality: QualityReport, every: bool) -> str:
    def row(m: Metric) -> list[str]:
        words = html_text(m.spec.meaning) + (f" <b>{html_text(m.detail)}.</b>" if m.detail else "")
        if m.merit in ("bad", "fair"):
            words += f' <span class="advice {m.merit}">{html_text(m.spec.advice)}</span>'
        best, worst = limits(m)
        name = f'<b class="nb">{html_text(m.spec.title)}</b>'
        return [_merit(m), name, html_text(m.text), html_text(best), html_text(worst), m.cost_text, words]

    note = (
        '<p class="note">Cost: the error of a reconstruction (NRMSE) caused by a fault of this size, '
        "measured with this H or typical.</p>"
    )
    count = f"<p>{html_text(counted_words(quality.metrics))}.</p>"
    headers = ("merit", "check", "value", "good", "bad", "cost", "meaning and advice")
    shown = [m for m in quality.metrics if every or m.applies]
    return count + html_table(headers, map(row, shown), (2, 3, 4, 5)) + note


def limits(metric: Metric) -> tuple[str, str]:
    """Return texts with the limits of good and of bad values in the unit of the metric.

    The second is "by cost" if values that are not good are rated by their cost.
    """
    limits = metric.spec.limits
    better, worse = ("≥", "<") if limits.higher_is_better else ("≤", ">")
    return f"{better} {limits.good:g}", "by cost" if metric.spec.by_cost else f"{worse} {limits.bad:g}"


def _apertures(H: PSFMatrix, quality: QualityReport) -> str:
    rows = []
    for z, a in enumerate(quality.apertures):
        rows.append(
            [
                html_text(quality.plane_words(z)),
                _number(float(quality.virtual_depths[z])),
                html_text(KINDS[a.kind]),
                str(a.blades) if a.blades and a.confident else "—",
                with_error(a.diameter_px, a.diameter_sigma_px, 2) if a.seen else "—",
                f"{a.centre[0]:.2f}, {a.centre[1]:.2f}" if a.seen else "—",
                f"{math.degrees(a.rotation_rad):.1f}" if a.blades and a.confident else "—",
                _curvature(a),
                f"{100 * a.ellipticity:.1f}" if a.seen else "—",
                f"{a.confidence:.2f}" if a.confident else "—",
                _answer(a),
            ]
        )
    headers = (
        "depth z",
        "virtual depth",
        "shape",
        "blades",
        "diameter (px)",
        "centre row, column (px)",
        "rotation (°)",
        "curvature",
        "ellipticity (%)",
        "confidence",
        "answer",
    )
    together = (
        "" if quality.iris is None else f"<p>All planes together: <b>{html_text(quality.iris.describe())}</b>.</p>"
    )
    return html_table(headers, rows, (0, 1, *range(3, 10))) + together + _f_number(H, quality)


def _curvature(a: Aperture) -> str:
    if not (a.blades and a.confident):
        return "—"
    return f"{a.curvature:.2f}" + (f" ± {a.curvature_sigma:.2f}" if math.isfinite(a.curvature_sigma) else "")


def _answer(a: Aperture) -> str:
    """Return whether the shape is certain, and the fault of the aperture, or why the shape is unknown."""
    if not a.confident:
        return html_text(a.reason or "not certain")
    return '<b class="advice good">certain</b>' + (f": {html_text(a.fault)}" if a.fault else "")


def _f_number(H: PSFMatrix, quality: QualityReport) -> str:
    f = quality.f_number
    stated = f" The camera's description states {H.camera.optics.working_f_number:.2f}." if H.camera else ""
    if f is None:
        return f"<p>The working f-number cannot be measured from these planes.{stated}</p>"
    error = f" ± {f.standard_error:.2f}" if math.isfinite(f.standard_error) else ""
    value = f"<b>{f.value:.2f}{error}</b>"
    return f"<p>Working f-number from the size of the illuminated disc over depth: {value}.{stated}</p>"


def _tilings(quality: QualityReport) -> str:
    rows = []
    for z, tiling in enumerate(quality.tilings):
        if tiling is not None:
            y, x = tiling.fitting_period
            rows.append(
                [
                    html_text(quality.plane_words(z)),
                    str(len(tiling.difference)),
                    f"{100 * float(np.median(tiling.difference)):.1f}",
                    f"{100 * float(tiling.difference.max()):.1f}",
                    f"{100 * float(np.median(tiling.best)):.1f}",
                    f"{_number(y, 5)} × {_number(x, 5)}",
                ]
            )
    if not rows:
        return ""
    headers = (
        "depth z",
        "control frames",
        "difference, median (%)",
        "largest (%)",
        "difference at the best fit (%)",
        "best-fitting period, y × x (px)",
    )
    return html_table(headers, rows, range(6))


def _compared(H: PSFMatrix, c: Comparison, reference: str, pictures: Sequence[ReportPicture]) -> str:
    name = f" with {html_text(Path(reference).name)}" if reference else ""
    left = int(np.prod(H.shape[:3])) - c.compared
    words = (
        f"<p>Correlation{name}: <b>{c.correlation:.5f}</b>; error at equal energy {100 * c.rms_error:.2f} % (rms of "
        f"positions); centroid shift {_number(c.rms_shift_px)} px rms, {_number(c.max_shift_px)} px at most; "
        f"{c.compared} positions compared, {left} left out.</p>"
    )
    rows = [
        [html_text(format_plane(float(H.known_depths[z]), z)), f"{one.correlation:.5f}", _number(one.scale, 4)]
        for z, one in enumerate(plane.all for plane in c.planes)
    ]
    return (
        words
        + html_table(("depth z", "correlation", "best-fitting scale of the reference"), rows, (0, 1, 2))
        + figures(pictures, "comparison")
    )


def _provenance(H: PSFMatrix) -> str:
    history: dict[str, Any] = H.provenance
    missing = H.missing
    places = ", ".join(f"({z}, {y}, {x})" for z, y, x in missing[:LISTED].tolist())
    more = " …" if len(missing) > LISTED else ""
    corrections = history.get("corrections")
    steps = corrections.get("steps", []) if isinstance(corrections, dict) else []
    kinds = ", ".join(str(s.get("kind", "?")) for s in steps if isinstance(s, dict))
    rows = [
        ("file", one_line(H.path) or "in memory"),
        ("camera", _camera(H)),
        ("cutout", f"{H.cutout[0]} × {H.cutout[1]} px, anchor row {H.anchor[0]:g}, column {H.anchor[1]:g} px"),
        ("corrections", kinds or "none recorded"),
        ("missing", f"{len(missing)}: {places}{more}" if len(missing) else "none"),
    ]
    facts = html_table((), [[f'<span class="nb">{k}</span>', html_text(v)] for k, v in rows])
    if not history:
        return facts
    return f"{facts}<pre>{html_text(json.dumps(history, ensure_ascii=False, default=str))}</pre>"


def _camera(H: PSFMatrix) -> str:
    if H.camera is None:
        return "not stated"
    c = H.camera
    if not c.has_lattice:
        lenslets = len(c.lattice.lenslets_within(math.inf, math.inf)[0])
        return f"{c.name}: {lenslets} lenslets in a pupil plane, pixel {format_length(c.sensor.pixel_um)}"
    kinds = len(c.lattice.types)
    return (
        f"{c.name}: {c.lattice.kind} lattice, pitch {format_length(c.lattice.pitch_um)}, {kinds} lenslet "
        f"type{'s' if kinds > 1 else ''}, pixel {format_length(c.sensor.pixel_um)}, working f-number "
        f"{c.optics.working_f_number:.2f}"
    )
