"""H of several regions of the field as one operator: weights, the exact adjoint, the light, and what it gains."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import Setup, described_effects
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import FieldProjector, Projector, SolverChoice, reconstruct
from lfcal.reconstruct.memory import run_memory
from lfcal.reconstruct.projectors.device import ArrayDevice
from lfcal.reconstruct.projectors.field_projector import field_weights, place_weights
from tests.fit.field_common import LAW, camera
from tests.reconstruct.oracles import dense, lenslet_psf

Pair = tuple[float, float]
PLACES: dict[int, list[Pair]] = {
    1: [(3, 4)],
    2: [(3, 4), (13, 15)],
    3: [(3, 4), (13, 3), (8, 20)],
    4: [(0, 0), (1, 20), (17, -2), (15, 22)],
}
SHAPE = (19, 23)


def regions(count: int, period: tuple[int, int] = (4, 3), cutout: tuple[int, int] = (7, 9)) -> list[PSFMatrix]:
    rng = np.random.default_rng(count)
    return [
        PSFMatrix(rng.random((2, *period, *cutout)), anchor=at, depths=(-1.0, 2.0), region=f"r{k}")
        for k, at in enumerate(PLACES[count])
    ]


def middles(matrices: Sequence[PSFMatrix]) -> list[Pair]:
    return [(H.anchor[0] + (H.period[0] - 1) / 2, H.anchor[1] + (H.period[1] - 1) / 2) for H in matrices]


def by_the_definition(matrices: Sequence[PSFMatrix], shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Return the operator entry by entry: the sum of each region's, its columns weighted."""
    weights = field_weights(middles(matrices), shape)
    planes = len(matrices[0])
    return sum(
        (
            dense(np.asarray(H), shape, tuple(map(int, H.anchor))) * np.tile(weight.ravel(), planes)
            for H, weight in zip(matrices, weights, strict=True)
        ),
        np.zeros(()),
    )


# -- weights ---------------------------------------------------------------------------------------------


def test_weights_share_every_voxel() -> None:
    for places, shape in itertools.product(PLACES.values(), (SHAPE, (1, 7), (600, 5))):
        weights = np.array(field_weights(places, shape))
        assert weights.min() >= 0 and weights.max() <= 1
        np.testing.assert_allclose(weights.sum(axis=0), 1, rtol=1e-12)
        for k, place in enumerate(places):
            np.testing.assert_allclose(place_weights(places, np.array([place]))[k], 1, atol=1e-12)


def test_linear_changes_are_interpolated_exactly() -> None:
    """Places and any linear function of them are exact within the triangle; beyond it counts the nearest point."""
    places = [(2.0, 3.0), (40.0, 10.0), (12.0, 50.0)]
    inside = np.array([[15.0, 20.0], [20.0, 25.0], [3.0, 4.5]])
    np.testing.assert_allclose(place_weights(places, inside).T @ np.array(places), inside, atol=1e-9)
    beyond = np.array([[-10.0, -5.0], [100.0, 0.0], [60.0, 60.0]])
    found = place_weights(places, beyond).T @ np.array(places)
    np.testing.assert_allclose(found[:2], places[:2], atol=1e-9)
    side = np.array(places[2]) - np.array(places[1])
    assert abs((beyond[2] - found[2]) @ side) < 1e-9, "nearest on the side between the last two"


def test_regions_on_a_line() -> None:
    places = [(10.0, 10.0), (30.0, 30.0), (20.0, 20.0)]
    points = np.array([[10.0, 10.0], [15.0, 15.0], [25.0, 15.0], [0.0, 0.0], [50.0, 50.0], [25.0, 25.0]])
    wanted = [[1, 0.5, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0.5], [0, 0.5, 1, 0, 0, 0.5]]
    np.testing.assert_allclose(place_weights(places, points), wanted, atol=1e-12)


