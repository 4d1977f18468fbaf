"""Light from beside the frame: a volume that goes on beyond it."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector
from lfcal.reconstruct.margin import cropped, usual_margin, widened, widened_start
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, reconstruct
from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.solver import Solver
from tests.reconstruct.oracles import dense, lenslet_psf

MARGIN = 9
SHAPE = (50, 45)


@pytest.fixture(scope="module")
def scene():
    """Return H, its anchor, and the frame cut out of the image of an even volume that goes on on all sides."""
    H = lenslet_psf(3, 5, 31)
    wide = Projector(H, (SHAPE[0] + 60, SHAPE[1] + 60), (31, 33))
    truth = np.full(wide.volume_shape, 40.0)
    image = np.random.default_rng(0).poisson(wide.forward(truth)).astype(float)
    return H, image[30:-30, 30:-30]


def with_margin(H, margin):
    return Projector(H, (SHAPE[0] + 2 * margin, SHAPE[1] + 2 * margin), (1 + margin, 3 + margin))


def test_it_is_the_same_equation_with_more_unknowns():
    """By plain algebra: the rows of the matrix of the wider frame that lie in the frame, and all its columns."""
    rng = np.random.default_rng(1)
    H, m = rng.random((2, 3, 2, 5, 5)), 2
    P = Projector(H, (9 + 2 * m, 8 + 2 * m), (1 + m, m), dtype=np.float64)
    inside = np.zeros((9 + 2 * m, 8 + 2 * m), bool)
    inside[m:-m, m:-m] = True
    A = dense(H, inside.shape, (1 + m, m))[inside.ravel()]
    f, b = rng.uniform(1, 20, 72), 0.7
    g = np.full(A.shape[1], (f - b).sum() / A.sum())
    for _ in range(4):
        g = g / A.sum(0) * (A.T @ (f / (A @ g + b)))
    found = reconstruct(P, f.reshape(9, 8), SolverChoice("rl", 4, b, margin=m))
    np.testing.assert_allclose(found.state.volume.ravel(), g, rtol=1e-9)
    np.testing.assert_allclose(found.volume, g.reshape(2, 13, 12)[:, m:-m, m:-m], rtol=1e-9)


@pytest.mark.parametrize("name", SOLVERS.names())
def test_edges_are_as_bright_as_the_rest(scene, name):
    H, image = scene
    ratios = []
    for margin in (0, MARGIN):
        count = 4 if name == "phase-space" else 12
        volume = reconstruct(with_margin(H, margin), image, SolverChoice(name, count, margin=margin)).volume
        assert volume.shape == (3, *SHAPE)
        border = np.ones(SHAPE, bool)
        border[3:-3, 3:-3] = False
        ratios.append(volume[:, border].mean() / volume[:, 12:-12, 12:-12].mean())
    assert abs(ratios[1] - 1) < 0.5 * abs(ratios[0] - 1)


def test_starts_and_weights_are_continued(scene):
    H, image = scene
    P = with_margin(H, MARGIN)
    first = reconstruct(P, image, SolverChoice("rl", 3, margin=MARGIN))
    narrow = reconstruct(P, image, SolverChoice("rl", 1, margin=MARGIN), initial=first.volume)
    wide = reconstruct(P, image, SolverChoice("rl", 1, margin=MARGIN), initial=first.state.volume)
    assert narrow.volume.shape == wide.volume.shape
    np.testing.assert_allclose(narrow.volume[:, 15:-15, 15:-15], wide.volume[:, 15:-15, 15:-15], rtol=0.02)
    spoilt = image.copy()
    spoilt[20, 20] = 1e9
    weights = np.ones(SHAPE)
    weights[20, 20] = 0
    kept = reconstruct(P, spoilt, SolverChoice("rl", 2, margin=MARGIN), weights=weights).volume
    assert kept.max() < 10 * first.volume.max()
    with pytest.raises(InputError, match="initial volume"):
        reconstruct(P, image, SolverChoice("rl", 1, margin=MARGIN), initial=np.ones((3, 7, 7)))


def test_pixels_of_the_margin_are_not_counted(scene):
    """Nothing was recorded there: it is neither saturated nor lost."""
    _, image = scene
    weights = widened(np.ones_like(image), 4)
    for fill in (np.nan, 1e6):
        found = Measurement.of(widened(image, 4, fill), dtype=float, weights=weights, saturation=1e5)
        assert found.notes == () and (found.weights == weights).all()
    image = image.copy()
    image[3, 5] = 1e6
    choice = SolverChoice("rl", 1, saturation=1e5, margin=4)
    assert reconstruct(with_margin(scene[0], 4), image, choice).notes == ("1 saturated pixel was left out",)


def test_arrays_and_sizes():
    volume = np.arange(2 * 6 * 8.0).reshape(2, 6, 8)
    np.testing.assert_array_equal(cropped(widened_start(volume, 3, (2, 12, 14)), 3), volume)
    assert widened(np.ones((2, 3)), 2).shape == (6, 7) and widened(np.ones((2, 3)), 2).sum() == 6
    assert usual_margin((15, 15), (181, 181), (425, 425)) == 30
    assert usual_margin((95, 55), (129, 129), (4384, 6576)) == 64
    assert usual_margin((5, 5), (15, 15), (30, 31)) == 3
    with pytest.raises(InputError, match="margin"):
        SolverChoice("rl", margin=-1)


def test_a_solver_that_takes_no_weights_has_no_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would take the empty pixels beside the frame for dark ones."""
    plain = Solver("plain", "of another distribution", lambda *_: iter(()), frozenset({"background"}))
    monkeypatch.setattr(type(SOLVERS), "get", lambda *_: plain)
    assert SolverChoice("plain").margin == 0
    with pytest.raises(InputError, match=r"cannot ignore pixels outside the frame, got 5; set it to 0"):
        SolverChoice("plain", margin=5)


@pytest.mark.parametrize(
    ("period", "cutout", "shape", "margin"),
    [
        ((2, 9), (101, 51), (800, 640), 18),
        ((9, 2), (51, 101), (640, 800), 18),
        ((40, 40), (9, 31), (800, 640), 15),
        ((40, 40), (101, 101), (80, 96), 12),
        ((40, 40), (1, 1), (80, 96), 0),
    ],
)
def test_the_usual_margin_is_the_least_of_three(
    period: tuple[int, int], cutout: tuple[int, int], shape: tuple[int, int], margin: int
) -> None:
    """Two periods, what patterns reach, an eighth of the frame; each of its longer side."""
    assert usual_margin(period, cutout, shape) == margin
