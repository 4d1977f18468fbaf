"""What texts of values mean, the same for every command, form and job file."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import pytest

from lfcal.base import InputError
from lfcal.records.reading import (
    check_planes,
    read_as,
    read_cutout,
    read_cutout_or_auto,
    read_depths,
    read_length_um,
    read_pair,
    read_planes,
    read_range,
    read_share,
    read_virtual_depths,
    show_pair,
    show_planes,
    show_share,
)


def test_planes_are_read_and_shown_with_every_digit() -> None:
    for text, values in (
        ("1, 2,-3e1", (1.0, 2.0, -30.0)),
        ("-1mm:1mm:500um", (-1000.0, -500.0, 0.0, 500.0, 1000.0)),
        ("-1 mm, 5 µm", (-1000.0, 5.0)),
        ("3:1:-1", (3.0, 2.0, 1.0)),
        ("", ()),
    ):
        assert read_depths(text) == values == read_depths(show_planes(values))
    assert read_virtual_depths("2:5.5:0.35") == pytest.approx([2 + 0.35 * k for k in range(11)])
    found = read_virtual_depths("0.1:0.7:0.1")
    assert found[-1] == pytest.approx(0.7) and len(found) == 7 and read_virtual_depths(show_planes(found)) == found


def test_texts_that_are_not_planes_are_refused() -> None:
    for text in ("a", "1:2", "1:2:0", "1:2,3", "1,,2", "1:2:-1", "1:1e9:1"):
        with pytest.raises(InputError, match="planes: expected"):
            read_planes(text, lengths=True)
    with pytest.raises(InputError, match="expected numbers"):
        read_virtual_depths("3mm")
    for text in ("1,000", "0:05:1", "-00.5"):  # as thousands separators and the like
        with pytest.raises(InputError, match="planes: expected numbers without leading zeros"):
            read_virtual_depths(text)
    assert read_virtual_depths("1,0,0.5") == (1.0, 0.0, 0.5), "0 is the plane of the lenslets"


def test_planes_are_given_in_one_way() -> None:
    check_planes((1.0,), ())
    check_planes("", "3")
    for depths, virtual in (((), ()), ((1.0,), (2.0,))):
        with pytest.raises(InputError, match="--virtual-depths"):
            check_planes(depths, virtual)


def test_a_cutout_is_written_in_several_ways() -> None:
    for text in ("41x61", "41,61", "41 , 61", "41×61"):
        assert read_cutout(text) == read_cutout_or_auto(text) == (41, 61) == read_cutout(show_pair((41, 61)))
    assert read_cutout("41") == (41, 41) and read_cutout(" ") is None and read_cutout_or_auto("auto") == "auto"


def test_shares_and_lengths_have_units() -> None:
    for text, value in (("3%", 0.03), ("3 %", 0.03), ("0.03", 0.03), (".5", 0.5)):
        assert read_share(text) == value
    for value, text in ((0.0027, "0.27 %"), (0.0029, "0.29 %"), (0, "0 %"), (0.07, "7 %"), (1e-6, "0.0001 %")):
        assert show_share(value) == text and read_share(text) == value
    random = Random(0)
    for value in (random.random() for _ in range(200)):
        assert read_share(show_share(value)) == value
    for text, value in (("1.5 mm", 1500), ("250um", 250), ("30 nm", 0.03), ("7", 7)):
        assert read_length_um(text) == pytest.approx(value)


def test_errors_name_what_the_user_named() -> None:
    cases: tuple[tuple[Callable[[str], Any], str], ...] = (
        *((read_cutout, text) for text in ("auto", "40.5")),
        *((read_pair, text) for text in ("", "1,2,3")),
        *((read_range, text) for text in ("5", "a,b")),
        (read_share, "1.2.3%"),
        (read_length_um, "1 m"),
    )
    for read, text in cases:
        with pytest.raises(InputError, match=r"^--option: expected") as error:
            read_as("--option", read, text)
        assert "\n" not in str(error.value)
