"""Drifts in frames of a simulator that shares no code with the engines (`tests.simulate.brute_force`).

Each bead is at one of 60 places. Its light is a summed Fresnel integral.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.fit import NewFrame
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.recalibrate import watch
from tests.recalibrate.common import described, small_plan, the_window
from tests.recalibrate.test_recalibrate_brute_force import paraxial, summed

pytestmark = pytest.mark.long

PLACES, BEADS = 60, 12
PLAN = small_plan((2.4,), 56)
SETUP = paraxial(described(PLAN))


def places() -> NDArray[np.intp]:
    """Return the places of beads (z, y, x), none at the edge."""
    ny, nx = the_window(PLAN).plan.period
    cells = np.random.default_rng(0).choice((ny - 6) * (nx - 6), PLACES, replace=False)
    return np.stack([np.zeros(PLACES, int), cells // (nx - 6) + 3, cells % (nx - 6) + 3], axis=1)


def frames(count: int, seed: int, **drift: float) -> list[NewFrame]:
    """Return frames of different beads, after a drift by changes of the camera's unknowns."""
    own, index = the_window(PLAN).plan, places()
    vector = Vector(SETUP, ScanScales.of(own), ("geometry",))
    patterns = summed(vector.setup_at(vector.at(drift)), own, index)
    (ny, nx), (nt, ns) = own.period, own.cutout
    found = []
    for k in range(count):
        rng, light = np.random.default_rng(seed + k), np.zeros((ny + nt - 1, nx + ns - 1))
        for n in rng.choice(PLACES, BEADS, replace=False):
            _, y, x = index[n]
            light[y : y + nt, x : x + ns] += rng.uniform(0.3, 1) * patterns[n]
        electrons = rng.poisson(3000 * light / light.max() + 20) + 3 * rng.standard_normal(light.shape)
        found.append(NewFrame(electrons.astype(np.float32), noise=(9.0, 1.0), label=f"{seed + k}"))
    return found


def test_drifts_are_found_and_quiet_frames_give_no_alarm() -> None:
    quiet, camera = frames(224, 0), SETUP.camera
    pixel, gap = camera.sensor.pixel_um, camera.lattice.gap_um
    shifted = frames(30, 1000, offset_x_um=0.05 * pixel)
    wider = frames(30, 2000, gap_um=2e-3 * gap)
    share = {}
    for name, series in (("quiet", quiet[24:]), ("shift", shifted), ("gap", wider)):
        found = watch(series, SETUP, PLAN, quiet=quiet[:24], mean=1 if name == "quiet" else 3)
        share[name] = np.mean([one.alarm for one in found.means])
        values = np.array([one.values for one in found.frames])
        print(name, f"{share[name]:.3f}", np.nanmean(values, 0), np.nanstd(values, 0), found.verdict)
        assert found.holds is (name == "quiet")
    # 200 quiet frames; the gap is known half as well as on a sensor of the usual size
    assert share["quiet"] <= 0.01 and share["shift"] >= 0.95 and share["gap"] >= 0.95
