"""What the volume viewer shows: three slices or projections with one cross hair. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal_gui.models import DisplaySettings

__all__ = ["VolumeIntent", "VolumePicture", "resolve"]


@dataclass(frozen=True)
class VolumeIntent:
    """What the user asked for.

    Attributes
    ----------
    z, y, x
        The cross hair, in planes and voxels.
    projection
        Maximum along the third axis instead of the slice through the cross hair.
    own_scale
        Each depth plane fills the colours by itself; else the whole volume shares one scale.
    display
        Scaling and colour map.
    """

    z: int = 0
    y: int = 0
    x: int = 0
    projection: bool = False
    own_scale: bool = False
    display: DisplaySettings = field(default_factory=DisplaySettings)

    def clamped(self, shape: tuple[int, ...]) -> VolumeIntent:
        """Return the intent with the cross hair inside a volume of ``shape``."""
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip((self.z, self.y, self.x), shape, strict=True))
        return replace(self, z=z, y=y, x=x)

    @classmethod
    def middle(cls, shape: tuple[int, ...], like: VolumeIntent | None = None) -> VolumeIntent:
        """Return the cross hair in the middle of a volume of ``shape``; the rest as in ``like``."""
        return replace(like or cls(), z=shape[0] // 2, y=shape[1] // 2, x=shape[2] // 2)


@dataclass(frozen=True, eq=False)
class VolumePicture:
    """What is drawn: ``xy`` (Y, X), ``xz`` (Z, X), ``yz`` (Y, Z), their levels, and the voxel under the cross."""

    xy: NDArray[Any]
    xz: NDArray[Any]
    yz: NDArray[Any]
    levels: tuple[float, float]
    side_levels: tuple[float, float]
    value: float


def resolve(intent: VolumeIntent, volume: NDArray[Any], whole: tuple[float, float]) -> VolumePicture:
    """Return what to draw of ``volume`` ``(Z, Y, X)``; ``whole`` are its lowest and highest value."""
    z, y, x = intent.z, intent.y, intent.x
    if intent.projection:
        xy, xz, yz = volume.max(0), volume.max(1), volume.max(2).T
    else:
        xy, xz, yz = volume[z], volume[:, y], volume[:, :, x].T
    levels = _levels(xy) if intent.own_scale else whole
    return VolumePicture(xy, xz, yz, levels, whole, float(volume[z, y, x]))


def _levels(image: NDArray[Any]) -> tuple[float, float]:
    low, high = float(np.nanmin(image)), float(np.nanmax(image))
    return low, high if high > low else low + 1.0
