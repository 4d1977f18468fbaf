"""Effects that vary over the field or with the wavelength: curvature, distortion, aberrations, colour, a bent array."""

from __future__ import annotations

import cmath
import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lfcal.camera import Camera, LatticeDistortion, ScanPlan, preset
from lfcal.judge import inspect as inspect_matrix
from lfcal.judge.quality._lattice import wave_vectors
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import lattice_anchor_of
from lfcal.simulate import PlaneResponse, Sampling, SimulatedCamera, at_wavelength, origin_of, outlook_of, plan_effects
from lfcal.simulate import effects as fx
from lfcal.simulate.engines import engine_for
from lfcal.simulate.staging import ideal_scene, light_samples, scene_of
from tests.simulate.common import BASE, FAST, difference, long, responses, small_camera, small_plan
from tests.simulate.scenes import microscope_scene, relative_error


def far_plan(v: float = 4.0, **options: object) -> ScanPlan:
    """Return a plan at the sensor's edge, 15 mm from the axis."""
    return small_plan(v, small_camera(160, 6000), anchor=(70.0, 5700.0), **options)


def test_a_curved_field_is_another_depth() -> None:
    """At 15 mm from the axis a surface of 200 mm lies 0.6 mm nearer: the same as a plane whose image does."""
    plan, effect = far_plan(cutout=41), fx.FieldCurvature(-200e3)
    y, x = outlook_of(plan, 0).field_um
    other = far_plan(4.0 - (x * x + y * y) / 400e3 / plan.camera.lattice.gap_um, cutout=41)
    for base in (BASE, (fx.LensTypeDefocus(),)):
        assert difference(responses(other, base), responses(plan, (*base, effect))) < 1e-4
    scope = preset("lfm_20x05")
    anchor = tuple(np.add(scope.sensor.centre_px, (0, 800)))
    plans = [ScanPlan.for_camera(scope, depths_um=[z], anchor=anchor, cutout=91) for z in (25.0, 22.0)]
    square = float(np.square(outlook_of(plans[0], 0).field_um).sum())
    # 3 µm nearer are M² 3 µm of the image
    effect, base = fx.FieldCurvature(square / 2 / (3.0 * 400)), (fx.LensTypeDefocus(), fx.LensletDiffraction())
    assert difference(responses(plans[1], base), responses(plans[0], (*base, effect))) < 1e-4


@pytest.mark.few(1)
@pytest.mark.parametrize("level", ["geometric", "wave", long("reference")])
def test_distortion_puts_every_source_in_its_own_place(level: str) -> None:
    """Against single points at k h³ from the axis, each with its own h; windows of the others are cut out."""
    plan = far_plan(cutout=(41, 45))
    k = 0.003 / 10e3**2
    found = PlaneResponse(plan, 0, (*BASE, fx.Distortion(0.003)), level=level, sampling=FAST)
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
    scene = PlaneResponse(plan, 0, (fx.Distortion(0.02),)).scene
    ends = [scene.source_um(0, x)[1] for x in (0, 40)]
    h = outlook_of(plan, 0).field_um[1]
    assert (ends[1] - ends[0]) / (40 * scene.pixel_um) - 1 == pytest.approx(3 * 0.02 * h * h / 10e3**2, rel=1e-3)
    across = [scene.source_um(y, 0)[0] for y in (0, 25)]
    assert (across[1] - across[0]) / (25 * scene.pixel_um) - 1 == pytest.approx(0.02 * h * h / 10e3**2, rel=1e-2)


