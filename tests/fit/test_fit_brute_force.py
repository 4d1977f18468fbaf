"""Cameras retrieved from patterns of a simulator that shares no code with the engines (`tests.simulate.brute_force`).

Its integral is paraxial, and so is the fitted model; all else is as in other fits: photon and read noise, sources
beside their places, crosstalk by a plain sum, lenslets aberrated each type by its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import convolve

from lfcal.bench._fit_cameras import random_truth
from lfcal.fit import Setup, fit_camera
from lfcal.fit.model import Fineness, predict
from lfcal.simulate.effects import Crosstalk, ExactAngles, LensletSpherical
from lfcal.simulate.staging import scene_for
from lfcal.threads import one_blas_thread
from tests.fit.common import CORE, measured, small_plan, some_index
from tests.simulate.brute_force import Fineness as Nodes
from tests.simulate.brute_force import brute_force

PLAN = small_plan(21)
NODES = Nodes(pixel=10, reach_um=150.0)
SHARE = 0.012
NEIGHBOURS = np.outer([SHARE, 1 - 2 * SHARE, SHARE], [SHARE, 1 - 2 * SHARE, SHARE])

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    with one_blas_thread():
        yield


def true_setup(rng: np.random.Generator, aberrated: bool) -> Setup:
    """Return a random camera whose main lens has no aberration, by small angles."""
    setup = random_truth(PLAN, rng, size=0.0).setup
    effects = tuple(e for e in setup.effects if not isinstance(e, ExactAngles) and e.name != "zernike")
    found = replace(setup, effects=effects)
    return found.with_effect(LensletSpherical(0.0, 0.1, -0.07, 0.12)) if aberrated else found


def summed(setup: Setup, index: NDArray[np.intp], offsets_px: NDArray[np.float64], crosstalk: bool) -> np.ndarray:
    """Return patterns by the summed integral."""
    out = []
    for (z, y, x), moved in zip(index.tolist(), offsets_px, strict=True):
        scene = replace(scene_for(setup.plan(PLAN), z, setup.effects), cutout=(23, 23))
        at = np.array(scene.source_um(y, x)) + moved * scene.pixel_um
        light = brute_force(scene, (float(at[0]), float(at[1])), (y, x), NODES)
        # by the plain sum over neighbours; light beyond the cutout is in its margin
        out.append((convolve(light, NEIGHBOURS) if crosstalk else light)[1:-1, 1:-1])
    return np.stack(out)


def error(found: np.ndarray, wanted: np.ndarray) -> float:
    scale = (found * wanted).sum() / np.square(found).sum()
    return float(np.abs(scale * found - wanted).sum() / wanted.sum())


@pytest.mark.parametrize("full", [False, True], ids=["as described", "aberrated lenslets, crosstalk, stage"])
def test_the_fit_ends_at_the_engine_s_floor(full: bool) -> None:
    rng = np.random.default_rng(8)
    truth = true_setup(rng, full)
    every = some_index(PLAN, 26)
    fitted, unseen = every[np.arange(26) % 13 != 6], every[np.arange(26) % 13 == 6]
    moved = 0.05 * full * rng.standard_normal((len(fitted), 2))
    light = summed(truth, fitted, moved, full)
    gain = 16000 / light.max()
    data = rng.poisson(gain * np.maximum(light, 0)) + 8.0 * rng.standard_normal(light.shape)
    groups = (*CORE, "lenslet_spherical", "crosstalk") if full else CORE
    start = tuple(e for e in truth.effects if not isinstance(e, LensletSpherical))
    fit = fit_camera(measured(PLAN, data, fitted, (64.0, 1.0)), unknowns=groups, effects=start, workers=1)

    wanted, still = summed(truth, unseen, np.zeros((len(unseen), 2)), full), np.zeros((len(unseen), 2))
    same = truth.with_effect(Crosstalk(SHARE)) if full else truth
    floor = error(predict(same, PLAN, unseen, still, Fineness.finest).astype(float), wanted)
    nominal = replace(truth, camera=PLAN.camera, effects=start)
    described = error(predict(nominal, PLAN, unseen, still, Fineness.finest).astype(float), wanted)
    found = error(predict(fit.ideal_places, PLAN, unseen, still, Fineness.finest).astype(float), wanted)
    print(f"floor {100 * floor:.2f} %, fitted {100 * found:.2f} %, described {100 * described:.0f} %, {fit.verdict}")
    assert floor < 2e-3 and described > 0.1
    assert found < floor + (0.006 if full else 0.004)
    assert fit.complete
    assert (fit.spread.stage_px == pytest.approx(0.05, rel=0.5)) if full else fit.spread.stage_px == 0
