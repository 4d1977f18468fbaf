"""Interface between a page and the window: project, jobs, messages, and requests for other pages."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, QSettings, QStandardPaths, Signal

from lfcal.base import LfcalError, Work
from lfcal_gui._matrices import Matrices
from lfcal_gui.jobs import Jobs, JobState, WindowJob
from lfcal_gui.models import (
    PAGES,
    CommandStep,
    FittedCamera,
    History,
    Keeping,
    KeptRun,
    MeasuredCurves,
    Paces,
    PageSettings,
    Project,
    ProjectState,
    Taken,
    stated_order,
    step_of,
)

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix
    from lfcal_gui.widgets import FoldedForm

MOST_NAMES = 10_000
"""Largest number that is tried to make a name unused."""


def results() -> Path:
    """Return the output folder of a project without a file and without data."""
    return Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)) / "lfcal"


class Context(QObject):
    """Context of all pages: everything that they share."""

    state_changed = Signal(object, object, arguments=["old", "new"])
    """The project changed (`lfcal_gui.models.project.ProjectState` before and after)."""
    go = Signal(str, object, arguments=["page", "payload"])
    """A page requests another page by its key, with something to show there, such as ``("frames", (z, y, x))``."""
    files_offered = Signal(object, arguments=["paths"])
    """Files to open in the page that accepts them, as if they were dropped."""
    help_asked = Signal(str, str, arguments=["page", "name"])
    """Request for a page of the manual, such as ``faults.md``, or its section about ``name``."""
    message = Signal(str, arguments=["text"])
    """A line for the log and the status bar."""
    refused = Signal(str, arguments=["text"])
    """Why a change of the project was refused; the current page shows it, too."""
    attention = Signal(str, bool, arguments=["page", "flag"])
    """Whether a page needs the attention of the user (``flag``)."""
    theme_asked = Signal(str, arguments=["name"])
    """Request for another theme."""
    theme_changed = Signal()
    """The theme changed; plots redraw."""
    frame_seen = Signal(object, object, arguments=["frame", "first"])
    """A frame ``(rows, columns)`` of the camera is shown; receivers must not change it. ``first`` is the sensor
    position (row, column) of its first pixel."""
    sample_asked = Signal()
    """Request for the sample session."""
    made = Signal(str, object, arguments=["page", "payload"])
    """A result was made that page ``page`` shows; the window goes there unless the user is working on another page."""
    reported_changed = Signal()
    """A page reported a change for the next step."""
    fitted_changed = Signal()
    """A fit found another camera, or the fitted camera is no longer valid."""

    def __init__(self, project: Project, jobs: Jobs, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.project, self.jobs = project, jobs
        self.matrices = Matrices(jobs, lambda path: stated_order(self.state, path), self)
        self.matrices.failed.connect(self.message.emit)
        self.preferences: QSettings | None = None
        """Settings stored between starts; None: nothing is stored."""
        self.in_front: Callable[[str], bool] = lambda page: True
        """Whether the user works on a page. Other pages follow changes in later turns of the event loop."""
        self._closers: list[Callable[[], None]] = []
        self._fitted: FittedCamera | None = None
        self.history = History()
        self.curves = MeasuredCurves()
        self.paces = Paces()
        self.judged: Any = None
        """Judgement of H made in the background, which the page H takes over."""
        self.reported: dict[str, dict[str, Any]] = {}
        """Fields of `Sitting` reported by each page."""
        self._reported_of = project.begun
        jobs.finished.connect(self._remember)
        project.listen(lambda old, new: self.matrices.follow_orders())
        project.listen(lambda old, new: self._forget_reported())
        project.listen(self.state_changed.emit)
        self.refused.connect(self.message.emit)

    @property
    def state(self) -> ProjectState:
        """The project's state."""
        return self.project.state

    def kept_texts(self, name: str) -> list[str]:
        """Return the texts stored by `keep_texts`, possibly at an earlier start."""
        kept = None if self.preferences is None else self.preferences.value(name)
        texts = kept if isinstance(kept, list) else [kept]  # a list of one text is stored as the text
        return [one for one in texts if isinstance(one, str) and one]

    def keep_texts(self, name: str, texts: Sequence[str]) -> None:
        """Store texts for later starts."""
        if self.preferences is not None:
            self.preferences.setValue(name, list(texts))

    @property
    def fitted(self) -> FittedCamera | None:
        """Camera found by the last fit in this window; None if there is none."""
        return self._fitted

    def own_path(self, name: str) -> str:
        """Return an unused path for an output called ``name``: next to the project or its data, else in `results`.

        It is empty if nothing can be written there; the user is then asked.
        """
        near = next(filter(None, (self.project.path, self.state.frames, self.state.recording, self.state.psf)), None)
        folder, wanted = results() if near is None else Path(near).parent, Path(name)
        try:
            if near is None:
                folder.mkdir(parents=True, exist_ok=True)
            names = (name, *(f"{wanted.stem}-{k}{wanted.suffix}" for k in range(2, MOST_NAMES)))
            found = next((path for one in names if not (path := folder / one).exists()), None)
        except OSError:
            return ""
        return str(found) if found is not None and os.access(folder, os.W_OK) else ""

    def edit(self, settings: PageSettings, key: str, value: Any, label: str = "change of") -> None:
        """Change one field of a page's settings; ``label`` and the name of the field name the undo step."""
        changed = settings.changed(key, value)
        self.project.merge(f"{label} {key.replace('_', ' ')}", settings=changed.into(self.state))

    def let_edit(self, form: FoldedForm, settings: Callable[[], PageSettings], label: str = "change of") -> None:
        """Connect a form with the settings of a page, and mark values that are refused; ``label`` is as in `edit`."""
        form.check = lambda key, value: settings().why_not(key, value)
        form.edited.connect(lambda key, value: self.edit(settings(), key, value, label))

    def set_fitted(self, fitted: FittedCamera | None) -> None:
        """Send all pages the camera of a fit. None: there is no valid fit."""
        if fitted is not self._fitted:
            self._fitted = fitted
            self.fitted_changed.emit()

    def _forget_reported(self) -> None:
        """Discard the reports of pages on the previous project."""
        if self._reported_of != self.project.begun:
            self._reported_of = self.project.begun
            self.reported.clear()

    def report(self, page: str, **facts: Any) -> None:
        """Report fields of `Sitting` known to ``page``; they are valid until its next report."""
        if self.reported.get(page) != facts:
            self.reported[page] = facts
            self.reported_changed.emit()

    def matrix(self, path: str) -> PSFMatrix | None:
        """Return the PSF matrix of a file if it is open; ``matrices.want`` opens it in the background."""
        return self.matrices.get(path)

    def forget(self, path: str) -> None:
        """Close a PSF matrix, so that its file can be replaced or read again."""
        self.matrices.forget(path)

    def start_writing(
        self,
        title: str,
        page: str,
        path: str,
        work: Callable[[], Work[Any]],
        on_done: Callable[[Any], None] | None = None,
        on_failed: Callable[[WindowJob], None] | None = None,
        *,
        kind: str = "make",
        on_end: Callable[[WindowJob], None] | None = None,
        keeping: Keeping | None = None,
        taken: Taken | None = None,
    ) -> int:
        """Run a job that writes the H file ``path``, in units that are kept if it ends early.

        The file is closed when the job starts, and read again at its end. If another project was opened meanwhile,
        ``on_done`` is not called. ``kind`` is as in `WindowJob`.
        """
        begun = self.project.begun

        def done(result: Any) -> None:
            if self.project.begun == begun and on_done is not None:
                on_done(result)
            elif self.project.begun != begun:
                self.message.emit(f"{path} is complete; its project is no longer open")

        def ended(job: WindowJob) -> None:
            if on_end is not None and self.project.begun == begun:
                on_end(job)
            if path in (self.state.psf, self.state.reference):
                self.matrices.want(path)

        return self.jobs.start(
            title,
            page,
            work,
            done,
            on_failed,
            kind=kind,
            on_end=ended,
            before=lambda: self.forget(path),
            keeping=keeping or KeptRun(path),
            taken=taken,
        )

    def taken(
        self,
        page: str,
        title: str,
        out: str = "",
        step: Callable[[], CommandStep] | None = None,
        *,
        draft: bool = False,
    ) -> Taken:
        """Return the entry of the history for a step that starts now and succeeds.

        Parameters
        ----------
        page, title
            Key of the page, and title of the step.
        out
            The file or folder that it writes.
        step
            Function that returns the command. None: the command of the page, for the project as it is now.
        draft
            Whether the step saves nothing yet.
        """
        try:
            made = step() if step is not None else step_of(PAGES.get(page), self.state, out)
        except LfcalError as error:
            return Taken(page, title, None, out, str(error), draft)
        return Taken(page, title, made, out, draft=draft)

    def _remember(self, job: WindowJob) -> None:
        if job.taken is not None and job.state is JobState.DONE:
            self.history.add(job.taken)

    def on_close(self, closer: Callable[[], None]) -> None:
        """Call ``closer`` when the window closes and all threads have ended, to release devices and files."""
        self._closers.append(closer)

    def close(self) -> None:
        """Call all closers, and close all files."""
        while self._closers:
            self._closers.pop()()
        self.matrices.close()
