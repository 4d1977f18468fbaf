"""How bright a frame is: every pixel counted, nothing sampled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, njit

__all__ = ["Levels", "levels"]


@njit()
def _count(data: NDArray[Any], histogram: NDArray[np.int64]) -> None:
    """Count the samples of ``data`` (rows, columns) by value; the histogram's last entry takes all at or above."""
    last = histogram.size - 1
    for i in range(data.shape[0]):
        for j in range(data.shape[1]):
            # one pass without a copy: np.bincount would first widen a frame of 16 bits to 64
            histogram[min(int(data[i, j]), last)] += 1


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """The true histogram of a frame.

    Attributes
    ----------
    histogram
        ``(max_value + 1,)`` pixels with each sample value; the last entry holds all at or above.
    """

    histogram: NDArray[np.int64]

    @property
    def pixels(self) -> int:
        """Pixels counted."""
        return int(self.histogram.sum())

    @property
    def saturated(self) -> int:
        """Pixels at the highest value."""
        return int(self.histogram[-1])

    @property
    def maximum(self) -> int:
        """Highest sample value that occurs."""
        return int(np.flatnonzero(self.histogram)[-1])

    def quantile(self, share: float) -> int:
        """Return the sample value below or at which ``share`` of the pixels lie."""
        total = np.cumsum(self.histogram)  # exact for whole numbers, where sorting the frame would cost its copy
        return int(np.searchsorted(total, share * total[-1]))


def levels(frame: NDArray[Any], max_value: int) -> Levels:
    """Return the histogram of ``frame`` ``(rows, columns)``, unsigned samples that saturate at ``max_value``.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.acquire.setup import Levels, levels
    >>> found: Levels = levels(np.array([[0, 100], [200, 4095]], np.uint16), max_value=4095)
    >>> print(found.saturated, "saturated pixel")
    1 saturated pixel
    """
    if frame.ndim != 2 or frame.dtype.kind != "u" or frame.size == 0:
        raise InputError.expected(
            "frame", "a 2-D array of unsigned samples", f"{frame.ndim}-D {frame.dtype}", "pass a raw frame"
        )
    histogram = np.zeros(max_value + 1, np.int64)
    _count(frame, histogram)
    return Levels(histogram)
