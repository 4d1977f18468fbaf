"""A dark lab: large buttons, red on black, and one button for whatever comes next."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QPushButton

from lfcal_gui.context import Context
from lfcal_gui.pages.acquire._lab_panel import LabPanel
from lfcal_gui.pages.acquire.model_lab import KEYS, Standing, next_step
from lfcal_gui.pages.acquire.model_stills import still_files
from lfcal_gui.pages.acquire.panel import AcquirePanel
from lfcal_gui.pages.acquire.record_tab import RecordTab
from lfcal_gui.pages.acquire.setup_tab import SetupTab
from lfcal_gui.theme import NIGHT, current_theme

__all__ = ["Lab"]


class Lab(QObject):
    """Connects the large buttons with what the two tabs do."""

    def __init__(
        self, context: Context, tabs: AcquirePanel, setup: SetupTab, record: RecordTab, toggle: QPushButton
    ) -> None:
        super().__init__(toggle)
        self.context, self.tabs, self.setup, self.record, self.toggle = context, tabs, setup, record, toggle
        self.panel = LabPanel(tabs)
        self.panel.pressed.connect(self._pressed)
        toggle.setCheckable(True)
        toggle.toggled.connect(self._switch)
        self._before = ""
        record.shown.connect(self.show)
        tabs.record.told.connect(self._tell)
        self._tell()

    def _switch(self, on: bool) -> None:
        """Show the buttons and turn everything red, or go back to the colours before."""
        if on and current_theme() is not NIGHT:
            self._before = current_theme().name
            self.context.theme_asked.emit(NIGHT.name)
        elif not on and self._before and current_theme() is NIGHT:
            self.context.theme_asked.emit(self._before)
        self.panel.bar.setVisible(on)
        self.show()

    @property
    def standing(self) -> Standing:
        """How the sitting stands."""
        setup, record, state = self.setup, self.record, self.context.state
        folder = Path(state.recording) if state.recording else None
        dark, white = (
            folder is not None and still_files(folder, kind)[0].is_file() if record.folder.complete else False
            for kind in ("dark", "white")
        )
        return Standing(
            setup.station is not None,
            record.recording or setup.connecting or not setup.free,
            setup.measuring.found,
            record.folder.there is not None,
            record.folder.complete,
            len(state.redo),
            dark,
            white,
        )

    def show(self) -> None:
        """Show on each button what it does now."""
        plan = self.context.state.plan
        if plan is None or not self.toggle.isChecked():
            return
        key, words = next_step(self.standing, plan)
        self.panel.show_button("next", f"Next: {words}" if key else words, enabled=bool(key))
        for name, _ in KEYS[1:]:
            button = self.tabs.record.buttons[name]
            words = "Resume" if name == "start" and button.text() != "Start" else button.text()
            self.panel.show_button(name, words, enabled=button.isEnabled())

    def _tell(self) -> None:
        record = self.tabs.record
        alarms = record.alarms.text() if record.alarms.isVisibleTo(record) else ""
        said = ", ".join(filter(None, (record.status.text(), record.detail.text())))
        self.panel.show_status("<br>".join(filter(None, (said, alarms))))

    def _pressed(self, name: str) -> None:
        if name != "next":
            self.tabs.record.buttons[name].click()
            return
        plan = self.context.state.plan
        if plan is None:
            return
        key, _ = next_step(self.standing, plan)
        setup, record = self.setup, self.record
        actions: dict[str, Callable[[], None]] = {
            "connect": setup.connect_devices,
            **{name: lambda name=name: setup.measuring.find(name) for name in ("stage", "exposure", "dark", "white")},
            "use stage": lambda: setup.measuring.use("stage"),
            "use exposure": lambda: setup.measuring.use("exposure"),
            "start": record.start,
            "redo": lambda: record.start(redo=True),
            "assemble": record.after.assemble,
        }
        if key in actions:
            actions[key]()
        self.show()
