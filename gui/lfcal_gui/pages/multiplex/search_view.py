"""The search: what is sought and under which constraints, and the design found with its certificate."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QGridLayout, QHBoxLayout, QLabel, QPushButton, QWidget

from lfcal_gui.models import Shot
from lfcal_gui.pages.multiplex.model_fields import SEARCH_FIELDS
from lfcal_gui.pages.multiplex.model_search import FoundDesign
from lfcal_gui.widgets import FoldedForm, Picture, card, set_role

__all__ = ["SearchView"]


class SearchView(QWidget):
    """Constraints left, the design right.

    Signals
    -------
    search_asked(), use_asked(), save_asked()
        Search; take the design as the page's modulator; write it as ``.npy``.
    """

    search_asked = Signal()
    use_asked = Signal()
    save_asked = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.found: FoundDesign | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 8, 0, 0)
        row.setSpacing(8)
        frame, column = card("Search")
        frame.setMaximumWidth(300)
        self.form = FoldedForm(SEARCH_FIELDS)
        column.addWidget(self.form)
        self.buttons: dict[str, QPushButton] = {}
        tips = (
            ("Search", "Find the design of most gain at the project's camera", self.search_asked),
            ("Use", "Take the design as the page's modulator", self.use_asked),
            (
                "Save …",
                "Write it to a file: .json keeps its views, .npy its transmissions (rows, columns, samples) alone",
                self.save_asked,
            ),
        )
        for title, tip, signal in tips:
            button = QPushButton(title)
            button.setToolTip(tip)
            button.clicked.connect(lambda _=False, signal=signal: signal.emit())
            column.addWidget(button)
            self.buttons[title] = button
        self.buttons["Search"].setProperty("role", "primary")
        column.addStretch(1)
        row.addWidget(frame)
        row.addWidget(self._result(), 1)
        self.show_found(None)

    def _result(self) -> QWidget:
        frame, column = card("Design")
        self.view = Picture("transmission (1)", axes=("column (px)", "row (px)"))
        self.view.setToolTip(
            "Transmission of each pixel of the super-pixel, for the middle view; filters in their colour"
        )
        column.addWidget(self.view, 1)
        inner = QWidget()
        self.words = QGridLayout(inner)
        self.words.setColumnStretch(1, 1)
        column.addWidget(inner)
        self.status = QLabel("")
        self.status.setProperty("role", "hint")
        self.status.setWordWrap(True)
        column.addWidget(self.status)
        return frame

    def show_status(self, words: str, *, bad: bool = False) -> None:
        """Say what is under way or why nothing is shown."""
        set_role(self.status, "error" if bad else "hint")
        self.status.setText(words)

    def show_found(self, found: FoundDesign | None) -> None:
        """Show a design, or none."""
        self.found = found
        for title in ("Use", "Save …"):
            self.buttons[title].setEnabled(found is not None)
        while self.words.count():
            item = self.words.takeAt(0)
            widget = None if item is None else item.widget()
            if widget is not None:
                widget.hide()
                widget.deleteLater()
        if found is None:
            self.view.set_shot(None)
            self.show_status("Filters or a mask of most gain at the project's camera, as they can be made.")
            return
        self.show_status("")
        pattern = found.design.modulator.pattern()
        values = pattern if found.design.modulator.colours else pattern[..., 0]
        self.view.set_shot(Shot(values, name="design", levels=(0.0, 1.0)))
        for k, (name, value) in enumerate(found.words):
            for column, text in enumerate((name, value)):
                label = QLabel(text)
                label.setWordWrap(column == 1)
                self.words.addWidget(label, k, column)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.view.apply_theme()
