"""Cameras retrieved from patterns of simulators that share no code with the engines.

Lenses are those of `tests.simulate.brute_force`, whose integral is paraxial, as is the fitted model. Microscopes are
those of `tests.simulate.microscope_oracle`, converged to 2e-5. Patterns have photon and read noise of an 80 % full
pixel. Positions at which fits are judged are in none of the fits.

Without noise a fit ends at the floor, which is the engine's own error. With noise the error of the unknowns adds 0.15 %
(L2) for 40 patterns of small cutouts, and 0.2 % where each source is displaced by 0.05 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve

from benchmarks._fit_cameras import Truth, described_plan, random_truth
from benchmarks.fit import measured_error
from lfcal.base.progress import drain
from lfcal.base.threads import one_blas_thread
from lfcal.camera import LensletLattice, LensType, ScanPlan, preset
from lfcal.fit import GROUPS, Fit, Measured, Setup, fit_camera
from lfcal.fit.fit import iter_retrieved, iter_summarised, problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import starting_effects
from lfcal.fit.spread import spread_out
from lfcal.simulate.effects import Crosstalk, ExactAngles, IndexMismatch, LensLaw, LensletSpherical, Spherical, Zernike
from lfcal.simulate.staging import scene_for
from tests.fit.common import CORE, measured, small_camera, small_plan, some_index, vector_of
from tests.simulate.brute_force import Fineness as Nodes
from tests.simulate.brute_force import brute_force
from tests.simulate.microscope_oracle import DipoleFields

COUNT = 40
SHARE = 0.012
NEIGHBOURS = np.outer([SHARE, 1 - 2 * SHARE, SHARE], [SHARE, 1 - 2 * SHARE, SHARE])
STAGE_PX = 0.05


@dataclass(frozen=True, eq=False)
class Light:
    """Light of a true camera at positions that are fitted and at others."""

    plan: ScanPlan
    truth: Setup
    fitted: NDArray[np.intp]
    unseen: NDArray[np.intp]
    light: np.ndarray
    wanted: np.ndarray

    def fit(self, count: int = COUNT, *, peak: float, read: float, hold_out: bool, **options: object) -> Fit:
        """Return the fit of ``count`` noisy patterns; ``peak`` are the brightest pixel's electrons."""
        rng = np.random.default_rng(1)
        electrons = peak / self.light.max() * np.maximum(self.light, 0)
        data = rng.poisson(electrons) + read * rng.standard_normal(electrons.shape)
        used = spread_out(self.fitted, count, self.plan.period)
        patterns = measured(self.plan, data[used], self.fitted[used], (read**2, 1.0))
        patterns = patterns if hold_out else replace(patterns, held_out=np.zeros(count, bool))
        return fit_camera(patterns, workers=1, **options)  # type: ignore[arg-type]

    def error(self, setup: Setup, *, by_plane: bool) -> tuple[float, float]:
        """Return the error of a setup's patterns at the unseen positions (relative L1 and L2), with equal light."""
        still = np.zeros((len(self.unseen), 2))
        found = predict(setup, self.plan, self.unseen, still, Fineness.finest).astype(float)
        planes = self.unseen[:, 0] * by_plane
        for z in np.unique(planes):
            own = planes == z
            found[own] *= (found[own] * self.wanted[own]).sum() / np.square(found[own]).sum()
        off = found - self.wanted
        l2 = np.sqrt(np.square(off).sum() / np.square(self.wanted).sum())
        return float(np.abs(off).sum() / self.wanted.sum()), float(l2)


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with one_blas_thread():
        yield


# -- lenses, by a summed integral -------------------------------------------------------------------------


@dataclass(frozen=True)
class Lens:
    """Which camera is fitted: only its numbers differ from the description, or it is also ``full`` of effects."""

    cutout: int
    depths: tuple[float, float]
    reach_um: float
    full: bool

    def fit(self, count: int = COUNT, peak: float = 16000.0) -> Fit:
        groups = (*CORE, "lenslet_spherical", "crosstalk") if self.full else CORE
        start = tuple(e for e in of_lens(self).truth.effects if not isinstance(e, LensletSpherical))
        return of_lens(self).fit(count, peak=peak, read=8.0, hold_out=False, unknowns=groups, effects=start)

    def error(self, setup: Setup) -> tuple[float, float]:
        return of_lens(self).error(setup, by_plane=False)

    @property
    def floor(self) -> tuple[float, float]:
        """The error of the true camera's patterns."""
        truth = of_lens(self).truth
        return self.error(truth.with_effect(Crosstalk(SHARE)) if self.full else truth)


