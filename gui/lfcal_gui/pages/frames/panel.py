"""Record > Folder: the frame with its cutout; findings, position, cutout and settings on the right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from html import escape
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
    QSlider,
    QStackedWidget,
    QWidget,
)

from lfcal.camera import Camera
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import DisplaySettings, FrameNumbers, Shot, cutout_of
from lfcal_gui.pages.frames._choices import FrameChoices
from lfcal_gui.pages.frames._import_dialog import ImportPreviews
from lfcal_gui.pages.frames.model import Loaded
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    Contrast,
    PeriodMap,
    Picture,
    WrappedLabel,
    button,
    card,
    column_area,
    column_of,
    inspector_width,
    line,
    name_controls,
    row_of,
    share_contrast,
    wrapped,
)

ONE = "Show the frame of the selected position"
THREE = "Show the first, middle and last frame. The image must be inside the cutout in all of them"
WHOLE = "Show the full frame; the view no longer follows the cutout"
FOLLOW = "Zoom to the cutout, and follow it as it moves with the point source"
LATTICE = (
    "Micro-image centres of the described camera, coloured by lens type. If the description "
    "is right, they coincide with the micro-images"
)
MAP, CROP = 112, 112
"""Heights of map and cutout in the inspector (px)."""


class FramesPanel(QWidget):
    """The page's widgets."""

    three_toggled = Signal(bool, arguments=["on"])
    """The user switched between one frame and the first, middle and last frame."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.choices = FrameChoices()
        self.view = Picture("sample value (counts)", jobs=jobs, legend=False)
        self.contrast = Contrast(self.view)
        self.contrast.display_asked.connect(lambda _: self.show_display(self.view.display))
        self.view.hovered.connect(self._hovered)
        self.crop = Picture("counts", legend=False)
        self._jobs = jobs
        share_contrast(self.view, self.crop)
        self.crop_words, self.map_words = wrapped("hint", " "), wrapped()
        self.map = PeriodMap()
        for side in ("left", "bottom"):  # their names would be cut in a low picture
            self.map.plot.getAxis(side).showLabel(False)
        self.map_words.hide()
        for picture, height in ((self.map, MAP), (self.crop, CROP)):
            picture.setFixedHeight(height)
        self.numbers = QLabel(textFormat=Qt.TextFormat.RichText)
        self._counted: FrameNumbers | None = None
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        self._window: tuple[int, int, int, int] | None = None
        self.pictures = QStackedWidget()
        self.pictures.addWidget(self.view)
        below = line(self.numbers, self.readout, stretch=1)
        row_of(
            column_of(self._bar(), self.pictures, self.contrast, below, spacing=2, stretch=1),
            self._inspector(),
            of=self,
            spacing=8,
            stretch=0,
        )

    @cached_property
    def three(self) -> ImportPreviews:
        """Pictures of the first, middle and last frame, which are created on demand."""
        made = ImportPreviews(self._jobs, legend=False)
        name_controls(made)
        share_contrast(self.view, self.crop, *made.views)
        self.pictures.addWidget(made)
        for view in made.views:
            view.set_display(self.view.display)
        return made

    # -- building --------------------------------------------------------------------------------------

    def _bar(self) -> QHBoxLayout:
        self.one_button = button("One frame", ONE, lambda: self.show_three(False))
        self.three_button = button("First, middle, last", THREE, lambda: self.show_three(True))
        for one in (self.one_button, self.three_button):
            one.setCheckable(True)
        self.one_button.setChecked(True)
        self.lattice_box = QCheckBox("Lattice")
        self.lattice_box.setToolTip(LATTICE)
        self.before_box = QCheckBox("As recorded")
        self.before_box.setToolTip("Show the frame as it was recorded, to see what the corrections do")
        whole, self.follow = button("Whole", WHOLE, self._show_whole), QPushButton("Follow")
        self.follow.setCheckable(True)
        self.follow.setToolTip(FOLLOW)
        self.follow.toggled.connect(lambda _: self._zoom_cutout())
        shown = (self.one_button, self.three_button, self.lattice_box, self.before_box)
        return line(*shown, "", whole, self.follow, stretch=len(shown))

    def _inspector(self) -> QScrollArea:
        found, within = card()
        self._found: tuple[str, str, str, Sequence[tuple[str, str, str]]] = ("", "", "", ())
        self.found = wrapped("")
        self.found.setTextFormat(Qt.TextFormat.RichText)
        within.addWidget(self.found)
        place, column = card()
        self.position_label = WrappedLabel(role="heading")
        column.addWidget(self.position_label)
        column.addLayout(self._plane_line())
        column.addWidget(self.map)
        column.addWidget(self.map_words)
        cut, column = card("Cutout")
        column.addWidget(self.crop)
        column.addWidget(self.crop_words)
        return column_area(inspector_width(0), found, place, cut, self.choices)

    def _plane_line(self) -> QHBoxLayout:
        self.plane_slider = QSlider(Qt.Orientation.Horizontal)
        self.plane_slider.setAccessibleName("Depth plane")
        self.plane_slider.setToolTip("Depth plane whose positions the map shows (page up, page down)")
        self.play_button = QPushButton("Play")
        self.play_button.setCheckable(True)
        self.play_button.setToolTip("Step through all positions. The image should move steadily, without jumps (Space)")
        self.play_button.toggled.connect(lambda on: self.play_button.setText("Stop" if on else "Play"))
        return line("Plane", self.plane_slider, self.play_button, stretch=1)

    # -- showing ---------------------------------------------------------------------------------------
    def show_three(self, on: bool) -> None:
        """Show first, middle and last frame, or the one of the position."""
        self.pictures.setCurrentWidget(self.three if on else self.view)
        self.one_button.setChecked(not on)
        self.three_button.setChecked(on)
        self.three_toggled.emit(on)

    def show_found(self, mark: str, head: str, words: str, facts: Sequence[tuple[str, str, str]]) -> None:
        """Show whether the frames can be used, and facts about them as rows of name, number and remark."""
        self._found = mark, head, words, facts
        self.found.setText(_found_words(*self._found))

    def set_planes(self, count: int) -> None:
        """Set the number of depth planes to choose from."""
        self.plane_slider.setRange(0, count - 1)
        self.plane_slider.setEnabled(count > 1)

    def show_position(self, z: int, y: int, x: int) -> None:
        """Show the selected position."""
        with QSignalBlocker(self.plane_slider):
            self.plane_slider.setValue(z)
        self.map.set_position(y, x)

    def show_map(self, there: NDArray[np.bool_], energy: NDArray[np.float64] | None = None, words: str = "") -> None:
        """Show which positions ``(ny, nx)`` of the plane have a frame, and the light of H assembled so far."""
        self.map.set_values(there.astype(float) if energy is None else energy, there.astype(int))
        self.map_words.setText(words)
        self.map_words.setVisible(bool(words))

    def show_reading(self, words: str) -> None:
        """Show in empty pictures what is being read."""
        for view in (self.view, self.crop):
            view.blank.wait(words)

    def show_missing(self, words: str, why: str = "No frame was recorded here.") -> None:
        """Show that there is no frame, and why."""
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
        self.view.set_shot(Shot(frame, name="frame", overlays=cutout, pixel_um=loaded.pixel_um))
        crop = None if loaded.crop is None else loaded.crop[0 if self.before_box.isChecked() else 1]
        words = (
            "The cutout leaves the frame." if crop is None else f"{crop.shape[0]} × {crop.shape[1]} px, as used for H"
        )
        self._show_crop(crop, words)

    def _show_crop(self, crop: NDArray[Any] | None, words: str) -> None:
        self.crop.set_shot(Shot(crop, name="cutout"))
        self.crop_words.setText(words)

    def show_display(self, display: DisplaySettings) -> None:
        """Set scaling and colours of all pictures."""
        for view in self.view.sharing:
            view.set_display(display)

    def show_overlays(self, camera: Camera, loaded: Loaded | None) -> None:
        """Show the lattice if chosen, and zoom to the cutout if the view follows it."""
        origin = (0, 0) if loaded is None else loaded.origin
        self.view.set_lattice(camera if self.lattice_box.isChecked() else None, origin)
        self._window = None if loaded is None else loaded.window
        self._zoom_cutout()

    def toggle_scale(self, scale: str) -> None:
        """Switch between ``scale`` and linear."""
        display = self.view.display
        self.show_display(replace(display, scale="linear" if display.scale == scale else scale))

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for widget in (*self.view.sharing, self.map, self.contrast):
            widget.apply_theme()
        self._count(self._counted)  # its colours are the theme's
        self.found.setText(_found_words(*self._found))

    def _zoom_cutout(self) -> None:
        if self.follow.isChecked() and self._window is not None:
            self.view.show_part(*self._window)

    def _show_whole(self) -> None:
        self.follow.setChecked(False)
        self.view.show_all()

    def _hovered(self, row: int, column: int, value: float) -> None:
        self.readout.setText(" " if row < 0 else f"row {row}, column {column}: {value:.5g} counts")


def _found_words(mark: str, head: str, words: str, facts: Sequence[tuple[str, str, str]]) -> str:
    theme = current_theme()
    colour = {"good": theme.good, "fair": theme.fair, "bad": theme.bad}.get(mark, theme.text)
    sign = {"good": "✓ ", "fair": "▲ ", "bad": "▲ "}.get(mark, "")
    muted = f"style='color:{theme.muted}'"
    rows = "".join(
        f"<tr><td {muted}><nobr>{name}&nbsp;</nobr></td>"
        + (
            f"<td align='right'><nobr><b>{escape(number)}</b>&nbsp;</nobr></td><td {muted}><nobr>"
            if number
            else "<td colspan='2'>"
        )
        + f"{escape(remark)}</td></tr>"
        for name, number, remark in facts
    )
    return (
        f"<p style='color:{colour}; margin-bottom:2px'><b>{sign}{escape(head)}</b></p>"
        f"<p style='margin-top:2px'>{escape(words)}</p>"
        f"<table cellspacing='0'>{rows}</table>"
    )


def _number_words(numbers: FrameNumbers) -> str:
    theme = current_theme()
    colour = theme.bad if numbers.saturated else theme.text
    saturated = "unknown" if numbers.saturated is None else f"{numbers.saturated}"
    return (
        f"as recorded: {numbers.low:g} to <b>{numbers.high:g}</b> counts, mean {numbers.mean:.1f}, "
        f"<span style='color:{colour}'>saturated pixels: <b>{saturated}</b></span>"
    )
