"""Sessions: gallery with filter and facts of the selection, reports over time, and comparison of two results."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from PySide6.QtCore import QSignalBlocker, Qt
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QStackedWidget,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from lfcal_gui.pages.sessions._tiles import ResultTiles
from lfcal_gui.pages.sessions.model import KIND_WORDS, ORDERS, PROJECT, SessionsSettings
from lfcal_gui.pages.sessions.trend_panel import TrendPanel
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import (
    ComparePanel,
    ElidedLabel,
    RowsTable,
    choice_box,
    heading,
    line,
    name_controls,
    split,
    told_or_shown,
)

FACTS = ("What", "Value")
PAIR = ("What", "First", "Second", "")
ONE = "Select a result to see its details, or two results (Ctrl+click) to compare them."
NO_PAIR = "Select two results in the gallery, then press Compare (Ctrl+D)."
TIPS = (
    "Recordings, H, fits, reports, exports and volumes in a folder",
    "The quality reports of the gallery as curves over time, to see whether the setup drifts",
    "Comparison of the two results selected in the gallery",
)


class SessionsPanel(QTabWidget):
    """Panel with three views: gallery, reports over time, comparison of two results."""

    def __init__(self) -> None:
        super().__init__()
        self.setDocumentMode(True)
        self.trend = TrendPanel()
        self.pair_table = RowsTable(PAIR, 0)
        self.pair_table.setAccessibleName("Details of both results")
        self.pair_stack = self._pair()
        for (tab, title), tip in zip(
            ((self._gallery(), "Gallery"), (self.trend, "Over time"), (self.pair_stack, "Compare")), TIPS, strict=True
        ):
            self.setTabToolTip(self.addTab(tab, title), tip)

    # -- building --------------------------------------------------------------------------------------
    def _gallery(self) -> QWidget:
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 2, 0, 0)
        column.setSpacing(4)
        column.addLayout(self._where())
        column.addLayout(self._which())
        self.tiles = ResultTiles()
        self.message, self.stack = told_or_shown("", self.tiles)
        column.addWidget(split(self.stack, self._facts(), sizes=(780, 300)), 1)
        column.addWidget(self.status)
        return inner

    def _where(self) -> QHBoxLayout:
        self.folder = QComboBox()
        self.folder.setAccessibleName("Folder")
        self.folder.setToolTip("Folder to search, with its subfolders")
        self.folder.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choose_button, self.again_button = QPushButton("Choose …"), QPushButton("Search again")
        self.choose_button.setToolTip("Search another folder, and add this folder to the list")
        self.again_button.setToolTip("Search the folder again (F5)")
        self.status = ElidedLabel(" ", role="hint")
        return line("Folder", self.folder, self.choose_button, self.again_button, stretch=1)

    def _which(self) -> QHBoxLayout:
        self.words = QLineEdit(placeholderText="Filter by name, verdict, camera …")
        self.words.setToolTip("Show only results with all of these words in their name, folder, verdict or details")
        self.words.setAccessibleName("Filter")
        self.kind = choice_box(list(KIND_WORDS.items()), "Show results of one kind", "kind")
        self.order = choice_box(ORDERS, "Order of the tiles", "order")
        self.counted = QLabel(" ")
        self.counted.setProperty("role", "hint")
        return line(self.words, self.kind, self.order, self.counted, stretch=0)

    def _facts(self) -> QWidget:
        self.facts = RowsTable(FACTS, 1)
        self.facts.setAccessibleName("Details of the selected result")
        self.facts.setSortingEnabled(False)
        self.facts_title = ElidedLabel(role="heading")
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 0, 0)
        column.addWidget(self.facts_title)
        self.facts_message, self.facts_stack = told_or_shown(ONE, self.facts)
        column.addWidget(self.facts_stack, 1)
        return inner

    def _pair(self) -> QStackedWidget:
        stack = QStackedWidget()
        none = QLabel(NO_PAIR)
        none.setAlignment(Qt.AlignmentFlag.AlignCenter)
        none.setProperty("role", "hint")
        table = QWidget()
        column = QVBoxLayout(table)
        column.setContentsMargins(0, 8, 0, 0)
        self.pair_title = heading("")
        column.addWidget(self.pair_title)
        column.addWidget(self.pair_table, 1)
        for part in (none, table):
            stack.addWidget(part)
        return stack

    @cached_property
    def compare(self) -> ComparePanel:
        """Comparison of two H, which is created on demand."""
        made = ComparePanel()
        made.choose_button.hide()  # both are chosen in the gallery
        self.pair_stack.addWidget(made)
        name_controls(made)
        return made

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: SessionsSettings, folders: Sequence[str]) -> None:
        """Show the settings; ``folders`` are the recently used ones."""
        blockers = [QSignalBlocker(box) for box in (self.folder, self.kind, self.order)]
        self.folder.clear()
        self.folder.addItem("Folders of this project", PROJECT)
        for one in folders:
            self.folder.addItem(one, one)
        for box, value in ((self.folder, settings.folder), (self.kind, settings.kind), (self.order, settings.order)):
            box.setCurrentIndex(max(0, box.findData(value)))
        for blocker in blockers:
            blocker.unblock()

    def show_message(self, words: str) -> None:
        """Show a message in place of the tiles; empty: show the tiles."""
        self.message.setText(words)
        self.stack.setCurrentIndex(0 if words else 1)

    def show_facts(self, title: str, rows: Sequence[tuple[str, str]]) -> None:
        """Show the facts of the selected result; without rows, explain how to select one."""
        self.facts_title.setText(title)
        self.facts.show_rows(rows)
        self.facts.setSortingEnabled(False)
        self.facts_stack.setCurrentIndex(int(bool(rows)))

    def show_pair(self, names: tuple[str, str], rows: Sequence[tuple[str, str, str, str]]) -> None:
        """Show facts of two results side by side."""
        self.pair_table.setHorizontalHeaderLabels(["What", *names, ""])
        self.pair_title.setText(f"{names[0]} and {names[1]}")
        self.pair_table.show_rows(rows, colour=lambda row, column: current_theme().fair if column == 3 else "")
        self.pair_stack.setCurrentIndex(1)
        self.setCurrentWidget(self.pair_stack)

    def show_compared(self) -> None:
        """Show the comparison of two H."""
        self.pair_stack.setCurrentWidget(self.compare)
        self.setCurrentWidget(self.pair_stack)

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        if "compare" in self.__dict__:
            self.compare.apply_theme()
        self.trend.apply_theme()
        self.tiles.forget_pictures()
