"""PSF: H and its transpose, at once, for any plane and position."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.models.display import COLOUR_MAPS
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.psf.depth_strip import DepthStrip
from gui.pages.psf.model import LoadedPlane, PSFIntent, resolve
from gui.widgets.image_view import ImageView
from gui.widgets.period_map import PeriodMap
from gui.widgets.plots import LinePlot
from lfcal.errors import LfcalError
from lfcal.psf import PSFMatrix
from lfcal.units import format_bytes, format_length

if TYPE_CHECKING:
    from lfcal.psf.aperture import Aperture

__all__ = ["Page"]

SUFFIXES = (".h5", ".mat", ".npy")


@dataclass(frozen=True, eq=False)
class PlaneData:
    """What is known of a plane once it is read."""

    plane: LoadedPlane
    reference: LoadedPlane | None
    energy: NDArray[np.float64]
    depth_sum: NDArray[np.float64]
    levels: tuple[float, float]


class Page(StagePage):
    """The heart of the window: intent in, picture out."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.intent = PSFIntent()
        self.matrix: PSFMatrix | None = None
        self.reference: PSFMatrix | None = None
        self.plane: LoadedPlane | None = None
        self.reference_plane: LoadedPlane | None = None
        self._frozen_pixel = False
        self._levels = (0.0, 1.0)
        self._build_tools()
        self._build_body()
        self._build_keys()
        context.theme_changed.connect(self._apply_theme)
        self._open()

    # -- building --------------------------------------------------------------------------------------
    def _build_tools(self) -> None:
        self.tool_button("Open H …", "An H file, a MATLAB v7.3 file or an .npy array", self.choose_file)
        self.tool_button("Reference …", "An H to compare with: simulated or earlier", self.choose_reference)
        self.tool_button("Export …", "H and HT for a deconvolution code", self.export)

    def _build_body(self) -> None:
        self.main_view, self.linked_view = ImageView(), ImageView()
        self.main_title, self.linked_title = QLabel(), QLabel()
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        for label in (self.main_title, self.linked_title):
            label.setProperty("role", "heading")
        self.main_view.hovered.connect(self._hovered)
        self.main_view.clicked.connect(self._pin)
        self.map = PeriodMap()
        self.map.chosen.connect(lambda y, x: self.set_intent(y=y, x=x))
        self.strip = DepthStrip(64)
        self.strip.chosen.connect(lambda z: self.set_intent(z=z))
        self.profile = LinePlot("pixel from the cutout's centre (px)", "intensity (counts)", legend=True)
        self.sum_view = ImageView()
        self.outline = pg.PlotCurveItem(pen=pg.mkPen("#ff5a5f", width=2))
        self.sum_view.add_overlay(self.outline)
        self.aperture_text = QLabel()
        self.aperture_text.setTextFormat(Qt.TextFormat.RichText)
        self.aperture_text.setWordWrap(True)
        grid = QGridLayout(self.body)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(8)
        grid.addWidget(self._controls(), 0, 0, 2, 1)
        grid.addWidget(_titled(self.main_title, self.main_view), 0, 1)
        grid.addWidget(_titled(self.linked_title, self.linked_view), 0, 2)
        grid.addWidget(_titled(QLabel("Line profiles through the pixel under the pointer"), self.profile), 1, 1)
        grid.addWidget(self._aperture_panel(), 1, 2)
        grid.addWidget(self.strip, 2, 0, 1, 3)
        grid.setColumnStretch(1, 1)
        grid.setColumnStretch(2, 1)
        grid.setRowStretch(0, 7)
        grid.setRowStretch(1, 4)

    def _controls(self) -> QWidget:
        panel = QFrame()
        panel.setProperty("role", "card")
        panel.setFixedWidth(244)
        column = QVBoxLayout(panel)
        column.setContentsMargins(12, 10, 12, 12)
        column.setSpacing(7)
        row = QHBoxLayout()
        self.h_button, self.ht_button = QPushButton("H"), QPushButton("HT")
        for button, transposed, tip in (
            (self.h_button, False, "Pattern on the sensor of one source position (T)"),
            (self.ht_button, True, "Pattern in the volume seen by one pixel: the transposed matrix (T)"),
        ):
            button.setCheckable(True)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, t=transposed: self.set_intent(transposed=t))
            row.addWidget(button)
        column.addLayout(row)
        self.plane_label = QLabel()
        self.plane_label.setWordWrap(True)
        self.plane_slider = QSlider(Qt.Orientation.Horizontal)
        self.plane_slider.setToolTip("Depth plane (page up, page down)")
        self.plane_slider.valueChanged.connect(lambda z: self.set_intent(z=z))
        column.addWidget(self.plane_label)
        column.addWidget(self.plane_slider)
        self.position_label = QLabel()
        column.addWidget(self.position_label)
        column.addWidget(self.map, 1)
        self.show_box = _combo((("measured", "measured"), ("reference", "reference"), ("difference", "difference")))
        self.show_box.setToolTip("Measured H, the reference, or measured - reference at equal energy")
        self.show_box.currentIndexChanged.connect(lambda _: self.set_intent(show=self.show_box.currentData()))
        self.scale_box = _combo((("linear", "linear"), ("log", "log, 4 decades"), ("gamma", "gamma 0.5")))
        self.scale_box.setToolTip("How intensity becomes colour (L: log, G: gamma)")
        self.scale_box.currentIndexChanged.connect(lambda _: self._set_display(scale=self.scale_box.currentData()))
        self.map_box = _combo(tuple((name, name) for name in COLOUR_MAPS))
        self.map_box.setToolTip("Colour map; all are perceptually even")
        self.map_box.currentIndexChanged.connect(lambda _: self._set_display(colour_map=self.map_box.currentData()))
        for text, box in (("Show", self.show_box), ("Scaling", self.scale_box), ("Colours", self.map_box)):
            line = QHBoxLayout()
            line.addWidget(QLabel(text))
            line.addWidget(box, 1)
            column.addLayout(line)
        self.own_scale = QCheckBox("Each picture fills the scale")
        self.own_scale.setToolTip("Off: all positions of a plane share one scale, so that they can be compared")
        self.own_scale.toggled.connect(lambda _: self._show_picture())
        column.addWidget(self.own_scale)
        self.readout.setWordWrap(True)
        self.readout.setMinimumHeight(50)
        column.addWidget(self.readout)
        return panel

    def _aperture_panel(self) -> QWidget:
        panel = QFrame()
        panel.setProperty("role", "card")
        row = QHBoxLayout(panel)
        row.setContentsMargins(8, 6, 8, 6)
        left = QVBoxLayout()
        title = QLabel("Aperture from the depth-plane sum")
        title.setProperty("role", "heading")
        left.addWidget(title)
        left.addWidget(self.sum_view, 1)
        row.addLayout(left, 3)
        self.aperture_text.setMinimumWidth(150)
        row.addWidget(self.aperture_text)
        return panel

    def _build_keys(self) -> None:
        for keys, action in (
            ("Left", lambda: self._step(0, -1)),
            ("Right", lambda: self._step(0, 1)),
            ("Up", lambda: self._step(-1, 0)),
            ("Down", lambda: self._step(1, 0)),
            ("PgUp", lambda: self.set_intent(z=self.intent.z - 1)),
            ("PgDown", lambda: self.set_intent(z=self.intent.z + 1)),
            ("T", lambda: self.set_intent(transposed=not self.intent.transposed)),
            ("L", lambda: self._toggle_scale("log")),
            ("G", lambda: self._toggle_scale("gamma")),
        ):
            shortcut = QShortcut(QKeySequence(keys), self)
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(action)

    # -- files -----------------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Open what the session names now."""
        if (old.psf, old.reference) != (new.psf, new.reference):
            self._open()

    def _open(self) -> None:
        state = self.context.state
        self.plane = self.reference_plane = None
        try:
            self.matrix = self.context.matrix(state.psf)
            self.reference = self.context.matrix(state.reference)
        except LfcalError as error:
            self.matrix = None
            self.context.message.emit(str(error))
        matrix = self.matrix
        if self.reference is not None and matrix is not None and self.reference.shape != matrix.shape:
            self.context.message.emit(f"the reference has shape {self.reference.shape}, H {matrix.shape}: not compared")
            self.reference = None
        if matrix is None:
            text = "No PSF yet.\nAssemble frames, simulate one, or open an H file, a MATLAB v7.3 file or an .npy array."
            self.show_empty(
                text,
                {
                    "Open H …": self.choose_file,
                    "Frames": lambda: self.context.go.emit("frames", None),
                    "Simulate": lambda: self.context.go.emit("simulate", None),
                },
            )
            return
        self.show_body()
        nz = matrix.shape[0]
        self.hint.setText(f"{Path(state.psf).name}: (z, y, x, t, s) = {matrix.shape}, {format_bytes(matrix.nbytes)}")
        self.plane_slider.setRange(0, nz - 1)
        self.plane_slider.setEnabled(nz > 1)
        self.strip.set_planes(matrix.depths)
        self.show_box.setEnabled(self.reference is not None)
        self._load_sums(matrix)
        unit = "share of the light" if "simulated" in matrix.provenance else "intensity (counts)"
        for view in (self.main_view, self.linked_view, self.sum_view):
            view.set_value_label(unit)
        self.profile.set_labels("pixel from the cutout's centre (px)", unit)
        self.set_intent(z=nz // 2, y=matrix.period[0] // 2, x=matrix.period[1] // 2, pixel=None)

    def _load_sums(self, matrix: PSFMatrix) -> None:
        """Compute what is known of each plane in the background, one plane after the other."""

        def load(z: int) -> None:
            if z < len(matrix) and matrix is self.matrix:
                self.context.jobs.compute("psf sums", lambda: matrix.depth_sum(z), lambda image: done(z, image))

        def done(z: int, image: NDArray[Any]) -> None:
            if matrix is self.matrix:
                self.strip.set_sum(z, image)
                load(z + 1)

        load(0)

    def choose_file(self) -> None:
        """Ask for an H file."""
        path = QFileDialog.getOpenFileName(self, "Open H", "", "PSF matrices (*.h5 *.mat *.npy)")[0]
        if path:
            self.context.session.update("open H", psf=path)

    def choose_reference(self) -> None:
        """Ask for a reference."""
        path = QFileDialog.getOpenFileName(self, "Open reference", "", "PSF matrices (*.h5 *.mat *.npy)")[0]
        if path:
            self.context.session.update("open reference", reference=path)

    def export(self, path: str = "") -> None:
        """Export H (and Ht) as a job."""
        from lfcal.psf import iter_export

        matrix = self.matrix
        if matrix is None:
            return
        kinds = "MATLAB v7.3 with H and Ht (*.mat);;numpy (*.npy);;TIFF stacks (*.tif);;H file (*.h5)"
        path = path or QFileDialog.getSaveFileName(self, "Export H", "H.mat", kinds)[0]
        if path:
            self.context.jobs.start(
                f"Export {Path(path).name}",
                "psf",
                lambda: iter_export(matrix, path),
                lambda out: self.context.message.emit(f"exported {out}"),
            )

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped H file."""
        if len(paths) == 1 and Path(paths[0]).suffix.lower() in SUFFIXES:
            self.context.session.update("open H", psf=paths[0])
            return True
        return False

    def receive(self, payload: Any) -> None:
        """Show a position (z, y, x) another page sent."""
        if isinstance(payload, tuple) and len(payload) == 3:
            self.set_intent(z=payload[0], y=payload[1], x=payload[2])

    # -- intent ----------------------------------------------------------------------------------------
    def set_intent(self, **changes: Any) -> None:
        """Change what is asked for, and show it."""
        if self.matrix is None:
            return
        self.intent = replace(self.intent, **changes).clamped(self.matrix.shape)
        self._show_controls()
        if self.plane is None or self.plane.z != self.intent.z:
            self._load_plane()
        else:
            self._show_picture()

    def _set_display(self, **changes: Any) -> None:
        self.intent = replace(self.intent, display=replace(self.intent.display, **changes))
        for view in (self.main_view, self.linked_view, self.sum_view):
            if view is self.sum_view or self.intent.show != "difference":
                view.set_display(self.intent.display)

    def _toggle_scale(self, scale: str) -> None:
        chosen = "linear" if self.intent.display.scale == scale else scale
        self.scale_box.setCurrentIndex(self.scale_box.findData(chosen))

    def _step(self, dy: int, dx: int) -> None:
        if self.matrix is not None:
            moved = self.intent.moved(dy, dx, self.matrix.period)
            self.set_intent(y=moved.y, x=moved.x)

    # -- data --------------------------------------------------------------------------------------------
    def _load_plane(self) -> None:
        """Read the plane in the background; the newest wish wins."""
        matrix, reference, z = self.matrix, self.reference, self.intent.z
        assert matrix is not None
        self.plane = None
        self.readout.setText(f"reading plane {z} …")

        def read() -> PlaneData:
            plane = LoadedPlane(z, matrix.plane(z))
            other = None if reference is None else LoadedPlane(z, reference.plane(z))
            low, high = float(plane.values.min()), float(plane.values.max())
            energy = plane.values.sum((2, 3), dtype=np.float64)
            return PlaneData(
                plane, other, energy, matrix.depth_sum(z), (min(low, 0.0), high if high > low else low + 1)
            )

        self.context.jobs.compute("psf plane", read, self._plane_read, self.context.message.emit)

    def _plane_read(self, loaded: PlaneData) -> None:
        self.plane, self.reference_plane, self._levels = loaded.plane, loaded.reference, loaded.levels
        matrix = self.matrix
        if matrix is None or self.plane.z != self.intent.z:
            return
        self.readout.setText("Hover a pixel to see the voxel pattern it belongs to; click to hold it.")
        self.map.set_values(loaded.energy, matrix.recorded[self.plane.z])
        ct, cs = (n // 2 for n in matrix.cutout)
        self.sum_view.set_image(loaded.depth_sum, name="depth_sum", origin=(-ct, -cs))
        self.outline.setData([], [])
        self.aperture_text.setText("fitting the aperture …")
        self.context.jobs.compute(
            "psf aperture", lambda: matrix.aperture(loaded.plane.z), self._show_aperture, self.aperture_text.setText
        )
        self._show_picture()

    # -- showing -----------------------------------------------------------------------------------------
    def _show_controls(self) -> None:
        matrix, intent = self.matrix, self.intent
        assert matrix is not None
        depth = float(matrix.depths[intent.z])
        virtual = f", v = {matrix.camera.virtual_depth(depth):.2f}" if matrix.camera is not None else ""
        self.plane_label.setText(f"Plane {intent.z} of {len(matrix)}: z = {format_length(depth)}{virtual}")
        self.position_label.setText(
            f"Position y {intent.y}, x {intent.x} of {matrix.period[0]} × {matrix.period[1]} px"
        )
        self.plane_slider.blockSignals(True)
        self.plane_slider.setValue(intent.z)
        self.plane_slider.blockSignals(False)
        self.strip.set_current(intent.z)
        self.map.set_position(intent.y, intent.x)
        self.h_button.setChecked(not intent.transposed)
        self.ht_button.setChecked(intent.transposed)

    def _show_picture(self) -> None:
        if self.plane is None:
            return
        picture = resolve(self.intent, self.plane, self.reference_plane)
        for view, image, cursor in (
            (self.main_view, picture.main, picture.main_cursor),
            (self.linked_view, picture.linked, picture.linked_cursor),
        ):
            if picture.signed != view.signed:
                view.set_signed(picture.signed, self.intent.display)
            view.set_image(image, name="psf", levels=self._scale_of(image))
            view.set_cursor(*(cursor or (None, None)))
        self.main_title.setText(picture.main_title)
        self.linked_title.setText(picture.linked_title)
        self._show_profile(picture.main)

    def _scale_of(self, image: NDArray[Any]) -> tuple[float, float] | None:
        """Return the levels of a picture: those of the whole plane, unless it is to fill the scale by itself."""
        if self.intent.show != "measured" or self.own_scale.isChecked():
            return None
        return self._levels

    def _show_profile(self, image: NDArray[Any]) -> None:
        ct, cs = (n // 2 for n in image.shape)
        t, s = self.intent.pixel or (ct, cs)
        levels = self._scale_of(image)
        if levels is not None:
            self.profile.plot.setYRange(*levels, padding=0.02)
        else:
            self.profile.plot.enableAutoRange("y")
        self.profile.set_curve("along the row", np.arange(image.shape[1]) - cs, image[t])
        self.profile.set_curve("along the column", np.arange(image.shape[0]) - ct, image[:, s])

    def _hovered(self, row: int, column: int, value: float) -> None:
        if self._frozen_pixel or self.plane is None:
            return
        pixel = None if row < 0 else (row, column)
        if pixel != self.intent.pixel:
            self.set_intent(pixel=pixel)
        if pixel is not None:
            self.readout.setText(f"t {row}, s {column}: {value:.5g} counts")

    def _pin(self, row: int, column: int) -> None:
        self._frozen_pixel = not self._frozen_pixel
        self.set_intent(pixel=(row, column))

    def _show_aperture(self, aperture: Aperture) -> None:
        if self.matrix is None:
            return
        ct, cs = (n // 2 for n in self.matrix.cutout)
        outline = aperture.outline()
        self.outline.setData(outline[:, 1] - cs, outline[:, 0] - ct)
        self.aperture_text.setText(aperture_words(aperture))

    def _apply_theme(self) -> None:
        for widget in (self.main_view, self.linked_view, self.sum_view, self.map, self.profile):
            widget.apply_theme()


def aperture_words(aperture: Aperture) -> str:
    """Return the numbers of a fitted aperture as rich text, with what it refuses to say."""
    from lfcal.psf.aperture.shape import REFUSALS

    refused = f"<p><b>{aperture.refusal}</b>: {REFUSALS[aperture.refusal]}</p>" if aperture.refusal else ""
    row, column = aperture.centre
    lines = (
        ("Blades", f"{aperture.blades}"),
        ("Rotation", f"{np.degrees(aperture.rotation_rad):.1f}°"),
        ("Centre t", f"{row:.2f} px"),
        ("Centre s", f"{column:.2f} px"),
        ("Apothem", f"{aperture.apothem_px:.2f} px"),
        ("Area", f"{aperture.area_px2:.0f} px²"),
        ("Curvature", f"{aperture.curvature:.2f}"),
        ("Edge blur", f"{aperture.blur_px:.2f} px"),
        ("Ellipticity", f"{100 * aperture.ellipticity:.1f} %"),
        ("Confidence", f"{100 * aperture.confidence:.0f} %"),
    )
    cells = "".join(
        f"<tr><td style='padding-right:10px'>{a}</td><td style='white-space:nowrap'><b>{b}</b></td></tr>"
        for a, b in lines
    )
    return f"{refused}<table>{cells}</table>"


def _titled(title: QLabel, content: QWidget) -> QFrame:
    frame = QFrame()
    frame.setProperty("role", "card")
    layout = QVBoxLayout(frame)
    layout.setContentsMargins(8, 6, 8, 6)
    layout.setSpacing(4)
    title.setProperty("role", "heading")
    title.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
    layout.addWidget(title)
    layout.addWidget(content, 1)
    return frame


def _combo(choices: tuple[tuple[str, str], ...]) -> QComboBox:
    box = QComboBox()
    for value, text in choices:
        box.addItem(text, value)
    return box
