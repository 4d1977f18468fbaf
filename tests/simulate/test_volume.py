"""Light fields of volumes against a brute-force sum, and the objects themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix
from lfcal.simulate import light_field, plume, points, simulate_psf, vesicle
from tests.simulate.common import BASE, FAST, difference, small_camera


def brute(h: np.ndarray, g: np.ndarray) -> np.ndarray:
    """f[p] = sum_v g[v] H[v mod n][p - v + c], one voxel at a time."""
    _, ny, nx, nt, ns = h.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    f = np.zeros((g.shape[1] + nt, g.shape[2] + ns))
    for z, y, x in np.argwhere(g):
        f[y : y + nt, x : x + ns] += g[z, y, x] * h[z, y % ny, x % nx]
    return f[ct : ct + g.shape[1], cs : cs + g.shape[2]]


@pytest.mark.parametrize("shape", [(2, 3, 4, 5, 7), (1, 4, 2, 9, 3), (3, 1, 1, 1, 1)])
def test_projection_against_brute_force(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    h = rng.random(shape).astype(np.float32)
    g = (rng.random((shape[0], 11, 14)) * (rng.random((shape[0], 11, 14)) < 0.4)).astype(np.float32)
    f = light_field(g, PSFMatrix(h), workers=1)
    assert f.shape == (11, 14) and np.allclose(f, brute(h, g), rtol=1e-5)
    assert np.array_equal(f, light_field(g, PSFMatrix(h), workers=3))
    assert not np.allclose(f, brute(h[:, ::-1], g)) or shape[1] == 1, "positions must not be reversed"


@pytest.mark.long
def test_a_plan_is_simulated_through_the_same_h() -> None:
    camera = small_camera()
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0, 3.0], cutout=31), period=(19, 33))
    g = points((2, 40, 50), 6, np.random.default_rng(0), margin=3)
    direct = light_field(g, plan, effects=BASE, sampling=FAST)
    stored = light_field(g, simulate_psf(plan, BASE, "auto", sampling=FAST))
    assert difference(direct, stored) < 1e-6 and direct.max() > 0


def test_dark_rows_are_not_computed() -> None:
    plan = ScanPlan.for_camera(small_camera(), virtual_depths=[4.0], cutout=31)
    g = np.zeros((1, 19, 33), np.float32)
    asked = []
    h = PSFMatrix(np.ones(plan.shape, np.float32))
    original = h.plane
    h.plane = lambda z: asked.append(z) or original(z)
    g[0, 4, 5] = 1
    assert light_field(g, h).sum() > 0 and asked == [0]
    assert not light_field(np.zeros_like(g), h).any() and asked == [0]


def test_impossible_volumes_are_refused() -> None:
    h = PSFMatrix(np.ones((2, 2, 2, 3, 3), np.float32))
    for g in (np.ones((1, 5, 5)), np.ones((5, 5)), np.full((2, 5, 5), np.nan)):
        with pytest.raises(InputError, match="volume"):
            light_field(g.astype(np.float32), h)
    with pytest.raises(InputError):
        points((1, 4, 4), 17, np.random.default_rng(0))
    with pytest.raises(InputError):
        vesicle((3, 9, 9), -1.0)


def test_objects() -> None:
    rng = np.random.default_rng(3)
    dots = points((3, 20, 24), 9, rng, margin=4)
    assert dots.sum() == 9 and not dots[:, :4].any() and not dots[:, :, -4:].any()
    shell = vesicle((9, 41, 41), 14.0, 1.5)
    assert shell[4, 20, 20] < 1e-6 and shell[4, 20, 34] == pytest.approx(1) and shell[4, 6, 20] == pytest.approx(1)
    assert np.array_equal(shell, shell[::-1]) and np.array_equal(shell, shell[:, ::-1])
    jet = plume((5, 60, 60), np.random.default_rng(4))
    assert jet.shape == (5, 60, 60) and jet.max() == 1 and jet.min() >= 0
    foot, head = jet[2, -8:].mean(0), jet[2, :8].mean(0)
    width = [np.sqrt(((np.arange(60) - 29.5) ** 2 * p).sum() / p.sum()) for p in (foot, head)]
    assert width[1] > 1.3 * width[0] and np.array_equal(jet, plume((5, 60, 60), np.random.default_rng(4)))
