"""Colour: foci by a catalogue glass, images by other depths, and wavelengths that are spread wherever it is on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera
from lfcal.simulate import plan_effects
from lfcal.simulate.effects import Bandwidth, ChromaticFocus, Effect, LensletDispersion, LensTypeDefocus
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse, at_wavelength
from lfcal.simulate.staging import light_samples, outlook_of
from tests.simulate.common import BASE, FAST, difference, responses, small_camera, small_plan
from tests.simulate.scenes import microscope_scene


def wide(width: float = 0.1) -> Camera:
    return replace(small_camera(), bandwidth_um=width)


@pytest.mark.long
@pytest.mark.parametrize("v", [4.0, *(pytest.param(v, marks=pytest.mark.long) for v in (-3.0, 2.2, 0.5))])
@pytest.mark.parametrize("effect", [ChromaticFocus(800.0, 0.1), LensletDispersion(10.0, 0.2)])
@pytest.mark.few(1)
def test_estimate_is_honest(v: float, effect: Effect) -> None:
    """Against the same wavelengths, imaged alike."""
    plan, sampling = small_plan(v), Sampling(None, 4, 6, coherent=False)
    on, off = (PlaneResponse(plan, 0, effects, sampling=sampling) for effects in ((*BASE, effect), BASE))
    off.samples = on.samples
    measured = difference(off.rows([4], [5]), on.rows([4], [5]))
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_focal_lengths_are_those_of_a_catalogue_glass() -> None:
    """N-BK7 by its Sellmeier equation (Schott), described to the effect by its Abbe number alone."""

    def index(lam: float) -> float:
        b, c = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
        return math.sqrt(1 + sum(bk * lam**2 / (lam**2 - ck) for bk, ck in zip(b, c, strict=True)))

    scene = PlaneResponse(small_plan(), 0, (LensTypeDefocus(), LensletDispersion(64.17, 0.2))).scene
    for lam in (0.48, 0.52, 0.6, 0.65):
        for kind, other in zip(scene.lattice.types, at_wavelength(scene, lam).lattice.types, strict=True):
            exact = (index(scene.wavelength_um) - 1) / (index(lam) - 1)
            assert other.focal_length_um / kind.focal_length_um == pytest.approx(exact, rel=5e-4)
    assert at_wavelength(scene, scene.wavelength_um) == scene


def test_each_wavelength_is_seen_at_its_own_depth() -> None:
    """By rays, which else do not depend on the wavelength: a sum over planes, weighted by Gauss and Legendre."""
    camera = wide()
    plan, rate = small_plan(4.0, camera, cutout=41), 2000.0
    found = PlaneResponse(plan, 0, (LensTypeDefocus(), ChromaticFocus(rate)))
    assert found.level == "geometric" and found.runs > 2
    nodes, weights = np.polynomial.legendre.leggauss(found.runs)
    wanted = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        v = 4.0 + rate * 0.05 * node / camera.lattice.gap_um
        wanted = wanted + weight / 2 * responses(small_plan(v, camera, cutout=41), (LensTypeDefocus(),))
    assert difference(responses(plan, (LensTypeDefocus(), ChromaticFocus(rate))), wanted) < 1e-4


def test_a_microscope_s_image_moves_by_its_depth() -> None:
    scene = microscope_scene(5.0, colour_rate=4000.0)
    moved = at_wavelength(scene, scene.wavelength_um + 0.1)
    assert moved.image_um - scene.image_um == pytest.approx(400.0)
    assert moved.z_um - scene.z_um == pytest.approx(-1.0), "M² = 400 times less, the other way"


def test_wavelengths_are_spread_with_bandwidth_left_out() -> None:
    outlook = outlook_of(small_plan(4.0, wide()), 0)
    colour = ChromaticFocus(500.0)
    alone = light_samples((colour,), outlook)
    assert len(alone) >= 3 and sum(s.weight for s in alone) == pytest.approx(1)
    assert np.ptp([s.wavelength_um for s in alone]) > 0.05
    assert light_samples((colour, Bandwidth()), outlook) == alone, "once, not twice"
    assert len(light_samples((ChromaticFocus(2e4), Bandwidth()), outlook)) > len(alone), "a wide blur takes more"
    given = light_samples((ChromaticFocus(500.0, 0.02),), outlook)
    assert np.ptp([s.wavelength_um for s in given]) < 0.02
    assert len(light_samples((), outlook)) == 1


def test_monochromatic_light_has_no_colour() -> None:
    plan = small_plan(4.0, wide(0.0))
    for effect in (ChromaticFocus(), LensletDispersion(), ChromaticFocus(0.0, 0.1)):
        response = PlaneResponse(plan, 0, (*BASE, effect), sampling=FAST)
        assert response.runs == 1 and response.scene == PlaneResponse(plan, 0, BASE, sampling=FAST).scene
        assert effect.estimate(outlook_of(plan, 0)).error == 0


def test_the_planner_takes_the_width_that_is_given() -> None:
    plan = small_plan(4.0, wide(0.01))
    plain = plan_effects(plan, 0.2)
    assert not plain.row("bandwidth").on
    found = plan_effects(plan, 0.2, effects=(ChromaticFocus(5e4), Bandwidth(0.02)))
    assert found.row("chromatic_focus").on and found.row("bandwidth").on
    assert "needed by longitudinal colour" in found.row("bandwidth").reason
    assert found.left_out[0] <= 0.1 and found.seconds > 2 * plain.seconds


def test_an_image_before_the_lens_is_refused() -> None:
    with pytest.raises(InputError, match="longitudinal colour") as error:
        PlaneResponse(small_plan(), 0, (*BASE, ChromaticFocus(1e8, 0.1)))
    assert "\n" not in str(error.value)
