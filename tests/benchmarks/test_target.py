"""H of a target's frames is judged by the truth, which shares none of the fit's simplifications."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks import target
from benchmarks._target_scene import target_scene
from benchmarks.target import compared, error_of, single_error
from lfcal.fit.model import Fineness
from lfcal.fit.setup import Setup
from lfcal.simulate.effects import Distortion, FiniteSource, MechanicalVignetting, ReadNoise, ShotNoise
from tests.benchmarks.conftest import Bench


def test_the_scene_has_every_difficulty_of_a_fit() -> None:
    scene = target_scene(5)
    camera = scene.camera()
    kinds = {type(effect) for effect in camera.single.effects} | {FiniteSource}
    assert {MechanicalVignetting, Distortion, ShotNoise, ReadNoise, FiniteSource} <= kinds
    assert camera.shape == (720, 720) and camera.target.hole_um == 20.0 and len(camera.target.holes) == 141
    assert np.degrees([scene.really.pose.rotation_rad, scene.really.pose.tilt_right_rad]) == pytest.approx([1.0, 2.0])
    assert camera.brightness.std() == pytest.approx(0.1, rel=0.2)
    # a user knows another camera, another cat's eye, and a target without tilt
    assert scene.plan.target.pose != scene.really.pose and scene.plan.scan.camera != scene.truth.setup.camera
    # finer than the derivatives of a fit, and no part of the field is one
    assert camera.single.sampling.samples_per_px > Fineness.coarse.samples_per_px
    assert camera._side < 720 / 3
    assert len(scene.plan_of(3).frames) == 3 and scene.plan_of(3).offsets_px[0] == scene.plan.offsets_px[0][:3]
    assert target_scene(3).plan.offsets_px[0] == scene.plan.offsets_px[0][:3], "fewer frames are the first ones"


def test_errors_are_those_of_what_is_measured() -> None:
    scene = target_scene(1)
    _, true = scene.true_patterns(scene.plan.scan)
    assert error_of(3.0 * true, true) < 1e-12
    assert error_of(true + 0.01 * true.mean(), true) > 0.001
    # less light, more noise: by the root of it, and where it is read by all of it
    bright, dim = (single_error(scene, electrons) for electrons in (4e6, 1e6))
    assert 2.0 < dim / bright < 4.0


def test_the_true_camera_of_the_scene_is_a_setup(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference patterns are those of the true camera with its cat's eye, of point sources in the plane."""
    scene = target_scene(1)
    seen: list[Setup] = []
    monkeypatch.setattr("benchmarks._target_scene.predicted", lambda setup, *_: seen.append(setup))
    scene.true_light(scene.plan.scan, np.zeros((1, 3), np.intp))
    (setup,) = seen
    assert setup.effect(MechanicalVignetting) == MechanicalVignetting(32e3, 1.03)
    assert setup.effect(FiniteSource) is None and setup.camera == scene.truth.setup.camera


RESULT: dict[str, Any] = {
    "holes": 141,
    "frames": 8,
    "few_frames": 2,
    "positions": 627,
    "single_error": 0.0788,
    "described": 0.57,
    "few": {"centre": 0.003, "worst": 0.012, "chi2": 1.14, "seconds": 9.0, "parts": {"part-0-0": 0.012}},
    "many": {"centre": 0.002, "chi2": 1.1, "seconds": 12.0},
    "modulo": {"camera_chi2": 44.0, "refused": True, "chi2": None, "says": "no such camera", "seconds": 1.0},
}


def test_the_options_of_the_command_are_used(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def answer(*arguments: Any, **named: Any) -> dict[str, Any]:
        asked.append((arguments, named))
        return RESULT

    monkeypatch.setattr(target, "compared", answer)
    words = "target --frames 8 --few 2 --points 27 --unknowns geometry,iris --seed 3 --as-described --workers 1"
    shown = bench(*words.split())
    ((frames, few, way), named), *_ = asked
    assert (frames, few, named) == (8, 2, {"seed": 3, "wrong": False})
    assert way == target.Way(27, ("geometry", "iris"), 1, quiet=False)
    for one in ("7.88 %", "0.20 %", "1.20 %", "44.00, refused", "part-0-0", "no such camera", "57.00 %"):
        assert one in shown, one
    assert bench.json("target", "--unknowns", "auto") == RESULT
    assert asked[-1][0][2] == target.Way(unknowns="auto", quiet=True)


@pytest.mark.long
def test_three_frames_of_a_target_are_worth_more_than_a_scan_of_a_single_point() -> None:
    found = compared(3, 3)
    assert found["few"]["worst"] <= 0.015, found["few"]
    assert len(found["few"]["parts"]) == 9
    # of three frames already, and so of thirty
    assert found["few"]["centre"] <= found["single_error"]
    assert found["modulo"]["refused"] and found["modulo"]["camera_chi2"] > 10 * found["few"]["chi2"], found["modulo"]
