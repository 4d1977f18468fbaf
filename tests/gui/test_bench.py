"""The bench measures what it says; how long that takes decides nothing here."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from PySide6.QtWidgets import (
    QApplication,
    QComboBox,
    QLabel,
    QLineEdit,
    QPushButton,
    QScrollArea,
    QSpinBox,
    QVBoxLayout,
    QWidget,
)
from pytestqt.qtbot import QtBot

from benchmarks.__main__ import command_line
from benchmarks._window_layout import controls, hovering, layout
from benchmarks.window import MEASURED, WORDS, live_frames, scrubbing
from lfcal.base.errors import InputError
from lfcal_gui.screenshots import main as take_pictures


def test_pictures_and_frames_are_shown_and_timed(qapp: QApplication) -> None:
    scrubbed, live = scrubbing(0.01, pictures=3), live_frames(0.01, seconds=0.3)
    assert scrubbed["plane"] == "55 x 95 x 19²" and live["frame"] == "657 x 438 px"
    for found, key in ((scrubbed, "busy_ms"), (live, "busy_ms"), (live, "all_ms")):
        assert math.isfinite(found[key]) and found[key] > 0
    assert "a picture" in WORDS["scrubbing"](scrubbed) and "a second" in WORDS["live_frames"](live)
    assert set(WORDS) == set(MEASURED)


def test_the_command_measures_what_is_asked_for(
    qapp: QApplication, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ``python -m benchmarks window``, but for the time that measuring takes."""
    monkeypatch.setattr("benchmarks.window.scrubbing", lambda scale: {"scale": scale})
    words = ["window", "--small", "--only", "scrubbing", "--json"]
    command_line().main(words, standalone_mode=False)
    assert json.loads(capsys.readouterr().out) == {"scrubbing": {"scale": 0.1}}
    with pytest.raises(InputError, match="some of layout"):
        command_line().main(["window", "--only", "scrubing"], standalone_mode=False)


def test_pictures_of_a_scene_that_there_is_not_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It ended in a traceback."""
    assert take_pictures([str(tmp_path / "out"), "--scene", "start", "--size", "1280x800"]) == 2
    assert "--scene: expected some of empty" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_controls_are_counted_once_and_only_where_they_are_seen(qtbot: QtBot) -> None:
    root, inside = QWidget(), QWidget()
    qtbot.addWidget(root)
    column, rows = QVBoxLayout(root), QVBoxLayout(inside)
    hidden = QPushButton("not seen")
    for part in (QPushButton("a"), QSpinBox(), QComboBox(), QLineEdit(), QLabel("no control"), hidden):
        column.addWidget(part)
    area = QScrollArea()
    area.setWidgetResizable(True)
    for k in range(40):
        rows.addWidget(QPushButton(f"row {k}"))
    area.setWidget(inside)
    area.setFixedHeight(60)
    column.addWidget(area)
    hidden.hide()
    root.show()
    QApplication.processEvents()
    reached = sum(not row.visibleRegion().isEmpty() for row in inside.findChildren(QPushButton))
    assert 1 <= reached < 5 and len(controls(root)) == 4 + reached


def test_no_place_shows_more_than_20_controls_and_h_takes_its_share(qapp: QApplication) -> None:
    found = layout()
    assert found["header"] <= 3 and found["rail"] == 5
    assert {name: one["controls"] for name, one in found["views"].items() if not 3 < one["controls"] <= 20} == {}
    assert {one["primary"] for one in found["views"].values()} == {1}
    shares = {"1920x1080": 0.45, "1280x800": 0.35, "1000x600": 0.28}
    assert all(found["shares"][size]["share"] > least for size, least in shares.items())
    assert "H and HT at 1280x800" in WORDS["layout"](found)


@pytest.mark.long
def test_hovering_over_the_sample_is_measured(qapp: QApplication) -> None:
    times = hovering(20)
    assert all(math.isfinite(ms) and ms > 0 for name, ms in times.items() if not name.endswith("_long"))
    assert "HT drawn: median" in WORDS["hovering"](times)
