"""Every effect's estimate against what switching it on and off measures."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor, preset
from lfcal.simulate.effects import (
    CATALOGUE,
    ActsOn,
    ArrayRotation,
    Backlash,
    Bandwidth,
    Coma,
    Crosstalk,
    DepthError,
    Drift,
    Effect,
    ExactAngles,
    FiniteSource,
    IrisDiffraction,
    IrisShape,
    LensLaw,
    LensletDiffraction,
    LensletGap,
    LensTypeDefocus,
    MechanicalVignetting,
    PitchError,
    PixelFill,
    PixelKernel,
    PositioningError,
    Spherical,
    Telecentricity,
    Zernike,
)
from lfcal.simulate.effects.aberrations import wavefront_rms
from lfcal.simulate.effects.base import LightSample
from lfcal.simulate.effects.field import overlap
from lfcal.simulate.effects.light import disc_rule
from lfcal.simulate.effects.outlook import share_moved, share_widened
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import filtered, outlook_of
from tests.simulate.common import BASE, FAST, difference, responses, small_camera, small_plan, some_positions, switched

SCENES = (4.0, -3.0, 2.2, 0.5)
"""Virtual depths: the usual one, before the array with large spots, near focus, near the native plane."""

EVERYWHERE: list[Effect] = [
    LensTypeDefocus(),
    LensletDiffraction(),
    IrisDiffraction(),
    IrisShape(),
    Telecentricity(),
    ExactAngles(),
    LensLaw(),
    Spherical(0.25),
    Coma(0.25, 0.7),
    LensletGap(5.0),
    PitchError(1e-3),
    Crosstalk(0.01),
]
"""Measured in the first two scenes."""

SOMEWHERE: list[tuple[float, Effect]] = [
    (2.2, LensTypeDefocus()),
    (2.2, LensletDiffraction()),
    (2.2, Spherical(0.05)),
    (-3.0, Spherical(1.0)),
    (4.0, Zernike(((2, 2, 0.2), (3, 3, 0.1)))),
    (-3.0, Zernike(((3, -1, 0.3),))),
    (4.0, LensletGap(-2.0)),
    (4.0, ArrayRotation(math.radians(0.05))),
    (-3.0, ArrayRotation(math.radians(-0.2))),
    (4.0, FiniteSource(50.0)),
    (-3.0, FiniteSource(80.0)),
    (0.5, LensTypeDefocus()),
    (0.5, LensLaw()),
    (0.5, LensletDiffraction()),
    (0.5, Telecentricity()),
    (0.5, Spherical(0.25)),
    (0.5, LensletGap(5.0)),
    (0.5, Crosstalk(0.01)),
    (4.0, PixelFill(0.5)),
    (-3.0, PixelFill(0.9)),
    (4.0, Crosstalk(0.03)),
    (4.0, PixelKernel(right=0.05)),
    (-3.0, PixelKernel(up=0.03, down=0.03, left=0.01)),
]
"""Other magnitudes, each in the scene where it is telling."""


def label(effect: Effect) -> str:
    return repr(effect).replace("(", "-").replace(")", "")


@pytest.fixture(scope="module")
def plans() -> dict[float, ScanPlan]:
    return {v: small_plan(v) for v in SCENES}


@pytest.fixture(scope="module")
def without() -> dict[float, np.ndarray]:
    """Responses of the described camera, filled as they are needed."""
    return {}


CASES = [(v, e) for v in SCENES[:2] for e in EVERYWHERE] + SOMEWHERE


@pytest.mark.few(8)
@pytest.mark.parametrize(("v", "effect"), CASES, ids=[f"{v:g}-{label(e)}" for v, e in CASES])
def test_estimate_is_honest(
    plans: dict[float, ScanPlan], without: dict[float, np.ndarray], v: float, effect: Effect
) -> None:
    plan, base = plans[v], without[v] if v in without else without.setdefault(v, responses(plans[v], BASE))
    if any(e.name == effect.name for e in BASE):
        measured = difference(responses(plan, tuple(e for e in BASE if e.name != effect.name)), base)
    else:
        measured = difference(base, responses(plan, (*BASE, effect)))
    estimate = effect.estimate(outlook_of(plan, 0))
    assert not estimate.upper_bound
    assert 0.5 * measured <= estimate.error <= 2 * measured, (measured, estimate)


@pytest.mark.few(1)
@pytest.mark.parametrize(("v", "width"), [(4.0, 0.02), (2.2, 0.1)])
def test_bandwidth_estimate(plans: dict[float, ScanPlan], v: float, width: float) -> None:
    """Measured with the lenslets' fields added: their interference is the first to be washed out."""
    effect, sampling = Bandwidth(width), Sampling(nodes_per_px=4, margin_px=12, coherent=True)
    ys, xs = [4], [5, 20]
    off = PlaneResponse(plans[v], 0, BASE, sampling=sampling).rows(ys, xs)
    on = PlaneResponse(plans[v], 0, (*BASE, effect), sampling=sampling).rows(ys, xs)
    estimate = effect.estimate(outlook_of(plans[v], 0)).error
    assert 0.5 * estimate <= difference(off, on) <= 2 * estimate


