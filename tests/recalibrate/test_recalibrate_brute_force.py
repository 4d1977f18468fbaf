"""Recalibration on frames of a simulator that shares no code with the engines (`tests.simulate.brute_force`).

Each bead is at its own place on the sensor, and its light is a summed Fresnel integral. The error of H is judged at
positions without beads.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.fit import NewFrame, Setup, Vector
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import ScanScales
from lfcal.recalibrate import recalibrate
from lfcal.recalibrate.recalibrate import DETERMINED
from lfcal.simulate.effects import ExactAngles
from lfcal.simulate.staging import scene_for
from tests.recalibrate.common import described, small_plan, the_window
from tests.simulate.brute_force import Fineness as Nodes
from tests.simulate.brute_force import brute_force

pytestmark = pytest.mark.long

BEADS, UNSEEN = 24, 6
WRONG = {"gap_um": 1.5, "rotation_rad": 5e-4, "pitch_um": 0.03, "offset_y_um": -1.1, "offset_x_um": 1.6}
WRONG |= {"focal_1_um": 4.0, "f_number": 0.15}


def summed(setup: Setup, plan: ScanPlan, index: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return patterns ``(n, nt, ns)`` by the summed integral."""
    found = []
    for z, y, x in index.tolist():
        scene = scene_for(setup.plan(plan), z, setup.effects)
        row, column = scene.source_um(y, x)
        found.append(brute_force(scene, (float(row), float(column)), (y, x), Nodes(pixel=10, reach_um=150.0)))
    return np.stack(found)


def paraxial(setup: Setup) -> Setup:
    """Return the setup without exact angles, which the summed integral does not have."""
    return replace(setup, effects=tuple(one for one in setup.effects if not isinstance(one, ExactAngles)))


def test_h_of_an_independent_simulator_is_found_on_one_frame_of_beads() -> None:
    plan = small_plan(side=80)
    own, rng = the_window(plan).plan, np.random.default_rng(0)
    start = paraxial(described(plan))
    vector = Vector(start, ScanScales.of(own), DETERMINED)
    signs = rng.choice([-1.0, 1.0], len(WRONG)) * rng.uniform(0.5, 1, len(WRONG))
    true = vector.setup_at(vector.at({name: s * v for s, (name, v) in zip(signs, WRONG.items(), strict=True)}))
    (ny, nx), (nt, ns) = own.period, own.cutout
    cells = rng.choice(2 * (ny - 6) * (nx - 6), BEADS + UNSEEN, replace=False)
    index = np.stack(np.unravel_index(cells, (2, ny - 6, nx - 6)), axis=1) + np.array([0, 3, 3])
    patterns = summed(true, own, index)
    light = np.zeros((ny + nt - 1, nx + ns - 1))
    for (_, y, x), one in zip(index[:BEADS].tolist(), patterns, strict=False):
        light[y : y + nt, x : x + ns] += rng.uniform(0.3, 1) * one
    mean = 3000 * light / light.max() + 20
    electrons = rng.poisson(mean) + 3 * rng.standard_normal(mean.shape)
    frame = NewFrame(electrons.astype(np.float32), noise=(9.0, 1.0))
    found = recalibrate([frame], plan, effects=start.effects)

    def error(setup: Setup) -> float:
        made = predict(setup, own, index[BEADS:], np.zeros((UNSEEN, 2)), Fineness.fine)
        return float(np.abs(made - patterns[BEADS:]).sum() / patterns[BEADS:].sum())

    before, floor, after = error(start), error(true), error(found.setup)
    values = vector.values(vector.at({name: s * v for s, (name, v) in zip(signs, WRONG.items(), strict=True)}))
    pulls = np.array([(one.value - values[name]) / one.sigma for name, one in found.parameters.items()])
    print(f"{before:.3f} -> {after:.4f}, floor {floor:.4f}, {found.verdict}, pulls {np.sqrt(np.mean(pulls**2)):.2f}")
    assert found.accepted and before > 0.05
    assert after < max(0.012, 2 * floor), (before, after, floor)
    assert np.sqrt(np.mean(pulls**2)) < 1.8, pulls
