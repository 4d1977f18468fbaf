"""A volume as three orthogonal slices with one cross hair, or as maximum projections."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QRectF, Qt, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QHBoxLayout, QLabel, QSlider, QVBoxLayout, QWidget

from lfcal.base import format_length
from lfcal_gui.models import COLOUR_MAPS, to_uint8
from lfcal_gui.pages.reconstruct.model_volume import VolumeIntent, VolumePicture, resolve
from lfcal_gui.widgets import (
    ColourBar,
    MeasuredPart,
    bar_table,
    count_pixels,
    entries_at,
    offer_menu,
    pixel_axes,
    style_axes,
    theme_plot,
    theme_table,
)

__all__ = ["VolumeView"]

VALUE = "brightness (counts)"
CROSS = "#ff5a5f"


class VolumeView(QWidget):
    """Show a volume ``(Z, Y, X)``; drag a line of the cross hair, click, or use the slider.

    Signals
    -------
    moved(z, y, x)
        The cross hair is elsewhere.
    """

    moved = Signal(int, int, int)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.intent = VolumeIntent()
        self.picture: VolumePicture | None = None
        self._volume: NDArray[Any] | None = None
        self._depths: NDArray[np.float64] | None = None
        self._whole = (0.0, 1.0)
        self.graphics = pg.GraphicsLayoutWidget()
        self.xy, self.yz = self._plot(0, 0, "x (voxels)", "y (voxels)"), self._plot(0, 1, "z (planes)", "")
        self.xz = self._plot(1, 0, "x (voxels)", "z (planes)")
        self.yz.setYLink(self.xy)
        self.xz.setXLink(self.xy)
        self.xy.setAspectLocked(True)
        self.bar = ColourBar(label=VALUE, below=True)
        self.graphics.addItem(self.bar, row=1, col=1)
        offer_menu(
            self.graphics, lambda: "volume", at=lambda p: entries_at(self.graphics, tuple(self.parts.values()), p)
        )
        layout = self.graphics.ci.layout
        for index, share in ((0, 5), (1, 2)):
            layout.setColumnStretchFactor(index, share)
            layout.setRowStretchFactor(index, share)
        self.items: dict[str, pg.ImageItem] = {}
        self.lines: dict[tuple[str, str], pg.InfiniteLine] = {}
        for name, plot in (("xy", self.xy), ("xz", self.xz), ("yz", self.yz)):
            self._add_image(name, plot)
        self.parts = {
            name: MeasuredPart(self, plot, f"volume_{name}", VALUE, lambda _: self._show())
            for name, plot in (("xy", self.xy), ("xz", self.xz), ("yz", self.yz))
        }
        self.graphics.scene().sigMouseClicked.connect(self._clicked)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(5)
        outer.addLayout(self._controls())
        outer.addWidget(self.graphics, 1)
        outer.addLayout(self._depth_row())
        self.apply_theme()

    # -- building --------------------------------------------------------------------------------------
    def _plot(self, row: int, column: int, xlabel: str, ylabel: str) -> pg.PlotItem:
        plot = self.graphics.addPlot(row=row, col=column, axisItems=pixel_axes(), enableMenu=False)
        plot.hideButtons()
        if row == 0:
            plot.invertY(True)
        style_axes(plot, xlabel, ylabel)
        if not ylabel:
            plot.getAxis("left").setStyle(showValues=False)
            plot.getAxis("left").setLabel("")
        return plot

    def _add_image(self, name: str, plot: pg.PlotItem) -> None:
        item = pg.ImageItem(axisOrder="row-major")
        plot.addItem(item)
        self.items[name] = item
        pen, hover = pg.mkPen(CROSS, width=1), pg.mkPen(CROSS, width=3)
        for axis, angle in ((name[0], 90), (name[1], 0)):
            if name == "yz":  # z runs to the right there, y down as in the slice beside it
                angle = 90 - angle
            one = pg.InfiniteLine(angle=angle, movable=True, pen=pen, hoverPen=hover)
            one.sigDragged.connect(lambda line, axis=axis: self.set_cross(**{axis: round(line.value())}))
            plot.addItem(one)
            self.lines[name, axis] = one

    def _controls(self) -> QHBoxLayout:
        row = QHBoxLayout()
        row.setSpacing(6)
        self.mode = QComboBox()
        self.mode.addItem("slices", False)
        self.mode.addItem("maximum projections", True)
        self.mode.setAccessibleName("view of the volume")
        self.mode.setToolTip(
            "Slices through the cross hair, or the brightest voxel along each axis, to find where something is"
        )
        self.mode.currentIndexChanged.connect(lambda _: self._change(projection=self.mode.currentData()))
        self.scale = QComboBox()
        for value, text in (("linear", "linear"), ("gamma", "gamma 0.5"), ("log", "log")):
            self.scale.addItem(text, value)
        self.scale.setAccessibleName("scaling of colours")
        self.scale.setToolTip("Gamma and log (four decades) bring out what is faint, artefacts among it")
        self.scale.currentIndexChanged.connect(lambda _: self._display(scale=self.scale.currentData()))
        self.colours = QComboBox()
        for name in COLOUR_MAPS:
            self.colours.addItem(name, name)
        self.colours.setAccessibleName("colours")
        self.colours.setToolTip(
            "Colours of brightness; equal steps look equally large in all of them, grey prints best"
        )
        self.colours.currentIndexChanged.connect(lambda _: self._display(colour_map=self.colours.currentData()))
        self.own = QCheckBox("Own scale")
        self.own.setToolTip("Each plane has a colour scale of its own; off: all planes share one")
        self.own.toggled.connect(lambda on: self._change(own_scale=on))
        for widget in (self.mode, self.scale, self.colours, self.own):
            row.addWidget(widget)
        row.addStretch()
        return row

    def _depth_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("depth plane")
        self.slider.setToolTip("Depth plane of the upper picture; the side views show the others")
        self.slider.valueChanged.connect(lambda z: self.set_cross(z=z))
        self.readout = QLabel("–")
        self.readout.setProperty("role", "hint")
        row.addWidget(QLabel("z"))
        row.addWidget(self.slider, 1)
        row.addWidget(self.readout, 1)
        return row

    # -- content ---------------------------------------------------------------------------------------
    def set_volume(self, volume: NDArray[Any] | None, depths_um: NDArray[np.float64] | None = None) -> None:
        """Show ``volume`` ``(Z, Y, X)`` with the depth of each plane (µm); cross hair and zoom stay if they fit."""
        before = None if self._volume is None else self._volume.shape
        self._volume, self._depths = volume, depths_um
        if volume is None:
            for item in self.items.values():
                item.clear()
            for part in self.parts.values():
                part.take(None)
            self.readout.setText("–")
            return
        low, high = float(np.nanmin(volume)), float(np.nanmax(volume))
        self._whole = (min(low, 0.0), high if high > low else low + 1.0)
        for plot, down, across in ((self.xy, 1, 2), (self.xz, 0, 2), (self.yz, 1, 0)):
            count_pixels(plot, (volume.shape[down], volume.shape[across]))
        if before != volume.shape:
            self.intent = VolumeIntent.middle(volume.shape, self.intent)
            self.slider.blockSignals(True)
            self.slider.setRange(0, volume.shape[0] - 1)
            self.slider.setEnabled(volume.shape[0] > 1)
            self.slider.blockSignals(False)
        self._show()
        if before != volume.shape:
            self.show_all()

    @property
    def volume(self) -> NDArray[Any] | None:
        """The volume shown."""
        return self._volume

    def set_cross(self, **place: Any) -> None:
        """Move the cross hair along any of ``z``, ``y``, ``x``."""
        if self._volume is None:
            return
        moved = replace(self.intent, **place).clamped(self._volume.shape)
        changed = moved != self.intent
        self.intent = moved
        self._show()
        if changed:
            self.moved.emit(moved.z, moved.y, moved.x)

    def show_all(self) -> None:
        """Zoom so that the whole volume is seen."""
        if self._volume is None:
            return
        nz, ny, nx = self._volume.shape
        self.xy.setRange(QRectF(-0.5, -0.5, nx, ny), padding=0.01)
        self.xz.setYRange(-0.5, nz - 0.5, padding=0.01)
        self.yz.setXRange(-0.5, nz - 0.5, padding=0.01)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        theme_plot(self.graphics, self.xy, self.xz, self.yz)
        self.bar.apply_theme()
        self._show()

    # -- inside ----------------------------------------------------------------------------------------
    def _change(self, **changes: Any) -> None:
        self.intent = replace(self.intent, **changes)
        self._show()

    def _display(self, **changes: Any) -> None:
        self._change(display=replace(self.intent.display, **changes))

    def _show(self) -> None:
        if self._volume is None:
            return
        intent = self.intent
        picture = self.picture = resolve(intent, self._volume, self._whole)
        table = theme_table(intent.display.colour_map)
        for name, image, levels in (
            ("xy", picture.xy, picture.levels),
            ("xz", picture.xz, picture.side_levels),
            ("yz", picture.yz, picture.side_levels),
        ):
            shown = to_uint8(np.ascontiguousarray(image), intent.display, self.parts[name].take(image, levels))
            self.items[name].setImage(shown, levels=(0, 255), lut=table, autoLevels=False)
            self.items[name].setRect(QRectF(-0.5, -0.5, image.shape[1], image.shape[0]))
        for (_, axis), line in self.lines.items():
            line.setValue(getattr(intent, axis))
            line.setVisible(not intent.projection or axis == "z")
        levels = self.parts["xy"].shown_levels()
        self.bar.set_colours(bar_table(intent.display.colour_map, intent.display.scale, levels))
        self.bar.set_levels(levels)
        self.slider.blockSignals(True)
        self.slider.setValue(intent.z)
        self.slider.blockSignals(False)
        depth = "" if self._depths is None else f" ({format_length(float(self._depths[intent.z]))})"
        self.readout.setText(f"plane {intent.z}{depth}, y {intent.y}, x {intent.x}: {picture.value:.4g} counts")

    def _clicked(self, event: Any) -> None:
        if self._volume is None or event.button() != Qt.MouseButton.LeftButton:
            return
        for plot, across, down in ((self.xy, "x", "y"), (self.xz, "x", "z"), (self.yz, "z", "y")):
            if plot.vb.sceneBoundingRect().contains(event.scenePos()):
                point = plot.vb.mapSceneToView(event.scenePos())
                self.set_cross(**{across: round(point.x()), down: round(point.y())})
