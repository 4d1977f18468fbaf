"""PSF: controls on the left, the picture and its linked one, profile and aperture, the strip of planes below."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QSlider,
    QSplitter,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import COLOUR_MAPS, DisplaySettings
from lfcal_gui.pages.psf._depth_strip import Apertures, DepthStrip, legend_words, outline_tones
from lfcal_gui.pages.psf.model import PlaneData, PSFIntent, PSFPicture, pixel_words
from lfcal_gui.pages.psf.model_aperture import aperture_words
from lfcal_gui.widgets import (
    LINES,
    ImageView,
    LinePlot,
    PeriodMap,
    card,
    choice_box,
    line_px,
    link_views,
    shown_tone,
    split,
)

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture

__all__ = ["PSFPanel"]

SHOWN = (("measured", "measured"), ("reference", "reference"), ("difference", "difference"))
SCALES = (("linear", "linear"), ("log", "log, 4 decades"), ("gamma", "gamma 0.5"))
HOVER = "Hover a pixel: the pattern that it belongs to. Click: hold it."
Levels = tuple[float, float] | None

COLOURS = "Colours of intensity; equal steps look equally large in all of them, grey prints best"


class PSFPanel(QWidget):
    """The page's widgets.

    Signals
    -------
    asked(changes)
        Entries of `lfcal_gui.pages.psf.model.PSFIntent` that are to change.
    display_asked(changes)
        Entries of `lfcal_gui.models.display.DisplaySettings` that are to change.
    own_scale_toggled()
        Each picture is to fill the scale, or all are to share one.
    hovered(row, column, value), clicked(row, column)
        The pointer in the main picture; row -1: outside.
    """

    asked = Signal(dict)
    display_asked = Signal(dict)
    own_scale_toggled = Signal()
    hovered = Signal(int, int, float)
    clicked = Signal(int, int)

    def __init__(self) -> None:
        super().__init__()
        self._unit = ""
        self._make_pictures()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(8)
        # pictures have a grid of their own: the height of the controls is not theirs
        grid.addWidget(self._controls(), 0, 0)
        grid.addWidget(self._pictures(), 0, 1)
        grid.addLayout(self._planes(), 1, 0, 1, 2)
        grid.setRowStretch(0, 1)
        grid.setColumnStretch(1, 1)
        self._colour()

    def _pictures(self) -> QSplitter:
        pictures = (self.main_title, self.main_view), (self.linked_title, self.linked_view)
        above = split(*(_titled(title, view) for title, view in pictures), sizes=(1, 1))
        self.profile_title = QLabel()
        below = split(_titled(self.profile_title, self.profile), self._aperture_card(), sizes=(1, 1))
        # what they would like to have takes nothing from H and HT
        below.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Ignored)
        self.split = split(above, below, sizes=(3, 2), vertical=True)
        return self.split

    # -- building --------------------------------------------------------------------------------------
    def _planes(self) -> QHBoxLayout:
        """Return the apertures of all planes, with what their lines mean."""
        side = QVBoxLayout()
        self.legend, larger = QLabel(), QPushButton("Larger …")
        self.legend.setToolTip("Outline fitted to the depth-plane sum, and the one that the camera lets expect there")
        larger.setToolTip("The apertures of all planes in a window of their own, large enough to compare their blades")
        larger.clicked.connect(lambda: self.show_apertures())
        side.addWidget(self.legend)
        side.addWidget(larger)
        side.addStretch()
        row = QHBoxLayout()
        row.addWidget(self.strip, 1)
        row.addLayout(side)
        return row

    def _make_pictures(self) -> None:
        self.main_view, self.linked_view, self.sum_view = ImageView(), ImageView(), ImageView()
        link_views((self.main_view, self.linked_view))
        # not empty: words are a pixel higher, and all pictures would be drawn again for it
        self.main_title, self.linked_title = QLabel("H"), QLabel("HT")
        self.main_view.hovered.connect(self.hovered.emit)
        self.main_view.clicked.connect(self.clicked.emit)
        self.map = PeriodMap()
        self.map.chosen.connect(lambda y, x: self.asked.emit({"y": y, "x": x}))
        self.strip = DepthStrip(64)
        self.strip.chosen.connect(lambda z: self.asked.emit({"z": z}))
        self.apertures: Apertures | None = None
        self.profile = LinePlot("pixel from the cutout's centre (px)", "intensity (counts)")
        self.outline = pg.PlotCurveItem()
        self.sum_view.add_overlay(self.outline)
        self.expected = pg.PlotCurveItem()
        self.sum_view.add_overlay(self.expected)
        self.aperture_text = QLabel()
        self.aperture_text.setTextFormat(Qt.TextFormat.RichText)
        self.aperture_text.setWordWrap(True)

    def _controls(self) -> QWidget:
        panel, column = card()
        panel.setFixedWidth(244)
        column.setSpacing(7)
        column.addLayout(self._transposition())
        self.plane_label = QLabel()
        self.plane_label.setWordWrap(True)
        self.plane_slider = QSlider(Qt.Orientation.Horizontal)
        self.plane_slider.setAccessibleName("depth plane")
        self.plane_slider.setToolTip("Depth plane that all pictures show (page up, page down)")
        self.plane_slider.valueChanged.connect(lambda z: self.asked.emit({"z": z}))
        self.position_label = QLabel()
        for widget in (self.plane_label, self.plane_slider, self.position_label):
            column.addWidget(widget)
        column.addWidget(self.map, 1)
        self._add_choices(column)
        self.own_scale = QCheckBox("Each picture fills the scale")
        self.own_scale.setToolTip("Off: all positions of a plane share one scale, so that they can be compared")
        self.own_scale.toggled.connect(lambda _: self.own_scale_toggled.emit())
        column.addWidget(self.own_scale)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        self.readout.setWordWrap(True)
        self.readout.setMinimumHeight(34)
        column.addWidget(self.readout)
        return panel

    def _transposition(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.h_button, self.ht_button = QPushButton("H"), QPushButton("HT")
        for button, transposed, tip in (
            (self.h_button, False, "Pattern on the sensor of one source position (T)"),
            (self.ht_button, True, "Pattern in the volume seen by one pixel: the transposed matrix (T)"),
        ):
            button.setCheckable(True)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, t=transposed: self.asked.emit({"transposed": t}))
            row.addWidget(button)
        return row

    def _add_choices(self, column: QVBoxLayout) -> None:
        self.show_box = choice_box(
            SHOWN, "Measured H, the reference, or what is left of H less the reference at equal energy"
        )
        self.scale_box = choice_box(SCALES, "Gamma and log bring out faint light beside the spots (L: log, G: gamma)")
        self.map_box = choice_box([(name, name) for name in COLOUR_MAPS], COLOURS)
        self.show_box.currentIndexChanged.connect(lambda _: self.asked.emit({"show": self.show_box.currentData()}))
        self.scale_box.currentIndexChanged.connect(
            lambda _: self.display_asked.emit({"scale": self.scale_box.currentData()})
        )
        self.map_box.currentIndexChanged.connect(
            lambda _: self.display_asked.emit({"colour_map": self.map_box.currentData()})
        )
        for text, box in (("Show", self.show_box), ("Scaling", self.scale_box), ("Colours", self.map_box)):
            box.setAccessibleName(text)
            line = QHBoxLayout()
            line.addWidget(QLabel(text))
            line.addWidget(box, 1)
            column.addLayout(line)

    def _aperture_card(self) -> QWidget:
        panel, column = card("Aperture from the depth-plane sum")
        row = QHBoxLayout()
        self.sum_view.graphics.removeItem(self.sum_view.bar)  # of its shape all is said; it takes half of the room
        for side in ("left", "bottom"):  # the numbers beside it say how large it is
            self.sum_view.plot.hideAxis(side)
        row.addWidget(self.sum_view, 1)
        self.aperture_text.setAlignment(Qt.AlignmentFlag.AlignVCenter)
        # in a scroll area: a label that wraps would ask the grid for height, and the pictures above would shrink
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(self.aperture_text)
        self.aperture_text.setAutoFillBackground(False)
        area.setFixedWidth(252)
        row.addWidget(area)
        column.addLayout(row, 1)
        return panel

    # -- showing ---------------------------------------------------------------------------------------
    def show_matrix(self, depths: NDArray[np.float64], unit: str, *, reference: bool) -> None:
        """Offer the planes of an H with values in ``unit``; ``reference``: there is one.

        ``depths`` are in µm, not-a-number where H states none.
        """
        self.plane_slider.setRange(0, len(depths) - 1)
        self.plane_slider.setEnabled(len(depths) > 1)
        self._each_strip(lambda strip: strip.set_planes(depths))
        self.show_box.setEnabled(reference)
        self.sum_view.set_value_label(unit)
        self._show_unit(unit)

    def _show_unit(self, unit: str) -> None:
        """Name the unit of the pictures and of the profile; their axes are slow to draw."""
        if unit != self._unit:
            self._unit = unit
            for view in (self.main_view, self.linked_view):
                view.set_value_label(unit)
            self.profile.set_labels("pixel from the cutout's centre (px)", unit)

    def show_intent(self, intent: PSFIntent, plane_words: str, position_words: str) -> None:
        """Show what was asked for."""
        self.plane_label.setText(plane_words)
        self.position_label.setText(position_words)
        for widget, show in (
            (self.plane_slider, lambda: self.plane_slider.setValue(intent.z)),
            (self.show_box, lambda: self.show_box.setCurrentIndex(self.show_box.findData(intent.show))),
        ):
            blocker = QSignalBlocker(widget)
            show()
            blocker.unblock()
        self._each_strip(lambda strip: strip.set_current(intent.z))
        self.map.set_position(intent.y, intent.x)
        self.h_button.setChecked(not intent.transposed)
        self.ht_button.setChecked(intent.transposed)

    def show_plane(self, loaded: PlaneData, recorded: NDArray[Any]) -> None:
        """Show what holds for a whole plane: energy of each position and whether it was recorded, depth sum."""
        self.map.set_values(loaded.energy, recorded)
        nt, ns = loaded.depth_sum.shape
        self.sum_view.set_image(loaded.depth_sum, name="depth_sum", origin=(-(nt // 2), -(ns // 2)))
        self.outline.setData([], [])
        self.expected.setData([], [])
        self.aperture_text.setText("fitting the aperture …")

    def show_reading(self, words: str) -> None:
        """Say in the pictures that are empty what is read for them."""
        self.readout.setText(words)
        for view in (self.main_view, self.linked_view, self.sum_view, self.profile):
            view.blank.wait(words)

    def show_no_plane(self, words: str) -> None:
        """Show no picture, and why: a plane that cannot be read must not have those of another."""
        for view in (self.main_view, self.linked_view, self.sum_view):
            view.blank.words = "This plane cannot be read."
            view.set_image(None)
        self.map.clear()
        self.profile.clear()
        for curve in (self.outline, self.expected):
            curve.setData([], [])
        self.aperture_text.setText("")
        self.readout.setText(words)

    def show_picture(self, picture: PSFPicture, intent: PSFIntent, levels: Levels, unit: str) -> None:
        """Show the main and the linked picture with values in ``unit``; ``levels`` None: each fills the scale."""
        self._show_unit(unit)
        for view, image, cursor in (
            (self.main_view, picture.main, picture.main_cursor),
            (self.linked_view, picture.linked, picture.linked_cursor),
        ):
            if picture.signed != view.signed:
                view.set_signed(picture.signed, intent.display)
            view.set_image(image, name="psf", levels=levels)
            view.set_cursor(*(cursor or (None, None)))
        words = HOVER if intent.pixel is None else pixel_words(picture, intent.pixel, unit)
        self.readout.setText(words)
        self.main_title.setText(picture.main_title)
        self.linked_title.setText(picture.linked_title)
        self._show_profile(picture.main, intent, levels)

    def _show_profile(self, image: NDArray[Any], intent: PSFIntent, levels: Levels) -> None:
        ct, cs = (n // 2 for n in image.shape)
        t, s = intent.pixel or (ct, cs)
        if levels is not None:
            self.profile.plot.setYRange(*levels, padding=0.02)
        else:
            self.profile.plot.enableAutoRange("y")
        self.profile.set_curve("along the row", np.arange(image.shape[1]) - cs, image[t])
        self.profile.set_curve("along the column", np.arange(image.shape[0]) - ct, image[:, s])

    def show_aperture(self, aperture: Aperture, expected: Aperture | None, cutout: tuple[int, int]) -> None:
        """Show the fitted aperture over the depth sum, dashed the one that the camera lets expect, and its numbers."""
        for curve, shown in ((self.outline, aperture), (self.expected, expected)):
            outline = shown.outline() if shown is not None and shown.seen else np.empty((0, 2))
            curve.setData(outline[:, 1] - cutout[1] // 2, outline[:, 0] - cutout[0] // 2)
        self.aperture_text.setText(aperture_words(aperture, expected))

    def show_tile(self, z: int, **known: Any) -> None:
        """Show more of plane ``z`` among all planes: fields of `lfcal_gui.pages.psf._depth_strip.PlaneTile`."""
        self._each_strip(lambda strip: strip.set_tile(z, **known))

    def _each_strip(self, do: Callable[[DepthStrip], object]) -> None:
        for strip in (self.strip, *(() if self.apertures is None else (self.apertures.grid,))):
            do(strip)

    def show_apertures(self) -> Apertures:
        """Show the apertures of all planes large."""
        if self.apertures is None:
            self.apertures = Apertures(self.window())
            self.apertures.chosen.connect(lambda z: self.asked.emit({"z": z}))
        self.apertures.grid.show_tiles(self.strip.tiles)
        self.apertures.grid.set_current(self.strip.currentRow())
        self.apertures.show()
        return self.apertures

    def set_display(self, display: DisplaySettings, *, sum_only: bool) -> None:
        """Use scaling and colours; ``sum_only``: the pictures show a difference, which has colours of its own."""
        for view in (self.sum_view,) if sum_only else (self.main_view, self.linked_view, self.sum_view):
            view.set_display(display)

    def toggle_scale(self, scale: str) -> None:
        """Change between ``scale`` and linear."""
        chosen = "linear" if self.scale_box.currentData() == scale else scale
        self.scale_box.setCurrentIndex(self.scale_box.findData(chosen))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (self.main_view, self.linked_view, self.sum_view, self.map, self.profile, self.strip):
            widget.apply_theme()
        if self.apertures is not None:
            self.apertures.apply_theme()
        self._colour()

    def _colour(self) -> None:
        """Give outlines, and the words about lines, the colours of the theme in use."""
        fitted, expected = outline_tones()
        self.outline.setPen(pg.mkPen(fitted, width=line_px(2)))
        self.expected.setPen(pg.mkPen(expected, width=line_px(1), style=Qt.PenStyle.DashLine))
        self.legend.setText(legend_words())
        self.profile_title.setText(_profile_words())


def _profile_words() -> str:
    """Return the title of the card with the profiles: a legend would lie over its curves."""
    tones = zip(LINES, ("row", "column"), strict=False)
    named = (f"<span style='color:{shown_tone(tone)}'>━</span> {what}" for tone, what in tones)
    return f"Profiles at the pixel: {', '.join(named)}"


def _titled(title: QLabel, content: QWidget) -> QFrame:
    frame, column = card(title)
    title.setSizePolicy(
        QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred
    )  # a long title must not widen a column
    column.addWidget(content, 1)
    return frame
