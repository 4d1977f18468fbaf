"""Faults that leave little of what a comparison needs: dead pixels, bent or rounded values, a pupil dark in a part."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks._fault_costs import TrueCost
from benchmarks._fault_list import FAULTS
from benchmarks._fault_optics import flicker
from benchmarks._fault_recordings import CAMERAS, Recording
from lfcal.base.progress import drain
from lfcal.judge import Evidence, iter_evidence, iter_search
from lfcal.judge.faults.levels import BRIGHT, MUCH
from lfcal.judge.faults.pupil import LEFT
from lfcal.judge.faults.scan import WORTH_PX
from lfcal.judge.faults.sensor_lines import BRIGHT as HOT
from lfcal.judge.inspection import EXPLAINED
from tests.judge import common
from tests.judge.common import (
    FEWEST,
    PEAK,
    added,
    clean,
    evidence_of,
    faults_of,
    light,
    matrix,
    noisy,
    recording,
    scaled,
    sensor,
    truth,
)
from tests.judge.test_inspection import inspected
from tests.judge.test_levels_order_pupil import put_in
from tests.judge.test_stage_faults import displaced, grid


def test_single_dead_pixels_and_dust_are_named_with_their_places() -> None:
    found = faults_of(put_in("dead pixels", 4))
    assert set(found) == {"bad_pixels"} and {(22, 38), (21, 47)} <= {*map(tuple, found["bad_pixels"].pixels.tolist())}
    dust = faults_of(put_in("dust on the sensor", 0.3))
    assert set(dust) == {"bad_pixels"} and len(dust["bad_pixels"].pixels) > 8


@pytest.mark.long
@pytest.mark.parametrize("exponent", [2.2, 0.5])
def test_a_strong_gamma_is_measured(exponent: float) -> None:
    found = faults_of(put_in("gamma above 1", exponent), FEWEST)
    told = float(found["not_linear"].detail.split("power of ")[1].split()[0])
    assert told == pytest.approx(exponent, rel=0.06)


@pytest.mark.long
@pytest.mark.parametrize("share", [0.3, -0.2])
def test_values_that_fall_behind_where_it_is_bright_are_no_power(share: float) -> None:
    """By the power that is most like it, 7 % of the light of microscopes was left unexplained."""
    evidence = evidence_of(put_in("bend towards the top", share), FEWEST)
    found, cleaned = drain(iter_search(evidence))
    assert [one.name for one in found] == ["not_linear"] and cleaned.misfit < EXPLAINED / 2
    brightest = float(light()[tuple(evidence.index.T)].max())
    told = float(found[0].detail.split(" ± ")[0].split()[-1])
    assert ("lack" if share > 0 else "exceed") in found[0].detail
    assert told == pytest.approx(100 * abs(share) * brightest / PEAK, rel=0.1)


def test_a_slight_compression_leaves_its_blocks() -> None:
    found = faults_of(put_in("JPEG", 95))
    assert "of the cutout is lost" in found["compression"].detail


def test_values_of_eight_bits_are_no_fault() -> None:
    step = np.float32(PEAK / 230)
    evidence = evidence_of(np.rint(clean() / step) * step)
    assert evidence.rounding == pytest.approx(step**2 / 12, rel=0.1)
    assert not drain(iter_search(evidence))[0]


def test_a_lamp_that_jumps_in_every_plane() -> None:
    found = faults_of(put_in("lamp that jumps", 0.3))
    assert set(found) == {"lamp"} and found["lamp"].detail.endswith("onwards in every plane")


def test_light_that_follows_the_pattern_is_told_with_its_power() -> None:
    found = faults_of(put_in("automatic exposure", 1.0))
    assert set(found) == {"auto_exposure"} and "power of -1.0" in found["auto_exposure"].detail


@pytest.mark.long
def test_light_that_follows_the_pattern_costs_what_it_costs_a_large_reconstruction() -> None:
    found = inspected(matrix(put_in("automatic exposure", 1.0)))
    (one,) = found.faults
    assert one.name == "auto_exposure" and "power of -1.0" in one.detail
    assert one.cost is not None and 0.05 < one.cost < 0.19, "what it costs a large reconstruction is 0.094"


@pytest.mark.long
@pytest.mark.parametrize("part", [0.6, 0.3])
def test_a_blade_far_in_is_explained(part: float) -> None:
    found, cleaned = drain(iter_search(evidence_of(put_in("blade stuck", part))))
    assert [one.name for one in found] == ["pupil"] and cleaned.misfit < EXPLAINED / 2
    side = float(found[0].detail.split("light ")[1].split("°")[0])
    assert side == pytest.approx(np.degrees(0.6), abs=8)


@pytest.mark.long
def test_a_blade_far_in_is_explained_before_bent_values_of_a_microscope() -> None:
    """Bent values, jitter and the blade in that order left 8 % of the light."""
    found, cleaned = drain(iter_search(evidence_of_microscope("blade stuck", 0.6)))
    assert found[0].name == "pupil" and cleaned.misfit < EXPLAINED / 2


@pytest.mark.long
def test_planes_with_each_other_s_depth_are_told() -> None:
    """They lie farther off than depths beside the stated one that are tried."""
    evidence = evidence_of_microscope("planes swapped", 1.0)
    (found,) = drain(iter_search(evidence))[0]
    assert found.name == "depth_label"
    assert "plane 0: v = 2.4" in found.detail and "plane 1: v = 4.8" in found.detail


def evidence_of_microscope(name: str, strength: float) -> Evidence:
    other = Recording(CAMERAS["lfm_20x05"]())
    (fault,) = (one for one in FAULTS if one.name == name)
    found = drain(iter_evidence(other.matrix(fault.put_in(other, strength)), patterns=FEWEST))
    assert isinstance(found, Evidence)
    return found


@pytest.mark.long
def test_the_first_rows_of_swapped_planes_tell_no_depth() -> None:
    evidence = evidence_of(put_in("planes swapped", 0.2))
    assert not evidence.starts.depth.any()
    found = {one.name: one for one in drain(iter_search(evidence))[0]}
    assert "strangers" in found and found["strangers"].positions[:, 1].max() < 4


@pytest.mark.long
def test_frames_that_a_metric_names_cost_what_they_cost_here() -> None:
    found = inspected(matrix(put_in("repeated frames", 20)))
    duplicates = found.quality["duplicates"]
    assert duplicates in found.alarms
    assert 0.025 < duplicates.cost < 0.1, "0.049 in a large reconstruction, 0.21 by the table"


@pytest.mark.long
def test_a_lens_type_far_out_of_focus_is_no_bent_values() -> None:
    """Of so different a camera the model is off everywhere: bent values, bad pixels and a ghost explain some of it."""
    found, cleaned = drain(iter_search(evidence_of(put_in("lens type out of focus", 0.15))))
    assert [one.name for one in found] == ["type_focus"] and cleaned.misfit < LEFT
    told, stated = (float(found[0].detail.split(words)[1].split()[0]) for words in ("length ", "instead of "))
    assert told / stated == pytest.approx(1.15, abs=0.005)


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_a_strong_ghost_is_told_whole_and_once() -> None:
    found, _ = drain(iter_search(evidence_of(put_in("ghost turned", 0.1))))
    assert [one.name for one in found] == ["ghost"] and "rotated by 180°" in found[0].detail
    assert found[0].share == pytest.approx(0.1, abs=0.003)


@pytest.mark.long
def test_no_ghost_is_brighter_than_the_light() -> None:
    """Of a strong gamma on this camera a ghost of 18 times the light explained most of what was left."""
    found = {one.name: one for one in drain(iter_search(evidence_of_microscope("gamma above 1", 2.2)))[0]}
    assert next(iter(found)) == "not_linear" and "ghost" not in found


@pytest.mark.long
def test_the_frames_that_flicker_most_do_not_tell_by_how_much_all_do() -> None:
    lamp = flicker(recording(), 0.2)[..., 0, 0]
    odd = np.argwhere(np.abs(lamp - 1) > 0.45)
    assert len(odd) > 20
    evidence = drain(iter_evidence(matrix(put_in("lamp that flickers", 0.2)), patterns=common.PATTERNS, suspected=odd))
    assert isinstance(evidence, Evidence)
    (one,) = (one for one in drain(iter_search(evidence))[0] if one.name == "flicker")
    assert float(one.detail.split()[0]) == pytest.approx(20, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_dead_pixel_costs_the_same_whatever_its_noise(seed: int) -> None:
    """Where all that a pixel at the image's border sees has it dead, light is divided by noise: 0.07 to 0.5."""
    image = sensor(1.0)
    image[36, 23] = 0.0
    values = noisy(scaled(light(), image), seed)
    true = (TrueCost(light(), noisy(light(), seed)) if seed else truth()).cost(values)
    (one,) = inspected(matrix(values)).faults
    assert one.pixels.tolist() == [[36, 23]] and one.cost is not None and true / 2 < one.cost < 2 * true


