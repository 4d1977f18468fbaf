"""H and HT with contrast and strip of planes; inspector with verdict, aperture and levels on the right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QCheckBox,
    QDialog,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QStackedWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.models import DisplaySettings, Outline, Shot, levels_of
from lfcal_gui.pages.h.model import (
    HIntent,
    HPicture,
    PlaneData,
    PositionMap,
    aperture_tip,
    aperture_words,
    pixel_words,
    unit_word,
)
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import (
    INSPECTOR,
    LINES,
    Contrast,
    ElidedLabel,
    Folded,
    LinePlot,
    PeriodMap,
    Picture,
    PlaneTile,
    Strip,
    VerdictCard,
    WrappedLabel,
    button,
    card,
    clear,
    column_of,
    heading,
    inspector_width,
    legend_words,
    line,
    link,
    name_controls,
    outline_tones,
    row_of,
    scrolling,
    segment,
    share_contrast,
    shown_tone,
    split,
)

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture
    from lfcal_gui.pages.h.fit_view import FitPictures
    from lfcal_gui.pages.h.model_fit_run import FoundFit

LARGE = 200
SIZE = (930, 560)


def tip_of(z: int, tile: PlaneTile, count: int) -> str:
    """Return the tooltip for the aperture of plane ``z`` of ``count`` planes."""
    made = f"computed with {tile.made}" if tile.made else ""
    return "\n".join(filter(None, (aperture_tip(z, tile.depth_um, count, tile.fitted, tile.expected), made)))


class Apertures(QDialog):
    """Window with large apertures of all planes, which is updated together with the strip."""

    chosen = Signal(int, arguments=["z"])
    """A plane was clicked."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Apertures of all planes")
        self.resize(*SIZE)
        self.grid = Strip(tip_of, LARGE, wrapping=True)
        self.grid.chosen.connect(self.chosen.emit)
        column = QVBoxLayout(self)
        self.legend = QLabel()
        column.addWidget(self.legend)
        column.addWidget(self.grid, 1)
        self.apply_theme()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.setStyleSheet(style_sheet())
        self.legend.setText(legend_words(" &nbsp; "))
        self.grid.apply_theme()


HOVER = "Point at a pixel of H to see its HT. Click to keep this pixel."
HOVER_BRIEF = "Point at H to see HT"
Levels = tuple[float, float] | None

NO_LINE = np.empty((0, 2))

VIEWS = (
    ("H", {"view": "one", "transposed": False}, "Pattern of one source position on the sensor (T)"),
    ("HT", {"view": "one", "transposed": True}, "Pattern in the volume seen by one pixel: the transposed matrix (T)"),
    ("Both", {"view": "both"}, "H, and HT of the pixel under the pointer"),
    ("Sum", {"view": "sum"}, "Depth-plane sum: the aperture as seen from this depth"),
    ("Difference", {"view": "difference"}, "H, and its difference from the other H at equal energy (D)"),
    ("Fit", {"view": "fit"}, "Measured, model and residual of a fitted pattern"),
)

LEVELS = {
    "checks": ("Checks", "All checks of H, failed ones first, with the meaning, remedy and image of each"),
    "fit": ("Fit of the optics", "Estimate gap, focal lengths, iris and aberrations from the recorded positions"),
    "compare": (
        "Compare with another H",
        "Compare position by position with the H of another day, of a simulation or of a fit",
    ),
}
"""Levels below the verdict, with their titles and tooltips."""

SIZES = {0: (90, 90), 600: (90, 98), 760: (120, 130), 900: (260, 200)}
"""Heights of depth-plane sum and map (px), by the smallest height of the panel."""

PROFILE = 150
"""Height of the profile (px)."""

ROW = 30
"""Height of a line that opens a level (px)."""

LINES_OF_APERTURE = 6
"""Smallest number of lines for the numbers of an aperture."""


