"""Set up: picture of the scan, expected apertures, and costs; camera and scan settings on the right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QSignalBlocker, QSize, Qt, Signal
from PySide6.QtGui import QHideEvent, QResizeEvent, QShowEvent
from PySide6.QtWidgets import (
    QGridLayout,
    QLabel,
    QMenu,
    QSlider,
    QStackedWidget,
    QWidget,
)

from lfcal.base import LfcalError, format_length, format_share
from lfcal.camera import ScanPlan
from lfcal_gui.models import ProjectState, Shot, plane_words
from lfcal_gui.pages.setup._inspector import Inspector
from lfcal_gui.pages.setup._optics_view import OpticsView
from lfcal_gui.pages.setup.model import facts
from lfcal_gui.pages.setup.model_picture import Area, Number, ScanCosts, ScanScene, numbers_of
from lfcal_gui.pages.setup.model_scan import half_of, path_lines
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.widgets import (
    INSPECTOR,
    ElidedLabel,
    Picture,
    PlaneTile,
    Strip,
    WrappedLabel,
    button,
    clear,
    column_of,
    inspector_width,
    line,
    outline_tones,
    row_of,
    scrolling,
    segment,
    table_entries,
)

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture
    from lfcal.simulate import ExpectedLight, ScanChoice
    from lfcal_gui.pages.setup.model_check import Checked

VIEWS = (
    ("Sensor", "The sensor with lenslets, scan path and cutout"),
    ("Optics", "Main optics and array, drawn to scale"),
    ("Depth", "Aperture images of the planes, and all numbers of the forecast"),
)

OVERLAYS = ("Lattice centres", "Scan path", "Cutout")

BIG = 20
"""Size of a big number (pt)."""

ABREAST, NAMED = 820, 1300
LEAST = 400
"""Smallest widths at which the slider is next to the numbers and has a name, and of the row (px)."""


class CostRow(QWidget):
    """Forecast costs of a scan as large numbers, and a slider between fast and exact ways to record it."""

    chosen = Signal(object, arguments=["choice"])
    """The user chose a way to record the scan: a `lfcal.simulate.ScanChoice`."""

    def __init__(self) -> None:
        super().__init__()
        self._costs: ScanCosts | None = None
        self._numbers: tuple[Number, ...] = ()
        self._shown: tuple[ScanChoice, ...] = ()
        self.labels = [(QLabel(), ElidedLabel()) for _ in range(4)]
        self.title, self.slider = ElidedLabel(), QSlider(Qt.Orientation.Horizontal)
        self.title.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.slider.setToolTip(
            "Change the exposure and the number of averages in the plan, to record faster or with less noise"
        )
        self.slider.setAccessibleName("Time versus accuracy")
        self.slider.setPageStep(1)
        self.slider.valueChanged.connect(self._chosen)
        self.slider.sliderReleased.connect(self._show_slider)
        self.effort = QWidget()
        effort = QGridLayout(self.effort)
        effort.setContentsMargins(0, 0, 0, 0)
        faster, exact = QLabel("fast"), QLabel("exact")
        for label in (faster, exact, *(words for _, words in self.labels)):
            label.setProperty("role", "hint")
        for column, label in enumerate((faster, self.title, exact)):
            effort.addWidget(label, 0, column)
        effort.addWidget(self.slider, 1, 0, 1, 3)
        effort.setColumnStretch(1, 1)
        self.grid = QGridLayout(self)
        self.grid.setContentsMargins(0, 0, 0, 0)
        self.grid.setHorizontalSpacing(16)
        self.grid.setVerticalSpacing(0)
        for column, (number, words) in enumerate(self.labels):
            number.setTextFormat(Qt.TextFormat.RichText)
            self.grid.addWidget(number, 0, column)
            self.grid.addWidget(words, 1, column)
            self.grid.setColumnStretch(column, 2)
        self._place()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Place the slider next to the numbers if there is enough space."""
        super().resizeEvent(event)
        self._place()

    def minimumSizeHint(self) -> QSize:
        """Return a small width, so that the row never makes the window wider; texts are shortened instead."""
        return QSize(LEAST, super().minimumSizeHint().height())

    def _place(self) -> None:
        abreast = self.width() >= ABREAST
        self.grid.addWidget(self.effort, *((0, 4, 2, 1) if abreast else (2, 0, 1, 4)))
        self.grid.setColumnStretch(4, 3 if abreast else 0)
        self._show_title()

    def _show_title(self) -> None:
        if self._costs is not None:
            name = "Time versus accuracy: " if self.width() >= NAMED or self.width() < ABREAST else ""
            self.title.setText(name + self._costs.way)
            self.title.setToolTip(_effort_tip(self._costs))

    @property
    def numbers(self) -> tuple[Number, ...]:
        """The displayed numbers."""
        return self._numbers

    def show_costs(self, costs: ScanCosts | None, numbers: tuple[Number, ...]) -> None:
        """Show the numbers of a scan, and set the slider to the way in which it is recorded."""
        self._costs, self._numbers = costs, numbers
        for k, (value, words) in enumerate(self.labels):
            there = k < len(numbers)
            for label in (value, words):
                label.setVisible(there)
            if there:
                number = numbers[k]
                style = f"font-size:{BIG}pt; font-weight:600"
                value.setText(f"<span style='{style}'>{number.value}</span> {number.unit}")
                words.setText(number.words)
        self.effort.setVisible(costs is not None)
        if not self.slider.isSliderDown():  # else the choices would change under the pointer
            self._show_slider()

    def _show_slider(self) -> None:
        costs = self._costs
        if costs is None:
            return
        self._show_title()
        self.slider.setEnabled(costs.own >= 0)
        with QSignalBlocker(self.slider):
            self.slider.setMaximum(max(0, len(costs.choices) - 1))
            self.slider.setValue(max(0, costs.own))
        self._shown = costs.choices
        self.slider.setToolTip(_effort_tip(costs))

    def _chosen(self, number: int) -> None:
        if number < len(self._shown):
            self.chosen.emit(self._shown[number])


