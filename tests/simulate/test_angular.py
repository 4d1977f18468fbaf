"""Pixels' response to angles: the reference filters the angular spectrum, the other levels by rays."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.simulate._symmetry import is_mirror_symmetric
from lfcal.simulate.effects import AngularResponse
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.microscope import DebyePlane, debye_plane
from lfcal.simulate.scene import pixel_response
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import small_camera, small_plan, switched
from tests.simulate.scenes import camera_scene, microscope_scene, relative_error

OBLIQUE = (10.0, 0.1, -0.2)


def edge_plan(v: float) -> ScanPlan:
    return small_plan(v, small_camera(160, 3000), anchor=(70.0, 2800.0))


@pytest.mark.parametrize(
    ("v", "edge"),
    [
        (4.0, True),
        (0.5, False),
        *(pytest.param(v, edge, marks=pytest.mark.long) for v in (-3.0, 2.2) for edge in (False, True)),
        pytest.param(4.0, False, marks=pytest.mark.long),
        pytest.param(0.5, True, marks=pytest.mark.long),
    ],
)
def test_estimate_is_honest(v: float, edge: bool) -> None:
    plan, effect = (edge_plan if edge else small_plan)(v), AngularResponse(math.radians(15))
    measured = switched(plan, effect)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_the_response_is_half_at_its_angle() -> None:
    effect = AngularResponse(math.radians(20))
    sines = np.sin(np.radians([0.0, 20.0, 14.142]))
    assert pixel_response(effect.power, sines, 0.0)[:2] == pytest.approx([1.0, 0.5])
    assert pixel_response(effect.power, 0.6, 0.9) == 0, "there is no such ray"
    outlook = outlook_of(edge_plan(4.0), 0)
    b = outlook.camera.optics.image_distance_um  # type: ignore[union-attr]
    assert effect.slope(outlook)[1] == pytest.approx(math.sin(math.atan(outlook.field_um[1] / b)), rel=1e-4)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("v", "accept", "share"),
    [
        (3.0, OBLIQUE, 0.05),
        (0.4, OBLIQUE, 0.08),
        pytest.param(3.0, (10.0, 0.0, 0.0), 0.15, marks=pytest.mark.long),
        pytest.param(-3.0, OBLIQUE, 0.05, marks=pytest.mark.long),
    ],
)
def test_waves_lose_what_the_angular_spectrum_does(v: float, accept: tuple[float, float, float], share: float) -> None:
    """Of the effect at most ``share`` is missed: most near the native plane, where one lenslet stands for all."""
    scene = camera_scene(v, cutout=(41, 41), accept=accept)
    plain, seen = (
        engine_for(s, "reference", Sampling(6.0)).rows([3], [20])[0, 0]
        for s in (replace(scene, accept=(0, 0, 0)), scene)
    )
    wave = engine_for(scene, "wave", Sampling(None, 5, 14, coherent=True)).rows([3], [20])[0, 0]
    effect = relative_error(plain, seen)
    assert effect > 0.03
    assert relative_error(wave, seen) < share * effect + 0.004


@pytest.mark.parametrize("v", [3.0, pytest.param(0.4, marks=pytest.mark.long)])
def test_rays_lose_as_much_light(v: float) -> None:
    scene = camera_scene(v, cutout=(41, 41), accept=OBLIQUE)
    without = replace(scene, accept=(0.0, 0.0, 0.0))
    rays, waves = (
        [float(engine_for(s, level, sampling).rows([3], [18, 20]).sum()) for s in (scene, without)]
        for level, sampling in (("geometric", Sampling()), ("wave", Sampling(None, 4, 8)))
    )
    assert rays[0] / rays[1] == pytest.approx(waves[0] / waves[1], abs=0.03)
    assert rays[0] / rays[1] < 0.85


@pytest.mark.long
def test_cells_and_exact_rays_are_weighed_too() -> None:
    scene = camera_scene(3.0, cutout=(41, 41), accept=OBLIQUE, aperture="cell", exact_rays=True, exact_defocus=True)
    wave = engine_for(scene, "wave", Sampling(None, 5, 14, coherent=True)).rows([3], [20])[0, 0]
    reference = engine_for(scene, "reference", Sampling(6.0)).rows([3], [20])[0, 0]
    assert relative_error(wave, reference) < 0.03


def test_an_oblique_chief_ray_breaks_the_mirror_and_the_separable_path() -> None:
    lattice = camera_scene().lattice
    upright = camera_scene(iris=replace(camera_scene().iris, blades=0), lattice=lattice)
    assert is_mirror_symmetric(replace(upright, accept=(5.0, 0.0, 0.1)))
    assert not is_mirror_symmetric(replace(upright, accept=(5.0, 0.1, 0.0)))
    scene = microscope_scene(8.0, cutout=(21, 21), accept=(5.0, 0.0, 0.0))
    assert not isinstance(debye_plane(scene), DebyePlane)


def test_angles_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="half_angle_rad"):
        AngularResponse(1.6)
