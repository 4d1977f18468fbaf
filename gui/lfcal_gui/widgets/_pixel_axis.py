"""An axis that counts: whole numbers, and none of what is not there."""

from __future__ import annotations

import math

import pyqtgraph as pg

ROOM = 14.0
"""Screen pixels from one number to the next, one above the other."""

DIGIT, BETWEEN = 7.0, 8.0
"""Width of a digit, and least gap between neighbouring numbers (px)."""


class PixelAxis(pg.AxisItem):
    """An axis of pixels or positions: no ticks between them, nor beyond the first and the last."""

    span: tuple[float, float] | None = None

    def cover(self, first: float, count: int, step: float = 1.0) -> None:
        """Count ``count`` pixels from ``first``; where they are no whole numbers the axis is as any other."""
        whole = step == 1 and float(first).is_integer()
        span = (first, first + count - 1) if whole else None
        if span != self.span:
            self.span = span
            self.picture = None
            self.update()

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """Return where ticks are: pairs of their distance and their places."""
        found: list[tuple[float, list[float]]] = super().tickValues(minVal, maxVal, size)
        if self.span is None:
            return found
        first, last = sorted((minVal, maxVal))  # rows count downwards
        low, high = max(first, self.span[0]), min(last, self.span[1])
        apart = size / max(last - first, 1e-9)
        room = ROOM
        if self.orientation in ("bottom", "top"):
            room = max(ROOM, DIGIT * max(len(f"{end:.0f}") for end in (low, high)) + BETWEEN)
        # pyqtgraph spaces numbers for the whole axis, not for many in a small part of it
        wide = [pair for pair in found if pair[0] >= 1 and pair[0] * apart >= room]
        kept = [(step, [v for v in values if low <= v <= high]) for step, values in wide]
        if any(values for _, values in kept):
            return kept
        # zoomed in until pyqtgraph has only ticks within a pixel, or out until one number fits
        each = max(1, math.ceil(room / max(apart, 1e-9)))
        return [(float(each), [float(k) for k in range(math.ceil(low), math.floor(high) + 1, each)])]


def pixel_axes() -> dict[str, PixelAxis]:
    """Return both axes of a picture, for ``addPlot``."""
    return {"bottom": PixelAxis("bottom"), "left": PixelAxis("left")}


def count_pixels(
    plot: pg.PlotItem, shape: tuple[int, ...], origin: tuple[float, float] = (0.0, 0.0), step: float = 1.0
) -> None:
    """Let the axes of ``plot`` count the pixels of a picture ``(rows, columns)`` whose first is at ``origin``."""
    for side, first, count in (("left", origin[0], shape[0]), ("bottom", origin[1], shape[1])):
        plot.getAxis(side).cover(first, count, step)
