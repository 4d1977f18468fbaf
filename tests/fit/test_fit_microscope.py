"""Microscopes retrieved from patterns of dipoles, by a simulator that shares no code with the engines.

Patterns are those of `tests.simulate.microscope_oracle`, converged to 2e-5, with photon and read noise of an 80 % full
pixel. Objective, array and stage are otherwise than described, and the fit chooses by itself what to look for.
Positions at which fits are judged are in none of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.threads import one_blas_thread
from lfcal.camera import ScanPlan
from lfcal.fit import Fit, Setup, fit_camera
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import starting_effects
from lfcal.fit.spread import spread_out
from lfcal.simulate.effects import IndexMismatch, Spherical
from lfcal.simulate.effects.base import Effect
from lfcal.simulate.staging import scene_for
from tests.fit.common import measured, small_camera
from tests.simulate.microscope_oracle import DipoleFields

COUNT = 40
UNSEEN = 8

pytestmark = pytest.mark.long


@dataclass(frozen=True)
class Case:
    """A preset, and what is otherwise.

    Attributes
    ----------
    depths_um, cutout
        The scan.
    gap, focal, aperture
        Errors of gap, focal length and numerical aperture (shares).
    away_um
        How much farther away the planes are than planned.
    waves
        W040 of the objective.
    specimen
        Index, described and true depth of a specimen; None: there is none.
    """

    name: str
    depths_um: tuple[float, float]
    cutout: int
    gap: float
    focal: float
    aperture: float
    away_um: float
    waves: float
    specimen: tuple[float, float, float] | None = None

    @property
    def plan(self) -> ScanPlan:
        return _plan(self)

    @property
    def start(self) -> tuple[Effect, ...]:
        """What the fit starts from."""
        return self._effects(1)

    def _effects(self, which: int) -> tuple[Effect, ...]:
        found = starting_effects(self.plan)
        return found if self.specimen is None else (*found, IndexMismatch(self.specimen[0], self.specimen[which]))

    @property
    def truth(self) -> Setup:
        camera, pixel = self.plan.camera, self.plan.camera.sensor.pixel_um
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
        effects = (*self._effects(2), Spherical(self.waves))
        return Setup(replace(camera, lattice=lattice, optics=optics), effects, (self.away_um,) * 2)


@cache
def _plan(case: Case) -> ScanPlan:
    return ScanPlan.for_camera(small_camera(case.name), depths_um=list(case.depths_um), cutout=case.cutout)


DRY = Case("lfm_20x05", (-6.0, 9.0), 31, gap=0.015, focal=-0.01, aperture=0.02, away_um=0.7, waves=0.25)
IN_WATER = Case(
    "lfm_60x12",
    (-1.0, 2.0),
    31,
    gap=-0.012,
    focal=0.01,
    aperture=-0.015,
    away_um=0.15,
    waves=0.2,
    specimen=(1.38, 12.0, 14.0),
)
CASES = pytest.mark.parametrize("case", [DRY, IN_WATER], ids=["20x, dry", "60x, in a specimen"])


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with one_blas_thread():
        yield


@cache
def recorded(case: Case) -> tuple[NDArray[np.intp], np.ndarray, NDArray[np.intp], np.ndarray]:
    """Return positions that are fitted and their light by sums over dipoles, and the same of others."""
    every = np.argwhere(np.ones(case.plan.shape[:3], bool))
    every = every[spread_out(every, COUNT + UNSEEN, case.plan.period)]
    truth = case.truth
    light = np.empty((len(every), *case.plan.cutout))
    for z, further in enumerate(truth.depth_errors_um):
        scene = scene_for(truth.plan(case.plan), z, truth.effects, depth_error_um=further)
        fields = DipoleFields(scene)
        for k in np.flatnonzero(every[:, 0] == z):
            y, x = every[k, 1:].tolist()
            light[k] = fields.response(scene, scene.source_um(y, x), (y, x))
    aside = np.arange(len(every)) % 6 == 3
    return every[~aside], light[~aside], every[aside], light[aside]


def fit_of(case: Case, count: int = COUNT, brighter: float = 1.0) -> Fit:
    """Return the fit of ``count`` noisy patterns, all of them fitted."""
    index, light, _, _ = recorded(case)
    sensor, rng = case.plan.camera.sensor, np.random.default_rng(1)
    electrons = brighter * 0.8 * sensor.full_well_e / light.max() * light
    data = rng.poisson(electrons) + sensor.read_noise_e * rng.standard_normal(light.shape)
    used = spread_out(index, count, case.plan.period)
    patterns = measured(case.plan, data[used], index[used], (sensor.read_noise_e**2, 1.0))
    return fit_camera(patterns, effects=case.start, workers=1)


def unlike(case: Case, setup: Setup) -> float:
    """Return how far a setup's patterns are off at the unseen positions (relative L1), their light alike by plane."""
    _, _, index, wanted = recorded(case)
    found = predict(setup, case.plan, index, np.zeros((len(index), 2)), Fineness.finest).astype(float)
    for z in (0, 1):
        own = index[:, 0] == z
        found[own] *= (found[own] * wanted[own]).sum() / np.square(found[own]).sum()
    return float(np.abs(found - wanted).sum() / wanted.sum())


def told(case: Case, fit: Fit) -> float:
    """Return how far a fit's patterns are off, printed beside the floor."""
    floor, found = unlike(case, case.truth), unlike(case, fit.ideal_places)
    print(f"floor {100 * floor:.3f} %, fitted {100 * found:.3f} %, {fit.verdict}")
    return found


@CASES
def test_forty_patterns_end_near_the_engine_s_floor(case: Case) -> None:
    described = Setup(case.plan.camera, case.start, (0.0, 0.0))
    floor = unlike(case, case.truth)
    assert floor < 1e-3 and unlike(case, described) > 0.1
    fit = fit_of(case)
    assert told(case, fit) < min(floor + 0.0015, 0.006)
    assert fit.complete and fit.spread.stage_px == 0


@CASES
def test_six_patterns_are_enough_for_a_percent(case: Case) -> None:
    fit = fit_of(case, 6)
    assert told(case, fit) < 0.008 and fit.complete


def test_a_depth_that_others_may_stand_for_has_their_error() -> None:
    """The wavefront is ρ⁴, which holds defocus beside Zernike's term: 0.2 waves of it are a micron of depth."""
    fit = fit_of(IN_WATER, 10)
    told(IN_WATER, fit)
    depth = fit.parameters["specimen_depth_um"]
    print(f"depth {depth.value:.2f} ± {depth.sigma:.2g} µm ({depth.sigma_held:.2g} with all else held)")
    assert abs(depth.value - 14.0) < 3 * depth.sigma < 9.0
    # distance, lens law and the lenslets' own waves change the gap a little
    gap = fit.parameters["gap_um"]
    true = IN_WATER.truth.camera.lattice.gap_um
    assert abs(gap.value - true) < 3.5 * gap.sigma and gap.sigma < 4 * gap.sigma_held
    # what nothing stands for is as sure as it was
    angle = fit.parameters["rotation_rad"]
    assert angle.sigma < 1.1 * angle.sigma_held
