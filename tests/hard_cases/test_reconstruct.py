"""Where naive deconvolution divides by zero, drifts or blows up."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors.forecast import METHODS
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, reconstruct
from lfcal.reconstruct.solvers.least_squares import conjugate_gradient
from lfcal.reconstruct.solvers.measurement import NothingMeasured
from tests.reconstruct.oracles import lenslet_psf

pytestmark = pytest.mark.hard_case


def blind_spot_psf(rng):
    """Return an H in which one source position is never seen: HT1 = 0 there."""
    H = rng.random((2, 3, 3, 5, 5))
    H[:, 1, 2] = 0
    return H


@pytest.mark.parametrize("name", SOLVERS.names())
def test_voxels_no_pixel_sees_stay_zero(name):
    rng = np.random.default_rng(0)
    P = Projector(blind_spot_psf(rng), (16, 17))
    unseen = P.grid.tiled(np.arange(9).reshape(3, 3) == 5)
    assert np.abs(P.adjoint(np.ones((16, 17)))[:, unseen]).max() < 1e-5
    volume = reconstruct(P, rng.uniform(1, 9, (16, 17)), SolverChoice(name, 10)).volume
    assert np.isfinite(volume).all()
    assert np.abs(volume[:, unseen]).max() <= 1e-5 * volume.max() or name in ("rl-tv", "rl-tikhonov")


@pytest.mark.parametrize("name", SOLVERS.names())
@pytest.mark.parametrize("case", ["all zero", "one photon", "huge range", "all masked", "holes"])
@pytest.mark.few(20)
def test_extreme_images_give_finite_volumes(name, case):
    P = Projector(lenslet_psf(2, 5, 15), (30, 31))
    image = np.zeros((30, 31))
    weights = None
    if case == "one photon":
        image[14, 15] = 1
    elif case == "huge range":
        image[:] = np.logspace(-12, 12, image.size).reshape(image.shape)
    elif case == "all masked":
        image[:], weights = 5.0, np.zeros_like(image)
    elif case == "holes":
        image[:] = 5.0
        image[3, 4], image[10, 10], image[20, 20:25] = np.nan, np.inf, 4095
    choice = SolverChoice(name, 15, saturation=4095 if case == "holes" else None)
    if case in ("all zero", "all masked"):
        with pytest.raises(NothingMeasured):
            reconstruct(P, image, choice, weights=weights)
        return
    result = reconstruct(P, image, choice, weights=weights)
    assert np.isfinite(result.volume).all()
    assert all(np.isfinite([r.residual, r.likelihood, r.change]).all() for r in result.history)
    if case == "one photon":
        # Richardson-Lucy conserves the light a pixel received: sum of HT1 * g is the image's sum.
        total = float((result.volume * P.adjoint(np.ones_like(image))).sum())
        assert name not in ("rl", "rl-biggs", "rl-nesterov") or np.isclose(total, 1, rtol=1e-3)
    if case == "holes":
        assert len(result.notes) == 2


@pytest.mark.few(1)
@pytest.mark.parametrize("method", METHODS)
def test_single_precision_likelihood_never_falls_over_500_iterations(method):
    P = Projector(lenslet_psf(1, 4, 9), (22, 21), method=method)
    rng = np.random.default_rng(1)
    truth = np.zeros(P.volume_shape)
    truth[0, rng.integers(3, 18, 9), rng.integers(3, 18, 9)] = 300
    image = rng.poisson(np.maximum(P.forward(truth), 0) + 1.0)
    result = reconstruct(P, image, SolverChoice("rl", 500, background=1.0))
    likelihood = np.array([r.likelihood for r in result.history])
    rounding = 4e-6 * image.sum()  # what single precision can tell of a sum of that size
    assert (np.diff(likelihood) > -rounding).all()
    assert likelihood[-1] > likelihood[20]


def test_planes_alike_near_the_native_plane_share_the_light():
    H = np.repeat(lenslet_psf(1, 5, 15), 3, axis=0)
    H[1] *= 1 + 1e-6  # three planes no image can tell apart
    P = Projector(H, (31, 30))
    truth = np.zeros(P.volume_shape)
    truth[0, 15, 15] = 100
    image = P.forward(truth)
    for name in ("rl", "rl-biggs"):
        volume = reconstruct(P, image, SolverChoice(name, 60)).volume
        assert np.isfinite(volume).all()
        assert np.allclose(volume[0], volume[2], rtol=1e-3, atol=1e-3 * volume.max())
        assert np.isclose(volume[:, 12:19, 12:19].sum(), 100, rtol=0.1)
    assert conjugate_gradient(P, image, 60, damping=1e-4).volume[0, 15, 15] < 100


@pytest.mark.parametrize(
    ("period", "shape"),
    [((4, 6), (25, 26)), ((40, 31), (25, 26)), ((2, 2), (5, 4))],
    ids=["even", "larger than the image", "tiny image"],
)
def test_unusual_periods_reconstruct(period, shape):
    rng = np.random.default_rng(2)
    H = rng.random((1, *period, 7, 9))
    truth = np.zeros((1, *shape))
    truth[0, shape[0] // 2, shape[1] // 2] = 50
    P = Projector(H, shape, (3, -5))
    result = reconstruct(P, P.forward(truth), SolverChoice("rl", 200))
    assert result.history[-1].residual < 0.05
    assert np.argmax(result.volume) == np.argmax(truth)


def test_signed_matrix_and_negative_pixels():
    rng = np.random.default_rng(3)
    H = lenslet_psf(2, 5, 15) + 1e-4 * rng.standard_normal((2, 5, 5, 15, 15))
    P = Projector(H, (30, 30))
    image = rng.normal(0.0, 3.0, (30, 30))
    image[10:20, 10:20] += 100
    result = reconstruct(P, image, SolverChoice("rl", 30))
    assert np.isfinite(result.volume).all() and result.volume.min() >= 0
    assert "negative" in result.notes[0]
    noted = reconstruct(P, image, SolverChoice("rl", 30, read_noise=12.0))
    assert noted.notes == ()
    assert np.isfinite(noted.volume).all()
