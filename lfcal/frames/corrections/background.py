"""The background of a frame: a given level, the median of its border, or a plane fitted to its border."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_choice, check_number
from lfcal.frames.regions import Region

__all__ = ["Background", "border_strips"]

MAX_SAMPLES = 20_000
"""Border pixels that a plane is fitted to at most, evenly taken."""

Plane = tuple[float, float, float]
"""Background at pixel (0, 0) and its change per row and per column (sample values)."""


def border_strips(shape: tuple[int, int], width: int) -> list[Region]:
    """Return the regions that cover a border of ``width`` pixels once: top, bottom, left, right."""
    rows, columns = shape
    # a frame so small is all border
    if 2 * width >= min(rows, columns):
        return [(slice(0, rows), slice(0, columns))]
    inner = slice(width, rows - width)
    return [
        (slice(0, width), slice(0, columns)),
        (slice(rows - width, rows), slice(0, columns)),
        (inner, slice(0, width)),
        (inner, slice(columns - width, columns)),
    ]


def fit_plane(rows: NDArray[Any], columns: NDArray[Any], values: NDArray[Any], *, rounds: int = 4) -> Plane:
    """Fit ``p0 + p1 row + p2 column`` by least squares, leaving out what lies beyond 3 robust sigma of the rest."""
    design = np.stack([np.ones(rows.size), rows, columns], axis=1).astype(np.float64)
    values = values.astype(np.float64)
    # a wider first cut: the median knows nothing of the slope yet, and a steep plane is wide about it
    keep = np.abs(values - np.median(values)) <= 6 * _sigma(values) + 1e-12
    solution = np.zeros(3)
    for _ in range(rounds):
        solution = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
        residual = values - design @ solution
        # the last term keeps all values of a plane without noise, whose sigma is rounding alone
        again = np.abs(residual) <= 3 * _sigma(residual[keep]) + 1e-9 * (1 + np.abs(values).max())
        # fewer than three points do not fix a plane, and an unchanged choice gives the same plane again
        if np.array_equal(again, keep) or np.count_nonzero(again) < 3:
            break
        keep = again
    return float(solution[0]), float(solution[1]), float(solution[2])


def _sigma(values: NDArray[np.float64]) -> float:
    """Return the robust standard deviation, 1.4826 times the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True)
class Background:
    """Subtract the background; what lies below it becomes negative and stays so.

    Attributes
    ----------
    kind
        ``"constant"``: ``value`` is subtracted. ``"border"``: the median of the border, measured on each frame.
        ``"plane"``: a plane fitted to the border of each frame, spots left out.
    value
        Level of the constant background, in sample values at this place of the chain.
    width
        Width of the border (px).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import Background, CorrectionChain
    >>> frame = np.full((32, 32), 12, np.uint16)
    >>> frame[15, 15] = 100
    >>> clean = CorrectionChain((Background("border", width=4),)).apply(frame)
    >>> print(clean[0, 0], clean[15, 15])
    0.0 88.0
    """

    kind: str = "border"
    value: float = 0.0
    width: int = 8

    def __post_init__(self) -> None:
        """Check the values."""
        check_choice("background", self.kind, ("constant", "border", "plane"))
        check_number("background level", self.value)
        check_number("background border (px)", self.width, at_least=1, at_most=4096, integer=True)

    @property
    def shape(self) -> tuple[int, int] | None:
        """Fits any frame."""
        return None

    @property
    def measured(self) -> bool:
        """Whether it is measured on each frame."""
        return self.kind != "constant"

    def measure(self, part: Callable[[Region], NDArray[np.float32]], shape: tuple[int, int]) -> Plane:
        """Return the background of the frame of ``shape`` whose regions ``part`` returns, corrected so far."""
        if self.kind == "constant":
            return float(self.value), 0.0, 0.0
        rows, columns, values = [], [], []
        for region in border_strips(shape, self.width):
            strip = part(region)
            # NaN marks masked pixels, which are not repaired yet at this place of the chain
            r, c = np.nonzero(np.isfinite(strip))
            values.append(strip[r, c])
            rows.append(r + region[0].start)
            columns.append(c + region[1].start)
        value = np.concatenate(values)
        if not value.size:
            return 0.0, 0.0, 0.0
        if self.kind == "border":
            return float(np.median(value)), 0.0, 0.0
        some = slice(None, None, 1 + value.size // MAX_SAMPLES)
        return fit_plane(np.concatenate(rows)[some], np.concatenate(columns)[some], value[some])

    def describe(self) -> dict[str, Any]:
        """Return a JSON description."""
        record: dict[str, Any] = {"kind": "background", "method": self.kind}
        return record | ({"width": self.width} if self.measured else {"value": float(self.value)})
