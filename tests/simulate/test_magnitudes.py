"""Magnitudes one by one: their units for people, where their values come from, and what is no value."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import Camera, Marks, preset
from lfcal.simulate.effects import (
    CATALOGUE,
    Bandwidth,
    Coma,
    Crosstalk,
    FiniteSource,
    IrisShape,
    PitchError,
    ReadNoise,
    Zernike,
    catalogue,
)
from lfcal.simulate.effects.described import (
    Entry,
    Magnitude,
    effect_from,
    entries_json,
    magnitudes_of,
    parse_effects,
    read_entries,
)

CAMERAS = [preset("bench"), preset("lfm_60x12")]


def of(effect: object, camera: Camera = CAMERAS[0], **given: str) -> dict[str, Magnitude]:
    return {one.field: one for one in magnitudes_of(effect, camera, given)}  # type: ignore[arg-type]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.name)
@pytest.mark.parametrize("name", list(CATALOGUE.names()))
def test_every_magnitude_counts_for_something_and_has_a_unit(name: str, camera: Camera) -> None:
    kind = CATALOGUE.get(name)
    listed = magnitudes_of(kind(), camera)
    assert [one.field for one in listed] == [field.name for field in fields(kind)]  # type: ignore[arg-type]
    for one in listed:
        assert one.kind != "other" and one.title
        assert one.counts is not None, "None stands for the camera's value, or for a typical size"
        assert one.source == ("camera" if one.value is None and kind.is_described(one.field, camera) else "typical")
        if one.kind in ("number", "whole"):
            told = one.field in kind.units or one.field.endswith(("_um", "_rad", "_s"))
            assert told, f"{name}: {one.field} needs an entry in units"
            assert one.read(one.text(one.counts)) == pytest.approx(one.counts, rel=1e-9)
    assert effect_from(name, {one.field: one.value for one in listed}) == kind()


def test_units_are_those_people_use() -> None:
    coma = of(Coma(0.3, math.radians(40)))
    assert (coma["waves"].text(0.3), coma["waves"].unit) == ("0.3", "waves")
    assert (coma["angle_rad"].text(coma["angle_rad"].value), coma["angle_rad"].unit) == ("40", "°")
    assert coma["angle_rad"].read("40") == coma["angle_rad"].read("40 deg") == pytest.approx(math.radians(40))
    assert coma["angle_rad"].read("10mrad") == pytest.approx(0.01)
    share = of(Crosstalk())["share"]
    assert (share.text(share.value), share.unit, share.range_text()) == ("1", "%", "0 to 25 %")
    assert share.read("2") == share.read("2%") == 0.02
    width = of(Bandwidth())["width_um"]
    assert (width.unit, width.text(0.02)) == ("nm", "20"), "as the camera's description shows it"
    assert width.read("20") == pytest.approx(0.02) and width.read("0.02um") == pytest.approx(0.02)
    assert of(PitchError())["relative"].text(1e-4) == "0.01"


def test_where_values_come_from() -> None:
    camera = replace(CAMERAS[0], marks=Marks.of({"sensor.read_noise_e": "assumed", "bandwidth_um": "measured"}))
    rms = of(ReadNoise(), camera)["rms_e"]
    assert (rms.source, rms.mark, rms.value) == ("camera", "assumed", None)
    assert rms.counts == camera.sensor.read_noise_e
    assert of(Bandwidth(), camera)["width_um"].mark == "measured"
    assert of(IrisShape(), camera)["blades"].mark == "stated"
    given = of(ReadNoise(3.0), camera)["rms_e"]
    assert (given.source, given.mark, given.counts) == ("given", "stated", 3.0)
    coma = of(Coma(), waves="measured")
    assert (coma["waves"].source, coma["waves"].mark) == ("given", "measured"), "the usual size, but said by somebody"
    assert (coma["angle_rad"].source, coma["angle_rad"].mark) == ("typical", "")
    assert [of(FiniteSource(), c)["diameter_um"].counts for c in CAMERAS] == [50.0, 0.2]
    with pytest.raises(InputError, match="stated or measured"):
        of(Coma(), waves="guessed")


@pytest.mark.parametrize(
    ("effect", "field", "text", "match"),
    [
        (Crosstalk(), "share", "30", "expected 0 to 25 %, got 30 %"),
        (Coma(), "waves", "large", "a number, with waves or no unit"),
        (Coma(), "waves", "", "a number"),
        (Coma(), "waves", "0,3", "write 0.3 with a decimal point"),
        (Coma(), "waves", "nan", "a number"),
        (Coma(), "waves", "1e999", "got inf"),
        (Coma(), "angle_rad", "40 um", "rad, mrad, deg"),
        (IrisShape(), "blades", "6.5", "a whole number"),
        (FiniteSource(), "diameter_um", "-1", "at least 0 µm"),
    ],
)
def test_what_is_no_value_is_one_line(effect: object, field: str, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        of(effect)[field].read(text)
    assert "\n" not in str(caught.value)


def test_edited_magnitudes_make_the_effect() -> None:
    waves, angle = magnitudes_of(Coma(), CAMERAS[0])
    edited = effect_from("coma", {waves.field: waves.read("0.3"), angle.field: angle.read("40")})
    assert edited == Coma(0.3, math.radians(40))
    (terms,) = magnitudes_of(Zernike(), CAMERAS[0])
    assert effect_from("zernike", {terms.field: ((3, 1, 0.1),)}) == Zernike(((3, 1, 0.1),))


def test_entries_survive_their_file(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    entries = (
        Entry(Coma(0.3, 0.5), "coma", {"waves": "measured", "angle_rad": "stated"}, "on"),
        Entry(Zernike(((3, 1, 0.1),)), "zernike", {"terms": "stated"}),
        Entry(None, "bandwidth", {}, "off"),
    )
    path.write_text(entries_json(entries))
    assert read_entries(path) == entries
    settings, given = parse_effects([str(path)])
    assert settings == {"coma": "on", "bandwidth": "off"}
    assert given == (Coma(0.3, 0.5), Zernike(((3, 1, 0.1),)))


@pytest.mark.parametrize(
    "extra",
    [
        {"setting": "maybe"},
        {"setting": ["on"]},
        {"sources": {"waves": "guessed"}},
        {"sources": {"angle_rad": "measured"}},
        {"sources": {"waves": ["measured"]}},
        {"sources": "measured"},
    ],
    ids=str,
)
def test_entries_that_say_what_cannot_be(tmp_path: Path, extra: dict[str, object]) -> None:
    path = tmp_path / "effects.json"
    path.write_text(json.dumps([{"name": "coma", "waves": 0.3, **extra}]))
    with pytest.raises((InputError, FileFormatError)) as caught:
        read_entries(path)
    assert "\n" not in str(caught.value)


def test_a_blade_count_beyond_numbers_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    path.write_text('[{"name": "iris_shape", "blades": Infinity}]')
    with pytest.raises(InputError, match="a whole number"):
        read_entries(path)


def test_magnitudes_of_the_catalogue_are_what_the_effects_compute_with() -> None:
    """The described values reach the physics: an effect told the camera's own values is the untold effect."""
    for camera in CAMERAS:
        for effect in catalogue():
            told = {one.field: one.counts for one in magnitudes_of(effect, camera)}
            if not told or effect.name == "zernike":
                continue
            full = replace(effect, **told)  # type: ignore[type-var]
            for method in ("kernel", "rms", "play", "end", "share", "gain_rms", "transmission", "iris"):
                if callable(getattr(effect, method, None)):
                    assert np.array_equal(getattr(full, method)(camera), getattr(effect, method)(camera))
