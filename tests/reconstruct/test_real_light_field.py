"""A real light field of a vesicle (napari-LF example data): corrected, resampled, reconstructed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import CorrectionChain, Dark, White, read_image
from lfcal.lattice.fit import fit_lattice
from lfcal.reconstruct import Projector
from lfcal.reconstruct.resample import Resampling, lattice_anchor_of
from lfcal.reconstruct.solvers.choice import SolverChoice, reconstruct
from lfcal.reconstruct.solvers.multiplicative import richardson_lucy
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.simulate import simulate_psf

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "lfm_guv"


def ring_profile(plane, centre):
    """Return the mean of ``plane`` at each whole distance from ``centre``."""
    r, c = np.indices(plane.shape)
    distance = np.hypot(r - centre[0], c - centre[1]).round().astype(int).ravel()
    return np.bincount(distance, plane.ravel()) / np.bincount(distance)


def measured(depths, cutout):
    """Return projector, frame on H's period, weights, its resampling, H's lattice anchor, and H of the microscope."""
    frame, white, dark = (read_image(DATA / f"{n}_GUVExperim1.tif") for n in ("Lightfield", "Radiometry", "DarkFrame"))
    fit = fit_lattice(white.astype(float), dark=dark.astype(float), kind="square")
    camera = preset("lfm_60x12")
    pitch = 100.1
    camera = replace(
        camera,
        lattice=replace(camera.lattice, pitch_um=pitch),
        sensor=replace(camera.sensor, shape=(435, 435), pixel_um=pitch / 15),
    )
    plan = ScanPlan.for_camera(camera, depths_um=depths, cutout=cutout)
    H = simulate_psf(plan, plan_effects(plan, 0.3), tolerance=0.3)
    corner = lattice_anchor_of(H)
    view = Resampling.of_fit(fit, H.period, corner)
    chain = CorrectionChain((Dark(dark), White(white, dark)))
    image = view.apply(chain.apply(frame))
    P = Projector(H, view.shape, view.anchor(corner), threshold=0.01, memory_limit=10**9)
    return P, image, view.inside(frame.shape), view, corner, H


@pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the measured light field in {DATA}")
@pytest.mark.long
def test_vesicle_appears_as_a_shell():
    P, image, weights, view, corner, H = measured((-3.0, 3.0), 151)
    result = richardson_lucy(P, image, 6, weights=weights, read_noise=20)
    assert result.history[-1].residual < 0.7 * result.history[0].residual
    for plane in result.volume:
        rows, columns = np.indices(plane.shape)
        bright = np.where(plane > np.percentile(plane[40:-40, 40:-40], 92), plane, 0)[40:-40, 40:-40]
        centre = [float((i[40:-40, 40:-40] * bright).sum() / bright.sum()) for i in (rows, columns)]
        profile = ring_profile(plane, centre)[:180]
        edge = int(np.argmax(profile[60:])) + 60
        # A vesicle of 24 to 30 um: bright on its rim, dark within and without.
        assert 95 < edge < 140
        assert profile[edge] > 2 * profile[: edge - 40].mean()
        assert profile[edge] > 2 * profile[edge + 30 :].mean()
    # With the lattice half a lenslet off, H explains the image less well.
    wrong = Projector(H, view.shape, np.add(view.anchor(corner), 7), threshold=0.01, memory_limit=10**9)
    off = richardson_lucy(wrong, image, 6, weights=weights, read_noise=20)
    assert off.history[-1].residual > 1.2 * result.history[-1].residual


def dots(volume, period):
    """Return the light of the native plane's brighter part of the mean lenslet over the volume's, and its excess."""
    plane = volume[len(volume) // 2, 2 * period : -2 * period, 2 * period : -2 * period]
    rows, columns = (n // period for n in plane.shape)
    cell = plane[: rows * period, : columns * period].reshape(rows, period, columns, period).mean((0, 2), dtype=float)
    above = np.maximum(cell - cell.mean(), 0).sum() * rows * columns
    return float(above / volume.sum(dtype=float)), float(cell.max() / cell.mean()) - 1


@pytest.mark.skipif(not DATA.is_dir(), reason=f"needs the measured light field in {DATA}")
@pytest.mark.long
def test_the_default_draws_no_lenslets_into_the_native_plane():
    """Light in dots there and their excess: below a twentieth of Richardson-Lucy's, at a likelihood that is higher."""
    P, image, weights, *_ = measured([float(z) for z in range(-7, 8)], 241)
    found = {
        name: reconstruct(P, image, SolverChoice(name, 15, read_noise=20), weights=weights) for name in ("rl", "sieve")
    }
    assert found["sieve"].history[-1].likelihood > found["rl"].history[-1].likelihood
    plain, ours = (dots(found[name].volume, 15) for name in ("rl", "sieve"))
    assert plain[1] > 0.25
    assert ours[0] < 0.05 * plain[0] and ours[1] < 0.05 * plain[1], (plain, ours)
