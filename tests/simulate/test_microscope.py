"""The coherent Debye path of scalar light: fields, positions, nodes, and the tolerance that it keeps."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.special import j0

from lfcal.base import InputError
from lfcal.camera import LensletLattice, LensType, Microscope, ScanPlan, preset
from lfcal.simulate import PlaneResponse, Sampling, plan_effects
from lfcal.simulate.accuracy import step_for
from lfcal.simulate.effects import ExactAngles, LensletDiffraction, Outlook
from lfcal.simulate.engines import EnergyError, engine_for, microscope
from lfcal.simulate.engines._debye import debye_field, debye_nodes, radial_field
from lfcal.simulate.engines._separable import in_blocks
from lfcal.simulate.engines._tile_llvm import ACROSS, DOWN, row_light
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.microscope import DebyePlane, _factors
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import Scene, seidel
from tests.simulate.common import long
from tests.simulate.scenes import microscope_scene, moments, relative_error


def literal(scene, r):
    """Return the Debye integral as it is printed, by adaptive quadrature in 20 digits."""
    mp.mp.dps = 20
    optics = scene.objective
    k = 2 * mp.pi * optics.medium_index / scene.wavelength_um
    alpha = mp.asin(mp.mpf(optics.numerical_aperture) / optics.medium_index)

    def integrand(t):
        lateral = mp.besselj(0, k * r / optics.magnification * mp.sin(t))
        return mp.sqrt(mp.cos(t)) * mp.sin(t) * lateral * mp.expj(-k * scene.z_um * (1 - mp.cos(t)))

    level = mp.sqrt(2 * mp.pi * (1 - mp.cos(alpha))) * optics.magnification / k
    return complex(mp.quad(integrand, mp.linspace(0, alpha, 5)) / level)


def test_fields_are_exact_and_their_nodes_follow_phase_and_reach():
    for z, r in ((0.0, 0.0), (25.0, 130.0), (-12.0, 40.0)):
        scene = microscope_scene(z)
        assert abs(debye_field(scene, np.array([r]))[0] - literal(scene, r)) < 1e-14
        at = np.linspace(0, 600, 60)
        wanted = debye_field(scene, at, nodes=3 * debye_nodes(scene, 600.0))
        peak = np.abs(wanted).max()
        assert np.abs(debye_field(scene, at) - wanted).max() < 1e-12 * peak
        assert np.abs(radial_field(scene, 600.0)(at) - wanted).max() < 2e-5 * peak, z


@pytest.mark.few(1)
@pytest.mark.parametrize(("z", "position"), [(0.0, (0, 0)), (6.0, (2, 3)), (-9.0, (0, 1))])
def test_against_the_converged_reference(z, position):
    scene = microscope_scene(z, cutout=(51, 51))
    y, x = position
    wanted = ReferencePlane(scene, Sampling(6)).rows([y], [x])[0, 0]
    found = DebyePlane(scene, Sampling(nodes_per_px=4)).rows([y], [x])[0, 0]
    assert relative_error(found, wanted) < 0.015
    assert np.allclose(moments(found), moments(wanted), atol=0.05)
    quick = DebyePlane(scene, Sampling(nodes_per_px=2)).rows([y], [x])[0, 0]
    assert relative_error(quick, wanted) < 0.04
    wrong_way = DebyePlane(microscope_scene(-z, cutout=(51, 51)), Sampling(nodes_per_px=4)).rows([y], [x])[0, 0]
    assert z == 0 or relative_error(wrong_way, wanted) > 0.3


def test_symmetric_positions_are_computed_once():
    scene = microscope_scene(5.0)
    engine = DebyePlane(scene, Sampling(nodes_per_px=2))
    images = engine.rows(range(9), range(9))
    assert engine.certificate.responses == 15  # 5 distinct distances from a lenslet's centre, in pairs
    assert np.array_equal(images[1, 3], images[8, 3][::-1])
    assert np.array_equal(images[1, 3], images[3, 1].T)
    assert np.array_equal(engine.rows([10], [-6])[0, 0], images[1, 3])
    alone = DebyePlane(scene, Sampling(nodes_per_px=2)).rows([8], [3])[0, 0]
    assert relative_error(images[8, 3], alone) < 1e-6


def test_factors_of_fields_of_any_rank():
    rng = np.random.default_rng(3)
    full = rng.normal(size=(20, 20)) + 1j * rng.normal(size=(20, 20))
    for field, rank in ((full, 20), (np.outer(full[0], full[1]), 1), (np.zeros((20, 20), complex), 1)):
        columns, rows = (part[0] + 1j * part[1] for part in _factors(field))
        assert columns.shape == rows.shape == (20, rank)
        assert np.abs(columns @ rows.T - field).max() < 1e-5


@pytest.mark.parametrize("z", [0.0, long(5.0), long(25.0)])
def test_fewer_nodes_where_little_light_falls(z, monkeypatch):
    scene = microscope_scene(z, cutout=(151, 151))
    places = range(5), range(5)
    wanted = DebyePlane(scene, Sampling(nodes_per_px=6)).rows(*places)
    engine = DebyePlane(scene, Sampling(nodes_per_px=2))
    found = engine.rows(*places)
    monkeypatch.setattr(microscope, "FAINT_LIGHT", 0.0)
    everywhere = DebyePlane(scene, Sampling(nodes_per_px=2))
    least = relative_error(everywhere.rows(*places), wanted)
    assert {nodes.positions.size for nodes, *_ in everywhere._axes.values()} == {304}
    assert all(nodes.positions.size < 290 for nodes, *_ in engine._axes.values())
    assert least < relative_error(found, wanted) < least + 0.001
    monkeypatch.setattr(microscope, "FAINT_LIGHT", 0.2)  # too much light is left to a single node
    assert relative_error(DebyePlane(scene, Sampling(nodes_per_px=2)).rows(*places), wanted) > least + 0.002


def test_light_moved_off_the_middle_has_all_nodes():
    offsets = np.zeros((9, 9, 2))
    offsets[2, 3] = (0.0, 200.0)  # 25 pixels
    scene = microscope_scene(5.0, cutout=(151, 151), offsets_um=offsets)
    wanted = DebyePlane(scene, Sampling(nodes_per_px=6)).rows([2], [3])
    assert relative_error(DebyePlane(scene, Sampling(nodes_per_px=2)).rows([2], [3]), wanted) < 0.006


def test_rows_that_were_forgotten_are_computed_again(monkeypatch):
    scene = microscope_scene(5.0)
    wanted = DebyePlane(scene, Sampling(nodes_per_px=2)).rows(range(3), range(3))
    monkeypatch.setattr(microscope, "MOST_ROWS", 10)
    assert np.array_equal(DebyePlane(scene, Sampling(nodes_per_px=2)).rows(range(3), range(3)), wanted)


def test_points_between_the_pixels_and_source_offsets():
    offsets = np.zeros((9, 9, 2))
    offsets[2, 3] = (1.7, -0.9)
    scene = microscope_scene(5.0, offsets_um=offsets)
    engine = DebyePlane(scene, Sampling(nodes_per_px=3))
    moved = engine.rows([2], [3])[0, 0]
    assert relative_error(moved, engine.point(2 * 8.0 + 1.7, 3 * 8.0 - 0.9)) < 1e-6
    wanted = ReferencePlane(scene, Sampling(6)).rows([2], [3])[0, 0]
    assert relative_error(moved, wanted) < 0.02
    assert relative_error(DebyePlane(microscope_scene(5.0)).rows([2], [3])[0, 0], wanted) > 0.05


def test_spherical_aberration_and_what_has_no_radial_form():
    scene = microscope_scene(3.0, wavefront=seidel(spherical=0.4))
    wanted = ReferencePlane(scene, Sampling(6)).rows([1], [2])[0, 0]
    assert relative_error(DebyePlane(scene).rows([1], [2])[0, 0], wanted) < 0.02
    assert relative_error(DebyePlane(microscope_scene(3.0)).rows([1], [2])[0, 0], wanted) > 0.05
    with pytest.raises(InputError, match="rotationally"):
        DebyePlane(microscope_scene(3.0, wavefront=seidel(coma=0.4)))


def test_energy_certificate():
    engine = DebyePlane(microscope_scene(4.0, cutout=(61, 61)))
    light = engine.rows([0], [1])[0, 0].sum()
    assert engine.certificate.energy_out == pytest.approx(float(light), rel=1e-5)
    assert 0.97 < light <= engine.certificate.energy_in * 1.001 <= 1.001
    with pytest.raises(InputError, match="microscope"):
        debye_field(replace(microscope_scene(), objective=None), np.zeros(1))


def test_every_position_of_a_deep_range_balances() -> None:
    """Two nodes a pixel pass the probes at z = -30 um and fail elsewhere in the cell: the nodes follow the light."""
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[-30.0], cutout=125)
    effects = (LensletDiffraction(),)  # of one wavelength, as the engine that it is compared with
    scene = PlaneResponse(plan, 0, effects).scene
    places = [(y, x) for y in range(0, 8, 2) for x in range(y, 8)]
    coarse = DebyePlane(scene, Sampling(nodes_per_px=2))
    with pytest.raises(EnergyError):
        for y, x in places:
            coarse.rows([y], [x])
    fine = DebyePlane(scene, Sampling(nodes_per_px=8))
    for tolerance in (0.2, 0.03, 0.004):
        response = PlaneResponse(plan, 0, effects, tolerance=tolerance)
        error = max(
            relative_error(response.rows([y], [x], workers=1), fine.rows([y], [x], workers=1)) for y, x in places
        )
        assert error < tolerance
        assert response.certificate.worst <= 1.005


def test_light_out_of_nothing_is_computed_again_more_finely() -> None:
    """Probes miss what a later position shows: the response refines itself, and a fixed number of nodes is an error."""
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[-10.0], cutout=39)
    effects = plan_effects(plan, 0.03).effects
    response = PlaneResponse(plan, 0, effects)
    response.engine()
    response._engines[0.525] = DebyePlane(response.scene, Sampling(nodes_per_px=1))
    response.settled = Sampling(nodes_per_px=1)
    wanted = DebyePlane(response.scene, Sampling(nodes_per_px=8)).rows(range(8), range(8), workers=1)
    assert relative_error(response.rows(range(8), range(8), workers=1), wanted) < 0.015
    assert response.engine().sampling.nodes_per_px > 1
    row, column, values = response.point(3.0, 5.0)[0]
    assert (row, column) == (3, 5)
    assert relative_error(values, wanted[3, 5]) < 0.015
    fixed = PlaneResponse(plan, 0, effects, sampling=Sampling(nodes_per_px=1))
    with pytest.raises(EnergyError, match="nodes_per_px"):
        fixed.rows(range(8), range(8))


def test_the_error_reached_is_stated_where_no_sampling_keeps_the_tolerance() -> None:
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[-10.0], cutout=39)
    response = PlaneResponse(plan, 0, plan_effects(plan, 0.03).effects, tolerance=1e-9)
    response.rows([0], [0])
    assert 1e-9 < response.reached < 1e-3


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("objective", "lenslet", "z"),
    [
        (Microscope(10.0, 0.3, 1.0), (125.0, 2500.0), -60.0),
        (Microscope(40.0, 0.95, 1.0), (125.0, 3000.0), -6.0),
        (Microscope(63.0, 1.4, 1.518), (100.0, 2500.0), -3.0),
        (Microscope(4.0, 0.1, 1.0), (125.0, 2500.0), 300.0),
        (Microscope(20.0, 0.5, 1.0), (125.0, 1250.0), -10.0),
        (Microscope(20.0, 0.5, 1.0), (125.0, 6250.0), -10.0),
        (Microscope(20.0, 0.5, 1.0), (125.0, 2500.0), 0.0),
    ],
)
def test_other_objectives_and_lenslets_keep_the_tolerance(objective, lenslet, z):
    lattice = LensletLattice("square", *lenslet, (LensType.focused_at(math.inf, lenslet[1]),))
    camera = replace(preset("lfm_20x05"), optics=objective, lattice=lattice)
    plan = ScanPlan.for_camera(camera, depths_um=[z], cutout=61)
    effects = plan_effects(plan, 0.03).effects
    response = PlaneResponse(plan, 0, effects, tolerance=0.03)
    fine = DebyePlane(response.scene, Sampling(nodes_per_px=12))
    for y, x in ((0, 0), (2, 5), (7, 7), (3, 11)):
        found = response.rows([y], [x], workers=1)
        assert relative_error(found, fine.rows([y], [x], workers=1)) < 0.0165
        assert 0 < found.sum() <= 1.005


def test_one_percent_takes_two_nodes_where_they_keep_it() -> None:
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[25.0, -30.0], cutout=101)
    for plane, nodes in ((0, 2), (1, 3)):
        response = PlaneResponse(plan, plane, (LensletDiffraction(),), tolerance=0.01)
        fine = DebyePlane(response.scene, Sampling(nodes_per_px=8))
        found = response.rows(range(0, 8, 3), range(0, 8, 3), workers=1)
        assert response.engine().sampling.nodes_per_px == nodes
        assert relative_error(found, fine.rows(range(0, 8, 3), range(0, 8, 3), workers=1)) < 0.01


@pytest.mark.long
def test_arrays_off_the_separable_path_keep_the_tolerance() -> None:
    """Windows of 20 px around each lenslet left 1.4 % of a hexagonal microscope's response out, at any nodes."""
    camera = preset("lfm_60x12")
    camera = replace(camera, lattice=replace(camera.lattice, kind="hexagonal"))
    plan = ScanPlan.for_camera(camera, depths_um=[4.0], cutout=61)
    response = PlaneResponse(plan, 0, [LensletDiffraction()], tolerance=0.012)
    assert isinstance(response.engine(), GridPlane) and response.level == "grid"
    fine = engine_for(response.scene, "reference", Sampling(samples_per_px=6))
    for y, x in ((0, 0), (9, 3)):
        assert relative_error(response.rows([y], [x], workers=1), fine.rows([y], [x], workers=1)) < 0.55 * 0.012


