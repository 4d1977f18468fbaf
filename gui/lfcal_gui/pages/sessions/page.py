"""Sessions: gallery of recordings and results, quality over time, and comparison of two results."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QUrl
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QFileDialog

from lfcal.base import format_count
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import PageSpec, ProjectState, capital, stated_order
from lfcal_gui.pages.sessions import model
from lfcal_gui.pages.sessions._looking import Looking
from lfcal_gui.pages.sessions._pairing import Pairing
from lfcal_gui.pages.sessions.model import SessionsSettings, Verdict
from lfcal_gui.pages.sessions.model_kept import JudgedResult, KeptResults, iter_judged
from lfcal_gui.pages.sessions.panel import SessionsPanel
from lfcal_gui.pages.sessions.trend_panel import Trending

if TYPE_CHECKING:
    from lfcal.judge import ResultList, StoredResult

RECENT = "sessions/folders"
NO_FOLDER = "This project has no file yet.\nChoose a folder that contains recordings, H or other results."
NOTHING = "No results of lfcal were found here."
NO_MATCH = "No result matches the filter."
PAGES = ("index.html", "report/index.html")
"""Pages of a folder that the browser opens."""


class Page(BasePage):
    """Page that searches a folder when it is first shown, and on request."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.results: list[StoredResult] = []
        self.verdicts: dict[Path, Verdict] = {}
        self._looked: tuple[str, ...] | None = None
        self._notes: tuple[str, ...] = ()
        self._judging: dict[int, tuple[StoredResult, JudgedResult]] = {}
        self._recent: list[str] = context.kept_texts(RECENT)
        self._make_buttons()
        self.panel = SessionsPanel()
        self.looking = Looking(context.jobs, KeptResults(), self)
        self.trending = Trending(self.panel.trend, context)
        self._connect()
        self.set_panel(self.panel)
        self.panel.show_settings(self.settings, self._recent)
        self._show_chosen()

    def _make_buttons(self) -> None:
        self.judge_button = self.tool_button(
            "Judge",
            "Measure the selected H and compare it with its camera; its tile then shows the verdict",
            self.judge,
        )
        self.compare_button = self.tool_button("Compare", "Compare the two selected results (Ctrl+D)", self.compare)
        self.stop_button = self.stop_tool("Stop judging or comparing")
        self.open_button = self.tool_button("Open", "Open the selected result on its page (Return)", self.open_chosen)

    def _connect(self) -> None:
        panel, looking = self.panel, self.looking
        looking.began.connect(self._began)
        looking.found.connect(self._found)
        looking.ended.connect(self._ended)
        looking.failed.connect(self._failed)
        looking.pictured.connect(panel.tiles.show_picture)
        panel.tiles.seen.connect(looking.want)
        panel.tiles.chosen.connect(self._show_chosen)
        panel.tiles.opened.connect(self.open_chosen)
        panel.folder.activated.connect(lambda _: self._set(folder=panel.folder.currentData()))
        panel.kind.activated.connect(lambda _: self._set(kind=panel.kind.currentData()))
        panel.order.activated.connect(lambda _: self._set(order=panel.order.currentData()))
        panel.words.textChanged.connect(lambda _: self._show())
        panel.choose_button.clicked.connect(lambda _: self.choose())
        panel.again_button.clicked.connect(lambda _: self.look())
        panel.currentChanged.connect(lambda _: self._show_trend())
        self.theme_changed.connect(self._apply_theme)
        self.context.jobs.finished.connect(self._job_finished)
        self.shortcut("F5", self.look)
        self.shortcut("Ctrl+D", self.compare)

    @cached_property
    def pairing(self) -> Pairing:
        """The comparison of two results, which is created on demand."""
        return Pairing(self.panel, self.context)

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> SessionsSettings:
        """The user's settings."""
        return SessionsSettings.of(self.context.state)

    @property
    def folders(self) -> tuple[str, ...]:
        """The folders to search."""
        chosen = self.settings.folder
        return (
            (chosen,) if chosen != model.PROJECT else model.own_folders(self.context.state, self.context.project.path)
        )

    def let_go(self) -> None:
        """Discard the comparison of the previous project."""
        if "pairing" in self.__dict__:
            self.pairing.let_go()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if settings or the folders of the project changed."""
        if SessionsSettings.of(old) != SessionsSettings.of(new):
            self.panel.show_settings(self.settings, self._recent)
            self._show()
        if old.settings != new.settings:
            self._take_verdict()
        if self.isVisible():
            self._look_if_new()

    def _take_verdict(self) -> None:
        """Show the verdict on the project's H, which other pages may have judged."""
        state = self.context.state
        for one in self.results:
            if state.psf and str(one.path) == str(Path(state.psf).absolute()):
                found = model.verdict_on(one, state)
                if found is not None and found != self.verdicts.get(one.path):
                    self.verdicts[one.path] = found
                    self._show()
                    self._show_chosen()

    def entered(self) -> None:
        """Search the folder, unless this was done already."""
        if "pairing" in self.__dict__:
            self.pairing.follow()
        self._look_if_new()

    def _look_if_new(self) -> None:
        if self.folders != self._looked:
            self.look()

    def _set(self, **changes: Any) -> None:
        settings = replace(self.settings, **changes)
        self.context.project.note(settings=settings.into(self.context.state))

    def choose(self, folder: str = "") -> None:
        """Search another folder; without a path, ask for one."""
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder to search")
        if folder:
            self._recent = model.recent_with(folder, self._recent)
            self.context.keep_texts(RECENT, self._recent)
            self._set(folder=folder)
            self.panel.show_settings(self.settings, self._recent)
            self._look_if_new()

    # -- looking ---------------------------------------------------------------------------------------
    def look(self) -> None:
        """Search the folder, even if this was done already."""
        self._looked = self.folders
        self.looking.start(self.folders, self.context.state)

    def _began(self) -> None:
        self.results, self.verdicts, self._notes = [], {}, ()
        self.panel.tiles.forget_pictures()
        self.panel.status.setText(f"Searching {', '.join(self.folders)} …" if self.folders else " ")
        self._show()

    def _found(self, seen: list[tuple[StoredResult, Verdict | None]], words: str) -> None:
        self.results += [one for one, _ in seen]
        self.verdicts |= {one.path: verdict for one, verdict in seen if verdict is not None}
        self.panel.status.setText(f"{capital(words)} …")
        if seen:
            self._show()

    def _ended(self, listing: ResultList) -> None:
        self._notes = listing.notes
        self.panel.status.setText("; ".join(listing.notes) or " ")
        self._show()

    def _failed(self, words: str) -> None:
        self.panel.status.setText(words)
        self._show()

    # -- showing ---------------------------------------------------------------------------------------
    def _show(self) -> None:
        found = model.shown(self.results, self.settings, self.panel.words.text(), self.verdicts)
        self.panel.tiles.show_results(found, self.verdicts)
        total = len(self.results)
        self.panel.counted.setText(
            format_count(total, "result", "results") if len(found) == total else f"{len(found)} of {total}"
        )
        if found:
            words = ""
        elif not self.folders:
            words = NO_FOLDER
        elif self.looking.active:
            words = "Searching …"
        else:
            words = NO_MATCH if self.results else "\n".join(self._notes) or NOTHING
        self.panel.show_message(words)
        self._show_trend()

    def _show_chosen(self) -> None:
        chosen = self.panel.tiles.selected()
        one = chosen[0] if len(chosen) == 1 else None
        refused = model.how_opened(one) if one is not None and model.how_opened(one).endswith(".") else ""
        self.open_button.setEnabled(one is not None and not refused)
        self.open_button.setToolTip(refused or "Open the selected result on its page (Return)")
        self.compare_button.setEnabled(len(chosen) == 2)
        busy = {result.path for result, _ in self._judging.values()}
        self.judge_button.setEnabled(one is not None and model.can_judge(one) and one.path not in busy)
        self.panel.show_facts(
            "" if one is None else one.name, [] if one is None else model.fact_rows(one, self.verdicts)
        )

    def _show_trend(self) -> None:
        if self.panel.currentWidget() is self.panel.trend and not self.looking.active:
            self.trending.show_results(
                model.shown(self.results, replace(self.settings, kind="report"), self.panel.words.text())
            )

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        self.trending.show()
        self._show_chosen()

    # -- doing -----------------------------------------------------------------------------------------
    def open_chosen(self) -> None:
        """Open the selected result: on its page, or in the browser."""
        chosen = self.panel.tiles.selected()
        if len(chosen) != 1:
            return
        one, how = chosen[0], model.how_opened(chosen[0])
        if how.endswith("."):
            self.refuse(how)
        elif how == "browser":
            self.load(one.name, lambda: _page_of(one.path), _browse)
        elif how == "reconstruct":
            self.context.project.update("open volume", volume=str(one.path))
            self.context.go.emit(how, None)
        else:
            self.context.files_offered.emit([str(one.path)])

    def compare(self) -> None:
        """Compare the two selected results."""
        chosen = self.panel.tiles.selected()
        if len(chosen) == 2:
            self.pairing.begin(chosen[0], chosen[1], self.verdicts)

    def judge(self) -> None:
        """Judge the selected H as a job."""
        chosen = self.panel.tiles.selected()
        if len(chosen) != 1 or not model.can_judge(chosen[0]):
            return
        one, kept = chosen[0], JudgedResult()
        path, order = str(one.path), stated_order(self.context.state, str(one.path))
        number = self.context.jobs.start(
            f"Judge {one.name}",
            "sessions",
            lambda: iter_judged(path, order, kept),
            abandon=True,
            leave=True,
            needs=(path,),
        )
        self._judging[number] = one, kept
        self._show_chosen()

    def _job_finished(self, job: WindowJob) -> None:
        if job.number not in self._judging:
            return
        one, kept = self._judging.pop(job.number)
        if kept.verdict is not None:
            self.verdicts[one.path] = verdict = kept.verdict
            self.context.jobs.compute(
                f"sessions keep {one.path}", lambda: self.looking.kept.keep_verdict(one, verdict), lambda _: None
            )
        elif job.error:
            self.refuse(job.error)
        self._show()
        self._show_chosen()


def _page_of(folder: Path) -> Path:
    """Return the HTML page of a report or a fit; the folder if there is none."""
    return next((folder / name for name in PAGES if (folder / name).is_file()), folder)


def _browse(path: Path) -> None:
    QDesktopServices.openUrl(QUrl.fromLocalFile(str(path)))
