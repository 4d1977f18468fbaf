"""Differences between a camera's description and a white image."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfcal.base import Finding
from lfcal.judge.source import FindingSource

if TYPE_CHECKING:
    from lfcal.lattice import CameraCheck

__all__ = ["FINDING_SOURCES"]


def _differences(check: CameraCheck) -> Iterator[Finding]:
    from lfcal.lattice import DIFFERS, FIT_PX, WRONG

    for line in check.lines:
        if line.verdict in (WRONG, DIFFERS):
            yield Finding(
                kind=line.label.replace(" ", "_"),
                what=line.label,
                subject="optics",
                detail=f"{line.measured} in the white image, {line.expected} in the camera",
                size=math.nan if line.edge_px is None else line.edge_px,
                limit=FIT_PX,
                remedy="Correct the camera, or use the measured values."
                if check.camera is not None
                else "Correct the camera, or choose the white image of this camera.",
                merit="bad" if line.verdict == WRONG else "fair",
            )


FINDING_SOURCES = (FindingSource("camera and white image", ("CameraCheck",), _differences),)
