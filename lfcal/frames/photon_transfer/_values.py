"""A measured number with its standard error."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["MeasuredValue"]


class MeasuredValue(NamedTuple):
    """A measured value and its standard error, in the same unit."""

    value: float
    sigma: float

    def times(self, factor: MeasuredValue | float) -> MeasuredValue:
        """Return the product with ``factor``, assuming independent errors."""
        if not isinstance(factor, MeasuredValue):
            return MeasuredValue(self.value * factor, self.sigma * abs(factor))
        sigma = math.hypot(self.sigma * factor.value, self.value * factor.sigma)
        return MeasuredValue(self.value * factor.value, sigma)

    def inverse(self) -> MeasuredValue:
        """Return the reciprocal."""
        return MeasuredValue(1 / self.value, self.sigma / self.value**2)

    def root(self, floor: float = 0.0) -> MeasuredValue:
        """Return the square root of a variance, which noise may have reduced below ``floor``."""
        root = math.sqrt(max(self.value, floor))
        # near zero, the root of the error is an upper limit of the value
        return MeasuredValue(root, min(self.sigma / (2 * root) if root > 0 else math.inf, math.sqrt(self.sigma)))

    def __str__(self) -> str:
        """Return the value with the number of digits that its error justifies."""
        if not self.sigma > 0 or not math.isfinite(self.sigma):
            return f"{self.value:.5g}"
        digits = max(0, min(9, 1 - math.floor(math.log10(self.sigma))))
        return f"{self.value:.{digits}f} ± {self.sigma:.{digits}f}"
