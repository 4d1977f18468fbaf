"""The window with content is laid out well: no text is cut, nothing overlaps, no scroll bar for a few pixels."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication, QHBoxLayout, QLabel, QWidget
from pytestqt.qtbot import QtBot

from gui.scenes.all import SCENES
from gui.scenes.sample import camera, frames, open_sample, psf
from gui.scenes.stage import Scene, Stage
from gui.window import MainWindow
from tests.gui.layout import flaws

SMALL, LARGE = (1280, 800), (1920, 1080)


@pytest.fixture
def stage(qapp: QApplication, window: MainWindow, tmp_path: Path) -> Stage:
    window.resize(*SMALL)
    return Stage(qapp, window, tmp_path / "made")


def looked_at(stage: Stage, scene: Scene, *sizes: tuple[int, int]) -> Iterator[str]:
    """Play a scene and yield what is wrong with each of its states."""
    for shot in scene(stage):
        before = {shot.name: flaws(shot.widget or stage.window)}
        for size in sizes:
            stage.window.resize(*size)
            stage.turn(20)
            found = flaws(shot.widget or stage.window)
            now = (stage.window.width(), stage.window.height())
            if now != size:
                found.append(f"the window is {now[0]} x {now[1]}")
            before[f"{shot.name} at {size[0]} x {size[1]}"] = found
        yield from (f"{state}: {one}" for state, wrong in before.items() for one in wrong)


def test_pages_with_the_sample_session(stage: Stage) -> None:
    open_sample(stage)
    for scene in (camera, frames, psf):
        assert not list(looked_at(stage, scene, SMALL))


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_every_state_at_both_sizes(name: str, stage: Stage) -> None:
    wrong = list(looked_at(stage, SCENES[name], SMALL, LARGE))
    assert not wrong, "\n".join(wrong)


def test_what_is_wrong_is_found(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    row = QHBoxLayout(root)
    first, second = QLabel("words that have less room than they need"), QLabel("other words")
    for label in (first, second):
        row.addWidget(label)
    root.show()
    root.resize(600, 60)
    assert not flaws(root)
    first.setFixedWidth(60)
    QApplication.processEvents()
    assert any("needs" in one and "has 60" in one for one in flaws(root))
    first.setFixedWidth(280)
    QApplication.processEvents()
    second.move(first.x() + 20, second.y())
    assert any("overlaps" in one for one in flaws(root))
    second.move(590, second.y())
    assert any("reaches out" in one for one in flaws(root))
