"""What the cameras of all backends have in common."""

from __future__ import annotations

__all__ = ["CameraFacts"]


class CameraFacts:
    """Shape and sample range of a camera; whoever opens it sets ``_shape`` and ``_bits``."""

    _shape: tuple[int, int]
    _bits: int

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Rows and columns of the whole sensor."""
        return self._shape

    @property
    def bit_depth(self) -> int:
        """Bits per sample."""
        return self._bits

    @property
    def max_value(self) -> int:
        """Sample value of a saturated pixel."""
        return (1 << self._bits) - 1
