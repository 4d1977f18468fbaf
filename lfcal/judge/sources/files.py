"""Damaged or missing parts of H files and sessions, and deviations from their formats."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfcal.base import Finding, format_count, listed
from lfcal.judge.source import FindingSource

if TYPE_CHECKING:
    from lfcal.acquire import SessionReport
    from lfcal.frames import Position
    from lfcal.psf import MatrixCheck

__all__ = ["FINDING_SOURCES", "places"]

NAMED = 3
"""Number of positions, files or planes that a finding lists."""

PLANES = {
    "damaged": "damaged planes",
    "changed": "changed planes",
    "not finite": "planes with values that are not finite",
    "depth sum changed": "planes with a changed depth sum",
    "uncertainty damaged": "planes with damaged uncertainties",
}
"""Names of damaged planes, by the result of the file check."""

AGAIN = "Copy the file again from its source, or make it again."


def places(positions: tuple[Position, ...]) -> str:
    """Return the first `NAMED` of the ``positions`` (z, y, x) as text; empty if there are none."""
    return f"(z, y, x) = {listed([str(tuple(one)) for one in positions], NAMED)}" if positions else ""


def _planes(check: MatrixCheck) -> Iterator[Finding]:
    for what in dict.fromkeys(one.what for one in check.damaged):
        own = [one for one in check.damaged if one.what == what]
        names = [f"{one.region}, plane {one.z}" if one.region else f"plane {one.z}" for one in own]
        positions = tuple(place for one in own for place in one.positions)
        yield Finding(
            kind=what.replace(" ", "_"),
            what=PLANES[what],
            subject="file",
            detail=f"{format_count(len(own), 'plane', 'planes')}, {listed(names, NAMED)}",
            where=places(positions),
            positions=tuple(map(tuple, positions)),
            remedy=AGAIN,
        )


def _deviations(check: MatrixCheck) -> Iterator[Finding]:
    if check.deviations:
        detail = listed(check.deviations, NAMED)
        yield Finding(kind="deviation", what="deviations from the format", subject="file", detail=detail, remedy=AGAIN)


def _not_recorded(check: MatrixCheck) -> Iterator[Finding]:
    if check.missing:
        yield Finding(
            kind="missing",
            what="positions never recorded",
            subject="frames",
            detail=format_count(check.missing, "position", "positions"),
            remedy="Record these positions, or fill them from a fit (lfcal assemble --fill).",
            merit="fair",
        )


RESUME = "Record these frames again (lfcal acquire --resume)."


def _frames(report: SessionReport) -> Iterator[Finding]:
    for kind in dict.fromkeys(one.kind for one in report.damaged if not one.replaced):
        own = [one for one in report.damaged if one.kind == kind and not one.replaced]
        positions = report.to_redo if kind == "position" else ()
        files = tuple(dict.fromkeys(one.file for one in own))
        yield Finding(
            kind="damaged",
            what=f"damaged {kind} frames",
            subject="frames",
            detail=f"{format_count(len(own), 'frame', 'frames')} in {listed(files, NAMED)}",
            where=places(positions),
            positions=tuple(map(tuple, positions)),
            remedy=RESUME,
            repeat=len(positions),
        )


def _files(report: SessionReport) -> Iterator[Finding]:
    for file in report.files:
        if file.fault:
            yield Finding(
                kind="file",
                what="damaged file",
                subject="file",
                detail=file.fault,
                where=file.file,
                remedy="Copy the file again from its source, or record the lost frames again (lfcal acquire --resume).",
            )


def _records(report: SessionReport) -> Iterator[Finding]:
    if report.lacking:
        detail = format_count(report.lacking, "position was stored earlier", "positions were stored earlier")
        what = "positions without a record"
        yield Finding(kind="lacking", what=what, subject="frames", detail=detail, remedy=RESUME)


def _never_taken(report: SessionReport) -> Iterator[Finding]:
    if report.never_taken:
        yield Finding(
            kind="never_taken",
            what="positions not recorded yet",
            subject="frames",
            detail=format_count(len(report.never_taken), "position", "positions"),
            where=places(report.never_taken),
            positions=tuple(map(tuple, report.never_taken)),
            remedy="Continue the session (lfcal acquire --resume).",
            merit="good",
            repeat=len(report.never_taken),
        )


FINDING_SOURCES = (
    FindingSource("damaged planes", ("MatrixCheck",), _planes),
    FindingSource("deviations from the format", ("MatrixCheck",), _deviations),
    FindingSource("positions never recorded", ("MatrixCheck",), _not_recorded),
    FindingSource("damaged frames", ("SessionReport",), _frames),
    FindingSource("damaged files", ("SessionReport",), _files),
    FindingSource("positions without a record", ("SessionReport",), _records),
    FindingSource("positions not recorded yet", ("SessionReport",), _never_taken),
)
