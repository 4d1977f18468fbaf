"""Effects in words, in files and in forms: magnitudes, their units for people, and where their values come from."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError
from lfcal.camera import Camera, Marks, preset
from lfcal.simulate import effects as fx
from lfcal.simulate.effects import (
    Entry,
    Magnitude,
    effect_entries,
    effect_from,
    effect_words,
    entries_json,
    magnitudes_of,
    parse_effects,
    read_entries,
)
from lfcal.simulate.plane_task import describe

WORDS: list[tuple[str, fx.Effect]] = [
    ("coma=0.3@40deg", fx.Coma(0.3, math.radians(40))),
    ("coma=.3", fx.Coma(0.3)),
    ("coma=waves:0.3,angle:10mrad", fx.Coma(0.3, 0.01)),
    ("spherical=-0.25", fx.Spherical(-0.25)),
    ("lenslet_gap=5um", fx.LensletGap(5.0)),
    ("lenslet_gap=0.005 mm", fx.LensletGap(5.0)),
    ("finite_source=200", fx.FiniteSource(200.0)),
    ("pitch_error=0.02%", fx.PitchError(2e-4)),
    ("drift=rows:2um,columns:500nm", fx.Drift(2.0, 0.5)),
    ("iris_shape=7", fx.IrisShape(7)),
    ("pixel_kernel=up:0.01,down_left:0.02", fx.PixelKernel(up=0.01, down_left=0.02)),
    ("zernike=4,0,0.1;3,-1,0.05", fx.Zernike(((4, 0, 0.1), (3, -1, 0.05)))),
    ("missing_lenslets=0,1,0;-2,0,30e-2", fx.MissingLenslets(((0, 1, 0.0), (-2, 0, 0.3)))),
    ("lenslet_spherical=0.1,type_1:0.2", fx.LensletSpherical(0.1, type_1=0.2)),
    ("field_aberrations=coma:0.3,astigmatism:0.2,radius:8mm", fx.FieldAberrations(0.3, 0.2, radius_um=8e3)),
]


def test_words_and_what_they_mean() -> None:
    for words, effect in WORDS:
        settings, (found,) = parse_effects([words])
        assert settings == {} and type(found) is type(effect), words
        for key, value in describe([effect])[0].items():
            assert describe([found])[0][key] == (pytest.approx(value) if isinstance(value, float) else value), words


def test_settings_files_and_the_last_word(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    path.write_text(json.dumps(describe([fx.Coma(0.2), fx.Spherical(0.1), fx.Zernike(((2, 2, 0.1),))])))
    settings, given = parse_effects([str(path), "bandwidth=on", "coma=0.3", "cos4=off"])
    assert settings == {"bandwidth": "on", "cos4": "off"}
    assert given == (fx.Coma(0.3), fx.Spherical(0.1), fx.Zernike(((2, 2, 0.1),)))
    path.write_text(json.dumps({"effects": [{"name": "coma", "waves": 1}]}))
    assert parse_effects([str(path)])[1] == (fx.Coma(1),)
    path.write_text(json.dumps(describe(fx.catalogue())))
    assert parse_effects([str(path)])[1] == fx.catalogue()


def test_words_say_all_of_an_entry() -> None:
    entries = [
        Entry(one, one.name, dict.fromkeys(given, "stated")) for one in fx.catalogue() if (given := _numbers(one))
    ]
    entries.append(Entry(fx.Coma(0.1 + 0.2, 1e-17), "coma", {"waves": "measured", "angle_rad": "stated"}))
    entries.append(Entry(fx.Zernike(((4, 0, 0.1), (3, -1, -5e-2))), "zernike", {"terms": "measured"}))
    entries.append(Entry(fx.ColourFilter("GRBG", 0.05), "colour_filter", {"cfa": "stated", "leak": "measured"}))
    entries.append(Entry(None, "bandwidth", setting="off"))
    words = effect_words(entries)
    assert "zernike=4,0,0.1;3,-1,-0.05 measured" in words and words[-1] == "bandwidth=off"
    assert effect_entries(words) == tuple(entries)
    both = effect_words([Entry(fx.Coma(0.3), "coma", {"waves": "measured"}, "off")])
    assert both == ("coma=waves:0.3 measured", "coma=off")
    assert effect_words([Entry(fx.Zernike(), "zernike", {"terms": "stated"})]) == (), "no terms"
    assert parse_effects(both) == ({"coma": "off"}, (fx.Coma(0.3),))


def _numbers(effect: fx.Effect) -> list[str]:
    """Return the magnitudes of an effect that are set."""
    return [key for key, value in describe([effect])[0].items() if key != "name" and value not in (None, (), [])]


REFUSED = [
    ("coma", "NAME=on, off, auto or a magnitude"),
    ("comma=0.3", "expected .*coma"),
    ("coma=large", "expected a number, with waves or no unit"),
    ("coma=30%", "expected a number, with waves or no unit"),
    ("coma=0.3um", "expected a number"),
    ("coma=0.3@40um", "expected a number, with rad, mrad, deg"),
    ("coma=size:3", "expected waves or angle_rad"),
    ("iris_shape=6.5", "a whole number"),
    ("iris_shape=2", "3"),
    ("zernike=4.5,0,0.1", "triples"),
    ("zernike=3,0,0.1", "n - .m. even"),
    ("zernike=900,0,0.1", "40"),
    ("zernike=4,0", "n,m,waves"),
    ("colour_filter=QXYZ", "letters"),
    ("colour_filter=RGB", "letters"),
    ("spherical=0.1@3", "expected waves"),
    ("cos4=0.3", "this effect has no magnitude"),
    ("crosstalk=0.9", "0.25"),
    ("lenslet_gap=1e400", "got inf"),
    ("missing_lenslets=0.5,1,0", "triples"),
    ("missing_lenslets=0,1", "row,column,transmission"),
]


@pytest.mark.parametrize(("words", "match"), REFUSED)
def test_words_of_no_effect_are_refused_in_one_line(words: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        parse_effects([words])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        *((text, "a list of effects") for text in ("", "{", "3", "[3]", '[{"waves": 1}]', '{"effects": 3}')),
        pytest.param("[" * 100_000, "a list of effects", id="deep"),
        ('[{"name": "iris_shape", "blades": Infinity}]', "a whole number"),
        *(
            (json.dumps([{"name": "coma", "waves": 0.3, **extra}]), match)
            for extra, match in (
                ({"setting": "maybe"}, "auto, on or off"),
                ({"setting": ["on"]}, "auto, on or off"),
                ({"sources": {"waves": "guessed"}}, "."),
                ({"sources": {"angle_rad": "measured"}}, "."),
                ({"sources": {"waves": ["measured"]}}, "."),
                ({"sources": "measured"}, "."),
            )
        ),
    ],
)
def test_files_of_no_effects_are_refused_in_one_line(tmp_path: Path, text: str, match: str) -> None:
    path = tmp_path / "effects.json"
    path.write_text(text)
    with pytest.raises((InputError, FileFormatError), match=match) as caught:
        read_entries(path)
    assert "\n" not in str(caught.value)


def test_magnitudes_of_files_are_checked() -> None:
    for name, key, values in (
        ("coma", "waves", ("large", True, None, [1])),
        ("coma", "size", (1,)),
        ("zernike", "terms", ([[1, 2]], 3)),
        ("colour_filter", "cfa", (3,)),
    ):
        for value in values:
            with pytest.raises(InputError):
                effect_from(name, {key: value})


CAMERAS = [preset("bench"), preset("lfm_60x12")]


def of(effect: object, camera: Camera = CAMERAS[0], **given: str) -> dict[str, Magnitude]:
    return {one.field: one for one in magnitudes_of(effect, camera, given)}


def test_every_magnitude_has_a_unit_and_a_value() -> None:
    for camera in CAMERAS:
        for kind in fx.CATALOGUE:
            listed = magnitudes_of(kind(), camera)
            assert [one.field for one in listed] == [field.name for field in fields(kind)]
            for one in listed:
                assert one.kind != "other" and one.title
                assert one.counts is not None, "None represents the camera's value, or a typical size"
                described = one.value is None and kind.is_described(one.field, camera)
                assert one.source == ("camera" if described else "typical")
                if one.kind in ("number", "whole"):
                    has_unit = one.field in kind.units or one.field.endswith(("_um", "_rad", "_s"))
                    assert has_unit, f"{kind.name}: {one.field} needs an entry in units"
                    assert one.read(one.text(one.counts)) == pytest.approx(one.counts, rel=1e-9)
            assert effect_from(kind.name, {one.field: one.value for one in listed}) == kind()


def test_units_are_those_people_use() -> None:
    coma = of(fx.Coma(0.3, math.radians(40)))
    assert (coma["waves"].text(0.3), coma["waves"].unit) == ("0.3", "waves")
    assert (coma["angle_rad"].text(coma["angle_rad"].value), coma["angle_rad"].unit) == ("40", "°")
    assert coma["angle_rad"].read("40") == coma["angle_rad"].read("40 deg") == pytest.approx(math.radians(40))
    assert coma["angle_rad"].read("10mrad") == pytest.approx(0.01)
    share = of(fx.Crosstalk())["share"]
    assert (share.text(share.value), share.unit, share.range_text()) == ("1", "%", "0 to 25 %")
    assert share.read("2") == share.read("2%") == 0.02
    width = of(fx.Bandwidth())["width_um"]
    assert (width.unit, width.text(0.02)) == ("nm", "20"), "as the camera's description shows it"
    assert width.read("20") == pytest.approx(0.02) and width.read("0.02um") == pytest.approx(0.02)
    assert of(fx.PitchError())["relative"].text(1e-4) == "0.01"


def test_where_values_come_from() -> None:
    camera = replace(CAMERAS[0], marks=Marks.of({"sensor.read_noise_e": "assumed", "bandwidth_um": "measured"}))
    rms = of(fx.ReadNoise(), camera)["rms_e"]
    assert (rms.source, rms.mark, rms.value) == ("camera", "assumed", None)
    assert rms.counts == camera.sensor.read_noise_e
    assert of(fx.Bandwidth(), camera)["width_um"].mark == "measured"
    assert of(fx.IrisShape(), camera)["blades"].mark == "stated"
    given = of(fx.ReadNoise(3.0), camera)["rms_e"]
    assert (given.source, given.mark, given.counts) == ("given", "stated", 3.0)
    coma = of(fx.Coma(), waves="measured")
    assert (coma["waves"].source, coma["waves"].mark) == ("given", "measured"), "the usual size, but given by the user"
    assert (coma["angle_rad"].source, coma["angle_rad"].mark) == ("typical", "")
    assert [of(fx.FiniteSource(), c)["diameter_um"].counts for c in CAMERAS] == [50.0, 0.2]
    with pytest.raises(InputError, match="stated or measured"):
        of(fx.Coma(), waves="guessed")


@pytest.mark.parametrize(
    ("effect", "field", "text", "match"),
    [
        (fx.Crosstalk(), "share", "30", "expected 0 to 25 %, got 30 %"),
        (fx.Coma(), "waves", "large", "a number, with waves or no unit"),
        (fx.Coma(), "waves", "", "a number"),
        (fx.Coma(), "waves", "0,3", "write 0.3 with a decimal point"),
        (fx.Coma(), "waves", "nan", "a number"),
        (fx.Coma(), "waves", "1e999", "got inf"),
        (fx.Coma(), "angle_rad", "40 um", "rad, mrad, deg"),
        (fx.IrisShape(), "blades", "6.5", "a whole number"),
        (fx.FiniteSource(), "diameter_um", "-1", "at least 0 µm"),
    ],
)
def test_texts_of_no_value_are_refused_in_one_line(effect: fx.Effect, field: str, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        of(effect)[field].read(text)
    assert "\n" not in str(caught.value)


def test_entries_survive_their_file(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    entries = (
        Entry(fx.Coma(0.3, 0.5), "coma", {"waves": "measured", "angle_rad": "stated"}, "on"),
        Entry(fx.Zernike(((3, 1, 0.1),)), "zernike", {"terms": "stated"}),
        Entry(None, "bandwidth", {}, "off"),
    )
    path.write_text(entries_json(entries))
    assert read_entries(path) == entries
    settings, given = parse_effects([str(path)])
    assert settings == {"coma": "on", "bandwidth": "off"}
    assert given == (fx.Coma(0.3, 0.5), fx.Zernike(((3, 1, 0.1),)))


def test_magnitudes_of_the_catalogue_are_what_the_effects_compute_with() -> None:
    """The described values reach the physics: an effect given the camera's own values is the effect without values."""
    for camera in CAMERAS:
        for effect in fx.catalogue():
            given = {one.field: one.counts for one in magnitudes_of(effect, camera)}
            if not given or effect.name == "zernike":
                continue
            full = replace(effect, **given)
            for method in ("kernel", "rms", "play", "end", "share", "gain_rms", "transmission", "iris"):
                if callable(getattr(effect, method, None)):
                    assert np.array_equal(getattr(full, method)(camera), getattr(effect, method)(camera))