def test_weights_are_even_from_pixel_to_pixel() -> None:
    """Also where there are more pixels than places at which weights are computed."""
    weight = field_weights([(100.0, 100.0), (900.0, 100.0)], (1000, 300))[1]
    np.testing.assert_allclose(weight[150:850, 7], (np.arange(150, 850) - 100) / 800, atol=1e-12)
    assert (weight[:95] < 1e-9).all() and (weight[905:] > 1 - 1e-9).all()


# -- the operator ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("method", ["direct", "polyphase", "sparse", "fft"])
@pytest.mark.few(5)
def test_the_operator_is_its_definition(method: str, count: int) -> None:
    matrices = regions(count)
    P = FieldProjector(matrices, SHAPE, method=method, dtype=np.float64)
    rng = np.random.default_rng(7)
    volume, image = rng.standard_normal(P.volume_shape), rng.standard_normal(SHAPE)
    wanted = by_the_definition(matrices)
    np.testing.assert_allclose(P.forward(volume).ravel(), wanted @ volume.ravel(), atol=1e-11)
    np.testing.assert_allclose(P.adjoint(image).ravel(), wanted.T @ image.ravel(), atol=1e-11)


@pytest.mark.parametrize("count", [3, *(pytest.param(n, marks=pytest.mark.long) for n in (2, 4))])
def test_the_adjoint_is_exact(count: int) -> None:
    for tolerance in (0.0, 0.02):
        P = FieldProjector(regions(count), SHAPE, dtype=np.float64, tolerance=tolerance)
        rng = np.random.default_rng(count)
        g, f = rng.standard_normal(P.volume_shape), rng.standard_normal(SHAPE)
        ahead, back = float((P.forward(g) * f).sum()), float((g * P.adjoint(f)).sum())
        assert abs(ahead - back) < 1e-12 * float(np.abs(P.forward(np.abs(g))).sum() * np.abs(f).max())


@pytest.mark.parametrize(
    "method", ["direct", "reduced", *(pytest.param(m, marks=pytest.mark.long) for m in ("auto", "polyphase", "sparse"))]
)
def test_of_one_region_it_is_that_regions_projector_to_the_last_bit(method: str) -> None:
    (H,) = regions(1)
    within = 0.05 if method == "reduced" else 0.0
    one, field = (
        kind(what, SHAPE, method=method, tolerance=within) for kind, what in ((Projector, H), (FieldProjector, [H]))
    )
    rng = np.random.default_rng(3)
    g, f = rng.random(one.volume_shape).astype(np.float32), rng.random(SHAPE).astype(np.float32)
    assert field.method == one.method
    assert field.forward(g).tobytes() == one.forward(g).tobytes()
    assert field.adjoint(f).tobytes() == one.adjoint(f).tobytes()
    phases = np.zeros(one.period, bool)
    phases[1::2] = True
    assert field.subset(phases).adjoint(f).tobytes() == one.subset(phases).adjoint(f).tobytes()


def test_equal_regions_are_like_one() -> None:
    """Of an H that is the same everywhere blending makes the same: regions whole periods apart."""
    values = np.random.default_rng(0).random((2, 4, 3, 7, 9))
    many = [PSFMatrix(values, anchor=at) for at in ((0, 0), (4, 12), (16, -3))]
    one, field = Projector(many[0], SHAPE, dtype=np.float64), FieldProjector(many, SHAPE, dtype=np.float64)
    volume = np.random.default_rng(1).random(one.volume_shape)
    np.testing.assert_allclose(field.forward(volume), one.forward(volume), rtol=1e-12)


def test_light_is_the_weighted_mean_of_the_regions_light() -> None:
    """None is lost or made between: each voxel emits what the regions around say it emits."""
    matrices = regions(3)
    matrices = [PSFMatrix(np.asarray(H) * (k + 1), anchor=H.anchor) for k, H in enumerate(matrices)]
    P = FieldProjector(matrices, SHAPE, dtype=np.float64)
    weights = field_weights(middles(matrices), SHAPE)
    for row, column in ((8, 9), (7, 12), (10, 6)):  # patterns lie within the image
        volume = np.zeros(P.volume_shape)
        volume[1, row, column] = 1
        own = [
            w[row, column] * H[1, int(row - H.anchor[0]) % 4, int(column - H.anchor[1]) % 3].sum()
            for H, w in zip(matrices, weights, strict=True)
        ]
        assert float(P.forward(volume).sum()) == pytest.approx(sum(own), rel=1e-12)


