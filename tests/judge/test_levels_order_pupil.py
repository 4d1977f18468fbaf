"""Ceilings, backgrounds, anchors, orders of the scan, dark parts of the pupil and lens types out of focus."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks._fault_list import FAULTS
from tests.judge.common import FEWEST, PEAK, Values, clean, faults_of, matrix, plan, recording, scaled, sensor
from tests.judge.test_inspection import inspected


def put_in(name: str, strength: float) -> Values:
    (one,) = (one for one in FAULTS if one.name == name)
    return one.put_in(recording(), strength)


def test_values_that_end_are_told_with_their_ceiling() -> None:
    found = faults_of(put_in("saturation", 0.5))
    assert next(iter(found)) == "saturated" and "not_linear" not in found
    assert float(found["saturated"].detail.split(" exceed ")[1].split()[0]) == pytest.approx(PEAK / 2, rel=1e-3)


def test_values_that_end_are_told_where_a_white_image_divided_the_ceiling() -> None:
    """Else the ceiling looks like light missing in a part of the pupil, and like bad pixels."""
    fall = np.linspace(0.97, 1.02, sensor(1.0).shape[1], dtype=np.float32)
    found = faults_of(scaled(put_in("saturation", 0.5), sensor(1.0) / fall))
    assert next(iter(found)) == "saturated" and not {"pupil", "bad_pixels", "not_linear"} & set(found)
    assert float(found["saturated"].detail.split(" exceed ")[1].split()[0]) == pytest.approx(PEAK / 2, rel=0.04)


def test_light_that_falls_over_the_field_is_no_ceiling() -> None:
    fall = np.linspace(0.97, 1.02, sensor(1.0).shape[1], dtype=np.float32)
    assert "saturated" not in faults_of(scaled(clean(), sensor(1.0) / fall))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_background_is_measured(sign: int) -> None:
    found = faults_of(clean() + np.float32(sign * 15))
    assert set(found) == {"background"}
    assert float(found["background"].detail.split()[0]) == pytest.approx(sign * 15, abs=0.5)


def test_an_anchor_that_is_wrong_for_all_frames() -> None:
    found = faults_of(np.roll(clean(), 2, axis=3))
    assert "frame_shift" in found and found["frame_shift"].detail.startswith("2.0")
    assert "anchor" in found["frame_shift"].detail and "order" not in found


@pytest.mark.parametrize(("axis", "words"), [(1, "plane 0: rows of"), (2, "plane 0: columns of")])
@pytest.mark.few(1)
def test_a_mirrored_plane_is_named_with_its_axis(axis: int, words: str) -> None:
    values = clean()
    values[0] = np.flip(values[0], axis - 1)
    found = faults_of(values)
    assert set(found) == {"order"} and words in found["order"].detail


def test_frames_that_come_late_are_told_with_their_number() -> None:
    found = faults_of(put_in("frames late", 5))
    assert set(found) == {"order"} and found["order"].detail.count("all patterns are 5 frames late") == 2


def test_a_stuck_blade_darkens_its_side() -> None:
    found = faults_of(put_in("blade stuck", 0.3))
    assert "pupil" in found and not {"ghost", "type_light", "depth_label"} & set(found)
    side = float(found["pupil"].detail.split("angle of ")[1].split("°")[0])
    assert side == pytest.approx(np.degrees(0.6), abs=25)
    picture = found["pupil"].picture
    assert picture is not None and picture.values.shape == plan().cutout and picture.values.min() < 50


def test_a_lens_type_out_of_focus_is_measured() -> None:
    found = faults_of(put_in("lens type out of focus", 0.05))
    words = found["type_focus"].detail
    told, stated = (float(part.split(" µm")[0].split()[-1]) for part in (words.split("instead")[0], words))
    stated = float(words.split("of ")[1].split()[0])
    assert words.startswith("type 1") and told / stated == pytest.approx(1.05, abs=0.01)


@pytest.mark.long
def test_two_frames_far_apart_that_were_swapped_are_both_listed() -> None:
    found = inspected(matrix(put_in("far positions swapped", 1)))
    strangers = next(one for one in found.faults if one.name == "strangers")
    assert len(strangers.positions) == 2 and len(found.redo()) >= 2
    assert {tuple(place) for place in strangers.positions.tolist()} <= {place for place, _ in found.redo()}


@pytest.mark.long
def test_rows_that_were_swapped_are_no_displaced_frames() -> None:
    found = inspected(matrix(put_in("rows swapped", 3)), FEWEST)
    assert found.faults[0].name == "strangers" and found.bad
