"""Fields of forms, by hand and made of records; words and numbers as they are typeset."""

from __future__ import annotations

import math

import pytest

from lfcal.base.errors import InputError
from lfcal.records import rows
from lfcal.tasks import AcquireUntil, PlanScan, SimulateH
from lfcal_gui.models import check_of, fields_of, options_in, shown_of, text_of
from lfcal_gui.models.form import Field, parse
from lfcal_gui.models.words import minus, plane_words, rough_seconds, typeset, unbroken

NUMBER = Field("a", "Exposure", "ms", scale=1e-3)
COUNT = Field("n", "Darks", kind="int")
LIST = Field("v", "Planes", kind="floats")


def test_texts_and_what_they_mean() -> None:
    assert [parse(NUMBER, text) for text in ("2.5", " 1e3 ")] == pytest.approx([2.5e-3, 1.0])
    assert (parse(COUNT, "12"), parse(MAYBE, ""), parse(Field("t", "Pattern", kind="text"), "R,G")) == (12, None, "R,G")
    for text in ("2; 5", "2;5", "2 , 5", "2, 5"):
        assert parse(LIST, text) == (2.0, 5.0), text
    assert [parse(LIST, text) for text in ("2.5, 3", "2,", "")] == [(2.5, 3.0), (2.0,), ()]


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


ENDLESS, MAYBE = Field("f", "Depths", kind="floats", endless=True), Field("o", "Saturation", optional=True)
NO_NUMBERS = {
    NUMBER: ("abc", "", "1, 2", "nan", "inf", "1e400"),
    COUNT: ("2.5", "inf"),
    LIST: ("2, x", "1, nan", "-inf"),
    ENDLESS: ("nan",),
    MAYBE: ("inf",),
}


@pytest.mark.parametrize(("field", "text"), [(field, text) for field, texts in NO_NUMBERS.items() for text in texts])
def test_a_text_that_is_no_number_is_refused_by_its_label(field: Field, text: str) -> None:
    with pytest.raises(InputError, match="number") as error:
        parse(field, text)
    assert field.label in str(error.value) and "\n" not in str(error.value)


def test_what_is_shown_is_read_back() -> None:
    for field, value in ((NUMBER, 0.0123), (COUNT, 7), (LIST, (2.0, 2.5, 1e6)), (ENDLESS, (math.inf,))):
        assert parse(field, text_of(field, value)) == pytest.approx(value), field.label


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


def test_words_and_negative_numbers_are_typeset() -> None:
    assert plane_words(1, 2) == "Plane 1 (0 to 1)" and plane_words(0, 1) == "Plane 0 (the only one)"
    for plain, shown in (
        ("hollow sphere of 2x128x128 voxels, 20000 e-", "hollow sphere of 2 × 128 × 128 voxels, 20000 e⁻"),
        ("19 x 33; pixel `anchor`; lens_types, e-6", "19 × 33; pixel anchor; lens types, e-6"),
        ("position x 9 of 1e-5", "position x 9 of 1e-5"),
    ):
        assert typeset(plain) == shown
    for plain, shown in (
        ("polyphase 54.5 ms a pair, 2 of 3", "polyphase 54.5\u00a0ms a pair, 2\u00a0of 3"),
        ("in about 4 min 19 s for 95 × 55", "in about 4\u00a0min\u00a019\u00a0s for 95\u00a0×\u00a055"),
        ("good; ≤ 0.35 px, > 1 bad", "good; ≤\u00a00.35\u00a0px, >\u00a01\u00a0bad"),
    ):
        assert unbroken(plain) == shown, "no line ends between a number and its unit"
    assert rough_seconds(0.33) == "less than 1 s" and rough_seconds(3.2) == "about 3 s"
    assert rough_seconds(259) == "about 4 min 19 s" and rough_seconds(9.6, "") == "10 s"
    assert minus("-20.03 mm to -.5, (-1, -2)") == "−20.03 mm to −.5, (−1, −2)"
    assert minus("2026-03-16, type-0, H-1.h5, 3-5, 1e-06, --z -0") == "2026-03-16, type-0, H-1.h5, 3-5, 1e-06, --z −0"
    assert minus("<p style='margin:-4'>-4</p>") == "<p style='margin:-4'>−4</p>"
