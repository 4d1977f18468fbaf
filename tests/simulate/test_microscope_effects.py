"""The microscope's effects: estimates against runs, what the planner makes of them, provenance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, Microscope, ScanPlan, Sensor, preset
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate.effects import IndexMismatch, LensletDiffraction, LensTypeDefocus, Outlook, VectorialPupil
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse
from tests.simulate.scenes import relative_error

WATER = 1.33


def small_camera(magnification: float, na: float, index: float, lenslet: tuple[float, float, float]) -> Camera:
    """Return a microscope with square lenslets of (pitch, focal length, pixel) (µm)."""
    pitch, focal, pixel = lenslet
    lattice = LensletLattice("square", pitch, focal, (LensType(focal),))
    optics, sensor = Microscope(magnification, na, index), Sensor((2048, 2048), pixel, 16, 30e3, 1.5)
    return Camera("small", optics, lattice, sensor, wavelength_um=0.55)


BROXTON, PRESET60, COARSE = (125.0, 2500.0, 125 / 15), (100.0, 2500.0, 6.5), (150.0, 3000.0, 10.0)

PLANES = [
    (10.0, 0.3, 1.0, BROXTON, 0.0),
    (10.0, 0.3, 1.0, BROXTON, -15.0),
    (20.0, 0.5, 1.0, BROXTON, 0.0),
    (20.0, 0.5, 1.0, BROXTON, 25.0),
    (20.0, 0.5, 1.0, BROXTON, -50.0),
    (40.0, 0.95, 1.0, (125.0, 3000.0, 125 / 15), 1.0),
    (25.0, 0.6, WATER, COARSE, -10.0),
    (60.0, 1.2, 1.35, PRESET60, 0.0),
    (60.0, 1.2, 1.35, PRESET60, -1.5),
    (60.0, 1.2, 1.35, PRESET60, 50.0),
    (63.0, 1.3, 1.518, PRESET60, 2.0),
    (60.0, 1.49, 1.518, (125.0, 3000.0, 125 / 13), 0.0),
]


def measured(plan: ScanPlan, effect: VectorialPupil | IndexMismatch, base: tuple = ()) -> tuple[float, float]:
    """Return the error of leaving ``effect`` out at a few positions, and its estimate."""
    base = (LensTypeDefocus(), LensletDiffraction(), *base)
    ny, nx = plan.period
    places = ((0, 0), (ny // 4, nx // 3), (ny // 2, nx // 2), (ny // 2 - 1, 2))
    off, on = (
        [
            PlaneResponse(plan, 0, chosen, sampling=Sampling(nodes_per_px=3)).rows([y], [x], workers=1)[0, 0]
            for y, x in places
        ]
        for chosen in (base, (*base, effect))
    )
    outlook = Outlook(plan.camera, plan.depths_um[0], plan.cutout, plan.period)
    return min(2.0, relative_error(np.stack(off), np.stack(on))), effect.estimate(outlook).error


@pytest.mark.few(4)
@pytest.mark.parametrize(("magnification", "na", "index", "lenslet", "z"), PLANES)
def test_estimate_of_the_vector_field(magnification, na, index, lenslet, z):
    plan = ScanPlan.for_camera(small_camera(magnification, na, index, lenslet), depths_um=[z], cutout=75)
    found, estimate = measured(plan, VectorialPupil())
    assert 0.5 * estimate <= found <= 2 * estimate


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("objective", "lenslet", "mismatch", "z"),
    [
        ((10.0, 0.3, 1.0), BROXTON, IndexMismatch(WATER, 0.0), 2.0),
        ((20.0, 0.5, 1.0), BROXTON, IndexMismatch(WATER, 20.0), -20.0),
        ((20.0, 0.5, 1.0), BROXTON, IndexMismatch(WATER, 50.0), 25.0),
        ((40.0, 0.95, 1.0), BROXTON, IndexMismatch(WATER, 5.0), 0.0),
        ((60.0, 1.2, WATER), PRESET60, IndexMismatch(1.38, 5.0), 0.0),
        ((60.0, 1.2, WATER), PRESET60, IndexMismatch(1.38, 50.0), 50.0),
        ((63.0, 1.3, 1.518), PRESET60, IndexMismatch(WATER, 0.0), 10.0),
        ((60.0, 1.4, 1.518), BROXTON, IndexMismatch(WATER, 20.0), -20.0),
    ],
)
def test_estimate_of_the_mismatch(objective, lenslet, mismatch, z):
    plan = ScanPlan.for_camera(small_camera(*objective, lenslet), depths_um=[z], cutout=75)
    found, estimate = measured(plan, mismatch, (VectorialPupil(),))
    assert 0.5 * estimate <= found <= 2 * estimate


def test_the_planner_switches_the_vector_field_on_where_it_shows():
    camera = preset("lfm_60x12")
    near, far = (ScanPlan.for_camera(camera, depths_um=[z], cutout=39) for z in (0.0, 40.0))
    found = plan_effects(near, 0.03)
    row, scalar = found.row("vectorial"), plan_effects(near, 0.03, {"vectorial": "off"})
    assert row.on and "above" in row.reason and found.seconds > 1.5 * scalar.seconds > 0
    assert not plan_effects(far, 0.03).row("vectorial").on
    bench = preset("bench")
    plan = ScanPlan.for_camera(bench, virtual_depths=[4.0])
    lens = plan_effects(plan, 1e-6).row("vectorial")
    assert not lens.on and lens.estimate.error == 0 and lens.seconds == 0 and "f/2" in lens.estimate.formula
    for effect in (VectorialPupil(), IndexMismatch(1.4, 10.0)):
        outlook = Outlook(bench, plan.depths_um[0], plan.cutout, plan.period)
        scene = PlaneResponse(plan, 0, ()).scene
        assert effect.on_scene(scene, outlook) == scene and effect.estimate(outlook).error == 0


def test_h_with_both_effects_says_so():
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[0.0], cutout=15)
    given = (VectorialPupil(), IndexMismatch(WATER, 3.0))
    H = simulate_psf(plan, given, tolerance=0.05)
    assert H.provenance["simulated"]["effects"] == [
        {"name": "vectorial"},
        {"name": "index_mismatch", "index": WATER, "depth_um": 3.0},
    ]
    assert 0 < H.facts.error[0] < 0.05
    plain = simulate_psf(plan, (LensletDiffraction(),), tolerance=0.05)
    assert relative_error(H.plane(0), plain.plane(0)) > 0.05


def test_rays_see_the_focal_shift():
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[20.0], cutout=61)
    shifted = PlaneResponse(plan, 0, (IndexMismatch(WATER, 30.0),), level="geometric")
    assert shifted.scene.image_um == pytest.approx(-400 * (50 / WATER - 30))
    there = ScanPlan.for_camera(camera, depths_um=[50 / WATER - 30], cutout=61)
    wanted = PlaneResponse(there, 0, (), level="geometric").rows([1], [2])
    assert relative_error(shifted.rows([1], [2]), wanted) < 1e-5


@pytest.mark.parametrize("given", [{"index": 0.9}, {"index": math.nan}, {"depth_um": -1.0}, {"depth_um": math.inf}])
def test_specimens_that_are_none(given):
    with pytest.raises(InputError) as error:
        IndexMismatch(**given)
    assert "\n" not in str(error.value)
