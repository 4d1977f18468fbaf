"""Three pictures side by side: a position without an effect, with it, and the difference."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QRectF
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from lfcal_gui.models import DisplaySettings, levels_of, to_uint8
from lfcal_gui.pages.simulate.model_influence import InfluencePictures
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    ColourBar,
    MeasuredPart,
    bar_table,
    entries_at,
    link_plots,
    offer_menu,
    style_axes,
    theme_plot,
    theme_table,
)

__all__ = ["InfluenceView"]

TITLES = ("without", "with", "difference")
PICTURE, ROW_NUMBERS = 100.0, 61.0
"""Widths of a picture and of the numbers of its rows, in units of the layout."""

MAPS = ("viridis", "viridis", "RdBu_r")


class InfluenceView(QWidget):
    """Pictures that pan and zoom together; the first two share their levels."""

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.graphics.setMinimumSize(240, 150)
        self.graphics.ci.layout.setContentsMargins(2, 2, 2, 2)
        self.graphics.ci.layout.setHorizontalSpacing(4)
        self.plots: list[pg.PlotItem] = []
        self.items: list[pg.ImageItem] = []
        self.bars: list[ColourBar] = []
        for k, title in enumerate(TITLES):
            self._add_plot(k, title)
        link_plots(self.plots)
        self.graphics.setAccessibleName("pattern with and without the effect")
        offer_menu(self.graphics, lambda: "effect", at=lambda point: entries_at(self.graphics, self.parts, point))
        self.parts = [
            MeasuredPart(self, plot, f"effect_{title}", title, self._contrast_changed)
            for plot, title in zip(self.plots, TITLES, strict=True)
        ]
        self.words = QLabel()
        self.words.setWordWrap(True)
        self.words.setProperty("role", "hint")
        self.influence: InfluencePictures | None = None
        column.addWidget(self.graphics, 1)
        column.addWidget(self.words)
        self.apply_theme()

    def _add_plot(self, number: int, title: str) -> None:
        plot: pg.PlotItem = self.graphics.addPlot(row=0, col=number, enableMenu=False)
        plot.setAspectLocked(True)
        plot.invertY(True)
        plot.hideButtons()
        plot.setTitle(title, size="9pt")
        item = pg.ImageItem(axisOrder="row-major")
        plot.addItem(item)
        layout = self.graphics.ci.layout
        # pictures as wide as each other, whatever stands below
        layout.setColumnPreferredWidth(number, PICTURE + (0 if number else ROW_NUMBERS))
        layout.setColumnStretchFactor(number, 1)
        if number:
            plot.getAxis("left").setStyle(showValues=False)
            plot.getAxis("left").setWidth(6)
        self.plots.append(plot)
        self.items.append(item)
        if number == 0:
            return
        # one bar for the first two pictures, one for the difference
        bar = ColourBar(width=10, below=True)
        self.graphics.addItem(bar, row=1, col=0 if number == 1 else 2, colspan=2 if number == 1 else 1)
        self.bars.append(bar)

    def show_influence(self, influence: InfluencePictures | None, words: str = "") -> None:
        """Show the pictures of one position; None clears them and says why."""
        before = None if self.influence is None else (self.influence.without.shape, self.influence.origin)
        self.influence = influence
        self.words.setText(words or (influence.words if influence is not None else ""))
        if influence is None:
            for item in self.items:
                item.clear()
            for part in self.parts:
                part.take(None)
            return
        pictures = (influence.without, influence.with_it, influence.difference)
        common = levels_of(np.stack(pictures[:2]))
        levels = (common, common, levels_of(pictures[2], signed=True))
        for k, (picture, ends) in enumerate(zip(pictures, levels, strict=True)):
            self.parts[k].value = "difference" if k == 2 else influence.value
            self._show(k, picture, self.parts[k].take(picture, ends, influence.origin), influence)
        for bar, part, name in zip(self.bars, self.parts[1:], (influence.value, "difference"), strict=True):
            bar.set_levels(part.shown_levels())
            bar.set_label(name)
        if before != (influence.without.shape, influence.origin):
            for plot, item in zip(self.plots, self.items, strict=True):
                plot.setRange(item.mapRectToParent(item.boundingRect()), padding=0.01)

    def _contrast_changed(self, part: MeasuredPart) -> None:
        """Draw anew; the first two pictures are compared, so they have one contrast."""
        if part is not self.parts[2]:
            for one in self.parts[:2]:
                one.contrast = part.contrast
        self.show_influence(self.influence, self.words.text())

    def _show(self, k: int, picture: NDArray[Any], levels: tuple[float, float], influence: InfluencePictures) -> None:
        display = DisplaySettings(colour_map=MAPS[k])
        data = to_uint8(picture, display, levels)
        self.items[k].setImage(data, levels=(0, 255), lut=theme_table(MAPS[k]), autoLevels=False)
        row, column = influence.origin
        rows, columns = picture.shape
        self.items[k].setRect(QRectF(column - 0.5, row - 0.5, columns, rows))
        across, down = influence.axes
        style_axes(self.plots[k], f"{across} (px)", f"{down} (px)" if k == 0 else "")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme = current_theme()
        theme_plot(self.graphics, *self.plots)
        for plot in self.plots:
            plot.titleLabel.setText(plot.titleLabel.text, color=theme.text, size="9pt")
        for bar, name in zip(self.bars, MAPS[1:], strict=True):
            bar.apply_theme()
            bar.set_colours(bar_table(name, "linear", (0.0, 1.0)))
        for item, name in zip(self.items, MAPS, strict=True):
            if item.image is not None:
                item.setLookupTable(theme_table(name))
