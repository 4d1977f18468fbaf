"""Guidance through the work: collect the current state, show the next step, and do it."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QEvent, QObject, QTimer, Signal
from PySide6.QtWidgets import QApplication, QWidget

from lfcal.base import Work
from lfcal_gui._header import NextLine
from lfcal_gui._leaving_out import LeavingOut
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import (
    FORECASTS,
    PAGES,
    FittedCamera,
    Paces,
    ProjectState,
    Sitting,
    Stamp,
    next_step,
    session_counts,
    sitting_of,
    stamp_of,
    with_declined,
    with_verdict,
)
from lfcal_gui.theme import current_theme

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

GATHER_MS, JUDGE_MS = 40, 1500
"""Delay before a change is shown, because changes come in groups, and idle time before H is judged (ms)."""

ELSEWHERE_S = 10.0
"""Time after a click during which another page stays in view when H is made (s)."""

MAKING = {"acquire", "frames"}
"""Pages whose jobs make H; the new H is shown."""

SESSION, PACES = "session counts", "paces"


def _iter_judged(project: ProjectState, fitted: FittedCamera | None) -> Work[Any]:
    """Judge H as the page H does; modules are imported in the job's thread."""
    judging = import_module(f"{PAGES.get('h').package}.model_checks")
    return (yield from judging.iter_judged(project, fitted))


def _export_facts(project: ProjectState, H: PSFMatrix | None) -> dict[str, Any]:
    """Return which export of H is offered, as determined by the page that exports."""
    exporting = import_module(f"{PAGES.get('reconstruct').package}.export_model") if H is not None else None
    return {} if exporting is None else exporting.next_facts(project, H)


