"""The dark lab: large buttons with keys, one of them for whatever comes next, red on black."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.devices import Frame
from lfcal.devices.simulated._camera import SimCamera
from lfcal_gui.models import ProjectState, colour_table
from lfcal_gui.pages.acquire._lab import KEYS, Standing, next_step
from lfcal_gui.theme import DARK, LIGHT, NIGHT, apply_theme, current_theme
from lfcal_gui.window import MainWindow
from tests.gui.pages.acquire._building import PLAN
from tests.gui.waiting import GUARD_MS

SOME = 12
"""Frames after which a recording of `PLAN` is neither at its beginning nor near its end."""


def test_each_step_follows_the_one_before() -> None:
    whole = Standing(connected=True, begun=True, complete=True)
    steps = (
        (Standing(), "connect"),
        (Standing(running="Connecting …"), ""),
        (Standing(connected=True), "stage"),
        (Standing(connected=True, found={"stage": None}), "exposure"),
        (Standing(connected=True, found={"stage": None, "exposure": PLAN.exposures}), "start"),
        (Standing(connected=True, begun=True), "start"),
        (replace(whole, redo=3), "redo"),
        (whole, "dark"),
        (replace(whole, dark=True), "white"),
        (replace(whole, dark=True, white=True), "assemble"),
    )
    assert [next_step(now)[0] for now, _ in steps] == [key for _, key in steps]
    assert all(words for _, words in (next_step(now) for now, _ in steps))


def test_night_is_red_alone() -> None:
    colours = [value for name, value in vars(NIGHT).items() if name not in ("name", "red")]
    rgb = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in colours])
    assert (rgb[:, 0] >= rgb[:, 1]).all() and (rgb[:, 1:].max() <= 0x8A) and (rgb[:, 2] <= 0x5C).all()
    for name in ("magma", "gray", "vanimo"):
        table = colour_table(name, red=True)
        assert not table[:, 1:3].any() and table[:, 0].max() > 200 and table[:, 0].min() < 80
    assert (np.diff(colour_table("magma", red=True)[:, 0].astype(int)) >= 0).all()


@pytest.fixture
def page(window: MainWindow, state: ProjectState, qtbot: QtBot) -> Any:
    window.set_theme("dark")
    window.files.start_with(state)
    window.go("acquire")
    made: Any = window.page("acquire")
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    made.panel.recording.open()
    yield made
    app = QApplication.instance()
    apply_theme(app, LIGHT)


def shown(page: Any, key: str) -> str:
    return str(page.lab.buttons[key].text())


def idle(page: Any, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: page.setup.free and not page.setup.connecting, timeout=GUARD_MS)


def test_a_sitting_by_the_large_buttons_and_their_keys(
    page: Any, window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    panel, context = page.lab, page.context
    page.lab.press("next")
    assert page.setup.station is None and not page.setup.connecting, "what is not shown is not pressed"
    qtbot.keyClick(page, Qt.Key.Key_F11)
    qtbot.waitUntil(lambda: NIGHT.text in page.styleSheet(), timeout=GUARD_MS)
    assert panel.bar.isVisible() and current_theme() is NIGHT
    assert page.panel.record.map.graphics.backgroundBrush().color().name() == NIGHT.panel
    assert shown(page, "next") == "Next: Connect\nF9" and shown(page, "start") == "Start\nF6"
    qtbot.keyClick(page, Qt.Key.Key_F9)
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    idle(page, qtbot)
    steps = []
    for _ in range(6):
        steps.append(shown(page, "next").split("\n")[0])
        if steps[-1] == "Next: Record":
            break
        qtbot.keyClick(page, Qt.Key.Key_F9)
        idle(page, qtbot)
    assert steps[0] == "Next: Measure the stage" and "Next: Find exposures" in steps and steps[-1] == "Next: Record"
    context.project.update("session folder", recording=str(tmp_path / "session"))
    qtbot.keyClick(page, Qt.Key.Key_F6)
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    assert panel.buttons["stop"].isEnabled()
    assert not panel.buttons["next"].isEnabled() and shown(page, "next") == "Recording …\nF9", "it said busy"
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    assert "Complete: 24 of 24 positions" in panel.status.text()
    for kind in ("Dark frames", "White image"):
        qtbot.waitUntil(lambda kind=kind: shown(page, "next") == f"Next: {kind}\nF9", timeout=GUARD_MS)
        panel.buttons["next"].click()
        idle(page, qtbot)
        qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: shown(page, "next") == "Next: Assemble H …\nF9", timeout=GUARD_MS)
    window.context.made.emit("h", None)
    assert window.shown is page, "the large buttons stay under the hand when H is made"
    qtbot.keyClick(page, Qt.Key.Key_F11)
    assert panel.bar.isHidden() and current_theme() is DARK
    assert window.settings.value("theme") == "dark", "the next start is as it was"


def test_large_buttons_are_large_and_whole(page: Any, window: MainWindow) -> None:
    page.lab.toggle.click()
    page.panel.setCurrentWidget(page.panel.record)
    for size in ((1280, 800), (1920, 1080)):
        window.resize(*size)
        QApplication.processEvents()
        assert (window.width(), window.height()) == size, "the window is not made larger by them"
        for key, shortcut in KEYS:
            button: QPushButton = page.lab.buttons[key]
            metrics = button.fontMetrics()
            for line in (*button.text().split("\n"), "Next: Measure the stage" if key == "next" else "Resume"):
                assert metrics.horizontalAdvance(line) + 20 <= button.width(), line
            assert button.height() >= 62 and 2 * metrics.height() <= button.height() and shortcut in button.text()
            assert button.accessibleName()
    page.lab.toggle.click()


def test_pause_and_stop_by_their_keys(page: Any, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped, grab, recorded = threading.Event(), SimCamera.grab, tmp_path / "session" / "recording.h5"

    def held(camera: SimCamera, timeout_s: float) -> Frame:
        """Wait after the first frames until the keys were pressed: all are recorded within a moment."""
        nonlocal frames
        frames += recorded.exists()
        if frames > SOME:
            stopped.wait(GUARD_MS / 1000)
        return grab(camera, timeout_s)

    frames = 0
    monkeypatch.setattr(SimCamera, "grab", held)
    page.context.project.update("folder", recording=str(tmp_path / "session"))
    page.lab.toggle.click()
    qtbot.keyClick(page, Qt.Key.Key_F6)
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: frames > SOME, timeout=GUARD_MS)
    qtbot.keyClick(page, Qt.Key.Key_F7)
    assert shown(page, "pause") == "Resume\nF7"
    qtbot.keyClick(page, Qt.Key.Key_F8)
    stopped.set()
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: shown(page, "start") == "Resume\nF6", timeout=GUARD_MS)
    page.lab.toggle.click()
