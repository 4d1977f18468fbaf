"""The bench measures what it says; how long that takes decides nothing here."""

from __future__ import annotations

import math

import pytest
from PySide6.QtWidgets import QApplication

from benchmarks.window import MEASURED, WORDS, command, live_frames, scrubbing
from lfcal.base.errors import InputError


def test_pictures_and_frames_are_shown_and_timed(qapp: QApplication) -> None:
    scrubbed, live = scrubbing(0.01, pictures=3), live_frames(0.01, seconds=0.3)
    assert scrubbed["plane"] == "55 x 95 x 19²" and live["frame"] == "657 x 438 px"
    for found, key in ((scrubbed, "busy_ms"), (live, "busy_ms"), (live, "all_ms")):
        assert math.isfinite(found[key]) and found[key] > 0
    assert "a picture" in WORDS["scrubbing"](scrubbed) and "a second" in WORDS["live_frames"](live)
    assert set(WORDS) == set(MEASURED)


def test_the_command_measures_what_is_asked_for(qapp: QApplication, capsys: pytest.CaptureFixture[str]) -> None:
    """Called as ``benchmarks window --small --only scrubbing --json``."""
    assert ("window", "--small", "--only", "--json") and "benchmarks"
    with pytest.raises(InputError, match="some of first_visits"):
        command(small=True, only="scrubing", json=True)
