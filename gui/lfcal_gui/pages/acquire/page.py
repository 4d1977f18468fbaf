"""Record > Rig: connect the devices, record a session, and follow its quality."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QWidget

from lfcal.base import format_count
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.models import PageSpec, ProjectState, kept_verdict
from lfcal_gui.pages.acquire import takes
from lfcal_gui.pages.acquire._lab import KEYS, Lab
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.panel import AcquirePanel
from lfcal_gui.pages.acquire.record_tab import RecordTab
from lfcal_gui.pages.acquire.setup_panel import SetupPanel
from lfcal_gui.pages.acquire.setup_tab import SetupTab

JOGS = (
    ("Ctrl+Left", 0, -1),
    ("Ctrl+Right", 0, 1),
    ("Ctrl+Down", 1, -1),
    ("Ctrl+Up", 1, 1),
    ("Ctrl+Shift+Down", 2, -1),
    ("Ctrl+Shift+Up", 2, 1),
)
"""Axis and direction of the step that each key makes."""

FOLLOWED = ("plan", "camera", "recording", "redo")


class Page(BasePage):
    """Page with the devices, their live view, and the session that is recorded with them."""

    def __init__(self, spec: PageSpec, context: Context, panel: AcquirePanel | None = None) -> None:
        super().__init__(spec, context)
        self.panel = AcquirePanel(SetupPanel(context.jobs)) if panel is None else panel
        self.setup = SetupTab(context, self.panel.setup, self)
        self.record = RecordTab(context, self.setup, self.panel.record, self)
        self.record.ended.connect(lambda: self._show(context.state, folder=False))
        self.record.asked.connect(self._ask)
        toggle = self.tool_button("Dark lab", "Large buttons with keys, red on black (F11)", lambda: None)
        self.lab = Lab(context, self.panel, self.setup, self.record, toggle)
        self.set_panel(self.lab)
        self._add_shortcuts()
        self.theme_changed.connect(self.panel.apply_theme)
        self._show(context.state, folder=True)

    @staticmethod
    def parts(context: Context) -> Iterator[QWidget]:
        """Make the live view, and then the panel."""
        setup = SetupPanel(context.jobs)
        yield setup
        yield AcquirePanel(setup)

    def let_go(self) -> None:
        """Discard frames, results and requests of the previous project; a running recording is shown until it ends."""
        self.setup.let_go()
        self.record.let_go()

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        setup, record = self.setup, self.record
        tabs: dict[QWidget, dict[str, Callable[[], object]]] = {
            self.panel.setup: {
                "connect": setup.connect_devices,
                "adjust": lambda: setup.measuring.find("stage"),
            },
            self.panel.record: {
                "record": self._record,
                "resume": record.resume,
                "pause": record.pause,
                "stop": record.stop,
                "redo": self._record_bad,
                "folder": record.folder_choice.ask,
                "assemble": self._assemble,
            },
        }
        return {name: partial(self._on_tab, tab, deed) for tab, own in tabs.items() for name, deed in own.items()}

    def _record(self) -> None:
        folder = "" if self.context.state.recording else self.context.own_path("session")
        if folder:
            self.context.project.update("session folder", recording=folder)
        self.record.start()

    def _assemble(self) -> None:
        """Assemble H of the session in its folder; if the file exists, ask for another one."""
        own = Path(self.context.state.recording) / "H.h5"
        self.record.after.assemble("" if own.exists() else str(own))

    def _record_bad(self) -> None:
        verdict = kept_verdict(self.context.state)
        if verdict is not None and verdict.redo:
            self.context.project.update("positions to record again", redo=verdict.redo)
            self.redo()

    def _on_tab(self, tab: QWidget, deed: Callable[[], object]) -> None:
        self.panel.setCurrentWidget(tab)
        deed()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if plan, settings, recording or the positions to record again changed."""
        same = AcquireSettings.of(old) == AcquireSettings.of(new)
        if not same or any(getattr(old, key) != getattr(new, key) for key in FOLLOWED):
            self._show(new, folder=old.recording != new.recording)

    def _show(self, state: ProjectState, *, folder: bool) -> None:
        self.record.show_state(state, folder=folder)
        if state.plan is None and not self.record.recording:  # a running recording keeps its buttons
            self.show_empty(
                "No scan planned yet\nA scan plan states where the point source goes. It follows from the camera.",
                {"Go to Set up": self.lead("setup", "Choose the source positions and depth planes of the scan")},
            )
            return
        self.show_body()
        self.setup.show_state(state)
        self.lab.show_controls()

    def _ask(self, words: str) -> None:
        recorder = self.record.recorder
        if not words or recorder is None:
            self.notice.clear()
            return
        answer, skip = recorder.cover.answer, recorder.cover.skippable
        leave = (lambda: answer(skip=True)) if skip else None
        self.notice.offer(
            words,
            "Continue",
            answer,
            leave,
            stay="Skip",
            tip="Continue the recording",
            stay_tip="Record without dark frames",
        )
        self.notice.leave.setVisible(skip)
        self.context.message.emit(words)

    def _add_shortcuts(self) -> None:
        stage = self.panel.setup.stage
        for keys, axis, sign in JOGS:
            self.shortcut(keys, lambda axis=axis, sign=sign: stage.press(axis, sign))
        self.shortcut("Ctrl+G", lambda: self.panel.setup.stage.type_target())
        self.shortcut("Esc", stage.stop_asked.emit)
        self.shortcut("F11", self.lab.toggle.click)
        for key, shortcut in KEYS:
            self.shortcut(shortcut, lambda key=key: self.lab.press(key))

    def entered(self) -> None:
        """Search for devices at the first visit, and check whether another program has changed the session's folder."""
        self.setup.entered()
        self.record.refresh()
        if self.context.state.recording and not self.record.recording:
            self.record.folder_choice.look()

    def receive(self, payload: Any) -> None:
        """Record positions again if another page requests it (``"redo"``)."""
        if payload == "redo":
            self.redo()

    def redo(self) -> bool:
        """Record the project's list of positions again and assemble H again; return whether this started.

        If no devices are connected, the page asks for them, and continues when they are connected.
        """
        state, count = self.context.state, len(self.context.state.redo)
        if not count or state.plan is None:
            return False
        if not state.recording:
            self.refuse("Choose the folder of the session that H was assembled from, then record the positions again.")
        elif self.record.recording or not self.setup.free:
            self.refuse(f"The devices are in use. {count} positions can be recorded again afterwards.")
        elif self.setup.station is None:
            words = (
                f"Connect camera and stage; {format_count(count, 'position is', 'positions are')} then recorded again."
            )
            self.setup.when_connected(self.redo)
            forget = partial(self.setup.when_connected, None)
            tip = "Connect the devices chosen in Record > Rig, and record these positions again"
            self.notice.offer(
                words,
                "Connect",
                self.setup.connect_devices,
                forget,
                stay="Not now",
                tip=tip,
                stay_tip="Hide this message. Nothing is recorded when you connect the devices",
            )
        else:
            self.notice.clear()
            self.record.start(redo=True)
            return True
        return False

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped session folder."""
        if len(paths) == 1 and takes(paths[0]):
            self.record.folder_choice.take(paths[0])
            self.panel.setCurrentWidget(self.panel.record)
            return True
        return False
