"""A clean recording of the bench camera by lfcal's own simulator, and what is found in it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_costs import TrueCost
from benchmarks._fault_recordings import CAMERAS, PEAK, Recording
from benchmarks._fault_sensor import compressed
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.judge import Evidence, FoundFault, iter_evidence, iter_search
from lfcal.psf import PSFMatrix

__all__ = [
    "ALL",
    "FEWEST",
    "PATTERNS",
    "PEAK",
    "SOME",
    "Values",
    "added",
    "clean",
    "compared",
    "compressed",
    "evidence_of",
    "faults_of",
    "light",
    "matrix",
    "noisy",
    "plan",
    "recording",
    "scaled",
    "sensor",
    "truth",
]

ALL, SOME = 60, 36
"""Patterns that are compared, and without --long: few faults take more to be told."""

PATTERNS = ALL

FEWEST = 24
"""Patterns that do where each takes long: those of a camera or of values that no model was computed for before."""

Values = NDArray[np.float32]


@cache
def recording() -> Recording:
    """Return a recording of two planes."""
    return Recording(CAMERAS["bench"]())


def plan() -> ScanPlan:
    """Return its scan."""
    return recording().plan


def noisy(values: Values, seed: int = 0) -> Values:
    """Return light as a camera counts it."""
    return recording().noisy(values, seed)


def clean() -> Values:
    """Return the recording without a fault, to be changed at will."""
    return recording().clean()


def light() -> Values:
    """Return the light before any noise, to be changed at will."""
    return recording().light()


def matrix(values: Values) -> PSFMatrix:
    """Return H of the values."""
    return recording().matrix(values)


@cache
def truth() -> TrueCost:
    """Return what values cost, beside the recording without a fault."""
    return TrueCost(light(), clean())


def scaled(values: Values, image: Values) -> Values:
    """Return values times an image of the sensor under each cutout."""
    return recording().scaled(values, image)


def added(values: Values, image: Values) -> Values:
    """Return values with an image of the sensor added under each cutout."""
    return recording().added(values, image)


def sensor(value: float) -> Values:
    """Return an image of the scanned part of the sensor."""
    return recording().sensor(value)


def evidence_of(values: Values, patterns: int | None = None) -> Evidence:
    """Return what patterns show beside their camera; as many as `PATTERNS` says unless their number is given."""
    found = drain(iter_evidence(matrix(values), patterns=patterns or PATTERNS))
    assert isinstance(found, Evidence), found
    return found


def compared() -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` that `evidence_of` compares, whatever is in the others."""
    return _compared(PATTERNS)


@cache
def _compared(patterns: int) -> NDArray[np.intp]:
    return evidence_of(clean(), patterns).index


def faults_of(values: Values, patterns: int | None = None) -> dict[str, FoundFault]:
    """Return the faults that are found, by name; every picture says what it shows, in which unit."""
    found, _ = drain(iter_search(evidence_of(values, patterns)))
    for one in found:
        assert one.picture is None or (one.picture.unit and all(one.picture.axes)), f"units of {one.name}"
    return {one.name: one for one in found}