PLAIN = Lens(21, (2.2, 2.7), 150.0, False)
FULL = Lens(41, (3.0, 3.5), 190.0, True)


def summed(
    lens: Lens, plan: ScanPlan, setup: Setup, index: NDArray[np.intp], offsets_px: NDArray[np.float64]
) -> np.ndarray:
    """Return patterns by the summed integral, with crosstalk by a plain sum over neighbours."""
    out, side, nodes = [], lens.cutout + 2, Nodes(pixel=10, reach_um=lens.reach_um)
    for (z, y, x), moved in zip(index.tolist(), offsets_px, strict=True):
        scene = replace(scene_for(setup.plan(plan), z, setup.effects), cutout=(side, side))
        at = np.array(scene.source_um(y, x)) + moved * scene.pixel_um
        light = brute_force(scene, (float(at[0]), float(at[1])), (y, x), nodes)
        # light beyond the cutout is in its margin
        out.append((convolve(light, NEIGHBOURS) if lens.full else light)[1:-1, 1:-1])
    return np.stack(out)


@cache
def of_lens(lens: Lens) -> Light:
    """Return the light of a random camera whose main lens has no aberration, by small angles."""
    plan, rng = small_plan(lens.cutout, lens.depths), np.random.default_rng(8)
    setup = random_truth(plan, rng, size=0.0).setup
    effects = tuple(e for e in setup.effects if not isinstance(e, ExactAngles) and e.name != "zernike")
    truth = replace(setup, effects=effects)
    truth = truth.with_effect(LensletSpherical(0.0, 0.1, -0.07, 0.12)) if lens.full else truth
    every = some_index(plan, COUNT + 4)
    aside = np.arange(len(every)) % 11 == 6
    fitted, unseen = every[~aside], every[aside]
    moved = STAGE_PX * lens.full * rng.standard_normal((len(fitted), 2))
    light = summed(lens, plan, truth, fitted, moved)
    return Light(plan, truth, fitted, unseen, light, summed(lens, plan, truth, unseen, np.zeros((len(unseen), 2))))


@pytest.mark.long
@pytest.mark.parametrize("lens", [PLAIN, FULL], ids=["as described", "aberrated lenslets, crosstalk, stage"])
def test_a_lens_is_found_to_the_floor_of_the_engine(lens: Lens) -> None:
    fit, floor = lens.fit(), lens.floor
    l1, l2 = lens.error(fit.ideal_places)
    described = replace(of_lens(lens).truth, camera=of_lens(lens).plan.camera)
    assert floor[0] < 3e-3 and lens.error(described)[0] > 0.1
    assert l1 < min(floor[0] + 0.0015, 0.006)
    assert l2 < np.hypot(floor[1], 1.5 * fit.held_out_error.statistical), "no more than by noise"
    assert fit.complete
    assert (fit.spread.stage_px == pytest.approx(STAGE_PX, rel=0.3)) if lens.full else fit.spread.stage_px == 0
    # six patterns are enough for a percent
    few = lens.fit(6)
    assert lens.error(few.ideal_places)[0] < 0.008 and few.complete
    # without noise the fit ends at the floor
    bright = lens.error(lens.fit(peak=1.6e8).ideal_places)
    assert bright[0] < floor[0] + 0.0003 and bright[1] < floor[1] + 0.0003


# -- microscopes, by dipoles ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scope:
    """A preset, and its errors.

    Attributes
    ----------
    depths_um
        Depths of the scan.
    gap, focal, aperture
        Errors of gap, focal length and numerical aperture (shares).
    away_um
        How much farther away the planes are than planned.
    waves
        W040 of the objective.
    specimen
        Index, described and true depth of a specimen, or None.
    """

    name: str
    depths_um: tuple[float, float]
    gap: float
    focal: float
    aperture: float
    away_um: float
    waves: float
    specimen: tuple[float, float, float] | None = None

    def fit(self, count: int = COUNT) -> Fit:
        """Return the fit, whose groups are chosen, from the effects that it starts from."""
        given = of_microscope(self)
        sensor = given.plan.camera.sensor
        noise = {"peak": 0.8 * sensor.full_well_e, "read": sensor.read_noise_e}
        return given.fit(count, **noise, hold_out=True, effects=self.effects(given.plan, 1))

    def error(self, setup: Setup) -> float:
        return of_microscope(self).error(setup, by_plane=True)[0]

    def effects(self, plan: ScanPlan, which: int) -> tuple[object, ...]:
        found = starting_effects(plan)
        return found if self.specimen is None else (*found, IndexMismatch(self.specimen[0], self.specimen[which]))

    def truth(self, plan: ScanPlan) -> Setup:
        camera, pixel = plan.camera, plan.camera.sensor.pixel_um
        lattice, optics = camera.lattice, camera.optics
        kind = lattice.types[0]
        lattice = replace(
            lattice,
            gap_um=(1 + self.gap) * lattice.gap_um,
            rotation_rad=0.003,
            offset_um=(0.3 * pixel, -0.2 * pixel),
            types=(replace(kind, focal_length_um=(1 + self.focal) * kind.focal_length_um),),
        )
        optics = replace(optics, numerical_aperture=(1 + self.aperture) * optics.numerical_aperture)  # type: ignore[call-arg]
        effects = (*self.effects(plan, 2), Spherical(self.waves))
        return Setup(replace(camera, lattice=lattice, optics=optics), effects, (self.away_um,) * 2)  # type: ignore[arg-type]


