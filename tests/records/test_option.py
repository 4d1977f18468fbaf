"""Fields of records: what texts and values of files mean, ranges, nested records, docstrings."""

from __future__ import annotations

import inspect
import re
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.base import InputError
from lfcal.records import (
    AssemblySettings,
    CorrectionRecipe,
    FieldRow,
    Variants,
    check_record,
    flat,
    from_dict,
    from_flat,
    one_of,
    opt,
    panel,
    read_pair,
    record,
    required,
    rows,
    rows_of,
    show_pair,
    to_dict,
    value_at,
)


@record
class Whole:
    """A record with everything."""

    frames: Path = required("The frames.", argument=True, file="in")
    many: tuple[str, ...] = opt((), "Several names.")
    share: float | None = opt(None, "A share.", above=0, below=1)
    count: int = opt(3, "A count.", at_least=1, at_most=9)
    pack: bool = opt(True, "Pack it.")
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections", without=("dark",))
    settings: AssemblySettings = panel(AssemblySettings(), "Storage")


ROWS = {row.name: row for row in rows(Whole)}


def test_rows_are_flat_and_in_order() -> None:
    assert list(ROWS)[:6] == ["frames", "many", "share", "count", "pack", "black_level"]
    assert "dark" not in ROWS and "channel" not in ROWS, "one is left out, the other is not a field that people set"
    assert ROWS["dtype"].path == ("settings", "dtype") and ROWS["dtype"].panel == "Storage"
    assert (ROWS["share"].kind, ROWS["share"].optional, ROWS["many"].many) == (float, True, True)
    assert ROWS["pack"].flag == "--no-pack" and ROWS["black_level"].flag == "--black-level"
    # the help of a flag that is on is positive, except for its option
    assert ROWS["pack"].described == "Pack it." and "\n    Pack it." in str(Whole.__doc__)
    assert ROWS["pack"].option_help == "Do not pack it." and ROWS["count"].option_help == ROWS["count"].described


def test_no_line_of_a_docstring_ends_between_a_number_and_its_unit() -> None:
    for before in range(60, 110):

        @record
        class Wrapped:
            width: float = opt(0.5, "x" * before + " by default 0.5 µm, then 3 %")

        said = str(Wrapped.__doc__)
        assert "0.5 µm," in said and "3 %" in said and "\N{NO-BREAK SPACE}" not in said, before


def test_a_text_and_a_value_of_a_file_mean_the_same() -> None:
    cases: tuple[tuple[str, object, object], ...] = (
        *(("share", given, value) for given, value in (("0.5", 0.5), ("", None), (0.25, 0.25))),
        *(("count", given, value) for given, value in (("7", 7), (None, 3))),
        ("frames", "a/b", Path("a/b")),
        *(("many", given, value) for given, value in ((["a", "b"], ("a", "b")), ("a", ("a",)))),
        ("lost", "2%", 0.02),
        *(("cutout", given, (41, 61)) for given in ("41x61", "41, 61", [41, 61])),
        *(("cutout", given, value) for given, value in (("41", (41, 41)), ("auto", "auto"), ("", None))),
        ("dtype", "float32", "float32"),
        ("interpolation", "", ""),
        ("pad", True, True),
    )
    for name, given, value in cases:
        row = ROWS[name]
        assert row.value(given, row.called) == value
        assert row.kind is bool or row.many or row.value(row.text(value), row.called) == value, name


