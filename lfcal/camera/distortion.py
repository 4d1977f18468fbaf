"""Lens distortion as a maker states it."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.checks import check_tuple

__all__ = ["BrownDistortion"]


@dataclass(frozen=True, slots=True)
class BrownDistortion:
    """Radial distortion after Brown, kept as the calibration file states it.

    The file says neither the unit of the radius nor from which corner the centre counts, so the numbers are
    carried along and not applied.

    Attributes
    ----------
    coefficients
        Radial coefficients k1, k2, … in the file's order.
    centre_px
        Centre of distortion (x, y) as in the file (pixels).
    """

    coefficients: tuple[float, ...]
    centre_px: tuple[float, float]

    def __post_init__(self) -> None:
        """Check every value."""
        values = check_tuple("distortion coefficients", self.coefficients)
        object.__setattr__(self, "coefficients", values)
        object.__setattr__(self, "centre_px", check_tuple("distortion centre (x, y) (px)", self.centre_px, 2))
