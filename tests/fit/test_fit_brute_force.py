"""Cameras retrieved from patterns of a simulator that shares no code with the engines (`tests.simulate.brute_force`).

Its integral is paraxial, and so is the fitted model; all else is as in other fits: photon and read noise of an 80 %
full pixel, sources beside their places, crosstalk by a plain sum, lenslets aberrated each type by its own. Positions
at which fits are judged are in none of them, so all patterns of a fit are fitted.

Without noise a fit ends at the floor, the engine's own error. What noise adds is what the unknowns' errors make of it:
by squares 0.15 % for 40 patterns of small cutouts, 0.2 % where each source lies 0.05 pixels beside its place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve

from benchmarks._fit_cameras import random_truth
from lfcal.base.threads import one_blas_thread
from lfcal.camera import ScanPlan
from lfcal.fit import Fit, Setup, fit_camera
from lfcal.fit.model import Fineness, predict
from lfcal.fit.spread import spread_out
from lfcal.simulate.effects import Crosstalk, ExactAngles, LensletSpherical
from lfcal.simulate.staging import scene_for
from tests.fit.common import CORE, measured, small_plan, some_index
from tests.simulate.brute_force import Fineness as Nodes
from tests.simulate.brute_force import brute_force

COUNT = 40
UNSEEN = 4
PEAK, READ = 16000.0, 8.0
SHARE = 0.012
NEIGHBOURS = np.outer([SHARE, 1 - 2 * SHARE, SHARE], [SHARE, 1 - 2 * SHARE, SHARE])
STAGE_PX = 0.05

pytestmark = pytest.mark.long


@dataclass(frozen=True)
class Case:
    """Which camera is fitted: as described but for its numbers, or ``full`` of effects."""

    cutout: int
    depths: tuple[float, float]
    reach_um: float
    full: bool

    @property
    def plan(self) -> ScanPlan:
        return small_plan(self.cutout, self.depths)

    @property
    def groups(self) -> tuple[str, ...]:
        return (*CORE, "lenslet_spherical", "crosstalk") if self.full else CORE


PLAIN = Case(21, (2.2, 2.7), 150.0, False)
FULL = Case(41, (3.0, 3.5), 190.0, True)
CASES = pytest.mark.parametrize("case", [PLAIN, FULL], ids=["as described", "aberrated lenslets, crosstalk, stage"])


@dataclass(frozen=True)
class Recorded:
    """Light of a random camera at positions that are fitted and at others, by the summed integral."""

    truth: Setup
    fitted: NDArray[np.intp]
    unseen: NDArray[np.intp]
    light: np.ndarray
    wanted: np.ndarray


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with one_blas_thread():
        yield


def true_setup(case: Case, rng: np.random.Generator) -> Setup:
    """Return a random camera whose main lens has no aberration, by small angles."""
    setup = random_truth(case.plan, rng, size=0.0).setup
    effects = tuple(e for e in setup.effects if not isinstance(e, ExactAngles) and e.name != "zernike")
    found = replace(setup, effects=effects)
    return found.with_effect(LensletSpherical(0.0, 0.1, -0.07, 0.12)) if case.full else found


def summed(case: Case, setup: Setup, index: NDArray[np.intp], offsets_px: NDArray[np.float64]) -> np.ndarray:
    """Return patterns by the summed integral."""
    out, side, nodes = [], case.cutout + 2, Nodes(pixel=10, reach_um=case.reach_um)
    for (z, y, x), moved in zip(index.tolist(), offsets_px, strict=True):
        scene = replace(scene_for(setup.plan(case.plan), z, setup.effects), cutout=(side, side))
        at = np.array(scene.source_um(y, x)) + moved * scene.pixel_um
        light = brute_force(scene, (float(at[0]), float(at[1])), (y, x), nodes)
        # by the plain sum over neighbours; light beyond the cutout is in its margin
        out.append((convolve(light, NEIGHBOURS) if case.full else light)[1:-1, 1:-1])
    return np.stack(out)


@cache
def recorded(case: Case) -> Recorded:
    rng = np.random.default_rng(8)
    truth = true_setup(case, rng)
    every = some_index(case.plan, COUNT + UNSEEN)
    aside = np.arange(len(every)) % 11 == 6
    fitted, unseen = every[~aside], every[aside]
    moved = STAGE_PX * case.full * rng.standard_normal((len(fitted), 2))
    light = summed(case, truth, fitted, moved)
    return Recorded(truth, fitted, unseen, light, summed(case, truth, unseen, np.zeros((len(unseen), 2))))


def fit_of(case: Case, count: int = COUNT, peak: float = PEAK) -> Fit:
    """Return the fit of ``count`` noisy patterns, all of them fitted; ``peak`` are the brightest pixel's electrons."""
    given, rng = recorded(case), np.random.default_rng(1)
    light = peak / given.light.max() * np.maximum(given.light, 0)
    data = rng.poisson(light) + READ * rng.standard_normal(light.shape)
    used = spread_out(given.fitted, count, case.plan.period)
    patterns = measured(case.plan, data[used], given.fitted[used], (READ**2, 1.0))
    start = tuple(e for e in given.truth.effects if not isinstance(e, LensletSpherical))
    whole = replace(patterns, held_out=np.zeros(count, bool))
    return fit_camera(whole, unknowns=case.groups, effects=start, workers=1)