def test_a_wrong_value_ends_in_one_sentence() -> None:
    cases: tuple[tuple[str, object, str], ...] = (
        ("share", "x", "--share: expected a number > 0 and < 1, got 'x'"),
        ("share", "1", "--share: expected a number > 0 and < 1, got 1.0"),
        ("share", True, "--share: expected a number"),
        ("share", "nan", "--share: expected a number > 0 and < 1, got nan"),
        ("count", "2.5", "--count: expected a whole number ≥ 1 and ≤ 9, got '2.5'"),
        ("count", "10", "--count: expected a whole number ≥ 1 and ≤ 9, got 10"),
        ("count", 2.0, "--count: expected a whole number"),
        ("frames", 3, "FRAMES: expected a path, got 3"),
        ("pad", "yes", "--pad: expected true or false, got 'yes'"),
        ("dtype", "floot32", "--dtype: expected rounded or float32, got 'floot32'; did you mean float32?"),
        ("cutout", "4 1", "--cutout: expected one number or two"),
        ("cutout", "41.5", "--cutout: expected whole numbers of pixels"),
        ("lost", "2 percent", "--lost: expected a number, or percent"),
    )
    for name, given, words in cases:
        with pytest.raises(InputError) as error:
            ROWS[name].value(given, ROWS[name].called)
        assert str(error.value).startswith(words) and "\n" not in str(error.value)


def test_records_go_to_plain_values_and_back() -> None:
    one = Whole(
        frames=Path("f"),
        many=("a",),
        share=0.5,
        settings=AssemblySettings(cutout=(5, 7)),
        corrections=CorrectionRecipe(),
    )
    plain = to_dict(one)
    assert plain["settings"]["cutout"] == [5, 7] and plain["frames"] == "f" and plain["corrections"]["white"] == ""
    assert from_dict(Whole, plain) == one
    names = {row.name: value_at(one, row) for row in rows(Whole)}
    assert from_flat(Whole, names) == one and flat(rows(Whole), plain, "it") == names


def test_a_hand_written_entry_that_is_wrong_is_named() -> None:
    cases: tuple[tuple[dict[str, object], str], ...] = (
        ({}, "FRAMES: expected a value"),
        ({"frames": "f", "cuont": 3}, "Whole: expected its fields, got cuont; did you mean count?"),
        ({"frames": "f", "settings": {"cutuot": 3}}, "got settings.cutuot; did you mean settings.cutout?"),
        ({"frames": "f", "settings": {"lost": 3}}, "settings.lost: expected a number > 0 and < 1"),
        ({"frames": "f", "corrections": {"dark": "d"}}, "got corrections.dark"),
    )
    for data, words in cases:
        with pytest.raises(InputError, match=re.escape(words)):
            from_dict(Whole, data)


def test_values_in_python_are_checked_and_empty_fields_have_defaults() -> None:
    with pytest.raises(InputError, match="lost: expected a number > 0 and < 1, got 3"):
        AssemblySettings(lost=3)
    with pytest.raises(InputError, match="white_mode: expected field or pixels"):
        check_record(CorrectionRecipe(white_mode="pixel"))
    row: FieldRow = ROWS["count"]
    assert row.empty == 3 and ROWS["share"].empty is None and replace(row, optional=True).empty is None

    @record
    class Paired:
        """A record."""

        pair: str | tuple[float, float] | None = opt(None, "A pair.", read=read_pair, show=show_pair)

    (row,) = rows(Paired)
    assert row.value(" ", "pair") is None and row.value("1,2", "pair") == (1.0, 2.0)


def test_help_shows_every_field_with_its_unit_and_range() -> None:
    said = inspect.getdoc(AssemblySettings)
    assert said is not None and "Examples\n--------" in said
    for row in rows(AssemblySettings):
        assert f"\n{row.name}\n    {row.opt.help[:60]}" in said and row.opt.help in re.sub(r"\n +", " ", said)
    assert "> 0, < 1" in said and "rounded, float32)" in said
    assert inspect.signature(AssemblySettings).parameters["lost"].default == 0.005


@record
class OfACamera:
    """A record with a text that may be a path, and a number or several."""

    camera: str = required("A preset or a file.", argument=True, file="in", is_path=lambda text: text != "bench")
    exposure: float | tuple[float, ...] = opt(0.02, "One number, or one of each plane.", above=0)


