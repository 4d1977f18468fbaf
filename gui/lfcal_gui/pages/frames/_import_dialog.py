"""Dialog for the import of frames from other programs: findings, choices, and three frames with their cutouts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSignalBlocker, QSize, Qt, Signal
from PySide6.QtWidgets import (
    QAbstractItemView,
    QComboBox,
    QDialog,
    QFileDialog,
    QFormLayout,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QScrollArea,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from lfcal.camera import Camera, ScanPlan
from lfcal.frames.lists import Column, Table
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Shot, cutout_of, said_in_window
from lfcal_gui.pages.frames._dataset_box import DatasetBox
from lfcal_gui.pages.frames.import_choice import HOLDS, ImportChoice, columns_text, not_held, unit_shown, units_of
from lfcal_gui.pages.frames.model import Loaded
from lfcal_gui.pages.frames.model_import import Survey, survey
from lfcal_gui.pages.frames.orientation import CHOICES
from lfcal_gui.widgets import (
    Picture,
    button,
    choice_box,
    clear,
    column_of,
    heading,
    line,
    scrolling,
    set_role,
    told_or_shown,
    wrapped,
)

WORDS = {"": "unit inferred", "index": "position number"}
NO_UNIT = (("", "no unit"),)
SIZE = QSize(1120, 740)
"""Size of the dialog (px), if the window is large enough."""

SHOWN_ROWS = 3
"""Number of rows of the list that are shown."""


class ColumnsTable(QTableWidget):
    """Table with the first rows of the list, below a row of column roles and a row of units."""

    changed = Signal(str, arguments=["text"])
    """Roles and units of the columns, in the format of ``lfcal assemble --columns``."""

    def __init__(self) -> None:
        super().__init__()
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.verticalHeader().hide()
        self.setAccessibleName("Columns of the list")
        self.setToolTip(
            "First rows of the list. To correct what lfcal found in a column, choose its content and unit above it"
        )
        self.boxes: list[tuple[QComboBox, QComboBox]] = []
        self.names: tuple[str, ...] = ()
        """Names of the columns."""
        self._used: set[str] = set()
        self._without: set[str] = set()
        self.hide()

    def show_table(self, table: Table | None, used: tuple[Column, ...], without: str = "") -> None:
        """Show the list and the roles of its columns; without a list, hide the table."""
        self.setVisible(table is not None)
        if table is None:
            return
        self.names = table.columns
        self._used, self._without = {column.role for column in used}, not_held(without)
        shown = table.rows[:SHOWN_ROWS]
        self.clear()
        self.setColumnCount(len(table.columns))
        self.setRowCount(2 + len(shown))
        self.setHorizontalHeaderLabels(list(table.columns))
        self.boxes = []
        by_name = {column.name: column for column in used}
        for k, name in enumerate(table.columns):
            self._add_boxes(k, by_name.get(name))
            for row, cells in enumerate(shown):
                self.setItem(2 + row, k, QTableWidgetItem(cells[k]))
        self.resizeColumnsToContents()
        for k in range(len(table.columns)):
            self.setColumnWidth(k, max(150, self.columnWidth(k)))
        heights = sum(self.rowHeight(row) for row in range(self.rowCount()))
        self.setFixedHeight(self.horizontalHeader().sizeHint().height() + heights + 18)

    def _add_boxes(self, k: int, column: Column | None) -> None:
        role = choice_box(HOLDS, "Content of this column")
        units = units_of("" if column is None else column.role)
        shown = tuple((name, WORDS.get(name, name)) for name in units) if len(units) > 1 else NO_UNIT
        unit = choice_box(shown, "Unit of this column")
        blockers = [QSignalBlocker(role), QSignalBlocker(unit)]
        role.setCurrentIndex(role.findData("" if column is None else column.role))
        unit.setCurrentIndex(max(0, unit.findData("" if column is None else unit_shown(column.unit))))
        unit.setEnabled(len(units) > 1)
        for one in blockers:
            one.unblock()
        for row, box in enumerate((role, unit)):
            box.currentIndexChanged.connect(self._changed)
            self.setCellWidget(row, k, box)
        self.boxes.append((role, unit))

    def _changed(self) -> None:
        holds = {str(k): (role.currentData(), unit.currentData()) for k, (role, unit) in enumerate(self.boxes, 1)}
        # else a role that the user removed would be found again from the column's name
        without = (self._without | self._used) - {role for role, _ in holds.values()}
        self.changed.emit(columns_text(holds, without))


SHOWN = ("first frame", "middle frame", "last frame")
NO_FRAME = "no frame yet"
HEIGHT = 200
"""Smallest height of a picture (px); lower ones would show only axes."""


class ImportPreviews(QWidget):
    """Three pictures side by side."""

    def __init__(self, jobs: Jobs, *, legend: bool = True) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self.views, self.labels, self.stacks = [], [], []
        for title in SHOWN:
            label, view = heading(title), Picture("sample value (counts)", jobs=jobs, legend=legend)
            view.setMinimumHeight(HEIGHT)
            _, stack = told_or_shown(NO_FRAME, view)
            self.views.append(view)
            self.labels.append(label)
            self.stacks.append(stack)
            row.addLayout(column_of(label, stack, stretch=1))

    def show_frames(self, shown: tuple[Loaded, ...]) -> None:
        """Show up to three frames."""
        for k, (title, label, view) in enumerate(zip(SHOWN, self.labels, self.views, strict=True)):
            # axes around nothing would be read as a picture
            self.stacks[k].setCurrentIndex(int(k < len(shown)))
            label.setText(title)
            if k >= len(shown):
                view.set_shot(None)
                continue
            loaded, (row, column, *shape) = shown[k], shown[k].window
            z, y, x = loaded.position
            label.setText(f"{title}: z {z}, y {y}, x {x}")
            label.setToolTip(loaded.label)
            cutout = cutout_of(row, column, (shape[0], shape[1]), loaded.point)
            view.set_shot(Shot(loaded.raw, name="frame", overlays=cutout), keep_view=False)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for view in self.views:
            view.apply_theme()


FOLDER = "Choose a folder of images; each file is a frame or a stack of frames"
FILE = "Choose one file that contains many frames, or the list of their positions"
LIST = "Choose the table of positions that the stage program wrote"
WELCOME = "Choose a folder of frames, or the list that a stage program wrote."
GROUP = "frames import survey"
WORDS_HEIGHT = 92
"""Height of the findings: five lines (px)."""
LIES = (("", "checked"), *CHOICES[1:])
FIRST = (("", "found"), ("0", "counted from 0"), ("1", "counted from 1"))
ORDER = (
    "Scan order of numbered files without a list: rows alternate in direction (serpentine), "
    "or all have the same direction (raster)"
)
ORDERS = (("", "not stated"), ("serpentine", "serpentine"), ("raster", "raster"))
SHIFTS = (("auto", "found"), ("0", "unchanged"), *((str(n), f"{16 - n} of 16 bits") for n in (2, 4, 6, 8)))


class ImportDialog(QDialog):
    """Dialog that imports frames. It inspects them in the background after each change of the choices."""

    accepted_frames = Signal(object, arguments=["survey"])
    """The user accepts the import: a `Survey` whose frames are open."""

    def __init__(self, jobs: Jobs, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Import frames")
        self._jobs = jobs
        self._plan: ScanPlan | None = None
        self._camera: Camera | None = None
        self.choice = ImportChoice("")
        self.survey: Survey | None = None
        whole, inner = QVBoxLayout(self), QWidget()
        whole.setContentsMargins(16, 12, 16, 12)
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        column.addLayout(self._source())
        self.columns = ColumnsTable()
        self.columns.changed.connect(lambda text: self._say(columns=text, header=self.columns.names))
        column.addWidget(self.columns)
        column.addLayout(self._options())
        self.words = wrapped("", WELCOME)
        self.words.setTextFormat(Qt.TextFormat.PlainText)
        self.words.setAlignment(Qt.AlignmentFlag.AlignTop)
        said = QScrollArea()  # there may be many words, and the pictures count more
        said.setWidgetResizable(True)
        said.setWidget(self.words)
        said.setFixedHeight(WORDS_HEIGHT)
        clear(said)
        column.addWidget(said)
        self.previews = ImportPreviews(jobs)
        column.addWidget(self.previews, 1)
        area = scrolling(inner)
        area.setMinimumWidth(inner.minimumSizeHint().width())
        clear(area)
        whole.addWidget(area, 1)
        whole.addLayout(self._buttons())

    # -- building --------------------------------------------------------------------------------------
    def _source(self) -> QGridLayout:
        grid = QGridLayout()
        self.frames_edit, self.list_edit = QLineEdit(), QLineEdit()
        self.frames_edit.setPlaceholderText("a folder of images, one file with many frames, or a list of frames")
        self.list_edit.setPlaceholderText("found in the folder; none if the names contain positions")
        self.frames_edit.setToolTip("Folder or file of the frames. Press Enter to inspect it")
        self.list_edit.setToolTip(
            "Table of positions or stage coordinates, one line per frame. Optional if the file names contain positions"
        )
        rows = (
            (
                "Frames",
                self.frames_edit,
                (("Folder …", FOLDER, self._ask_folder), ("File …", FILE, self._ask_file)),
            ),
            ("List", self.list_edit, (("List …", LIST, self._ask_list),)),
        )
        for row, (title, edit, buttons) in enumerate(rows):
            edit.setAccessibleName(title)
            edit.editingFinished.connect(self._typed)
            grid.addWidget(QLabel(title), row, 0)
            grid.addWidget(edit, row, 1)
            for column, asking in enumerate(buttons, 2):
                made = button(*asking)
                made.setAutoDefault(False)
                grid.addWidget(made, row, column)
        self._add_names(grid, len(rows))
        self.dataset = DatasetBox()
        self.dataset.chosen.connect(lambda path: self._say(frames=path))
        self.dataset.add_to(grid, len(rows) + 1)
        return grid

    def _add_names(self, grid: QGridLayout, row: int) -> None:
        self.pattern = QLineEdit(placeholderText="z{z}_y{y}_x{x}.tif")
        self.pattern.setAccessibleName("Names")
        self.pattern.setToolTip(
            "Pattern that reads positions from file names; {z}, {y} and {x} are the numbers of the position"
        )
        self.pattern.editingFinished.connect(self._typed)
        self.order = choice_box(ORDERS, ORDER, "Order")
        order = QFormLayout()
        order.addRow("Order", self.order)
        grid.addWidget(QLabel("Names"), row, 0)
        grid.addWidget(self.pattern, row, 1)
        grid.addLayout(order, row, 2, 1, 2)

    def _options(self) -> QHBoxLayout:
        self.first = choice_box(FIRST, "Whether positions in names and lists are counted from 0 or 1")
        self.shift = choice_box(SHIFTS, "Number of bits by which left-aligned samples are shifted to the right")
        self.channel = choice_box((("", "as recorded"),), "One colour of a mosaic or a colour image")
        self.channel.setMinimumContentsLength(10)
        self.orientation = choice_box(LIES, "Rotation or mirroring that gives the frames the orientation of the sensor")
        # its words are long
        self.orientation.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.orientation.setMinimumContentsLength(12)
        row = QHBoxLayout()
        for title, widget in (
            ("Positions", self.first),
            ("Samples", self.shift),
            ("Colour", self.channel),
            ("Orientation", self.orientation),
        ):
            form = QFormLayout()
            form.addRow(title, widget)
            widget.setAccessibleName(title)
            row.addLayout(form, 1)
        for key, box in self._boxes().items():
            box.currentIndexChanged.connect(lambda _, key=key, box=box: self._say(**{key: box.currentData()}))
        return row

    def _boxes(self) -> dict[str, QComboBox]:
        return {
            "order": self.order,
            "first": self.first,
            "shift": self.shift,
            "channel": self.channel,
            "orientation": self.orientation,
        }

    def _buttons(self) -> QHBoxLayout:
        self.open_button = button("Open", "Import these frames as shown above; the files are not changed", self._take)
        self.open_button.setProperty("role", "primary")
        self.open_button.setEnabled(False)
        self.open_button.setDefault(True)
        cancel = button("Cancel", "Close this dialog and keep the current frames of the project", self.reject)
        cancel.setAutoDefault(False)
        return line("", cancel, self.open_button, stretch=0)

    def start(self, plan: ScanPlan | None, camera: Camera | None) -> None:
        """Reset and open the dialog for a project with ``plan``; ``camera`` is used to make a plan from a list."""
        self._plan, self._camera = plan, camera
        self.choice = ImportChoice("")
        self._show_nothing()
        self._show_choice()
        if not self.isVisible():
            self.resize(SIZE.boundedTo(self.parentWidget().window().size()))
        self.open()

    # -- asking ----------------------------------------------------------------------------------------
    def _ask_folder(self) -> None:
        if path := QFileDialog.getExistingDirectory(self, "Folder of frames"):
            self.look_at(path)

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "File that contains many frames, or a list of frames")
        if path:
            self.look_at(path)

    def _ask_list(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "List of the frames", filter="Lists (*.csv *.tsv *.txt *.json)")
        if path:
            self.list_edit.setText(path)
            self._say(listed=path, columns="", frames=self.choice.frames or str(Path(path).parent))

    def _typed(self) -> None:
        frames, listed = self.frames_edit.text().strip(), self.list_edit.text().strip()
        pattern = self.pattern.text().strip()
        if listed and not frames and not self.choice.frames:
            frames = str(Path(listed).parent)
        if (frames, listed, pattern) != (self.choice.frames, self.choice.listed, self.choice.pattern):
            self._say(frames=frames, listed=listed, pattern=pattern)

    def look_at(self, frames: str, listed: str = "") -> None:
        """Inspect other frames; choices for the previous frames are reset."""
        self._say(**vars(ImportChoice(frames, listed)))

    def _say(self, **changes: Any) -> None:
        """Apply a choice and inspect the frames again; a running inspection for earlier choices is dropped."""
        self.choice = replace(self.choice, **changes)
        self._show_choice()
        self._drop()
        if not self.choice.frames:
            self._show_nothing()
            return
        choice, plan, camera = self.choice, self._plan, self._camera
        set_role(self.words, "")
        self.words.setText(f"Inspecting {Path(choice.frames).name} …")
        self._jobs.load(GROUP, lambda: survey(choice, plan, camera), self._found, self._failed, Survey.close)

    def _drop(self) -> None:
        self._jobs.drop(GROUP)
        if self.survey is not None:
            self.survey.close()
        self.survey = None
        self.open_button.setEnabled(False)

    # -- showing ---------------------------------------------------------------------------------------
    def _show_choice(self) -> None:
        choice = self.choice
        boxes = [(box, getattr(choice, key)) for key, box in self._boxes().items()]
        blockers = [QSignalBlocker(box) for box, _ in boxes]
        for box, value in boxes:
            box.setCurrentIndex(max(0, box.findData(value)))
        for edit, text in (
            (self.frames_edit, choice.frames),
            (self.list_edit, choice.listed),
            (self.pattern, choice.pattern),
        ):
            edit.setText(text)
        for one in blockers:
            one.unblock()

    def _show_nothing(self) -> None:
        self._found(Survey(self.choice))
        self.survey = None
        self.words.setText(WELCOME)

    def _failed(self, words: str) -> None:
        self._found(Survey(self.choice, problem=words))

    def _found(self, found: Survey) -> None:
        self.survey, self.choice = found, found.choice
        self.columns.show_table(found.table, found.used, found.choice.columns)
        self.dataset.offer(found.datasets, found.choice.frames)
        _offer(self.channel, self._colours(found), self.choice.channel)
        # show notes of list and plan that are equal only once
        lines = dict.fromkeys(map(said_in_window, filter(None, (found.problem, *found.notes))))
        self.words.setText("\n".join(lines) or "Nothing had to be guessed.")
        set_role(self.words, "error" if found.problem else "")
        self.open_button.setEnabled(found.imported is not None)
        self.previews.show_frames(found.shown)

    def _colours(self, found: Survey) -> tuple[str, ...]:
        """Return the colours to choose from: those found, or those that were offered when one was chosen."""
        if found.colours:
            return found.colours
        offered = tuple(str(self.channel.itemData(k)) for k in range(1, self.channel.count()))
        return offered if self.choice.channel else ()

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.previews.apply_theme()

    def _take(self) -> None:
        found, self.survey = self.survey, None
        if found is not None and found.imported is not None:
            self.accepted_frames.emit(found)
            self.accept()

    def reject(self) -> None:
        """Close the dialog without importing frames."""
        self._drop()
        super().reject()


def _offer(box: QComboBox, colours: tuple[str, ...], chosen: str) -> None:
    with QSignalBlocker(box):
        while box.count() > 1:
            box.removeItem(1)
        for name in colours:
            box.addItem(name, name)
        box.setCurrentIndex(max(0, box.findData(chosen)))
        box.setEnabled(bool(colours))
