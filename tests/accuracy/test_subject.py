"""What is measured: plans, H with and without its camera, and samples of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy import subject as module
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.simulate import plan_effects, simulate_psf


def numbered(shape: tuple[int, int, int, int, int]) -> PSFMatrix:
    return PSFMatrix(np.arange(np.prod(shape), dtype=np.float32).reshape(shape), depths=np.arange(shape[0]))


def test_a_sample_of_h_is_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    H = numbered((5, 2, 3, 9, 9))
    monkeypatch.setattr(module, "SAMPLE_BYTES", 4 * 3 * 6 * 25)
    sample = drain(Subject.of_matrix(H, "H").iter_sample(3))
    np.testing.assert_array_equal(np.asarray(sample.matrix), np.asarray(H)[1:4, :, :, 2:7, 2:7])
    assert sample.scale == H.size / sample.matrix.size and list(sample.matrix.depths) == [1, 2, 3]
    assert sample.notes == ("3 of 5 planes, 3 x 2 positions, 5 x 5 px of the cutout's 9 x 9, of H",)


def test_ht_is_measured_as_its_h() -> None:
    H = numbered((1, 2, 3, 5, 7))
    np.testing.assert_array_equal(np.asarray(drain(Subject.of_matrix(H.T, "HT").iter_sample(1)).matrix), np.asarray(H))


@pytest.mark.parametrize("part", ["storage", "projection", "solvers"])
@pytest.mark.parametrize("level", [0.0, -1.0])
def test_without_light_there_is_nothing_to_measure(part: str, level: float) -> None:
    H = PSFMatrix(np.full((3, 2, 2, 5, 5), level, np.float32))
    found = measure_curve(PARTS.get(part), Subject.of_matrix(H, "dark.h5"))
    assert not found.points and "expected light in the middle planes, got none" in found.stopped


def test_samples_are_made_once() -> None:
    subject = Subject.of_matrix(numbered((3, 2, 2, 5, 5)), "H")
    assert drain(subject.iter_sample(7)) is drain(subject.iter_sample(3)), "there are no more than three"
    assert drain(subject.iter_patterns()) is drain(subject.iter_patterns())


def test_patterns_keep_their_cutout_and_are_spread() -> None:
    H = numbered((3, 30, 40, 3, 5))
    patterns = drain(Subject.of_matrix(H, "H").iter_patterns())
    assert patterns.values.shape == (8, 8, 3, 5) and patterns.scale == 3 * 30 * 40 / 64
    np.testing.assert_array_equal(patterns.values[0, 0], H[1, 0, 0])
    np.testing.assert_array_equal(patterns.values[-1, -1], H[1, 29, 39])


@pytest.mark.long
def test_a_simulated_sample_is_the_middle_of_a_simulated_h(plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SAMPLE_BYTES", 4 * 9 * 15 * 15)
    monkeypatch.setattr(module, "LONGEST_WAVES", 0.0)
    sample = drain(Subject("small", plan).iter_sample(1))
    effects = plan_effects(plan, module.EFFECTS_TOLERANCE)
    middle = replace(plan, depths_um=plan.depths_um[1:2], exposure_s=plan.exposures[1:2])
    (whole,) = simulate_psf(middle, effects, level="geometric", tolerance=module.TOLERANCE)
    np.testing.assert_allclose(sample.matrix[0], whole[:, :, 3:18, 3:18], atol=1e-6 * float(whole.max()))
    assert "by rays" in sample.notes[0] or "level geometric, because wave optics takes longer" in sample.notes[0]


def test_the_plan_of_h_is_the_one_it_was_made_with(plan: ScanPlan, tmp_path: Path) -> None:
    H = simulate_psf(plan, (), "geometric", out=tmp_path / "H.h5", provenance={"plan": plan.to_dict()})
    with H:
        assert Subject.of_matrix(H, "H").planned == plan


def test_the_plan_of_h_is_made_of_its_camera_where_it_tells_none(plan: ScanPlan) -> None:
    H = simulate_psf(plan, (), "geometric")
    found = Subject.of_matrix(H, "H").planned
    assert (found.camera, found.shape, found.anchor) == (plan.camera, plan.shape, plan.anchor)
    assert found.depths_um == plan.depths_um


@pytest.mark.parametrize("told", [{"format": "lfcal-plan"}, "plan", {"format": "lfcal-plan", "version": 1, "x": []}])
def test_a_plan_that_anyone_may_have_written_is_not_believed(plan: ScanPlan, told: object) -> None:
    values = np.ones(plan.shape, np.float32)
    H = PSFMatrix(values, camera=plan.camera, depths=plan.depths_um, anchor=plan.anchor, provenance={"plan": told})
    assert Subject.of_matrix(H, "H").planned.shape == plan.shape


def test_without_a_camera_it_says_so(tmp_path: Path) -> None:
    save(numbered((1, 2, 2, 3, 3)), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H, pytest.raises(InputError, match="got H of an unknown camera"):
        _ = Subject.of_matrix(H, "H").planned
    with pytest.raises(InputError, match="subject of the accuracy measurement"):
        Subject("nothing")


def test_a_camera_that_h_does_not_fit_is_said(plan: ScanPlan) -> None:
    H = PSFMatrix(np.ones((1, 3, 3, 201, 201), np.float32), camera=plan.camera, depths=[-2e4], anchor=plan.anchor)
    with pytest.raises(InputError, match="a camera that does not fit H"):
        _ = Subject.of_matrix(H, "H").planned


def test_a_sample_is_simulated_at_the_level_of_its_sampling() -> None:
    """For this plan, the fastest sampling of waves is that of a grid, which windows about lenslets cannot use."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=55)
    sample = drain(Subject("bench", plan, workers=1).iter_sample(1))
    assert "level grid" in sample.notes[0], sample.notes
