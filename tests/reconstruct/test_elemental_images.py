"""A Fourier light-field microscope from frames to a volume: assembled, judged, transposed, exported, reconstructed."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from scipy.signal import fftconvolve

from lfcal.camera import Camera, Microscope, PupilLenslets, ScanPlan, Sensor
from lfcal.judge import inspect
from lfcal.psf import PSFMatrix, assemble_plan, codes_for, export
from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from lfcal.simulate import SimulatedCamera, simulate_psf
from lfcal.simulate.effects import Quantisation, ReadNoise, ShotNoise

DEPTHS = (-40.0, -20.0, 0.0, 20.0, 40.0)


@pytest.fixture(scope="module")
def plan():
    lenslets = PupilLenslets(((-310.0, 20.0), (250.0, -260.0), (180.0, 330.0)), 30e3, 1e4, (1e4,), 400.0)
    sensor = Sensor((281, 281), 5.5, 12, 20e3, 5.0, black_level=100.0)
    return ScanPlan.for_camera(Camera("small", Microscope(20.0, 0.4), lenslets, sensor), depths_um=DEPTHS, cutout=161)


@pytest.fixture(scope="module")
def H(plan):
    return simulate_psf(plan, (), tolerance=0.02)


def test_every_frame_becomes_the_one_pattern_of_its_plane(plan, H):
    frames = SimulatedCamera(plan, (ShotNoise(), ReadNoise(), Quantisation()), seed=3)
    found = assemble_plan(frames, plan).matrix
    assert found.shape == (5, 1, 1, 161, 161)
    assert found.camera == plan.camera
    for z in range(5):
        assert np.corrcoef(found.plane(z).ravel(), H.plane(z).ravel())[0, 1] > 0.98


def test_the_projection_is_the_convolution_with_each_plane_and_its_transpose_is_exact(H):
    for z in range(len(H)):
        assert np.array_equal(H.T.plane(z)[0, 0], H.plane(z)[0, 0][::-1, ::-1])
    P, rng = Projector(H, (181, 181), dtype="float64"), np.random.default_rng(0)
    g, f = rng.random(P.volume_shape), rng.random((181, 181))
    image = P.forward(g)
    assert float((image * f).sum()) == pytest.approx(float((g * P.adjoint(f)).sum()), rel=1e-9)
    truth = sum(fftconvolve(g[z], H.plane(z)[0, 0].astype(float), mode="same") for z in range(len(H)))
    assert np.abs(image - truth).max() < 1e-5 * truth.max()


@pytest.mark.long
def test_a_noise_free_matrix_has_no_fault_with_or_without_its_camera(H):
    report, bare = inspect(H), PSFMatrix(np.stack([H.plane(z) for z in range(5)]), depths=list(DEPTHS))
    for one in (report, inspect(bare)):
        assert [m.spec.key for m in one.metrics if m.merit in ("bad", "fair")] == []
    for key in ("centring", "leak", "truncation", "background"):  # they need a pattern about the middle of the cutout
        assert not report[key].applies


def test_a_plane_recorded_twice_is_found(plan, H):
    values = np.stack([H.plane(z) for z in (0, 1, 1, 3, 4)])
    report = inspect(PSFMatrix(values, depths=list(DEPTHS), camera=plan.camera, anchor=plan.anchor))
    assert report["plane_copies"].merit == "bad"


def test_beads_are_found_at_their_places(H):
    rng = np.random.default_rng(4)
    places = [(z, int(y), int(x)) for z in range(5) for y, x in rng.integers(60, 121, (2, 2))]
    P = Projector(H, (181, 181))
    volume = np.zeros(P.volume_shape, np.float32)
    for place in places:
        volume[place] = 1.0
    light = P.forward(volume)
    frame = rng.poisson(np.maximum(light, 0) / light.max() * 5000).astype(np.float32)
    found = reconstruct(P, frame, SolverChoice(iterations=25)).volume
    for z, y, x in places:
        near = found[max(0, z - 1) : z + 2, y - 2 : y + 3, x - 2 : x + 3]
        assert near.max() > 20 * np.percentile(found, 99)


def test_h_is_exported_for_codes_of_such_microscopes_only(H, tmp_path):
    export(H, tmp_path / "psf.tif", code="flfm")

    stack = tifffile.imread(tmp_path / "psf.tif")
    assert stack.shape == (5, 161, 161)
    assert [code.name for code in codes_for(H)] == ["flfm"]
    assert np.allclose(stack[2], H.plane(2)[0, 0], rtol=1e-5, atol=1e-9)