DRY = Scope("lfm_20x05", (-6.0, 9.0), gap=0.015, focal=-0.01, aperture=0.02, away_um=0.7, waves=0.25)
IN_WATER = Scope("lfm_60x12", (-1.0, 2.0), -0.012, 0.01, -0.015, away_um=0.15, waves=0.2, specimen=(1.38, 12.0, 14.0))


@cache
def of_microscope(scope: Scope) -> Light:
    """Return the light of the true microscope by sums over dipoles."""
    plan = ScanPlan.for_camera(small_camera(scope.name), depths_um=list(scope.depths_um), cutout=31)
    every, truth = some_index(plan, COUNT + 8), scope.truth(plan)
    light = np.empty((len(every), *plan.cutout))
    for z, further in enumerate(truth.depth_errors_um):
        scene = scene_for(truth.plan(plan), z, truth.effects, depth_error_um=further)
        fields = DipoleFields(scene)
        for k in np.flatnonzero(every[:, 0] == z):
            y, x = every[k, 1:].tolist()
            light[k] = fields.response(scene, scene.source_um(y, x), (y, x))
    aside = np.arange(len(every)) % 6 == 3
    return Light(plan, truth, every[~aside], every[aside], light[~aside], light[aside])


@pytest.mark.long
@pytest.mark.parametrize("scope", [DRY, IN_WATER], ids=["20x, dry", "60x, in a specimen"])
def test_a_microscope_is_found_to_the_floor_of_the_engine(scope: Scope) -> None:
    given = of_microscope(scope)
    described = Setup(given.plan.camera, scope.effects(given.plan, 1), (0.0, 0.0))  # type: ignore[arg-type]
    floor = scope.error(given.truth)
    assert floor < 1e-3 and scope.error(described) > 0.1
    fit, few = scope.fit(), scope.fit(6)
    assert scope.error(fit.ideal_places) < min(floor + 0.0015, 0.006)
    assert fit.complete and fit.spread.stage_px == 0
    assert scope.error(few.ideal_places) < 0.008 and few.complete, "six patterns are enough for a percent"


@pytest.mark.long
def test_the_sigma_of_a_depth_in_a_specimen_includes_what_resembles_it() -> None:
    """The wavefront is ρ⁴, which contains defocus besides Zernike's term: 0.2 waves of it are a micron of depth."""
    fit = IN_WATER.fit(10)
    depth, gap, angle = (fit.parameters[name] for name in ("specimen_depth_um", "gap_um", "rotation_rad"))
    assert abs(depth.value - 14.0) < 3 * depth.sigma < 9.0
    # distance, lens law and the lenslets' own waves change the gap a little
    true = of_microscope(IN_WATER).truth.camera.lattice.gap_um
    assert abs(gap.value - true) < 3.5 * gap.sigma and gap.sigma < 4 * gap.sigma_held
    # nothing resembles the rotation
    assert angle.sigma < 1.1 * angle.sigma_held


# -- Seidel aberrations, which bring defocus and tilt of the wavefront with them -------------------------


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


def noisy_patterns(truth: Truth, count: int, rng: np.random.Generator) -> Measured:
    index = some_index(truth.plan, count)
    light = predict(truth.setup, truth.plan, index, np.zeros((count, 2)), Fineness.finest)
    return measured(truth.plan, noisy(light, rng), index, (READ**2, 1.0))


def pulls(fit: Fit, truth: Truth) -> dict[str, float]:
    same = ("gap_um", "f_number", "rotation_rad", "offset_y_um", "offset_x_um", "focal_0_um")
    return {name: (fit.parameters[name].value - truth.values[name]) / fit.parameters[name].sigma for name in same}


def selected(patterns: Measured, setup: Setup, tried: tuple[str, ...]) -> Fit:
    """Return the fit whose groups are chosen of the ``tried``."""
    problem = problem_of(patterns, setup, (*CORE, *tried), 1)
    return drain(iter_summarised(*drain(iter_retrieved(problem, CORE, tried, stage=0.0)), tried))[0]


