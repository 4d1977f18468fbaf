"""Problems of the frames that an H was assembled from, and of the target in them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from lfcal.base import Finding, format_count, listed
from lfcal.judge.source import FindingSource
from lfcal.judge.sources.files import NAMED, places

if TYPE_CHECKING:
    from lfcal.campaign import Points
    from lfcal.psf import AssemblyReport

__all__ = ["FINDING_SOURCES"]


def _left_out(report: AssemblyReport) -> Iterator[Finding]:
    if report.left_out:
        positions = tuple(one.position for one in report.left_out if one.position is not None)
        names = listed([one.label for one in report.left_out], NAMED)
        yield Finding(
            kind="left_out",
            what="damaged frames left out",
            subject="frames",
            detail=f"{format_count(len(report.left_out), 'frame', 'frames')}: {names}",
            where=places(positions),
            positions=tuple(map(tuple, positions)),
            remedy="Record these frames again.",
            merit="fair",
            repeat=len(positions),
        )


def _missing(report: AssemblyReport) -> Iterator[Finding]:
    many = len(report.missing) - report.filled
    if many > 0:
        yield Finding(
            kind="missing",
            what="positions without a frame",
            subject="frames",
            detail=format_count(many, "position", "positions"),
            where=places(report.missing),
            positions=tuple(map(tuple, report.missing)),
            remedy="Record these positions; or fit the optics (lfcal fit) and fill them (lfcal assemble --fill FIT).",
            merit="fair",
            repeat=many,
        )


def _padded(report: AssemblyReport) -> Iterator[Finding]:
    if report.padded:
        yield Finding(
            kind="padded",
            what="cutouts beyond the edge of the sensor",
            subject="cutout",
            detail=f"{format_count(len(report.padded), 'cutout', 'cutouts')}, padded with zeros",
            where=places(report.padded),
            positions=tuple(map(tuple, report.padded)),
            remedy="Move the anchor, or choose a smaller cutout.",
            merit="fair",
        )


def _saturation(report: AssemblyReport) -> Iterator[Finding]:
    if report.saturated:
        yield Finding(
            kind="saturated",
            what="saturated pixels",
            subject="light",
            detail=format_count(report.saturated, "position has some", "positions have some"),
            remedy="Record with less light, or with several exposures.",
            merit="fair",
        )
    if report.unknown_saturation:
        yield Finding(
            kind="unknown_saturation",
            what="unknown saturation",
            subject="light",
            detail=format_count(report.unknown_saturation, "position", "positions"),
            remedy="State the bit depth in the plan or manifest, or the saturation level.",
            merit="fair",
        )


def _mistakes(points: Points) -> Iterator[Finding]:
    frames = len(points.found)
    for one, count in points.mistakes:
        yield replace(one, detail=f"{one.detail} ({count} of {frames} frames)")


FINDING_SOURCES = (
    FindingSource("damaged frames left out", ("AssemblyReport",), _left_out),
    FindingSource("positions without a frame", ("AssemblyReport",), _missing),
    FindingSource("cutouts beyond the edge of the sensor", ("AssemblyReport",), _padded),
    FindingSource("saturation", ("AssemblyReport",), _saturation),
    FindingSource("target in frames", ("Points",), _mistakes),
)
