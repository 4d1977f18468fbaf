"""A volume as three orthogonal slices with one cross hair, or as maximum projections."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QCheckBox, QComboBox, QGridLayout, QHBoxLayout, QLabel, QSlider, QVBoxLayout, QWidget

from lfcal.base import format_length
from lfcal_gui.models import COLOUR_MAPS, CUTOUT, Outline, Shot
from lfcal_gui.pages.reconstruct.model_volume import VolumeIntent, VolumePicture, resolve
from lfcal_gui.widgets import Contrast, Picture, share_contrast

__all__ = ["VolumeView"]

VALUE = "brightness (counts)"


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
        names = {"xy": ("x", "y"), "xz": ("x", "z"), "yz": ("z", "y")}
        self.pictures = {name: Picture(VALUE, steered=True, square=name == "xy", legend=False) for name in names}
        share_contrast(*self.pictures.values())
        self.xy, self.xz, self.yz = self.pictures.values()
        self.yz.box.setYLink(self.xy.box)
        self.xz.box.setXLink(self.xy.box)
        for name, (across, down) in names.items():
            picture = self.pictures[name]
            picture.setAccessibleName(f"{down} over {across}")
            picture.steered_to.connect(lambda row, column, a=across, d=down: self.set_cross(**{d: row, a: column}))
        self.contrast = Contrast(self.xy)
        self.contrast.display_asked.connect(lambda changes: self._display(**changes))
        grid = QGridLayout()
        grid.setSpacing(3)
        for row, column, name in ((0, 0, "xy"), (0, 1, "yz"), (1, 0, "xz")):
            grid.addWidget(self.pictures[name], row, column)
        for index, share in ((0, 5), (1, 2)):
            grid.setColumnStretch(index, share)
            grid.setRowStretch(index, share)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(5)
        outer.addLayout(self._controls())
        outer.addLayout(grid, 1)
        outer.addWidget(self.contrast)
        outer.addLayout(self._depth_row())
        self.apply_theme()

    # -- building --------------------------------------------------------------------------------------
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
            for picture in self.pictures.values():
                picture.set_shot(None)
            self.readout.setText("–")
            return
        low, high = float(np.nanmin(volume)), float(np.nanmax(volume))
        self._whole = (min(low, 0.0), high if high > low else low + 1.0)
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
        for picture in self.pictures.values():
            picture.show_all()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for picture in (*self.pictures.values(), self.contrast):
            picture.apply_theme()
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
        where = {"x": intent.x, "y": intent.y, "z": intent.z}
        for name, image, levels, (across, down) in (
            ("xy", picture.xy, picture.levels, "xy"),
            ("xz", picture.xz, picture.side_levels, "xz"),
            ("yz", picture.yz, picture.side_levels, "zy"),
        ):
            shown = [axis for axis in (across, down) if not intent.projection or axis == "z"]
            lines = tuple(_line(axis == across, where[axis], image.shape) for axis in shown)
            caption = f"{down} over {across}"
            shot = Shot(np.ascontiguousarray(image), caption, VALUE, f"volume_{name}", levels, overlays=lines)
            self.pictures[name].set_display(intent.display)
            self.pictures[name].set_shot(shot)
        self.slider.blockSignals(True)
        self.slider.setValue(intent.z)
        self.slider.blockSignals(False)
        depth = "" if self._depths is None else f" ({format_length(float(self._depths[intent.z]))})"
        self.readout.setText(f"plane {intent.z}{depth}, y {intent.y}, x {intent.x}: {picture.value:.4g} counts")


def _line(upright: bool, at: float, shape: tuple[int, ...]) -> Outline:
    """Return a line through the middle of a column, or of a row, of a picture ``(rows, columns)``."""
    rows, columns = shape[:2]
    ends = [(-0.5, at), (rows - 0.5, at)] if upright else [(at, -0.5), (at, columns - 0.5)]
    return Outline(np.array(ends), CUTOUT, closed=False, width=1)