def unlike(case: Case, setup: Setup) -> tuple[float, float]:
    """Return how far a setup's patterns are off at the unseen positions (relative L1 and L2), their light alike."""
    given = recorded(case)
    still = np.zeros((len(given.unseen), 2))
    found = predict(setup, case.plan, given.unseen, still, Fineness.finest).astype(float)
    off = (found * given.wanted).sum() / np.square(found).sum() * found - given.wanted
    l2 = np.sqrt(np.square(off).sum() / np.square(given.wanted).sum())
    return float(np.abs(off).sum() / given.wanted.sum()), float(l2)


def floor_of(case: Case) -> tuple[float, float]:
    """Return how far the true camera's patterns are off."""
    truth = recorded(case).truth
    return unlike(case, truth.with_effect(Crosstalk(SHARE)) if case.full else truth)


def told(case: Case, fit: Fit) -> tuple[float, float]:
    """Return `unlike` of a fit, printed beside the floor."""
    floor, found = floor_of(case), unlike(case, fit.ideal_places)
    print(f"floor {100 * floor[0]:.3f} % (L2 {100 * floor[1]:.3f}), ", end="")
    print(f"fitted {100 * found[0]:.3f} % (L2 {100 * found[1]:.3f}), {fit.verdict}")
    return found


@CASES
def test_forty_patterns_end_near_the_engine_s_floor(case: Case) -> None:
    fit = fit_of(case)
    (l1, l2), floor = told(case, fit), floor_of(case)
    described = replace(recorded(case).truth, camera=case.plan.camera)
    assert floor[0] < 3e-3 and unlike(case, described)[0] > 0.1
    assert l1 < min(floor[0] + 0.0015, 0.006)
    assert l2 < np.hypot(floor[1], 1.5 * fit.held_out_error.statistical), "no more than noise makes of it"
    assert fit.complete
    assert (fit.spread.stage_px == pytest.approx(STAGE_PX, rel=0.3)) if case.full else fit.spread.stage_px == 0


@CASES
def test_six_patterns_are_enough_for_a_percent(case: Case) -> None:
    fit = fit_of(case, 6)
    assert told(case, fit)[0] < 0.008 and fit.complete


@CASES
def test_without_noise_the_fit_ends_at_the_floor(case: Case) -> None:
    l1, l2 = told(case, fit_of(case, peak=1e4 * PEAK))
    assert l1 < floor_of(case)[0] + 0.0003 and l2 < floor_of(case)[1] + 0.0003
