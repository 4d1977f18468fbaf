"""What effects do: oracles of their pieces, extreme magnitudes, refusals, and no work where they are off."""

from __future__ import annotations

import inspect
import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError, LfcalError
from lfcal.camera import ScanPlan, preset
from lfcal.simulate import PlaneResponse, Sampling, filtered, outlook_of, plan_effects, scene_for
from lfcal.simulate import effects as fx
from lfcal.simulate.effects import LightSample
from lfcal.simulate.effects.aberrations import wavefront_rms
from lfcal.simulate.effects.field import overlap
from lfcal.simulate.effects.light import disc_rule
from lfcal.simulate.effects.outlook import share_moved, share_widened
from lfcal.simulate.engines import _geometric as geometric
from lfcal.simulate.engines import _wave as wave
from lfcal.simulate.engines import engine_for
from tests.simulate.common import BASE, FAST, difference, long, responses, small_camera, small_plan, some_positions


def test_exact_angles_keep_the_chief_rays() -> None:
    """Exact rays alone displace the outer spots; with exact defocus they come back."""
    plan = small_plan(4.0, cutout=61)
    scene = PlaneResponse(plan, 0, BASE[1:]).scene  # one lens type: every spot alike

    def spots(**flags: bool) -> np.ndarray:
        image = engine_for(replace(scene, **flags), "wave", Sampling()).rows([9], [16])[0, 0].astype(float)
        place = np.array([(12, 27), (45, 26), (26, 14), (26, 46)])  # near the rim of the shadow
        out = []
        for row, column in place:
            part = image[row - 4 : row + 5, column - 4 : column + 5]
            y, x = np.mgrid[row - 4 : row + 5, column - 4 : column + 5] - 30
            out.append(float((part * np.hypot(y, x)).sum() / part.sum()))
        return np.array(out)

    plain, rays = spots(), spots(exact_rays=True)
    both = spots(exact_rays=True, exact_defocus=True)
    assert np.abs(both - plain).max() < np.abs(rays - plain).max()


def test_every_effect_has_an_estimate_for_the_microscope() -> None:
    outlook = outlook_of(ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[25.0], cutout=91), 0)
    for kind in fx.CATALOGUE:
        estimate = kind().estimate(outlook)
        assert np.isfinite([estimate.size, estimate.error]).all()
        assert 0 <= estimate.error <= 2 and estimate.unit and estimate.formula, kind.name


