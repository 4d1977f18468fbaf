"""Each fault put into a recording is named, with its place and its size; a recording without one has none."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.judge import FAULTS, iter_search
from lfcal.judge._patch import patch_of
from tests.judge.common import (
    FEWEST,
    PEAK,
    added,
    clean,
    compressed,
    evidence_of,
    faults_of,
    light,
    noisy,
    plan,
    scaled,
    sensor,
)


def test_a_clean_recording_has_no_fault() -> None:
    evidence = evidence_of(clean())
    found, left = drain(iter_search(evidence))
    assert not found and left.misfit < 0.02
    for name in ("source_y", "source_x", "window_y", "window_x", "depth"):
        values, sigmas = evidence.column(name)
        assert 0.7 < np.std(values / sigmas) < 1.6, f"{name}: stated errors hold"


def test_a_dead_column_is_named_with_its_place() -> None:
    image = sensor(1.0)
    image[:, 30] = 0.0
    found = faults_of(noisy(scaled(light(), image)))
    assert set(found) == {"dead_line"} and found["dead_line"].detail.startswith("column 30 ")
    assert set(found["dead_line"].pixels[:, 1].tolist()) == {30}


@pytest.mark.long
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.few(1)
def test_a_hot_line_is_no_step_of_the_stage(axis: int) -> None:
    image = sensor(0.0)
    image[(25, slice(None)) if axis == 0 else (slice(None), 25)] = 0.01 * PEAK
    found = faults_of(added(clean(), image))
    assert set(found) == {"hot_line"} and f"{('row', 'column')[axis]} 25 " in found["hot_line"].detail


def test_a_finding_brings_the_picture_that_shows_it() -> None:
    image = sensor(0.0)
    image[:, 25] = 60.0
    picture = faults_of(added(clean(), image))["hot_line"].picture
    assert picture is not None and int(np.nanargmax(picture.values)) == 25 and picture.unit == "counts"
    assert picture.values[25] == pytest.approx(60, abs=3)


def test_offsets_of_rows_are_measured() -> None:
    image = sensor(0.0) + np.random.default_rng(1).normal(0, 6, (len(sensor(0)), 1)).astype(np.float32)
    found = faults_of(added(clean(), image))
    assert set(found) == {"line_offsets"} and "rows" in found["line_offsets"].detail
    assert float(found["line_offsets"].detail.split(" by ")[1].split()[0]) == pytest.approx(image.std(), rel=0.3)


def test_offsets_of_rows_and_columns_are_one_fault() -> None:
    shape, rng = sensor(0.0).shape, np.random.default_rng(1)
    image = sensor(0.0) + rng.normal(0, 6, (shape[0], 1)).astype(np.float32)
    image += rng.normal(0, 4, (1, shape[1])).astype(np.float32)
    (one,), cleaned = drain(iter_search(evidence_of(added(clean(), image))))
    assert one.name == "line_offsets" and "rows" in one.detail and "columns" in one.detail
    # what puts it in for its cost has both
    patch = patch_of(cleaned, cleaned.index[:20], cleaned.plan.cutout)
    assert one.put_in is not None
    seen = patch.seen(image.astype(np.float64))
    left = one.put_in(patch) - patch.light - seen
    assert np.std(left - left.mean()) < 0.3 * np.std(seen)


def test_bad_pixels_are_no_lines() -> None:
    image = sensor(0.0)
    image[20, 33] = 0.3 * PEAK
    found = faults_of(added(clean(), image))
    assert set(found) == {"bad_pixels"} and found["bad_pixels"].pixels.tolist() == [[20, 33]]


def test_a_mosaic_is_no_lamp() -> None:
    image = sensor(1.0)
    image[::2, ::2], image[1::2, 1::2] = 0.6, 0.5
    found = faults_of(noisy(scaled(light(), image)))
    told = [float(v) for v in found["mosaic"].detail.split(" receive ")[1].split(" of ")[0].split(", ")]
    assert set(found) == {"mosaic"} and told == pytest.approx([0.6, 1, 1, 0.5], abs=0.02)


@pytest.mark.parametrize("power", [1.05, 1.2])
@pytest.mark.few(1)
def test_the_exponent_of_values_is_measured(power: float) -> None:
    values = noisy(light())
    found = faults_of((np.sign(values) * PEAK * (np.abs(values) / PEAK) ** power).astype(np.float32))
    assert set(found) == {"not_linear"}
    assert float(found["not_linear"].detail.split("power of ")[1].split()[0]) == pytest.approx(power, abs=0.02)


def test_compression_is_named_before_what_it_looks_like() -> None:
    assert "compression" in faults_of(compressed(clean(), 75), FEWEST)


def test_a_lamp_that_fades_and_one_that_flickers() -> None:
    ny, nx = plan().period
    come = np.arange(ny * nx).reshape(ny, nx) / (ny * nx)
    found = faults_of(noisy(light() * (1 - 0.08 * come)[None, :, :, None, None].astype(np.float32)))
    assert set(found) == {"lamp"} and found["lamp"].detail.startswith("-8")
    lamp = 1 + 0.05 * np.random.default_rng(2).standard_normal(light().shape[:3])
    found = faults_of(noisy((light() * lamp[..., None, None]).astype(np.float32)))
    assert set(found) == {"flicker"} and 4 < float(found["flicker"].detail.split()[0]) < 6.5


@pytest.mark.parametrize(("ratio", "words"), [(3, "2.98 times the expected light"), (0, "no light")])
def test_a_frame_with_another_exposure_is_to_be_recorded_again(ratio: int, words: str) -> None:
    values = light()
    place = evidence_of(clean()).index[17]
    values[tuple(place)] *= ratio
    found = faults_of(noisy(values))
    assert set(found) == {"exposure"} and found["exposure"].redo
    assert found["exposure"].positions.tolist() == [place.tolist()] and f"has {words}" in found["exposure"].detail


@pytest.mark.long
def test_planes_that_were_swapped_are_at_each_others_depths() -> None:
    found = faults_of(clean()[::-1].copy())
    assert set(found) == {"depth_label"}
    words = found["depth_label"].detail.replace(";", "").split()
    told = [float(words[k + 2]) for k, word in enumerate(words) if word == "v"]
    assert told == pytest.approx([4.0, 3.0], rel=5e-3)


def test_frames_that_move_halfway_are_told_with_the_first() -> None:
    values = clean()
    values[1] = np.roll(values[1], 1, axis=3)
    found = faults_of(values)
    assert set(found) == {"frame_shift"} and found["frame_shift"].detail.startswith("1.00 px across")
    assert set(found["frame_shift"].positions[:, 0].tolist()) == {1}


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.few(1)
def test_a_ghost_is_told_with_its_share_and_place(mirrored: bool) -> None:
    ghost = light()[..., ::-1, :] if mirrored else light()
    found = faults_of(noisy(light() + np.float32(0.02) * np.roll(ghost, (7, -5), (3, 4))))
    assert set(found) == {"ghost"}
    assert ("mirrored top to bottom" if mirrored else "as it is") in found["ghost"].detail
    assert "+7 px (down) and -5 px (right)" in found["ghost"].detail
    assert found["ghost"].share == pytest.approx(0.02, rel=0.3)
    picture = found["ghost"].picture
    assert picture is not None and all("(px)" in axis for axis in picture.axes)
    brightest = np.unravel_index(np.argmax(picture.values), picture.values.shape)
    assert tuple(np.add(brightest, picture.origin)) == (7, -5)


def test_two_faults_at_once_are_both_named() -> None:
    image = sensor(1.0)
    image[:, 30] = 0.0
    ny, nx = plan().period
    come = np.arange(ny * nx).reshape(ny, nx) / (ny * nx)
    values = scaled(light() * (1 - 0.08 * come)[None, :, :, None, None].astype(np.float32), image)
    assert set(faults_of(noisy(values))) == {"dead_line", "lamp"}


def test_a_repair_takes_the_fault_away() -> None:
    image = sensor(1.0)
    image[::2, ::2], image[1::2, 1::2] = 0.6, 0.5
    evidence = evidence_of(scaled(light(), image))
    (found,), _ = drain(iter_search(evidence))
    assert found.name == "mosaic" and found.repair is not None
    whole = evidence_of(light())
    back = found.repair(evidence.index, evidence.data)
    scale = float((back * whole.data).sum() / np.square(whole.data).sum())
    assert np.abs(back / scale - whole.data).sum() < 0.02 * whole.data.sum()


def test_every_fault_says_what_to_do() -> None:
    for fault in FAULTS:
        assert fault.title and fault.advice.endswith(".") and fault.found.__doc__