def test_an_anchor_moves_all_regions() -> None:
    matrices = regions(3)
    moved = [PSFMatrix(np.asarray(H), anchor=(H.anchor[0] + 5, H.anchor[1] - 2), depths=H.depths) for H in matrices]
    here = FieldProjector(matrices, SHAPE, (PLACES[3][0][0] + 5, PLACES[3][0][1] - 2))
    there = FieldProjector(moved, SHAPE)
    volume = np.random.default_rng(1).random(here.volume_shape)
    assert here.forward(volume).tobytes() == there.forward(volume).tobytes()
    assert here.grid == there.grid


def test_subsets_of_phases_are_masked_operators() -> None:
    rng = np.random.default_rng(0)
    for count in (2, 4):
        P = FieldProjector(regions(count), SHAPE, dtype=np.float64)
        volume, image = rng.random(P.volume_shape), rng.random(SHAPE)
        masks = [np.arange(P.period[0] * P.period[1]).reshape(P.period) % 3 == k for k in range(3)]
        for mask in masks:
            part, tiled = P.subset(mask), P.grid.tiled(mask)
            np.testing.assert_allclose(part.forward(volume), P.forward(volume) * tiled, atol=1e-11)
            np.testing.assert_allclose(part.adjoint(image), P.adjoint(image * tiled), atol=1e-11)
            assert P.subset(mask) is part


def test_regions_are_projected_only_where_their_weights_are_positive() -> None:
    """Of regions far apart each works on its own part of the image; one that weighs nothing is left out."""
    rng = np.random.default_rng(0)
    far = [PSFMatrix(rng.random((1, 3, 3, 5, 5)), anchor=(0, at)) for at in (0, 150, 300, 2000)]
    P = FieldProjector(far, (20, 240), method="direct")
    widths = sorted(part.window[1].stop - part.window[1].start for part in P._parts)
    assert P.regions == 3 and widths[0] < 100 and sum(widths) < 2.2 * 240
    assert [a.start for a, b in pairwise([part.window[0] for part in P._parts])] == [0, 0]


def test_a_field_projector_is_pickled() -> None:
    P = FieldProjector(regions(3), SHAPE, (4.0, 4.7), threshold=0.1)
    volume = np.random.default_rng(1).random(P.volume_shape)
    again = pickle.loads(pickle.dumps(P))
    assert again.forward(volume).tobytes() == P.forward(volume).tobytes()


def test_the_forecast_counts_every_region() -> None:
    matrices = regions(3)
    P = FieldProjector(matrices, SHAPE, method="direct", memory_limit=50_000_000)
    cost = P.forecast().chosen
    alone = [part.projector.forecast().chosen for part in P._parts]
    assert cost.pair_s == pytest.approx(sum(one.pair_s for one in alone))
    assert P.prepare().operand_bytes() == cost.operand_bytes <= cost.memory_bytes <= 50_000_000
    assert cost.operand_bytes > sum(one.operand_bytes for one in alone), "the weights"
    assert run_memory(P, SolverChoice("rl")).matrix == cost.operand_bytes
    with pytest.raises(InputError, match="memory limit for the projection"):
        FieldProjector(matrices, SHAPE, method="direct", memory_limit=20_000)


def test_planes_that_cannot_be_kept_are_not_counted() -> None:
    rng = np.random.default_rng(0)
    many = [PSFMatrix(rng.random((40, 3, 3, 31, 31)).astype(np.float32), anchor=(9 * k, 0)) for k in range(2)]
    P = FieldProjector(many, (30, 30), method="direct", memory_limit=2_500_000, workers=1)
    cost = P.forecast().chosen
    assert not cost.resident and cost.memory_bytes <= 2_500_000
    whole = FieldProjector(many, (30, 30), method="direct", memory_limit=500_000_000, workers=1)
    volume = rng.random(P.volume_shape).astype(np.float32)
    assert P.forward(volume).tobytes() == whole.forward(volume).tobytes()


