"""Metrics, phantoms, smoothing widths, two-point resolution, and the benchmarks that report them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks import project, reconstruct
from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import PHANTOMS, nrmse, phantom, points, vesicle
from lfcal.reconstruct.resolution import dip, two_point
from lfcal.reconstruct.solvers.smoothing import DepthSmoothing, lanczos_kernel, smoothing_widths
from tests.reconstruct.oracles import lenslet_psf


def test_nrmse_by_hand():
    truth = np.array([3.0, 4.0])
    assert nrmse(truth + 1, truth) == pytest.approx(math.sqrt(2) / 5)
    with pytest.raises(InputError, match="truth"):
        nrmse(truth, np.zeros(2))
    with pytest.raises(InputError, match="compare"):
        nrmse(truth, np.zeros(3))


def test_phantoms_are_at_their_places():
    spot = points((3, 9, 9), [(1, 4, 5), (1, 4, 5)])
    assert spot.sum() == 2 and spot[1, 4, 5] == 2
    shell = vesicle((21, 41, 41), radius=8, z_step=1.0)
    assert shell[10, 20, 20] < 1e-5 and shell[10, 20, 28] > 0.99 and shell[18, 20, 20] > 0.99
    for name in PHANTOMS:
        volume = phantom(name, (4, 30, 36))
        assert volume.shape == (4, 30, 36) and volume.min() >= 0 and volume.max() > 0
        assert np.array_equal(volume, phantom(name, (4, 30, 36)))
    with pytest.raises(InputError, match="phantom"):
        phantom("unicorn", (1, 9, 9))


def test_smoothing_widths_of_a_microscope_fall_with_depth():
    camera = preset("lfm_20x05")
    depths = [camera.depth_of(v) for v in (0.0, 1.0, 2.0, 5.0)]
    widths = smoothing_widths(camera, depths)
    # focused at infinity: p/|v| less half of it, doubled; a whole lenslet up to v = 1
    assert np.allclose(widths, [15, 15, 7.5, 3])
    assert np.allclose(smoothing_widths(camera, [-d for d in depths]), widths)


def test_smoothing_keeps_waves_that_the_lenslets_sample():
    kernel = lanczos_kernel(6.0)
    f = np.arange(kernel.size) - (kernel.size - 1) / 2
    response = [abs((kernel * np.exp(-2j * np.pi * f / period)).sum()) for period in (1e9, 24, 12, 6)]
    assert response[0] == pytest.approx(1)
    assert response[1] > 0.95 and 0.3 < response[2] < 0.7 and response[3] < 0.05
    flat = DepthSmoothing((6.0, 1.0)).apply(np.ones((2, 50, 60)))
    assert np.allclose(flat[:, 24:26, 29:31], 1, atol=1e-3) and np.allclose(flat[1], 1)
    with pytest.raises(InputError, match="one per plane"):
        DepthSmoothing((6.0,)).apply(np.ones((2, 9, 9)))


def test_dip_between_two_peaks():
    x = np.arange(60)
    apart = np.exp(-((x - 20) ** 2) / 8) + np.exp(-((x - 40) ** 2) / 8)
    merged = np.exp(-((x - 29) ** 2) / 80) + np.exp(-((x - 31) ** 2) / 80)
    assert dip(apart, 20, 40) < 1e-3
    assert dip(merged, 28, 32) > 0.95
    assert dip(np.zeros(60), 20, 40) == 1


def test_two_points_resolve_from_some_distance_on():
    P = Projector(lenslet_psf(1, 5, 15), (24, 31))
    (result,) = two_point(P, distances=(2, 6, 10), iterations=25, photons=1e6)
    assert result.dips[2] < 0.5 and result.distance <= 10
    (quiet,) = two_point(P, distances=(6,), iterations=3, seed=None)
    assert quiet.plane == 0


def test_projections_are_compared(capsys):
    rows = project.measure(60, 5, 21, 1, 1, 1)
    names = ["polyphase, float64", "polyphase, float32", "direct, float32", "per-position FFT, scipy"]
    assert [r.name for r in rows[:4]] == names
    assert rows[0].mismatch < 1e-12
    assert all(r.error < 1e-5 and r.pair_s > 0 for r in rows)
    project.show(rows, "small")
    assert "÷ fastest of lfcal" in capsys.readouterr().out


def test_errors_and_seconds_of_solvers_are_compared(tmp_path, capsys):
    H = PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32))
    truth, frame = reconstruct.scene(H, 40, 500.0, "points", 1)
    chosen = ("Richardson-Lucy", "threshold 5e-2", "Biggs-Andrews", "float64", "Tikhonov 0.1")
    settings = [s for s in reconstruct.SETTINGS if s.name in chosen]
    curves = [reconstruct.measure(s, H, truth, frame, 4, 1) for s in settings]
    plain = curves[0]
    assert plain.iterations == (1, 2, 3, 4) and plain.errors[-1] < plain.errors[0]
    assert np.isclose(plain.errors[-1], curves[1].errors[-1], rtol=1e-3)  # single against double precision
    reference = reconstruct.against_reference(H, 40, 1)
    assert reference["ratio"] > 0
    reconstruct.draw(curves, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    reconstruct.show(curves, reference, "small")
    assert "smallest NRMSE" in capsys.readouterr().out