@pytest.mark.long
def test_a_dead_column_costs_what_it_costs_at_the_border_too() -> None:
    """It reaches the image's border wherever it lies; amid the periods it was told to cost half of what it does."""
    image = sensor(1.0)
    image[:, 23] = 0.0
    values = noisy(scaled(light(), image), 0)
    (one,) = inspected(matrix(values)).faults
    true = truth().cost(values)
    assert one.cost == pytest.approx(true, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    ("camera", "name", "strength"),
    [("r29-like", "dead row", 1.0), ("r29-like", "dim row", 0.3), ("lfm_60x12", "hot pixels together", 0.4)],
)
def test_lines_and_hot_pixels_cost_what_they_cost_at_the_border_too(camera: str, name: str, strength: float) -> None:
    """They were told to cost .16 of .47, .03 of .06, and .25 of .12."""
    other = Recording(CAMERAS[camera]())
    (fault,) = (one for one in FAULTS if one.name == name)
    values = fault.put_in(other, strength)
    true = TrueCost(other.light(), other.clean()).cost(values)
    found = inspected(other.matrix(values)).faults[0]
    assert found.cost is not None and true / 1.7 < found.cost < 1.7 * true


@pytest.mark.parametrize(("name", "strength"), [("repeated frames", 20), ("scan to and fro read as raster", 1)])
def test_frames_of_other_places_make_no_bad_pixels_and_no_ghost(name: str, strength: float) -> None:
    assert set(faults_of(put_in(name, strength))) == {"strangers"}


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_a_scan_to_and_fro_that_is_read_as_one_way() -> None:
    values = clean()
    values[:, 1::2] = values[:, 1::2, ::-1].copy()
    found = faults_of(values)
    assert set(found) == {"order"}
    assert found["order"].detail.count("every other row of positions is reversed") == 2
    columns = clean()
    columns[1, :, 1::2] = columns[1, ::-1, 1::2].copy()
    assert "plane 1: every other column" in faults_of(columns)["order"].detail


