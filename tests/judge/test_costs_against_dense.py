"""Costs of faults compared with a dense Richardson-Lucy reconstruction of beads and lines that shares no code."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks._fault_list import FAULTS
from benchmarks._fault_recordings import Recording
from lfcal.camera import LensletLattice, ScanPlan, preset
from tests.judge.common import SOME
from tests.judge.test_inspection import inspected

IMAGE, MARGIN, ITERATIONS = 27, 9, 25

F8 = NDArray[np.float64]


@cache
def square() -> Recording:
    """Return a recording of a camera whose square lenslets are 9 pixels apart: 81 positions of two planes."""
    camera = preset("bench")
    old = camera.lattice
    pitch = 9 * camera.sensor.pixel_um
    scale = pitch / old.pitch_um
    kind = replace(old.types[1], focal_length_um=old.types[1].focal_length_um * scale)
    camera = replace(camera, lattice=LensletLattice("square", pitch, old.gap_um * scale, (kind,)))
    return Recording(ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0)))


def matrix_of(patterns: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the matrix from voxels to pixels, each voxel's pattern written into its column by a loop."""
    nz, ny, nx, nt, ns = patterns.shape
    side = IMAGE + 2 * MARGIN
    out = np.zeros((nz, side, side, IMAGE, IMAGE), np.float32)
    for v in range(side):
        for u in range(side):
            top, left = v - MARGIN - nt // 2, u - MARGIN - ns // 2
            rows = slice(max(0, top), min(IMAGE, top + nt))
            columns = slice(max(0, left), min(IMAGE, left + ns))
            inside = (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
            out[:, v, u, rows, columns] = patterns[:, v % ny, u % nx][:, *inside]
    return out.reshape(nz * side * side, IMAGE * IMAGE).T


@cache
def volume() -> F8:
    """Return beads and a line in each plane, on nothing."""
    rng = np.random.default_rng(77)
    side = IMAGE + 2 * MARGIN
    y, x = np.mgrid[:side, :side]
    out = np.zeros((2, side, side))
    for plane, tilt in zip(out, (0.4, -0.7), strict=True):
        plane += np.exp(-((np.cos(tilt) * (y - side / 2) + np.sin(tilt) * (x - side / 2)) ** 2))
        for row, column in rng.uniform(MARGIN, side - MARGIN, (6, 2)):
            plane += np.exp(-((y - row) ** 2 + (x - column) ** 2) / 2)
    return out.ravel()


@cache
def image() -> F8:
    seen = matrix_of(square().light()) @ volume()
    found: F8 = seen + 0.05 * seen.mean()
    return found


def reconstructed(patterns: NDArray[np.float32]) -> F8:
    A = np.maximum(matrix_of(patterns), 0).astype(np.float64)
    background = 0.05 * image().mean() / 1.05
    weight, g = A.sum(0), np.ones(A.shape[1])
    for _ in range(ITERATIONS):
        g *= (A.T @ (image() / (A @ g + background))) / np.maximum(weight, 1e-9 * weight.max())
    side = IMAGE + 2 * MARGIN
    return g.reshape(2, side, side)[:, MARGIN:-MARGIN, MARGIN:-MARGIN]


@cache
def error_of(name: str, strength: float) -> float:
    """Return the error of a reconstruction with a recording (NRMSE), beside one with the light itself."""
    r = square()
    patterns = r.clean() if not name else next(one for one in FAULTS if one.name == name).put_in(r, strength)
    found, wanted = reconstructed(patterns), reconstructed(r.light())
    scale = (found * wanted).sum() / np.square(found).sum()
    return float(np.linalg.norm(scale * found - wanted) / np.linalg.norm(wanted))


HARD = [
    ("periodic error of the screw", 0.35),
    ("stage moved during exposures", 12),
    ("focus that drifts in each plane", 0.25),
    ("glow of the amplifier", 0.03),
    ("dead column", 1.0),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "strength"), HARD)
def test_costs_are_within_a_factor_2_of_a_dense_reconstruction(name: str, strength: float) -> None:
    r = square()
    fault = next(one for one in FAULTS if one.name == name)
    found = inspected(r.matrix(fault.put_in(r, strength)), SOME)
    true = np.sqrt(error_of(name, strength) ** 2 - error_of("", 0) ** 2)
    assert found.clean is not None and found.as_it_is is not None
    costs = np.array([one.cost for one in found.faults], float)
    named = np.array([one.name in fault.named for one in found.faults])
    told = np.sqrt(np.square(costs[named]).sum())
    assert named.any() and true / 2 < told < 2 * true, (told, true)
    assert np.hypot(found.clean, np.sqrt(np.square(costs).sum())) == pytest.approx(found.as_it_is, rel=0.35)


@pytest.mark.long
def test_few_saturated_values_cost_next_to_nothing() -> None:
    r = square()
    fault = next(one for one in FAULTS if one.name == "few saturated values")
    true = np.sqrt(max(0.0, error_of(fault.name, 120) ** 2 - error_of("", 0) ** 2))
    found = inspected(r.matrix(fault.put_in(r, 120)), SOME)
    told = max((one.cost or 0.0 for one in found.faults), default=0.0)
    assert max(told, true) < 0.05 and not found.bad
