"""A cell scanned on a distorted array: plan, scene, inspection and reconstruction take the array as it is there."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lfcal.camera import Camera, LatticeDistortion, ScanPlan, preset
from lfcal.judge.quality import inspect as inspect_matrix
from lfcal.judge.quality._lattice import wave_vectors
from lfcal.psf import PSFMatrix
from lfcal.reconstruct.resample import lattice_anchor_of
from lfcal.simulate.staging import ideal_scene, outlook_of, scene_of

DEPTH = 3.0


@pytest.fixture(scope="module")
def camera() -> Camera:
    """Return a camera whose pitch grows by 3 % from the middle to the place scanned, and whose rows turn there."""
    plain = preset("bench")
    scale = 0.5 * min(plain.sensor.shape) * plain.sensor.pixel_um
    terms = ((0.01 * scale, 0.002 * scale, 0.0), (0.0, 0.004 * scale, 0.012 * scale))
    bend = LatticeDistortion("polynomial", (0.0, 0.0), scale, terms)
    return replace(plain, lattice=replace(plain.lattice, distortion=bend))


@pytest.fixture(scope="module")
def plan(camera: Camera) -> ScanPlan:
    row, column = (0.7 * n for n in camera.sensor.shape)
    return ScanPlan.for_camera(camera, virtual_depths=[DEPTH], cutout=41, anchor=(round(row), round(column)))


def neighbours(camera: Camera, plan: ScanPlan) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre (row, column) of the lenslet at the anchor and the steps (x, y) to its neighbours (px)."""
    x, y = camera.sensor_um(plan.anchor)
    q, r = (int(v) for v in np.rint(camera.lattice.lenslet_at((x, y))))
    own = camera.pixels(camera.lattice.centres_um(q, r))
    ends = [camera.pixels(camera.lattice.centres_um(q + i, r + j)) for i, j in ((1, 0), (0, 1))]
    starts = [camera.pixels(camera.lattice.centres_um(q - i, r - j)) for i, j in ((1, 0), (0, 1))]
    return own, np.array([(e - s)[::-1] / 2 for e, s in zip(ends, starts, strict=True)])


def test_the_scene_is_the_array_about_the_cell(camera: Camera, plan: ScanPlan) -> None:
    scene = ideal_scene(plan, outlook_of(plan, 0))
    seen, types = scene.lattice.lenslets_within(400.0, 400.0)
    x, y = camera.sensor_um(plan.anchor)
    true, kinds = camera.lattice.lenslets_within(90.0, 90.0, (float(x), float(y)))
    away = np.hypot(*(true - (x, y) - scene.scale * seen[:, None]).transpose(2, 0, 1)) / camera.sensor.pixel_um
    assert away.min(0).max() < 0.15
    assert np.array_equal(types[away.argmin(0)], kinds)
    # that of the straight lattice would be off by more
    assert abs(scene.lattice.pitch_um * scene.scale / camera.lattice.pitch_um - 1) > 0.003


def test_without_a_place_a_scene_is_that_of_the_middle(camera: Camera) -> None:
    bend = camera.lattice.distortion
    assert bend is not None
    aside = replace(camera, lattice=replace(camera.lattice, distortion=replace(bend, centre=(-2000.0, 1000.0))))
    scene = scene_of(aside, cutout=(9, 9))
    local = aside.lattice.local((0.0, 0.0))
    assert scene.lattice.distortion is None
    assert scene.lattice.pitch_um * scene.scale == pytest.approx(local.pitch_um)


def test_the_plan_s_period_is_that_of_the_cell(camera: Camera, plan: ScanPlan) -> None:
    _, (a, b) = neighbours(camera, plan)
    across = float(np.hypot(*a)), 2 * abs(a[0] * b[1] - a[1] * b[0]) / float(np.hypot(*a))
    wanted = camera.local(plan.anchor).period_px
    three = len(camera.lattice.types) == 3
    assert wanted == pytest.approx((across[1], across[0] * (3 if three else 1)), rel=2e-3)
    residual = np.array(wanted) * plan.cells - plan.period
    assert plan.period_residual_px == pytest.approx(tuple(residual))
    exact = replace(plan, resample=True)
    assert np.array(plan.period) / np.array(exact.resample_factors) == pytest.approx(np.array(wanted) * plan.cells)


def test_wave_vectors_are_those_of_the_cell(camera: Camera, plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """A step to a neighbour is a whole number of waves of the lattice that is asked for."""
    used = []

    def recorded(*arguments: object) -> np.ndarray:
        used.append(wave_vectors(*arguments))  # type: ignore[arg-type]
        return used[-1]

    # the package has a function of the module's name
    monkeypatch.setattr(sys.modules["lfcal.judge.quality._inspect"], "wave_vectors", recorded)
    values = np.random.default_rng(0).random((1, 2, 3, 21, 21), np.float32)
    inspect_matrix(PSFMatrix(values, depths=(0.0,), camera=camera, anchor=plan.anchor), workers=1)
    _, steps = neighbours(camera, plan)
    turns = used[0] @ steps.T / (2 * math.pi)
    assert np.abs(turns - np.rint(turns)).max() < 3e-3
    turns = wave_vectors(camera, plan.period) @ steps.T / (2 * math.pi)
    assert np.abs(turns - np.rint(turns)).max() > 0.01


def test_the_anchor_counts_from_the_nearest_true_micro_image(camera: Camera, plan: ScanPlan) -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-40, 41), np.arange(-40, 41)))
    zero = camera.lattice.type_of(q, r) == 0
    centres = camera.pixels(camera.lattice.centres_um(q[zero], r[zero]))
    nearest = centres[np.argmin(np.hypot(*(centres - plan.anchor).T))]
    away = np.array(plan.anchor) - nearest
    exact = replace(plan, resample=True)
    assert plan.lattice_anchor == pytest.approx(tuple(away), abs=1e-6)
    H = SimpleNamespace(shape=plan.shape, camera=camera, anchor=plan.anchor)
    assert lattice_anchor_of(H) == pytest.approx(tuple(away * exact.resample_factors), abs=1e-6)
