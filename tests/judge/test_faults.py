"""Each fault put into a recording is found, with its place and its size; a recording without one has none."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks._fault_optics import flicker
from benchmarks._fault_recordings import CAMERAS, Recording
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.judge import FAULTS, Evidence, Fault, FoundFault, iter_evidence, iter_inspection, iter_search
from lfcal.judge._patch import patch_of
from lfcal.judge.faults._series import scan_order
from lfcal.judge.faults.levels import BRIGHT, MUCH
from lfcal.judge.faults.pupil import LEFT
from lfcal.judge.faults.scan import WORTH_PX
from lfcal.judge.faults.sensor_lines import BRIGHT as HOT
from lfcal.judge.inspection import EXPLAINED
from lfcal.judge.quality import QualityReport, inspect
from lfcal.psf import PSFMatrix
from tests.distribution import names_of
from tests.judge import common
from tests.judge.common import (
    FEWEST,
    PEAK,
    SOME,
    Values,
    added,
    clean,
    compared,
    compressed,
    displaced,
    evidence_of,
    faults_of,
    inspected,
    light,
    matrix,
    noisy,
    plan,
    put_in,
    recording,
    scaled,
    sensor,
)
from tests.judge.injections import INJECTIONS


def numbers(detail: str, after: str, count: int) -> list[float]:
    """Return the numbers of a detail after some words."""
    rest = detail.split(after, 1)[1] if after else detail
    return [float(one) for one in re.findall(r"[-+]?\d+(?:\.\d+)?", rest)[:count]]


FIGURES: dict[str, tuple[str, str, tuple[float, ...], float]] = {
    "saturated": ("values do not exceed", " exceed ", (PEAK / 2,), 2.0),
    "cut_off": ("dark samples", "noise of ", (3.0,), 0.5),
    "background": ("in every sample", "", (0.02 * PEAK,), 0.5),
    "order": ("plane 0: columns of positions are reversed; plane 1: columns of", "", (), 0.0),
    "pupil": ("the light falls to", "angle of ", (float(np.degrees(0.6)),), 25.0),
    "type_focus": ("type 1", "length ", (1.15 * 435.6,), 0.005 * 435.6),
    "compression": ("blocks of 8 x 8 pixels", "", (), 0.0),
    "not_linear": ("power of", "power of ", (1.1,), 0.02),
    "dead_line": ("column 30 ", "region: ", (100.0,), 5.0),
    "hot_line": ("column 25 ", "region: ", (60.0,), 3.0),
    "line_offsets": ("rows scatter", " by ", (5.2,), 1.5),
    "mosaic": ("2 x 2 block", " receive ", (0.6, 1.0, 1.0, 0.5), 0.02),
    "bad_pixels": ("1 pixel:", "pixel: ", (20.0, 33.0), 0.0),
    "strangers": ("contains the pattern of", "", (), 0.0),
    "frame_shift": ("px across", "", (1.0,), 0.004),
    "stage_axes": ("with wrong steps", "rotated by ", (1.0,), 0.015),
    "backlash": ("along the rows", "displaced by ", (0.3,), 0.005),
    "jitter": ("about their positions", " by ", (0.15,), 0.05),
    "auto_exposure": ("to the power of", "power of ", (-0.6,), 0.05),
    "exposure": ("times the expected light", "has ", (3.0,), 0.05),
    "lamp": ("over the scan of a plane", "", (-8.4,), 0.6),
    "flicker": ("from frame to frame", "", (5.0,), 1.2),
    "depth_label": ("plane 1: v = ", "plane 0: v = ", (4.0, 3.0), 0.02),
    "focus_drift": ("plane 0", "changes by ", (3.0,), 0.2),
    "ghost": ("mirrored top to bottom", "displaced by ", (7.0, -5.0), 0.0),
    "type_light": ("type 1 ", " passes ", (79.5,), 3.5),
}
"""For each injection: words of its detail, those before its numbers, the true numbers, and their tolerance."""

MIXED: dict[str, set[str]] = {
    "saturated": {"not_linear"},
    "compression": set(),
    "pupil": {"ghost", "type_light", "depth_label"},
    "jitter": {"stage_axes", "backlash", "depth_label", "lamp"},
    "focus_drift": set(),
    "type_light": set(),
}
"""Faults with which others may be found, but not these."""


def places(found: FoundFault, axis: int) -> set[int]:
    return set(found.positions[:, axis].tolist())


def brightest(found: FoundFault) -> Any:
    return np.unravel_index(int(np.nanargmax(found.picture.values)), found.picture.values.shape)


MORE: dict[str, Callable[[FoundFault], Any]] = {
    "dead_line": lambda one: set(one.pixels[:, 1].tolist()) == {30},
    "hot_line": lambda one: brightest(one) == (25,) and one.picture.unit == "counts",
    "bad_pixels": lambda one: one.pixels.tolist() == [[20, 33]],
    "strangers": lambda one: one.redo and places(one, 2) <= {3, 4},
    "frame_shift": lambda one: places(one, 0) == {1},
    "exposure": lambda one: one.redo and one.positions.tolist() == [compared()[17].tolist()],
    "pupil": lambda one: one.picture.values.shape == plan().cutout and one.picture.values.min() < 50,
    "ghost": lambda one: tuple(np.add(brightest(one), one.picture.origin)) == (7, -5) and abs(one.share - 0.02) < 0.006,
}
"""What else is true of a finding: its pixels, positions and picture."""

SLOW = ("compression", "depth_label", "focus_drift", "order", "type_focus")


@pytest.mark.parametrize(
    "name", [one if one not in SLOW else pytest.param(one, marks=pytest.mark.long) for one in FIGURES]
)
def test_each_fault_is_found_with_its_place_and_size(name: str) -> None:
    words, after, figures, tolerance = FIGURES[name]
    found = faults_of(INJECTIONS[name].made())
    assert name in found and not MIXED.get(name, set(found) - {name}) & set(found), list(found)
    one = found[name]
    assert words in one.detail, one.detail
    if figures:
        assert numbers(one.detail, after, len(figures)) == pytest.approx(list(figures), abs=tolerance), one.detail
    assert name not in MORE or MORE[name](one), one


def low_background() -> Values:
    some = light()
    level = 1.3 * max(BRIGHT * PEAK, MUCH * float(some.sum((3, 4)).mean()) / (some.shape[3] * some.shape[4]))
    return clean() + np.float32(level)


def dim_hot_pixel() -> Values:
    image = sensor(0.0)
    image[29, 36] = 1.5 * 10 * HOT * PEAK
    return added(clean(), image)


def blank_frame() -> Values:
    values = light()
    values[tuple(compared()[17])] = 0
    return noisy(values)


def wide_steps() -> Values:
    y, x = recording().grid()
    return displaced(0.03 * y, 0.03 * x)


FALL = np.linspace(0.97, 1.02, sensor(1.0).shape[1], dtype=np.float32)
OTHERS: dict[str, tuple[Callable[[], Values], str, str]] = {
    "a slight compression": (lambda: put_in("JPEG", 95), "compression", "of the cutout is lost"),
    "a background just above the limit": (low_background, "background", "counts in every sample"),
    "a hot pixel just above the limit": (dim_hot_pixel, "bad_pixels", "1 pixel: (29, 36)"),
    "a frame without light": (blank_frame, "exposure", "has no light"),
    "a lamp that jumps": (lambda: put_in("lamp that jumps", 0.3), "lamp", "onwards in every plane"),
    "steps too long": (wide_steps, "stage_axes", "stage step +3.0 %:"),
    "a wrong anchor": (lambda: np.roll(clean(), 2, axis=3), "frame_shift", "anchor"),
    "frames late": (lambda: put_in("frames late", 5), "order", "all patterns are 5 frames late"),
    "repeated frames": (lambda: put_in("repeated frames", 20), "strangers", "contains the pattern of"),
    "a ceiling after a white image": (
        lambda: scaled(put_in("saturation", 0.5), sensor(1.0) / FALL),
        "saturated",
        "values do not exceed 1",
    ),
    "a lens type out of focus": (lambda: put_in("lens type out of focus", 0.05), "type_focus", "type 1: focal length"),
    "light that falls over the field": (lambda: scaled(clean(), sensor(1.0) / FALL), "not saturated", ""),
    "noise of one sign over a background": (lambda: np.abs(clean()) + np.float32(1), "not cut_off", ""),
}
"""Weak faults and special cases: the only fault that is found, or one that must not be, and words of its detail."""


@pytest.mark.parametrize("case", OTHERS)
def test_weak_faults_and_special_cases(case: str) -> None:
    make, name, words = OTHERS[case]
    found = faults_of(make())
    if name.startswith("not "):
        assert name.removeprefix("not ") not in found
        return
    assert words in found[name].detail, found[name].detail
    if name == "saturated":  # otherwise the ceiling looks like light missing in a part of the pupil
        assert next(iter(found)) == name and not {"pupil", "bad_pixels", "not_linear"} & set(found)
        assert numbers(found[name].detail, " exceed ", 1) == pytest.approx([PEAK / 2], rel=0.04)
    elif name == "type_focus":
        measured, stated = (numbers(found[name].detail, after, 1)[0] for after in ("length ", "instead of "))
        assert measured / stated == pytest.approx(1.05, abs=0.01)
    else:
        assert name == "compression" or "order" not in set(found) - {name}
        assert name in ("compression", "frame_shift") or set(found) == {name}
    if name == "exposure":
        assert found[name].redo and found[name].positions.tolist() == [compared()[17].tolist()]


def test_every_fault_has_a_remedy_and_an_example() -> None:
    assert set(FIGURES) == {fault.name for fault in FAULTS}
    for fault in FAULTS:
        assert fault.title and fault.advice.endswith(".") and fault.found.__doc__


# -- no fault ----------------------------------------------------------------------------------------------
def documented() -> Fault:
    fault = names_of("extending.md", "A fault")["FRINGES"]
    assert isinstance(fault, Fault)
    return fault


def test_a_clean_recording_has_no_fault() -> None:
    evidence = evidence_of(clean())
    found, left = drain(iter_search(evidence))
    assert not found and left.misfit < 0.02
    for name in ("source_y", "source_x", "window_y", "window_x", "depth"):
        values, sigmas = evidence.column(name)
        assert 0.7 < np.std(values / sigmas) < 1.6, f"{name}: stated errors hold"
    assert not list(documented().found(evidence))


def test_values_of_eight_bits_are_no_fault() -> None:
    step = np.float32(PEAK / 230)
    evidence = evidence_of(np.rint(clean() / step) * step)
    assert evidence.rounding == pytest.approx(step**2 / 12, rel=0.1)
    assert not drain(iter_search(evidence))[0]


# -- levels and values -------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_ceiling_that_most_light_ends_at_is_no_hot_pixel() -> None:
    assert next(iter(faults_of(put_in("saturation", 0.02), FEWEST))) == "saturated"


@pytest.mark.long
@pytest.mark.parametrize(
    ("exponent", "tolerance"), [(2.2, 0.06), (0.5, 0.06), (0.4, 0.03)], ids=["above 1", "below 1", "far below 1"]
)
def test_a_strong_gamma_is_measured_before_lines_are_searched(exponent: float, tolerance: float) -> None:
    found = faults_of(put_in("gamma above 1", exponent), FEWEST)
    assert next(iter(found)) == "not_linear" and not {"line_offsets", "mosaic", "depth_label"} & set(found)
    assert numbers(found["not_linear"].detail, "power of ", 1) == pytest.approx([exponent], rel=tolerance)


@pytest.mark.long
def test_bent_values_are_measured_where_dark_samples_have_no_noise() -> None:
    """Dark samples, with almost no noise, dominate what fits a pattern best."""
    found = faults_of((PEAK * (light() / PEAK) ** 2.2).astype(np.float32))
    assert numbers(found["not_linear"].detail, "power of ", 1) == pytest.approx([2.2], rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize("share", [0.3, -0.2])
def test_values_that_deviate_where_it_is_bright_are_no_power(share: float) -> None:
    """By the most similar power, 7 % of the light of microscopes was left unexplained."""
    evidence = evidence_of(put_in("bend towards the top", share), FEWEST)
    found, cleaned = drain(iter_search(evidence))
    assert [one.name for one in found] == ["not_linear"] and cleaned.misfit < EXPLAINED / 2
    top = float(light()[tuple(evidence.index.T)].max())
    assert ("lack" if share > 0 else "exceed") in found[0].detail
    assert float(found[0].detail.split(" ± ")[0].split()[-1]) == pytest.approx(100 * abs(share) * top / PEAK, rel=0.1)


# -- pixels and lines --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["dead pixels", pytest.param("dust on the sensor", marks=pytest.mark.long)])
def test_single_dead_pixels_and_dust_are_named_with_their_places(name: str) -> None:
    found = faults_of(put_in(name, 4 if name == "dead pixels" else 0.3))
    assert set(found) == {"bad_pixels"}
    pixels = {*map(tuple, found["bad_pixels"].pixels.tolist())}
    assert {(22, 38), (21, 47)} <= pixels if name == "dead pixels" else len(pixels) > 8


def test_offsets_of_rows_and_columns_are_one_fault() -> None:
    shape, rng = sensor(0.0).shape, np.random.default_rng(1)
    image = sensor(0.0) + rng.normal(0, 6, (shape[0], 1)).astype(np.float32)
    image += rng.normal(0, 4, (1, shape[1])).astype(np.float32)
    (one,), cleaned = drain(iter_search(evidence_of(added(clean(), image))))
    assert one.name == "line_offsets" and "rows" in one.detail and "columns" in one.detail
    # what puts it in for its cost has both
    patch = patch_of(cleaned, cleaned.index[:20], cleaned.plan.cutout)
    seen = patch.seen(image.astype(np.float64))
    left = one.put_in(patch) - patch.light - seen
    assert np.std(left - left.mean()) < 0.3 * np.std(seen)


@pytest.mark.long
def test_two_dead_columns_of_a_small_microscope_are_named() -> None:
    """They were 6 % of its light and 25 % of its misfit, and were not named for their small share of the light."""
    assert "dead_line" in microscope_faults("two dead columns apart", 0.8)[0]


# -- light of frames ---------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_lamp_that_jumps_is_found_where_planes_were_compared_on_different_sides_of_it() -> None:
    """Positions that metrics find odd are compared besides: of one plane those before, of the other those after."""
    ny, nx = plan().period
    rows = [(0, y, x) for y in (ny // 2 - 2, ny // 2 - 3) for x in range(0, nx, 2)]
    rows += [(1, y, x) for y in (ny // 2 + 2, ny // 2 + 3) for x in range(0, nx, 2)]
    evidence = drain(iter_evidence(matrix(put_in("lamp that jumps", 0.3)), patterns=24, suspected=np.array(rows)))
    (one,) = drain(iter_search(evidence))[0]
    assert one.name == "lamp" and one.detail.endswith("onwards in every plane") and 0.28 < 4 * one.share < 0.37


@pytest.mark.long
def test_the_frames_that_flicker_most_do_not_bias_the_measured_flicker() -> None:
    lamp = flicker(recording(), 0.2)[..., 0, 0]
    odd = np.argwhere(np.abs(lamp - 1) > 0.45)
    assert len(odd) > 20
    work = iter_evidence(matrix(put_in("lamp that flickers", 0.2)), patterns=common.PATTERNS, suspected=odd)
    found = {one.name: one for one in drain(iter_search(drain(work)))[0]}
    assert numbers(found["flicker"].detail, "", 1) == pytest.approx([20], rel=0.1)


@pytest.mark.usefixtures("all_patterns")
def test_the_fault_of_the_documentation_is_found_and_removed() -> None:
    nx = plan().period[1]
    fringes = 1 + 0.05 * np.cos(2 * np.pi * 4 * np.arange(nx) / nx + 1)
    evidence = evidence_of(noisy((light() * fringes[:, None, None]).astype(np.float32)))
    (found,) = documented().found(evidence)
    assert found.detail.endswith("4 times over the period") and found.picture is not None
    without = evidence.with_data(found.repair(evidence.index, evidence.data), evidence.valid)
    order = scan_order(evidence.index)
    before, after = (part.column("gain")[0][order] for part in (evidence, without))
    assert np.ptp(after) < np.ptp(before) / 2 and not list(documented().found(without))


# -- scan and stage ----------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_orders_that_are_wrong_in_a_part_are_described() -> None:
    def interlaced(values: Values, planes: Any, axis: int) -> Values:
        """Reverse every other line of positions."""
        lines = np.moveaxis(values[planes], axis, 1)
        lines[:, 1::2] = np.flip(lines[:, 1::2], 2).copy()
        return values

    for values, words in (
        (interlaced(clean(), slice(None), 1), ["plane 0: every other row", "plane 1: every other row"]),
        (interlaced(clean(), slice(1, 2), 2), ["plane 1: every other column of positions is reversed"]),
        (np.concatenate([np.flip(clean()[:1], 1), clean()[1:]]), ["plane 0: rows of"]),
    ):
        found = faults_of(values)
        assert set(found) == {"order"} and all(one in found["order"].detail for one in words), found


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_positions_just_beyond_the_limit_are_found() -> None:
    scatter = 1.3 * WORTH_PX / np.sqrt(2)
    assert set(faults_of(displaced(*np.random.default_rng(5).normal(0, scatter, (2, *plan().period))))) == {"jitter"}


@pytest.mark.long
def test_two_frames_far_apart_that_were_swapped_are_both_listed() -> None:
    found = inspected(matrix(put_in("far positions swapped", 1)))
    strangers = next(one for one in found.faults if one.name == "strangers")
    assert len(strangers.positions) == 2 and len(found.redo()) >= 2
    assert {tuple(place) for place in strangers.positions.tolist()} <= {place for place, _ in found.redo()}


@pytest.mark.long
def test_swapped_rows_and_parts_of_planes_are_patterns_of_other_positions() -> None:
    found = inspected(matrix(put_in("rows swapped", 3)), FEWEST)
    assert found.faults[0].name == "strangers" and found.bad
    evidence = evidence_of(put_in("planes swapped", 0.2))
    assert not evidence.starts.depth.any(), "a few rows do not give a plane its depth"
    part = {one.name: one for one in drain(iter_search(evidence))[0]}
    assert part["strangers"].positions[:, 1].max() < 4


# -- optics ------------------------------------------------------------------------------------------------
@pytest.mark.long
@pytest.mark.parametrize("part", [0.6, 0.3])
def test_a_blade_far_in_is_explained(part: float) -> None:
    found, cleaned = drain(iter_search(evidence_of(put_in("blade stuck", part))))
    assert [one.name for one in found] == ["pupil"] and cleaned.misfit < EXPLAINED / 2
    side = float(found[0].detail.split("light ")[1].split("°")[0])
    assert side == pytest.approx(np.degrees(0.6), abs=8)


@pytest.mark.long
def test_a_lens_type_far_out_of_focus_is_not_taken_for_bent_values() -> None:
    """The model is off everywhere: bent values, bad pixels and a ghost explain some of it."""
    found, cleaned = drain(iter_search(evidence_of(put_in("lens type out of focus", 0.15))))
    assert [one.name for one in found] == ["type_focus"] and cleaned.misfit < LEFT


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_a_strong_ghost_is_found_whole_and_once() -> None:
    found, _ = drain(iter_search(evidence_of(put_in("ghost turned", 0.1))))
    assert [one.name for one in found] == ["ghost"] and "rotated by 180°" in found[0].detail
    assert found[0].share == pytest.approx(0.1, abs=0.003)


def microscope_faults(name: str, strength: float) -> tuple[dict[str, FoundFault], Evidence]:
    other = Recording(CAMERAS["lfm_20x05"]())
    evidence = drain(iter_evidence(other.matrix(put_in(name, strength, other)), patterns=FEWEST))
    found, cleaned = drain(iter_search(evidence))
    return {one.name: one for one in found}, cleaned


@pytest.mark.long
def test_faults_of_a_microscope_are_not_taken_for_others() -> None:
    """Bent values, jitter and the blade in that order left 8 % of the light."""
    found, cleaned = microscope_faults("blade stuck", 0.6)
    assert next(iter(found)) == "pupil" and cleaned.misfit < EXPLAINED / 2
    # a ghost of 18 times the light explained most of what a strong gamma left
    found, _ = microscope_faults("gamma above 1", 2.2)
    assert next(iter(found)) == "not_linear" and "ghost" not in found
    # the depths of swapped planes are farther away than those that are tried around the stated one
    found, _ = microscope_faults("planes swapped", 1.0)
    assert set(found) == {"depth_label"}
    assert all(words in found["depth_label"].detail for words in ("plane 0: v = 2.4", "plane 1: v = 4.8"))


# -- several, and repairs ----------------------------------------------------------------------------------
def test_two_faults_at_once_are_both_named() -> None:
    image = sensor(1.0)
    image[:, 30] = 0.0
    ny, nx = plan().period
    come = (np.arange(ny * nx) / (ny * nx)).reshape(ny, nx).astype(np.float32)
    values = scaled(light() * (1 - 0.08 * come)[None, :, :, None, None], image)
    assert set(faults_of(noisy(values))) == {"dead_line", "lamp"}


def test_a_repair_removes_the_fault() -> None:
    image = sensor(1.0)
    image[::2, ::2], image[1::2, 1::2] = 0.6, 0.5
    evidence = evidence_of(scaled(light(), image))
    (found,), _ = drain(iter_search(evidence))
    assert found.name == "mosaic" and found.repair is not None
    whole, back = evidence_of(light()), found.repair(evidence.index, evidence.data)
    scale = float((back * whole.data).sum() / np.square(whole.data).sum())
    assert np.abs(back / scale - whole.data).sum() < 0.02 * whole.data.sum()


# -- H without a fault: small cells, no noise, cutouts that are too small, rounded periods ---------------
NEAR, FAR = (-20.0, 0.0, 20.0), (-60.0, 0.0, 60.0)


OTHER_PLANES = (((15.0, 30.0, 30.2), False), ((30.0, 30.2), True))


@cache
def microscope(pitch_px: float, depths: tuple[float, ...] = NEAR, cutout: int = 31) -> Recording:
    """Return a recording of a light-field microscope whose lenslets are so many pixels apart."""
    camera = preset("lfm_20x05")
    camera = replace(camera, sensor=replace(camera.sensor, pixel_um=camera.lattice.pitch_um / pitch_px))
    return Recording(ScanPlan.for_camera(camera, depths_um=depths, cutout=cutout))


def findings(r: Recording, values: Values, provenance: Mapping[str, Any] | None = None) -> tuple[FoundFault, ...]:
    plan = r.plan
    H = PSFMatrix(values, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor, provenance=provenance)
    evidence = drain(iter_evidence(H, patterns=SOME))
    assert isinstance(evidence, Evidence)
    return drain(iter_search(evidence))[0]


def doubted(quality: QualityReport) -> set[str]:
    return {m.key for m in quality.metrics if m.merit in ("bad", "fair")}


@pytest.mark.long
@pytest.mark.parametrize(
    ("pitch", "cutout"),
    [(6, 31), *(pytest.param(p, 4 * p + 3, marks=pytest.mark.long) for p in (5, 7, 8, 9, 10, 11, 12, 14, 16))],
)
def test_small_cells_without_noise_are_neither_compressed_nor_from_a_bad_sensor(pitch: int, cutout: int) -> None:
    r = microscope(pitch, cutout=cutout)
    named = {one.name for one in findings(r, r.light())}
    assert not named & {"compression", "dead_line", "bad_pixels", "hot_line", "depth_label", "pupil"}


@pytest.mark.parametrize("pitch", [pytest.param(5, marks=pytest.mark.long), 6])
def test_small_cells_with_noise_have_no_fault(pitch: int) -> None:
    """Between lenslets a few pixels apart the model is off by more than the light there, and in focus by 1 %."""
    r = microscope(pitch)
    named = {one.name for one in findings(r, r.clean())}
    assert not named & {"compression", "dead_line", "bad_pixels", "hot_line"}
    assert pitch == 5 or not named


@pytest.mark.long
@pytest.mark.parametrize("quality", [75, *(pytest.param(one, marks=pytest.mark.long) for one in (95, 30))])
def test_a_compression_is_named_with_small_cells_unless_frames_were_stored_without_loss(quality: int) -> None:
    r = microscope(9, cutout=39)
    values = compressed(r.clean(), quality)
    lossless = {"frames": {"codec": {"name": "lzw", "lossless": True}}}
    unknown = (None, {"frames": {"codec": {"name": "unknown"}}}, {"frames": "any"})
    for provenance, named in ((lossless, False), *((one, True) for one in unknown[: 1 if quality == 75 else 3])):
        assert ("compression" in {one.name for one in findings(r, values, provenance)}) is named, provenance


@pytest.mark.long
@pytest.mark.parametrize("noise", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("pitch", [7, pytest.param(12, marks=pytest.mark.long)])
def test_what_is_cut_off_is_no_other_fault(pitch: int, noise: bool) -> None:
    """Of complete frames whose cutouts are filled: missing frames, dark planes, stage steps, saturated pixels."""
    r = microscope(pitch, FAR)
    values = r.clean() if noise else r.light()
    quality = inspect(r.matrix(values), workers=1)
    assert [m.key for m in quality.alarms if m.key != "hot_pixels"] == ["truncation"]
    assert doubted(quality) <= {"truncation", "hot_pixels", "position"}
    values[0, 2, 3] = 0 * values[0, 2, 3]
    assert inspect(r.matrix(values), workers=1)["missing"].positions.tolist() == [[0, 2, 3]]


@pytest.mark.long
def test_a_fault_that_costs_nothing_does_not_hide_what_is_cut_off() -> None:
    r = microscope(7)
    H = r.matrix(r.light())
    found = drain(iter_inspection(H, inspect(H, workers=1), patterns=FEWEST))
    assert found.bad and "light at the edge" in found.verdict


@cache
def rounded() -> Recording:
    """Return a recording whose period, 7 px, is 0.4 px less than its lenslets are apart."""
    return microscope(7.4, (15.0, 30.0), 41)


@pytest.mark.long
def test_a_rounded_period_makes_no_seam_and_other_seams_are_named() -> None:
    quality = inspect(rounded().matrix(rounded().clean()), workers=1)
    assert quality["seam"].merit == "good" and quality["period"].merit == "fair"
    # patterns of lenslets 8 px apart, of which 7 positions were recorded as if that were a period
    r = microscope(7, rounded().plan.depths_um, 41)
    values = microscope(8, r.plan.depths_um, 41).clean()[:, :7, :7]
    assert inspect(r.matrix(np.ascontiguousarray(values)), workers=1)["seam"].merit == "bad"


@pytest.mark.long
def test_odd_frames_and_a_seam_that_the_camera_explains_are_none() -> None:
    """Frames change more from one to the next, and across the wrap, where a source crosses from lenslet to lenslet."""
    r = microscope(7)
    H = r.matrix(r.clean())
    quality = inspect(H, workers=1)
    fair = {key: replace(quality[key], value=3.3, merit="fair", cost=0.05) for key in ("step", "seam")}
    rest = (m if m.merit in ("good", "unknown") else replace(m, merit="good", cost=0.0) for m in quality.metrics)
    metrics = tuple(fair.get(m.key, m) for m in rest)
    found = drain(iter_inspection(H, replace(quality, metrics=metrics), patterns=FEWEST))
    assert found.compared and found.merit == "good" and "should be checked" not in found.verdict


@pytest.mark.long
@pytest.mark.parametrize(
    ("depths", "noise"),
    [((15.0, 30.0, 30.2), True), *(pytest.param(*one, marks=pytest.mark.long) for one in OTHER_PLANES)],
)
def test_planes_close_together_are_no_copies_and_copies_are_found(depths: tuple[float, ...], noise: bool) -> None:
    """They differ by less than noise; copies share it."""
    r = microscope(7, depths)
    values = r.clean() if noise else r.light()
    assert inspect(r.matrix(values), workers=1)["plane_copies"].merit == "good"
    values[-1] = values[-2]
    assert inspect(r.matrix(values), workers=1)["plane_copies"].merit == "bad"
    if len(depths) == 3 and noise:  # a depth that was recorded twice, among others
        r = microscope(7, (15.0, 22.0, 30.0))
        light = r.light()
        light[2] = light[1]
        assert inspect(r.matrix(r.noisy(light)), workers=1)["plane_copies"].merit == "bad"
