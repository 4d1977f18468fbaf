from __future__ import annotations

import math
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal_gui.models.form import Field, parse, text_of

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
