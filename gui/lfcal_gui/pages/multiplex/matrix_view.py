"""Small arrays without a colour bar of their own: matrices and patterns, in values or as they look."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal_gui.widgets import ColourBar, ImageView

__all__ = ["MatrixView"]


class MatrixView(ImageView):
    """An `ImageView` that also shows red, green and blue; the bar may lie below, where height is to spare."""

    def __init__(
        self,
        *,
        xlabel: str,
        ylabel: str,
        value_label: str,
        unit: str = "px",
        signed: bool = False,
        bar_below: bool = False,
        square: bool = True,
    ) -> None:
        super().__init__(xlabel=xlabel, ylabel=ylabel, unit=unit, value_label=value_label, signed=signed)
        self.coloured: NDArray[Any] | None = None
        self.plot.setAspectLocked(square)
        if bar_below:
            self.graphics.removeItem(self.bar)
            self.bar = ColourBar(width=10, below=True, label=value_label)
            self.graphics.addItem(self.bar, row=1, col=0)
            self.apply_theme()

    def show_array(
        self,
        array: NDArray[Any],
        *,
        name: str,
        levels: tuple[float, float] | None = None,
        origin: tuple[float, float] = (0.0, 0.0),
        step: float = 1.0,
    ) -> None:
        """Show values ``(rows, columns)``, or colours ``(rows, columns, 3)`` in 0 … 1; hovering gives their mean.

        The others are as in `ImageView.set_image`.
        """
        colours = array if array.ndim == 3 else None
        self.coloured = colours
        self.set_image(array if colours is None else array.mean(-1), name=name, levels=levels, origin=origin, step=step)
        if colours is not None:
            bytes_ = (np.clip(colours, 0, 1) * 255 + 0.5).astype(np.uint8)
            self.item.setImage(bytes_, levels=(0, 255), lut=None, autoLevels=False)
        self.bar.setVisible(colours is None)
