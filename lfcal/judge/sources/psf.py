"""Problems of an H found by metrics, faults and its camera, and of an old H found by new frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfcal.base import Finding, format_share
from lfcal.judge.source import FindingSource

if TYPE_CHECKING:
    from lfcal.judge.checking import Check
    from lfcal.judge.fault import FoundFault
    from lfcal.judge.inspection import Inspection
    from lfcal.judge.quality import QualityReport

__all__ = ["FINDING_SOURCES"]


def _metrics(measured: QualityReport | Inspection) -> Iterator[Finding]:
    from lfcal.judge.quality import findings_of

    yield from findings_of(measured.standing, measured.shape)


def _faults(inspection: Inspection) -> Iterator[Finding]:
    from lfcal.judge.inspection import is_bad, is_fair, is_of_single_frames

    for one in inspection.faults:
        if is_bad(one) or is_fair(one) or is_of_single_frames(one):
            yield _fault(inspection, one)


def _fault(inspection: Inspection, fault: FoundFault) -> Finding:
    from lfcal.judge.inspection import FAIR, FAIR_SHARE, is_bad, is_fair
    from lfcal.judge.quality import where

    frames = math.prod(inspection.shape[:3])
    if fault.cost is None:
        cost = f"not measured; it changes {format_share(min(fault.share, 1.0))} of the light"
    else:
        noise = "" if inspection.clean is None else f", to {inspection.clean:.3f} by noise alone"
        cost = f"{fault.cost:.3f} (NRMSE{noise})"
    return Finding(
        kind=fault.name,
        what=fault.title,
        subject=fault.fault.subject,
        detail=fault.detail,
        where=where(fault.positions.tolist(), frames) or "all positions",
        positions=tuple(map(tuple, fault.positions.tolist())),
        size=fault.share if fault.cost is None else fault.cost,
        limit=FAIR_SHARE if fault.cost is None else FAIR,
        sigma=fault.sigmas,
        cost=fault.cost,
        cost_words=cost,
        remedy=fault.fault.advice,
        merit="bad" if is_bad(fault) else "fair" if is_fair(fault) else "good",
        repeat=len(fault.positions) if fault.redo and fault.extent is not None else 0,
    )


def _camera(inspection: Inspection) -> Iterator[Finding]:
    found = inspection.disagreement
    if found is not None:
        yield Finding(
            kind="camera",
            what="disagreement with its camera",
            subject="optics",
            detail=found.sentence.removesuffix("."),
            size=math.nan if found.misfit is None else found.misfit,
            remedy=found.advice,
            # another camera or orientation is certain; otherwise the description may be wrong
            merit="bad" if found.certain else "unknown",
        )


def _unfinished(inspection: Inspection) -> Iterator[Finding]:
    if inspection.unfinished:
        yield Finding(
            kind="unfinished",
            what="comparison with the camera",
            subject="optics",
            detail=inspection.unfinished,
            remedy="Allow more time for the comparison (--seconds).",
            merit="unknown",
        )


def _strange(check: Check) -> Iterator[Finding]:
    for one in check.frames:
        if one.strange:
            yield Finding(
                kind="strange",
                what="frame without similarity to H",
                subject="frames",
                detail=f"correlation {one.found.correlation:.2f}",
                where=one.label,
                size=one.found.correlation,
                remedy="Check that it is a frame of this camera and this scan.",
            )


def _error(check: Check) -> Iterator[Finding]:
    if check.holds or any(one.strange for one in check.frames):
        return
    yield Finding(
        kind="error",
        what="error of H" if check.holds is None else "error of H beyond its limit",
        subject="optics",
        detail=check.figures,
        size=check.error.value,
        limit=check.limit,
        sigma=math.nan,
        remedy=check.remedy,
        merit="unknown" if check.holds is None else "bad",
    )


def _changes(check: Check) -> Iterator[Finding]:
    for one in check.explanations:
        changed = ", ".join(f"{name} {by:+.3g} ± {sigma:.2g} {unit}".rstrip() for name, by, sigma, unit in one.values)
        explains = f"explains {format_share(one.error)} of the light, leaves {format_share(one.left)}"
        yield Finding(
            kind="changed",
            what=one.name,
            subject="optics",
            detail=f"{explains}; {changed}",
            size=one.error,
            limit=check.limit,
            sigma=one.error / one.sigma if one.sigma else math.nan,
            remedy="Fit the camera again, or record H again.",
            merit="bad" if check.holds is False else "fair",
        )


FINDING_SOURCES = (
    FindingSource("camera", ("Inspection",), _camera),
    FindingSource("faults", ("Inspection",), _faults),
    FindingSource("metrics", ("QualityReport", "Inspection"), _metrics),
    FindingSource("comparison with the camera", ("Inspection",), _unfinished),
    FindingSource("frames unlike H", ("Check",), _strange),
    FindingSource("error of H", ("Check",), _error),
    FindingSource("changes since H was recorded", ("Check",), _changes),
)
