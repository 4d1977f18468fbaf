"""Frames: positions and corrections on the left, the frame on the right."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from lfcal.camera import Camera
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import DisplaySettings, FrameNumbers, Shot, cutout_of
from lfcal_gui.pages.frames._choices import FrameChoices
from lfcal_gui.pages.frames.model_frame import Loaded
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    SCALINGS,
    Contrast,
    PeriodMap,
    Picture,
    WrappedLabel,
    card,
    choice_box,
    heading,
    line,
    share_contrast,
    split,
)

__all__ = ["FramesPanel"]

HEIGHTS = ((136, 230), (110, 290))
"""Least and most height of map and cutout (px): what is low enough needs no scroll bar."""

LEFT = 320
"""Least width of the column of positions (px)."""


class FramesPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    plane_asked(z), position_asked(y, x)
        Show another depth plane; another position of the same plane.
    play_toggled(on)
        Step through the positions, or stop.
    before_toggled(on), lattice_toggled(on)
        Show the frame as it was recorded; show the lattice.
    """

    plane_asked = Signal(int)
    position_asked = Signal(int, int)
    play_toggled = Signal(bool)
    before_toggled = Signal(bool)
    lattice_toggled = Signal(bool)

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.choices = FrameChoices()
        self.view = Picture("sample value (counts)", jobs=jobs, legend=False)
        self.contrast = Contrast(self.view)
        self.view.hovered.connect(self._hovered)
        self.crop = Picture("counts", legend=False)
        share_contrast(self.view, self.crop)
        self.crop_words = QLabel(" ")
        self.crop_words.setProperty("role", "hint")
        self.crop_words.setWordWrap(True)
        self.map = PeriodMap()
        self.map.chosen.connect(self.position_asked.emit)
        self.map_words = QLabel("")
        self.map_words.setProperty("role", "hint")
        self.map_words.setWordWrap(True)
        self.map_words.hide()
        for picture, (least, most) in zip((self.map, self.crop), HEIGHTS, strict=True):
            picture.setMinimumHeight(least)
            picture.setMaximumHeight(most)
            # what they would like to have makes no scroll bar
            picture.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Ignored)
        self.numbers = QLabel()
        self.numbers.setTextFormat(Qt.TextFormat.RichText)
        self._counted: FrameNumbers | None = None
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        self._window: tuple[int, int, int, int] | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        column = QVBoxLayout()
        column.addLayout(self._bar())
        column.addWidget(self.view, 1)
        column.addWidget(self.contrast)
        column.addLayout(line(self.numbers, self.readout, stretch=1))
        self.split = split(self._left(), column, sizes=(LEFT, 960), fixed=1)
        row.addWidget(self.split)

    # -- building --------------------------------------------------------------------------------------
    def _bar(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.lattice_box = QCheckBox("Lattice")
        self.lattice_box.setToolTip(
            "Micro-image centres of the described camera, coloured by lens type; they lie on the images if it is right"
        )
        self.before_box = QCheckBox("Before correction")
        self.before_box.setToolTip("Show the frame as it was recorded, to see what the corrections do")
        self.lattice_box.toggled.connect(self.lattice_toggled.emit)
        self.before_box.toggled.connect(self.before_toggled.emit)
        self.scale_box = choice_box(SCALINGS, "Gamma and log bring out faint light near the spot (L: log, G: gamma)")
        self.scale_box.setAccessibleName("scaling of colours")
        self.scale_box.currentIndexChanged.connect(
            lambda _: self._set_display(DisplaySettings(scale=self.scale_box.currentData()))
        )
        whole, self.follow = QPushButton("Whole frame"), QPushButton("Follow cutout")
        whole.setToolTip("See where in the frame the image lies; the cutout is no longer followed")
        self.follow.setCheckable(True)
        self.follow.setToolTip("Zoom to the cutout, and keep it in view as it moves along with the point")
        whole.clicked.connect(self._show_whole)
        self.follow.toggled.connect(lambda _: self._zoom_cutout())
        for widget in (self.lattice_box, self.before_box, self.scale_box):
            row.addWidget(widget)
        row.addStretch()
        row.addWidget(whole)
        row.addWidget(self.follow)
        return row

    def _left(self) -> QScrollArea:
        panel, column = card()
        self.position_label = WrappedLabel()
        self.position_label.setProperty("role", "heading")
        column.addWidget(self.position_label)
        column.addLayout(self._plane_line())
        column.addWidget(self.map, 4)
        column.addWidget(self.map_words)
        column.addWidget(heading("Cutout"))
        column.addWidget(self.crop, 5)
        column.addWidget(self.crop_words)
        column.addWidget(self.choices)
        column.addStretch()
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(panel)
        area.setMinimumWidth(LEFT)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        return area

    def _plane_line(self) -> QHBoxLayout:
        self.plane_slider = QSlider(Qt.Orientation.Horizontal)
        self.plane_slider.setAccessibleName("depth plane")
        self.plane_slider.setToolTip("Depth plane whose positions the map shows (page up, page down)")
        self.plane_slider.valueChanged.connect(self.plane_asked.emit)
        self.play_button = QPushButton("Play")
        self.play_button.setCheckable(True)
        self.play_button.setToolTip("Step through all positions: the image has to move steadily, without jumps (space)")
        self.play_button.toggled.connect(self._play)
        row = QHBoxLayout()
        row.addWidget(QLabel("Plane"))
        row.addWidget(self.plane_slider, 1)
        row.addWidget(self.play_button)
        return row

    # -- showing ---------------------------------------------------------------------------------------
    def set_planes(self, count: int) -> None:
        """Offer so many depth planes."""
        self.plane_slider.setRange(0, count - 1)
        self.plane_slider.setEnabled(count > 1)

    def show_position(self, z: int, y: int, x: int) -> None:
        """Show which position is looked at."""
        blocker = QSignalBlocker(self.plane_slider)
        self.plane_slider.setValue(z)
        blocker.unblock()
        self.map.set_position(y, x)

    def show_map(self, there: NDArray[np.bool_], energy: NDArray[np.float64] | None = None, words: str = "") -> None:
        """Show which positions ``(ny, nx)`` of the plane have a frame, and what light H has of them so far."""
        self.map.set_values(there.astype(float) if energy is None else energy, there.astype(int))
        self.map_words.setText(words)
        self.map_words.setVisible(bool(words))

    def show_reading(self, words: str) -> None:
        """Say in the pictures that are empty what is read for them."""
        for view in (self.view, self.crop):
            view.blank.wait(words)

    def show_missing(self, words: str, why: str = "No frame was recorded here.") -> None:
        """Say that there is no frame, and in the pictures why."""
        self.position_label.setText(words)
        self.view.set_shot(None)
        self._window = None
        self._count(None)
        self._show_crop(None, "no frame")
        for blank in (self.view.blank, self.crop.blank):
            blank.words = why

    def show_frame(self, loaded: Loaded) -> None:
        """Show a frame with its numbers."""
        position = loaded.position
        self.position_label.setText(f"{loaded.label}\nz {position.z}, y {position.y}, x {position.x}")
        self._count(loaded.numbers)
        self.show_pixels(loaded)

    def _count(self, numbers: FrameNumbers | None) -> None:
        self._counted = numbers
        self.numbers.setText("" if numbers is None else _number_words(numbers))

    def show_pixels(self, loaded: Loaded) -> None:
        """Show the frame before or after its correction, as chosen."""
        frame = loaded.raw if self.before_box.isChecked() else loaded.fixed
        row, column, rows, columns = loaded.window
        cutout = cutout_of(row, column, (rows, columns), loaded.point)
        self.view.set_shot(Shot(frame, name="frame", overlays=cutout))
        crop = None if loaded.crop is None else loaded.crop[0 if self.before_box.isChecked() else 1]
        words = "It leaves the frame." if crop is None else f"{crop.shape[0]} × {crop.shape[1]} px, as it goes into H"
        self._show_crop(crop, words)

    def _show_crop(self, crop: NDArray[Any] | None, words: str) -> None:
        self.crop.set_shot(Shot(crop, name="cutout"))
        self.crop_words.setText(words)

    def _set_display(self, display: DisplaySettings) -> None:
        self.view.set_display(display)
        self.crop.set_display(display)

    def show_overlays(self, camera: Camera, loaded: Loaded | None) -> None:
        """Show lattice, if chosen, and cutout."""
        origin = (0, 0) if loaded is None else loaded.origin
        self.view.set_lattice(camera if self.lattice_box.isChecked() else None, origin)
        self._window = None if loaded is None else loaded.window
        self._zoom_cutout()

    def toggle_scale(self, scale: str) -> None:
        """Change between ``scale`` and linear."""
        chosen = "linear" if self.scale_box.currentData() == scale else scale
        self.scale_box.setCurrentIndex(self.scale_box.findData(chosen))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.view, self.crop, self.map, self.contrast):
            widget.apply_theme()
        self._count(self._counted)  # its colours are the theme's

    def _play(self, on: bool) -> None:
        self.play_button.setText("Stop" if on else "Play")
        self.play_toggled.emit(on)

    def _zoom_cutout(self) -> None:
        """Keep the cutout in view, where that is chosen."""
        if self.follow.isChecked() and self._window is not None:
            self.view.show_part(*self._window)

    def _show_whole(self) -> None:
        self.follow.setChecked(False)
        self.view.show_all()

    def _hovered(self, row: int, column: int, value: float) -> None:
        self.readout.setText(" " if row < 0 else f"row {row}, column {column}: {value:.5g} counts")


def _number_words(numbers: FrameNumbers) -> str:
    theme = current_theme()
    colour = theme.bad if numbers.saturated else theme.text
    saturated = "unknown" if numbers.saturated is None else f"{numbers.saturated}"
    return (
        f"as recorded: {numbers.low:g} to <b>{numbers.high:g}</b> counts, mean {numbers.mean:.1f}, "
        f"<span style='color:{colour}'>saturated pixels: <b>{saturated}</b></span>"
    )
