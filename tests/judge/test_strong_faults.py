"""Faults that leave little of the patterns as it was: values bent, cut off, rounded away, in other planes."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.judge import Evidence, iter_evidence, iter_search
from tests.judge.common import FEWEST, clean, faults_of, light, matrix, plan, truth
from tests.judge.test_inspection import inspected
from tests.judge.test_levels_order_pupil import put_in


@pytest.mark.long
def test_bent_values_are_straightened_before_lines_are_looked_for() -> None:
    found = faults_of(put_in("gamma below 1", 0.4), FEWEST)
    assert next(iter(found)) == "not_linear" and not {"line_offsets", "mosaic", "depth_label"} & set(found)
    told = float(found["not_linear"].detail.split("power of ")[1].split()[0])
    assert told == pytest.approx(0.4, rel=0.03)


@pytest.mark.long
def test_bent_values_are_told_where_dark_samples_have_no_noise() -> None:
    """Dark samples, of next to no noise, have all the say in what fits a pattern best."""
    peak = float(light().max())
    found = faults_of((peak * (light() / peak) ** 2.2).astype(np.float32))
    told = float(found["not_linear"].detail.split("power of ")[1].split()[0])
    assert told == pytest.approx(2.2, rel=0.01)


@pytest.mark.long
def test_a_ceiling_that_most_light_ends_at_is_no_hot_pixel() -> None:
    assert next(iter(faults_of(put_in("saturation", 0.02), FEWEST))) == "saturated"


def test_noise_that_was_cut_off_at_zero_is_told_by_its_dark_samples() -> None:
    (one,) = faults_of(put_in("clipped at zero", 1)).values()
    told = [float(part.split()[0]) for part in one.detail.split("noise of ")[1].split("around ")]
    assert one.name == "cut_off" and told == pytest.approx([3.0, -3.0], abs=0.5), one.detail


@pytest.mark.long
def test_noise_that_was_cut_off_at_zero_costs_what_it_costs_a_large_reconstruction() -> None:
    values = put_in("clipped at zero", 1)
    found = inspected(matrix(values))
    (one,) = found.faults
    true = truth().cost(values)
    assert one.cost is not None and true > 0.005 and true / 2 < one.cost < 2 * true
    assert not found.alarms


def test_signed_noise_and_a_background_are_not_cut_off() -> None:
    assert "cut_off" not in faults_of(np.abs(clean()) + np.float32(1))
    assert "cut_off" not in faults_of(light())


@pytest.mark.long
def test_a_strong_compression_costs_what_it_takes_away() -> None:
    values = put_in("JPEG", 30)
    found = inspected(matrix(values), FEWEST)
    (one,) = found.faults
    true = truth().cost(values)
    assert one.name == "compression" and one.cost is not None
    assert true > 0.3 and true / 2 < one.cost < 2 * true


@pytest.mark.long
def test_patterns_of_other_places_cost_no_more_than_all_of_h() -> None:
    values = put_in("planes swapped", 0.2)
    found = inspected(matrix(values))
    strangers = next(one for one in found.faults if one.name == "strangers")
    assert found.as_it_is is not None and found.clean is not None and strangers.cost is not None
    assert 0.1 < strangers.cost <= found.as_it_is - found.clean + 1e-9
    assert strangers.positions[:, 1].max() < 0.3 * plan().period[0]


@pytest.mark.long
def test_a_lamp_that_jumps_is_told_where_planes_were_looked_at_on_different_sides_of_it() -> None:
    """Positions that metrics find odd are compared besides: of one plane those before, of the other those after."""
    ny, nx = plan().period
    rows = [(0, y, x) for y in (ny // 2 - 2, ny // 2 - 3) for x in range(0, nx, 2)]
    rows += [(1, y, x) for y in (ny // 2 + 2, ny // 2 + 3) for x in range(0, nx, 2)]
    work = iter_evidence(matrix(put_in("lamp that jumps", 0.3)), patterns=24, suspected=np.array(rows))
    evidence = drain(work)
    assert isinstance(evidence, Evidence)
    (one,) = drain(iter_search(evidence))[0]
    assert one.name == "lamp" and one.detail.endswith("onwards in every plane") and 0.28 < 4 * one.share < 0.37
