"""Numbers with their units, as people read them."""

from __future__ import annotations

import math
from datetime import datetime

import pytest

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


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0 %"), (0.0035, "0.35 %"), (0.12, "12 %"), (0.996, "100 %"), (1.4, "140 %"), (2e-6, "0.0002 %")],
)
def test_shares(share: float, words: str) -> None:
    assert format_share(share) == words


def test_different_shares_read_differently_and_rounding_errors_do_not_show() -> None:
    shares = (0.01, 0.0103, 0.996, 1.0)
    assert [format_share(one, shares) for one in shares] == ["1 %", "1.03 %", "99.6 %", "100 %"]
    assert format_share(0.31, (0.1 + 0.21, 0.31 * (1 + 1e-9))) == "31 %"


@pytest.mark.parametrize(
    ("value", "words"),
    [(0.0, "0"), (0.263, "0.263"), (999.4, "999"), (1063.2, "1,060"), (49440.0, "49,400"), (-2e3, "-2,000")],
)
def test_numbers_have_no_powers_of_ten(value: float, words: str) -> None:
    assert format_number(value) == words


def test_durations_lengths_and_sizes() -> None:
    assert [format_seconds(s) for s in (3e-5, 0.0031, 4.2, 42, 125, 7500)] == [
        "30 µs",
        "3.1 ms",
        "4.2 s",
        "42 s",
        "2 min 05 s",
        "2 h 05 min",
    ]
    assert [format_length(um) for um in (0.02, 5.0, 2.5e5, 2e6)] == ["20 nm", "5 µm", "250 mm", "2 m"]
    assert [format_bytes(n) for n in (12, 685e6)] == ["12 B", "685.0 MB"]


def test_numbers_agree_with_what_they_count() -> None:
    assert [format_count(n, "position is", "positions are") for n in (0, 1, 2)] == [
        "0 positions are",
        "1 position is",
        "2 positions are",
    ]


def test_spans_of_days_and_the_days_they_lie_between() -> None:
    assert [format_span(s) for s in (4.0, 6 * 3600, 2 * 86400, 40.25 * 86400)] == [
        "4.0 s",
        "6 h 00 min",
        "2.0 days",
        "40.2 days",
    ]
    first, last = datetime(2026, 5, 1, 3), datetime(2026, 6, 1)
    assert format_dates(first, last) == "2026-05-01 to 2026-06-01"
    assert format_dates(first, first.replace(hour=9)) == "2026-05-01"


def test_slopes_say_how_near_in_time_values_are_that_give_none() -> None:
    assert format_slope(0.1234, 1e7) == "+0.12"
    assert format_slope(-0.1234, 1e7, 0.0123) == "-0.12 ± 0.01"
    assert format_slope(math.nan, 6 * 3600) == "within 6 h 00 min"
    assert format_slope(math.nan, 0) == format_slope(math.nan, math.nan) == ""
