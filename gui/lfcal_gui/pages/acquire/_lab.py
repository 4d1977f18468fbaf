"""Mode for a dark lab: large buttons in red on black, and one button for the next step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSizePolicy, QWidget

from lfcal.acquire import still_files
from lfcal_gui.context import Context
from lfcal_gui.pages.acquire.panel import AcquirePanel
from lfcal_gui.pages.acquire.record_tab import RecordTab
from lfcal_gui.pages.acquire.setup_tab import SetupTab
from lfcal_gui.theme import NIGHT, current_theme
from lfcal_gui.widgets import card, column_of

KEYS = (("next", "F9"), ("start", "F6"), ("pause", "F7"), ("stop", "F8"), ("abort", "Shift+F8"))
"""Buttons and their keys, in their order."""


@dataclass(frozen=True)
class Standing:
    """State of a recording session in the lab.

    Attributes
    ----------
    connected
        Whether devices are connected.
    running
        Current activity of the devices in words; empty if there is none.
    found
        Results of the completed measurements by name: ``"stage"``, ``"axis"``, ``"exposure"``.
    begun, complete
        Whether the folder contains a recording, and whether it is complete.
    redo
        Number of positions to record again.
    dark, white
        Whether the folder contains these frames.
    """

    connected: bool = False
    running: str = ""
    found: Mapping[str, Any] = field(default_factory=dict)
    begun: bool = False
    complete: bool = False
    redo: int = 0
    dark: bool = False
    white: bool = False


def next_step(now: Standing) -> tuple[str, str]:
    """Return key and text of the next step; the key is empty if no step can be started now."""
    if now.running:
        return "", now.running
    if not now.connected:
        return "connect", "Connect"
    if now.complete:
        return _afterwards(now)
    if now.begun:  # what was measured before it began is not asked for again
        return "start", "Continue recording"
    if "stage" not in now.found:
        return "stage", "Measure the stage"
    if "exposure" not in now.found:
        return "exposure", "Find exposures"
    return "start", "Record"


def _afterwards(now: Standing) -> tuple[str, str]:
    if now.redo:
        return "redo", f"Record {now.redo} again"
    if not now.dark:
        return "dark", "Dark frames"
    if not now.white:
        return "white", "White image"
    return "assemble", "Assemble H …"


TIPS = {
    "next": "Next step of the session: connect, measure, record, dark and white frames, assemble",
    "start": "Record every position, or continue the session",
    "pause": "Finish the current position, then wait; press again to continue",
    "stop": "Finish the current position, then stop; the session can be resumed",
    "abort": "Stop the stage now; recorded positions are safe",
}


class Lab(QWidget):
    """Content of the page; in the mode for a dark lab, it ends with the status and large buttons."""

    def __init__(
        self, context: Context, tabs: AcquirePanel, setup: SetupTab, record: RecordTab, toggle: QPushButton
    ) -> None:
        super().__init__()
        self.context, self.tabs, self.setup, self.record, self.toggle = context, tabs, setup, record, toggle
        self._before = ""
        self.bar, column = card()
        self.status = QLabel("", wordWrap=True)
        self.status.setProperty("role", "big")
        self.status.setAccessibleName("Status of the recording")
        # long words never make the window wider
        self.status.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        column.addWidget(self.status)
        column.addLayout(self._buttons())
        column_of(tabs, self.bar, of=self, spacing=8, stretch=0)
        self.bar.hide()
        toggle.setCheckable(True)
        toggle.toggled.connect(self._switch)
        record.shown.connect(self.show_controls)
        tabs.record.noted.connect(self._report)
        self._report()

    def _buttons(self) -> QHBoxLayout:
        row = QHBoxLayout()
        row.setSpacing(8)
        self.buttons: dict[str, QPushButton] = {}
        for key, shortcut in KEYS:
            button = QPushButton()
            button.setProperty("role", "big")
            button.setToolTip(f"{TIPS[key]} ({shortcut})")
            button.clicked.connect(lambda _=False, key=key: self._pressed(key))
            # the words change, the place does not
            button.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            self.buttons[key] = button
            row.addWidget(button, 2 if key == "next" else 1)
        return row

    def press(self, key: str) -> None:
        """Press the button of a key if it is visible and enabled."""
        if self.bar.isVisible():
            self.buttons[key].click()

    def _switch(self, on: bool) -> None:
        """Switch to the dark-lab mode with its buttons and red theme, or back to the previous theme."""
        if on and current_theme() is not NIGHT:
            self._before = current_theme().name
            self.context.theme_asked.emit(NIGHT.name)
        elif not on and self._before and current_theme() is NIGHT:
            self.context.theme_asked.emit(self._before)
        self.bar.setVisible(on)
        self.show_controls()

    @property
    def _running(self) -> str:
        """Current activity of the devices in words."""
        setup, recorder = self.setup, self.record.recorder
        if self.record.recording:
            return "Paused" if recorder is not None and recorder.control.pausing else "Recording …"
        return "Connecting …" if setup.connecting else "" if setup.free else "Measuring …"

    @property
    def standing(self) -> Standing:
        """State of the session, which determines the next step."""
        setup, record, state = self.setup, self.record, self.context.state
        folder = Path(state.recording) if state.recording else None
        dark, white = (
            folder is not None and still_files(folder, kind)[0].is_file() if record.folder.complete else False
            for kind in ("dark", "white")
        )
        return Standing(
            setup.station is not None,
            self._running,
            setup.measuring.found,
            record.folder.there is not None,
            record.folder.complete,
            len(state.redo),
            dark,
            white,
        )

    def show_controls(self) -> None:
        """Set the current action of each button."""
        if self.context.state.plan is None or not self.toggle.isChecked():
            return
        key, words = next_step(self.standing)
        self._show_button("next", f"Next: {words}" if key else words, enabled=bool(key))
        for name, _ in KEYS[1:]:
            button = self.tabs.record.buttons[name]
            words = "Resume" if name == "start" and button.text() != "Start" else button.text()
            self._show_button(name, words, enabled=button.isEnabled())

    def _show_button(self, key: str, words: str, *, enabled: bool) -> None:
        button = self.buttons[key]
        button.setText(f"{words}\n{dict(KEYS)[key]}")
        button.setAccessibleName(f"{words} ({key})")
        button.setEnabled(enabled)

    def _report(self) -> None:
        record = self.tabs.record
        said = ", ".join(filter(None, (record.status.text() or "Not recording.", record.detail.text())))
        self.status.setText("<br>".join(filter(None, (said, record.alarms.text()))))

    def _pressed(self, name: str) -> None:
        if name != "next":
            self.tabs.record.buttons[name].click()
            return
        if self.context.state.plan is None:
            return
        key, _ = next_step(self.standing)
        setup, record = self.setup, self.record
        actions: dict[str, Callable[[], None]] = {
            "connect": setup.connect_devices,
            **{name: lambda name=name: setup.measuring.find(name) for name in ("stage", "exposure", "dark", "white")},
            "start": record.start,
            "redo": lambda: record.start(redo=True),
            "assemble": record.after.assemble,
        }
        if key in actions:
            actions[key]()
        self.show_controls()
