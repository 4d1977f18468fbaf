"""What an inspection reports of an H as a whole: faults, metrics, and what it cannot know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.judge import Evidence, iter_evidence
from lfcal.judge._scatter import misfit, variance_of
from lfcal.psf import PSFMatrix
from tests.judge import common
from tests.judge.common import FEWEST, added, clean, inspected, matrix, plan, sensor


def test_a_clean_recording_is_good() -> None:
    found = inspected(matrix(clean()))
    assert found.compared == common.PATTERNS and not found.faults and not found.bad
    assert found.verdict.startswith("This H is usable, but should be checked: light at the edge. "), "a small cutout"
    assert "show no fault" in found.verdict and "Assemble again with a larger cutout" in found.verdict


@pytest.mark.long
def test_a_fault_explains_the_metrics_that_it_looks_like() -> None:
    image = sensor(0.0)
    image[:, 25] = 60.0
    found = inspected(matrix(added(clean(), image)), FEWEST)
    assert found.bad and found.faults[0].name == "hot_line"
    assert found.verdict.startswith("This H should not be used as it is: hot line of the sensor")
    step = found.quality["stage_gain"]
    assert found.settled(step) is found.faults[0] and step not in found.alarms
    assert found.quality.redo() and not found.redo(), "no frame is recorded again for a line of the sensor"
    model = found.to_dict()["model"]
    assert model["faults"][0]["name"] == "hot_line" and np.isfinite(model["faults"][0]["share"])


def test_an_h_that_cannot_be_compared_is_judged_by_metrics_with_the_reason() -> None:
    found = inspected(PSFMatrix(clean()))
    assert not found.compared and found.why_not == "H has no camera"
    assert found.merit == found.quality.merit and "it was not compared with a camera (H has no camera)" in found.verdict
    patterns = np.random.default_rng(0).uniform(1, 2, (4, 1, 1, 21, 21)).astype(np.float32)
    flat = PSFMatrix(patterns, depths=(-1.0, 0.0, 1.0, 2.0), camera=preset("flfm_20x05"), anchor=(500.0, 500.0))
    H, known = matrix(clean()), {"depths": plan().depths_um, "camera": plan().camera}
    scaled = {"cutout": {"scale": [0.99, 0.99]}}
    for other, reason in (
        (flat, "only cameras with a lenslet lattice can be compared; lfcal fit compares this one"),
        (PSFMatrix(clean(), **known, anchor=(0.0, 0.0)), "cutout of position"),
        (PSFMatrix(H[:], **known, anchor=H.anchor, provenance=scaled), "resampled pixels"),
    ):
        unlike = drain(iter_evidence(other))
        assert not isinstance(unlike, Evidence) and reason in unlike.reason


@pytest.mark.long
def test_a_camera_that_does_not_explain_the_patterns_names_no_fault() -> None:
    camera = plan().camera
    lattice = replace(camera.lattice, gap_um=1.06 * camera.lattice.gap_um)
    other = PSFMatrix(clean(), depths=plan().depths_um, camera=replace(camera, lattice=lattice), anchor=plan().anchor)
    found = inspected(other, FEWEST)
    assert not found.faults and not found.compared and found.merit != "good" and "lfcal fit" in found.verdict
    assert "the gap between lenslets and sensor differs from the description by about -5.7 %" in found.verdict


def test_patterns_derived_from_others_are_not_compared() -> None:
    H = matrix(clean())
    derived = {"half_cell": {"positions": [[0, H.shape[1] * H.shape[2]]]}}  # all of plane 0
    other = PSFMatrix(H[:], depths=H.depths, camera=H.camera, anchor=H.anchor, provenance=derived)
    found = drain(iter_evidence(other, patterns=FEWEST))
    assert isinstance(found, Evidence) and set(found.index[:, 0].tolist()) == {1}


@pytest.mark.parametrize(
    "scale", [0.0, 1e-12, pytest.param(-1.0, marks=pytest.mark.long), pytest.param(1e11, marks=pytest.mark.long)]
)
def test_any_light_or_none_ends_in_words(scale: float) -> None:
    """Warnings are errors in tests: nothing is divided by no light."""
    found = inspected(matrix((scale * clean()).astype(np.float32)))
    if scale > 0:
        assert found.compared and not found.faults
    else:
        assert "no light" in found.why_not or "little in common" in found.why_not


def test_values_whose_squares_overflow_end_in_words() -> None:
    """Warnings are errors in tests: float32 holds no variance of these."""
    noise = np.random.default_rng(0).standard_normal(clean().shape)
    for size in (1e30, 1e-30):
        found = inspected(matrix((size * noise).astype(np.float32)))
        assert not found.compared and "where 1e-12 to 1e+15 is expected" in found.why_not, size


# -- the share of the light that a camera leaves unexplained ---------------------------------------------
LIGHT = np.full((6, 5, 5), 100.0, np.float32)
SEEN = np.ones(LIGHT.shape, np.bool_)
NOISE = np.ones_like(LIGHT)


def test_the_misfit_is_that_of_the_valid_patterns_without_noise() -> None:
    left, valid = 0.2 * LIGHT, SEEN.copy()
    valid[:4] = False
    assert misfit(left, LIGHT, valid, 0 * NOISE) == pytest.approx(0.2)
    assert misfit(left, LIGHT, ~SEEN, NOISE) == 0.0
    assert misfit(1e3 * LIGHT, 0 * LIGHT, SEEN, NOISE) == 1.0, "without expected light nothing is explained"
    noise = np.random.default_rng(0).standard_normal(LIGHT.shape).astype(np.float32)
    assert misfit(noise, LIGHT, SEEN, NOISE) < 0.01


def test_noise_of_photons_is_no_misfit_and_errors_of_the_model_are_no_noise() -> None:
    """Noise that grows with the light, and an error of the model of 10 % of the light that grows faster."""
    rng = np.random.default_rng(3)
    light = (1000 * rng.random((20, 40, 40)) ** 4).astype(np.float32)
    seen = np.ones(light.shape, np.bool_)
    photons = (np.sqrt(4 + 2 * light) * rng.standard_normal(light.shape)).astype(np.float32)
    wrong = (0.1 * light * np.where(rng.random(light.shape) < 0.5, -1, 1)).astype(np.float32)
    for left, least, most in ((photons, 0.0, 0.03), (photons + wrong, 0.09, 0.11)):
        _, constant, slope = variance_of(left, light, seen)
        assert slope == pytest.approx(2, rel=0.25)
        assert least <= misfit(left, light, seen, constant + np.float32(slope) * light) < most
