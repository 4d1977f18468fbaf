"""Cameras whose main lens has Seidel aberrations, which bring defocus and tilt of the wavefront with them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks._fit_cameras import Truth, described_plan, random_truth
from benchmarks.fit import measured_error
from lfcal.base.progress import drain
from lfcal.camera import LensletLattice, LensType, ScanPlan, preset
from lfcal.fit import Fit, Measured, Setup, fit_camera
from lfcal.fit.fit import iter_retrieved, iter_summarised, problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.spread import spread_out
from lfcal.simulate.effects import ExactAngles, Zernike
from lfcal.simulate.staging import scene_for
from tests.fit.common import CORE, measured, small_plan, some_index
from tests.simulate.brute_force import Fineness as Nodes
from tests.simulate.brute_force import brute_force

PEAK, READ = 12e3, 6.0
FORMS = ("seidel", "balanced")


def aberrated(truth: Truth, waves: tuple[float, float, float], angles: tuple[float, float], form: str) -> Truth:
    """Return the camera with W040 rho^4 + W131 rho^3 cos(t - a) + W222 rho^2 cos^2(t - b), or without R20 and R11.

    rho^4 = (R40 + 3 R20 + 2)/6, rho^3 = (R31 + 2 R11)/3, rho^2 cos^2 t = (R20 + 1)/4 + R22 cos(2 t)/2.
    """
    spherical, coma, astigmatism = waves
    along, across = math.cos(angles[0]), math.sin(angles[0])
    terms = {
        (4, 0): spherical / 6,
        (3, 1): coma * along / 3,
        (3, -1): coma * across / 3,
        (2, 2): astigmatism / 2 * math.cos(2 * angles[1]),
        (2, -2): astigmatism / 2 * math.sin(2 * angles[1]),
    }
    if form == "seidel":
        tilt = 2 * coma / 3
        terms |= {(2, 0): spherical / 2 + astigmatism / 4, (1, 1): tilt * along, (1, -1): tilt * across}
    effect = Zernike(tuple((n, m, value) for (n, m), value in terms.items()))
    return replace(truth, setup=truth.setup.with_effect(effect))


def noisy(light: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float64]:
    electrons = PEAK * np.maximum(light.astype(float), 0) / light.max()
    return rng.poisson(electrons) + READ * rng.standard_normal(light.shape)


def recorded(truth: Truth, count: int, rng: np.random.Generator) -> Measured:
    every = np.argwhere(np.ones(truth.plan.shape[:3], bool))
    index = every[spread_out(every, count, truth.plan.period)]
    light = predict(truth.setup, truth.plan, index, np.zeros((count, 2)), Fineness.finest)
    return measured(truth.plan, noisy(light, rng), index, (READ**2, 1.0))


def pulls(fit: Fit, truth: Truth) -> dict[str, float]:
    same = ("gap_um", "f_number", "rotation_rad", "offset_y_um", "offset_x_um", "focal_0_um")
    return {name: (fit.parameters[name].value - truth.values[name]) / fit.parameters[name].sigma for name in same}


def selected(patterns: Measured, setup: Setup, tried: tuple[str, ...]) -> Fit:
    """Return the fit whose groups are chosen of the ``tried``."""
    problem = problem_of(patterns, setup, (*CORE, *tried), 1)
    return drain(iter_summarised(*drain(iter_retrieved(problem, CORE, tried, stage=0.0)), tried))[0]


def test_seidel_aberrations_call_for_the_zero_of_the_stage() -> None:
    """Alone none of them explains what they do together; each takes away what gap, offset and iris took of it."""
    plan = small_plan(29, (2.7,))
    rng = np.random.default_rng(3)
    start = random_truth(plan, rng, size=0.0)
    truth = aberrated(start, (-0.18, 0.21, 0.0), (0.7, 0.0), "seidel")
    described = Setup(plan.camera, start.setup.effects, (0.0,))
    fit = selected(recorded(truth, 12, rng), described, ("wavefront", "distance", "stage_zero", "defocus"))
    assert set(fit.groups) == {*CORE, "wavefront", "stage_zero", "distance"} and fit.complete
    assert measured_error(fit, truth, 12)["error_l1"] < 0.005
    assert max(map(abs, pulls(fit, truth).values())) < 4
    assert "zernike_2_0, fixed at 0 waves, with distance_um" in " ".join(fit.unidentified)


def random_camera(k: int) -> tuple[ScanPlan, np.random.Generator]:
    """Return the scan of one of ten cameras: hexagonal or square, planes before and behind the array."""
    rng = np.random.default_rng(100 + k)
    camera, cutout = preset("bench"), 55
    optics = replace(
        camera.optics,
        f_number=camera.optics.f_number * rng.uniform(0.95, 1.3),
        blades=int(rng.choice([0, 5, 6, 7, 9])),
        blade_rotation_rad=rng.uniform(0, 0.5),
    )
    lattice = camera.lattice
    if k in (3, 7):
        kind = LensType.focused_at(3.5 if k == 3 else 2.2, lattice.gap_um)
        lattice = LensletLattice("square", lattice.pitch_um, lattice.gap_um, (kind,), clear_um=lattice.clear_um)
    camera = replace(camera, optics=optics, lattice=lattice, wavelength_um=float(rng.uniform(0.48, 0.63)))
    depths = {4: (2.4, 3.2), 5: (3.0, -3.0), 6: (-3.0, -4.0), 8: (2.6, 4.5)}.get(k, (3.0, 4.0))
    shape = tuple(round(n) + cutout + 40 for n in camera.period_px)
    camera = replace(camera, sensor=replace(camera.sensor, shape=shape))
    return ScanPlan.for_camera(camera, virtual_depths=depths, cutout=cutout), rng


@pytest.mark.long
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("k", [*range(9), 10])
def test_random_cameras_with_seidel_aberrations(k: int, form: str) -> None:
    plan, rng = random_camera(k)
    start = random_truth(plan, rng, size=0.0)
    waves = tuple(rng.uniform(0.08, 0.25, 3) * rng.choice([-1.0, 1.0], 3))
    truth = aberrated(start, waves, tuple(rng.uniform(-math.pi, math.pi, 2)), form)
    fit = fit_camera(recorded(truth, 24, np.random.default_rng(7 * k + 1)), workers=1)
    found = measured_error(fit, truth, 20)
    print(f"camera {k}, {form}: {found}, {fit.verdict}, {fit.groups}, {pulls(fit, truth)}")
    assert found["error_l1"] < 0.005 and fit.complete
    assert max(map(abs, pulls(fit, truth).values())) < 4


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "cutout", "count", "form"),
    [("bench", 55, 24, "seidel"), ("bench", 55, 24, "balanced"), ("r29", 61, 16, "seidel")],
)
def test_presets_with_spherical_aberration_and_coma(name: str, cutout: int, count: int, form: str) -> None:
    plan, rng = described_plan(name, cutout=cutout), np.random.default_rng(1)
    truth = aberrated(random_truth(plan, rng, size=0.0), (-0.18, 0.21, 0.0), (0.7, 0.0), form)
    fit = fit_camera(recorded(truth, count, rng), workers=1)
    found = measured_error(fit, truth, 8)
    print(f"{name}, {form}: {found}, {fit.verdict}, {fit.groups}, {pulls(fit, truth)}")
    assert found["error_l1"] < 0.005 and fit.complete
    assert max(map(abs, pulls(fit, truth).values())) < 4


@pytest.mark.long
def test_seidel_aberrations_of_another_simulator() -> None:
    """By a summed integral with the Seidel wavefront as it stands, paraxial; unseen patterns are of the same."""
    plan, rng, count = small_plan(29), np.random.default_rng(5), 20
    start = random_truth(plan, rng, size=0.0)
    effects = tuple(e for e in start.setup.effects if not isinstance(e, ExactAngles | Zernike))
    setup = replace(start.setup, effects=effects)

    def waves(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        rho2 = u * u + v * v
        return -0.18 * rho2**2 + 0.21 * rho2 * (0.8 * u - 0.6 * v) + 0.12 * (0.28 * u + 0.96 * v) ** 2

    index = some_index(plan, count + 4)
    unseen = np.arange(count + 4) % 6 == 3
    light = []
    for z, y, x in index.tolist():
        scene = scene_for(setup.plan(plan), z, effects)
        light.append(brute_force(scene, scene.source_um(y, x), (y, x), Nodes(pixel=10, reach_um=170.0), waves))
    patterns = np.array(light)
    given = measured(plan, noisy(patterns[~unseen], rng), index[~unseen], (READ**2, 1.0))
    fit = selected(given, Setup(plan.camera, effects, (0.0, 0.0)), ("wavefront", "distance", "stage_zero", "defocus"))
    found = predict(fit.ideal_places, plan, index[unseen], np.zeros((4, 2)), Fineness.finest).astype(float)
    for z in (0, 1):
        own = index[unseen][:, 0] == z
        found[own] *= patterns[unseen][own].sum() / found[own].sum()
    off = np.abs(found - patterns[unseen]).sum() / patterns[unseen].sum()
    print(f"{100 * off:.3f} %, {fit.verdict}, {pulls(fit, start)}")
    assert off < 0.005 and fit.complete
    assert max(map(abs, pulls(fit, start).values())) < 4