# -- just above the limit below which a finder says nothing ------------------------------------------------
def test_a_background_just_above_the_limit_is_told() -> None:
    some = light()
    samples = some.shape[3] * some.shape[4]
    level = 1.3 * max(BRIGHT * PEAK, MUCH * float(some.sum((3, 4)).mean()) / samples)
    assert set(faults_of(clean() + np.float32(level))) == {"background"}


def test_a_hot_pixel_just_above_the_limit_is_told() -> None:
    image = sensor(0.0)
    image[29, 36] = 1.5 * 10 * HOT * PEAK
    found = faults_of(added(clean(), image))
    assert set(found) == {"bad_pixels"} and found["bad_pixels"].pixels.tolist() == [[29, 36]]


@pytest.mark.long
@pytest.mark.usefixtures("all_patterns")
def test_positions_just_beyond_the_limit_are_told() -> None:
    scatter = 1.3 * WORTH_PX / np.sqrt(2)
    y, _ = grid()
    found = faults_of(displaced(*np.random.default_rng(5).normal(0, scatter, (2, *y.shape))))
    assert set(found) == {"jitter"}


@pytest.mark.long
def test_two_dead_columns_of_a_small_microscope_are_named() -> None:
    """They were 6 % of its light and 25 % of its misfit, and were not named for their small share of the light."""
    evidence = evidence_of_microscope("two dead columns apart", 0.8)
    assert "dead_line" in {one.name for one in drain(iter_search(evidence))[0]}
