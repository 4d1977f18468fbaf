"""Estimate how much results depend on the assumed values of a camera, by changing each within its uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, LfcalError, Work
from lfcal.camera import Camera, Forecast, ScanPlan, cutout_for, quantities_of, value_at
from lfcal.simulate.effects import IrisShape, LensTypeDefocus
from lfcal.simulate.response import PlaneResponse

__all__ = ["AssumedEffect", "iter_assumed_effects"]

SHARES = {
    "optics.focal_length_um": 0.02,
    "optics.f_number": 0.12,
    "optics.working_distance_um": 0.05,
    "optics.magnification": 0.03,
    "optics.numerical_aperture": 0.03,
    "optics.medium_index": 0.02,
    "optics.tube_length_um": 0.02,
    "lattice.pitch_um": 0.01,
    "lattice.row_pitch_um": 0.01,
    "lattice.gap_um": 0.05,
    "lattice.clear_um": 0.05,
    "sensor.pixel_um": 0.1,
    "wavelength_um": 0.05,
    "bandwidth_um": 0.5,
}
"""Relative uncertainty of each value; for an f-number a third of a stop."""

FOCUS = 0.05
"""Relative uncertainty of the focal lengths of the lenslets."""

STEPS = {"lattice.rotation_rad": math.radians(0.2), "lattice.shear_rad": math.radians(0.1)}
"""Absolute uncertainty of each value (rad)."""

OTHERS: dict[str, tuple[Any, ...]] = {
    "optics.blades": (0, 5, 6, 7, 8, 9),
    "optics.blade_curvature": (0.0, 0.5, 1.0),
    "lattice.type_step": (1, 2),
}
"""Values to try, by path, for quantities that have no uncertainty."""

OPTICS = (LensTypeDefocus(), IrisShape())

KEPT = ("depths_um", "cutout", "anchor", "stage", "order", "exposure_s", "settle_s", "frames_averaged")
"""Fields of a plan that stay the same if a value of the camera is changed."""

PHASES = 3
"""Number of positions along each axis of the period at which patterns are compared."""


@dataclass(frozen=True, slots=True)
class AssumedEffect:
    """Largest relative changes of a scan if an assumed value of its camera is wrong by the value's uncertainty.

    Attributes
    ----------
    path, label
        Path of the value in the camera's description, such as ``"optics.f_number"``, and its display name.
    seconds
        Relative change of the recording time. All three changes are infinite if the scan may become impossible.
    cutout
        Relative change of the side of the smallest cutout that contains the patterns.
    pattern
        Relative L1 change of H, computed with rays; 2 if the old and new patterns do not overlap.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.base import drain
    >>> from lfcal.camera import Marks, ScanPlan, preset
    >>> from lfcal.simulate import AssumedEffect, iter_assumed_effects
    >>> marks = Marks.of({"optics.f_number": "assumed", "sensor.prnu": "assumed"})
    >>> camera = replace(preset("bench"), marks=marks)
    >>> plan = ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0))
    >>> first: AssumedEffect = drain(iter_assumed_effects(plan))[0]
    >>> print(first.label, f"{first.largest:.0%}", first.words, sep="; ")
    f-number of the main lens; 34%; H by up to 34 %
    """

    path: str
    label: str
    seconds: float
    cutout: float
    pattern: float

    @property
    def largest(self) -> float:
        """Largest of `seconds`, `cutout` and `pattern`."""
        return max(self.seconds, self.cutout, self.pattern)

    @property
    def words(self) -> str:
        """Text that states the largest change, such as ``"H by up to 12 %"``."""
        if not math.isfinite(self.largest):
            return "the scan may not be possible"
        name = max(("time", self.seconds), ("cutout", self.cutout), ("H", self.pattern), key=lambda one: one[1])[0]
        shown = f"{100 * self.largest:.0f}" if self.largest >= 0.0095 else f"{100 * self.largest:.1f}"
        return f"{name} by up to {shown} %" if self.largest >= 0.0005 else "no change"


def iter_assumed_effects(plan: ScanPlan) -> Work[tuple[AssumedEffect, ...]]:
    """Estimate how much each assumed value of the plan's camera matters, with patterns computed by rays.

    Return an `AssumedEffect` for each value, the largest first. The result is empty for a Fourier light-field
    microscope, whose light is not computed with rays.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import Marks, ScanPlan, preset
    >>> from lfcal.simulate import iter_assumed_effects
    >>> marks = Marks.of({"optics.f_number": "assumed", "sensor.prnu": "assumed"})
    >>> plan = ScanPlan.for_camera(replace(preset("bench"), marks=marks), virtual_depths=(3.0,))
    >>> [step.count for step in iter_assumed_effects(plan)]
    ['0 of 2', '1 of 2', '2 of 2']
    """
    there = set(plan.camera.marks.paths("assumed"))
    asked = [one for one in quantities_of(plan.camera) if one.path in there and plan.camera.has_lattice]
    clock = Clock("estimate the influence of assumed values", len(asked))
    yield clock.at(0)
    kept = {name: getattr(plan, name) for name in KEPT}
    found, base = [], _Outcome.of(plan.camera, kept) if asked else None
    for number, quantity in enumerate(asked, 1):
        assert base is not None
        changes = [base.change(camera, kept) for camera in _variants(plan.camera, quantity.path)]
        largest = (max(parts) for parts in zip((0.0, 0.0, 0.0), *changes, strict=True))
        found.append(AssumedEffect(quantity.path, quantity.label, *largest))
        yield clock.at(number)
    return tuple(sorted(found, key=lambda one: -one.largest))


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Consequences of a plan: recording time (s), side of the cutout (px), and patterns by rays."""

    seconds: float
    cutout: float
    patterns: NDArray[np.float32]

    @classmethod
    def of(cls, camera: Camera, kept: Mapping[str, Any]) -> _Outcome:
        """Return the consequences of the plan of a camera with the ``kept`` values."""
        made = ScanPlan.for_camera(camera, **kept)
        numbers = sorted({0, len(made.depths_um) // 2, len(made.depths_um) - 1})
        ys, xs = (np.unique(np.linspace(0, n - 1, PHASES).round().astype(np.intp)) for n in made.period)
        patterns = [PlaneResponse(made, z, OPTICS, level="geometric").rows(ys, xs, 1) for z in numbers]
        seconds = 3600 * Forecast.of(made).hours
        return cls(seconds, cutout_for(camera, made.depths_um), np.array(patterns).reshape(len(numbers), -1))

    def change(self, camera: Camera, kept: Mapping[str, Any]) -> tuple[float, float, float]:
        """Return the changes of time, cutout and patterns for another camera."""
        try:
            other = _Outcome.of(camera, kept)
        except (LfcalError, ZeroDivisionError, OverflowError):
            return math.inf, math.inf, math.inf
        if other.patterns.shape != self.patterns.shape:
            return abs(other.seconds / self.seconds - 1), abs(other.cutout / self.cutout - 1), 2.0
        light = self.patterns.sum(axis=1)
        off = np.abs(other.patterns - self.patterns).sum(axis=1) / np.maximum(light, 1e-12)
        return abs(other.seconds / self.seconds - 1), abs(other.cutout / self.cutout - 1), float(off.max())


def _variants(camera: Camera, path: str) -> Iterator[Camera]:
    """Yield cameras with the value at a path changed by its uncertainty; none if it has no effect."""
    value = value_at(camera, path)
    given: tuple[Any, ...] = ()
    if path == "lattice.types":
        for share in (1 - FOCUS, 1 + FOCUS):
            types = tuple(replace(one, focal_length_um=one.focal_length_um * share) for one in camera.periodic.types)
            yield replace(camera, lattice=replace(camera.periodic, types=types))
    elif path == "lattice.kind":
        kind = "hexagonal" if value == "square" else "square"
        one_type: dict[str, Any] = {
            "kind": kind,
            "types": camera.lattice.types[:1],
            "row_pitch_um": None,
            "shear_rad": 0.0,
        }
        yield replace(camera, lattice=replace(camera.lattice, **one_type))
    elif path == "lattice.offset_um":
        half = camera.lattice.pitch_um / 2
        given = ((value[0] + half, value[1]), (value[0], value[1] + half))
    elif path == "optics.blade_rotation_rad":
        given = (value + math.pi / max(1, camera.optics.blades),)  # type: ignore[union-attr]
    elif path in SHARES and value is not None:
        given = (value * (1 - SHARES[path]), value * (1 + SHARES[path]))
    elif path == "lattice.clear_um":
        given = (camera.lattice.clear_diameter_um * (1 - SHARES[path]),)
    elif path in STEPS:
        given = (value - STEPS[path], value + STEPS[path])
    else:
        given = tuple(one for one in OTHERS.get(path, ()) if one != value)
    for one in given:
        try:
            yield _with(camera, path, one)
        except LfcalError:  # a camera with such a value is not possible
            continue


def _with(camera: Camera, path: str, value: Any) -> Camera:
    part, _, name = path.rpartition(".")
    return replace(camera, **({part: replace(getattr(camera, part), **{name: value})} if part else {name: value}))
