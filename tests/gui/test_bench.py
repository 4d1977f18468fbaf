"""The bench measures what it says; how long that takes decides nothing here."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication

from benchmarks.__main__ import command_line
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
    with pytest.raises(InputError, match="some of first_visits"):
        command_line().main(["window", "--only", "scrubing"], standalone_mode=False)


def test_pictures_of_a_scene_that_there_is_not_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It ended in a traceback."""
    assert take_pictures([str(tmp_path / "out"), "--scene", "start", "--size", "1280x800"]) == 2
    assert "--scene: expected some of empty" in capsys.readouterr().err and not (tmp_path / "out").exists()
