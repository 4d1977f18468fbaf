"""Messages are one printable line; numbers with their units; positions in the order of storage."""

from __future__ import annotations

import math
import pickle
from datetime import datetime

import numpy as np

from lfcal.acquire.errors import AcquisitionStopped
from lfcal.base.axes import Position, position_at
from lfcal.base.errors import MAX_MESSAGE, FileFormatError, LfcalError, StorageError, choose, one_line
from lfcal.base.units import (
    format_bytes,
    format_count,
    format_dates,
    format_length,
    format_number,
    format_seconds,
    format_share,
    format_slope,
    format_span,
)


def test_messages_are_one_printable_line() -> None:
    for text, shown in {
        "a\nb\tc  d": "a b c d",
        "bell \x07, null \x00": r"bell \x07, null \x00",
        "right to left \u202e": r"right to left \u202e",
        "half \ud800": r"half \ud800",
        "5 µm": "5 µm",
    }.items():
        assert one_line(text) == shown == str(LfcalError(text))
    for length in (479, 480, 481, 5000, 10**7):
        line = one_line("begin" + "x" * (length - 8) + "end")
        assert len(line) == min(length, MAX_MESSAGE)
        assert line.startswith("begin") and line.endswith("end"), "long text loses its middle"


def test_a_huge_value_leaves_name_and_remedy() -> None:
    message = str(FileFormatError.expected("camera.name", "text", "x" * 10**6, "correct it"))
    assert message.startswith("camera.name: expected text, got xxx") and message.endswith("; correct it")
    assert len(message) < 250


def test_errors_of_the_system_and_with_entries_of_their_own() -> None:
    assert str(StorageError("a\nb")) == "a b"
    stopped = AcquisitionStopped("a\nb", 3)
    assert str(stopped) == "a b" and stopped.acknowledged == 3
    assert str(pickle.loads(pickle.dumps(StorageError("a\nb")))) == "a b"


def test_a_misspelt_name_brings_the_one_that_is_like_it() -> None:
    names, none = ("bench", "R29", "lfm_20x05"), "choose one of these"
    found = {"benhc": "did you mean bench?", "BENCH": "did you mean bench?", "r28": "did you mean R29?"}
    for name, said in (found | {"x" * 10**6: none, "": none, "microscope": none, 7: none}).items():
        assert choose(name, names) == said


# -- numbers with units ------------------------------------------------------------------------------------------------


def test_different_shares_read_differently_and_rounding_errors_do_not_show() -> None:
    shares = (0.01, 0.0103, 0.996, 1.0)
    assert [format_share(one, shares) for one in shares] == ["1 %", "1.03 %", "99.6 %", "100 %"]
    assert format_share(0.31, (0.1 + 0.21, 0.31 * (1 + 1e-9))) == "31 %"


def test_numbers_have_no_powers_of_ten() -> None:
    numbers = {0.0: "0", 0.263: "0.263", 999.4: "999", 1063.2: "1,060", 49440.0: "49,400", -2e3: "-2,000"}
    assert {value: format_number(value) for value in numbers} == numbers
    shares = {0.0: "0 %", 0.0035: "0.35 %", 0.12: "12 %", 0.996: "100 %", 1.4: "140 %", 2e-6: "0.0002 %"}
    assert {share: format_share(share) for share in shares} == shares


def test_durations_lengths_sizes_and_counts() -> None:
    seconds = {3e-5: "30 µs", 0.0031: "3.1 ms", 4.2: "4.2 s", 42: "42 s", 125: "2 min 05 s", 7500: "2 h 05 min"}
    assert {s: format_seconds(s) for s in seconds} == seconds
    assert [format_length(um) for um in (0.02, 5.0, 2.5e5, 2e6)] == ["20 nm", "5 µm", "250 mm", "2 m"]
    assert [format_bytes(n) for n in (12, 685e6)] == ["12 B", "685.0 MB"]
    counts = {0: "0 positions are", 1: "1 position is", 2: "2 positions are"}
    assert {n: format_count(n, "position is", "positions are") for n in counts} == counts


def test_spans_of_days_and_the_days_they_lie_between() -> None:
    spans = {4.0: "4.0 s", 6 * 3600: "6 h 00 min", 2 * 86400: "2.0 days", 40.25 * 86400: "40.2 days"}
    assert {s: format_span(s) for s in spans} == spans
    first, last = datetime(2026, 5, 1, 3), datetime(2026, 6, 1)
    assert format_dates(first, last) == "2026-05-01 to 2026-06-01"
    assert format_dates(first, first.replace(hour=9)) == "2026-05-01"


def test_slopes_say_how_near_in_time_values_are_that_give_none() -> None:
    assert format_slope(0.1234, 1e7) == "+0.12"
    assert format_slope(-0.1234, 1e7, 0.0123) == "-0.12 ± 0.01"
    assert format_slope(math.nan, 6 * 3600) == "within 6 h 00 min"
    assert format_slope(math.nan, 0) == format_slope(math.nan, math.nan) == ""


# -- positions ---------------------------------------------------------------------------------------------------------


def test_positions_count_in_storage_order() -> None:
    shape = (3, 4, 5)
    found = [position_at(flat, shape[1:]) for flat in range(np.prod(shape))]
    assert found == [Position(*place) for place in np.ndindex(*shape)]
