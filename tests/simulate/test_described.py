"""Effects in words and in files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.simulate.effects import (
    ColourFilter,
    Coma,
    Drift,
    Effect,
    FiniteSource,
    IrisShape,
    LensletGap,
    PitchError,
    PixelKernel,
    Spherical,
    Zernike,
    catalogue,
)
from lfcal.simulate.effects.described import Entry, effect_entries, effect_from, effect_words, parse_effects
from lfcal.simulate.plane_task import describe


@pytest.mark.parametrize(
    ("words", "effect"),
    [
        ("coma=0.3@40deg", Coma(0.3, math.radians(40))),
        ("coma=.3", Coma(0.3)),
        ("coma=waves:0.3,angle:10mrad", Coma(0.3, 0.01)),
        ("spherical=-0.25", Spherical(-0.25)),
        ("lenslet_gap=5um", LensletGap(5.0)),
        ("lenslet_gap=0.005 mm", LensletGap(5.0)),
        ("finite_source=200", FiniteSource(200.0)),
        ("pitch_error=0.02%", PitchError(2e-4)),
        ("drift=rows:2um,columns:500nm", Drift(2.0, 0.5)),
        ("iris_shape=7", IrisShape(7)),
        ("pixel_kernel=up:0.01,down_left:0.02", PixelKernel(up=0.01, down_left=0.02)),
        ("zernike=4,0,0.1;3,-1,0.05", Zernike(((4, 0, 0.1), (3, -1, 0.05)))),
    ],
)
def test_words_and_what_they_mean(words: str, effect: Effect) -> None:
    settings, (found,) = parse_effects([words])
    assert settings == {} and type(found) is type(effect)
    for key, value in describe([effect])[0].items():
        assert describe([found])[0][key] == (pytest.approx(value) if isinstance(value, float) else value)


def test_settings_files_and_the_last_word(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    path.write_text(json.dumps(describe([Coma(0.2), Spherical(0.1), Zernike(((2, 2, 0.1),))])))
    settings, given = parse_effects([str(path), "bandwidth=on", "coma=0.3", "cos4=off"])
    assert settings == {"bandwidth": "on", "cos4": "off"}
    assert given == (Coma(0.3), Spherical(0.1), Zernike(((2, 2, 0.1),)))
    path.write_text(json.dumps({"effects": [{"name": "coma", "waves": 1}]}))
    assert parse_effects([str(path)])[1] == (Coma(1),)


def test_every_effect_of_the_catalogue_survives_its_description(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    path.write_text(json.dumps(describe(catalogue())))
    assert parse_effects([str(path)])[1] == catalogue()


def test_words_say_all_of_an_entry() -> None:
    entries = [Entry(one, one.name, dict.fromkeys(given, "stated")) for one in catalogue() if (given := _numbers(one))]
    entries.append(Entry(Coma(0.1 + 0.2, 1e-17), "coma", {"waves": "measured", "angle_rad": "stated"}))
    entries.append(Entry(Zernike(((4, 0, 0.1), (3, -1, -5e-2))), "zernike", {"terms": "measured"}))
    entries.append(Entry(ColourFilter("GRBG", 0.05), "colour_filter", {"cfa": "stated", "leak": "measured"}))
    entries.append(Entry(None, "bandwidth", setting="off"))
    words = effect_words(entries)
    assert "zernike=4,0,0.1;3,-1,-0.05 measured" in words and words[-1] == "bandwidth=off"
    assert effect_entries(words) == tuple(entries)
    both = effect_words([Entry(Coma(0.3), "coma", {"waves": "measured"}, "off")])
    assert both == ("coma=waves:0.3 measured", "coma=off")
    assert effect_words([Entry(Zernike(), "zernike", {"terms": "stated"})]) == (), "no terms"
    assert parse_effects(both) == ({"coma": "off"}, (Coma(0.3),))


def _numbers(effect: Effect) -> list[str]:
    """Return the magnitudes of an effect that are set."""
    return [key for key, value in describe([effect])[0].items() if key != "name" and value not in (None, (), [])]


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ("coma", "NAME=on, off, auto or a magnitude"),
        ("comma=0.3", "expected .*coma"),
        ("coma=large", "expected a number, with waves or no unit"),
        ("coma=30%", "expected a number, with waves or no unit"),
        ("iris_shape=6.5", "a whole number"),
        ("iris_shape=2", "3"),
        ("zernike=4.5,0,0.1", "triples"),
        ("zernike=3,0,0.1", "n - .m. even"),
        ("zernike=900,0,0.1", "40"),
        ("colour_filter=QXYZ", "letters"),
        ("colour_filter=RGB", "letters"),
        ("coma=0.3um", "expected a number"),
        ("coma=0.3@40um", "expected a number, with rad, mrad, deg"),
        ("coma=size:3", "expected waves or angle_rad"),
        ("spherical=0.1@3", "expected waves"),
        ("cos4=0.3", "this effect has no magnitude"),
        ("crosstalk=0.9", "0.25"),
        ("zernike=4,0", "n,m,waves"),
        ("lenslet_gap=1e400", "got inf"),
    ],
)
def test_what_is_no_effect_is_one_line(words: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        parse_effects([words])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "3", "[3]", '[{"waves": 1}]', '{"effects": 3}', "[" * 100000], ids=lambda t: t[:12]
)
def test_files_that_hold_no_effects(tmp_path: Path, text: str) -> None:
    path = tmp_path / "effects.json"
    path.write_text(text)
    with pytest.raises(FileFormatError, match="a list of effects"):
        parse_effects([str(path)])


@pytest.mark.parametrize(
    ("name", "magnitudes"),
    [
        ("coma", {"waves": "large"}),
        ("coma", {"waves": True}),
        ("coma", {"waves": None}),
        ("coma", {"waves": [1]}),
        ("coma", {"size": 1}),
        ("zernike", {"terms": [[1, 2]]}),
        ("zernike", {"terms": 3}),
        ("colour_filter", {"cfa": 3}),
    ],
)
def test_magnitudes_of_files_are_checked(name: str, magnitudes: dict[str, object]) -> None:
    with pytest.raises(InputError):
        effect_from(name, magnitudes)