class HPanel(QWidget):
    """The page's widgets."""

    asked = Signal(dict, arguments=["changes"])
    """Requested changes of `lfcal_gui.pages.h.model.HIntent`, by field."""
    display_asked = Signal(dict, arguments=["changes"])
    """Requested changes of `lfcal_gui.models.display.DisplaySettings`, by field."""
    own_scale_toggled = Signal()
    """The user switched between separate scales and one scale for all pictures of the plane."""
    hovered, clicked = (
        Signal(int, int, float, arguments=["row", "column", "value"]),
        Signal(int, int, arguments=["row", "column"]),
    )
    """The pointer in the main picture; row -1: outside."""
    level_asked = Signal(str, arguments=["name"])
    """Request for a level of the inspector: one of `LEVELS`, or the verdict (empty)."""
    frame_asked = Signal()
    """Request for the recorded frame of the position."""

    def __init__(self) -> None:
        super().__init__()
        self._unit, self._pixel_um = "", None
        self._display = DisplaySettings()
        self._outlines: tuple[NDArray[np.float64], NDArray[np.float64]] = (NO_LINE, NO_LINE)
        self.apertures: Apertures | None = None
        self._make_pictures()
        self._make_tools()
        left = QVBoxLayout()
        left.setSpacing(2)
        left.addWidget(self.pictures, 1)
        left.addWidget(self.contrast)
        left.addWidget(self.strip)
        self.inspector = self._inspector()
        row_of(left, self.inspector, of=self, spacing=8, stretch=0)
        self._colour()
        self._show_view(HIntent())

    # -- building --------------------------------------------------------------------------------------
    def _make_pictures(self) -> None:
        self.main_view, self.linked_view, self.sum_view = (Picture(legend=False) for _ in range(3))
        link(self.main_view, self.linked_view)
        share_contrast(self.main_view, self.linked_view)
        self.main_view.hovered.connect(self.hovered.emit)
        self.main_view.clicked.connect(self.clicked.emit)
        self.split = split(self.main_view, self.linked_view, sizes=(1, 1))
        self.pictures = QStackedWidget()
        self.pictures.addWidget(self.split)
        self.contrast = Contrast(self.main_view)
        self.contrast.display_asked.connect(self.display_asked.emit)
        self.strip = Strip(tip_of, 64)
        self.strip.chosen.connect(lambda z: self.asked.emit({"z": z}))

    @cached_property
    def fitted(self) -> FitPictures:
        """Pictures of the patterns of a fit, which are created with the first fit."""
        from lfcal_gui.pages.h.fit_view import FitPictures

        made = FitPictures()
        made.set_display(self._display)
        made.contrast.display_asked.connect(self.display_asked.emit)
        self.pictures.addWidget(made)
        return made

    def _make_tools(self) -> None:
        """Create the tools of the header: views, readout, and scaling of the pictures."""
        self.view_buttons: dict[str, QPushButton] = {}
        for title, changes, tip in VIEWS:
            asked = partial(self.asked.emit, dict(changes))
            self.view_buttons[title] = segment(title, tip, asked)
        for title in ("Difference", "Fit"):  # until there is another H, or a fit
            self.view_buttons[title].hide()
        self.readout = ElidedLabel(sentence=True, role="hint")
        self.own_scale = QCheckBox("Separate scales")
        self.own_scale.setToolTip(
            "Each image uses the full colour scale. Off: all positions of a plane share one scale"
        )
        self.own_scale.toggled.connect(lambda _: self.own_scale_toggled.emit())

    def _inspector(self) -> QWidget:
        self.verdict = VerdictCard("Show all checks of H, failed ones first, with the meaning and remedy of each")
        self.verdict.why_asked.connect(lambda: self.level_asked.emit("checks"))
        self.levels = QStackedWidget()
        self.levels.addWidget(_scrolled(self.verdict, self._aperture_card(), self._profiles(), self._made()))
        self.rows: dict[str, LevelRow] = {}
        self.level_titles: dict[str, QLabel] = {}
        rows = QVBoxLayout()
        rows.setSpacing(0)
        for name, (title, tip) in LEVELS.items():
            row = self.rows[name] = LevelRow(title, tip)
            row.clicked.connect(lambda _=False, name=name: self.level_asked.emit(name))
            rows.addWidget(row)
        self.row_holder = QWidget()
        self.row_holder.setLayout(rows)
        rows.setContentsMargins(0, 0, 0, 0)
        inspector = QWidget()
        column_of(self.levels, self._position(), self.row_holder, of=inspector, spacing=6, stretch=0)
        inspector.setFixedWidth(inspector_width(0))
        inspector.setProperty(INSPECTOR, True)
        return inspector

    def _position(self) -> QWidget:
        self.map_title, self.map_range = ElidedLabel(sentence=True), QLabel()
        self.place_label, self.position_label = WrappedLabel(), ElidedLabel()
        self.map_range.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.map_title.setProperty("role", "heading")
        for label in (self.map_range, self.place_label, self.position_label):
            label.setProperty("role", "hint")
        self.frame_button = button("Frame", "Show the recorded frame of this position", self.frame_asked.emit, "tight")
        self.map = PeriodMap()
        self.map.chosen.connect(lambda y, x: self.asked.emit({"y": y, "x": x}))
        place, column = card()
        column.addLayout(line(self.map_title, self.map_range, stretch=0))
        column.addWidget(self.map)
        column.addWidget(self.place_label)
        column.addLayout(line(self.position_label, self.frame_button, stretch=0))
        return place

    def _profiles(self) -> QWidget:
        self.profile = LinePlot("pixel from the cutout's centre (px)", "intensity (counts)")
        self.profile.setFixedHeight(PROFILE)
        self.profile_title = QLabel()
        profiles = Folded("Profiles", "Values along the row and the column of the pixel under the pointer")
        profiles.column.addWidget(self.profile_title)
        profiles.column.addWidget(self.profile)
        return profiles

    def _made(self) -> QWidget:
        self.made = WrappedLabel(role="hint")
        self.made_fold = Folded(
            "Computation", "How this plane was computed: engine, sampling, processor time and error"
        )
        self.made_fold.column.addWidget(self.made)
        self.made_fold.hide()
        return self.made_fold

    def add_level(self, name: str, view: QWidget, *, scrolled: bool = True) -> None:
        """Add a level to the inspector; if ``scrolled``, the level scrolls as a whole instead of in parts."""
        back = button(
            "‹ Verdict",
            "Back to the verdict, the aperture and the other levels (Backspace)",
            lambda: self.level_asked.emit(""),
            "link",
        )
        title = self.level_titles[name] = ElidedLabel(LEVELS[name][0])
        title.setProperty("role", "heading")
        title.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        level = QWidget()
        column = QVBoxLayout(level)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(line(back, title, stretch=1))
        column.addWidget(_scrolled(view, stretch=True) if scrolled else view, 1)
        level.setObjectName(name)
        name_controls(level)
        self.levels.addWidget(level)

    def say_level(self, name: str, title: str, state: str) -> None:
        """Show name and state of a level."""
        self.rows[name].say(title, state)
        if name in self.level_titles:
            self.level_titles[name].setText(title)

    def show_level(self, name: str) -> None:
        """Show a level of the inspector; empty: the verdict. Other levels are hidden."""
        for k in range(self.levels.count()):
            level = self.levels.widget(k)
            shown = level.objectName() == name
            height = QSizePolicy.Policy.Preferred if shown else QSizePolicy.Policy.Ignored
            level.setSizePolicy(QSizePolicy.Policy.Preferred, height)
            if shown:
                self.levels.setCurrentIndex(k)
        self.levels.updateGeometry()  # a hidden level does not report its change
        self.row_holder.setVisible(not name)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Widen the inspector in a large window."""
        super().resizeEvent(event)
        self.inspector.setFixedWidth(inspector_width(self.width()))
        height = max(least for least in SIZES if self.height() >= least)
        for widget, px in zip((self.sum_place, self.map), SIZES[height], strict=True):
            widget.setFixedHeight(px)
        self.map.set_axes(*(("position x (px)", "position y (px)") if height == max(SIZES) else ("", "")))

    def _aperture_card(self) -> QWidget:
        panel, column = card()
        self.legend, larger = QLabel(), QPushButton("Enlarge …")
        self.legend.setToolTip("Outline fitted to the depth-plane sum, and outline expected from the camera")
        larger.setProperty("role", "tight")
        larger.setToolTip("Show the apertures of all planes in a separate window, large enough to compare their blades")
        larger.clicked.connect(lambda: self.show_apertures())
        self.aperture_text = QLabel(textFormat=Qt.TextFormat.RichText, wordWrap=True)
        self.aperture_text.setAlignment(Qt.AlignmentFlag.AlignTop)
        # what is below does not move when the aperture is known
        self.aperture_text.setMinimumHeight(LINES_OF_APERTURE * self.aperture_text.fontMetrics().height())
        self.sum_place = QWidget()
        column_of(self.sum_view, of=self.sum_place)
        column.addLayout(line(heading("Aperture"), self.legend, larger, stretch=1))
        column.addWidget(self.aperture_text)  # in a low window, only what is first is seen
        column.addWidget(self.sum_place)
        return panel

    # -- showing ---------------------------------------------------------------------------------------
    def show_matrix(self, depths: NDArray[np.float64], unit: str, pixel_um: float | None, *, reference: bool) -> None:
        """Show the planes of an H with values in ``unit``; ``reference`` states whether there is a reference.

        ``depths`` are in µm, NaN if H states none; ``pixel_um`` is the pixel pitch of the sensor, if known.
        """
        self._pixel_um = pixel_um
        self._each_strip(lambda strip: strip.set_planes(depths))
        self.view_buttons["Difference"].setVisible(reference)
        self._show_unit(unit)

    def _show_unit(self, unit: str) -> None:
        """Set the unit of the profile only if it changed, because its axes are slow to draw."""
        if unit != self._unit:
            self._unit = unit
            self.profile.set_labels("pixel from the cutout's centre (px)", unit)

    def show_intent(self, intent: HIntent, plane_words: str, position_words: str) -> None:
        """Show plane, position and view of an intent in the controls."""
        self.place_label.setText(plane_words)
        self.position_label.setText(position_words)
        self._each_strip(lambda strip: strip.set_current(intent.z))
        self.map.set_position(intent.y, intent.x)
        self._show_view(intent)

    def _show_view(self, intent: HIntent) -> None:
        """Show H, HT, both, the difference, the patterns of a fit, or the depth-plane sum."""
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
        self.linked_view.setVisible(intent.view in ("both", "difference"))
        by_fit = intent.view == "fit"
        self.pictures.setCurrentWidget(self.fitted if by_fit else self.split)
        self.contrast.setVisible(not by_fit)

    def show_fit(self, found: FoundFit | None) -> None:
        """Offer the patterns of a fit as a view. None: there is no fit."""
        self.view_buttons["Fit"].setVisible(found is not None)
        if found is None:
            self.map.clear()  # its lines keep references to the fit
        if found is not None or "fitted" in self.__dict__:
            self.fitted.show_fit(found)

    def show_map(self, shown: PositionMap) -> None:
        """Show a quantity over the positions of the plane."""
        self.map_title.setText(shown.title)
        self.map_range.setText(shown.range_words)
        self.map.lines = shown.lines
        marks = {"x": shown.missing, "o": shown.ringed, "s": shown.aside}
        self.map.set_values(shown.values, marks=marks, name=shown.name, levels=shown.levels, quantity=shown.title)

    def show_plane(self, loaded: PlaneData) -> None:
        """Show the depth-plane sum."""
        nt, ns = loaded.depth_sum.shape
        shown = Shot(loaded.depth_sum, name="depth_sum", quantity=self._unit, origin=(-(nt // 2), -(ns // 2)))
        self.sum_view.set_shot(replace(shown, pixel_um=self._pixel_um))
        self._show_outlines(NO_LINE, NO_LINE)
        self.aperture_text.setText("fitting the aperture …")

    def show_reading(self, words: str) -> None:
        """Show in empty pictures what is being read."""
        self.readout.setText(words)
        for view in (self.main_view, self.linked_view, self.sum_view, self.profile):
            view.blank.wait(words)

    def show_made(self, words: str) -> None:
        """Show how the plane was computed; empty: it was not simulated, or its file does not state how."""
        self.made.setText(words)
        self.made_fold.setVisible(bool(words))

    def show_no_plane(self, words: str) -> None:
        """Show why a plane cannot be read, in place of pictures of another plane."""
        for view in (self.main_view, self.linked_view, self.sum_view):
            view.blank.words = "This plane cannot be read."
            view.set_shot(None)
        self.map.clear()
        self.profile.clear()
        self._show_outlines(NO_LINE, NO_LINE)
        self.aperture_text.setText("")
        self.readout.setText(words)

    def show_picture(self, picture: HPicture, intent: HIntent, ends: tuple[Levels, Levels], unit: str) -> None:
        """Show the main and the linked picture with values in ``unit``.

        ``ends`` are the levels of the pictures and of a difference. None: each picture has its own levels.
        """
        levels, signed = ends
        self._show_unit(unit)
        for view, image, title, cross in (
            (self.main_view, picture.main, picture.main_title, picture.main_cursor),
            (self.linked_view, picture.linked, picture.linked_title, picture.linked_cursor),
        ):
            apart = picture.signed and view is self.linked_view
            if apart:  # the scale below the pictures is that of H
                title += f", ±{(signed or levels_of(image, signed=True))[1]:.3g} {unit_word(unit)}"
            shot = Shot(image, title, unit, "psf", signed if apart else levels, apart, cross=cross)
            view.set_shot(replace(shot, pixel_um=self._pixel_um))
        words = (HOVER, HOVER_BRIEF) if intent.pixel is None else pixel_words(picture, intent.pixel, unit)
        self.readout.setText(*words)
        self._show_profile(picture.main, intent, levels)

    def _show_profile(self, image: NDArray[Any], intent: HIntent, levels: Levels) -> None:
        ct, cs = (n // 2 for n in image.shape)
        t, s = intent.pixel or (ct, cs)
        if levels is not None:
            self.profile.plot.vb.setYRange(*levels, padding=0.02)
        else:
            self.profile.plot.vb.enableAutoRange("y")
        self.profile.set_curve("along the row", np.arange(image.shape[1]) - cs, image[t])
        self.profile.set_curve("along the column", np.arange(image.shape[0]) - ct, image[:, s])

    def show_aperture(self, aperture: Aperture, expected: Aperture | None, cutout: tuple[int, int]) -> None:
        """Show the fitted and the expected (dashed) aperture over the depth-plane sum, and the numbers of both."""
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
        """Update the tile of plane ``z`` with fields of `lfcal_gui.widgets.PlaneTile`."""
        self._each_strip(lambda strip: strip.set_tile(z, **known))

    def _each_strip(self, do: Callable[[Strip], object]) -> None:
        for strip in (self.strip, *(() if self.apertures is None else (self.apertures.grid,))):
            do(strip)

    def show_apertures(self) -> Apertures:
        """Open the window with large apertures of all planes."""
        if self.apertures is None:
            self.apertures = Apertures(self.window())
            self.apertures.chosen.connect(lambda z: self.asked.emit({"z": z}))
        self.apertures.grid.show_tiles(self.strip.tiles)
        self.apertures.grid.set_current(self.strip.currentRow())
        self.apertures.show()
        return self.apertures

    def set_display(self, display: DisplaySettings) -> None:
        """Set scaling and colours; those of a difference are separate."""
        self._display = display
        for view in (self.main_view, self.linked_view, self.sum_view):
            view.set_display(display)
        if "fitted" in self.__dict__:
            self.fitted.set_display(display)
        self.contrast.update()

    def toggle_scale(self, scale: str) -> None:
        """Switch between ``scale`` and linear."""
        chosen = "linear" if self._display.scale == scale else scale
        self.display_asked.emit({"scale": chosen})

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
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
        for large in (self.apertures, self.__dict__.get("fitted")):
            if large is not None:
                large.apply_theme()
        self._colour()

    def _colour(self) -> None:
        """Apply the colours of the current theme to outlines and to texts about lines."""
        self._show_outlines(*self._outlines)
        self.legend.setText(legend_words(" "))
        self.profile_title.setText(_profile_words())


class LevelRow(QPushButton):
    """Line of the inspector that opens a level: name, state, and an arrow."""

    def __init__(self, title: str, tip: str) -> None:
        super().__init__()
        self.setProperty("role", "row")
        self.setToolTip(tip)
        self.name, self.state = QLabel(), ElidedLabel()
        self.name.setProperty("role", "heading")
        self.state.setProperty("role", "hint")
        self.state.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        row = QHBoxLayout(self)
        row.setContentsMargins(10, 0, 8, 0)
        for part, stretch in ((self.name, 0), (self.state, 1), (QLabel("›"), 0)):
            part.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
            row.addWidget(part, stretch)
        self.setFixedHeight(ROW)
        self.say(title, "")

    def say(self, title: str, state: str) -> None:
        """Set name and state of the level."""
        self.name.setText(title)
        self.state.setText(state, state.rpartition(", ")[0])
        self.setAccessibleName(f"{title}: {state}" if state else title)


def _scrolled(*parts: QWidget, stretch: bool = False) -> QScrollArea:
    """Return parts below each other in an area that scrolls in a low window."""
    inner = QWidget()
    column = QVBoxLayout(inner)
    column.setContentsMargins(0, 0, 4, 0)
    column.setSpacing(6)
    for part in parts:
        column.addWidget(part, int(stretch))
    if not stretch:
        column.addStretch()
    area = scrolling(inner)
    clear(area)
    return area


def _profile_words() -> str:
    """Return the title of the card with the profiles, which replaces a legend that would cover the curves."""
    tones = zip(LINES, ("row", "column"), strict=False)
    named = (f"<span style='color:{shown_tone(tone)}'>━</span> {what}" for tone, what in tones)
    return f"Profiles at the pixel: {', '.join(named)}"
