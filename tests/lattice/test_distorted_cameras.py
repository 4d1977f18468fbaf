from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.lattice import measure
from lfcal.lattice.fit import fit_lattice
from lfcal.lattice.lattice_fit import LatticeFit
from tests.lattice.cameras import COUNT, DistortedCamera, distorted_camera
from tests.lattice.white_frames import draw_white


def rms(camera: DistortedCamera, fit: LatticeFit) -> float:
    errors = camera.truth.errors(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    return math.sqrt(float((errors**2).sum(1).mean()))


def true_terms(camera: DistortedCamera, fit: LatticeFit) -> np.ndarray:
    """Return the terms that plain least squares finds in the exact places: the truth in the fit's own form."""
    bend = fit.distortion
    assert bend is not None
    places = camera.truth.seen(camera.truth.indices(fit.centres_px(*fit.index.T)))[:, ::-1]
    straight = fit.index @ fit.basis_px() + bend.invert(np.array(fit.origin_px[::-1]))
    u, v = ((straight - np.array(bend.centre)) / bend.scale).T
    plain = [np.ones_like(u), u, v]
    if bend.model == "radial":
        # about the fitted centre a radial distortion has quadratic terms, too
        rho = u * u + v * v
        zero = np.zeros_like(u)
        columns = [np.concatenate([c, zero]) for c in plain] + [np.concatenate([zero, c]) for c in plain]
        columns += [np.concatenate([3 * u * u + v * v, 2 * u * v]), np.concatenate([2 * u * v, u * u + 3 * v * v])]
        columns.append(np.concatenate([rho * u, rho * v]))
        answer = np.linalg.lstsq(np.stack(columns, -1), places.T.ravel(), rcond=None)[0]
        return answer[-1:]
    bent = [u**i * v**j for i, j in ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))]
    answer = np.linalg.lstsq(np.stack([*plain, *bent], -1), places, rcond=None)[0]
    return answer[3:].T.ravel()


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 2])
def test_two_of_the_distorted_cameras(number: int) -> None:
    trial = measure(number, workers=1)
    assert trial.form == trial.called and trial.rms_px < 0.01 and trial.pull < 2


@pytest.mark.long
def test_every_distorted_camera_to_a_twentieth_of_a_pixel() -> None:
    """Every micro-image within 0.05 px rms of the truth, and coefficients as far off as their errors say."""
    z = []
    for number in range(COUNT):
        camera = distorted_camera(number)
        fit = fit_lattice(camera.truth.frame, pitch_px=camera.nominal_px)
        assert fit.form == camera.form and fit.errors is not None and fit.distortion is not None
        assert rms(camera, fit) < 0.05
        z.append((np.concatenate(fit.distortion.terms) - true_terms(camera, fit)) / np.concatenate(fit.errors.terms))
    every = np.concatenate(z)
    # chi² per coefficient, and no coefficient far outside
    assert 0.5 < float((every**2).mean()) < 1.6
    assert np.abs(every).max() < 5


@pytest.mark.long
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_without_distortion_the_straight_lattice_is_chosen(kind: str) -> None:
    for seed in range(6):
        truth = draw_white((700, 900), 11.0 + 2 * seed, kind, rotation=0.13 * seed, seed=seed)
        fit = fit_lattice(truth.frame)
        assert fit.form == "affine"
        assert fit.pitch_px == pytest.approx(truth.pitch, abs=3e-4)
