"""A volume turned, as three orthogonal slices, or as maximum projections, all at true scale with one cross."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAction, QResizeEvent
from PySide6.QtWidgets import (
    QBoxLayout,
    QButtonGroup,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QMenu,
    QPushButton,
    QSlider,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.jobs import Jobs
from lfcal_gui.models import BEGIN, CUTOUT, Levels, Outline, Shot, turned
from lfcal_gui.pages.reconstruct._solid_picture import Newest, SolidPicture, View
from lfcal_gui.pages.reconstruct.model_volume import MODES, Prepared, Side, VolumeIntent, prepare, sides
from lfcal_gui.widgets import Contrast, ElidedLabel, Picture, link, share_contrast

__all__ = ["VolumeView"]

VALUE = "brightness (counts)"

TICKS = (
    ("by_depth", "Colour by depth", "Colours of the 3-D view: depth, with brightness by value; off: by value alone"),
    ("box", "Box and axes", "Edges of the volume, and the directions of its axes"),
    ("cross", "Cross", "The voxel that the slices go through"),
    ("own_scale", "Own scale of each plane", "Slices: each depth plane has its own colour scale"),
    ("truth", "Truth", "The phantom that the light field was made from, turned together with the reconstruction"),
)
"""Field of the intent, words and meaning of each entry of the menu."""

AXES = {"xy": "xy", "xz": "xz", "yz": "zy"}
"""What is across and down in each picture."""


class VolumePanes(QWidget):
    """One volume: turned, or from three sides."""

    def __init__(self, name: str, jobs: Jobs | None, *, first: bool) -> None:
        super().__init__()
        self.name, self.short = name, "" if first else f"{name}, "
        self.prepared: Prepared | None = None
        self.shown: dict[str, Side] = {}
        self.solid = SolidPicture(VALUE, name, jobs)
        self.pictures = {key: Picture(VALUE, steered=True, legend=False) for key in AXES}
        for key, picture in self.pictures.items():
            picture.setAccessibleName(f"{name}: {AXES[key][1]} over {AXES[key][0]}")
        self._grid_widget = QWidget()
        self._grid = QGridLayout(self._grid_widget)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self._grid.setSpacing(3)
        for row, column, key in ((0, 0, "xy"), (0, 1, "yz"), (1, 0, "xz")):
            self._grid.addWidget(self.pictures[key], row, column)
        self._stack = QStackedWidget()
        self._stack.addWidget(self.solid)
        self._stack.addWidget(self._grid_widget)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self._stack)

    def set_volume(self, prepared: Prepared | None) -> None:
        """Show a volume from the next `show` on."""
        before, self.prepared = self.prepared, prepared
        if prepared is None:
            for picture in self.pictures.values():
                picture.set_shot(None)
            self.solid.show_volume(None, View(BEGIN))
        elif before is None or before.volume.shape != prepared.volume.shape:
            x, y, z = 2 * prepared.solid.half
            for index, share in ((0, 1.0), (1, min(1.5, max(0.3, float(z) / float(x))))):
                self._grid.setColumnStretch(index, round(100 * share))
            self._grid.setRowStretch(0, 100)
            self._grid.setRowStretch(1, round(100 * min(1.5, max(0.3, float(z) / float(y)))))

    def show_as(self, intent: VolumeIntent, turn: NDArray[np.float64], levels: Levels) -> None:
        """Show the volume as it is asked for."""
        prepared = self.prepared
        if prepared is None:
            return
        planes, rows, columns = prepared.volume.shape
        size = f"{columns} × {rows} × {planes} voxels"
        if intent.mode == MODES[0]:
            cross = (intent.z, intent.y, intent.x) if intent.cross else None
            self.solid.set_display(intent.display)
            view = View(turn, intent.by_depth, intent.box, cross, levels, f"{self.name}, {size}")
            self.solid.show_volume(prepared, view)
            self._stack.setCurrentIndex(0)
            return
        self._stack.setCurrentIndex(1)
        self.shown = sides(intent, prepared)
        x, y, z = prepared.solid.axes
        at = {"x": float(x[intent.x]), "y": float(y[intent.y]), "z": float(z[intent.z])}
        for key, side in self.shown.items():
            across, down = AXES[key]
            own = intent.own_scale and key == "xy" and intent.mode == MODES[1]
            rows, columns = (n * side.pixel for n in side.values.shape)
            frame = side.origin[0] - side.pixel / 2, side.origin[1] - side.pixel / 2, rows, columns
            cross = (_line(True, at[across], frame), _line(False, at[down], frame)) if intent.cross else ()
            shot = Shot(
                side.values,
                f"{self.short}{down} over {across}",
                name=f"volume_{key}",
                levels=None if own else levels,
                origin=side.origin,
                step=side.pixel,
                overlays=cross,
                pixel_um=side.pixel if prepared.solid.measured else None,
            )
            self.pictures[key].set_display(intent.display)
            self.pictures[key].set_shot(shot)


class VolumeView(QWidget):
    """Show a volume ``(Z, Y, X)``: turned in 3-D, sliced, or projected, and next to it a known one.

    Parameters
    ----------
    jobs
        Draw in the background; None: draw immediately.

    Signals
    -------
    moved(z, y, x)
        The cross is elsewhere.
    """

    moved = Signal(int, int, int)

    def __init__(self, jobs: Jobs | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.intent = VolumeIntent()
        self.turn = BEGIN
        self._volume: NDArray[Any] | None = None
        self._newest = Newest(jobs, f"volume {id(self)}")
        self._emptied = 0
        self.looks = VolumePanes("Volume", jobs, first=True), VolumePanes("Truth", jobs, first=False)
        self.solid, self.pictures = self.looks[0].solid, self.looks[0].pictures
        self.xy, self.xz, self.yz = self.pictures.values()
        share_contrast(*(p for look in self.looks for p in (look.solid, *look.pictures.values())))
        link(*(look.solid for look in self.looks))
        for key in AXES:
            link(*(look.pictures[key] for look in self.looks))
        for look in self.looks:
            self._watch(look)
        self._beside = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        self._beside.setSpacing(3)
        for look in self.looks:
            self._beside.addWidget(look, 1)
        self.contrasts = Contrast(self.solid), Contrast(self.xy)
        for contrast in self.contrasts:
            contrast.display_asked.connect(lambda changes: self._display(**changes))
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(5)
        outer.addLayout(self._controls())
        outer.addLayout(self._beside, 1)
        for contrast in self.contrasts:
            outer.addWidget(contrast)
        outer.addLayout(self._depth_row())
        self.apply_theme()

    # -- building --------------------------------------------------------------------------------------
    def _watch(self, look: VolumePanes) -> None:
        look.solid.turned.connect(self._turn)
        look.solid.begun_again.connect(self.show_all)
        look.solid.hovered.connect(lambda row, column, _: self._read(look, row, column))
        look.solid.picked.connect(lambda z, y, x: self.set_cross(z=z, y=y, x=x))
        for key, picture in look.pictures.items():
            picture.steered_to.connect(lambda row, column, key=key: self._steer(look, key, row, column))

    def _controls(self) -> QHBoxLayout:
        row = QHBoxLayout()
        row.setSpacing(4)
        self.modes = QButtonGroup(self)
        tips = (
            "The brightest value along each line of sight; drag to turn",
            "Slices through the cross",
            "The brightest voxel along each axis",
        )
        for k, (mode, tip) in enumerate(zip(MODES, tips, strict=True)):
            button = QPushButton(mode)
            button.setCheckable(True)
            button.setProperty("role", "segment")
            button.setToolTip(tip)
            self.modes.addButton(button, k)
            row.addWidget(button)
        self.modes.button(0).setChecked(True)
        self.modes.idClicked.connect(lambda k: self._change(mode=MODES[k]))
        row.addStretch()
        row.addWidget(self._overlay())
        return row

    def _overlay(self) -> QPushButton:
        self.overlay = QPushButton("Overlay")
        self.overlay.setToolTip("What is drawn, and how")
        menu = QMenu(self.overlay)
        menu.setToolTipsVisible(True)
        self.ticks: dict[str, QAction] = {}
        for key, words, tip in TICKS:
            tick = self.ticks[key] = menu.addAction(words)
            tick.setCheckable(True)
            tick.setChecked(getattr(self.intent, key))
            tick.setToolTip(tip)
            tick.toggled.connect(lambda on, key=key: self._change(**{key: on}))
        self.overlay.setMenu(menu)
        menu.addSeparator()
        self.moves: dict[str, QAction] = {}
        for words, tip, do in (
            ("Brightest voxel", "Put the cross on the brightest voxel", self.go_to_brightest),
            ("Reset view", "The first turn and zoom (Home)", self.show_all),
        ):
            move = self.moves[words] = menu.addAction(words)
            move.setToolTip(tip)
            move.triggered.connect(lambda _=False, do=do: do())
        return self.overlay

    def _depth_row(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("depth plane")
        self.slider.setToolTip("Depth plane of the cross")
        self.slider.valueChanged.connect(lambda z: self.set_cross(z=z))
        self.readout = ElidedLabel("–")
        self.readout.setProperty("role", "hint")
        row.addWidget(QLabel("z"))
        row.addWidget(self.slider, 2)
        row.addWidget(self.readout, 3)
        return row

    # -- content ---------------------------------------------------------------------------------------
    def set_volume(
        self,
        volume: NDArray[Any] | None,
        depths_um: NDArray[np.float64] | None = None,
        voxel_um: tuple[float, float] | None = None,
        truth: NDArray[Any] | None = None,
    ) -> None:
        """Show ``volume`` ``(Z, Y, X)``; cross, turn and zoom stay if they fit.

        Parameters
        ----------
        volume
            None: nothing.
        depths_um
            Depth of each plane; without it, or without the size of voxels, these are cubes.
        voxel_um
            Sides of a voxel (rows, columns).
        truth
            What it should be, where that is known.
        """
        self._volume = volume
        if volume is None:
            self._emptied += 1
            for look in self.looks:
                look.set_volume(None)
            self.readout.setText("–")
            return
        asked = self._emptied

        def work() -> list[Prepared]:
            return [prepare(one, depths_um, voxel_um) for one in (volume, truth) if one is not None]

        def take(found: list[Prepared]) -> None:
            if asked == self._emptied:  # else it is of a project that is no longer open
                self._take(found)

        self._newest.ask(work, take)

    def _take(self, found: list[Prepared]) -> None:
        before, shape = self.prepared, found[0].volume.shape
        first = before is None or before.volume.shape != shape
        for look, prepared in zip(self.looks, (*found, None), strict=False):
            look.set_volume(prepared)
        self.ticks["truth"].setEnabled(len(found) > 1)
        if first:
            self.slider.blockSignals(True)
            self.slider.setRange(0, shape[0] - 1)
            self.slider.setEnabled(shape[0] > 1)
            self.slider.blockSignals(False)
            z, y, x = found[0].brightest
            self.intent = replace(self.intent, z=z, y=y, x=x)
        self._show()
        if first:
            self.show_all()

    @property
    def volume(self) -> NDArray[Any] | None:
        """The volume that was asked for."""
        return self._volume

    @property
    def prepared(self) -> Prepared | None:
        """The volume that is shown."""
        return self.looks[0].prepared

    def set_cross(self, **place: Any) -> None:
        """Move the cross along any of ``z``, ``y``, ``x``."""
        if self.prepared is None:
            return
        moved = replace(self.intent, **place).clamped(self.prepared.volume.shape)
        changed = moved != self.intent
        self.intent = moved
        if changed:
            self._show()
            self.moved.emit(moved.z, moved.y, moved.x)

    def go_to_brightest(self) -> None:
        """Put the cross on the brightest voxel."""
        if self.prepared is not None:
            self.set_cross(**dict(zip("zyx", self.prepared.brightest, strict=True)))

    def show_all(self) -> None:
        """Show the first view: turn and zoom."""
        self.turn = BEGIN
        for look in self.looks:
            for picture in (look.solid, *look.pictures.values()):
                picture.show_all()
        self._show()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for look in self.looks:
            for picture in (look.solid, *look.pictures.values()):
                picture.apply_theme()
        for contrast in self.contrasts:
            contrast.apply_theme()
        self._show()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Put the truth where both have more room: on the right, or below."""
        super().resizeEvent(event)
        room = self._beside.geometry()
        direction = QBoxLayout.Direction
        self._beside.setDirection(direction.TopToBottom if room.height() > room.width() else direction.LeftToRight)

    # -- inside ----------------------------------------------------------------------------------------
    def _turn(self, across: float, down: float) -> None:
        self.turn = turned(self.turn, across, down)
        self._show()

    def _steer(self, look: VolumePanes, key: str, row: int, column: int) -> None:
        if look.prepared is None or key not in look.shown:
            return
        side, axes = look.shown[key], dict(zip("xyz", look.prepared.solid.axes, strict=True))
        across, down = AXES[key]
        at = {down: side.origin[0] + row * side.pixel, across: side.origin[1] + column * side.pixel}
        self.set_cross(**{axis: int(np.argmin(np.abs(axes[axis] - place))) for axis, place in at.items()})

    def _read(self, look: VolumePanes, row: int, column: int) -> None:
        """Say which voxel is behind the pointer, else where the cross is."""
        at = look.solid.voxel_at(row, column) or (self.intent.z, self.intent.y, self.intent.x)
        if look.prepared is not None:
            self.readout.setText(look.prepared.words_at(*at))

    def _change(self, **changes: Any) -> None:
        self.intent = replace(self.intent, **changes)
        self._show()

    def _display(self, **changes: Any) -> None:
        self._change(display=replace(self.intent.display, **changes))

    def _show(self) -> None:
        intent, solid = self.intent, self.intent.mode == MODES[0]
        self.contrasts[0].setVisible(solid)
        self.contrasts[1].setVisible(not solid)
        truth = self.looks[1].prepared
        self.looks[1].setVisible(truth is not None and intent.truth)
        if self.prepared is None:
            return
        known = [look.prepared.levels for look in self.looks if look.prepared is not None]
        levels = min(low for low, _ in known), max(high for _, high in known)
        for look in self.looks:
            look.show_as(intent, self.turn, levels)
        self.slider.blockSignals(True)
        self.slider.setValue(intent.z)
        self.slider.blockSignals(False)
        self.readout.setText(self.prepared.words_at(intent.z, intent.y, intent.x))


def _line(upright: bool, at: float, frame: tuple[float, float, float, float]) -> Outline:
    """Return a line through the middle of a column, or of a row, of a picture: first row, column, height, width."""
    row, column, height, width = frame
    ends = [(row, at), (row + height, at)] if upright else [(at, column), (at, column + width)]
    return Outline(np.array(ends), CUTOUT, closed=False, width=1)
