"""Messages are one printable line of a length to be read, whatever a file holds."""

from __future__ import annotations

import pickle

import pytest

from lfcal.acquire.errors import AcquisitionStopped
from lfcal.base.errors import MAX_MESSAGE, FileFormatError, LfcalError, StorageError, choose, one_line


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\nb\tc  d", "a b c d"),
        ("bell \x07, null \x00", r"bell \x07, null \x00"),
        ("right to left \u202e", r"right to left \u202e"),
        ("half \ud800", r"half \ud800"),
        ("5 µm", "5 µm"),
    ],
)
def test_one_printable_line(text: str, shown: str) -> None:
    assert one_line(text) == shown
    assert str(LfcalError(text)) == shown


@pytest.mark.parametrize("length", [479, 480, 481, 5000, 10**7])
def test_long_text_loses_its_middle(length: int) -> None:
    text = "begin" + "x" * (length - 8) + "end"
    line = one_line(text)
    assert len(line) == min(length, MAX_MESSAGE)
    assert line.startswith("begin") and line.endswith("end")


def test_a_huge_value_leaves_name_and_remedy() -> None:
    message = str(FileFormatError.expected("camera.name", "text", "x" * 10**6, "correct it"))
    assert message.startswith("camera.name: expected text, got xxx") and message.endswith("; correct it")
    assert len(message) < 250


def test_errors_of_the_system_and_with_entries_of_their_own() -> None:
    assert str(StorageError("a\nb")) == "a b"
    stopped = AcquisitionStopped("a\nb", 3)
    assert str(stopped) == "a b" and stopped.acknowledged == 3
    assert str(pickle.loads(pickle.dumps(StorageError("a\nb")))) == "a b"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("benhc", "did you mean bench?"),
        ("BENCH", "did you mean bench?"),
        ("r28", "did you mean R29?"),
        ("x" * 10**6, "choose one of these"),
        ("", "choose one of these"),
        ("microscope", "choose one of these"),
        (7, "choose one of these"),
    ],
    ids=lambda value: str(value)[:12],
)
def test_a_misspelt_name_brings_the_one_that_is_like_it(name: object, said: str) -> None:
    assert choose(name, ("bench", "R29", "lfm_20x05")) == said