def test_regions_that_do_not_belong_together_are_refused() -> None:
    for change, words in (
        (
            {"values": (3, 4, 3, 7, 9)},
            r"H of region other: expected 2 planes of 4 x 3 positions, as in the first, got 3",
        ),
        ({"values": (2, 4, 4, 7, 9)}, r"got 2 planes of 4 x 4 positions; measure all regions by the same plan"),
        ({"depths": (-1.0, 5.0)}, r"expected the depths"),
        ({"anchor": (3, 4)}, r"a different position for each, got regions 1 and 2 at the same position"),
    ):
        values = np.ones(change.get("values", (2, 4, 3, 7, 9)))
        depths = change.get("depths", (-1.0, 2.0, 3.0)[: len(values)])
        other = PSFMatrix(values, anchor=change.get("anchor", (9, 9)), depths=depths, region="other")
        with pytest.raises(InputError, match=words):
            FieldProjector([*regions(1), other], SHAPE)
    with pytest.raises(InputError, match="at least one H"):
        FieldProjector([], SHAPE)
    with pytest.raises(InputError, match="which states its position in the field"):
        FieldProjector([np.ones((2, 4, 3, 7, 9))], SHAPE)


# -- what it gains ---------------------------------------------------------------------------------------


def seen_at(far: float) -> np.ndarray:
    """Return H where spots grow and spread towards the edge: ``far`` is 0 at the centre and 1 at the edge."""
    return lenslet_psf(2, 5, 21, spread=0.7 + 0.5 * far, slope=0.3 + 0.08 * far)


def truth(shape: tuple[int, int], anchor: Pair, volume: np.ndarray, edge: float) -> np.ndarray:
    """Return the image in which each column's voxels have the patterns of their own place."""
    image = np.zeros(shape)
    for column in range(shape[1]):
        if not volume[:, :, column].any():
            continue
        alone = np.zeros_like(volume)
        alone[:, :, column] = volume[:, :, column]
        far = min(1.0, max(0.0, (column - anchor[1] - 2) / edge))  # H of an anchor is that of half a period on
        P = Projector(seen_at(far), shape, (int(anchor[0]), int(anchor[1])), "direct", dtype=np.float64)
        image += P.forward(alone)
    return image


@pytest.mark.long
def test_a_field_is_modelled_better_than_by_any_single_region() -> None:
    """Projection and reconstruction; also between regions, where H was not measured."""
    shape, edge = (30, 90), 60.0
    matrices = [PSFMatrix(seen_at((at - 10) / edge), anchor=(0, at)) for at in (10.0, 40.0, 70.0)]
    rng = np.random.default_rng(5)
    volume = np.zeros((2, *shape))
    volume[0, rng.integers(6, 24, 40), rng.integers(8, 82, 40)] = rng.uniform(50, 100, 40)
    frame = truth(shape, (0, 10), volume, edge)
    operators = {"field": FieldProjector(matrices, shape, dtype=np.float64)}
    operators |= {f"region {k}": Projector(H, shape, dtype=np.float64) for k, H in enumerate(matrices)}
    errors = {
        name: float(np.linalg.norm(P.forward(volume) - frame) / np.linalg.norm(frame)) for name, P in operators.items()
    }
    best = min(error for name, error in errors.items() if name != "field")
    assert errors["field"] < 0.15 * best, errors
    found = {name: reconstruct(P, frame, SolverChoice("rl-biggs", 60)).volume for name, P in operators.items()}
    off = {name: float(np.linalg.norm(got - volume) / np.linalg.norm(volume)) for name, got in found.items()}
    assert off["field"] < 0.7 * min(error for name, error in off.items() if name != "field"), off


