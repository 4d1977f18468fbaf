"""Forms made of records: what they show and what they store."""

from __future__ import annotations

from lfcal.records import rows
from lfcal.tasks import AcquireUntil, SimulateH
from lfcal_gui.models import check_of, fields_of, options_in, shown_of, text_of


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
