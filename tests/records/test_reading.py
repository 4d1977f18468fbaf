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


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1, 2,-3e1", (1.0, 2.0, -30.0)),
        ("-1mm:1mm:500um", (-1000.0, -500.0, 0.0, 500.0, 1000.0)),
        ("-1 mm, 5 µm", (-1000.0, 5.0)),
        ("3:1:-1", (3.0, 2.0, 1.0)),
        ("", ()),
    ],
)
def test_planes_are_read(text: str, values: tuple[float, ...]) -> None:
    assert read_depths(text) == values
    assert read_depths(show_planes(values)) == values


def test_steps_are_counted_as_they_are_meant() -> None:
    assert read_virtual_depths("2:5.5:0.35") == pytest.approx([2 + 0.35 * k for k in range(11)])
    found = read_virtual_depths("0.1:0.7:0.1")
    assert found[-1] == pytest.approx(0.7) and len(found) == 7
    assert read_virtual_depths(show_planes(found)) == found, "every digit is shown"


@pytest.mark.parametrize("text", ["a", "1:2", "1:2:0", "1:2,3", "1,,2", "1:2:-1", "1:1e9:1"])
def test_planes_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="planes: expected"):
        read_planes(text, lengths=True)
    with pytest.raises(InputError, match="expected numbers"):
        read_virtual_depths("3mm")


@pytest.mark.parametrize("text", ["1,000", "0:05:1", "-00.5"])
def test_a_thousands_separator_is_no_list_of_planes(text: str) -> None:
    with pytest.raises(InputError, match="planes: expected numbers without leading zeros"):
        read_virtual_depths(text)
    assert read_virtual_depths("1,0,0.5") == (1.0, 0.0, 0.5), "0 is the plane of the lenslets"


def test_planes_are_given_in_one_way() -> None:
    check_planes((1.0,), ())
    check_planes("", "3")
    for depths, virtual in (((), ()), ((1.0,), (2.0,))):
        with pytest.raises(InputError, match="--virtual-depths"):
            check_planes(depths, virtual)


@pytest.mark.parametrize("text", ["41x61", "41,61", "41 , 61", "41×61"])
def test_a_cutout_is_written_in_several_ways(text: str) -> None:
    assert read_cutout(text) == read_cutout_or_auto(text) == (41, 61) == read_cutout(show_pair((41, 61)))
    assert read_cutout("41") == (41, 41) and read_cutout(" ") is None
    assert read_cutout_or_auto("auto") == "auto"


@pytest.mark.parametrize(("text", "value"), [("3%", 0.03), ("3 %", 0.03), ("0.03", 0.03), (".5", 0.5)])
def test_a_share_is_a_number_or_percent(text: str, value: float) -> None:
    assert read_share(text) == value


@pytest.mark.parametrize(
    ("value", "text"), [(0.0027, "0.27 %"), (0.0029, "0.29 %"), (0, "0 %"), (0.07, "7 %"), (1e-6, "0.0001 %")]
)
def test_a_share_is_shown_in_percent(value: float, text: str) -> None:
    assert show_share(value) == text and read_share(text) == value


def test_a_share_that_is_shown_is_read_unchanged() -> None:
    random = Random(0)
    for value in (random.random() for _ in range(200)):
        assert read_share(show_share(value)) == value


@pytest.mark.parametrize(("text", "value"), [("1.5 mm", 1500), ("250um", 250), ("30 nm", 0.03), ("7", 7)])
def test_a_length_has_a_unit(text: str, value: float) -> None:
    assert read_length_um(text) == pytest.approx(value)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_cutout, "auto"),
        (read_cutout, "40.5"),
        (read_pair, ""),
        (read_pair, "1,2,3"),
        (read_range, "5"),
        (read_range, "a,b"),
        (read_share, "1.2.3%"),
        (read_length_um, "1 m"),
    ],
)
def test_errors_name_what_the_user_named(read: Callable[[str], Any], text: str) -> None:
    with pytest.raises(InputError, match=r"^--option: expected") as error:
        read_as("--option", read, text)
    assert "\n" not in str(error.value)
