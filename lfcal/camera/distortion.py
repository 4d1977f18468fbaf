"""Lens distortion as a maker states it."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.camera._checks import check_number
from lfcal.errors import InputError, expectation

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
        for name, most in (("coefficients", 8), ("centre_px", 2)):
            values = getattr(self, name)
            if not isinstance(values, list | tuple) or not 1 <= len(values) <= most:
                raise InputError(expectation(f"distortion {name}", f"1 to {most} numbers", repr(values), "correct it"))
            for value in values:
                check_number(f"distortion {name}", value)
            object.__setattr__(self, name, tuple(float(v) for v in values))
        if len(self.centre_px) != 2:
            raise InputError(expectation("distortion centre_px", "(x, y)", self.centre_px, "correct it"))
