"""Acquire: set the devices up, record a session, see at once whether it is good."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtWidgets import QTabWidget, QVBoxLayout

from gui.base_page import StagePage
from gui.context import Context
from gui.models.page import Stage
from gui.models.project import SessionState
from gui.pages.acquire.record_tab import RecordTab
from gui.pages.acquire.setup_tab import SetupTab

__all__ = ["Page"]

FOLLOWED = ("plan", "camera", "extra", "recording", "redo")


class Page(StagePage):
    """Two tabs over one set of devices."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.setup = SetupTab(context, self)
        self.record = RecordTab(context, self.setup, self)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.addTab(self.setup.panel, "Set up")
        self.tabs.addTab(self.record.panel, "Record")
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.tabs)
        context.theme_changed.connect(self.setup.panel.apply_theme)
        context.theme_changed.connect(self.record.panel.apply_theme)
        self._show(context.state, folder=True)

    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Follow plan, settings, recording and the list of positions to redo."""
        if any(getattr(old, key) != getattr(new, key) for key in FOLLOWED):
            self._show(new, folder=old.recording != new.recording)

    def _show(self, state: SessionState, *, folder: bool) -> None:
        if state.plan is None:
            self.show_empty(
                "Recording needs a scan plan: which positions, planes and cutout.",
                {"Plan": lambda: self.context.go.emit("plan", None)},
            )
            return
        self.show_body()
        self.setup.show_state(state)
        self.record.show_state(state, folder=folder)

    def entered(self) -> None:
        """Look for devices the first time."""
        self.setup.entered()

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped session folder."""
        if len(paths) == 1 and (Path(paths[0]) / "session.json").is_file():
            self.record.set_folder(paths[0])
            self.tabs.setCurrentWidget(self.record.panel)
            return True
        return False
