"""Every effect's estimate compared with what switching the effect on and off measures: within a factor of two."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Microscope, ScanPlan, Sensor, preset
from lfcal.simulate import (
    PlaneResponse,
    Sampling,
    SimulatedCamera,
    expose,
    outlook_of,
    plan_effects,
    simulate_psf,
)
from lfcal.simulate import effects as fx
from lfcal.simulate.effects import Outlook
from tests.simulate.common import BASE, FAST, difference, long, small_camera, small_plan, some_positions
from tests.simulate.scenes import relative_error

SCOPE = preset("lfm_20x05")
PLACES = {
    "axis": lambda v: small_plan(v),
    "wide": lambda v: small_plan(v, small_camera(300, 300)),
    "rim": lambda v: small_plan(v, small_camera(160, 1200), anchor=(70.0, 1100.0)),
    "edge": lambda v: small_plan(v, small_camera(160, 3000), anchor=(70.0, 2800.0)),
    "far": lambda v: small_plan(v, small_camera(160, 6000), anchor=(70.0, 5700.0)),
    "r29": lambda v: ScanPlan.for_camera(preset("r29"), virtual_depths=[v]),
    "microscope": lambda z: ScanPlan.for_camera(SCOPE, depths_um=[z]),
    "microscope, off axis": lambda z: ScanPlan.for_camera(
        SCOPE, depths_um=[z], anchor=tuple(np.add(SCOPE.sensor.centre_px, (0, 800)))
    ),
}
"""Plans by where on the sensor they lie, for a virtual depth or, of the microscope, a depth (µm)."""

DESCRIBED = (fx.LensTypeDefocus(), fx.LensletDiffraction(), fx.IrisDiffraction(), fx.IrisShape(), fx.Telecentricity())
OTHERS = (
    fx.ExactAngles(),
    fx.LensLaw(),
    fx.Spherical(0.25),
    fx.Coma(0.25, 0.7),
    fx.LensletGap(5.0),
    fx.PitchError(1e-3),
    fx.Crosstalk(0.01),
)
TABLE: list[tuple[str, tuple[float, ...], tuple[fx.Effect, ...]]] = [
    ("axis", (4.0, -3.0), (*DESCRIBED, *OTHERS)),
    (
        "axis",
        (4.0,),
        (fx.ArrayRotation(math.radians(0.05)), fx.FiniteSource(50.0), fx.PixelFill(0.5), fx.PixelKernel(right=0.05)),
    ),
    ("axis", (-3.0,), (fx.Zernike(((3, -1, 0.3),)),)),
    ("axis", (4.0, -3.0, 2.2, 0.5), (fx.CoverGlass(40.0, 1.8, 0.5), fx.LensletSpherical(-0.25))),
    ("axis", (0.5, 4.0), (fx.AngularResponse(math.radians(15)),)),
    ("wide", (-3.0, 4.0), (fx.ArrayTilt(0.05, 0.0),)),
    ("rim", (4.0,), (fx.MechanicalVignetting(30e3, 1.02),)),
    ("edge", (4.0, -3.0, 2.2, 0.5), (fx.ArrayTilt(4e-3, -3e-3), fx.AngularResponse(math.radians(15)))),
    ("edge", (4.0, -3.0, 2.2), (fx.FieldAberrations(0.2, 0.1),)),
    ("far", (2.2, -3.0, 4.0, 0.5), (fx.FieldCurvature(-900e3), fx.Distortion(0.001))),
    ("microscope", (25.0,), (fx.LensletDiffraction(), fx.LensletGap(20.0))),
    ("microscope, off axis", (25.0,), (fx.FieldCurvature(-20e3), fx.Distortion(0.005))),
    ("r29", (4.0,), (fx.ExactAngles(),)),
]
"""Effects that are measured in the plain run at the first of their depths."""

TABLE_LONG: list[tuple[str, tuple[float, ...], tuple[fx.Effect, ...]]] = [
    ("axis", (2.2,), (fx.LensTypeDefocus(), fx.LensletDiffraction(), fx.Spherical(0.05))),
    (
        "axis",
        (-3.0,),
        (fx.Spherical(1.0), fx.ArrayRotation(math.radians(-0.2)), fx.FiniteSource(80.0), fx.PixelFill(0.9)),
    ),
    ("axis", (-3.0,), (fx.PixelKernel(up=0.03, down=0.03, left=0.01),)),
    ("axis", (4.0,), (fx.Zernike(((2, 2, 0.2), (3, 3, 0.1))), fx.LensletGap(-2.0), fx.Crosstalk(0.03))),
    ("axis", (0.5,), (*DESCRIBED[:2], fx.Telecentricity(), *(OTHERS[k] for k in (1, 2, 4, 6)))),
    ("axis", (4.0, -3.0, 2.2, 0.5), (fx.CoverGlass(10.0), fx.LensletSpherical(0.05), fx.LensletSpherical(1.0))),
    ("edge", (4.0, -3.0, 2.2, 0.5), (fx.ArrayTilt(0.0, 1e-3),)),
    ("edge", (4.0, -3.0, 2.2), (fx.FieldAberrations(0.1, 0.0), fx.FieldAberrations(0.0, 0.1))),
    ("far", (4.0, -3.0, 2.2, 0.5), (fx.FieldCurvature(500e3), fx.Distortion(-0.0003))),
    ("microscope", (25.0,), (fx.Spherical(0.25), fx.ArrayRotation(0.005), fx.FiniteSource(1.0), fx.Crosstalk(0.01))),
    ("r29", (4.0,), (fx.LensTypeDefocus(), fx.IrisDiffraction())),
]
ROWS = [(place, v, e, k > 0) for place, depths, effects in TABLE for k, v in enumerate(depths) for e in effects]
ROWS += [(place, v, e, True) for place, depths, effects in TABLE_LONG for v in depths for e in effects]


@cache
def plan_at(place: str, v: float) -> ScanPlan:
    return PLACES[place](v)


@cache
def responses_at(place: str, v: float, effects: tuple[fx.Effect, ...]) -> np.ndarray:
    plan = plan_at(place, v)
    positions = ([20], [10, 60]) if place == "r29" else some_positions(plan)
    return PlaneResponse(plan, 0, effects, sampling=FAST).rows(*positions)


def within_two(estimate: float, measured: float) -> bool:
    return 0.5 * measured <= estimate <= 2 * measured


def case(place: str, v: float, effect: fx.Effect, slow: bool) -> ParameterSet:
    label = f"{place} {v:g} {effect!r}".replace("(", " ").replace(")", "")
    return pytest.param(place, v, effect, id=label, marks=[pytest.mark.long] if slow else [])


@pytest.mark.parametrize(("place", "v", "effect"), [case(*row) for row in ROWS])
def test_estimates_of_the_optics(place: str, v: float, effect: fx.Effect) -> None:
    whole = BASE[:2] if place.startswith("microscope") else BASE
    others = tuple(one for one in whole if one.name != effect.name)
    off = responses_at(place, v, others)
    on = responses_at(place, v, whole if effect in whole else (*others, effect))
    estimate = effect.estimate(outlook_of(plan_at(place, v), 0))
    assert not estimate.upper_bound
    assert within_two(estimate.error, difference(off, on)), estimate


@pytest.mark.parametrize("v", [4.0, *(long(v) for v in (-3.0, 2.2, 0.5))])
@pytest.mark.parametrize("lenslets", [((1, 0, 0.5), (0, 1, 0.2)), long(((0, 0, 0.0),))], ids=str)
def test_estimate_of_missing_lenslets(v: float, lenslets: tuple[tuple[int, int, float], ...]) -> None:
    plan, effect = small_plan(v, small_camera(200, 200)), fx.MissingLenslets(lenslets)
    # near the native plane a source lights one lenslet or another: many positions make the mean
    ys, xs = (np.arange(1, n, 3) for n in plan.period)
    off, on = (PlaneResponse(plan, 0, (*BASE, *e), sampling=FAST).rows(ys, xs) for e in ((), (effect,)))
    assert within_two(effect.estimate(outlook_of(plan, 0)).error, difference(off, on))


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize("effect", [fx.ChromaticFocus(800.0, 0.1), fx.LensletDispersion(10.0, 0.2)])
def test_estimates_of_colour(v: float, effect: fx.Effect) -> None:
    """Compared with the same wavelengths, all imaged alike."""
    plan, sampling = small_plan(v), Sampling(None, 4, 6, coherent=False)
    on, off = (PlaneResponse(plan, 0, effects, sampling=sampling) for effects in ((*BASE, effect), BASE))
    off.samples = on.samples
    measured = difference(off.rows([4], [5]), on.rows([4], [5]))
    assert within_two(effect.estimate(outlook_of(plan, 0)).error, measured)


def test_no_fringes_are_lost_near_the_limit_of_their_separation() -> None:
    """Exact angles separate fringes from a Fresnel number of 8; a finite pupil distance turns 7.8 into 8.07."""
    types = (LensType(615.0), LensType(461.0), LensType(384.6))
    lattice = LensletLattice("hexagonal", 39.4, 307.7, types, clear_um=34.1)
    lens = MainLens(25e3, 5.91, 1e5, blades=0)
    camera = Camera("fringes", lens, lattice, Sensor((800, 800), 2.2, 12, 20e3, 5.0), 0.473)
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[-3.0], cutout=41), period=(1, 2))
    truth, found = (np.asarray(simulate_psf(plan, plan_effects(plan, t), tolerance=t)) for t in (0.005, 0.03))
    assert difference(found, truth) < 0.03, "the fringes alone are 11 %"


def faster(factor: float) -> Camera:
    """Return the bench camera with faster optics, whose fringes are finer than its pixels."""
    camera = preset("bench")
    gap = camera.lattice.gap_um / factor
    types = tuple(LensType.focused_at(v, gap) for v in (2.0, 3.0, 4.0))
    optics = replace(camera.optics, f_number=camera.optics.f_number / factor)
    return replace(camera, optics=optics, lattice=replace(camera.lattice, gap_um=gap, types=types))


@pytest.mark.parametrize(
    ("factor", "v", "width", "places"),
    [
        long(1.0, 4.0, 0.02, ([4], [5, 20])),
        (1.0, 2.2, 0.1, ([4], [5, 20])),
        long(2.5, 3.0, 0.1, ([2], [9])),
        long(2.0, -2.0, 0.1, ([2], [9])),
    ],
)
def test_estimate_of_the_bandwidth(factor: float, v: float, width: float, places: tuple[list[int], list[int]]) -> None:
    """With the fields of the lenslets added: their interference is the first to disappear."""
    plan = small_plan(v) if factor == 1 else ScanPlan.for_camera(faster(factor), virtual_depths=[v])
    effect, sampling = fx.Bandwidth(width), Sampling(nodes_per_px=4 if factor == 1 else 8, margin_px=12, coherent=True)
    off, on = (PlaneResponse(plan, 0, e, sampling=sampling).rows(*places) for e in (BASE, (*BASE, effect)))
    assert within_two(effect.estimate(outlook_of(plan, 0)).error, difference(off, on))


@pytest.mark.parametrize(("v", "step"), [(4.0, 6.0), *(long(*one) for one in ((-3.0, 12.0), (2.2, 3.0)))])
def test_estimates_of_motion(v: float, step: float) -> None:
    """Stage error, drift and backlash by displaced sources; a fixed displacement represents their mean."""
    plan = small_plan(v)
    outlook, response = outlook_of(plan, 0), PlaneResponse(plan, 0, BASE, sampling=FAST)
    pixel, engine = response.scene.pixel_um, response.engine()
    places = [(y, x) for y in some_positions(plan)[0] for x in some_positions(plan)[1]]
    true = [engine.point(y * pixel, x * pixel) for y, x in places]

    def mean_error(shifts: np.ndarray) -> float:
        shifts = np.clip(shifts[: len(places)], -0.499 * pixel, 0.499 * pixel)
        moved = [engine.point(y * pixel + dy, x * pixel + dx) for (y, x), (dy, dx) in zip(places, shifts, strict=True)]
        return difference(np.array(moved), np.array(true))

    commanded = plan.object_um(plan.order_indices())[:, ::-1]
    rng = np.random.default_rng(1)
    scale = pixel / plan.camera.step_um(outlook.z_um)
    for effect in (fx.PositioningError(step / 3), fx.Drift(step / 2, step / 2), fx.Backlash(step)):
        moved = effect.displace(commanded, plan.camera, rng)[:, 1:] * scale
        measured, estimate = mean_error(moved[rng.permutation(len(moved))]), effect.estimate(outlook).error
        if isinstance(effect, fx.Backlash):
            assert measured <= estimate <= 4 * measured
        else:
            assert within_two(estimate, measured), (effect.name, measured, estimate)


@pytest.mark.parametrize("v", [4.0, long(-3.0)])
def test_estimate_of_the_depth_error(v: float) -> None:
    plan, off_um = small_plan(v), math.sqrt(2 / math.pi) * 200.0
    wrong = PlaneResponse(plan, 0, BASE, sampling=FAST, depth_error_um=off_um).rows(*some_positions(plan))
    measured = difference(responses_at("axis", v, BASE), wrong)
    assert within_two(fx.DepthError(200.0).estimate(outlook_of(plan, 0)).error, measured)


FRAME_EFFECTS: list[tuple[fx.FrameEffect, float]] = [
    *(
        (effect, 1.0)
        for effect in (fx.ShotNoise(), fx.ReadNoise(), fx.ReadNoise(2.0), fx.FixedPattern(), fx.DarkCurrent(20.0))
    ),
    *(
        (effect, 1.0)
        for effect in (fx.StrayLight(0.02), fx.Quantisation(), fx.SensorNonlinearity(0.02), fx.SensorNonlinearity(-0.1))
    ),
    (fx.Saturation(), 3.0),
]
"""Effects on frames, and how many times as bright as planned the frames are."""


@pytest.mark.parametrize("v", [4.0, long(-3.0)])
def test_estimates_of_frame_effects(v: float) -> None:
    """On the cutouts of a few frames."""
    plan = small_plan(v, small_camera(180, 180))
    source, half = SimulatedCamera(plan, BASE, sampling=FAST), plan.cutout[0] // 2
    frames = []
    for k in (0, 150, 320, 500):
        row, column = plan.image_px(plan.order_indices()[k]).astype(int)
        frames.append((k, source.light(k), np.s_[row - half : row + half + 1, column - half : column + half + 1]))
    for effect, over in FRAME_EFFECTS:
        measured = []
        for k, light, cutout in frames:
            off, on = (
                expose(light * np.float32(over), plan.camera, effects, exposure_s=plan.exposures[0], index=k)[cutout]
                - plan.camera.sensor.black_level
                for effects in ((), (effect,))
            )
            measured.append(difference(off, on))
        estimate = effect.estimate(outlook_of(plan, 0, peak=0.8 * over))
        assert within_two(estimate.error, float(np.mean(measured))), (effect, np.mean(measured), estimate)


def test_estimates_of_cos_fourth_and_colour_filters() -> None:
    wide = small_plan(4.0, small_camera(180, 9000), anchor=(80.0, 8900.0))
    for plan, effect in (
        (wide, fx.CosFourth()),
        (small_plan(4.0, small_camera(180, 180, cfa="GRBG")), fx.ColourFilter()),
    ):
        light = SimulatedCamera(plan, BASE, sampling=FAST).light(10)
        off, on = (expose(light, plan.camera, e, exposure_s=0.02) - 64.0 for e in ((), (effect,)))
        estimate = effect.estimate(outlook_of(plan, 0)).error
        assert estimate > 0.05 and within_two(estimate, difference(off, on)), effect


WATER = 1.33


def microscope(magnification: float, na: float, index: float, lenslet: tuple[float, float, float]) -> Camera:
    """Return a microscope with square lenslets of (pitch, focal length, pixel) (µm)."""
    pitch, focal, pixel = lenslet
    lattice = LensletLattice("square", pitch, focal, (LensType(focal),))
    optics, sensor = Microscope(magnification, na, index), Sensor((2048, 2048), pixel, 16, 30e3, 1.5)
    return Camera("small", optics, lattice, sensor, wavelength_um=0.55)


BROXTON, PRESET60, COARSE = (125.0, 2500.0, 125 / 15), (100.0, 2500.0, 6.5), (150.0, 3000.0, 10.0)
VECTOR = fx.VectorialPupil()
SPECIMENS: list[tuple[tuple[float, float, float], tuple[float, float, float], fx.Effect, float]] = [
    ((10.0, 0.3, 1.0), BROXTON, VECTOR, 0.0),
    ((10.0, 0.3, 1.0), BROXTON, VECTOR, -15.0),
    ((20.0, 0.5, 1.0), BROXTON, VECTOR, 0.0),
    ((20.0, 0.5, 1.0), BROXTON, VECTOR, 25.0),
    ((20.0, 0.5, 1.0), BROXTON, VECTOR, -50.0),
    ((40.0, 0.95, 1.0), (125.0, 3000.0, 125 / 15), VECTOR, 1.0),
    ((25.0, 0.6, WATER), COARSE, VECTOR, -10.0),
    ((60.0, 1.2, 1.35), PRESET60, VECTOR, 0.0),
    ((60.0, 1.2, 1.35), PRESET60, VECTOR, -1.5),
    ((60.0, 1.2, 1.35), PRESET60, VECTOR, 50.0),
    ((63.0, 1.3, 1.518), PRESET60, VECTOR, 2.0),
    ((60.0, 1.49, 1.518), (125.0, 3000.0, 125 / 13), VECTOR, 0.0),
    ((10.0, 0.3, 1.0), BROXTON, fx.IndexMismatch(WATER, 0.0), 2.0),
    ((20.0, 0.5, 1.0), BROXTON, fx.IndexMismatch(WATER, 20.0), -20.0),
    ((20.0, 0.5, 1.0), BROXTON, fx.IndexMismatch(WATER, 50.0), 25.0),
    ((40.0, 0.95, 1.0), BROXTON, fx.IndexMismatch(WATER, 5.0), 0.0),
    ((60.0, 1.2, WATER), PRESET60, fx.IndexMismatch(1.38, 5.0), 0.0),
    ((60.0, 1.2, WATER), PRESET60, fx.IndexMismatch(1.38, 50.0), 50.0),
    ((63.0, 1.3, 1.518), PRESET60, fx.IndexMismatch(WATER, 0.0), 10.0),
    ((60.0, 1.4, 1.518), BROXTON, fx.IndexMismatch(WATER, 20.0), -20.0),
]
"""Objective, lenslets, effect and depth (µm)."""
PLAIN = (2, 8, 13, 16)
"""Rows of the plain run: of each effect a low and a high aperture."""


@pytest.mark.parametrize(
    ("objective", "lenslet", "effect", "z"),
    [pytest.param(*row, marks=() if k in PLAIN else pytest.mark.long) for k, row in enumerate(SPECIMENS)],
)
def test_estimates_of_vector_field_and_specimen(objective, lenslet, effect, z):
    plan = ScanPlan.for_camera(microscope(*objective, lenslet), depths_um=[z], cutout=75)
    base = (fx.LensTypeDefocus(), fx.LensletDiffraction(), *(() if effect is VECTOR else (VECTOR,)))
    ny, nx = plan.period
    places = ((0, 0), (ny // 4, nx // 3), (ny // 2, nx // 2), (ny // 2 - 1, 2))
    off, on = (
        np.stack([response.rows([y], [x], workers=1)[0, 0] for y, x in places])
        for response in (PlaneResponse(plan, 0, e, sampling=Sampling(nodes_per_px=3)) for e in (base, (*base, effect)))
    )
    outlook = Outlook(plan.camera, plan.depths_um[0], plan.cutout, plan.period)
    assert within_two(effect.estimate(outlook).error, min(2.0, relative_error(off, on)))