def check(fit: Fit, truth: Truth, positions: int) -> None:
    found = measured_error(fit, truth, positions)
    print(f"{found}, {fit.verdict}, {fit.groups}, {pulls(fit, truth)}")
    assert found["error_l1"] < 0.005 and fit.complete
    assert max(map(abs, pulls(fit, truth).values())) < 4


def test_seidel_aberrations_need_the_zero_of_the_stage() -> None:
    """No group alone explains their joint effect. Each takes back a part that gap, offset and iris took."""
    plan = small_plan(29, (2.7,))
    rng = np.random.default_rng(3)
    start = random_truth(plan, rng, size=0.0)
    truth = aberrated(start, (-0.18, 0.21, 0.0), (0.7, 0.0), "seidel")
    described = Setup(plan.camera, start.setup.effects, (0.0,))
    fit = selected(noisy_patterns(truth, 12, rng), described, ("wavefront", "distance", "stage_zero", "defocus"))
    assert set(fit.groups) == {*CORE, "wavefront", "stage_zero", "distance"}
    check(fit, truth, 12)
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
    check(fit_camera(noisy_patterns(truth, 24, np.random.default_rng(7 * k + 1)), workers=1), truth, 20)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "cutout", "count", "form"),
    [("bench", 55, 24, "seidel"), ("bench", 55, 24, "balanced"), ("r29", 61, 16, "seidel")],
)
def test_presets_with_spherical_aberration_and_coma(name: str, cutout: int, count: int, form: str) -> None:
    plan, rng = described_plan(name, cutout=cutout), np.random.default_rng(1)
    truth = aberrated(random_truth(plan, rng, size=0.0), (-0.18, 0.21, 0.0), (0.7, 0.0), form)
    check(fit_camera(noisy_patterns(truth, count, rng), workers=1), truth, 8)


@pytest.mark.long
def test_seidel_aberrations_of_the_summed_integral_are_found() -> None:
    """The integral has the unchanged Seidel wavefront and is paraxial; it also computes the unseen patterns."""
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
    judge = Light(plan, setup, index[~unseen], index[unseen], patterns[~unseen], patterns[unseen])
    assert judge.error(fit.ideal_places, by_plane=True)[0] < 0.005 and fit.complete
    assert max(map(abs, pulls(fit, start).values())) < 4


# -- the law of the main lens -----------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("named", [False, True], ids=["auto", "named groups"])
def test_the_sigma_of_the_f_number_includes_the_unknown_lens_law(named: bool) -> None:
    """A thin lens looks like a lens by the sine condition whose iris is smaller by 1/(8 Nw²), many sigmas of noise."""
    plan = small_plan(21)
    start = random_truth(plan, np.random.default_rng(1), size=0.0)
    truth = replace(start, setup=start.setup.with_effect(LensLaw(1.0)))
    patterns = noisy_patterns(truth, 10, np.random.default_rng(2))
    if named:
        fit = fit_camera(patterns, unknowns=CORE, workers=1)
    else:
        fit = selected(patterns, Setup(plan.camera, start.setup.effects, (0.0, 0.0)), ("lens_law",))
    found = fit.parameters["f_number"]
    off = found.value - truth.values["f_number"]
    assert off > 5 * found.sigma_held, "by noise alone it would be certain, and wrong"
    assert abs(off) < 3 * found.sigma < 0.04 * found.value
    assert "the main lens obeys the sine condition" in fit.held
    # with the true law the true f-number is found
    known = selected(patterns, Setup(plan.camera, truth.setup.effects, (0.0, 0.0)), ("lens_law",))
    size = known.parameters["f_number"]
    assert abs(size.value - truth.values["f_number"]) < 4 * size.sigma_held
    assert "the main lens obeys the tangent law" in known.held


def test_the_lens_law_is_an_unknown_only_with_exact_angles() -> None:
    """By small angles sine and tangent are equal, and no step of the law may switch exact angles on."""
    vector = vector_of(small_plan(15), ["lens_law"])
    (law,) = vector.unknowns
    assert (law.start, law.low, law.high) == (0.0, -0.5, 1.5)
    setup = vector.setup_at(np.array([2.0]))
    assert setup.effect(LensLaw) == LensLaw(1.0) and vector.setup_at(np.zeros(1)).effect(LensLaw) is None
    paraxial = replace(vector.setup, effects=tuple(e for e in vector.setup.effects if not isinstance(e, ExactAngles)))
    assert GROUPS.get("lens_law").unknowns(paraxial, vector.frame) == ()
