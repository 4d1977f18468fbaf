"""The anchor in the lattice of a three-type array, wherever in the cell it lies."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor

TYPES = (LensType(900.0), LensType(1000.0), LensType(1100.0))


def camera(step: int) -> Camera:
    lattice = LensletLattice("hexagonal", 110.0, 500.0, TYPES, 0.001, (123.0, -45.0), type_step=step)
    return Camera("c", MainLens(), lattice, Sensor((801, 1001), 5.0))


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("nearest", [1, 2])
def test_an_anchor_under_another_type_is_measured_from_type_0(step: int, nearest: int) -> None:
    """Brute force over every lenslet: the nearest one is of another type and does not count."""
    given = camera(step)
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)))
    rows, columns = np.array([given.pixels((float(x), float(y))) for x, y in given.lattice.centres_um(q, r)]).T
    types = given.lattice.type_of(q, r)
    start = int(np.flatnonzero((types == nearest) & (np.abs(q) < 4) & (np.abs(r) < 4))[0])
    anchor = (float(rows[start]) + 1.5, float(columns[start]) - 2.0)
    away = np.hypot(rows - anchor[0], columns - anchor[1])
    assert types[np.argmin(away)] == nearest
    zero = np.flatnonzero(types == 0)[np.argmin(away[types == 0])]
    plan = ScanPlan(given, (9, 9), (9, 9), (0.0,), anchor)
    assert plan.lattice_anchor == pytest.approx((anchor[0] - rows[zero], anchor[1] - columns[zero]))
    assert np.hypot(*plan.lattice_anchor) > 10
