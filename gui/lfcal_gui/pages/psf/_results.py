"""What is made of a fit: H of the fitted camera, a folder with everything, the report."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QFileDialog

from lfcal.fit import MODEL, REPORT, fit_outputs, iter_fit_report
from lfcal_gui.jobs import WindowJob
from lfcal_gui.pages.psf.model_fit_run import FoundFit
from lfcal_gui.pages.psf.step_fit import step_as
from lfcal_gui.saving import ask_target, may_replace

__all__ = ["Results"]


class Results:
    """Writes in jobs what a fit has found.

    Parameters
    ----------
    fitting, page
        What has ``found`` the fit, and the page that says what is refused.
    """

    def __init__(self, fitting: Any, page: Any) -> None:
        self._fitting, self._page, self.context = fitting, page, page.context
        self.report: Path | None = None
        self._scratch: tempfile.TemporaryDirectory[str] | None = None

    def close(self) -> None:
        """Forget the report; one that nobody saved is deleted."""
        self.report = None
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None

    def compute(self, path: str = "") -> None:
        """Compute H of the fitted camera as a job; it is the reference to compare with."""
        found = self._fitting.found
        if found is None:
            return
        path = path or ask_target(self._page, "Compute H", "model_H.h5", "H file (*.h5)")
        if not path or self._refused([Path(path)]):
            return
        self.context.start_writing(
            f"H of the fit: {Path(path).name}",
            self._page.spec.key,
            path,
            lambda: found.iter_model(Path(path)),
            lambda _: self._computed(found, path),
            lambda job: self._page.refuse(job.error),
        )

    def _computed(self, found: FoundFit, path: str) -> None:
        self.context.message.emit(f"H of the fitted camera written: {path}")
        if found is self._fitting.found:  # of another H it is no reference
            self.context.project.update("H of the fit", reference=path)

    def save(self, folder: str = "") -> None:
        """Write everything that the fit makes into a folder, as a job."""
        found, asked = self._fitting.found, not folder
        if found is None:
            return
        folder = folder or QFileDialog.getExistingDirectory(self._page, "Folder for the fit")
        if not folder or self._refused([Path(folder) / MODEL]):
            return
        if asked and not may_replace(self._page, fit_outputs(Path(folder))):
            return
        asked = found.question
        self.context.start_writing(
            f"Save fit in {Path(folder).name}",
            self._page.spec.key,
            str(Path(folder) / MODEL),
            lambda: found.iter_saved(Path(folder)),
            lambda files: self._saved(found, files),
            lambda job: self._page.refuse(job.error),
            taken=self.context.taken(
                "fit", f"Fit {asked.name}", folder, lambda: step_as(asked.settings, asked.project, asked.offer, folder)
            ),
        )

    def _saved(self, found: FoundFit, files: list[Path]) -> None:
        self.context.message.emit(f"fit written: {files[-1].parent}")
        if found is self._fitting.found:
            self.report = next(path for path in files if path.parent.name == REPORT)

    def _refused(self, files: list[Path]) -> bool:
        """Return whether a file would replace the H that is fitted; say so."""
        own = Path(self.context.state.psf).resolve()
        if own in [path.resolve() for path in files]:
            self._page.refuse(f"{own.name} is the H that was fitted; choose another name")
            return True
        return False

    def open_report(self) -> None:
        """Show the report in the browser; one that was not saved is made for the time being."""
        found = self._fitting.found
        if found is None:
            return
        if self.report is not None and self.report.is_file():
            self.show_page(self.report)
            return
        self._scratch = self._scratch or tempfile.TemporaryDirectory(prefix="lfcal-fit-")
        folder = Path(self._scratch.name)
        self.context.jobs.start(
            "Report of the fit",
            self._page.spec.key,
            lambda: iter_fit_report(found.fit, found.measured, folder, found.question.name),
            lambda page: self._reported(found, page),
            lambda job: self._failed(found, job),
        )

    def _failed(self, found: FoundFit, job: WindowJob) -> None:
        if found is self._fitting.found:  # else its folder was taken away meanwhile
            self._page.refuse(job.error)

    def _reported(self, found: FoundFit, page: Path) -> None:
        if found is self._fitting.found:
            self.report = page
            self.show_page(page)

    def show_page(self, page: Path) -> None:
        """Open a page in the browser."""
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(page)))
