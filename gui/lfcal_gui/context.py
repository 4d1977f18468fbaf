"""What a page may use of the window: the project, the jobs, messages, and going to another page."""

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
"""Numbers that are tried for a name."""


def results() -> Path:
    """Return the folder for what is made in a project without a file and without data."""
    return Path(QStandardPaths.writableLocation(QStandardPaths.StandardLocation.DocumentsLocation)) / "lfcal"


class Context(QObject):
    """Handed to every page; the only thing pages share."""

    state_changed = Signal(object, object, arguments=["old", "new"])
    """The project changed (`lfcal_gui.models.project.ProjectState` before and after)."""
    go = Signal(str, object, arguments=["page", "payload"])
    """A page requests another page by its key, with something to show there, such as ``("frames", (z, y, x))``."""
    files_offered = Signal(object, arguments=["paths"])
    """Files to open in the page that accepts them, as if they were dropped."""
    help_asked = Signal(str, str, arguments=["page", "name"])
    """A page of the manual is wanted, such as ``faults.md``, or its section about ``name``."""
    message = Signal(str, arguments=["text"])
    """A line for the log and the status bar."""
    refused = Signal(str, arguments=["text"])
    """Why a change of the project was refused; the current page shows it, too."""
    attention = Signal(str, bool, arguments=["page", "flag"])
    """A page found something that needs the user."""
    theme_asked = Signal(str, arguments=["name"])
    """A page wants another theme."""
    theme_changed = Signal()
    """Colours changed; plots redraw."""
    frame_seen = Signal(object, object, arguments=["frame", "first"])
    """A frame of the camera is shown: ``(rows, columns)``, not to be changed, and which of the sensor's pixels (row,
    column) its first one is."""
    sample_asked = Signal()
    """A page offers the sample session, and the user wants it."""
    made = Signal(str, object, arguments=["page", "payload"])
    """Something was made that page ``page`` shows; the window goes there unless the person is at work elsewhere."""
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
        """What is kept between starts. None: nothing is."""
        self._closers: list[Callable[[], None]] = []
        self._fitted: FittedCamera | None = None
        self.history = History()
        self.curves = MeasuredCurves()
        self.paces = Paces()
        self.judged: Any = None
        """The judgement of H that was made in the background, as the page that judges takes it over."""
        self.reported: dict[str, dict[str, Any]] = {}
        """What each page reported about the sitting."""
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
        """Return texts that `keep_texts` kept, at an earlier start too."""
        kept = None if self.preferences is None else self.preferences.value(name)
        texts = kept if isinstance(kept, list) else [kept]  # a list of one text is stored as the text
        return [one for one in texts if isinstance(one, str) and one]

    def keep_texts(self, name: str, texts: Sequence[str]) -> None:
        """Keep texts for later starts."""
        if self.preferences is not None:
            self.preferences.setValue(name, list(texts))

    @property
    def fitted(self) -> FittedCamera | None:
        """The camera that a fit of this window found last."""
        return self._fitted

    def own_path(self, name: str) -> str:
        """Return a new file or folder ``name`` for what is made: next to the project or its data, else in `results`.

        Empty where nothing can be written there: then the user is asked.
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
        """Change one field of a page's settings; ``label``, with the field's name, is what undo offers."""
        changed = settings.changed(key, value)
        self.project.merge(f"{label} {key.replace('_', ' ')}", settings=changed.into(self.state))

    def let_edit(self, form: FoldedForm, settings: Callable[[], PageSettings], label: str = "change of") -> None:
        """Let a form edit the settings of a page, and mark values that they refuse; ``label``: as in `edit`."""
        form.check = lambda key, value: settings().why_not(key, value)
        form.edited.connect(lambda key, value: self.edit(settings(), key, value, label))

    def set_fitted(self, fitted: FittedCamera | None) -> None:
        """Send all pages the camera of a fit. None: there is no valid fit."""
        if fitted is not self._fitted:
            self._fitted = fitted
            self.fitted_changed.emit()

    def _forget_reported(self) -> None:
        """Forget what pages reported about another project."""
        if self._reported_of != self.project.begun:
            self._reported_of = self.project.begun
            self.reported.clear()

    def report(self, page: str, **facts: Any) -> None:
        """Report what ``page`` knows about the sitting: fields of `Sitting`, valid until its next report."""
        if self.reported.get(page) != facts:
            self.reported[page] = facts
            self.reported_changed.emit()

    def matrix(self, path: str) -> PSFMatrix | None:
        """Return the PSF matrix of a file if it is open; ``matrices.want`` opens it in the background."""
        return self.matrices.get(path)

    def forget(self, path: str) -> None:
        """Close a PSF matrix, so that its file may be replaced or is read again."""
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
        ``on_done`` is not called. ``kind``: as in `WindowJob`.
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
            Returns the command; by default that of the page, for the project as it is now.
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
        """Close what pages hold, and all files."""
        while self._closers:
            self._closers.pop()()
        self.matrices.close()
