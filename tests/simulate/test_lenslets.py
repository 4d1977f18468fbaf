"""Aberrated and defective lenslets, in every engine that shows them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.simulate import plan_effects
from lfcal.simulate.effects import Effect, LensletSpherical, MissingLenslets
from lfcal.simulate.effects.described import parse_effects
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.microscope import DebyePlane, debye_plane
from lfcal.simulate.response import PlaneResponse, at_wavelength
from lfcal.simulate.scene import PupilIris, Scene
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, FAST, difference, small_camera, small_plan, switched
from tests.simulate.scenes import camera_scene, microscope_scene, relative_error


@pytest.mark.few(3)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize("lenslets", [((0, 0, 0.0),), ((1, 0, 0.5), (0, 1, 0.2))])
def test_estimate_is_honest(v: float, lenslets: Any) -> None:
    plan, effect = small_plan(v, small_camera(200, 200)), MissingLenslets(lenslets)
    # near the native plane a source lights one lenslet or another: many positions make the mean
    ys, xs = (np.arange(1, n, 3) for n in plan.period)
    without, with_it = (PlaneResponse(plan, 0, (*BASE, *e), sampling=FAST).rows(ys, xs) for e in ((), (effect,)))
    measured = difference(without, with_it)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


@pytest.mark.few(4)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize("waves", [0.05, -0.25, 1.0])
def test_estimate_of_aberrated_lenslets(v: float, waves: float) -> None:
    plan, effect = small_plan(v), LensletSpherical(waves)
    measured = switched(plan, effect)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def one_lens(scene: Scene, row: int, column: int) -> Scene:
    """Return the scene in which all lenslets about the source but one are opaque."""
    others = [(r, q, 0.0) for r in range(-9, 10) for q in range(-9, 10) if (r, q) != (row, column)]
    return replace(scene, defects=tuple(others))


ENGINES = {
    "geometric": Sampling(),
    "wave": Sampling(4, 4, 8, coherent=False),
}


@pytest.mark.few(2)
@pytest.mark.parametrize("level", sorted(ENGINES))
@pytest.mark.parametrize("aperture", ["circle", "cell"])
def test_what_a_lenslet_does_not_pass_is_what_it_would_have_made(level: str, aperture: str) -> None:
    """The lenslet is found by its place: light beside its own micro-image stays as it is."""
    scene = camera_scene(3.0, cutout=(45, 45), aperture=aperture)
    scene = replace(scene, lattice=replace(scene.lattice, types=scene.lattice.types[1:2]))

    def seen(one: Scene) -> np.ndarray:
        return engine_for(one, level, ENGINES[level]).rows([2], [3])[0, 0].astype(float)

    whole, alone = seen(scene), seen(one_lens(scene, 1, -1))
    x, y = scene.lattice.centres_um(-1, 1)
    # its light lies a third of the way from the lenslet to the source
    row, column = (22 + (v - s) * 2 / 3 for v, s in ((y / scene.pixel_um, 2), (x / scene.pixel_um, 3)))
    brightest = np.unravel_index(int(alone.argmax()), alone.shape)
    assert np.hypot(brightest[0] - row, brightest[1] - column) < 6
    for passed in (0.0, 0.3):
        found = seen(replace(scene, defects=((1, -1, passed),)))
        assert relative_error(found, whole - (1 - passed) * alone) < 1e-4
    assert 0.02 < alone.sum() / whole.sum() < 0.3


def test_fields_are_as_much_weaker_as_the_light() -> None:
    """Coherent engines against each other: a quarter of the light is half the field."""
    scene = camera_scene(3.0, cutout=(45, 45), defects=((0, 0, 0.0), (1, -1, 0.25)))
    wave = engine_for(scene, "wave", Sampling(4, 4, 14, coherent=True)).rows([2], [3])[0, 0]
    reference = engine_for(scene, "reference", Sampling(6.0)).rows([2], [3])[0, 0]
    plain = engine_for(replace(scene, defects=()), "reference", Sampling(6.0)).rows([2], [3])[0, 0]
    assert relative_error(wave, reference) < 0.02
    assert relative_error(plain, reference) > 0.2


@pytest.mark.long
def test_the_microscope_takes_the_path_over_lenslets() -> None:
    scene = microscope_scene(8.0, cutout=(21, 21))
    defect = replace(scene, defects=((0, 0, 0.0), (0, 1, 0.5)))
    assert isinstance(debye_plane(scene), DebyePlane) and not isinstance(debye_plane(defect), DebyePlane)
    found = debye_plane(defect, Sampling(nodes_per_px=3)).rows([4], [4])[0, 0]
    reference = engine_for(defect, "reference", Sampling(4.0)).rows([4], [4])[0, 0]
    plain = engine_for(scene, "reference", Sampling(4.0)).rows([4], [4])[0, 0]
    assert relative_error(found, reference) < 0.2 * relative_error(plain, reference)


def test_rows_are_not_mirrored_about_a_defective_lenslet() -> None:
    lattice = replace(camera_scene().lattice, rotation_rad=0.0)
    scene = camera_scene(3.0, cutout=(45, 45), iris=PupilIris(), lattice=lattice)
    defect = replace(scene, defects=((1, 0, 0.0),))
    for one, mirrored in ((scene, True), (defect, False)):
        engine = engine_for(one, "wave", Sampling(3, 4, 4, coherent=False))
        up, down = engine.rows([2, -2], [3])[:, 0]
        alone = engine.rows([-2], [3])[0, 0]
        assert relative_error(down, alone) < 1e-4
        assert (relative_error(up[::-1], down) < 0.01) == mirrored


def test_white_frames_show_the_defective_lenslets_once() -> None:
    plan = small_plan(4.0, small_camera(120, 120))
    effects: tuple[Effect, ...] = BASE[:1]
    frames = [
        SimulatedCamera(plan, (*effects, *more), sampling=FAST).white_frame().astype(float)
        for more in ((), (MissingLenslets(((1, 0, 0.25),)),))
    ]
    ratio = (frames[1] - plan.camera.sensor.black_level) / (frames[0] - plan.camera.sensor.black_level).clip(1e-9)
    dark = ratio < 0.9
    cell = plan.camera.pitch_px * plan.camera.lattice.row_step_um / plan.camera.sensor.pixel_um
    assert 0.5 * cell < dark.sum() < 1.2 * cell
    first = np.array(plan.anchor) - plan.lattice_anchor
    b = plan.camera.lattice.basis_um()[1] / plan.camera.sensor.pixel_um
    assert np.hypot(*(np.argwhere(dark).mean(0) - first - b[::-1])) < 1


@pytest.mark.parametrize("bad", [((0.5, 0, 0.0),), ((0, 0, 1.5),), ((0, 0, math.nan),), ((0, 0),), (3,)])
def test_what_is_no_lenslet_is_refused(bad: Any) -> None:
    with pytest.raises(InputError, match="defective lenslets"):
        MissingLenslets(bad)


def test_lenslets_in_words() -> None:
    _, (found,) = parse_effects(["missing_lenslets=0,1,0;-2,0,30e-2"])
    assert found == MissingLenslets(((0, 1, 0.0), (-2, 0, 0.3)))
    with pytest.raises(InputError, match="triples"):
        parse_effects(["missing_lenslets=0.5,1,0"])
    with pytest.raises(InputError, match="row,column,transmission"):
        parse_effects(["missing_lenslets=0,1"])


# -- spherical aberration ------------------------------------------------------------------------------------


def one_type(**changes: Any) -> Scene:
    scene = camera_scene(3.0, cutout=(41, 41), **changes)
    return replace(scene, lattice=replace(scene.lattice, types=scene.lattice.types[1:2]))


@pytest.mark.parametrize("aperture", ["circle", "cell"])
@pytest.mark.parametrize("waves", [pytest.param(0.25, marks=pytest.mark.long), -1.0])
@pytest.mark.few(1)
def test_aberrated_lenslets_are_those_of_the_reference(aperture: str, waves: float) -> None:
    scene = one_type(aperture=aperture, lenslet_waves=waves)
    wave = engine_for(scene, "wave", Sampling(None, 6, 14, coherent=True)).rows([3], [20])[0, 0]
    reference, plain = (
        engine_for(s, "reference", Sampling(6.0)).rows([3], [20])[0, 0]
        for s in (scene, replace(scene, lenslet_waves=0))
    )
    assert relative_error(wave, reference) < 0.01
    assert relative_error(plain, reference) > 0.2


def test_the_rim_s_rays_land_where_the_wavefront_s_slope_sends_them() -> None:
    """In focus, W (r/R)^4 sends the ray at r to 4 W lambda B r³/R^4: a share q of the light goes within q^(3/2)."""
    waves = 4.0
    scene = one_lens(one_type(lenslet_waves=waves), 0, 0)
    image = engine_for(scene, "wave", Sampling(None, 6, 14)).rows([0], [0])[0, 0].astype(float)
    rim = 4 * waves * scene.wavelength_um * scene.gap_um / scene.clear_radius_um / scene.pixel_um
    assert rim > 10
    y, x = np.indices(image.shape) - 20
    r = np.hypot(y, x)
    within = [image[r < share * rim].sum() / image.sum() for share in (0.35, 1.05)]
    assert within[0] == pytest.approx(0.35 ** (2 / 3), abs=0.06) and within[1] > 0.98


def test_aberrated_lenslets_keep_their_glass_in_other_light() -> None:
    scene = one_type(lenslet_waves=0.5)
    assert at_wavelength(scene, scene.wavelength_um / 2).lenslet_waves == pytest.approx(1.0)
    assert not isinstance(debye_plane(microscope_scene(lenslet_waves=0.5)), DebyePlane)


@pytest.mark.few(1)
@pytest.mark.parametrize("level", ["wave", "grid"])
def test_each_lens_type_has_its_own_aberration(level: str) -> None:
    """Of one lens type alone: its light is that of an array in which all lenslets are aberrated as it is."""
    scene = camera_scene(3.0, cutout=(41, 41))
    own = (0.4, -0.3, 0.0)
    sampling = Sampling(None, 4, 14, coherent=True) if level == "wave" else Sampling(6.0)
    centres, kinds = scene.lattice.lenslets_within(600.0, 600.0, (0.0, 0.0))
    index = np.rint(scene.lattice.lenslet_at(centres)).astype(int)
    for kind in range(3):
        dark = tuple((int(r), int(q), 0.0) for (q, r), k in zip(index, kinds, strict=True) if k != kind)
        typed = replace(scene, defects=dark, lenslet_waves=0.1, type_waves=own)
        alike = replace(scene, defects=dark, lenslet_waves=0.1 + own[kind])
        found, wanted, plain = (
            engine_for(one, level, sampling).rows([3], [20])[0, 0]
            for one in (typed, alike, replace(scene, defects=dark))
        )
        assert relative_error(found, wanted) < 2e-3
        assert relative_error(plain, wanted) > 0.02


@pytest.mark.long
def test_aberrations_of_lens_types_are_those_of_the_reference() -> None:
    scene = camera_scene(3.0, cutout=(41, 41), type_waves=(0.4, -0.3, 0.0))
    grid = engine_for(scene, "grid", Sampling(8.0)).rows([3], [20])[0, 0]
    reference = engine_for(scene, "reference", Sampling(8.0)).rows([3], [20])[0, 0]
    assert relative_error(grid, reference) < 0.01


def test_aberrations_of_lens_types_are_one_a_type() -> None:
    plan, camera = small_plan(cutout=31), small_camera()
    alike = replace(camera, lattice=replace(camera.lattice, types=camera.lattice.types[:1]))
    one = small_plan(camera=alike, cutout=31)
    with pytest.raises(InputError, match="lens type: expected a number below 1, got 2"):
        PlaneResponse(one, 0, (*BASE, LensletSpherical(0.0, type_2=0.1)))
    with pytest.raises(InputError, match="expected 3 values, one for each lens type"):
        camera_scene(type_waves=(0.1,))
    with pytest.raises(InputError, match="type_1"):
        LensletSpherical(type_1=math.inf)
    response = PlaneResponse(plan, 0, (*BASE, LensletSpherical(0.25), LensletSpherical(0.0, 0.1, 0.0, -0.1)))
    assert response.scene.lenslet_waves == 0.25 and response.scene.type_waves == (0.1, 0.0, -0.1)
    assert at_wavelength(response.scene, response.scene.wavelength_um / 2).type_waves == pytest.approx((0.2, 0, -0.2))
    (found,) = parse_effects(["lenslet_spherical=0.1,type_1:0.2"])[1]
    assert found == LensletSpherical(0.1, type_1=0.2)


def test_rays_do_not_show_aberrated_lenslets_and_waves_are_called_for() -> None:
    plan = small_plan(cutout=31)
    found = plan_effects(plan, 2.0, effects=(LensletSpherical(8.0),), overrides={"lenslet_spherical": "on"})
    assert found.level == "wave"


def test_all_lenslets_missing_is_dark() -> None:
    plan = small_plan(cutout=31)
    everything = MissingLenslets(tuple((r, q, 0.0) for r in range(-15, 16) for q in range(-20, 20)))
    for base in ((), BASE):
        assert PlaneResponse(plan, 0, (*base, everything)).rows([1], [2]).sum() == 0
    assert everything.estimate(outlook_of(plan, 0)).error == 2
