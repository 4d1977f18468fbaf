"""The export of H: the card in the inspector, the file that is asked for, and the job."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from lfcal.base import LfcalError, format_bytes
from lfcal.psf import CODES, PSFMatrix
from lfcal_gui.base_page import BasePage
from lfcal_gui.crash_dialog import open_folder
from lfcal_gui.models import KeptRun, exported_to, stamp_of, stated_order, with_exported
from lfcal_gui.pages.reconstruct._export_card import ExportCard
from lfcal_gui.pages.reconstruct.export_model import ExportSettings, iter_exported
from lfcal_gui.pages.reconstruct.step import export_step, quality_in
from lfcal_gui.saving import ask_target

NONE = "there is no H to export; open or assemble one first"


class Exporting:
    """Connects the `ExportCard` of a page with the project and the jobs."""

    def __init__(self, page: BasePage, card: ExportCard) -> None:
        self._page, self._card, self._context = page, card, page.context
        card.edited.connect(self._edited)
        card.asked.connect(self.ask)
        card.folder_asked.connect(self.show_folder)
        card.form.check = self._check

    @property
    def settings(self) -> ExportSettings:
        """Settings of the export in the project."""
        return ExportSettings.of(self._context.state)

    @property
    def _matrix(self) -> PSFMatrix | None:
        return self._context.matrix(self._context.state.psf)

    def _check(self, key: str, value: Any) -> str:
        try:
            self.settings.changed(key, value)
        except LfcalError as error:
            return str(error)
        return ""

    def _edited(self, key: str, value: Any) -> None:
        settings = self.settings.changed(key, value).into(self._context.state)
        self._context.project.merge(f"export: {key.replace('_', ' ')}", settings=settings)

    def facts(self) -> dict[str, Any]:
        """Return what the next step should know: the code that is exported for, where it can use H."""
        matrix = self._matrix
        if matrix is None:
            return {}
        code = self.settings.code_for(matrix)
        return {"export_for": "" if self.settings.refusal(matrix, code) else CODES[code].title}

    def show(self) -> None:
        """Show what would be written, and what was."""
        matrix, state = self._matrix, self._context.state
        if matrix is None:
            return
        self._card.show_settings(self.settings, matrix, quality_in(state))
        path = exported_to(state)
        file = stamp_of(path)
        size = "" if file is None else f", {format_bytes(file[2])}"
        self._card.show_result(f"H and HT are in {Path(path).name}{size}." if path else "")

    def ask(self, code: str = "") -> None:
        """Ask for the file of an export for a code, or of another kind, and begin."""
        matrix, settings = self._matrix, self.settings
        if matrix is None:
            self._page.refuse(NONE)
            return
        if settings.refusal(matrix, code):
            self._page.refuse(settings.refusal(matrix, code))
            return
        suffix = settings.suffix_for(code)
        name = f"H_{CODES[code].title}{suffix}" if code else f"H{suffix}"
        kinds = f"{suffix[1:]} files (*{suffix})"
        path = ask_target(self._page, "Export H", name, kinds, lambda chosen: settings.files(matrix, chosen, code))
        if path:
            self.start(path, settings, code)

    def ask_usual(self) -> None:
        """Export for the code that is chosen; where it cannot use H, as the options say, missing positions as zeros."""
        matrix, settings = self._matrix, self.settings
        if matrix is None:
            self._page.refuse(NONE)
            return
        code = settings.code_for(matrix)
        if not settings.refusal(matrix, code):
            self.ask(code)
            return
        self._card.other.open()
        self.ask()

    def start(self, path: str, settings: ExportSettings | None = None, code: str = "") -> None:
        """Export H to a file as a job; by default as the name of the file says."""
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
        """Show the folder of the file that H was exported to."""
        exported = exported_to(self._context.state)
        if exported:
            open_folder(Path(exported).parent)
