"""Export of H: card in the inspector, choice of the file, and job."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QButtonGroup, QGridLayout, QHBoxLayout, QLabel, QPushButton, QWidget

from lfcal.base import format_bytes
from lfcal.psf import CODES, PSFMatrix
from lfcal_gui.base_page import BasePage
from lfcal_gui.crash_dialog import open_folder
from lfcal_gui.models import KeptRun, exported_to, said_in_window, stamp_of, stated_order, typeset, with_exported
from lfcal_gui.pages.reconstruct.export_model import KINDS, OPTIONS, ExportSettings, facts_of, iter_exported
from lfcal_gui.pages.reconstruct.step import export_step, quality_in
from lfcal_gui.saving import ask_target
from lfcal_gui.widgets import (
    ElidedLabel,
    Folded,
    FoldedForm,
    WrappedLabel,
    button,
    card,
    choice_box,
    column_of,
    line,
    segment,
    set_role,
)

LEAST = 100
"""Smallest width of the list of file formats (px)."""

FACTS = ("H and HT", "Order", "Quality")


class ExportCard(QWidget):
    """Card that shows and changes `ExportSettings`."""

    edited = Signal(str, object, arguments=["key", "value"])
    """The user chose a code or another file format."""
    asked = Signal(str, arguments=["code"])
    """Request to export for a code; empty: according to the options."""
    usual_asked = Signal()
    """Request for the export that is offered first."""
    folder_asked = Signal()
    """Request to open the folder of the exported file."""

    def __init__(self) -> None:
        super().__init__()
        frame, column = card("Export")
        self.codes: dict[str, QPushButton] = {}
        group, row = QButtonGroup(self), QHBoxLayout()
        row.setSpacing(0)
        for code in CODES.values():
            tip = f"Write H as {code.title} reads it: {code.order}, {code.stored}"
            made = segment(code.title, tip, lambda name=code.name: self.edited.emit("code", name))
            self.codes[code.name] = made
            group.addButton(made)
            row.addWidget(made)
        row.addStretch()
        column.addLayout(row)
        column.addLayout(self._facts())
        self.note = _note()
        column.addWidget(self.note)
        self.go = button("Export …", "Choose a file to write. The export runs as a job", self.usual_asked.emit)
        column.addLayout(line(self.go))
        self.result = QLabel(wordWrap=True, textFormat=Qt.TextFormat.RichText)
        self.result.setAccessibleName("Exported file")
        self.result.linkActivated.connect(lambda _: self.folder_asked.emit())
        self.result.hide()
        column.addWidget(self.result)
        column_of(frame, self._other(), of=self, spacing=6)

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
            value.setProperty("role", "value")
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
        self.other = Folded("Other formats", "MATLAB, HDF5, NumPy and TIFF, with all options")
        self.kind = choice_box(
            [(suffix, f"{words} ({suffix})") for suffix, (_, words) in KINDS.items()],
            "Choose by the program that reads the file",
            "file format",
        )
        self.kind.setMinimumWidth(LEAST)
        self.kind.currentIndexChanged.connect(lambda _: self.edited.emit("suffix", self.kind.currentData()))
        self.form = FoldedForm(tuple(OPTIONS.values()))
        self.form.own_line("interpolation")
        self.other_note = _note()
        self.other_go = button(
            "Export …", "Choose a file to write. The export runs as a job", lambda: self.asked.emit("")
        )
        for part in (self.kind, self.form, self.other_note):
            self.other.column.addWidget(part)
        self.other.column.addLayout(line(self.other_go))
        return self.other

    # -- showing ---------------------------------------------------------------------------------------
    def show_settings(self, settings: ExportSettings, H: PSFMatrix, quality: str) -> None:
        """Show the export settings for an H; ``quality`` is a word, empty if H was not judged."""
        code = settings.code_for(H)
        self.codes[code].setChecked(True)
        for name, fact in zip(FACTS, facts_of(H, code, quality), strict=True):
            for label, words in zip(self.facts[name], fact, strict=True):
                label.setText(words)
                label.setToolTip(" ".join(fact))
        set_role(self.facts["Quality"][1], "good" if quality == "good" else "hint")
        offered, usable = settings.offered(H)
        self.go.setText(f"{offered.title(usable)} …")
        _show_notes(self.note, settings.notes(H, code), bad=code != usable)
        self._show_other(settings, H)

    def _show_other(self, settings: ExportSettings, H: PSFMatrix) -> None:
        with QSignalBlocker(self.kind):
            self.kind.setCurrentIndex(self.kind.findData(settings.suffix))
        shown, names, free = settings.shown(), settings.names, settings.open_to(H)
        self.form.set_values(shown)
        for key in OPTIONS:
            self.form.set_shown(key, key in names)
            self.form.set_enabled(key, key in free)
        refusal = settings.refusal(H)
        _show_notes(self.other_note, settings.notes(H), bad=bool(refusal))
        self.other_go.setEnabled(not refusal)

    def show_result(self, words: str) -> None:
        """Show the path of the exported file; empty: H was not exported."""
        self.result.setText(f"{words} <a href='folder'>Show folder</a>" if words else "")
        self.result.setVisible(bool(words))


def _note() -> WrappedLabel:
    label = WrappedLabel(role="hint")
    return label


def _show_notes(label: WrappedLabel, notes: tuple[str, ...], *, bad: bool) -> None:
    lines = (typeset(said_in_window(note)) for note in notes)
    label.setText("\n".join(f"{one[:1].upper()}{one[1:]}." for one in lines))
    label.setVisible(bool(notes))
    set_role(label, "fair" if bad else "hint")


NONE = "there is no H to export; open or assemble one first"


class Exporting:
    """Connect the `ExportCard` of a page with project and jobs."""

    def __init__(self, page: BasePage, card: ExportCard) -> None:
        self._page, self._card, self._context = page, card, page.context
        card.edited.connect(lambda key, value: page.context.edit(self.settings, key, value, "export:"))
        page.context.let_edit(card.form, lambda: self.settings, "export:")
        card.asked.connect(self.ask)
        card.usual_asked.connect(self.ask_usual)
        card.folder_asked.connect(self.show_folder)

    @property
    def settings(self) -> ExportSettings:
        """Settings of the export in the project."""
        return ExportSettings.of(self._context.state)

    @property
    def _matrix(self) -> PSFMatrix | None:
        return self._context.matrix(self._context.state.psf)

    def show(self) -> None:
        """Show what the export would write, and what it has written."""
        matrix, state = self._matrix, self._context.state
        if matrix is None:
            return
        self._card.show_settings(self.settings, matrix, quality_in(state))
        path = exported_to(state)
        file = stamp_of(path)
        size = "" if file is None else f", {format_bytes(file[2])}"
        self._card.show_result(f"H is exported to {Path(path).name}{size}." if path else "")

    def ask(self, code: str = "") -> None:
        """Ask for the file of an export, for a code or in another format, and start it."""
        matrix, settings = self._matrix, self.settings
        if matrix is None:
            self._page.refuse(NONE)
            return
        if settings.refusal(matrix, code):
            self._page.refuse(settings.refusal(matrix, code))
        else:
            self._ask(matrix, settings, code)

    def _ask(self, matrix: PSFMatrix, settings: ExportSettings, code: str) -> None:
        suffix = settings.suffix_for(code)
        name = f"H_{CODES[code].title}{suffix}" if code else f"H{suffix}"
        kinds = f"{suffix[1:]} files (*{suffix})"
        path = ask_target(self._page, "Export H", name, kinds, lambda chosen: settings.files(matrix, chosen, code))
        if path:
            self.start(path, settings, code)

    def ask_usual(self) -> None:
        """Export for the chosen code or, if this cannot use H, to a plain file."""
        if self._matrix is None:
            self._page.refuse(NONE)
        else:
            self._ask(self._matrix, *self.settings.offered(self._matrix))

    def start(self, path: str, settings: ExportSettings | None = None, code: str = "") -> None:
        """Export H to a file as a job; by default, its suffix determines the format."""
        state = self._context.state
        if self._matrix is None:
            self._page.refuse(NONE)
            return
        chosen = settings or ExportSettings.of_path(path)
        task = chosen.task(state.psf, path, stated_order(state, state.psf), code, quality_in(state))
        title, context = f"Export {Path(path).name}", self._context
        context.jobs.start(
            title,
            "reconstruct",
            lambda: iter_exported(task, path),
            self._exported,
            kind="export",
            keeping=KeptRun(path),
            needs=(state.psf,),
            taken=context.taken("reconstruct", title, path, partial(export_step, state, path, chosen, code)),
        )

    def _exported(self, out: Path) -> None:
        self._context.message.emit(f"exported {out}")
        self._context.project.note(settings=with_exported(self._context.state, str(out)))

    def show_folder(self) -> None:
        """Open the folder of the exported file."""
        exported = exported_to(self._context.state)
        if exported:
            open_folder(Path(exported).parent)