def test_a_text_may_be_a_path_and_each_of_several_numbers_is_checked() -> None:
    camera, exposure = rows(OfACamera)
    assert camera.paths_of("bench") == () and camera.paths_of("bench.json") == (Path("bench.json"),)
    assert camera.placed("bench", Path("a").joinpath) == "bench"
    assert camera.placed("bench.json", Path("a").joinpath) == str(Path("a/bench.json"))
    assert camera.value(Path("bench.json"), "CAMERA") == "bench.json", "a path is as good as its text"
    assert exposure.paths_of("bench") == (), "it is not a path"
    exposure.check((0.1, 0.2), "--exposure")
    with pytest.raises(InputError, match="--exposure: expected a number > 0, got -1"):
        exposure.check((0.1, -1.0), "--exposure")


# -- a record within a record that is one of several kinds -----------------------------------------------------
@record
class Plain:
    """What all ways have."""

    way: str = opt("plain", "The way.", flag="--by")
    size: float = opt(1.0, "Its size.", above=0)


@record
class Sharp(Plain):
    """A way with an edge."""

    way: str = opt("sharp", "The way.", flag="--by")
    edge: int = opt(2, "Its edge.", at_least=1)


@record
class Soft(Plain):
    """A way with a width, of another package."""

    way: str = opt("soft", "The way.", flag="--by")
    edge: int = opt(2, "Its edge.", at_least=1)


def find(name: str) -> type:
    kinds: dict[str, type] = {"plain": Plain, "sharp": Sharp, "soft": Soft}
    if name not in kinds:
        raise InputError.expected("way", "a known one", name, "correct it")
    return kinds[name]


WAYS = Variants((Plain, Sharp), "way", find, lambda: ("plain", "sharp", "soft"))


@record
class Chosen:
    """A record whose way decides which fields it has."""

    name: str = opt("", "A name.")
    by: Plain = one_of(Plain(), "Way", WAYS)


def test_fields_of_all_kinds_are_rows_and_say_which_kinds_have_them() -> None:
    found = {row.name: row for row in rows(Chosen)}
    assert list(found) == ["name", "way", "size", "edge"]
    assert [row.only for row in found.values()] == [(), (), (), ("sharp",)]
    assert found["edge"].path == ("by", "edge") and found["edge"].panel == "Way"
    assert found["way"].offered == ("plain", "sharp", "soft")
    assert [row.name for row in rows_of(Chosen())] == ["name", "way", "size"]
    assert [row.name for row in rows_of(Chosen(by=Sharp()))] == ["name", "way", "size", "edge"]
    assert "Way: `Plain`, `Sharp`." in str(Chosen.__doc__)


def test_every_kind_goes_to_plain_values_and_back() -> None:
    for by in (Plain(size=2.0), Sharp(edge=7), Soft(edge=3, size=0.5)):
        one = Chosen(name="n", by=by)
        plain = to_dict(one)
        assert plain["by"]["way"] == by.way and ("edge" in plain["by"]) == (type(by) is not Plain)
        assert from_dict(Chosen, plain) == one
        assert from_flat(Chosen, {row.name: value_at(one, row) for row in rows_of(one)}) == one


def test_a_field_of_another_kind_is_refused() -> None:
    cases: tuple[tuple[dict[str, object], str], ...] = (
        ({"edge": 3}, "edge: expected way sharp, got plain; leave edge out"),
        ({"edge": 2}, "edge: expected way sharp, got plain; leave edge out"),
        ({"way": "sharp", "edge": 0}, "by.edge: expected a whole number ≥ 1"),
        ({"way": "blunt"}, "way: expected a known one, got blunt"),
        ({"way": "sharp", "width": 1}, "got by.width"),
    )
    for data, words in cases:
        with pytest.raises(InputError, match=re.escape(words)):
            from_dict(Chosen, {"by": data})
    with pytest.raises(InputError, match=r"corrections.dark: expected its default, got 'd'; leave it out"):
        check_record(Whole(frames=Path("f"), corrections=CorrectionRecipe(dark="d")))
