"""Quality: a second H chosen beside the first, compared as a job, and looked at position by position."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtWidgets import QFileDialog

from lfcal.base import LfcalError, format_plane
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import CommandStep, Taken, stamp_of, stated_order
from lfcal_gui.pages.quality.compare_panel import NONE, ComparePanel
from lfcal_gui.pages.quality.model import QualitySettings, capital
from lfcal_gui.pages.quality.model_compare import (
    Both,
    CompareRequest,
    KeptDifference,
    Place,
    both_at,
    compared_files,
    iter_compare,
    iter_compared,
    numbers_of,
    plane_of_row,
    table_of,
    told_of,
    worst_of,
)
from lfcal_gui.pages.quality.step import compared
from lfcal_gui.saving import may_replace

if TYPE_CHECKING:
    from lfcal.judge import Comparison, Pair

__all__ = ["Comparing"]

FILES = "H files (*.h5 *.npy *.mat *.lfc);;All files (*)"
READY = "Press Compare (F5): all positions of both are compared."


class Comparing:
    """What is compared belongs to both files as they are; when either changes it is let go.

    Parameters
    ----------
    panel, context
        What shows it, and the window.
    """

    def __init__(self, panel: ComparePanel, context: Context) -> None:
        self._panel, self._context = panel, context
        self.found: Comparison | None = None
        self._asked: CompareRequest | None = None
        self._pair: Pair | None = None
        self._place: Place = (0, 0, 0)
        self._kept = KeptDifference()
        self._job = 0
        panel.choose_asked.connect(self.choose)
        panel.compare_asked.connect(self.compare)
        panel.report_asked.connect(self.write_report)
        panel.pairing_chosen.connect(self._pairing_chosen)
        panel.row_chosen.connect(self._row_chosen)
        panel.place_chosen.connect(self.show_place)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        context.matrices.changed.connect(self._matrix_changed)
        self.follow()

    # -- project ---------------------------------------------------------------------------------------
    def _now(self) -> CompareRequest | None:
        """Return what would be compared now; None where one of the two is missing."""
        state = self._context.state
        first, second = stamp_of(state.psf), stamp_of(state.reference)
        settings = QualitySettings.of(state)
        orders = stated_order(state, state.psf), stated_order(state, state.reference)
        return None if first is None or second is None else CompareRequest(first, second, settings.by_number, orders)

    def follow(self) -> None:
        """Show what belongs to the two H of now."""
        now, state = self._now(), self._context.state
        self._panel.show_second(Path(state.reference).name, by_number=QualitySettings.of(state).by_number)
        if now != self._asked:
            self.release()
            self._asked = now
            gone = f"{Path(state.reference).name} is not there any more." if state.reference and state.psf else NONE
            self._panel.show_message(gone if now is None else READY)
        self._show_buttons()

    def let_go(self) -> None:
        """Forget what was compared in another project."""
        self.release()
        self._asked = None
        self._panel.show_message(NONE)

    def release(self) -> None:
        """Forget what was compared, and stop what is at work."""
        number, self._job = self._job, 0
        if number:
            self._context.jobs.cancel(number)
        self.found = self._pair = self._asked = None

    def _show_buttons(self) -> None:
        self._panel.compare_button.setEnabled(self._asked is not None and not self._job)
        self._panel.report_button.setEnabled(self.found is not None and not self._job)

    def choose(self, path: str = "") -> None:
        """Take a second H, and compare with it."""
        path = path or QFileDialog.getOpenFileName(self._panel, "Open a second H", "", FILES)[0]
        if not path:
            return
        # known to be good before the project takes it
        self._panel.show_message(f"Opening {Path(path).name} …")

        begun = self._context.project.begun

        def taken() -> None:
            if begun != self._context.project.begun:  # the project it was opened for is no longer open
                if path not in (self._context.state.psf, self._context.state.reference):
                    self._context.forget(path)
                return
            self._context.project.update("second H", reference=path)
            self.follow()
            self.compare()

        def refused(words: str) -> None:
            if begun != self._context.project.begun:
                return
            self._asked = None
            self.follow()
            old = Path(self._context.state.reference).name
            self._panel.show_message(f"{words}\nThe second H is {old} as before. {READY}" if old else words)

        self._context.matrices.take(path, taken, refused)

    def _pairing_chosen(self, by_number: bool) -> None:
        state = self._context.state
        settings = replace(QualitySettings.of(state), by_number=by_number)
        self._context.project.update("how planes are paired", settings=settings.into(state))
        self.follow()

    # -- comparing -------------------------------------------------------------------------------------
    def compare(self) -> None:
        """Compare both as a job."""
        self.follow()
        asked = self._asked
        if asked is None or self._job:
            return
        self._kept, self.found = KeptDifference(), None
        kept = self._kept
        self._panel.show_message(f"Comparing {' and '.join(asked.names)} …")
        self._job = self._context.jobs.start(
            f"Compare {' and '.join(asked.names)}",
            "quality",
            lambda: iter_compare(asked, kept),
            abandon=True,
            leave=True,
            needs=(asked.first[0], asked.second[0]),
            taken=self._taken(asked),
        )
        self._show_buttons()

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.progress is not None:
            record = job.progress
            self._panel.show_message(f"{job.title}\n{capital(record.stage)}: {100 * record.fraction:.0f} %")

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job, found = 0, self._kept.found
        self._kept = KeptDifference()
        if found is None:
            self._panel.show_message(job.error or "Stopped.\n" + READY)
        else:
            self.found = found
            self._show()
        self._show_buttons()

    def write_report(self, folder: str = "") -> None:
        """Write the comparison as a page, as a job; without a folder it is asked for."""
        found, asked = self.found, self._asked
        if found is None or asked is None:
            return
        chosen = folder or QFileDialog.getExistingDirectory(self._panel, "Folder for the report")
        if not chosen or (not folder and not may_replace(self._panel, compared_files(chosen))):
            return
        self._context.jobs.start(
            f"Report on {' and '.join(asked.names)}",
            "quality",
            lambda: iter_compared(asked, found, chosen),
            lambda page: self._context.message.emit(f"report written: {page}"),
            abandon=True,
            needs=(asked.first[0], asked.second[0]),
            taken=self._taken(asked, chosen),
        )

    def _taken(self, asked: CompareRequest, folder: str = "") -> Taken:
        """Return a comparison, with its report in ``folder`` if there is one, for the history."""

        def made() -> CommandStep:
            files = asked.first[0], asked.second[0]
            return compared(*files, folder, by_number=asked.by_number, mat_order=asked.mat_order)

        return self._context.taken("quality", f"Compare {' and '.join(asked.names)}", step=made)

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self) -> None:
        found, asked = self.found, self._asked
        if found is None or asked is None:
            return
        worst = worst_of(found)
        self._panel.show_numbers(asked.names, told_of(found), table_of(found), numbers_of(found), worst)
        for path in (asked.first[0], asked.second[0]):
            self._context.matrices.want(path)
        self.show_place(worst[0][1] if worst else (0, 0, 0))

    def _row_chosen(self, row: int) -> None:
        if self.found is not None and (plane := plane_of_row(self.found, row)) is not None:
            self.show_place((plane, *self._place[1:]))

    def show_place(self, place: Place) -> None:
        """Show a position of both, and where it is."""
        from lfcal.judge.report import map_levels

        found = self.found
        if found is None:
            return
        self._place = place
        k = place[0]
        plane = format_plane(found.planes[k].depths_um[0], found.planes[k].planes[0], "z")
        error = 100 * found.error[k]
        self._panel.show_map(k, f"Difference over the positions, {plane}", error, map_levels(error))
        pair = self._opened()
        if pair is None:
            return
        where = f"at ({found.pair.planes[k][0]}, {place[1]}, {place[2]})"

        def read(both: Both) -> None:
            if self.found is found:
                self._panel.show_both(both, where)

        def failed(words: str) -> None:
            if self._pair is pair:  # else its files were let go for others
                self._context.message.emit(words)

        self._context.jobs.compute("quality both", lambda: both_at(pair, place), read, failed)

    def _opened(self) -> Pair | None:
        """Return both H as they are open in the window, None: not yet."""
        from lfcal.judge import pair

        if self._pair is None and self._asked is not None:
            a, b = (self._context.matrix(path) for path in (self._asked.first[0], self._asked.second[0]))
            if a is not None and b is not None:
                try:
                    self._pair = pair(a, b, by_number=self._asked.by_number)
                except LfcalError:  # other files than those that were compared; told when they are followed
                    return None
        return self._pair

    def _matrix_changed(self, path: str) -> None:
        if self._asked is not None and path in (self._asked.first[0], self._asked.second[0]):
            self._pair = None
            if self.found is not None:
                self.show_place(self._place)
