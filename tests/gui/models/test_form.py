"""Fields of forms, by hand and made of records."""

from __future__ import annotations

import math
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.records import rows
from lfcal.tasks import AcquireUntil, PlanScan, SimulateH
from lfcal_gui.models import check_of, fields_of, options_in, shown_of, text_of
from lfcal_gui.models.form import Field, parse

NUMBER = Field("a", "Exposure", "ms", scale=1e-3)
COUNT = Field("n", "Darks", kind="int")
LIST = Field("v", "Planes", kind="floats")


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        (NUMBER, "2.5", 2.5e-3),
        (NUMBER, " 1e3 ", 1.0),
        (COUNT, "12", 12),
        (LIST, "2.5, 3", (2.5, 3.0)),
        (LIST, "2; 5", (2.0, 5.0)),
        (LIST, "2;5", (2.0, 5.0)),
        (LIST, "2 , 5", (2.0, 5.0)),
        (LIST, "2,", (2.0,)),
        (LIST, "", ()),
        (Field("o", "Saturation", optional=True), "", None),
        (Field("t", "Pattern", kind="text"), "R,G", "R,G"),
    ],
)
def test_texts_and_what_they_mean(field: Field, text: str, value: Any) -> None:
    assert parse(field, text) == pytest.approx(value) if isinstance(value, float) else parse(field, text) == value


POINT, SPACE = "with a decimal point", "with a space after the comma"


@pytest.mark.parametrize(
    ("field", "text", "remedy"),
    [
        (NUMBER, "2,5", f"write 2.5 {POINT}"),
        (NUMBER, "1,000", f"write 1000 or 1.000 {POINT}"),
        (NUMBER, "0,125", f"write 0.125 {POINT}"),
        (NUMBER, "12,345,678", "write 12345678"),
        (NUMBER, "1,2,3", "write one number"),
        (NUMBER, "-1,5e3", f"write 1.5 {POINT}"),
        (COUNT, "1,000", "write 1000"),
        (COUNT, "2,5", "write one number"),
        (LIST, "2,5", f"write 2.5 {POINT} or 2, 5 {SPACE}"),
        (LIST, "1,000", f"write 1000 or 1.000 {POINT} or 1, 000 {SPACE}"),
        (LIST, "2,5; 3,5", f"write 2.5 {POINT} or 2, 5 {SPACE}"),
        (LIST, "1, 2,5", f"write 2.5 {POINT} or 2, 5 {SPACE}"),
    ],
)
def test_a_comma_between_digits_is_refused_with_what_it_may_mean(field: Field, text: str, remedy: str) -> None:
    with pytest.raises(InputError) as error:
        parse(field, text)
    assert str(error.value) == f"{field.label}: expected no comma between digits, got {text!r}; {remedy}"


@pytest.mark.parametrize(
    ("field", "text"),
    [
        (NUMBER, "abc"),
        (NUMBER, ""),
        (COUNT, "2.5"),
        (LIST, "2, x"),
        (NUMBER, "1, 2"),
        (NUMBER, "nan"),
        (NUMBER, "inf"),
        (NUMBER, "1e400"),
        (COUNT, "inf"),
        (LIST, "1, nan"),
        (LIST, "-inf"),
        (Field("f", "Depths", kind="floats", endless=True), "nan"),
        (Field("o", "Saturation", optional=True), "inf"),
    ],
)
def test_what_is_no_number_is_said(field: Field, text: str) -> None:
    with pytest.raises(InputError, match="number") as error:
        parse(field, text)
    assert field.label in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        (NUMBER, 0.0123),
        (COUNT, 7),
        (LIST, (2.0, 2.5, 1e6)),
        (Field("f", "Depths", kind="floats", endless=True), (math.inf,)),
    ],
)
def test_what_is_shown_is_read_back(field: Field, value: Any) -> None:
    assert parse(field, text_of(field, value)) == pytest.approx(value)


def test_a_share_is_shown_in_percent_and_stored_unchanged() -> None:
    field = next(one for one in fields_of(SimulateH) if one.key == "tolerance")
    assert (field.unit, field.empty) == ("", "3 %") and "0.03 or 3 %" in field.tip
    for value in (0.0029, 0.035, 1 / 3):
        shown = shown_of(SimulateH, {"tolerance": value})["tolerance"]
        assert shown.endswith(" %")
        assert options_in(SimulateH, {"tolerance": text_of(field, shown)}) == {"tolerance": value}
    assert next(row for row in rows(SimulateH) if row.name == "tolerance").text(0.035) == "0.035", "of a command"


def test_several_names_are_typed() -> None:
    field = next(one for one in fields_of(AcquireUntil) if one.key == "unknowns")
    assert (field.kind, field.choices, field.empty) == ("text", (), "auto")
    assert options_in(AcquireUntil, {"unknowns": "iris, distance"}) == {"unknowns": ("iris", "distance")}
    assert shown_of(AcquireUntil, {"unknowns": ("iris", "distance")})["unknowns"] == "iris,distance"
    assert "nonsense" in check_of(AcquireUntil)("unknowns", "iris, nonsense")


def test_numbers_of_a_list_are_shown_apart_and_read_back() -> None:
    by_name = {row.name: row for row in rows(PlanScan)}
    for name, value, text in (
        ("cutout", (55, 95), "55, 95"),
        ("virtual_depths", (3.0, -4.25), "3, -4.25"),
        ("anchor", (1.5, 20.0), "1.5, 20"),
    ):
        assert shown_of(PlanScan, {name: value})[name] == text
        assert by_name[name].value(text, name) == value
