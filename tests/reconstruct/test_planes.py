"""What solvers do to planes: filters against scipy's, threads that change nothing, and as many as memory allows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import convolve1d, uniform_filter

from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from lfcal.reconstruct.projectors import projector
from lfcal.reconstruct.solvers import measurement, planes
from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.planes import UPDATING, box_mean, plane_threads, separable
from tests.reconstruct.oracles import lenslet_psf

SHAPES = [(1, 1), (1, 7), (5, 1), (40, 33)]


def plane_of(shape, dtype):
    return (1000 * np.random.default_rng(0).random(shape)).astype(dtype)


@pytest.mark.parametrize(("dtype", "off"), [(np.float32, 1e-6), (np.float64, 1e-13)])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("window", [(1, 1), (3, 3), (4, 6), (55, 95)])
def test_mean_over_a_window_is_that_of_scipy(shape, window, dtype, off):
    plane = plane_of(shape, dtype)
    found = box_mean(plane, window)
    truth = uniform_filter(plane.astype(float), window, mode="nearest")
    assert (found.dtype, found.shape) == (np.dtype(dtype), shape)
    assert np.abs(found - truth).max() <= off * np.abs(truth).max()


@pytest.mark.parametrize(("dtype", "off"), [(np.float32, 1e-6), (np.float64, 1e-13)])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", [1, 5, 59])
def test_separable_filter_is_that_of_scipy(shape, size, dtype, off):
    plane, x = plane_of(shape, dtype), np.linspace(-2, 2, size)
    kernel = np.exp(-(x**2)) / np.exp(-(x**2)).sum()
    truth = plane.astype(float)
    for axis in (0, 1):
        truth = convolve1d(truth, kernel, axis=axis, mode="constant")
    found = separable(plane, kernel)
    assert (found.dtype, found.shape) == (np.dtype(dtype), shape)
    assert np.abs(found - truth).max() <= off * np.abs(truth).max()


@pytest.mark.parametrize("name", ["sieve", "rl-biggs", "isra"])
def test_threads_change_no_bit_of_a_reconstruction(name, monkeypatch):
    H, image = lenslet_psf(3, 5, 15), np.random.default_rng(1).random((41, 37))
    for module, limit, value in (
        (measurement, "BAND", 100),
        (measurement, "LARGE", 0),
        (planes, "LEAST", 0),
        (projector, "LARGE", 0),
    ):
        monkeypatch.setattr(module, limit, value)
    volumes, ends = [], []
    for workers in ("1", "3"):
        monkeypatch.setenv("LFCAL_WORKERS", workers)
        found = reconstruct(Projector(H, image.shape, workers=int(workers)), image, SolverChoice(name, 4))
        volumes.append(found.volume)
        ends.append([(one.residual, one.change, str(one.likelihood)) for one in found.history])
    np.testing.assert_array_equal(*volumes)
    assert ends[0] == ends[1]


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("masked", [False, True])
def test_fit_is_the_deviance_by_its_definition(weighted, held, masked, monkeypatch):
    rng = np.random.default_rng(3)
    monkeypatch.setattr(measurement, "BAND", 60)  # the last of seven bands is shorter
    data, model = rng.poisson(3, (20, 19)).astype(float), rng.random((20, 19)) + 0.5
    model[3, 4] = 0  # under a lit pixel: the floor stands in for it
    data[3, 4] = 2
    mask = rng.random(data.shape) < 0.6 if masked else None
    weights = rng.random(data.shape) if weighted else None
    out = rng.random(data.shape) < 0.2 if held else None
    measured = Measurement.of(data, dtype=np.float64, weights=weights, held_out=out)
    trust = (1.0 if weights is None else weights) * (1.0 if mask is None else mask) * np.ones_like(data)
    m = np.maximum(model, 1e-3)
    terms = m - data + np.where(data > 0, data * np.log(np.where(data > 0, data, 1) / m), 0)
    kept = trust if out is None else trust * ~out
    found = measured.fit(model, mask, 1e-3)
    assert found.likelihood == pytest.approx(-(kept * terms).sum(), rel=1e-12)
    norm = np.sqrt((kept * data**2).sum())
    assert found.residual == pytest.approx(np.sqrt((kept * (data - model) ** 2).sum()) / norm, rel=1e-12)
    if out is not None:
        assert found.held_out == pytest.approx(-(trust * out * terms).sum(), rel=1e-12)
        assert found.held_out_error > 0
    else:
        assert np.isnan(found.held_out)


def test_as_many_planes_at_once_as_memory_allows(monkeypatch):
    monkeypatch.setenv("LFCAL_WORKERS", "16")
    assert plane_threads(11, 10**5) == 1, "small planes"
    monkeypatch.setattr(planes, "LEAST", 0)
    monkeypatch.setattr(planes, "free_memory", lambda: 10 * 1000 * UPDATING)
    assert plane_threads(11, 100) == 10
    assert plane_threads(3, 1) == 3
    assert plane_threads(11, 10**6) == 1
    monkeypatch.setenv("LFCAL_WORKERS", "2")
    assert plane_threads(11, 1) == 2
