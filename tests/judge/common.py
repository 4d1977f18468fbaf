"""A clean recording of the bench camera by lfcal's own simulator, and what is found in it."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_costs import TrueCost
from benchmarks._fault_list import FAULTS
from benchmarks._fault_recordings import CAMERAS, PEAK, Recording
from benchmarks._fault_sensor import compressed
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.fit.model import Fineness, PlaneModel
from lfcal.fit.setup import Setup, described_effects
from lfcal.judge import Evidence, FoundFault, Inspection, iter_evidence, iter_inspection, iter_search
from lfcal.judge.quality import inspect
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
    "displaced",
    "evidence_of",
    "faults_of",
    "inspected",
    "light",
    "matrix",
    "mixed_focus",
    "noisy",
    "plan",
    "put_in",
    "recording",
    "scaled",
    "sensor",
    "truth",
]

ALL, SOME = 60, 36
"""Patterns that are compared, and without --long: few faults need more."""

PATTERNS = ALL

FEWEST = 24
"""Patterns that suffice where each takes long: those of a camera or of values without a model from an earlier test."""

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
    """Return what values cost, compared with the recording without a fault."""
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
    """Return patterns compared with their camera, `PATTERNS` of them by default."""
    found = drain(iter_evidence(matrix(values), patterns=patterns or PATTERNS))
    assert isinstance(found, Evidence), found
    return found


def compared() -> NDArray[np.intp]:
    """Return the positions ``(n, 3)`` that `evidence_of` compares."""
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


def put_in(name: str, strength: float, of: Recording | None = None) -> Values:
    """Return a recording with a fault of the list of benchmarks."""
    (fault,) = (one for one in FAULTS if one.name == name)
    return fault.put_in(of or recording(), strength)


def inspected(H: PSFMatrix, patterns: int | None = None) -> Inspection:
    return drain(iter_inspection(H, inspect(H, workers=1), patterns=patterns or PATTERNS))


# -- patterns of displaced sources and of other depths -----------------------------------------------------
def _patterns(places: NDArray[np.intp], moved: NDArray[np.float64], z: int = 0, depth_um: float = 0.0) -> Values:
    """Return the patterns of displaced sources, or of plane 0 farther away, as shares of the light."""
    setup = Setup(plan().camera, described_effects(plan().camera), (depth_um, 0.0))
    return PlaneModel(setup, plan(), z, Fineness.coarse).patterns(places, moved)


def _every() -> NDArray[np.intp]:
    return np.argwhere(np.ones(plan().period, np.bool_))


@cache
def _counts() -> np.float32:
    """Return the factor from shares of the light to counts."""
    return np.float32(PEAK / float(_patterns(_every(), np.zeros((len(_every()), 2))).max()))


def displaced(dy: NDArray[np.float64], dx: NDArray[np.float64], *, everywhere: bool = False) -> Values:
    """Return a noisy recording, sources of both planes' positions displaced by fields ``(ny, nx)``.

    Without ``everywhere`` only the patterns that are compared are, as no others are used.
    """
    values = light()
    for z in (0, 1):
        own = compared()[compared()[:, 0] == z, 1:]
        places = _every() if everywhere else own
        moved = np.stack([dy[tuple(places.T)], dx[tuple(places.T)]], 1)
        values[(z, *places.T)] = _patterns(places, moved, z) * _counts()
    return noisy(values)


def mixed_focus(share: float) -> Values:
    """Return a recording whose first plane's virtual depth changes by a share during its scan."""
    moved, ny = plan().camera.depth_of(3.0 * (1 + share)) - plan().depths_um[0], plan().period[0]
    come = (np.arange(ny)[:, None, None, None] + 0.5) / ny
    still, shape = np.zeros((len(_every()), 2)), (*plan().period, *plan().cutout)
    first, last = (_patterns(_every(), still, 0, depth).reshape(shape) for depth in (0.0, moved))
    values = clean()
    values[0] = noisy(((1 - come) * first + come * last)[None].astype(np.float32) * _counts())[0]
    return values