def fast_lenslets(z_um: float = 0.0, **changes) -> Scene:
    """Return a plane of a 4x/0.28 microscope with matched lenslets of f/7: light behind them is up to 0.14 steep."""
    lattice = LensletLattice("square", 128.0, 900.0, (LensType(900.0),))
    objective = Microscope(4.0, 0.28, 1.0)
    values = {"objective": objective, "f_number": 4 / 0.56, "lattice": lattice, "cutout": (51, 51), "period": (16, 16)}
    return microscope_scene(z_um, **(values | changes))


def by_fourier(scene: Scene, position: tuple[int, int], exact: bool, samples: int = 8, spare: int = 24) -> np.ndarray:
    """Return a scalar response by sums: Debye integral, parabolas by the nearest lenslet, one transform to the sensor.

    Samples lie halfway about the source: a source on the edge of lenslets has it between samples.
    """
    optics, lam, pitch = scene.objective, scene.wavelength_um, scene.lattice.pitch_um
    n, h = (scene.cutout[0] + 2 * spare) * samples, scene.pixel_um / samples
    x = (np.arange(n) - (n - 1) / 2) * h
    nodes, weights = np.polynomial.legendre.leggauss(400)
    alpha, k = math.asin(optics.numerical_aperture), 2 * math.pi / lam
    t = (nodes + 1) * alpha / 2
    light = np.sqrt(np.cos(t)) * np.sin(t) * np.exp(1j * k * scene.z_um * (np.cos(t) - 1)) * weights * alpha / 2
    light *= k / optics.magnification / math.sqrt(2 * math.pi * (1 - math.cos(alpha)))
    r = np.linspace(0, 1.5 * x[-1], 3000)
    radial = CubicSpline(r, j0(np.outer(r, k * np.sin(t) / optics.magnification)) @ light)
    field = radial(np.hypot(x[:, None], x[None, :]))
    focal = scene.lattice.types[0].focal_length_um
    for axis, pixel in enumerate(position):
        from_lens = (x + pixel * scene.pixel_um + pitch / 2) % pitch - pitch / 2
        phase = np.exp(-1j * math.pi / (lam * focal) * from_lens**2)
        field = field * (phase[:, None] if axis == 0 else phase[None, :])
    f = np.fft.fftfreq(n, h)
    sine2 = lam**2 * (f[:, None] ** 2 + f[None, :] ** 2)
    cosine = np.sqrt(np.maximum(1 - sine2, 0)) if exact else 1 - sine2 / 2
    field = np.fft.ifft2(np.fft.fft2(field) * np.exp(1j * k * scene.lattice.gap_um * (cosine - 1)) * (sine2 < 1))
    pixels = (np.abs(field) ** 2 * h * h).reshape(n // samples, samples, n // samples, samples).sum((1, 3))
    return pixels[spare:-spare, spare:-spare]


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("position", [(8, 8), (8, 0), (3, 5)], ids=["corner", "edge", "within"])
def test_light_focused_where_fast_lenslets_meet_is_not_made_more(position):
    scene = fast_lenslets(cutout=(41, 41))
    wanted = by_fourier(scene, position, exact=False, samples=24, spare=12)
    found = DebyePlane(scene, Sampling(nodes_per_px=4)).rows(*([p] for p in position))[0, 0]
    assert found.sum() < 1  # with 20 orders beyond the cone 1.013 on the corner, which was refused
    assert relative_error(found, wanted) < 0.01


@pytest.mark.long
@pytest.mark.parametrize("plane", [GridPlane, ReferencePlane])
def test_lenslets_without_gaps_meet_on_a_grid_without_making_light(plane):
    """Masks low-passed before they are bent overlapped, each with its own phase: 1.07 and 10 % on the corner."""
    scene = fast_lenslets(cutout=(41, 41))
    wanted = by_fourier(scene, (8, 8), exact=False, samples=24, spare=12)
    found = plane(scene, Sampling(samples_per_px=7, margin_px=60)).rows([8], [8])[0, 0]
    assert found.sum() < 0.985
    assert relative_error(found, wanted) < 0.01


@pytest.mark.long
@pytest.mark.parametrize("z", [30.0, long(0.0)])
def test_exact_angles_are_followed_behind_the_lenslets(z):
    camera = replace(preset("lfm_20x05"), optics=Microscope(4.0, 0.28, 1.0), lattice=fast_lenslets().lattice)
    outlook = Outlook(camera, z, (41, 41), (16, 16))
    paraxial = fast_lenslets(z, cutout=(41, 41), wavelength_um=camera.wavelength_um, pixel_um=camera.sensor.pixel_um)
    scene = ExactAngles().on_scene(paraxial, outlook)
    position = (3, 5)
    wanted = by_fourier(scene, position, exact=True, samples=12)
    step = step_for(scene, "debye", 0.002)
    found = engine_for(scene, step.level, step.sampling).rows(*([p] for p in position))[0, 0]
    assert relative_error(found, wanted) < 0.003
    changed = relative_error(by_fourier(paraxial, position, exact=False, samples=12), wanted)
    assert changed > 0.008  # switching it on had no effect
    assert changed < ExactAngles().estimate(outlook).error < 2.5 * changed  # rather too much than too little


def test_exact_angles_do_not_act_on_rows_and_columns_separately():
    with pytest.raises(InputError, match="exact_angles=off"):
        engine_for(fast_lenslets(exact_rays=True), "debye", Sampling(nodes_per_px=2))


def parts(value: np.ndarray) -> np.ndarray:
    return np.stack([value.real, value.imag, value.real + value.imag]).astype(np.float32)


@pytest.mark.parametrize("shape", [(DOWN, 16, 1), (24, 53, 37), (40, 7, 3), (8, 33, 130)])
def test_light_of_two_factors_on_pixels(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(4)
    high, wide, n = shape
    left, right = (rng.normal(size=(k, n)) + 1j * rng.normal(size=(k, n)) for k in (high, wide))
    used = high - 3  # the last nodes only complete a tile
    pixels = np.stack([np.arange(used) // 2, np.where(np.arange(used) % 3, -1, 1)], axis=1)
    weights = rng.random(pixels.shape).astype(np.float32)
    lines = np.ones((high, wide), np.float32)
    row_light(parts(left), in_blocks(parts(right), ACROSS), pixels, weights, lines)
    wanted = np.ones((high, wide))
    for i, light in enumerate(np.abs(left[:used] @ right.T) ** 2):
        for pixel, weight in zip(pixels[i], weights[i], strict=True):
            if pixel >= 0:
                wanted[pixel] += weight * light
    assert np.abs(lines - wanted).max() < 2e-6 * wanted.max()


@pytest.mark.long
@pytest.mark.parametrize("features", ["+avx,+avx2,+fma", ""])
def test_light_of_two_factors_on_other_processors(features: str, tmp_path) -> None:
    """Sums are spread over fewer registers where a processor has only small ones."""
    settings = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": features, "NUMBA_CACHE_DIR": str(tmp_path)}
    test = f"{__file__}::test_light_of_two_factors_on_pixels"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", test]
    done = subprocess.run(command, env=os.environ | settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
