"""Frames: look at them, clean them, see the cutout move with the point, assemble H."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QCheckBox,
    QComboBox,
    QFileDialog,
    QFrame,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from gui.base_page import StagePage
from gui.context import Context
from gui.models.display import Display
from gui.models.frame_view import FrameNumbers, frame_numbers
from gui.models.page import Stage
from gui.models.project import FrameSettings, SessionState
from gui.theme import current_theme
from gui.widgets.frame_view import FrameView
from gui.widgets.period_map import PeriodMap
from gui.widgets.plots import LinePlot
from lfcal.camera import ScanPlan
from lfcal.errors import LfcalError
from lfcal.frames.source import FrameSource, Position

__all__ = ["Page"]


@dataclass(frozen=True, eq=False)
class Opened:
    """The frames of a session: source, correction chain, and which frame shows which position."""

    source: FrameSource
    chain: Any
    frames: NDArray[np.int64]
    plan: ScanPlan


@dataclass(frozen=True, eq=False)
class Loaded:
    """One frame, before and after correction, with its numbers."""

    position: Position
    label: str
    raw: NDArray[Any]
    fixed: NDArray[np.float32]
    numbers: FrameNumbers


class Page(StagePage):
    """Frames on the left, the frame in the middle, what was found on the right."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.opened: Opened | None = None
        self.loaded: Loaded | None = None
        self.position = Position(0, 0, 0)
        self.tool_button("Open frames …", "A folder of frames with a manifest, or one file of many", self.choose_folder)
        self.assemble_button = self.tool_button(
            "Assemble H", "Correct, crop and stack all frames into H", self.assemble, primary=True
        )
        self.play_timer = QTimer(self)
        self.play_timer.setInterval(60)
        self.play_timer.timeout.connect(lambda: self._step(0, 1))
        self._build()
        self._keys()
        context.theme_changed.connect(self._apply_theme)
        self._open()

    # -- building --------------------------------------------------------------------------------------
    def _build(self) -> None:
        self.view = FrameView(self.context.jobs, "frame view")
        self.view.hovered.connect(self._hovered)
        self.map = PeriodMap()
        self.map.chosen.connect(lambda y, x: self.go_to(Position(self.position.z, y, x)))
        self.histogram = LinePlot("sample value (counts)", "pixels")
        self.histogram.plot.setLogMode(False, True)
        self.histogram.setFixedHeight(180)
        self.numbers = QLabel()
        self.numbers.setTextFormat(Qt.TextFormat.RichText)
        self.numbers.setWordWrap(True)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        row = QHBoxLayout(self.body)
        row.setContentsMargins(0, 0, 0, 0)
        row.setSpacing(10)
        row.addWidget(self._left())
        middle = QWidget()
        column = QVBoxLayout(middle)
        column.setContentsMargins(0, 0, 0, 0)
        column.addLayout(self._bar())
        column.addWidget(self.view, 1)
        column.addWidget(self.readout)
        row.addWidget(middle, 1)

    def _bar(self) -> QHBoxLayout:
        row = QHBoxLayout()
        self.lattice_box = QCheckBox("Lattice")
        self.lattice_box.setToolTip("Micro-image centres of the described camera, coloured by lens type")
        self.lattice_box.toggled.connect(lambda _: self._show_overlays())
        self.before_box = QCheckBox("Before correction")
        self.before_box.setToolTip("Show the frame as it was recorded")
        self.before_box.toggled.connect(lambda _: self._show_frame())
        self.scale_box = QComboBox()
        for value, text in (("linear", "linear"), ("gamma", "gamma 0.5"), ("log", "log, 4 decades")):
            self.scale_box.addItem(text, value)
        self.scale_box.setToolTip("How intensity becomes colour (L: log, G: gamma)")
        self.scale_box.currentIndexChanged.connect(lambda _: self._show_display())
        whole, cutout = QPushButton("Whole frame"), QPushButton("Cutout")
        whole.clicked.connect(self.view.show_all)
        cutout.clicked.connect(self._zoom_cutout)
        for widget in (self.lattice_box, self.before_box, self.scale_box):
            row.addWidget(widget)
        row.addStretch()
        row.addWidget(whole)
        row.addWidget(cutout)
        return row

    def _left(self) -> QWidget:
        panel = QFrame()
        panel.setProperty("role", "card")
        column = QVBoxLayout(panel)
        column.setContentsMargins(12, 10, 12, 10)
        self.position_label = QLabel()
        self.position_label.setProperty("role", "heading")
        self.position_label.setWordWrap(True)
        column.addWidget(self.position_label)
        self.plane_slider = QSlider(Qt.Orientation.Horizontal)
        self.plane_slider.setToolTip("Depth plane (page up, page down)")
        self.plane_slider.valueChanged.connect(lambda z: self.go_to(self.position._replace(z=z)))
        row = QHBoxLayout()
        row.addWidget(QLabel("Plane"))
        row.addWidget(self.plane_slider, 1)
        self.play_button = QPushButton("Play")
        self.play_button.setCheckable(True)
        self.play_button.setToolTip("Step through the positions (space)")
        self.play_button.toggled.connect(self._play)
        row.addWidget(self.play_button)
        column.addLayout(row)
        self.map.setFixedHeight(190)
        column.addWidget(self.map)
        heading = QLabel("Corrections")
        heading.setProperty("role", "heading")
        column.addWidget(heading)
        self.boxes: dict[str, QCheckBox] = {}
        for key, text, tip in (
            ("use_dark", "Dark frame", "Subtract the mean dark frame"),
            ("use_white", "White frame", "Divide by the relative brightness of the white frame"),
            ("use_defects", "Defect pixels", "Find pixels that do not measure light, over all frames; repair them"),
            ("use_background", "Background", "Subtract the median of each frame's border"),
        ):
            box = QCheckBox(text)
            box.setToolTip(tip)
            box.toggled.connect(lambda on, key=key: self._set_frames(f"{key[4:]} correction", **{key: on}))
            self.boxes[key] = box
        grid = QHBoxLayout()
        for pair in (("use_dark", "use_white"), ("use_defects", "use_background")):
            part = QVBoxLayout()
            for key in pair:
                part.addWidget(self.boxes[key])
            grid.addLayout(part)
        column.addLayout(grid)
        heading = QLabel("Histogram of the frame as recorded")
        heading.setProperty("role", "heading")
        column.addWidget(heading)
        column.addWidget(self.histogram)
        column.addWidget(self.numbers)
        column.addStretch()
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setWidget(panel)
        area.setFixedWidth(320)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        return area

    def _keys(self) -> None:
        actions: tuple[tuple[str, Callable[[], object]], ...] = (
            ("Left", lambda: self._step(0, -1)),
            ("Right", lambda: self._step(0, 1)),
            ("Up", lambda: self._step(-1, 0)),
            ("Down", lambda: self._step(1, 0)),
            ("PgUp", lambda: self.plane_slider.setValue(self.position.z - 1)),
            ("PgDown", lambda: self.plane_slider.setValue(self.position.z + 1)),
            ("Space", self.play_button.toggle),
            ("L", lambda: self._toggle_scale("log")),
            ("G", lambda: self._toggle_scale("gamma")),
        )
        for keys, action in actions:
            shortcut = QShortcut(QKeySequence(keys), self)
            shortcut.setContext(Qt.ShortcutContext.WidgetWithChildrenShortcut)
            shortcut.activated.connect(action)

    # -- session ---------------------------------------------------------------------------------------
    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Open what the session names now."""
        if old.frames != new.frames or old.plan != new.plan:
            self._open()

    def _set_frames(self, label: str, **changes: Any) -> None:
        self.context.session.update(label, frames=replace(self.context.state.frames, **changes))

    def choose_folder(self) -> None:
        """Ask for a folder of frames."""
        path = QFileDialog.getExistingDirectory(self, "Folder of frames")
        if path:
            self.open_folder(path)

    def open_folder(self, path: str) -> None:
        """Take the frames of a folder; dark, white and plan beside it are found."""
        folder = Path(path)
        around = folder if (folder / "frames").is_dir() else folder.parent
        frames = folder / "frames" if (folder / "frames").is_dir() else folder
        changes: dict[str, Any] = {}
        plan = around / "plan.json"
        if plan.is_file():
            try:
                changes["plan"] = ScanPlan.from_json(plan.read_text(encoding="utf-8"))
                changes["camera"] = changes["plan"].camera
            except (LfcalError, OSError) as error:
                self.context.message.emit(str(error))
        found = {name: str(around / name) for name in ("dark", "white") if (around / name).is_dir()}
        settings = replace(
            self.context.state.frames,
            folder=str(frames),
            manifest="",
            pattern="",
            dark=found.get("dark", ""),
            white=found.get("white", ""),
        )
        self.context.session.update("open frames", frames=settings, **changes)

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped folder of frames."""
        if len(paths) == 1 and Path(paths[0]).is_dir():
            self.open_folder(paths[0])
            return True
        return False

    def receive(self, payload: Any) -> None:
        """Show a position (z, y, x) another page sent."""
        if isinstance(payload, tuple) and len(payload) == 3:
            self.go_to(Position(*payload))

    def _open(self) -> None:
        state = self.context.state
        for key, box in self.boxes.items():
            box.blockSignals(True)
            box.setChecked(getattr(state.frames, key))
            box.blockSignals(False)
        self.boxes["use_dark"].setEnabled(bool(state.frames.dark))
        self.boxes["use_white"].setEnabled(bool(state.frames.white))
        self.opened = None
        self.assemble_button.setEnabled(False)
        if not state.frames.folder:
            self.show_empty(
                "No frames yet.\nOpen a folder with a manifest (file, z, y, x), or record a session.\n"
                "Folders named dark and white beside it, and plan.json, are found.",
                {"Open frames …": self.choose_folder},
            )
            return
        if state.plan is None:
            self.show_empty(
                "The frames need a scan plan: which positions, which cutout.",
                {"Plan": lambda: self.context.go.emit("plan", None)},
            )
            return
        self.show_body()
        plan, settings = state.plan, state.frames
        self.position_label.setText("opening frames …")
        self.context.jobs.compute("frames open", lambda: open_session(settings, plan), self._opened, self._failed)

    def _failed(self, words: str) -> None:
        self.show_empty(words, {"Open frames …": self.choose_folder})
        self.context.message.emit(words)

    def _opened(self, opened: Opened) -> None:
        self.opened = opened
        self.assemble_button.setEnabled(True)
        nz = opened.frames.shape[0]
        self.hint.setText(f"{len(opened.source)} frames of {opened.source.shape[1]} × {opened.source.shape[0]} px")
        self.plane_slider.setRange(0, nz - 1)
        self.plane_slider.setEnabled(nz > 1)
        self._show_map()
        self.go_to(self.position)

    # -- stepping --------------------------------------------------------------------------------------
    def go_to(self, position: Position) -> None:
        """Show the frame of a position."""
        if self.opened is None:
            self.position = position
            return
        shape = self.opened.frames.shape
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip(position, shape, strict=True))
        changed_plane = z != self.position.z
        self.position = Position(z, y, x)
        self.plane_slider.blockSignals(True)
        self.plane_slider.setValue(z)
        self.plane_slider.blockSignals(False)
        self.map.set_position(y, x)
        if changed_plane:
            self._show_map()
        index = int(self.opened.frames[self.position])
        if index < 0:
            self.position_label.setText(f"z {z}, y {y}, x {x}: no frame")
            self.view.set_frame(None, (0, 1))
            return
        opened, where = self.opened, self.position
        self.context.jobs.compute("frames load", lambda: load_frame(opened, where), self._loaded, self._failed)

    def _step(self, dy: int, dx: int) -> None:
        if self.opened is None:
            return
        _, ny, nx = self.opened.frames.shape
        position = self.position
        x = position.x + dx
        y = position.y + dy + (x // nx if dx else 0)
        self.go_to(Position(position.z, y % ny, x % nx))

    def _play(self, on: bool) -> None:
        self.play_button.setText("Stop" if on else "Play")
        (self.play_timer.start if on else self.play_timer.stop)()

    def _toggle_scale(self, scale: str) -> None:
        chosen = "linear" if self.scale_box.currentData() == scale else scale
        self.scale_box.setCurrentIndex(self.scale_box.findData(chosen))

    # -- showing ---------------------------------------------------------------------------------------
    def _show_map(self) -> None:
        if self.opened is not None:
            plane = self.opened.frames[self.position.z]
            self.map.set_values((plane >= 0).astype(float), (plane >= 0).astype(int))

    def _loaded(self, loaded: Loaded) -> None:
        self.loaded = loaded
        self.position_label.setText(
            f"{loaded.label}\nz {loaded.position.z}, y {loaded.position.y}, x {loaded.position.x}"
        )
        numbers = loaded.numbers
        middle = (numbers.edges[1:] + numbers.edges[:-1]) / 2
        self.histogram.set_curve("pixels", middle, np.maximum(numbers.counts, 0.5))
        theme = current_theme()
        colour = theme.bad if numbers.saturated else theme.text
        self.numbers.setText(
            f"maximum <b>{numbers.high:g}</b> counts<br>minimum <b>{numbers.low:g}</b>, "
            f"mean <b>{numbers.mean:.1f}</b> counts<br>"
            f"<span style='color:{colour}'>saturated pixels: <b>{numbers.saturated}</b></span>"
        )
        self._show_frame()
        self._show_overlays()

    def _show_frame(self) -> None:
        if self.loaded is None:
            return
        frame = self.loaded.raw if self.before_box.isChecked() else self.loaded.fixed
        self.view.set_frame(frame, (float(frame.min()), float(frame.max())))

    def _show_display(self) -> None:
        self.view.set_display(Display(scale=self.scale_box.currentData()))

    def _show_overlays(self) -> None:
        state = self.context.state
        self.view.set_lattice(state.camera if self.lattice_box.isChecked() else None)
        if self.opened is None or self.loaded is None:
            self.view.clear_cutout()
            return
        from lfcal.psf.cutout import Cutout

        cutout = Cutout.for_plan(self.opened.plan)
        window = cutout.window(self.loaded.position)
        point = (self.opened.plan.image_px(self.loaded.position)[0], self.opened.plan.image_px(self.loaded.position)[1])
        self.view.set_cutout(window.row, window.column, cutout.reach, (float(point[0]), float(point[1])))

    def _zoom_cutout(self) -> None:
        if self.opened is None or self.loaded is None:
            return
        from lfcal.psf.cutout import Cutout

        cutout = Cutout.for_plan(self.opened.plan)
        window = cutout.window(self.loaded.position)
        self.view.show_region(window.row, window.column, *cutout.reach)

    def _hovered(self, row: int, column: int, value: float) -> None:
        self.readout.setText(" " if row < 0 else f"row {row}, column {column}: {value:.5g} counts")

    # -- assembly --------------------------------------------------------------------------------------
    def assemble(self, path: str = "") -> None:
        """Assemble H as a job."""
        if self.opened is None:
            return
        path = path or QFileDialog.getSaveFileName(self, "Assemble H", "H.h5", "H file (*.h5)")[0]
        if not path:
            return
        opened = self.opened
        self.context.forget(path)

        def work() -> Any:
            from lfcal.psf import Cutout, iter_assemble

            return iter_assemble(
                opened.source,
                opened.plan.shape[:3],
                Cutout.for_plan(opened.plan),
                path,
                corrections=opened.chain,
                depths=opened.plan.depths_um,
                camera=opened.plan.camera,
                provenance={"plan": opened.plan.to_dict()},
            )

        self.context.jobs.start(f"Assemble {Path(path).name}", "frames", work, self._assembled)

    def _assembled(self, report: Any) -> None:
        path = report.matrix.path
        report.matrix.close()
        for note in report.notes or ("complete: every position once, nothing saturated",):
            self.context.message.emit(f"{Path(path).name}: {note}")
        self.context.attention.emit("frames", bool(report.missing or report.saturated))
        self.context.session.update("assembly", psf=path)

    def _apply_theme(self) -> None:
        for widget in (self.view, self.map, self.histogram):
            widget.apply_theme()


def open_session(settings: FrameSettings, plan: ScanPlan) -> Opened:
    """Open frames and corrections as the settings say; raises what opening raises."""
    from lfcal.frames import open_frames
    from lfcal.frames.corrections.recipe import CorrectionRecipe, build_chain

    source = open_frames(
        settings.folder,
        manifest=settings.manifest or None,
        pattern=settings.pattern or None,
        plan_shape=plan.shape[:3],
    )
    recipe = CorrectionRecipe(
        dark=settings.dark if settings.use_dark else "",
        white=settings.white if settings.use_white else "",
        defects=settings.use_defects,
        background="border" if settings.use_background else "none",
    )
    frames = np.full(plan.shape[:3], -1, np.int64)
    for index in range(len(source)):
        frames[source.position(index)] = index
    return Opened(source, build_chain(source, recipe), frames, plan)


def load_frame(opened: Opened, position: Position) -> Loaded:
    """Read one frame, correct it, count every pixel of it."""
    index = int(opened.frames[position])
    raw = opened.source.read(index)
    level = opened.chain.saturation_level(raw.dtype)
    return Loaded(position, opened.source.label(index), raw, opened.chain.apply(raw), frame_numbers(raw, level))