@pytest.mark.few(1)
@pytest.mark.parametrize(("v", "faster"), [(3.0, 2.5), (-2.0, 2.0)])
def test_pixels_larger_than_the_fringes_hide_the_bandwidth(v: float, faster: float) -> None:
    camera = preset("bench")
    assert isinstance(camera.optics, MainLens)
    gap = camera.lattice.gap_um / faster
    lattice = replace(camera.lattice, gap_um=gap, types=tuple(LensType.focused_at(k, gap) for k in (2.0, 3.0, 4.0)))
    optics = replace(camera.optics, f_number=camera.optics.f_number / faster)
    plan = ScanPlan.for_camera(replace(camera, optics=optics, lattice=lattice), virtual_depths=[v])
    effect, sampling = Bandwidth(0.1), Sampling(nodes_per_px=8, margin_px=12, coherent=True)
    off = PlaneResponse(plan, 0, BASE, sampling=sampling).rows([2], [9])
    on = PlaneResponse(plan, 0, (*BASE, effect), sampling=sampling).rows([2], [9])
    estimate = effect.estimate(outlook_of(plan, 0)).error
    assert 0.5 * estimate <= difference(off, on) <= 2 * estimate


MICROSCOPE: list[Effect] = [
    LensletDiffraction(),
    Spherical(0.25),
    LensletGap(20.0),
    ArrayRotation(0.005),
    FiniteSource(1.0),
    Crosstalk(0.01),
]


@pytest.mark.few(2)
@pytest.mark.parametrize("effect", MICROSCOPE, ids=label)
def test_microscope_estimates(effect: Effect) -> None:
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[25.0])
    base = (LensTypeDefocus(), LensletDiffraction())
    on = responses(plan, (*(e for e in base if e.name != effect.name), effect))
    off = responses(plan, tuple(e for e in base if e.name != effect.name))
    estimate = effect.estimate(outlook_of(plan, 0)).error
    assert 0.5 * estimate <= difference(off, on) <= 2 * estimate


def test_estimates_of_the_r29() -> None:
    """The table of the r29 at v = 4: every optical effect that matters there, within a factor of two."""
    camera = preset("r29")
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0])
    for effect in (LensTypeDefocus(), IrisDiffraction(), ExactAngles()):
        others = tuple(e for e in BASE if e.name != effect.name)
        ys, xs = [20], [10, 60]
        on = PlaneResponse(plan, 0, (*others, effect), sampling=FAST).rows(ys, xs)
        off = PlaneResponse(plan, 0, others, sampling=FAST).rows(ys, xs)
        estimate = effect.estimate(outlook_of(plan, 0)).error
        assert 0.5 * estimate <= difference(off, on) <= 2 * estimate, effect.name


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


def test_exact_angles_displace_the_fringes_of_a_small_iris() -> None:
    """At a Fresnel number of 8, the phase counts: a displacement of spots by 0.018 px would change 1 % of the light."""
    types = (LensType(615.0), LensType(461.0), LensType(384.6))
    lattice = LensletLattice("hexagonal", 39.4, 307.7, types, clear_um=34.1)
    camera = Camera("fringes", MainLens(25e3, 5.91, 1e5), lattice, Sensor((800, 800), 2.2, 12, 20e3, 5.0), 0.473)
    plan = ScanPlan.for_camera(camera, virtual_depths=[-3.0], cutout=41)
    effects = (LensTypeDefocus(), LensletDiffraction(), Telecentricity())
    off, on = (
        PlaneResponse(plan, 0, some, sampling=FAST).rows([4], [6]) for some in (effects, (*effects, ExactAngles()))
    )
    assert 0.05 < difference(off, on) <= ExactAngles().estimate(outlook_of(plan, 0)).error


def test_vignetting_is_measured_off_axis() -> None:
    """A region at the sensor's edge, the only place where a rim cuts the pupil."""
    plan = small_plan(4.0, small_camera(160, 1200), anchor=(70.0, 1100.0))
    rim = MechanicalVignetting(30e3, 1.02)
    estimate = rim.estimate(outlook_of(plan, 0))
    assert estimate.error > 0.02
    assert 0.5 * estimate.error <= switched(plan, rim) <= 2 * estimate.error
    assert MechanicalVignetting().estimate(outlook_of(small_plan(), 0)).error == 0


