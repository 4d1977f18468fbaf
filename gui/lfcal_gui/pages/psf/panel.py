"""PSF: H and HT with their contrast and the strip of planes; aperture, position and profiles on the right."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import (
    QCheckBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import DisplaySettings, Outline, Shot
from lfcal_gui.pages.psf._apertures import Apertures, tip_of
from lfcal_gui.pages.psf.model import PlaneData, PSFIntent, PSFPicture, pixel_words
from lfcal_gui.pages.psf.model_aperture import aperture_words
from lfcal_gui.widgets import (
    LINES,
    Contrast,
    ElidedLabel,
    Folded,
    LinePlot,
    PeriodMap,
    Picture,
    Strip,
    VerdictCard,
    card,
    choice_box,
    column_area,
    heading,
    legend_words,
    line,
    link,
    outline_tones,
    share_contrast,
    shown_tone,
    split,
)

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture

__all__ = ["PSFPanel"]

SHOWN = (("measured", "measured"), ("reference", "reference"), ("difference", "difference"))
HOVER = "Hover a pixel: the pattern that it belongs to. Click: hold it."
Levels = tuple[float, float] | None

NO_LINE = np.empty((0, 2))

VIEWS = (
    ("H", {"view": "one", "transposed": False}, "Pattern on the sensor of one source position (T)"),
    ("HT", {"view": "one", "transposed": True}, "Pattern in the volume seen by one pixel: the transposed matrix (T)"),
    ("Both", {"view": "both"}, "H, and HT of the pixel under the pointer"),
    ("Sum", {"view": "sum"}, "Depth-plane sum: the aperture as seen from this depth"),
)

INSPECTOR, SUM, MAP, PROFILE = 304, 170, 150, 150
"""Width of what stands right of the pictures, and heights in it (px)."""

LINES_OF_APERTURE = 6
"""Least height of the numbers of an aperture, in lines."""


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
        self._unit, self._pixel_um = "", None
        self._display = DisplaySettings()
        self._outlines: tuple[NDArray[np.float64], NDArray[np.float64]] = (NO_LINE, NO_LINE)
        self.apertures: Apertures | None = None
        self._make_pictures()
        left = QVBoxLayout()
        left.setSpacing(2)
        left.addLayout(self._view_bar())
        left.addWidget(self.split, 1)
        left.addWidget(self.contrast)
        left.addWidget(self.strip)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addLayout(left, 1)
        row.addWidget(self._inspector())
        self._colour()
        self._show_view(PSFIntent())

    # -- building --------------------------------------------------------------------------------------
    def _make_pictures(self) -> None:
        self.main_view, self.linked_view, self.sum_view = (Picture(legend=False) for _ in range(3))
        link(self.main_view, self.linked_view)
        share_contrast(self.main_view, self.linked_view)
        self.main_view.hovered.connect(self.hovered.emit)
        self.main_view.clicked.connect(self.clicked.emit)
        self.split = split(self.main_view, self.linked_view, sizes=(1, 1))
        self.contrast = Contrast(self.main_view)
        self.contrast.display_asked.connect(self.display_asked.emit)
        self.strip = Strip(tip_of, 64)
        self.strip.chosen.connect(lambda z: self.asked.emit({"z": z}))

    def _view_bar(self) -> QHBoxLayout:
        self.view_buttons: dict[str, QPushButton] = {}
        for title, changes, tip in VIEWS:
            button = QPushButton(title)
            button.setCheckable(True)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, changes=changes: self.asked.emit(dict(changes)))
            self.view_buttons[title] = button
        self.show_box = choice_box(
            SHOWN, "Measured H, the reference, or what is left of H less the reference at equal energy"
        )
        self.show_box.setAccessibleName("Show")
        self.show_box.currentIndexChanged.connect(lambda _: self.asked.emit({"show": self.show_box.currentData()}))
        self.readout = ElidedLabel()
        self.readout.setProperty("role", "hint")
        self.own_scale = QCheckBox("Own scale")
        self.own_scale.setToolTip("Each picture fills the colours; off: all positions of a plane share one scale")
        self.own_scale.toggled.connect(lambda _: self.own_scale_toggled.emit())
        parts = *self.view_buttons.values(), self.show_box, self.readout, self.own_scale
        return line(*parts, stretch=len(VIEWS) + 1)

    def _inspector(self) -> QWidget:
        self.place_label = QLabel()
        self.place_label.setWordWrap(True)
        self.map = PeriodMap()
        self.map.setFixedHeight(MAP)
        self.map.chosen.connect(lambda y, x: self.asked.emit({"y": y, "x": x}))
        place, column = card("Position")
        column.addWidget(self.place_label)
        column.addWidget(self.map)
        self.profile = LinePlot("pixel from the cutout's centre (px)", "intensity (counts)")
        self.profile.setFixedHeight(PROFILE)
        self.profile_title = QLabel()
        profiles = Folded("Profiles", "Values along the row and the column of the pixel that is pointed at")
        profiles.column.addWidget(self.profile_title)
        profiles.column.addWidget(self.profile)
        self.verdict = VerdictCard("All checks of H: failed ones first, with what each means and what to do")
        return column_area(INSPECTOR, self.verdict, self._aperture_card(), place, profiles)

    def _aperture_card(self) -> QWidget:
        panel, column = card()
        self.legend, larger = QLabel(), QPushButton("Larger …")
        self.legend.setToolTip("Outline fitted to the depth-plane sum, and the one that the camera lets expect there")
        larger.setToolTip("The apertures of all planes in a separate window, large enough to compare their blades")
        larger.clicked.connect(lambda: self.show_apertures())
        self.aperture_text = QLabel()
        self.aperture_text.setTextFormat(Qt.TextFormat.RichText)
        self.aperture_text.setWordWrap(True)
        self.aperture_text.setAlignment(Qt.AlignmentFlag.AlignTop)
        # what is below does not move when the aperture is known
        self.aperture_text.setMinimumHeight(LINES_OF_APERTURE * self.aperture_text.fontMetrics().height())
        self.sum_place = QWidget()
        inside = QVBoxLayout(self.sum_place)
        inside.setContentsMargins(0, 0, 0, 0)
        inside.addWidget(self.sum_view)
        self.sum_place.setFixedHeight(SUM)
        column.addLayout(line(heading("Aperture"), self.legend, larger, stretch=1))
        column.addWidget(self.sum_place)
        column.addWidget(self.aperture_text)
        return panel

    # -- showing ---------------------------------------------------------------------------------------
    def show_matrix(self, depths: NDArray[np.float64], unit: str, pixel_um: float | None, *, reference: bool) -> None:
        """Offer the planes of an H with values in ``unit``; ``reference``: there is one.

        ``depths`` are in µm, not-a-number where H states none; ``pixel_um`` is that of the sensor, where it is known.
        """
        self._pixel_um = pixel_um
        self._each_strip(lambda strip: strip.set_planes(depths))
        self.show_box.setVisible(reference)
        self._show_unit(unit)

    def _show_unit(self, unit: str) -> None:
        """Name the unit of the profile, whose axes are slow to draw."""
        if unit != self._unit:
            self._unit = unit
            self.profile.set_labels("pixel from the cutout's centre (px)", unit)

    def show_intent(self, intent: PSFIntent, plane_words: str, position_words: str) -> None:
        """Show what was asked for."""
        self.place_label.setText(f"{plane_words}<br>{position_words}")
        blocker = QSignalBlocker(self.show_box)
        self.show_box.setCurrentIndex(self.show_box.findData(intent.show))
        blocker.unblock()
        self._each_strip(lambda strip: strip.set_current(intent.z))
        self.map.set_position(intent.y, intent.x)
        self._show_view(intent)

    def _show_view(self, intent: PSFIntent) -> None:
        """Show H, HT, both, or the depth-plane sum instead of them."""
        for title, changes, _ in VIEWS:
            self.view_buttons[title].setChecked(all(getattr(intent, key) == one for key, one in changes.items()))
        large = intent.view == "sum"
        if large is not (self.sum_view.parentWidget() is self.split):
            if large:
                self.split.addWidget(self.sum_view)
            else:
                self.sum_place.layout().addWidget(self.sum_view)
        self.sum_place.setVisible(not large)
        self.main_view.setVisible(not large)
        self.linked_view.setVisible(intent.view == "both")

    def show_plane(self, loaded: PlaneData, recorded: NDArray[Any]) -> None:
        """Show what holds for a whole plane: energy of each position and whether it was recorded, depth sum."""
        self.map.set_values(loaded.energy, recorded)
        nt, ns = loaded.depth_sum.shape
        shown = Shot(loaded.depth_sum, name="depth_sum", quantity=self._unit, origin=(-(nt // 2), -(ns // 2)))
        self.sum_view.set_shot(shown)
        self._show_outlines(NO_LINE, NO_LINE)
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
            view.set_shot(None)
        self.map.clear()
        self.profile.clear()
        self._show_outlines(NO_LINE, NO_LINE)
        self.aperture_text.setText("")
        self.readout.setText(words)

    def show_picture(self, picture: PSFPicture, intent: PSFIntent, levels: Levels, unit: str) -> None:
        """Show the main and the linked picture with values in ``unit``; ``levels`` None: each fills the scale."""
        self._show_unit(unit)
        for view, image, title, cross in (
            (self.main_view, picture.main, picture.main_title, picture.main_cursor),
            (self.linked_view, picture.linked, picture.linked_title, picture.linked_cursor),
        ):
            view.set_shot(Shot(image, title, unit, "psf", levels, picture.signed, cross=cross, pixel_um=self._pixel_um))
        words = HOVER if intent.pixel is None else pixel_words(picture, intent.pixel, unit)
        self.readout.setText(words)
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
        self._show_outlines(
            *(
                shown.outline() - [n // 2 for n in cutout] if shown is not None and shown.seen else NO_LINE
                for shown in (aperture, expected)
            )
        )
        self.aperture_text.setText(aperture_words(aperture, expected))
        self.aperture_text.setToolTip(aperture_words(aperture, expected, ()))

    def _show_outlines(self, fitted: NDArray[np.float64], expected: NDArray[np.float64]) -> None:
        """Draw the outlines ``(n, 2)`` of the fitted and the expected aperture over the depth sum."""
        self._outlines = fitted, expected
        tones = outline_tones()
        self.sum_view.set_overlays(Outline(fitted, tones[0], width=2), Outline(expected, tones[1], dashed=True))

    def show_tile(self, z: int, **known: Any) -> None:
        """Show more of plane ``z`` among all planes: fields of `lfcal_gui.widgets.PlaneTile`."""
        self._each_strip(lambda strip: strip.set_tile(z, **known))

    def _each_strip(self, do: Callable[[Strip], object]) -> None:
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

    def set_display(self, display: DisplaySettings) -> None:
        """Use scaling and colours; a difference has its own."""
        self._display = display
        for view in (self.main_view, self.linked_view, self.sum_view):
            view.set_display(display)
        self.contrast.update()

    def toggle_scale(self, scale: str) -> None:
        """Change between ``scale`` and linear."""
        chosen = "linear" if self._display.scale == scale else scale
        self.display_asked.emit({"scale": chosen})

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for widget in (
            self.main_view,
            self.linked_view,
            self.sum_view,
            self.map,
            self.profile,
            self.strip,
            self.contrast,
        ):
            widget.apply_theme()
        if self.apertures is not None:
            self.apertures.apply_theme()
        self._colour()

    def _colour(self) -> None:
        """Give outlines, and the words about lines, the colours of the theme in use."""
        self._show_outlines(*self._outlines)
        self.legend.setText(legend_words())
        self.profile_title.setText(_profile_words())


def _profile_words() -> str:
    """Return the title of the card with the profiles: a legend would lie over its curves."""
    tones = zip(LINES, ("row", "column"), strict=False)
    named = (f"<span style='color:{shown_tone(tone)}'>━</span> {what}" for tone, what in tones)
    return f"Profiles at the pixel: {', '.join(named)}"
