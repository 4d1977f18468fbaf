"""Dialog Verify: check whether a session or an H file is unchanged since it was written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QDialog, QFileDialog, QLineEdit, QPlainTextEdit, QPushButton, QVBoxLayout, QWidget

from lfcal.base import Work
from lfcal.judge import judgement_of
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import button, heading, line

FILES = "H files (*.h5)"
SIZE = (640, 380)


class VerifyDialog(QDialog):
    """Checks every frame of a session, or every plane of an H file, against its checksum, as a job.

    The dialog lives as long as its window, because a job may end after the dialog was closed.

    Parameters
    ----------
    context
        Context of the window. The recording of its project, or else its H, is offered.
    """

    def __init__(self, context: Context, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.context = context
        self._number, self._redo = 0, ()
        self.setWindowTitle("Verify")
        self.resize(*SIZE)
        self.path = QLineEdit(placeholderText="folder of a session, or an H file")
        self.path.setAccessibleName("Session or H file to verify")
        self.path.setToolTip("Session folder or H file to check, for example after a crash or a copy")
        self.path.textChanged.connect(lambda _: self._forget())
        self.path.returnPressed.connect(self.check)
        self.choosers = folder, file = QPushButton("Session …"), QPushButton("H file …")
        folder.setToolTip("Choose the folder of a recorded session")
        file.setToolTip("Choose an H file that lfcal wrote. Other files have no checksums")
        folder.clicked.connect(self._choose_folder)
        file.clicked.connect(self._choose_file)
        self.start, self.stop = QPushButton("Check"), QPushButton("Stop")
        self.start.setToolTip("Read all data and compare the checksums. Nothing is changed")
        self.stop.setToolTip("Stop the check")
        self.start.setProperty("role", "primary")
        self.start.clicked.connect(self.check)
        self.stop.clicked.connect(lambda: context.jobs.cancel(self._number))
        self.again = button(
            "Record damaged positions again",
            "Add the damaged positions to those that Record > Rig records again",
            self._send,
        )
        self.found = QPlainTextEdit(readOnly=True, placeholderText="Press Check to show the result here.")
        self.found.setAccessibleName("Result of the check")
        self.found.setToolTip("Frames or planes with wrong checksums, and how to repair them")
        column = QVBoxLayout(self)
        column.addWidget(heading("Every frame or plane is read and compared with its checksum"))
        column.addLayout(line(self.path, folder, file, stretch=0))
        column.addWidget(self.found, 1)
        column.addLayout(line(self.again, QWidget(), self.stop, self.start, stretch=1))
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self._enable()

    def offer(self) -> None:
        """Fill in the recording or H of the project, unless a path is given already."""
        self.setStyleSheet(style_sheet())
        if not self.path.text().strip():
            self.path.setText(self.context.state.recording or self.context.state.psf)
        self._enable()

    def check(self) -> None:
        """Check the given path as a job."""
        text = self.path.text().strip()
        if self._number or not text:
            return
        self._redo = ()
        self.found.setPlainText("reading …")
        self._number = self.context.jobs.start(
            f"Verify {Path(text).name}", "verify", lambda: _work(Path(text)), self._done, self._failed, at_once=True
        )
        self._enable()

    def _done(self, result: Any) -> None:
        lines, self._redo = result
        self.found.setPlainText("\n".join(lines))

    def _failed(self, job: WindowJob) -> None:
        self.found.setPlainText(job.error)

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._number and job.progress is not None and job.active:
            self.found.setPlainText(f"{job.progress.done} of {job.progress.total} read")

    def _job_finished(self, job: WindowJob) -> None:
        if job.number == self._number:
            self._number = 0
            if self.found.toPlainText().endswith("read") or self.found.toPlainText() == "reading …":
                self.found.setPlainText("stopped")
            self._enable()

    def _send(self) -> None:
        self.context.project.update("positions to record again", redo=tuple(tuple(p) for p in self._redo))
        self.context.go.emit("acquire", None)
        self.close()

    def _forget(self) -> None:
        """Clear the result when the path changes."""
        self._redo = ()
        self.found.clear()
        self._enable()

    def _choose_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of the session")
        if path:
            self.path.setText(path)

    def _choose_file(self) -> None:
        path = QFileDialog.getOpenFileName(self, "H file", "", FILES)[0]
        if path:
            self.path.setText(path)

    def _enable(self) -> None:
        self.start.setEnabled(not self._number and bool(self.path.text().strip()))
        self.stop.setEnabled(bool(self._number))
        self.path.setReadOnly(bool(self._number))  # the result belongs to this path
        for chooser in self.choosers:
            chooser.setEnabled(not self._number)
        own = Path(self.path.text().strip() or ".") == Path(self.context.state.recording or ".")
        self.again.setVisible(bool(self._redo))
        self.again.setEnabled(own and bool(self.context.state.recording))


def _work(path: Path) -> Work[tuple[list[str], tuple[Any, ...]]]:
    """Check a folder as a session and anything else as an H file; return the verdict with details, and what to redo."""
    from lfcal.acquire import iter_verify
    from lfcal.psf import iter_verify as iter_verify_matrix

    work: Work[Any] = (iter_verify if path.is_dir() else iter_verify_matrix)(path)
    report = yield from work
    lines = [judgement_of(report).verdict, *(f"  {line}" for line in report.lines())]
    return lines, tuple(report.to_redo) if path.is_dir() else ()
