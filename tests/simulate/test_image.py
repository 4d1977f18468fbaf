"""Field curvature and distortion: against other depths, and against sources set where the distortion puts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.simulate.effects import Distortion, Effect, FieldCurvature, FiniteSource, LensletDiffraction, LensTypeDefocus
from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.staging import origin_of, outlook_of
from tests.simulate.common import BASE, FAST, difference, responses, small_camera, small_plan, switched
from tests.simulate.scenes import camera_scene, microscope_scene, relative_error


def far_plan(v: float = 4.0, **options: object) -> ScanPlan:
    """Return a plan at the sensor's edge, 15 mm off the axis."""
    return small_plan(v, small_camera(160, 6000), anchor=(70.0, 5700.0), **options)


@pytest.mark.few(3)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize(
    "effect", [FieldCurvature(-900e3), FieldCurvature(500e3), Distortion(-0.0003), Distortion(0.001)]
)
def test_estimates_are_honest(v: float, effect: Effect) -> None:
    plan = far_plan(v)
    estimate = effect.estimate(outlook_of(plan, 0))
    measured = switched(plan, effect)
    assert 0.5 * measured <= estimate.error <= 2 * measured, (measured, estimate)


@pytest.mark.parametrize("effect", [FieldCurvature(-20e3), Distortion(0.005)])
def test_estimates_of_a_microscope(effect: Effect) -> None:
    camera = preset("lfm_20x05")
    y, x = camera.sensor.centre_px
    plan = ScanPlan.for_camera(camera, depths_um=[25.0], anchor=(y, x + 800))
    measured = switched(plan, effect, (LensTypeDefocus(), LensletDiffraction()))
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_a_curved_field_is_another_depth() -> None:
    """At 15 mm from the axis a surface of 200 mm lies 0.6 mm nearer: the same as a plane whose image does."""
    plan = far_plan(cutout=41)
    effect = FieldCurvature(-200e3)
    y, x = outlook_of(plan, 0).field_um
    v = 4.0 - (x * x + y * y) / 400e3 / plan.camera.lattice.gap_um
    assert difference(responses(far_plan(v, cutout=41), BASE), responses(plan, (*BASE, effect))) < 1e-4
    rays = (LensTypeDefocus(),)
    assert difference(responses(far_plan(v, cutout=41), rays), responses(plan, (*rays, effect))) < 1e-4


def test_a_curved_field_of_a_microscope_is_another_depth() -> None:
    camera = preset("lfm_20x05")
    y, x = camera.sensor.centre_px
    base = (LensTypeDefocus(), LensletDiffraction())
    plans = [ScanPlan.for_camera(camera, depths_um=[z], anchor=(y, x + 800), cutout=91) for z in (25.0, 22.0)]
    fy, fx = outlook_of(plans[0], 0).field_um
    # 3 µm nearer are M² 3 µm of the image
    radius = (fy * fy + fx * fx) / 2 / (3.0 * 400)
    assert difference(responses(plans[1], base), responses(plans[0], (*base, FieldCurvature(radius)))) < 1e-4


@pytest.mark.few(1)
@pytest.mark.parametrize("level", ["geometric", "wave", "reference"])
def test_distortion_puts_every_source_in_its_own_place(level: str) -> None:
    """Against single points at k h³ from the axis, h reckoned anew for each; windows of the others are cut out."""
    plan = far_plan(cutout=(41, 45))
    k = 0.003 / 10e3**2
    found = PlaneResponse(plan, 0, (*BASE, Distortion(0.003)), level=level, sampling=FAST)
    plain = PlaneResponse(plan, 0, BASE, level=level, sampling=FAST, cutout=(81, 85))
    pixel, centre = plan.camera.sensor.pixel_um, np.array(plan.camera.sensor.centre_px)
    for y, x in [(3, 0), (20, 31)]:
        h = (np.array(plan.anchor) + np.array([y, x]) - centre) * pixel
        moved = (y, x) + k * float(h @ h) * h / pixel
        ((row, column, wide),) = plain.point(*moved)
        top, left = 20 - (row - y), 20 - (column - x)
        wanted = wide[top : top + 41, left : left + 45]
        assert abs(column - x) > 10, "far enough to see"
        # what is left is the third power's bend over the period
        assert difference(found.rows([y], [x])[0, 0], wanted) < 3e-3


