"""Memory of reconstructions: what is foretold against what Python and numpy really took."""

import tracemalloc

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.psf import Facts, PSFMatrix
from lfcal.reconstruct import Projector
from lfcal.reconstruct.memory import room_for_projections, run_memory
from lfcal.reconstruct.solvers import penalty
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct


class Stored:
    """H as it lies in a file: what is read of it is a copy."""

    def __init__(self, planes: int, period: int, cutout: int) -> None:
        self.values = np.random.default_rng(0).random((planes, period, period, cutout, cutout), np.float32)
        self.shape, self.dtype = self.values.shape, self.values.dtype

    def __getitem__(self, key: object) -> np.ndarray:
        return np.array(self.values[key])

    def __len__(self) -> int:
        return len(self.values)


H = Stored(8, 5, 15)
SHAPE = (330, 310)


@pytest.mark.parametrize("name", [solver.name for solver in SOLVERS])
@pytest.mark.parametrize("method", ["polyphase", "direct", "sparse", "reduced"])
@pytest.mark.few(5)
def test_what_is_foretold_is_taken(name, method):
    P = Projector(H, SHAPE, method=method, workers=1, tolerance=0.01 if method == "reduced" else 0)
    assert foretold_over_taken(P, SolverChoice(name, 3)) == pytest.approx(1, abs=0.2)


def foretold_over_taken(P: Projector, choice: SolverChoice) -> float:
    image = np.random.default_rng(1).random(SHAPE, np.float32)
    small = Projector(H.values, (12, 12), method=P.method, tolerance=P.tolerance, workers=1)
    for _ in iter_reconstruct(small, image[:12, :12], choice):
        pass  # what is loaded and compiled at the first use does not count
    foretold = run_memory(P, choice)
    tracemalloc.start()
    if not choice.solver.in_parts:
        P.prepare()
    for _ in iter_reconstruct(P, image, choice):
        pass
    taken = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return (foretold.total - foretold.program) / taken


def test_planes_that_are_not_kept_count_as_they_are_used():
    whole = run_memory(Projector(H, SHAPE, method="direct", workers=1), SolverChoice())
    kept = Projector(H, SHAPE, method="polyphase", workers=1)
    tight = Projector(H, SHAPE, method="polyphase", workers=1, memory_limit=kept.forecast().chosen.memory_bytes // 3)
    assert whole.matrix == H.values.nbytes
    assert run_memory(tight, SolverChoice()).matrix == 0
    assert foretold_over_taken(tight, SolverChoice(iterations=2)) == pytest.approx(1, abs=0.2)


def test_a_plane_whose_noise_is_reduced_counts_twice_while_it_is_read():
    noise = np.tile([1.0, 1.0], (*H.shape[:3], 1))
    costs = [
        Projector(PSFMatrix(H.values, facts=facts), SHAPE, workers=1).forecast().options
        for facts in (None, Facts.of(H.shape[:3], H.shape[3:], noise=noise))
    ]
    more = [noisy.prepare_bytes - exact.prepare_bytes for exact, noisy in zip(*costs, strict=True)]
    assert len(more) > 1 and set(more) == {H.values[0].nbytes}


def test_what_is_left_for_projections():
    shape = (8, 1000, 1000)
    volume = 8 * 1000 * 1000 * 4
    room = [room_for_projections(shape, SolverChoice(name), 4, memory=10**9) for name in ("rl", "rl-biggs")]
    assert room[0] - room[1] == pytest.approx(5 * volume, rel=0.06)
    warm = room_for_projections(shape, SolverChoice("rl"), 4, memory=10**9, warm=True)
    assert room[0] - warm == volume
    shared = room_for_projections(shape, SolverChoice("rl"), 4, memory=10**9, share=2)
    assert room[0] - shared == pytest.approx(5e8)
    assert room_for_projections(shape, SolverChoice("rl"), 8, memory=10**9) < room[0]


def test_no_room_is_told_with_what_to_do():
    shape = (8, 1000, 1000)
    with pytest.raises(InputError, match=r"rl-biggs alone.*choose rl, which needs 3 volumes in memory instead of 8"):
        room_for_projections(shape, SolverChoice("rl-biggs"), 4, memory=200_000_000)
    with pytest.raises(InputError, match=r"smaller image or fewer planes; or use fewer than 4 threads \(--workers\)$"):
        room_for_projections(shape, SolverChoice("rl"), 4, memory=200_000_000, share=4)


def test_subsets_are_prepared_once_and_together_as_large_as_the_whole():
    masks = [np.arange(25).reshape(5, 5) % 4 == k for k in range(4)]
    for method in ("polyphase", "sparse"):
        P = Projector(H, SHAPE, method=method, workers=1)
        parts = [P.subset(mask).prepare() for mask in masks]
        assert all(P.subset(mask) is part for mask, part in zip(masks, parts, strict=True))
        assert P.operand_bytes() == 0
        whole = Projector(H, SHAPE, method=method, workers=1).prepare().operand_bytes()
        assert sum(part.operand_bytes() for part in parts) == pytest.approx(whole, rel=0.02)
    P = Projector(H, SHAPE, method="direct", workers=1)
    assert P.subset(masks[0]).prepare().operand_bytes() == P.operand_bytes() == P.subset(masks[1]).operand_bytes() > 0


@pytest.mark.parametrize("kind", [penalty.TotalVariation, penalty.Tikhonov])
@pytest.mark.parametrize("z_weight", [0.0, 0.3])
@pytest.mark.parametrize("planes", [1, 2, 4, 5, 11])
def test_a_gradient_made_plane_by_plane_is_the_gradient(monkeypatch, kind, z_weight, planes):
    volume = np.random.default_rng(2).random((planes, 9, 8), np.float32)
    found = kind(0.1, z_weight).gradient(volume)
    monkeypatch.setattr(penalty, "_by_slabs", lambda volume, of, _: of(volume))
    np.testing.assert_array_equal(found, kind(0.1, z_weight).gradient(volume))


@pytest.mark.parametrize(
    "name", ["rl", *(pytest.param(n, marks=pytest.mark.long) for n in ("phase-space", "rl-biggs"))]
)
def test_a_run_that_stops_by_itself_keeps_more(name):
    P = Projector(H, SHAPE, method="direct", workers=1)
    assert foretold_over_taken(P, SolverChoice(name, 5, auto=True)) == pytest.approx(1, abs=0.2)