@pytest.mark.parametrize(("v", "step"), [(4.0, 6.0), (-3.0, 12.0), (2.2, 3.0)])
def test_motion_estimates(plans: dict[float, ScanPlan], v: float, step: float) -> None:
    """Stage error and drift by source points that are displaced; a fixed displacement stands for their mean."""
    plan = plans[v]
    outlook = outlook_of(plan, 0)
    response = PlaneResponse(plan, 0, BASE, sampling=FAST)
    pixel = response.scene.pixel_um
    ys, xs = some_positions(plan)

    def mean_error(shifts: np.ndarray) -> float:
        total = light = 0.0
        for k, (y, x) in enumerate((y, x) for y in ys for x in xs):
            true = response.engine().point(y * pixel, x * pixel)
            dy, dx = np.clip(shifts[k % len(shifts)], -0.499 * pixel, 0.499 * pixel)
            total += np.abs(response.engine().point(y * pixel + dy, x * pixel + dx) - true).sum()
            light += true.sum()
        return float(total / light)

    camera = plan.camera
    commanded = plan.object_um(plan.order_indices())[:, ::-1]
    rng = np.random.default_rng(1)
    scale = pixel / camera.step_um(outlook.z_um)
    for effect, count in ((PositioningError(step / 3), len(commanded)), (Drift(step / 2, step / 2), len(commanded))):
        moved = effect.displace(commanded, camera, rng)[:, 1:] * scale
        measured = mean_error(moved[rng.permutation(count)])
        estimate = effect.estimate(outlook).error
        assert 0.5 * measured <= estimate <= 2 * measured, (effect.name, measured, estimate)
    backlash = Backlash(step)
    moved = backlash.displace(commanded, camera, rng)[:, 1:] * scale
    measured = mean_error(moved[rng.permutation(len(moved))])
    assert measured <= backlash.estimate(outlook).error <= 4 * measured


@pytest.mark.parametrize("v", [4.0, -3.0])
def test_depth_error(plans: dict[float, ScanPlan], v: float) -> None:
    plan, effect = plans[v], DepthError(200.0)
    ys, xs = some_positions(plan)
    true = PlaneResponse(plan, 0, BASE, sampling=FAST).rows(ys, xs)
    wrong = PlaneResponse(plan, 0, BASE, sampling=FAST, depth_error_um=math.sqrt(2 / math.pi) * 200.0).rows(ys, xs)
    estimate = effect.estimate(outlook_of(plan, 0)).error
    assert 0.5 * estimate <= difference(true, wrong) <= 2 * estimate


def test_every_effect_has_a_word_on_the_microscope() -> None:
    camera = preset("lfm_20x05")
    outlook = outlook_of(ScanPlan.for_camera(camera, depths_um=[25.0], cutout=91), 0)
    for kind in CATALOGUE:
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
    base = (LensletDiffraction(), IrisDiffraction())

    def seen(angle: float, rows: list[int], columns: list[int]) -> np.ndarray:
        return PlaneResponse(plan, 0, (*base, Coma(0.6, angle)), sampling=FAST).rows(rows, columns)

    along_x, along_y = seen(0.0, ys, xs), seen(math.pi / 2, xs, ys)
    turned = along_y.transpose(1, 0, 3, 2)
    assert difference(along_x, turned) < 1e-4
    assert difference(along_x, seen(-math.pi / 2, xs, ys).transpose(1, 0, 3, 2)) > 0.05, "the other way is another H"


def test_the_empty_tuple_is_the_ideal_camera(plans: dict[float, ScanPlan]) -> None:
    response = PlaneResponse(plans[4.0], 0, ())
    scene = response.scene
    assert response.level == "geometric" and response.runs == 1 and response.kernel is None
    assert scene.iris.circular and scene.pupil_um == math.inf and scene.wavefront == () and scene.pixel_fill == 1
    assert len(set(scene.lattice.types)) == 1 and not scene.exact_rays and not scene.exact_defocus
    nominal = (Crosstalk(0.0), LensletGap(0.0), ArrayRotation(0.0), PitchError(0.0), Spherical(0.0), Bandwidth(0.0))
    assert np.array_equal(responses(plans[4.0], ()), responses(plans[4.0], (*nominal, FiniteSource(1e-12))[:-1]))


def test_effects_are_frozen_and_named_once() -> None:
    assert len({kind.name for kind in CATALOGUE}) == len(CATALOGUE)
    for kind in CATALOGUE:
        with pytest.raises((AttributeError, TypeError)):
            kind().name = "x"  # type: ignore[misc]
        assert kind.title and kind.acts_on in ActsOn