def test_distorted_frames_hold_the_light_where_h_has_it() -> None:
    plan = replace(far_plan(), period=(2, 2))
    effects = (*BASE, fx.Distortion(0.003))
    for more in ((), (fx.FiniteSource(30.0),)):
        camera = SimulatedCamera(plan, (*effects, *more), sampling=FAST)
        found = camera.light(3)
        (_, y, x), (row, column) = camera.position(3), origin_of(camera.plan)[:2]
        nt, ns = plan.cutout
        window = found[row + y - nt // 2 :, column + x - ns // 2 :][:nt, :ns] / camera.electrons_per_unit(0)
        h = PlaneResponse(plan, 0, (*effects, *more), sampling=FAST).rows([y], [x])[0, 0]
        assert difference(h, window) < 5e-3


def test_the_microscope_s_separable_path_reaches_displaced_sources() -> None:
    scene = microscope_scene(25.0, cutout=(31, 31))
    moved = replace(scene, image_map=((40.0, 0.0, 0.0), (-240.0, 0.0, 0.0)))
    whole = replace(scene, cutout=(101, 101))
    sampling = Sampling(nodes_per_px=3)
    found = engine_for(moved, "debye", sampling).rows([1], [2])[0, 0]
    wanted = engine_for(whole, "debye", sampling).rows([6], [-28])[0, 0][30:61, 65:96]
    assert relative_error(found, wanted) < 5e-3


def test_neither_acts_on_the_axis() -> None:
    outlook = replace(outlook_of(small_plan(), 0), field_um=(0.0, 0.0))
    scene = PlaneResponse(small_plan(), 0, ()).scene
    for effect in (fx.FieldCurvature(), fx.Distortion()):
        assert effect.on_scene(scene, outlook) is scene
        assert effect.estimate(outlook).error == 0


CAMERA = small_camera(2400, 3000)
LAW = fx.FieldAberrations(0.4, 0.3, 0.05, -0.1, 0.2, 8e3)


@pytest.mark.parametrize("anchor", [(100.0, 2800.0), (2200.0, 300.0)])
@pytest.mark.few(1)
def test_light_at_a_place_is_that_of_its_wavefront(anchor: tuple[float, float]) -> None:
    """Against a wavefront that is the same everywhere, with terms computed by hand."""
    plan = small_plan(3.0, CAMERA, anchor=anchor, cutout=31)
    y, x = outlook_of(plan, 0).field_um
    h, turn = np.hypot(y, x) / 8e3, cmath.phase(complex(x, y))
    coma, along = 0.4 * h, 0.3 * h**2
    linear = (-0.1 + 0.05j) * complex(x, y) / 8e3
    terms = (
        (3, 1, coma * np.cos(turn)),
        (3, -1, coma * np.sin(turn)),
        (2, 2, along * np.cos(2 * turn) + linear.real),
        (2, -2, along * np.sin(2 * turn) + linear.imag),
        (4, 0, 0.2 * h**2),
    )
    found, plain = responses(plan, (*BASE, LAW)), responses(plan, BASE)
    assert difference(found, responses(plan, (*BASE, fx.Zernike(terms)))) < 1e-5
    # a wavefront on the axis adds to it, term by term
    both = responses(plan, (*BASE, fx.Zernike(((3, 1, 0.1), (4, 0, -0.1))), LAW))
    summed = tuple((n, m, w + {(3, 1): 0.1, (4, 0): -0.1}.get((n, m), 0.0)) for n, m, w in terms)
    assert difference(both, responses(plan, (*BASE, fx.Zernike(summed)))) < 1e-5
    assert difference(found, plain) > 0.05


def test_coma_points_from_the_axis_and_turns_with_the_field() -> None:
    """Places opposite to each other have opposite coma and the same astigmatism."""
    there, back = ({t[:2]: t[2] for t in LAW.terms_at(at)} for at in ((3e3, 4e3), (-3e3, -4e3)))
    assert there[3, 1] == pytest.approx(0.4 * 0.5) and there[3, -1] == pytest.approx(0.4 * 3 / 8)
    assert back[3, 1] == -there[3, 1] and back[4, 0] == there[4, 0]
    only = replace(LAW, astigmatism_y=0.0, astigmatism_x=0.0)
    assert {t[:2]: t[2] for t in only.terms_at((-3e3, -4e3))}[2, 2] == pytest.approx(0.3 * (16 - 9) / 64)
    assert LAW.terms_at((0.0, 0.0)) == ()


def wide(width: float = 0.1) -> Camera:
    return replace(small_camera(), bandwidth_um=width)


def test_focal_lengths_are_those_of_a_catalogue_glass() -> None:
    """N-BK7 by its Sellmeier equation (Schott), described to the effect by its Abbe number alone."""

    def index(lam: float) -> float:
        b, c = (1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)
        return math.sqrt(1 + sum(bk * lam**2 / (lam**2 - ck) for bk, ck in zip(b, c, strict=True)))

    scene = PlaneResponse(small_plan(), 0, (fx.LensTypeDefocus(), fx.LensletDispersion(64.17, 0.2))).scene
    for lam in (0.48, 0.52, 0.6, 0.65):
        for kind, other in zip(scene.lattice.types, at_wavelength(scene, lam).lattice.types, strict=True):
            exact = (index(scene.wavelength_um) - 1) / (index(lam) - 1)
            assert other.focal_length_um / kind.focal_length_um == pytest.approx(exact, rel=5e-4)
    assert at_wavelength(scene, scene.wavelength_um) == scene


def test_each_wavelength_is_seen_at_its_own_depth() -> None:
    """By rays, which else do not depend on the wavelength: a sum over planes, weighted by Gauss and Legendre."""
    camera = wide()
    plan, rate = small_plan(4.0, camera, cutout=41), 2000.0
    found = PlaneResponse(plan, 0, (fx.LensTypeDefocus(), fx.ChromaticFocus(rate)))
    assert found.level == "geometric" and found.runs > 2
    nodes, weights = np.polynomial.legendre.leggauss(found.runs)
    wanted = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        v = 4.0 + rate * 0.05 * node / camera.lattice.gap_um
        wanted = wanted + weight / 2 * responses(small_plan(v, camera, cutout=41), (fx.LensTypeDefocus(),))
    assert difference(responses(plan, (fx.LensTypeDefocus(), fx.ChromaticFocus(rate))), wanted) < 1e-4


def test_a_microscope_s_image_moves_by_its_depth() -> None:
    scene = microscope_scene(5.0, colour_rate=4000.0)
    moved = at_wavelength(scene, scene.wavelength_um + 0.1)
    assert moved.image_um - scene.image_um == pytest.approx(400.0)
    assert moved.z_um - scene.z_um == pytest.approx(-1.0), "M² = 400 times less, the other way"


def test_wavelengths_are_spread_with_bandwidth_left_out() -> None:
    outlook = outlook_of(small_plan(4.0, wide()), 0)
    colour = fx.ChromaticFocus(500.0)
    alone = light_samples((colour,), outlook)
    assert len(alone) >= 3 and sum(s.weight for s in alone) == pytest.approx(1)
    assert np.ptp([s.wavelength_um for s in alone]) > 0.05
    assert light_samples((colour, fx.Bandwidth()), outlook) == alone, "once, not twice"
    assert len(light_samples((fx.ChromaticFocus(2e4), fx.Bandwidth()), outlook)) > len(alone), "a wide blur takes more"
    given = light_samples((fx.ChromaticFocus(500.0, 0.02),), outlook)
    assert np.ptp([s.wavelength_um for s in given]) < 0.02
    assert len(light_samples((), outlook)) == 1


def test_monochromatic_light_has_no_colour() -> None:
    plan = small_plan(4.0, wide(0.0))
    for effect in (fx.ChromaticFocus(), fx.LensletDispersion(), fx.ChromaticFocus(0.0, 0.1)):
        response = PlaneResponse(plan, 0, (*BASE, effect), sampling=FAST)
        assert response.runs == 1 and response.scene == PlaneResponse(plan, 0, BASE, sampling=FAST).scene
        assert effect.estimate(outlook_of(plan, 0)).error == 0


def test_the_planner_takes_the_width_that_is_given() -> None:
    plan = small_plan(4.0, wide(0.01))
    plain = plan_effects(plan, 0.2)
    assert not plain.row("bandwidth").on
    found = plan_effects(plan, 0.2, effects=(fx.ChromaticFocus(5e4), fx.Bandwidth(0.02)))
    assert found.row("chromatic_focus").on and found.row("bandwidth").on
    assert "needed by longitudinal colour" in found.row("bandwidth").reason
    assert found.left_out[0] <= 0.1 and found.seconds > 2 * plain.seconds


DEPTH = 3.0


@pytest.fixture(scope="module")
def camera() -> Camera:
    """Return a camera whose pitch grows by 3 % from the middle to the place scanned, and whose rows turn there."""
    plain = preset("bench")
    scale = 0.5 * min(plain.sensor.shape) * plain.sensor.pixel_um
    terms = ((0.01 * scale, 0.002 * scale, 0.0), (0.0, 0.004 * scale, 0.012 * scale))
    bend = LatticeDistortion("polynomial", (0.0, 0.0), scale, terms)
    return replace(plain, lattice=replace(plain.lattice, distortion=bend))


@pytest.fixture(scope="module")
def plan(camera: Camera) -> ScanPlan:
    row, column = (0.7 * n for n in camera.sensor.shape)
    return ScanPlan.for_camera(camera, virtual_depths=[DEPTH], cutout=41, anchor=(round(row), round(column)))


def neighbours(camera: Camera, plan: ScanPlan) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre (row, column) of the lenslet at the anchor and the steps (x, y) to its neighbours (px)."""
    x, y = camera.sensor_um(plan.anchor)
    q, r = (int(v) for v in np.rint(camera.lattice.lenslet_at((x, y))))
    own = camera.pixels(camera.lattice.centres_um(q, r))
    ends = [camera.pixels(camera.lattice.centres_um(q + i, r + j)) for i, j in ((1, 0), (0, 1))]
    starts = [camera.pixels(camera.lattice.centres_um(q - i, r - j)) for i, j in ((1, 0), (0, 1))]
    return own, np.array([(e - s)[::-1] / 2 for e, s in zip(ends, starts, strict=True)])


def test_the_scene_is_the_array_about_the_cell(camera: Camera, plan: ScanPlan) -> None:
    scene = ideal_scene(plan, outlook_of(plan, 0))
    seen, types = scene.lattice.lenslets_within(400.0, 400.0)
    x, y = camera.sensor_um(plan.anchor)
    true, kinds = camera.lattice.lenslets_within(90.0, 90.0, (float(x), float(y)))
    away = np.hypot(*(true - (x, y) - scene.scale * seen[:, None]).transpose(2, 0, 1)) / camera.sensor.pixel_um
    assert away.min(0).max() < 0.15
    assert np.array_equal(types[away.argmin(0)], kinds)
    # that of the straight lattice would be off by more
    assert abs(scene.lattice.pitch_um * scene.scale / camera.lattice.pitch_um - 1) > 0.003


def test_without_a_place_a_scene_is_that_of_the_middle(camera: Camera) -> None:
    bend = camera.lattice.distortion
    assert bend is not None
    moved = replace(camera, lattice=replace(camera.lattice, distortion=replace(bend, centre=(-2000.0, 1000.0))))
    scene = scene_of(moved, cutout=(9, 9))
    local = moved.lattice.local((0.0, 0.0))
    assert scene.lattice.distortion is None
    assert scene.lattice.pitch_um * scene.scale == pytest.approx(local.pitch_um)


def test_the_plan_s_period_is_that_of_the_cell(camera: Camera, plan: ScanPlan) -> None:
    _, (a, b) = neighbours(camera, plan)
    across = float(np.hypot(*a)), 2 * abs(a[0] * b[1] - a[1] * b[0]) / float(np.hypot(*a))
    wanted = camera.local(plan.anchor).period_px
    three = len(camera.lattice.types) == 3
    assert wanted == pytest.approx((across[1], across[0] * (3 if three else 1)), rel=2e-3)
    residual = np.array(wanted) * plan.cells - plan.period
    assert plan.period_residual_px == pytest.approx(tuple(residual))
    exact = replace(plan, resample=True)
    assert np.array(plan.period) / np.array(exact.resample_factors) == pytest.approx(np.array(wanted) * plan.cells)


def test_wave_vectors_are_those_of_the_cell(camera: Camera, plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step to a neighbour is a whole number of waves of the requested lattice."""
    used = []

    def recorded(*arguments: object) -> np.ndarray:
        used.append(wave_vectors(*arguments))
        return used[-1]

    # the package has a function of the module's name
    monkeypatch.setattr(sys.modules["lfcal.judge.quality._inspect"], "wave_vectors", recorded)
    values = np.random.default_rng(0).random((1, 2, 3, 21, 21), np.float32)
    inspect_matrix(PSFMatrix(values, depths=(0.0,), camera=camera, anchor=plan.anchor), workers=1)
    _, steps = neighbours(camera, plan)
    turns = used[0] @ steps.T / (2 * math.pi)
    assert np.abs(turns - np.rint(turns)).max() < 3e-3
    turns = wave_vectors(camera, plan.period) @ steps.T / (2 * math.pi)
    assert np.abs(turns - np.rint(turns)).max() > 0.01


def test_the_anchor_counts_from_the_nearest_true_micro_image(camera: Camera, plan: ScanPlan) -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-40, 41), np.arange(-40, 41)))
    zero = camera.lattice.type_of(q, r) == 0
    centres = camera.pixels(camera.lattice.centres_um(q[zero], r[zero]))
    nearest = centres[np.argmin(np.hypot(*(centres - plan.anchor).T))]
    away = np.array(plan.anchor) - nearest
    exact = replace(plan, resample=True)
    assert plan.lattice_anchor == pytest.approx(tuple(away), abs=1e-6)
    H = SimpleNamespace(shape=plan.shape, camera=camera, anchor=plan.anchor)
    assert lattice_anchor_of(H) == pytest.approx(tuple(away * exact.resample_factors), abs=1e-6)
