"""Comparison of two H as a job, for the place H and the gallery of sessions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from PySide6.QtWidgets import QFileDialog

from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import (
    CommandStep,
    CompareRequest,
    KeptDifference,
    Place,
    Taken,
    capital,
    compare_step,
    compared_files,
    compared_numbers,
    compared_rows,
    compared_words,
    differing_most,
    iter_compare,
    iter_compared,
    plane_of_row,
)
from lfcal_gui.saving import may_replace
from lfcal_gui.widgets import ComparedNumbers

if TYPE_CHECKING:
    from lfcal.judge import Comparison

READY = "Press Compare (F5) to compare all positions of both H."


class Comparing:
    """Compares two files. The comparison is discarded when either of them changes.

    Parameters
    ----------
    panel, context
        Panel that shows the comparison, and context of the window.
    page
        Key of the page.
    """

    def __init__(self, panel: ComparedNumbers, context: Context, page: str) -> None:
        self._panel, self._context, self._page = panel, context, page
        self.found: Comparison | None = None
        self._asked: CompareRequest | None = None
        self._place: Place = (0, 0, 0)
        self._kept = KeptDifference()
        self._job = 0
        panel.compare_asked.connect(self.compare)
        panel.report_asked.connect(self.write_report)
        panel.pairing_chosen.connect(self.pairing_chosen)
        panel.row_chosen.connect(self._row_chosen)
        panel.place_chosen.connect(self.show_place)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)

    # -- what is compared ------------------------------------------------------------------------------
    def request(self) -> CompareRequest | None:
        """Return the request for the current comparison; None if a file is missing."""
        raise NotImplementedError

    def pairing_chosen(self, by_number: bool) -> None:
        """Pair planes by number or by depth, as chosen."""
        raise NotImplementedError

    def follow(self) -> None:
        """Discard the comparison if other files have been chosen."""
        now = self.request()
        if now != self._asked:
            self.release()
            self._asked = now
            self._panel.show_message(self.missing() if now is None else READY)
        self._show_buttons()

    def missing(self) -> str:
        """Return why nothing can be compared, or what to choose."""
        raise NotImplementedError

    def release(self) -> None:
        """Discard the comparison, and stop a running one."""
        number, self._job = self._job, 0
        if number:
            self._context.jobs.cancel(number)
        self.found = self._asked = None

    def _show_buttons(self) -> None:
        self._panel.compare_button.setEnabled(self._asked is not None and not self._job)
        self._panel.report_button.setEnabled(self.found is not None and not self._job)

    # -- comparing -------------------------------------------------------------------------------------
    def compare(self) -> None:
        """Compare both files as a job."""
        self.follow()
        asked = self._asked
        if asked is None or self._job:
            return
        self._kept, self.found = KeptDifference(), None
        kept = self._kept
        self._panel.show_message(f"Comparing {' and '.join(asked.names)} …")
        self._job = self._context.jobs.start(
            f"Compare {' and '.join(asked.names)}",
            self._page,
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
        """Write the report of the comparison as a job; without a folder, ask for one."""
        found, asked = self.found, self._asked
        if found is None or asked is None:
            return
        chosen = folder or QFileDialog.getExistingDirectory(self._panel, "Folder for the report")
        if not chosen or (not folder and not may_replace(self._panel, compared_files(chosen))):
            return
        self._context.jobs.start(
            f"Report on {' and '.join(asked.names)}",
            self._page,
            lambda: iter_compared(asked, found, chosen),
            lambda page: self._context.message.emit(f"report written: {page}"),
            abandon=True,
            needs=(asked.first[0], asked.second[0]),
            taken=self._taken(asked, chosen),
        )

    def _taken(self, asked: CompareRequest, folder: str = "") -> Taken:
        """Return the entry of the history for a comparison, with its report in ``folder`` if one is written."""

        def made() -> CommandStep:
            files = asked.first[0], asked.second[0]
            return compare_step(*files, folder, by_number=asked.by_number, mat_order=asked.mat_order)

        return self._context.taken(self._page, f"Compare {' and '.join(asked.names)}", step=made)

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self) -> None:
        found, asked = self.found, self._asked
        if found is None or asked is None:
            return
        worst = differing_most(found)
        self._panel.show_numbers(
            asked.names, compared_words(found), compared_rows(found), compared_numbers(found), worst
        )
        for path in (asked.first[0], asked.second[0]):
            self._context.matrices.want(path)
        self.show_place(worst[0][1] if worst else (0, 0, 0))

    def _row_chosen(self, row: int) -> None:
        if self.found is not None and (plane := plane_of_row(self.found, row)) is not None:
            self.show_place((plane, *self._place[1:]))

    def show_place(self, place: Place) -> None:
        """Show a position of both H."""
        raise NotImplementedError
