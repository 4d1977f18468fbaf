"""The export in the inspector: a code that reads the file, or any other kind of file with its options."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QButtonGroup, QGridLayout, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal.psf import CODES, PSFMatrix
from lfcal_gui.models import said_in_window, typeset
from lfcal_gui.pages.reconstruct.export_model import KINDS, OPTIONS, ExportSettings, facts_of
from lfcal_gui.widgets import ElidedLabel, Folded, FoldedForm, WrappedLabel, card, choice_box, line, set_role

LEAST = 100
"""Least width of the kind of file (px): its entries are long."""

FACTS = ("H and Ht", "Order", "Quality")


class ExportCard(QWidget):
    """Shows `ExportSettings` and changes them.

    Signals
    -------
    edited(key, value)
        The user changed an entry of the settings.
    asked(code)
        Export for a code; empty: as the options say.
    folder_asked()
        The folder of the exported file is wanted.
    """

    edited = Signal(str, object)
    asked = Signal(str)
    folder_asked = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._code = ""
        frame, column = card("Export")
        self.codes: dict[str, QPushButton] = {}
        group, row = QButtonGroup(self), QHBoxLayout()
        row.setSpacing(0)
        for code in CODES.values():
            button = self.codes[code.name] = QPushButton(code.title)
            button.setProperty("role", "segment")
            button.setCheckable(True)
            button.setToolTip(f"Write H as {code.title} reads it: {code.order}, {code.stored}")
            button.clicked.connect(lambda _=False, name=code.name: self.edited.emit("code", name))
            group.addButton(button)
            row.addWidget(button)
        row.addStretch()
        column.addLayout(row)
        column.addLayout(self._facts())
        self.note = _note()
        column.addWidget(self.note)
        self.go = QPushButton("Export …")
        self.go.setToolTip("Choose a file; it is written as a job")
        self.go.clicked.connect(lambda: self.asked.emit(self._code))
        column.addLayout(line(self.go))
        self.result = QLabel()
        self.result.setWordWrap(True)
        self.result.setTextFormat(Qt.TextFormat.RichText)
        self.result.setAccessibleName("exported file")
        self.result.linkActivated.connect(lambda _: self.folder_asked.emit())
        self.result.hide()
        column.addWidget(self.result)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.setSpacing(6)
        outer.addWidget(frame)
        outer.addWidget(self._other())

    def _facts(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setHorizontalSpacing(8)
        grid.setVerticalSpacing(2)
        grid.setColumnStretch(2, 1)
        self.facts: dict[str, tuple[QLabel, ElidedLabel]] = {}
        for k, name in enumerate(FACTS):
            label, value, remark = QLabel(name), QLabel(), ElidedLabel()
            for one in (label, remark):
                one.setProperty("role", "hint")
            value.setAlignment(Qt.AlignmentFlag.AlignRight)
            value.setStyleSheet("font-weight: 600;")
            grid.addWidget(label, k, 0)
            if name == "Order":  # longer than a number
                value.setAlignment(Qt.AlignmentFlag.AlignLeft)
                grid.addWidget(value, k, 1, 1, 2)
            else:
                grid.addWidget(value, k, 1)
                grid.addWidget(remark, k, 2)
            self.facts[name] = value, remark
        return grid

    def _other(self) -> Folded:
        self.other = Folded("Other formats", "MATLAB, HDF5, NumPy and TIFF with all their options")
        self.kind = choice_box(
            [(suffix, f"{words} ({suffix})") for suffix, (_, words) in KINDS.items()], "By the program that reads it"
        )
        self.kind.setAccessibleName("kind of file")
        self.kind.setMinimumWidth(LEAST)
        self.kind.currentIndexChanged.connect(lambda _: self.edited.emit("suffix", self.kind.currentData()))
        self.form = FoldedForm(tuple(OPTIONS.values()))
        self.form.edited.connect(self.edited.emit)
        self.other_note = _note()
        self.other_go = QPushButton("Export …")
        self.other_go.setToolTip("Choose a file; it is written as a job")
        self.other_go.clicked.connect(lambda: self.asked.emit(""))
        for part in (self.kind, self.form, self.other_note):
            self.other.column.addWidget(part)
        self.other.column.addLayout(line(self.other_go))
        return self.other

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: ExportSettings, H: PSFMatrix, quality: str) -> None:
        """Show what is exported of H, whose quality is a word, or empty where it is not judged."""
        self._code = code = settings.code_for(H)
        self.codes[code].setChecked(True)
        for name, fact in zip(FACTS, facts_of(H, code, quality), strict=True):
            for label, words in zip(self.facts[name], fact, strict=True):
                label.setText(words)
                label.setToolTip(" ".join(fact))
        set_role(self.facts["Quality"][1], "good" if quality == "good" else "hint")
        refusal = settings.refusal(H, code)
        self.go.setText(f"Export for {CODES[code].title} …")
        self.go.setEnabled(not refusal)
        _show_notes(self.note, settings.notes(H, code), bad=bool(refusal))
        self._show_other(settings, H)

    def _show_other(self, settings: ExportSettings, H: PSFMatrix) -> None:
        blocker = QSignalBlocker(self.kind)
        self.kind.setCurrentIndex(self.kind.findData(settings.suffix))
        blocker.unblock()
        shown, names, free = settings.shown(), settings.names, settings.open_to(H)
        self.form.set_values(shown)
        for key in OPTIONS:
            self.form.set_shown(key, key in names)
            self.form.set_enabled(key, key in free)
        refusal = settings.refusal(H)
        _show_notes(self.other_note, settings.notes(H), bad=bool(refusal))
        self.other_go.setEnabled(not refusal)

    def show_result(self, words: str) -> None:
        """Say where H is; empty: it was not exported."""
        self.result.setText(f"{words} <a href='folder'>Show folder</a>" if words else "")
        self.result.setVisible(bool(words))


def _note() -> WrappedLabel:
    label = WrappedLabel()
    label.setProperty("role", "hint")
    return label


def _show_notes(label: WrappedLabel, notes: tuple[str, ...], *, bad: bool) -> None:
    lines = (typeset(said_in_window(note)) for note in notes)
    label.setText("\n".join(f"{one[:1].upper()}{one[1:]}." for one in lines))
    label.setVisible(bool(notes))
    set_role(label, "fair" if bad else "hint")