@pytest.mark.long
def test_h_between_the_regions_of_a_camera_is_accurate() -> None:
    """Coma that grows with the field and astigmatism with its square, simulated; points where no H was taken."""
    bench = camera()
    setup = Setup(bench, (*described_effects(bench), LAW), (0.0,))

    def h_at(column: float) -> PSFMatrix:
        plan = ScanPlan.for_camera(bench, virtual_depths=(2.7,), cutout=21, anchor=(985.0, column))
        index = np.argwhere(np.ones(plan.shape[:3]))
        light = predict(setup, plan, index, np.zeros((len(index), 2)), Fineness.coarse)
        # the image begins at this pixel of the sensor
        return PSFMatrix(light.reshape(plan.shape), anchor=(10.0, column - 1180))

    columns = [1190.0 + 33 * periods for periods in (0, 16, 32)]
    matrices = [h_at(column) for column in columns]
    shape, errors = (39, 1120), []
    field = FieldProjector(matrices, shape, method="direct", dtype=np.float64)
    single = [Projector(H, shape, method="direct", dtype=np.float64) for H in matrices]
    for periods in (5, 8, 11, 21, 27):
        true, at = h_at(1190.0 + 33 * periods), (19, 10 + 33 * periods + 16)
        point = np.zeros(field.volume_shape)
        point[0][at] = 1
        wanted = Projector(true, shape, method="direct", dtype=np.float64).forward(point)
        errors.append([np.square(P.forward(point) - wanted).sum() / np.square(wanted).sum() for P in (field, *single)])
    found = np.sqrt(np.mean(errors, axis=0))
    assert found[0] < 0.03 and found[0] < 0.35 * found[1:].min(), found


@pytest.mark.parametrize(
    "solver", ["sieve", "rl-biggs", *(pytest.param(s, marks=pytest.mark.long) for s in ("osem", "phase-space"))]
)
def test_every_kind_of_solver_works_with_regions(solver: str) -> None:
    matrices = [PSFMatrix(seen_at(at), anchor=(0, 20 * at)) for at in (0.0, 1.0)]
    P = FieldProjector(matrices, (20, 31), dtype=np.float64)
    volume = np.zeros(P.volume_shape)
    volume[0, 10, 15] = 100
    result = reconstruct(P, P.forward(volume), SolverChoice(solver, 8))
    plane, row, column = np.unravel_index(result.volume.argmax(), volume.shape)
    assert plane == 0 and abs(row - 10) <= 1 and abs(column - 15) <= 1
    assert result.history[-1].residual < result.history[0].residual


# -- on a device -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("count", [1, 3])
def test_regions_share_a_device(count: int) -> None:
    """With numpy in the place of an accelerator's library."""
    matrices = regions(count)
    there = FieldProjector(matrices, SHAPE, dtype=np.float64, device=ArrayDevice("numpy"))
    here = FieldProjector(matrices, SHAPE, dtype=np.float64, method=there.method)
    assert there.device is not None and here.device is None
    volume = np.random.default_rng(0).random(here.volume_shape)
    np.testing.assert_allclose(there.forward(volume), here.forward(volume), rtol=1e-9)
    image = np.random.default_rng(1).random(SHAPE)
    np.testing.assert_allclose(there.adjoint(image), here.adjoint(image), rtol=1e-9)
    use = there.forecast().device
    assert use is not None and use.memory_bytes <= use.free
    again = pickle.loads(pickle.dumps(there))
    # what a library adds up in another order differs in the last digit
    np.testing.assert_allclose(again.forward(volume), there.forward(volume), rtol=1e-13)


def test_auto_uses_the_processor_if_regions_have_no_room_on_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    small = ArrayDevice("numpy", room=1000)
    monkeypatch.setattr("lfcal.reconstruct.projectors.field_projector.find_device", lambda text: small)
    assert FieldProjector(regions(2), SHAPE, device="auto").device is None
    with pytest.raises(InputError, match="memory of cpu"):
        FieldProjector(regions(2), SHAPE, device="cuda")
