"""Effects at the array: angular response and cover glass of the sensor, tilt, missing and aberrated lenslets."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import LensType, ScanPlan
from lfcal.simulate import PlaneResponse, Sampling, SimulatedCamera, at_wavelength, outlook_of, plan_effects
from lfcal.simulate import effects as fx
from lfcal.simulate.engines import engine_for
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.microscope import DebyePlane, debye_plane
from lfcal.simulate.engines.tilted import TiltedArray
from lfcal.simulate.scene import Scene, pixel_response
from tests.simulate.common import BASE, FAST, difference, long, responses, small_camera, small_plan
from tests.simulate.scenes import camera_scene, microscope_scene, moments, relative_error

OBLIQUE = (10.0, 0.1, -0.2)


def edge_plan(v: float) -> ScanPlan:
    return small_plan(v, small_camera(160, 3000), anchor=(70.0, 2800.0))


COHERENT = Sampling(None, 5, 14, coherent=True)
FINE = Sampling(None, 6, 14, coherent=True)
WINDOWS = Sampling(4, 4, 12, coherent=True)
GRID = Sampling(samples_per_px=6, margin_px=24)


def point(scene: Scene, level: str, sampling: Sampling) -> np.ndarray:
    """Return the response of one position."""
    return engine_for(scene, level, sampling).rows([3], [20])[0, 0].astype(float)


def test_the_response_is_half_at_its_angle() -> None:
    effect = fx.AngularResponse(math.radians(20))
    sines = np.sin(np.radians([0.0, 20.0, 14.142]))
    assert pixel_response(effect.power, sines, 0.0)[:2] == pytest.approx([1.0, 0.5])
    assert pixel_response(effect.power, 0.6, 0.9) == 0, "there is no such ray"
    outlook = outlook_of(edge_plan(4.0), 0)
    angle = math.atan(outlook.field_um[1] / outlook.camera.optics.image_distance_um)
    assert effect.slope(outlook)[1] == pytest.approx(math.sin(angle), rel=1e-4)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("v", "accept", "share"),
    [(3.0, OBLIQUE, 0.05), long(0.4, OBLIQUE, 0.08), long(3.0, (10.0, 0.0, 0.0), 0.15), long(-3.0, OBLIQUE, 0.05)],
)
def test_waves_lose_what_the_angular_spectrum_does(v: float, accept: tuple[float, float, float], share: float) -> None:
    """Of the effect at most ``share`` is missed: most near the native plane, where one lenslet represents all."""
    scene = camera_scene(v, cutout=(41, 41), accept=accept)
    plain, seen = (point(s, "reference", Sampling(6.0)) for s in (replace(scene, accept=(0, 0, 0)), scene))
    effect = relative_error(plain, seen)
    assert effect > 0.03
    assert relative_error(point(scene, "wave", COHERENT), seen) < share * effect + 0.004


@pytest.mark.parametrize("v", [3.0, long(0.4)])
def test_rays_lose_as_much_light(v: float) -> None:
    scene = camera_scene(v, cutout=(41, 41), accept=OBLIQUE)
    without = replace(scene, accept=(0.0, 0.0, 0.0))
    rays, waves = (
        [float(engine_for(s, level, sampling).rows([3], [18, 20]).sum()) for s in (scene, without)]
        for level, sampling in (("geometric", Sampling()), ("wave", Sampling(None, 4, 8)))
    )
    assert rays[0] / rays[1] == pytest.approx(waves[0] / waves[1], abs=0.03)
    assert rays[0] / rays[1] < 0.85


TILT = (0.01, -0.02)


def test_the_region_has_the_gap_and_the_image_of_its_place() -> None:
    plan = edge_plan(4.0)
    plain, tilted = (PlaneResponse(plan, 0, (*BASE, *more)).scene for more in ((), (fx.ArrayTilt(2e-3, 1e-3),)))
    y, x = outlook_of(plan, 0).field_um
    farther = 2e-3 * y + 1e-3 * x
    assert farther > 5
    assert tilted.gap_um - plain.gap_um == pytest.approx(farther)
    assert tilted.image_um - plain.image_um == pytest.approx(farther)
    assert plain.pupil_um - tilted.pupil_um == pytest.approx(farther)


def test_rays_through_lenslets_land_where_straight_lines_do() -> None:
    """By similar triangles for each lenslet at its own height: (a + d)/(B + d) from the image to the sensor."""
    scene = camera_scene(4.0, cutout=(81, 81), lenslet_diffraction=False)
    # in focus at v = 2, all of them: spots of two pixels' radius
    scene = replace(scene, lattice=replace(scene.lattice, types=scene.lattice.types[:1]))
    y, x = 3, 7
    images = [engine_for(s, "geometric").rows([y], [x])[0, 0] for s in (scene, replace(scene, tilt=TILT))]
    middle = np.array([(n - 1) / 2 for n in scene.period[::-1]]) * scene.pixel_um
    source = np.array([x, y]) * scene.pixel_um
    reach = scene.shadow_radius_um - scene.clear_radius_um
    centres, _ = scene.lattice.lenslets_within(reach, reach, (x * scene.pixel_um, y * scene.pixel_um))
    moved = []
    for c in centres:
        if np.hypot(*(c - source)) > reach:
            continue
        d = float((c - middle) @ np.array(TILT[::-1]))
        flat, lands = (c + (scene.gap_um + k) / (scene.image_um + k) * (source - c) for k in (0.0, d))
        # a window of 9 pixels holds one spot, and nothing of the next
        column, row = np.round((lands - source) / scene.pixel_um).astype(int) + 40
        places = [np.array(moments(image[row - 4 : row + 5, column - 4 : column + 5]))[::-1] for image in images]
        moved.append(((places[1] - places[0]) * scene.pixel_um, lands - flat))
    found, wanted = np.array(moved).transpose(1, 0, 2)
    assert len(found) > 4 and np.abs(wanted).max() > 0.1
    assert np.abs(found - wanted).max() < 0.1 * np.abs(wanted).max()


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("change", [{}, {"exact_rays": True, "exact_defocus": True}])
def test_windows_follow_a_tilt_in_part(change: dict[str, bool]) -> None:
    """Windows take each lenslet at its own height, and parallel to the sensor: about half of what a tilt does."""
    flat = camera_scene(6.0, cutout=(45, 45), **change)
    tilted = replace(flat, tilt=(0.03, -0.04))
    by_windows, by_grid = (
        [point(scene, level, sampling) for scene in (flat, tilted)]
        for level, sampling in (("wave", WINDOWS), ("grid", GRID))
    )
    effect = relative_error(*by_grid)
    assert effect > 0.02
    assert relative_error(by_windows[1], by_grid[1]) < relative_error(by_windows[0], by_grid[0]) + 0.5 * effect


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("v", [3.0, 0.3])
@pytest.mark.parametrize("exact", [False, True])
def test_the_grid_follows_a_tilt_as_the_reference_does(v: float, exact: bool) -> None:
    flat = camera_scene(v, cutout=(33, 33), exact_rays=exact, exact_defocus=exact)
    by_grid, by_reference = (
        [point(scene, level, sampling) for scene in (flat, replace(flat, tilt=(0.017, -0.01)))]
        for level, sampling in (("grid", GRID), ("reference", Sampling(6.0)))
    )
    assert relative_error(*by_reference) > 0.005
    assert relative_error(by_grid[1], by_reference[1]) < relative_error(by_grid[0], by_reference[0]) + 3e-4


def field_on(scene: Scene) -> tuple[TiltedArray, np.ndarray, float, np.ndarray]:
    """Return an array, how far its samples lie, the samples' distance, and their places (y, x)."""
    n, dx = 96, 0.9
    axis = (np.arange(n) - n // 2) * dx
    farther = scene.farther_at(axis[:, None], axis[None, :])
    return TiltedArray(scene, n, dx, n / 2 * dx, np.complex128), farther, dx, axis


@pytest.mark.parametrize("exact", [False, True])
def test_a_plane_wave_is_met_where_the_array_lies(exact: bool) -> None:
    """By its formula: exp(2 pi i (s r - d (sqrt(1 - s²) - 1))/lambda) at a point r that lies d before the plane."""
    scene = camera_scene(3.0, tilt=(0.05, -0.03), exact_rays=exact)
    tilted, farther, dx, axis = field_on(scene)
    heights = tilted.heights(farther)
    for turns in ((0, 0), (8, -11)):
        f = np.array(turns) / (axis.size * dx)
        sines2 = float(f @ f) * scene.wavelength_um**2
        assert sines2 < 0.1
        longer = np.sqrt(1 - sines2) - 1 if exact else -sines2 / 2
        plane = np.exp(2j * np.pi * (f[0] * axis[:, None] + f[1] * axis[None, :]))
        wanted = plane * np.exp(-2j * np.pi / scene.wavelength_um * farther * longer)
        assert np.abs(tilted.met(tilted.parts(plane), heights) - wanted).max() < 5e-4
        # and from there to the plane again
        back = np.fft.ifft2(tilted.left(wanted.copy(), heights))
        assert np.abs(back - plane)[8:-8, 8:-8].max() < 0.02  # a slope is not periodic: its border spreads


def test_leaving_is_the_adjoint_of_meeting() -> None:
    rng = np.random.default_rng(0)
    tilted, farther, _, axis = field_on(camera_scene(3.0, tilt=(0.02, 0.01)))
    heights = tilted.heights(farther)
    e, b = (rng.standard_normal((2, axis.size, axis.size, 2)) @ [1, 1j])[:2]
    on_array = np.vdot(b, tilted.met(tilted.parts(e), heights))
    on_plane = np.vdot(np.fft.ifft2(tilted.left(b.copy(), heights)), e)
    assert on_array == pytest.approx(on_plane, rel=1e-10)


def test_a_tilt_too_far_for_any_polynomial_is_refused() -> None:
    with pytest.raises(InputError, match=r"array tilt: expected a smaller tilt over the lit lenslets, got 0\.5 rad"):
        engine_for(camera_scene(6.0, tilt=(0.5, 0.0)), "grid")


def one_lens(scene: Scene, row: int, column: int) -> Scene:
    """Return the scene in which all lenslets about the source but one are opaque."""
    others = [(r, q, 0.0) for r in range(-9, 10) for q in range(-9, 10) if (r, q) != (row, column)]
    return replace(scene, defects=tuple(others))


ENGINES = {"geometric": Sampling(), "wave": Sampling(4, 4, 8, coherent=False)}


@pytest.mark.few(2)
@pytest.mark.parametrize("level", sorted(ENGINES))
@pytest.mark.parametrize("aperture", ["circle", "cell"])
def test_what_a_lenslet_does_not_pass_is_what_it_would_have_made(level: str, aperture: str) -> None:
    """The lenslet is found by its place: light outside its own micro-image does not change."""
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


def test_white_frames_show_the_defective_lenslets_once() -> None:
    plan = small_plan(4.0, small_camera(120, 120))
    effects: tuple[fx.Effect, ...] = BASE[:1]
    frames = [
        SimulatedCamera(plan, (*effects, *more), sampling=FAST).white_frame().astype(float)
        for more in ((), (fx.MissingLenslets(((1, 0, 0.25),)),))
    ]
    ratio = (frames[1] - plan.camera.sensor.black_level) / (frames[0] - plan.camera.sensor.black_level).clip(1e-9)
    dark = ratio < 0.9
    cell = plan.camera.pitch_px * plan.camera.lattice.row_step_um / plan.camera.sensor.pixel_um
    assert 0.5 * cell < dark.sum() < 1.2 * cell
    first = np.array(plan.anchor) - plan.lattice_anchor
    b = plan.camera.lattice.basis_um()[1] / plan.camera.sensor.pixel_um
    assert np.hypot(*(np.argwhere(dark).mean(0) - first - b[::-1])) < 1


def one_type(**changes: Any) -> Scene:
    scene = camera_scene(3.0, cutout=(41, 41), **changes)
    return replace(scene, lattice=replace(scene.lattice, types=scene.lattice.types[1:2]))


@pytest.mark.long
@pytest.mark.parametrize("aperture", ["circle", "cell"])
@pytest.mark.parametrize("waves", [long(0.25), -1.0])
@pytest.mark.few(1)
def test_aberrated_lenslets_are_those_of_the_reference(aperture: str, waves: float) -> None:
    scene = one_type(aperture=aperture, lenslet_waves=waves)
    reference, plain = (point(s, "reference", Sampling(8.0)) for s in (scene, replace(scene, lenslet_waves=0)))
    assert relative_error(point(scene, "wave", FINE), reference) < 0.01
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


@pytest.mark.few(1)
@pytest.mark.parametrize("level", ["wave", "grid"])
def test_each_lens_type_has_its_own_aberration(level: str) -> None:
    """Of one lens type alone: its light is that of an array in which all lenslets are aberrated as it is."""
    scene, own = camera_scene(3.0, cutout=(41, 41)), (0.4, -0.3, 0.0)
    sampling = Sampling(None, 4, 14, coherent=True) if level == "wave" else Sampling(6.0)
    centres, kinds = scene.lattice.lenslets_within(600.0, 600.0, (0.0, 0.0))
    index = np.rint(scene.lattice.lenslet_at(centres)).astype(int)
    for kind in (0, 1):
        dark = tuple((int(r), int(q), 0.0) for (q, r), k in zip(index, kinds, strict=True) if k != kind)
        found, wanted, plain = (
            point(replace(scene, defects=dark, **change), level, sampling)
            for change in ({"lenslet_waves": 0.1, "type_waves": own}, {"lenslet_waves": 0.1 + own[kind]}, {})
        )
        assert relative_error(found, wanted) < 2e-3
        assert relative_error(plain, wanted) > 0.02


def test_aberrations_of_lens_types_are_one_for_each_and_keep_their_glass() -> None:
    plan, camera = small_plan(cutout=31), small_camera()
    alike = replace(camera, lattice=replace(camera.lattice, types=camera.lattice.types[:1]))
    with pytest.raises(InputError, match="lens type: expected a number below 1, got 2"):
        PlaneResponse(small_plan(camera=alike, cutout=31), 0, (*BASE, fx.LensletSpherical(0.0, type_2=0.1)))
    with pytest.raises(InputError, match="expected 3 values, one for each lens type"):
        camera_scene(type_waves=(0.1,))
    scene = PlaneResponse(plan, 0, (*BASE, fx.LensletSpherical(0.25), fx.LensletSpherical(0.0, 0.1, 0.0, -0.1))).scene
    assert scene.lenslet_waves == 0.25 and scene.type_waves == (0.1, 0.0, -0.1)
    other = at_wavelength(scene, scene.wavelength_um / 2)
    assert other.lenslet_waves == pytest.approx(0.5) and other.type_waves == pytest.approx((0.2, 0, -0.2))
    assert not isinstance(debye_plane(microscope_scene(lenslet_waves=0.5)), DebyePlane)


def test_rays_do_not_show_aberrated_lenslets_so_waves_are_planned() -> None:
    overrides = {"lenslet_spherical": "on"}
    assert plan_effects(small_plan(cutout=31), 2.0, overrides, effects=(fx.LensletSpherical(8.0),)).level == "wave"


def test_all_lenslets_missing_is_dark() -> None:
    plan = small_plan(cutout=31)
    everything = fx.MissingLenslets(tuple((r, q, 0.0) for r in range(-15, 16) for q in range(-20, 20)))
    for base in ((), BASE):
        assert PlaneResponse(plan, 0, (*base, everything)).rows([1], [2]).sum() == 0
    assert everything.estimate(outlook_of(plan, 0)).error == 2


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
    found, wanted = (responses(plan, (*BASE, e)) for e in (fx.CoverGlass(30.0, 1.5), fx.LensletGap(-shorter)))
    assert difference(found, wanted) < 1e-6
    held = responses(plan, (*BASE, fx.CoverGlass(30.0, 1.5, 1.0)))
    assert difference(held, responses(plan, BASE)) < 1e-6, "the gap includes it, and paraxial light sees no more"
    by_rays = [responses(plan, (BASE[0], e)) for e in (fx.CoverGlass(30.0, 1.5), fx.LensletGap(-shorter))]
    assert difference(*by_rays) < 1e-6


def fast_scene(thickness: float) -> Scene:
    """Return lenslets of f/2.8 behind a cone of F/2.8, in focus."""
    scene = camera_scene(3.0, cutout=(45, 45), exact_rays=True, exact_defocus=True, f_number=2.8)
    gap = 0.56 * scene.gap_um
    lattice = replace(scene.lattice, types=(LensType.focused_at(3.0, gap),), gap_um=gap)
    return replace(scene, lattice=lattice, image_um=3 * gap, glass=(thickness, 1.52))


@pytest.mark.long
def test_waves_follow_the_aberration_of_the_plate() -> None:
    air, glass = fast_scene(0.0), fast_scene(200.0)
    reference, plain = (point(s, "reference", Sampling(8.0)) for s in (glass, air))
    effect = relative_error(plain, reference)
    assert effect > 0.04
    assert relative_error(point(glass, "wave", FINE), reference) < 0.5 * effect
    assert relative_error(point(air, "wave", FINE), plain) < 0.03


def test_the_scene_has_the_plate() -> None:
    scene = PlaneResponse(small_plan(), 0, (*BASE, fx.ExactAngles(), fx.CoverGlass(100.0, 1.5, 1.0))).scene
    assert scene.glass == (100.0, 1.5) and scene.exact_rays
