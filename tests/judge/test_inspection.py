"""What an inspection says of an H as a whole: faults beside metrics, and what it does not know."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.judge import Evidence, Inspection, iter_evidence, iter_inspection
from lfcal.judge.quality import inspect
from lfcal.psf import PSFMatrix
from tests.judge import common
from tests.judge.common import FEWEST, Values, added, clean, matrix, plan, sensor


def inspected(H: PSFMatrix, patterns: int | None = None) -> Inspection:
    return drain(iter_inspection(H, inspect(H, workers=1), patterns=patterns or common.PATTERNS))


def hot() -> Values:
    image = sensor(0.0)
    image[:, 25] = 60.0
    return added(clean(), image)


@cache
def inspected_hot() -> Inspection:
    return inspected(matrix(hot()), FEWEST)


def test_a_clean_recording_is_good() -> None:
    found = inspected(matrix(clean()))
    assert found.compared == common.PATTERNS and not found.faults and not found.bad
    assert found.verdict.startswith("This H is usable, but should be checked: light at the edge. "), "a small cutout"
    assert "show no fault" in found.verdict and "Assemble again with a larger cutout" in found.verdict


@pytest.mark.long
def test_a_fault_stands_for_the_metrics_that_it_looks_like() -> None:
    found = inspected_hot()
    assert found.bad and found.faults[0].name == "hot_line"
    assert found.verdict.startswith("This H should not be used as it is: hot line of the sensor")
    step = found.quality["stage_gain"]
    assert found.settled(step) is found.faults[0] and step not in found.alarms
    assert found.quality.redo() and not found.redo(), "no frame is recorded again for a line of the sensor"


def test_without_a_camera_it_says_that_metrics_are_weaker() -> None:
    found = inspected(PSFMatrix(clean()))
    assert not found.compared and found.why_not == "H has no camera"
    assert found.merit == found.quality.merit and "it was not compared with a camera (H has no camera)" in found.verdict


def test_a_camera_without_a_lattice_is_not_compared() -> None:
    patterns = np.random.default_rng(0).uniform(1, 2, (4, 1, 1, 21, 21)).astype(np.float32)
    H = PSFMatrix(patterns, depths=(-1.0, 0.0, 1.0, 2.0), camera=preset("flfm_20x05"), anchor=(500.0, 500.0))
    found = drain(iter_evidence(H))
    assert not isinstance(found, Evidence)
    assert found.reason == "only cameras with a lenslet lattice can be compared; lfcal fit compares this one"


@pytest.mark.long
def test_a_camera_that_does_not_explain_the_patterns_names_no_fault() -> None:
    camera = plan().camera
    lattice = replace(camera.lattice, gap_um=1.06 * camera.lattice.gap_um)
    other = PSFMatrix(clean(), depths=plan().depths_um, camera=replace(camera, lattice=lattice), anchor=plan().anchor)
    found = inspected(other, FEWEST)
    assert not found.faults and not found.compared and "lfcal fit" in found.verdict
    assert (
        found.merit != "good"
        and "the gap between lenslets and sensor differs from the description by about -5.7 %" in found.verdict
    )


def test_a_shift_of_the_anchor_is_no_traceback() -> None:
    H = PSFMatrix(clean(), depths=plan().depths_um, camera=plan().camera, anchor=(0.0, 0.0))
    assert "cutout of position" in inspected(H).why_not


def test_resampled_patterns_are_not_compared() -> None:
    H = matrix(clean())
    scaled = {"cutout": {"scale": [0.99, 0.99]}}
    other = PSFMatrix(H[:], depths=H.depths, camera=H.camera, anchor=H.anchor, provenance=scaled)
    assert "resampled pixels" in inspected(other).why_not


def test_patterns_that_stand_for_others_are_not_compared() -> None:
    H = matrix(clean())
    stand_ins = {"half_cell": {"positions": [[0, H.shape[1] * H.shape[2]]]}}  # all of plane 0
    other = PSFMatrix(H[:], depths=H.depths, camera=H.camera, anchor=H.anchor, provenance=stand_ins)
    found = drain(iter_evidence(other, patterns=common.PATTERNS))
    assert isinstance(found, Evidence) and set(found.index[:, 0].tolist()) == {1}


LONG = pytest.mark.long


@pytest.mark.parametrize("scale", [0.0, 1e-12, pytest.param(-1.0, marks=LONG), pytest.param(1e11, marks=LONG)])
def test_any_light_or_none_ends_in_words(scale: float) -> None:
    """Warnings are errors in tests: nothing is divided by no light."""
    found = inspected(matrix((scale * clean()).astype(np.float32)))
    if scale > 0:
        assert found.compared and not found.faults
    else:
        assert "no light" in found.why_not or "little in common" in found.why_not


@pytest.mark.parametrize("size", [1e30, 1e-30])
def test_values_whose_squares_are_no_numbers_end_in_words(size: float) -> None:
    """Warnings are errors in tests: float32 holds no variance of these."""
    noise = np.random.default_rng(0).standard_normal(clean().shape)
    found = inspected(matrix((size * noise).astype(np.float32)))
    assert not found.compared and "where 1e-12 to 1e+15 is expected" in found.why_not


def test_plain_values_of_everything() -> None:
    told = inspected_hot().to_dict()["model"]
    assert isinstance(told, dict) and told["faults"][0]["name"] == "hot_line"
    assert np.isfinite(told["faults"][0]["share"])
