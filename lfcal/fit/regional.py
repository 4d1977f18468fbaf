"""Patterns of several regions of the field, recorded with one camera at the same depths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.measured import Measured

__all__ = ["FieldRegion", "Regional", "regional_of"]

APART = 2.0
"""Cutouts by which the middles of two regions must be apart: nearer, they show the same place of the field."""


@dataclass(frozen=True, slots=True)
class FieldRegion:
    """A place of the field that was scanned.

    Attributes
    ----------
    name
        What it is called.
    period, anchor
        Positions of its scan, and where the image of the first lies on the sensor, as of a `ScanPlan`.
    """

    name: str
    period: tuple[int, int]
    anchor: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Regional(Measured):
    """Patterns of several regions; all else as of those of one, ``plan`` is that of the first.

    Attributes
    ----------
    regions
        Where each was scanned.
    region
        Which region each pattern ``(n,)`` is of.
    """

    regions: tuple[FieldRegion, ...] = ()
    region: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))

    def __post_init__(self) -> None:
        """Check that everything belongs together."""
        if self.region.shape != (len(self.index),):
            wanted = f"shape {(len(self.index),)}"
            raise InputError.expected("region", wanted, self.region.shape, "give one for each pattern")
        Measured.__post_init__(self)

    @property
    def level(self) -> NDArray[np.intp]:
        """Of which light and background each pattern ``(n,)`` is: those of its plane in its region."""
        found: NDArray[np.intp] = self.region * self.plan.shape[0] + self.index[:, 0]
        return found

    @property
    def levels(self) -> int:
        """How many there are."""
        return len(self.regions) * self.plan.shape[0]

    @property
    def plans(self) -> tuple[ScanPlan, ...]:
        """The plan of each region."""
        return tuple(replace(self.plan, period=one.period, anchor=one.anchor) for one in self.regions)

    def parts(self) -> Iterator[tuple[ScanPlan, NDArray[np.intp], int]]:
        """Yield the plan of each region with patterns, which patterns are of it, and its number."""
        plans = self.plans
        for k in np.unique(self.region).tolist():
            yield plans[k], np.flatnonzero(self.region == k), k

    def of(self, keep: NDArray[np.bool_]) -> Regional:
        """Return the patterns that are kept."""
        return replace(self, **self._some(keep), region=self.region[keep])

    def of_region(self, k: int) -> Measured:
        """Return the patterns of one region, as of a scan of its own."""
        own = self.region == k
        return Measured(self.plans[k], **self._some(own))


def regional_of(patterns: Mapping[str, Measured], camera: Camera | None = None) -> Regional:
    """Return the patterns of several regions as one.

    Parameters
    ----------
    patterns
        Those of each region, by its name.
    camera
        The camera as described; None takes that of the first.

    Raises
    ------
    InputError
        Unless there are two regions or more, apart from each other, of one camera, depths and cutout.
    """
    parts = list(patterns.values())
    if len(parts) < 2:
        raise InputError.expected("regions of the field", "two or more", len(parts), "name an H of each region")
    first = parts[0].plan if camera is None else replace(parts[0].plan, camera=camera)
    regions: list[FieldRegion] = []
    for name, own in patterns.items():
        _check_alike(name, own.plan, first)
        middle = np.array(own.plan.anchor) + np.array(own.plan.period) / 2
        for other in regions:
            apart = float(np.hypot(*(middle - np.array(other.anchor) - np.array(other.period) / 2)))
            if apart < APART * max(first.cutout):
                wanted = f"{APART * max(first.cutout):.0f} px or more from {other.name!r}"
                raise InputError.expected(f"region {name!r}", wanted, f"{apart:.0f} px", "scan it elsewhere")
        regions.append(FieldRegion(name, own.plan.period, own.plan.anchor))
    joined: dict[str, Any] = {
        key: np.concatenate([getattr(own, key) for own in parts])
        for key in ("index", "patterns", "noise", "places_px", "valid", "left_out")
    }
    number = np.concatenate([np.full(len(own), k) for k, own in enumerate(parts)])
    return Regional(first, **joined, regions=tuple(regions), region=number)


def _check_alike(name: str, plan: ScanPlan, first: ScanPlan) -> None:
    """Raise where a region's scan is not of the same camera, depths and cutout as the first."""
    have: dict[str, tuple[Any, Any]] = {
        "depths (µm)": (plan.depths_um, first.depths_um),
        "pixels of a pattern": (plan.cutout, first.cutout),
        "pixels of the sensor": (plan.camera.sensor.shape, first.camera.sensor.shape),
        "pixel (µm)": (plan.camera.sensor.pixel_um, first.camera.sensor.pixel_um),
        "pitch of the lenslets (µm)": (plan.camera.lattice.pitch_um, first.camera.lattice.pitch_um),
    }
    for what, (own, wanted) in have.items():
        if np.shape(own) != np.shape(wanted) or not np.allclose(own, wanted, rtol=1e-6, atol=1e-6):
            raise InputError.expected(f"region {name!r}, {what}", wanted, own, "take regions of one camera and depths")