def test_coma_turns_with_the_field_point() -> None:
    """A square array looks the same when rows and columns change places; a field point along +x then lies along +y."""
    camera = small_camera()
    square = replace(camera.lattice, kind="square", types=camera.lattice.types[:1], row_pitch_um=None, rotation_rad=0.0)
    plan = small_plan(4.0, replace(camera, lattice=square), cutout=41)
    ny, nx = plan.period
    ys, xs = [2, ny // 3], [3, nx // 2]
    base = (fx.LensletDiffraction(), fx.IrisDiffraction())

    def seen(angle: float, rows: list[int], columns: list[int]) -> np.ndarray:
        return PlaneResponse(plan, 0, (*base, fx.Coma(0.6, angle)), sampling=FAST).rows(rows, columns)

    along_x, along_y = seen(0.0, ys, xs), seen(math.pi / 2, xs, ys)
    turned = along_y.transpose(1, 0, 3, 2)
    assert difference(along_x, turned) < 1e-4
    wrong = seen(-math.pi / 2, xs, ys).transpose(1, 0, 3, 2)
    assert difference(along_x, wrong) > 0.05, "the opposite sign gives another H"


def test_without_effects_the_camera_is_ideal() -> None:
    plan = small_plan()
    response = PlaneResponse(plan, 0, ())
    scene = response.scene
    assert response.level == "geometric" and response.runs == 1 and response.kernel is None
    assert scene.iris.circular and scene.pupil_um == math.inf and scene.wavefront == () and scene.pixel_fill == 1
    assert len(set(scene.lattice.types)) == 1 and not scene.exact_rays and not scene.exact_defocus
    nominal = (
        fx.Crosstalk(0.0),
        fx.LensletGap(0.0),
        fx.ArrayRotation(0.0),
        fx.PitchError(0.0),
        fx.Spherical(0.0),
        fx.Bandwidth(0.0),
    )
    assert np.array_equal(responses(plan, ()), responses(plan, nominal))


def all_below(kind: type[fx.Effect]) -> list[type[fx.Effect]]:
    return [kind, *(deeper for below in kind.__subclasses__() for deeper in all_below(below))]


def test_the_catalogue_is_complete_and_follows_the_light() -> None:
    """An effect that its module forgets to name would never be planned."""
    own = {k.name for k in all_below(fx.Effect) if k.__module__.startswith("lfcal.") and not inspect.isabstract(k)}
    names = fx.CATALOGUE.names()
    assert len(set(names)) == len(names) == len(own) == 46 and set(names) == own
    way = ["lens_types", "iris_shape", "coma", "pixel_fill", "finite_source", "crosstalk", "stage_error", "cos4"]
    assert [names.index(n) for n in way] == sorted(names.index(n) for n in way)
    sensor = "stray_light colour_filter fixed_pattern dark_current shot_noise saturation read_noise quantisation"
    assert [name for name in names if name in sensor.split()] == sensor.split()
    for kind in fx.CATALOGUE:
        with pytest.raises((AttributeError, TypeError)):
            kind().name = "x"
        assert kind.title and kind.acts_on in fx.ActsOn


def test_disc_rule_integrates_polynomials() -> None:
    for degree in (5, 6, 11, 40):
        y, x, weight = np.array(disc_rule(degree)).T
        for i in range(degree + 1):
            for j in range(degree + 1 - i):
                exact = 0.0
                if not i % 2 and not j % 2:  # mean of y^i x^j over the unit disc
                    halves = math.gamma((i + 1) / 2) * math.gamma((j + 1) / 2) / math.gamma((i + j + 2) / 2)
                    exact = 2 * halves / (math.pi * (i + j + 2))
                assert float((weight * y**i * x**j).sum()) == pytest.approx(exact, abs=1e-14), (degree, i, j)


@pytest.mark.long
@pytest.mark.parametrize(("v", "diameter"), [(2.0, 200.0)])
def test_a_large_source_is_no_ring_of_seven_points(v: float, diameter: float) -> None:
    """Against a spiral of equal weights; seven points would be seven spots, up to twice the light off."""
    plan = small_plan(v)
    source = fx.FiniteSource(diameter)
    found = PlaneResponse(plan, 0, (*BASE, source), sampling=FAST)
    places = some_positions(plan, 1, 1)
    radius, count = source.image_px(outlook_of(plan, 0)) / 2, 120
    k = np.arange(count)
    r, turn = radius * np.sqrt((k + 0.5) / count), k * math.pi * (3 - math.sqrt(5))
    found_h = found.rows(*places)
    found.samples = tuple(
        LightSample(float(a * np.sin(b)), float(a * np.cos(b)), plan.camera.wavelength_um, 1 / count)
        for a, b in zip(r, turn, strict=True)
    )
    spiral = found.rows(*places)
    assert difference(found_h, spiral) < 0.03
    found.samples = tuple(LightSample(radius * y, radius * x, plan.camera.wavelength_um, w) for y, x, w in disc_rule(5))
    assert difference(found.rows(*places), spiral) > 0.1


def test_gaussian_shares_against_quadrature() -> None:
    x = np.linspace(-12, 12, 1201)

    def spot(width: float, shift: float = 0.0) -> np.ndarray:
        g = np.exp(-0.5 * ((x[None] - shift) ** 2 + x[:, None] ** 2) / width**2)
        return g / g.sum()

    assert share_moved(0.7, 1.2) == pytest.approx(np.abs(spot(1.2) - spot(1.2, 0.7)).sum(), rel=1e-4)
    assert share_widened(0.8, 1.5) == pytest.approx(np.abs(spot(0.8) - spot(1.5)).sum(), rel=1e-4)
    assert share_widened(1.0, 1.0) == 0 and share_widened(1.0, 1.0 + 1e-9) == pytest.approx(2 / math.e * 2e-9, rel=1e-3)


def test_overlap_of_discs() -> None:
    n = 801
    y, x = (np.arange(n) - n // 2)[:, None] / 380, (np.arange(n) - n // 2)[None] / 380
    unit = y**2 + x**2 <= 1
    for d, r in ((0.3, 1.0), (0.5, 1.2), (1.0, 0.4), (0.2, 1.3), (3.0, 1.0)):
        rim = y**2 + (x - d) ** 2 <= r * r
        assert overlap(d, r) == pytest.approx((unit & rim).sum() / unit.sum(), abs=2e-3)
    assert 1 - overlap(0.01, 1.0) == pytest.approx(1.27 * 0.01 / 2, rel=0.01)


def test_wavefront_rms_of_single_terms() -> None:
    """Rms of R_n^m cos(m theta) is 1/sqrt(n + 1), times 1/sqrt(2) for m > 0; defocus 2 rho² - 1 slopes 4 rho."""
    assert wavefront_rms(((4, 0, 1.0),))[0] == pytest.approx(1 / math.sqrt(5), rel=1e-12)
    assert wavefront_rms(((3, -1, 0.5),))[0] == pytest.approx(0.5 / math.sqrt(8), rel=1e-12)
    assert wavefront_rms(((2, 0, 1.0),))[1] == pytest.approx(math.sqrt(8), rel=1e-12)
    assert wavefront_rms(()) == (0.0, 0.0)


def test_backlash_is_a_play() -> None:
    commanded = np.zeros((7, 3))
    commanded[:, 2] = [0, 5, 10, 8, 5, 0, 5]
    moved = fx.Backlash(3.0).displace(commanded, small_camera(), np.random.default_rng(0))
    assert np.array_equal(moved[:, 2], [0, 0, 0, 2, 3, 3, 0])
    assert not moved[:, :2].any()


def test_filters_of_pixels_keep_the_light_and_are_not_turned() -> None:
    kernel = fx.PixelKernel(up_left=0.01, right=0.05, down=-0.02).kernel(small_camera())
    np.testing.assert_allclose(kernel, [[0.01, 0, 0], [0, 0.96, 0.05], [0, -0.02, 0]], atol=1e-15)
    kernel = fx.Crosstalk(0.02).kernel(small_camera())
    assert kernel.sum() == pytest.approx(1) and kernel[0, 1] == pytest.approx(0.02 * 0.96)
    dot = np.zeros((1, 5, 5), np.float32)
    dot[0, 2, 1] = 1
    assert np.allclose(filtered(dot, kernel)[0, 1:4, 0:3], kernel, atol=1e-7)
    uneven = np.array([[0.0, 0.1, 0.0], [0.2, 0.6, 0.0], [0.0, 0.1, 0.0]])
    assert filtered(dot, uneven)[0, 2, 0] == np.float32(0.2)


REFUSED: list[tuple[type[fx.Effect], dict[str, Any], str]] = [
    (fx.PixelFill, {"fill_factor": 1.5}, "fill_factor"),
    (fx.PixelFill, {"fill_factor": 0.0}, "fill_factor"),
    (fx.Crosstalk, {"share": -0.1}, "share"),
    (fx.Bandwidth, {"width_um": -0.02}, "width_um"),
    (fx.Spherical, {"waves": math.nan}, "waves"),
    (fx.LensletGap, {"error_um": math.inf}, "error_um"),
    (fx.IrisShape, {"curvature": 1.2}, "curvature"),
    (fx.PositioningError, {"rms_um": -1.0}, "rms_um"),
    (fx.AngularResponse, {"half_angle_rad": 1.6}, "half_angle_rad"),
    (fx.SensorNonlinearity, {"share": 0.6}, "share"),
    (fx.LensletSpherical, {"type_1": math.inf}, "type_1"),
    (fx.FieldCurvature, {"radius_um": 0.0}, "radius_um"),
    (fx.IndexMismatch, {"index": 0.9}, "index"),
    (fx.IndexMismatch, {"index": math.nan}, "index"),
    (fx.IndexMismatch, {"depth_um": -1.0}, "depth"),
    (fx.IndexMismatch, {"depth_um": math.inf}, "depth"),
    *((fx.MissingLenslets, {"lenslets": bad}, "defective lenslets") for bad in (((0.5, 0, 0.0),), ((0, 0),), (3,))),
    *((fx.MissingLenslets, {"lenslets": ((0, 0, bad),)}, "defective lenslets") for bad in (1.5, math.nan)),
]


def test_magnitudes_are_checked_where_they_are_given() -> None:
    for kind, given, word in REFUSED:
        with pytest.raises(InputError, match=word) as error:
            kind(**given)
        assert "\n" not in str(error.value), (kind, given)
    with pytest.raises(InputError, match="Zernike term"):
        responses(small_plan(), (fx.Zernike(((3, 2, 0.1),)),))


def test_what_does_not_fit_the_camera_is_refused_in_one_line() -> None:
    far = small_plan(4.0, small_camera(160, 6000), anchor=(70.0, 5700.0))
    edge = small_plan(4.0, small_camera(160, 3000), anchor=(70.0, 2800.0))
    for plan, effect, title in (
        (small_plan(), fx.CoverGlass(500.0), "cover glass"),
        (small_plan(), fx.ChromaticFocus(1e8, 0.1), "longitudinal colour"),
        (edge, fx.ArrayTilt(0.0, -0.2), "array tilt"),
        (far, fx.FieldCurvature(-1.0), fx.FieldCurvature.title),
        (far, fx.Distortion(0.5), fx.Distortion.title),
    ):
        with pytest.raises(InputError, match=title) as error:
            responses(plan, (*BASE, effect))
        assert "\n" not in str(error.value), title


EXTREMES: list[fx.Effect] = [
    *(fx.FieldCurvature(r) for r in (1.0, -1.0, 3e3, -3e3, 1e12)),
    *(fx.FieldAberrations(c, a, spherical=w) for c, a, w in ((1e-300, 0.0, 0.0), (-1.0, 0.5, 0.2))),
    *(fx.Distortion(k, r) for k, r in ((0.5, 1.0), (-0.5, 1e9), (0.5, 1e4), (-0.01, 1e4))),
    *(fx.ArrayTilt(a, b) for a, b in ((0.2, 0.2), (-0.2, 0.0), (0.0, -0.002))),
    *(fx.AngularResponse(a) for a in (0.01, 1.57)),
    *(fx.CoverGlass(*g) for g in ((1e6, 4.0, 0.0), (200.0, 4.0, 0.0), (250.0, 1.5, 1.0))),
    *(fx.ChromaticFocus(r, w) for r, w in ((1e9, 0.1), (-2e4, 0.3))),
    *(fx.LensletDispersion(v, w) for v, w in ((5.0, 0.4), (1e15, 0.1))),
    *(fx.LensletSpherical(w) for w in (-4.0, 1e-300)),
    fx.MissingLenslets(((-1_000_000, 1_000_000, 0.0), (0, 0, 1e-300), (1, 0, 1.0))),
]

NOMINAL: dict[str, fx.Effect] = {
    "field_aberrations": fx.FieldAberrations(0.0, 0.0),
    "field_curvature": fx.FieldCurvature(1e15),
    "cover_glass": fx.CoverGlass(0.0),
    "distortion": fx.Distortion(0.0),
    "array_tilt": fx.ArrayTilt(0.0, 0.0),
    "chromatic_focus": fx.ChromaticFocus(0.0),
    "ghost": fx.Ghost(0.0),
    "lenslet_dispersion": fx.LensletDispersion(5.0, 0.0),
    "lenslet_spherical": fx.LensletSpherical(0.0),
    "nonlinearity": fx.SensorNonlinearity(0.0),
    "missing_lenslets": fx.MissingLenslets(((0, 0, 1.0),)),
}
"""Effects of no size: the scene stays as it is, and so does the work."""


@cache
def plan_at(v: float, side: bool) -> ScanPlan:
    if not side:
        return small_plan(v, cutout=31)
    return small_plan(v, small_camera(160, 8000), anchor=(70.0, 7900.0), cutout=31)


@pytest.mark.few(4)
@pytest.mark.parametrize("side", [long(False, id="axis"), pytest.param(True, id="edge")])
@pytest.mark.parametrize("effect", EXTREMES, ids=repr)
def test_extremes_are_computed_or_refused(effect: fx.Effect, side: bool) -> None:
    for v in (0.0, 4.0, -3.0):
        for base in ((), BASE):
            try:
                found = PlaneResponse(plan_at(v, side), 0, (*base, effect), sampling=FAST).rows([0], [3])
            except LfcalError as error:
                assert "\n" not in str(error) and len(str(error)) < 480
                continue
            assert np.isfinite(found).all() and found.min() >= -1e-6
            assert found.sum(dtype=np.float64) <= 1.005


def test_effects_of_no_size_change_neither_scene_nor_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engines do the same work, call by call."""
    plan = small_plan(cutout=31)
    counted: list[str] = []
    for module, function in ((wave, "build_tables"), (wave, "respond"), (geometric, "draw_spots")):
        plain = getattr(module, function)
        monkeypatch.setattr(module, function, lambda *a, _f=plain, _n=function: counted.append(_n) or _f(*a))

    def calls(*effects: fx.Effect) -> list[str]:
        counted.clear()
        PlaneResponse(plan, 0, effects, sampling=FAST).rows([2], [3, 4])
        return list(counted)

    rays, waves = calls(), calls(*BASE)
    assert rays and waves and rays != waves
    for name, effect in NOMINAL.items():
        assert scene_for(plan, 0, (*BASE, effect)) == scene_for(plan, 0, BASE), name
        assert calls(effect) == rays, name
    assert calls(*BASE, *NOMINAL.values()) == waves


def test_rare_effects_are_off_unless_given_or_switched_on() -> None:
    plan, names = small_plan(cutout=31), [*NOMINAL, "angular_response"]
    for frames in (False, True):
        found = plan_effects(plan, 1e-4, frames=frames)
        assert not any(found.row(name).on for name in names)
    wanted = plan_effects(plan, overrides=dict.fromkeys(names, "on"), frames=True)
    for name in names:
        assert wanted.row(name).on and wanted.row(name).effect == fx.CATALOGUE.get(name)(), name
