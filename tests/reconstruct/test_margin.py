"""Volumes that extend beyond the frame, and the memory of reconstructions: the forecast and what numpy really uses."""

from __future__ import annotations

import itertools
import tracemalloc

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.psf import Facts, PSFMatrix
from lfcal.reconstruct import Projector
from lfcal.reconstruct.margin import cropped, usual_margin, widened, widened_start
from lfcal.reconstruct.memory import room_for_projections, run_memory
from lfcal.reconstruct.solvers import penalty
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct, reconstruct
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


def test_a_margin_is_the_same_equation_with_more_unknowns():
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
def test_a_margin_makes_edges_as_bright_as_the_rest(scene, name):
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


def test_margins_are_added_and_removed():
    volume = np.arange(2 * 6 * 8.0).reshape(2, 6, 8)
    np.testing.assert_array_equal(cropped(widened_start(volume, 3, (2, 12, 14)), 3), volume)
    assert widened(np.ones((2, 3)), 2).shape == (6, 7) and widened(np.ones((2, 3)), 2).sum() == 6
    with pytest.raises(InputError, match="margin"):
        SolverChoice("rl", margin=-1)


def test_a_solver_without_weights_has_no_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would take the empty pixels outside the frame for dark ones."""
    plain = Solver("plain", "of another package", lambda *_: iter(()), frozenset({"background"}))
    monkeypatch.setattr(type(SOLVERS), "get", lambda *_: plain)
    assert SolverChoice("plain").margin == 0
    with pytest.raises(InputError, match=r"cannot ignore pixels outside the frame, got 5; set it to 0"):
        SolverChoice("plain", margin=5)


def test_the_usual_margin_is_the_smallest_of_three() -> None:
    """Two periods, the reach of patterns, an eighth of the frame; each of its longer side."""
    for period, cutout, shape, margin in (
        ((15, 15), (181, 181), (425, 425), 30),
        ((95, 55), (129, 129), (4384, 6576), 64),
        ((5, 5), (15, 15), (30, 31), 3),
        ((2, 9), (101, 51), (800, 640), 18),
        ((9, 2), (51, 101), (640, 800), 18),
        ((40, 40), (9, 31), (800, 640), 15),
        ((40, 40), (101, 101), (80, 96), 12),
        ((40, 40), (1, 1), (80, 96), 0),
    ):
        assert usual_margin(period, cutout, shape) == margin


class Stored:
    """H as it lies in a file: what is read of it is a copy."""

    def __init__(self, planes: int, period: int, cutout: int) -> None:
        self.values = np.random.default_rng(0).random((planes, period, period, cutout, cutout), np.float32)
        self.shape, self.dtype = self.values.shape, self.values.dtype

    def __getitem__(self, key: object) -> np.ndarray:
        return np.array(self.values[key])

    def __len__(self) -> int:
        return len(self.values)


STORED = Stored(8, 5, 15)
LARGE_SHAPE = (330, 310)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(solver.name, marks=pytest.mark.long if solver.name in ("osem", "phase-space") else ())
        for solver in SOLVERS
    ],
)
@pytest.mark.parametrize("method", ["polyphase", "direct", "sparse", "reduced"])
@pytest.mark.few(4)
def test_the_forecast_memory_is_used(name, method):
    P = Projector(STORED, LARGE_SHAPE, method=method, workers=1, tolerance=0.01 if method == "reduced" else 0)
    assert forecast_over_used(P, SolverChoice(name, 3)) == pytest.approx(1, abs=0.2)


def forecast_over_used(P: Projector, choice: SolverChoice) -> float:
    image = np.random.default_rng(1).random(LARGE_SHAPE, np.float32)
    small = Projector(STORED.values, (12, 12), method=P.method, tolerance=P.tolerance, workers=1)
    for _ in iter_reconstruct(small, image[:12, :12], choice):
        pass  # what is loaded and compiled at the first use does not count
    forecast = run_memory(P, choice)
    tracemalloc.start()
    if not choice.solver.in_parts:
        P.prepare()
    for _ in iter_reconstruct(P, image, choice):
        pass
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return (forecast.total - forecast.program) / used


def test_planes_that_are_not_kept_count_while_they_are_used():
    whole = run_memory(Projector(STORED, LARGE_SHAPE, method="direct", workers=1), SolverChoice())
    kept = Projector(STORED, LARGE_SHAPE, method="polyphase", workers=1)
    tight = Projector(
        STORED, LARGE_SHAPE, method="polyphase", workers=1, memory_limit=kept.forecast().chosen.memory_bytes // 3
    )
    assert whole.matrix == STORED.values.nbytes
    assert run_memory(tight, SolverChoice()).matrix == 0
    assert forecast_over_used(tight, SolverChoice(iterations=2)) == pytest.approx(1, abs=0.2)


def test_a_plane_whose_noise_is_reduced_counts_twice_while_it_is_read():
    noise = np.tile([1.0, 1.0], (*STORED.shape[:3], 1))
    costs = [
        Projector(PSFMatrix(STORED.values, facts=facts), LARGE_SHAPE, workers=1).forecast().options
        for facts in (None, Facts.of(STORED.shape[:3], STORED.shape[3:], noise=noise))
    ]
    more = [noisy.prepare_bytes - exact.prepare_bytes for exact, noisy in zip(*costs, strict=True)]
    assert len(more) > 1 and set(more) == {STORED.values[0].nbytes}


def test_the_memory_left_for_projections():
    shape = (8, 1000, 1000)
    volume = 8 * 1000 * 1000 * 4
    room = [room_for_projections(shape, SolverChoice(name), 4, memory=10**9) for name in ("rl", "rl-biggs")]
    assert room[0] - room[1] == pytest.approx(5 * volume, rel=0.06)
    warm = room_for_projections(shape, SolverChoice("rl"), 4, memory=10**9, warm=True)
    assert room[0] - warm == volume
    shared = room_for_projections(shape, SolverChoice("rl"), 4, memory=10**9, share=2)
    assert room[0] - shared == pytest.approx(5e8)
    assert room_for_projections(shape, SolverChoice("rl"), 8, memory=10**9) < room[0]


def test_the_message_for_too_little_memory_has_a_remedy():
    shape = (8, 1000, 1000)
    with pytest.raises(InputError, match=r"rl-biggs alone.*choose rl, which needs 3 volumes in memory instead of 8"):
        room_for_projections(shape, SolverChoice("rl-biggs"), 4, memory=200_000_000)
    with pytest.raises(InputError, match=r"smaller image or fewer planes; or use fewer than 4 threads \(--workers\)$"):
        room_for_projections(shape, SolverChoice("rl"), 4, memory=200_000_000, share=4)


def test_subsets_are_prepared_once_and_together_as_large_as_the_whole():
    masks = [np.arange(25).reshape(5, 5) % 4 == k for k in range(4)]
    for method in ("polyphase", "sparse"):
        P = Projector(STORED, LARGE_SHAPE, method=method, workers=1)
        parts = [P.subset(mask).prepare() for mask in masks]
        assert all(P.subset(mask) is part for mask, part in zip(masks, parts, strict=True))
        assert P.operand_bytes() == 0
        whole = Projector(STORED, LARGE_SHAPE, method=method, workers=1).prepare().operand_bytes()
        assert sum(part.operand_bytes() for part in parts) == pytest.approx(whole, rel=0.02)
    P = Projector(STORED, LARGE_SHAPE, method="direct", workers=1)
    assert P.subset(masks[0]).prepare().operand_bytes() == P.operand_bytes() == P.subset(masks[1]).operand_bytes() > 0


def test_penalty_gradients_by_slabs_are_equal(monkeypatch):
    rng, kinds = np.random.default_rng(2), (penalty.TotalVariation, penalty.Tikhonov)
    cases = list(itertools.product(kinds, (0.0, 0.3), [rng.random((n, 9, 8), np.float32) for n in (1, 2, 4, 5, 11)]))
    found = [kind(0.1, z_weight).gradient(volume) for kind, z_weight, volume in cases]
    monkeypatch.setattr(penalty, "_by_slabs", lambda volume, of, _: of(volume))
    for (kind, z_weight, volume), one in zip(cases, found, strict=True):
        np.testing.assert_array_equal(one, kind(0.1, z_weight).gradient(volume))


@pytest.mark.parametrize(
    "name", ["rl", *(pytest.param(n, marks=pytest.mark.long) for n in ("phase-space", "rl-biggs"))]
)
def test_automatic_stopping_needs_more_memory(name):
    P = Projector(STORED, LARGE_SHAPE, method="direct", workers=1)
    assert forecast_over_used(P, SolverChoice(name, 5, auto=True)) == pytest.approx(1, abs=0.2)