def all_below(kind: type[Effect]) -> list[type[Effect]]:
    return [kind, *(deeper for below in kind.__subclasses__() for deeper in all_below(below))]


def test_the_catalogue_lacks_no_effect_and_follows_the_light() -> None:
    """An effect that its module forgets to name would never be planned."""
    own = {k.name for k in all_below(Effect) if k.__module__.startswith("lfcal.") and not inspect.isabstract(k)}
    names = CATALOGUE.names()
    assert set(names) == own and len(own) == 46
    way = ["lens_types", "iris_shape", "coma", "pixel_fill", "finite_source", "crosstalk", "stage_error", "cos4"]
    assert [names.index(n) for n in way] == sorted(names.index(n) for n in way)
    sensor = "stray_light colour_filter fixed_pattern dark_current shot_noise saturation read_noise quantisation"
    assert [name for name in names if name in sensor.split()] == sensor.split()


# -- oracles of the pieces -----------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [5, 6, 11, 40])
def test_disc_rule_integrates_polynomials(degree: int) -> None:
    rule = np.array(disc_rule(degree))
    for i in range(degree + 1):
        for j in range(degree + 1 - i):
            if i % 2 or j % 2:
                exact = 0.0
            else:  # mean of y^i x^j over the unit disc
                exact = (
                    2
                    * math.gamma((i + 1) / 2)
                    * math.gamma((j + 1) / 2)
                    / (math.pi * (i + j + 2) * math.gamma((i + j + 2) / 2))
                )
            assert float((rule[:, 2] * rule[:, 0] ** i * rule[:, 1] ** j).sum()) == pytest.approx(exact, abs=1e-14)


@pytest.mark.long
@pytest.mark.parametrize(("v", "diameter"), [(2.0, 200.0), (4.0, 500.0)])
def test_a_large_source_is_no_ring_of_seven_points(v: float, diameter: float) -> None:
    """Against a spiral of equal weights; seven points would be seven spots, up to twice the light off."""
    plan = small_plan(v)
    source = FiniteSource(diameter)
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


def test_displaced_sources_share_the_plane_s_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of a plane's tables depends on where its sources are: they are built once."""
    from lfcal.simulate.engines import _wave as wave

    built: list[object] = []
    tables = wave.build_tables
    monkeypatch.setattr(wave, "build_tables", lambda *given: built.append(given) or tables(*given))
    responses(small_plan(), (*BASE, FiniteSource(100.0)))
    assert len(built) == 1


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
    moved = Backlash(3.0).displace(commanded, small_camera(), np.random.default_rng(0))
    assert np.array_equal(moved[:, 2], [0, 0, 0, 2, 3, 3, 0])
    assert not moved[:, :2].any()


def test_a_free_filter_moves_light_to_the_neighbours_that_it_names() -> None:
    kernel = PixelKernel(up_left=0.01, right=0.05, down=-0.02).kernel(small_camera())
    np.testing.assert_allclose(kernel, [[0.01, 0, 0], [0, 0.96, 0.05], [0, -0.02, 0]], atol=1e-15)


def test_crosstalk_keeps_light_and_is_symmetric() -> None:
    kernel = Crosstalk(0.02).kernel(small_camera())
    assert kernel.sum() == pytest.approx(1) and kernel[0, 1] == pytest.approx(0.02 * 0.96)
    dot = np.zeros((1, 5, 5), np.float32)
    dot[0, 2, 1] = 1
    assert np.allclose(filtered(dot, kernel)[0, 1:4, 0:3], kernel, atol=1e-7)
    uneven = np.array([[0.0, 0.1, 0.0], [0.2, 0.6, 0.0], [0.0, 0.1, 0.0]])
    assert filtered(dot, uneven)[0, 2, 0] == np.float32(0.2), "the kernel must not be turned round"


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: PixelFill(1.5), "fill_factor"),
        (lambda: PixelFill(0.0), "fill_factor"),
        (lambda: Crosstalk(-0.1), "share"),
        (lambda: Bandwidth(-0.02), "width_um"),
        (lambda: Spherical(math.nan), "waves"),
        (lambda: LensletGap(math.inf), "error_um"),
        (lambda: IrisShape(curvature=1.2), "curvature"),
        (lambda: PositioningError(-1.0), "rms_um"),
    ],
)
def test_magnitudes_are_checked_where_they_are_given(make: Callable[[], Effect], word: str) -> None:
    with pytest.raises(InputError, match=word) as error:
        make()
    assert "\n" not in str(error.value)


def test_terms_are_checked_by_the_scene() -> None:
    with pytest.raises(InputError, match="Zernike term"):
        responses(small_plan(), (Zernike(((3, 2, 0.1),)),))