def _effort_tip(costs: ScanCosts) -> str:
    if costs.own < 0:
        return f"The noise of H is not known: {costs.unknown or 'it is being computed'}"
    peak = format_share(costs.choices[costs.own].peak)
    return (
        "Time versus accuracy. Left: shorter exposures, fewer frames. Right: longer exposures, "
        f"then more frames.\nNow: {costs.way}. The brightest pixel reaches {peak} of the full "
        "well. Undo (Ctrl+Z) restores the plan"
    )


class PlanningPanel(QWidget):
    """The page's widgets.

    Parameters
    ----------
    check, check_scan
        Return why a field of the camera, or of the scan, cannot take a value, or an empty string.
    later
        Leaves a call for a later turn of the event loop.
    """

    dragged = Signal(int, int, arguments=["rows", "columns"])
    """The user dragged the scan by a number of pixels."""

    def __init__(
        self,
        check: Callable[[str, Any], str],
        check_scan: Callable[[str, Any], str],
        later: Callable[[Callable[[], None]], None],
    ) -> None:
        super().__init__()
        self._later = later
        self._scene: ScanScene | None = None
        self.costs: ScanCosts | None = None
        self._area: Area | None = None
        """Area to show, for any size of the picture."""
        self._wanted: Area | None = None
        """Area to which the picture is zoomed when it is drawn next."""
        self._due = False
        """Whether the picture is drawn in a later turn of the event loop."""
        self._shown: tuple[Any, Shot] | None = None
        """Input of the drawn picture, and the picture."""
        self.inspector = Inspector(check, check_scan)
        self.picture = Picture("white image (counts)", legend=False, colour_map="gray")
        self.picture.graphics.setAccessibleName("Sensor with lenslets, scan and cutout")
        self.picture.dragged.connect(self.dragged.emit)
        self.picture.moved.connect(self._moved)
        self.picture.box.sigResized.connect(lambda *_: self._draw(self._area))
        self.optics = OpticsView()
        self.facts, self.forecast = _Figures(), _Figures()
        self.strip = Strip(_tip, 64)
        self.strip.setToolTip("Expected apertures in the planes of the scan. Click one to draw it in the cutout")
        self.strip.chosen.connect(self._chosen)
        self.views = QStackedWidget()
        for view in (self.picture, self.optics, self._depth()):
            self.views.addWidget(view)
        self._tools()
        self.numbers = CostRow()
        left = column_of(self.views, self.strip, self.numbers, spacing=4, stretch=0)
        self.area = scrolling(self.inspector)
        self.area.setProperty(INSPECTOR, True)
        clear(self.area)
        row_of(left, self.area, of=self, spacing=8, stretch=0)

    def _tools(self) -> None:
        self.segments = []
        for k, (title, tip) in enumerate(VIEWS):
            self.segments.append(segment(title, tip, partial(self._look_at, k), on=k == 0))
            self.segments[k].setAutoExclusive(True)
        self.overlay = button("Overlay", "Choose what is drawn over the image")
        menu = QMenu(self.overlay)
        self.overlays = {name: menu.addAction(name) for name in OVERLAYS}
        for action in self.overlays.values():
            action.setCheckable(True)
            action.setChecked(True)
            action.toggled.connect(self._chosen)
        menu.addSeparator()
        for words, action in zip(("Copy scan path", "Save scan path …"), self.path_entries(), strict=True):
            menu.addAction(words).triggered.connect(lambda _=False, do=action[1]: do())
        self.overlay.setMenu(menu)

    def _look_at(self, view: int) -> None:
        self.views.setCurrentIndex(view)
        self.overlay.setEnabled(view == 0)

    def path_entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return the menu entries that copy and save the scan path of a plane as a table."""

        def lines(between: str) -> Iterator[str]:
            scene = self._scene
            if scene is not None and scene.plan is not None:
                yield from path_lines(scene.plan, between, scene.half)

        return table_entries(self, "scan path", lines)

    def _depth(self) -> QWidget:
        inner, row = QWidget(), line(self.facts, self.forecast)
        for k in range(2):
            row.setStretch(k, 1)
        inner.setLayout(row)
        area = scrolling(inner)
        clear(area)
        return area

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Widen the inspector in a large window."""
        super().resizeEvent(event)
        self.area.setFixedWidth(inspector_width(self.width()))

    def showEvent(self, event: QShowEvent) -> None:
        """Draw what changed while the panel was hidden."""
        super().showEvent(event)
        self._draw(self._area)

    # -- showing ---------------------------------------------------------------------------------------
    def show_state(self, state: ProjectState, checked: Checked | None, light: ExpectedLight | str | None) -> None:
        """Show camera and plan of a project.

        ``checked`` is the comparison of the camera with a white image. ``light`` is the light of the patterns, or the
        reason why it is unknown. Either is None if it is not known yet.
        """
        plan, settings, refused, half = state.plan, PlanSettings.of(state), "", None
        if plan is not None and settings.half_cell:
            try:
                half = half_of(plan)
            except LfcalError as error:
                refused = str(error)
        scene = ScanScene(state.camera, plan, half, checked)
        before, self._scene = self._scene, scene
        self.inspector.show_plan(plan, settings, refused)
        if before is None or (before.camera, before.camera.marks) != (state.camera, state.camera.marks):
            self.inspector.show_camera(state.camera)
            self.optics.set_camera(state.camera)
            self.facts.setText(facts(state.camera))
        self._show_costs(None if plan is None else ScanCosts.of(plan, settings, half, light), checked)
        self._show_planes(plan)
        if scene.same_view(before):
            self._draw()
        else:
            self.look()

    def look(self) -> None:
        """Zoom to the scan or, without a plan, to the middle of the sensor."""
        if self._scene is not None:
            self._draw(self._scene.area())

    def _show_costs(self, costs: ScanCosts | None, checked: Checked | None) -> None:
        self.costs = costs
        cells = "".join(
            f"<tr><td style='padding-right:12px'>{name.replace('  ', '&nbsp;&nbsp;')}</td><td><b>{value}</b></td></tr>"
            for name, value in (() if costs is None else costs.rows())
        )
        self.forecast.setText(f"<table cellspacing='1'>{cells}</table>")
        self.numbers.show_costs(costs, numbers_of(costs, checked))

    def _show_planes(self, plan: ScanPlan | None) -> None:
        self.strip.setVisible(plan is not None)
        if plan is None:
            return
        self.strip.offer(plan.depths_um, plan.cutout)
        if self.strip.currentRow() < 0:
            self.strip.set_current(len(plan.depths_um) - 1)

    def show_expected(self, apertures: Sequence[Aperture | None]) -> None:
        """Draw the expected apertures of the planes. None: the plane is in focus, or its aperture is not visible."""
        self.strip.show_expected(apertures)
        self._draw()

    def _moved(self) -> None:
        seen = self.picture.box.viewRect()
        self._area, self._wanted = (seen.top(), seen.left(), seen.height(), seen.width()), None
        self._draw()

    def _chosen(self, _: object) -> None:
        """Draw the plane or the overlays that the user chose."""
        self._draw()
        self.draw_now()

    def _draw(self, view: Area | None = None) -> None:
        """Draw the visible part in a later turn, once for all changes until then: the same as before, or ``view``."""
        self._area, self._wanted = view or self._area, view or self._wanted
        if self.isVisible() and not self._due:
            self._due = True
            self._later(self.draw_now)

    def draw_now(self) -> None:
        """Draw the visible part if anything changed since it was drawn."""
        scene, due, view = self._scene, self._due, self._wanted
        self._due, self._wanted = False, None
        if not due or scene is None or not self.isVisible():  # it is drawn when it is shown
            return
        if view is not None:
            self.picture.show_part(*view, padding=0)
        seen = self.picture.box.viewRect()
        view = seen.top(), seen.left(), seen.height(), seen.width()
        centres, path, cutout = (self.overlays[name].isChecked() for name in OVERLAYS)
        self.picture.set_lattice(scene.centres(view) if centres else None)
        made_of = (scene.camera, scene.checked, view)
        if self._shown is None or self._shown[0] != made_of:
            self._shown = made_of, scene.shot(view)
            self.picture.set_shot(self._shown[1])
        plane = self.strip.currentRow()
        aperture = self.strip.tiles[plane].expected if 0 <= plane < len(self.strip.tiles) else None
        outline = scene.aperture_overlays(aperture, outline_tones()[1])
        drawn = (
            scene.sensor_overlay(),
            *(scene.scan_overlays() * path),
            *((scene.cutout_overlays() + outline) * cutout),
        )
        self.picture.set_overlays(*drawn)
        self.picture.set_grip(scene.cutout)
        self.picture.show_part(*view, padding=0)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for part in (self.picture, self.optics, self.strip):
            part.apply_theme()


class _Figures(WrappedLabel):
    """A table as rich text, which Qt has only while it is visible: arranging it takes long at each change of style."""

    def __init__(self) -> None:
        super().__init__(rich=True)
        self.setTextFormat(Qt.TextFormat.RichText)
        self.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.setAlignment(Qt.AlignmentFlag.AlignTop)

    def setText(self, text: str) -> None:
        """Set the table."""
        if self.isVisible():
            super().setText(text)
        else:
            self._whole = text

    def showEvent(self, event: QShowEvent) -> None:
        """Show the table."""
        super().setText(self._whole)
        super().showEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        """Keep only the text."""
        super().hideEvent(event)
        QLabel.setText(self, "")


def _tip(z: int, tile: PlaneTile, count: int) -> str:
    expected = (
        "expected: in focus, or not visible" if tile.expected is None else f"expected: {tile.expected.describe()}"
    )
    return f"{plane_words(z, count)}: z = {format_length(tile.depth_um)}\n{expected}"
