"""A tolerance is kept, and a tighter one is never further off: over random cameras, near focus and far from it."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks._effect_scenes import random_plan
from lfcal.camera import ScanPlan, preset
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.accuracy.sampling import steps_for
from lfcal.simulate.effects import Effect, FiniteSource
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.plane_task import budgeted, tolerance_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.simulate import simulate_psf
from lfcal.simulate.staging import resolve_level, scene_for
from lfcal.simulate.volume import light_field
from tests.simulate.common import difference

TOLERANCES = (0.1, 0.03, 0.01)
QUICK = (8, 13)
"""Scenes that CI judges: all kinds of errors of build in a few seconds each; a microscope's reference takes minutes."""

CAMERAS = [
    pytest.param(number, marks=() if number in QUICK else (pytest.mark.long,), id=f"camera{number}")
    for number in range(40)
]


def finest(plan: ScanPlan, effects: tuple[Effect, ...], ys: list[int], xs: list[int]) -> object:
    """Return responses by the coherent reference; on the separable path of a microscope by many nodes."""
    scene, level = resolve_level(scene_for(plan, 0, effects))
    if steps_for(scene, level)[0].level == "debye":
        return PlaneResponse(plan, 0, effects, sampling=Sampling(nodes_per_px=7)).rows(ys, xs)
    sampling = steps_for(scene, "reference")[2].sampling
    return PlaneResponse(plan, 0, effects, level="reference", sampling=sampling).rows(ys, xs)


def test_a_selection_of_effects_brings_its_tolerance() -> None:
    """Where none is named: the library took 3 % whatever the selection was made for."""
    camera = preset("bench")
    plan = ScanPlan(camera, (2, 3), cutout=(41, 41), depths_um=(camera.depth_of(4.0),), anchor=(160, 160))
    found = plan_effects(plan, 0.01)
    by_itself, named, coarse = (simulate_psf(plan, found, tolerance=t) for t in (None, 0.01, 0.1))
    np.testing.assert_array_equal(by_itself[:], named[:])
    assert by_itself.facts.error[0] == named.facts.error[0] <= 0.01 < coarse.facts.error[0]
    assert by_itself.provenance["simulated"]["tolerance"] == 0.01
    assert simulate_psf(plan, found.effects).provenance["simulated"]["tolerance"] == 0.03
    assert SimulatedCamera(plan, found).tolerance == 0.01 and SimulatedCamera(plan).tolerance == 0.03
    assert tolerance_for(found, 0.1) == 0.1
    volume = np.zeros((1, 9, 9), np.float32)
    volume[0, 4, 4] = 1
    np.testing.assert_array_equal(light_field(volume, plan, effects=found), light_field(volume, named))


@pytest.mark.few(1)
@pytest.mark.parametrize("number", CAMERAS)
def test_a_tighter_tolerance_is_never_further_off(number: int) -> None:
    plan, given = random_plan(number)
    # one wavelength and a point: what they add is a sum of the same, and takes many times as long
    known = tuple(e for e in given if not isinstance(e, FiniteSource))
    ny, nx = plan.period
    ys, xs = [ny // 3], [nx // 5, (4 * nx) // 7]
    everything = plan_effects(plan, 1e-9, {"bandwidth": "off"}, effects=known)
    truth = finest(plan, everything.effects, ys, xs)
    errors = []
    for tolerance in TOLERANCES:
        found = plan_effects(plan, tolerance, {"bandwidth": "off"}, effects=known)
        chosen, share = budgeted(found, plan, tolerance).at(plan.depths_um[0])
        response = PlaneResponse(plan, 0, chosen, tolerance=share)
        errors.append(difference(response.rows(ys, xs), truth))  # type: ignore[arg-type]
        # four positions settle a plane, and estimates hold within 2: two others may lie above by so much
        assert errors[-1] <= 1.3 * tolerance or response.reached > share, (tolerance, errors)
    for loose, tight, tolerance in zip(errors, errors[1:], TOLERANCES[1:], strict=False):
        assert tight <= loose + 0.1 * tolerance, errors