def test_distortion_spreads_the_sources_of_a_period() -> None:
    """The gradient of k h³ along the field is 3 k h²: at 15 mm and 2 % per cm² 13 % over 100 positions."""
    plan = far_plan(cutout=(41, 451))
    scene = PlaneResponse(plan, 0, (Distortion(0.02),)).scene
    ends = [scene.source_um(0, x)[1] for x in (0, 40)]
    h = outlook_of(plan, 0).field_um[1]
    assert (ends[1] - ends[0]) / (40 * scene.pixel_um) - 1 == pytest.approx(3 * 0.02 * h * h / 10e3**2, rel=1e-3)
    across = [scene.source_um(y, 0)[0] for y in (0, 25)]
    assert (across[1] - across[0]) / (25 * scene.pixel_um) - 1 == pytest.approx(0.02 * h * h / 10e3**2, rel=1e-2)


def test_distorted_frames_hold_the_light_where_h_has_it() -> None:
    plan = replace(far_plan(), period=(2, 2))
    effects = (*BASE, Distortion(0.003))
    for more in ((), (FiniteSource(30.0),)):
        camera = SimulatedCamera(plan, (*effects, *more), sampling=FAST)
        found = camera.light(3)
        (_, y, x), (row, column) = camera.position(3), origin_of(camera.plan)[:2]
        nt, ns = plan.cutout
        window = found[row + y - nt // 2 :, column + x - ns // 2 :][:nt, :ns] / camera.electrons_per_unit(0)
        h = PlaneResponse(plan, 0, (*effects, *more), sampling=FAST).rows([y], [x])[0, 0]
        assert difference(h, window) < 5e-3


@pytest.mark.long
def test_displaced_sources_light_all_their_lenslets() -> None:
    """A small cutout needs few lenslets; for a source far beside it they are others."""
    scene = camera_scene(20.0, cutout=(9, 9))
    shift = np.broadcast_to([0.0, 80 * scene.pixel_um], (*scene.period, 2)).copy()
    engine = WavePlane(scene, Sampling()).displaced(shift)
    wide = WavePlane(replace(scene, cutout=(171, 171)), Sampling()).displaced(shift)
    found, wanted = engine.rows([2], [3])[0, 0], wide.rows([2], [3])[0, 0][81:90, 81:90]
    assert wanted.sum() > 1e-4
    assert relative_error(found, wanted) < 1e-3


def test_the_microscope_s_separable_path_reaches_displaced_sources() -> None:
    scene = microscope_scene(25.0, cutout=(31, 31))
    moved = replace(scene, image_map=((40.0, 0.0, 0.0), (-240.0, 0.0, 0.0)))
    whole = replace(scene, cutout=(101, 101))
    sampling = Sampling(nodes_per_px=3)
    found = engine_for(moved, "debye", sampling).rows([1], [2])[0, 0]
    wanted = engine_for(whole, "debye", sampling).rows([6], [-28])[0, 0][30:61, 65:96]
    assert relative_error(found, wanted) < 5e-3


def test_what_cannot_be_is_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="radius_um"):
        FieldCurvature(0.0)
    for effect in (FieldCurvature(-1.0), Distortion(0.5)):
        with pytest.raises(InputError) as error:
            responses(far_plan(), (*BASE, effect))
        assert "\n" not in str(error.value) and effect.title in str(error.value)


def test_neither_acts_on_the_axis() -> None:
    outlook = replace(outlook_of(small_plan(), 0), field_um=(0.0, 0.0))
    scene = PlaneResponse(small_plan(), 0, ()).scene
    for effect in (FieldCurvature(), Distortion()):
        assert effect.on_scene(scene, outlook) is scene
        assert effect.estimate(outlook).error == 0
