"""Set up: the picture with the scan in it, the expected apertures, the big numbers; values and scan on the right."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QMenu, QPushButton, QStackedWidget, QVBoxLayout, QWidget

from lfcal.base import LfcalError, format_length
from lfcal.camera import Forecast, ScanPlan
from lfcal_gui.models import ProjectState, Shot, plane_words
from lfcal_gui.pages.setup._inspector import Inspector
from lfcal_gui.pages.setup._optics_view import OpticsView
from lfcal_gui.pages.setup.model import facts
from lfcal_gui.pages.setup.model_check import Checked
from lfcal_gui.pages.setup.model_picture import Area, Number, ScanScene, apertures_of, numbers_of
from lfcal_gui.pages.setup.model_scan import forecast_rows, half_of, path_lines
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.widgets import Picture, PlaneTile, Strip, clear, outline_tones, scrolling, table_entries

__all__ = ["PlanningPanel"]

VIEWS = (
    ("Sensor", "The sensor with lenslets, scan path and cutout"),
    ("Optics", "Main optics and array, drawn to scale"),
    ("Depth", "What the planes look like, and every figure of the forecast"),
)

OVERLAYS = ("Lattice centres", "Scan path", "Cutout")

NARROW, WIDE, ROOMY = 304, 368, 1380
"""Two widths of the inspector, and the least width of the panel for the wider one (px)."""

BIG = 20
"""Size of a big number (pt)."""


class PlanningPanel(QWidget):
    """The page's widgets.

    Parameters
    ----------
    check, check_scan
        Return why a field of the camera, or of the scan, cannot take a value, or an empty string.

    Signals
    -------
    dragged(rows, columns)
        The scan is moved by so many pixels.
    """

    dragged = Signal(int, int)

    def __init__(self, check: Callable[[str, Any], str], check_scan: Callable[[str, Any], str]) -> None:
        super().__init__()
        self._scene: ScanScene | None = None
        self._settings: PlanSettings | None = None
        self._shown: tuple[Any, Shot] | None = None
        """What the picture was drawn of, and the picture."""
        self.inspector = Inspector(check, check_scan)
        self.picture = Picture("white image (counts)", legend=False, colour_map="gray")
        self.picture.graphics.setAccessibleName("sensor with lenslets, scan and cutout")
        self.picture.dragged.connect(self.dragged.emit)
        self.picture.moved.connect(self._draw)
        self.optics = OpticsView()
        self.facts, self.forecast = _figures(), _figures()
        self.strip = Strip(_tip, 64)
        self.strip.setToolTip("Apertures expected in the planes of the scan. Click to draw one in the cutout")
        self.strip.chosen.connect(lambda _: self._draw())
        self.views = QStackedWidget()
        for view in (self.picture, self.optics, self._depth()):
            self.views.addWidget(view)
        self._tools()
        self.numbers = QHBoxLayout()
        self.numbers.setSpacing(24)
        left = QVBoxLayout()
        left.setSpacing(4)
        left.addWidget(self.views, 1)
        left.addWidget(self.strip)
        left.addLayout(self.numbers)
        self.area = scrolling(self.inspector)
        clear(self.area)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(8)
        row.addLayout(left, 1)
        row.addWidget(self.area)

    def _tools(self) -> None:
        """Make what the header has: views, and what is drawn over the picture."""
        self.segments = []
        for k, (title, tip) in enumerate(VIEWS):
            button = QPushButton(title)
            button.setProperty("role", "segment")
            button.setCheckable(True)
            button.setAutoExclusive(True)
            button.setChecked(k == 0)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, k=k: self._look_at(k))
            self.segments.append(button)
        self.overlay = QPushButton("Overlay")
        self.overlay.setToolTip("What is drawn over the picture")
        menu = QMenu(self.overlay)
        self.overlays = {name: menu.addAction(name) for name in OVERLAYS}
        for action in self.overlays.values():
            action.setCheckable(True)
            action.setChecked(True)
            action.toggled.connect(lambda _: self._draw())
        menu.addSeparator()
        for words, action in zip(("Copy scan path", "Save scan path …"), self.path_entries(), strict=True):
            menu.addAction(words).triggered.connect(lambda _=False, do=action[1]: do())
        self.overlay.setMenu(menu)

    def _look_at(self, view: int) -> None:
        self.views.setCurrentIndex(view)
        self.overlay.setEnabled(view == 0)

    def path_entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return what copies and what saves the scan path of a plane as a table."""

        def lines(between: str) -> Iterator[str]:
            scene = self._scene
            if scene is not None and scene.plan is not None:
                yield from path_lines(scene.plan, between, scene.half)

        return table_entries(self, "scan path", lines)

    def _depth(self) -> QWidget:
        inner = QWidget()
        row = QHBoxLayout(inner)
        for label in (self.facts, self.forecast):
            row.addWidget(label, 1)
        area = scrolling(inner)
        clear(area)
        return area

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Give the inspector more room in a large window."""
        super().resizeEvent(event)
        self.area.setFixedWidth(WIDE if self.width() >= ROOMY else NARROW)

    # -- showing ---------------------------------------------------------------------------------------
    def show_state(self, state: ProjectState, checked: Checked | None) -> None:
        """Show camera and plan of a project, with the white image that the camera was compared with."""
        plan, settings, refused = state.plan, PlanSettings.of(state), ""
        half = None
        if plan is not None and settings.half_cell:
            try:
                half = half_of(plan)
            except LfcalError as error:
                refused = str(error)
        scene = ScanScene(state.camera, plan, half, checked)
        before, self._scene = self._scene, scene
        self.inspector.show_plan(plan, settings, refused)
        if settings == self._settings and scene.only_moved(before):
            self._draw()
            return
        self._settings = settings
        self.inspector.show_camera(state.camera)
        self.optics.set_camera(state.camera)
        self.facts.setText(facts(state.camera))
        self._show_costs(scene, settings)
        self._show_planes(plan)
        if scene.same_view(before):
            self._draw()
        else:
            self.look()

    def look(self) -> None:
        """Look at the scan, or where nothing is planned at the middle of the sensor."""
        if self._scene is not None:
            self._draw(self._scene.area())

    def _show_costs(self, scene: ScanScene, settings: PlanSettings) -> None:
        plan, half = scene.plan, scene.half
        forecast, rows = None, []
        if plan is not None:
            rates = settings.speed, settings.frame_rate
            forecast = Forecast.of(plan, stage_um_per_s=rates[0], frames_per_s=rates[1], positions=half)
            rows = forecast_rows(plan, *rates, half)
        cells = "".join(
            f"<tr><td style='padding-right:12px'>{name.replace('  ', '&nbsp;&nbsp;')}</td><td><b>{value}</b></td></tr>"
            for name, value in rows
        )
        self.forecast.setText(f"<table cellspacing='1'>{cells}</table>")
        while self.numbers.count():
            gone = self.numbers.takeAt(0).widget()
            if gone is not None:
                gone.deleteLater()
        for number in numbers_of(scene, forecast):
            self.numbers.addWidget(_big(number))
        self.numbers.addStretch()

    def _show_planes(self, plan: ScanPlan | None) -> None:
        self.strip.setVisible(plan is not None)
        if plan is not None:
            shape = plan.cutout
            tiles = zip(plan.depths_um, apertures_of(plan), strict=True)
            chosen = self.strip.currentRow()
            self.strip.show_tiles([PlaneTile(depth, expected=one, shape=shape) for depth, one in tiles])
            self.strip.set_current(chosen if 0 <= chosen < len(plan.depths_um) else len(plan.depths_um) - 1)

    def _draw(self, view: Area | None = None) -> None:
        """Draw what is seen: the part that was before, or ``view``."""
        scene = self._scene
        if scene is None:
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
        """Take the colours of the theme in use."""
        for part in (self.picture, self.optics, self.strip):
            part.apply_theme()


def _figures() -> QLabel:
    label = QLabel()
    label.setTextFormat(Qt.TextFormat.RichText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    label.setAlignment(Qt.AlignmentFlag.AlignTop)
    label.setWordWrap(True)
    return label


def _big(number: Number) -> QLabel:
    label = QLabel(
        f"<span style='font-size:{BIG}pt; font-weight:600'>{number.value}</span> {number.unit}<br>{number.words}"
    )
    label.setTextFormat(Qt.TextFormat.RichText)
    return label


def _tip(z: int, tile: PlaneTile, count: int) -> str:
    expected = "expected: in focus, or not seen" if tile.expected is None else f"expected: {tile.expected.describe()}"
    return f"{plane_words(z, count)}: z = {format_length(tile.depth_um)}\n{expected}"
