"""Cover glass: Snell's law against the transfer function, waves against the reference."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import LensType
from lfcal.simulate.effects import CoverGlass, ExactAngles, LensletGap
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, difference, responses, small_plan, switched
from tests.simulate.scenes import camera_scene, relative_error


@pytest.mark.few(3)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize("glass", [CoverGlass(10.0), CoverGlass(40.0, 1.8, 0.5)], ids=repr)
def test_estimate_is_honest(v: float, glass: CoverGlass) -> None:
    plan = small_plan(v)
    measured = switched(plan, glass)
    assert 0.5 * measured <= glass.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_the_transfer_function_refracts_by_snell() -> None:
    """The slope of its phase is where a ray lands that runs through air, and in the plate at asin(sin/n)."""
    gap, thick, index, lam = 300.0, 120.0, 1.6, 0.55
    n, dx = 4096, 0.4
    f = np.fft.fftfreq(n, dx)
    equivalent = gap - thick * (1 - 1 / index)
    step, _ = sensor_propagator(f[:400], lam, equivalent, True, (thick, index))
    phase = np.unwrap(np.angle(step[0]))  # along x, no frequency along y
    lands = -np.gradient(phase, f[1] - f[0]) / (2 * np.pi)
    for k in (50, 150, 300):
        sine = lam * f[k]
        tan, inside = math.tan(math.asin(sine)), math.tan(math.asin(sine / index))
        assert lands[k] == pytest.approx((gap - thick) * tan + thick * inside, rel=1e-4)
    assert lam * f[300] > 0.09


def test_rays_see_a_shorter_gap() -> None:
    plan = small_plan(4.0)
    shorter = 30.0 * (1 - 1 / 1.5)
    found, wanted = (responses(plan, (*BASE, e)) for e in (CoverGlass(30.0, 1.5), LensletGap(-shorter)))
    assert difference(found, wanted) < 1e-6
    held = responses(plan, (*BASE, CoverGlass(30.0, 1.5, 1.0)))
    assert difference(held, responses(plan, BASE)) < 1e-6, "the gap holds it, and paraxial light sees no more"
    by_rays = [responses(plan, (BASE[0], e)) for e in (CoverGlass(30.0, 1.5), LensletGap(-shorter))]
    assert difference(*by_rays) < 1e-6


def fast_scene(thickness: float) -> Scene:
    """Return lenslets of f/2.8 behind a cone of F/2.8, in focus."""
    scene = camera_scene(3.0, cutout=(45, 45), exact_rays=True, exact_defocus=True, f_number=2.8)
    gap = 0.56 * scene.gap_um
    lattice = replace(scene.lattice, types=(LensType.focused_at(3.0, gap),), gap_um=gap)
    return replace(scene, lattice=lattice, image_um=3 * gap, glass=(thickness, 1.52))


def test_waves_follow_the_plate_s_aberration() -> None:
    air, glass = fast_scene(0.0), fast_scene(200.0)
    wave = engine_for(glass, "wave", Sampling(None, 6, 14, coherent=True)).rows([3], [20])[0, 0]
    reference, plain = (engine_for(s, "reference", Sampling(8.0)).rows([3], [20])[0, 0] for s in (glass, air))
    effect = relative_error(plain, reference)
    assert effect > 0.04
    assert relative_error(wave, reference) < 0.5 * effect
    assert (
        relative_error(engine_for(air, "wave", Sampling(None, 6, 14, coherent=True)).rows([3], [20])[0, 0], plain)
        < 0.03
    )


def test_the_plate_comes_to_the_scene_of_exact_angles() -> None:
    scene = PlaneResponse(small_plan(), 0, (*BASE, ExactAngles(), CoverGlass(100.0, 1.5, 1.0))).scene
    assert scene.glass == (100.0, 1.5) and scene.exact_rays


def test_a_plate_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="cover glass") as error:
        PlaneResponse(small_plan(), 0, (*BASE, CoverGlass(500.0)))
    assert "\n" not in str(error.value)