class Leading(QObject):
    """Connects a `NextLine` with the window.

    ``page`` returns a page, which it makes at the first call. ``shown`` returns key and place of the current page.
    ``changed(sitting)`` is emitted when the `Sitting` has changed.
    """

    changed = Signal(object)

    def __init__(
        self,
        context: Context,
        line: NextLine,
        window: QWidget,
        page: Callable[[str], BasePage],
        shown: Callable[[], tuple[str, str]],
    ) -> None:
        super().__init__(window)
        self.context, self.line, self.sitting = context, line, Sitting()
        self._window, self._page, self._shown = window, page, shown
        self._tried: Stamp | None = None
        self._judging = 0
        context.paces = Paces.of(context.kept_texts(PACES))
        self.own: dict[str, Callable[[], object]] = {"h.leave_out": LeavingOut(context).begin}
        """Actions of buttons that do not belong to a page."""
        self._pressed, self._watching = -ELSEWHERE_S, False
        self._gathering, self._judge = QTimer(self), QTimer(self)
        for timer, ms, action in (
            (self._gathering, GATHER_MS, self.gather),
            (self._judge, JUDGE_MS, self.judge),
        ):
            timer.setSingleShot(True)
            timer.setInterval(ms)
            timer.timeout.connect(action)
        line.pressed.connect(self.do)
        line.declined.connect(self._decline)
        context.state_changed.connect(self._follow)
        context.reported_changed.connect(self.look)
        context.jobs.changed.connect(lambda _: self.look())
        context.jobs.changed.connect(lambda _: self._watch())
        context.jobs.finished.connect(self._finished)
        context.jobs.queued.connect(self._give_way)
        context.matrices.changed.connect(lambda _: self.look())
        context.made.connect(self._show_made)

    # -- gathering -------------------------------------------------------------------------------------
    def look(self) -> None:
        """Schedule `gather`; several changes in a short time cause only one call."""
        if not self._gathering.isActive():
            self._gathering.start()

    def _follow(self, old: Any, new: Any) -> None:
        if old.recording != new.recording:
            self._count()
        self.look()

    def _finished(self, job: WindowJob) -> None:
        if job.number == self._judging:
            self._judging = 0
        if job.page == "acquire":
            self._count()
        self._time(job)
        self.look()

    def _time(self, job: WindowJob) -> None:
        """Correct later forecasts by the duration of a job."""
        forecast = self.context.reported.get(job.page, {}).get(FORECASTS.get(job.kind, ""))
        if job.state is JobState.DONE and isinstance(forecast, float):
            self.context.paces.take(job.kind, forecast, time.monotonic() - job.started)
            self.context.keep_texts(PACES, self.context.paces.texts())

    def _count(self) -> None:
        """Count the recorded positions of the session in the background, because a disk may not respond."""
        path, jobs = self.context.state.recording, self.context.jobs
        jobs.drop(SESSION)
        if path:
            jobs.load(SESSION, lambda: session_counts(path), self._counted, lambda _: None)
        else:
            self._counted({"done": 0, "total": 0})

    def _counted(self, facts: dict[str, Any]) -> None:
        self.context.report("session", **facts)

    def gather(self) -> None:
        """Collect the current state, and show the next step if the state has changed."""
        context = self.context
        state, (page, place) = context.state, self._shown()
        matrix, paces = context.matrix(state.psf), context.paces
        reported = {**context.reported, "export": _export_facts(state, matrix)}
        found = sitting_of(state, reported, context.jobs.jobs(), page=page, place=place, matrix=matrix, paces=paces)
        if self._judge_wanted(found):
            self._judge.start()
        if found != self.sitting or self.line.step is None:
            self.sitting = found
            self.line.show_step(next_step(found))
            self.changed.emit(found)

    # -- doing -----------------------------------------------------------------------------------------
    def do(self, action: str) -> None:
        """Do the action of a button: show the page and let it act, or stop the jobs of a kind."""
        page, _, name = action.partition(".")
        if page == "jobs":
            for job in self.context.jobs.jobs():
                if job.active and job.kind == name:
                    self.context.jobs.cancel(job.number)
            return
        if action in self.own:
            self.own[action]()
            return
        self.context.go.emit(page, None)
        if not self._page(page).do(name):
            self.context.message.emit(f"page {page} has no action {name}")

    def _decline(self, action: str, place: str) -> None:
        self.context.project.note(settings=with_declined(self.context.state, action, place))

    # -- judging H -------------------------------------------------------------------------------------
    def _judge_wanted(self, found: Sitting) -> bool:
        """Return whether H should be judged: it is open and new, and no job needs the processor."""
        path, jobs = self.context.state.psf, self.context.jobs
        new = found.verdict is None and stamp_of(path) != self._tried
        free = not (jobs.running_pages() or found.recording or self._judge.isActive())
        return found.h and new and free and self.context.matrix(path) is not None

    def judge(self) -> None:
        """Judge H in the background, once the computations for the current page have ended."""
        if not self._judge_wanted(self.sitting):
            return
        if self.context.jobs.computing:
            self._judge.start()
            return
        state, begun = self.context.state, self.context.project.begun
        self._tried = stamp = stamp_of(state.psf)
        if stamp is None:
            return

        def done(judged: Any) -> None:
            if self.context.project.begun == begun:
                self.context.judged = judged
                self.context.project.note(settings=with_verdict(self.context.state, stamp, judged.verdict))

        self._judging = self.context.jobs.start(
            f"Inspect {Path(state.psf).name}",
            "h",
            lambda: _iter_judged(state, self.context.fitted),
            done,
            kind="judge",
            abandon=True,
            leave=True,
            needs=(state.psf,),
        )

    @property
    def due(self) -> bool:
        """Whether the next step is about to be updated, or H is about to be judged."""
        return self._gathering.isActive() or self._judge.isActive()

    def _give_way(self) -> None:
        """Postpone the judgement of H if a job of the user waits for it."""
        if self._judging and self.context.jobs.waiting() and self._judging not in self.context.jobs.waiting():
            number, self._judging, self._tried = self._judging, 0, None
            self.context.jobs.cancel(number)

    # -- arriving --------------------------------------------------------------------------------------
    def _show_made(self, page: str, payload: Any) -> None:
        """Show the result, unless the user is working on another page; the rail then marks the page of the result."""
        if current_theme().red:  # in a dark lab the large buttons must not move away
            return
        shown, place = self._shown()
        if place == "record" or shown == page or time.monotonic() - self._pressed > ELSEWHERE_S:
            self.context.go.emit(page, payload)

    def _watch(self) -> None:
        """Follow clicks and keys while H is being made.

        There is no event filter at other times: it would run for each event of the application. Building one page
        sends tens of thousands of events.
        """
        making = not MAKING.isdisjoint(self.context.jobs.running_pages())
        if making != self._watching and (app := QApplication.instance()) is not None:
            self._watching = making
            (app.installEventFilter if making else app.removeEventFilter)(self)

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Record the time of the last click or key press in the window."""
        if event.type() in (QEvent.Type.MouseButtonPress, QEvent.Type.KeyPress) and isinstance(watched, QWidget):
            if watched.window() is self._window:
                self._pressed = time.monotonic()
        return False
