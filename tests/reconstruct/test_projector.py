"""Projection and its adjoint: the dense matrix, conventions, forecasts, and the same to the last bit by a recipe."""

from __future__ import annotations

import itertools
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.psf import PSFMatrix, open_psf, save, transpose
from lfcal.reconstruct import FieldProjector, Projector
from lfcal.reconstruct.projectors import _direct as direct
from lfcal.reconstruct.projectors._polyphase import Polyphase
from lfcal.reconstruct.projectors._recipe import Tiles, read_recipe, recipe_of
from lfcal.reconstruct.projectors._tiles import TilePlan
from lfcal.reconstruct.projectors.forecast import METHODS
from tests.reconstruct.oracles import convolved, dense
from tests.speeds import measured_speeds, same_speeds

# (image, period, cutout, anchor, planes)
CASES = {
    "odd": ((13, 17), (3, 5), (7, 5), (0, 0), 2),
    "even, unequal": ((11, 14), (4, 2), (5, 9), (1, 1), 1),
    "period larger than cutout": ((12, 11), (7, 9), (3, 5), (2, 4), 2),
    "period larger than image": ((6, 5), (11, 8), (7, 7), (2, 3), 1),
    "cutout larger than image": ((7, 6), (2, 3), (21, 17), (0, 1), 1),
    "negative anchor": ((9, 10), (3, 4), (5, 5), (-7, -2), 1),
    "no lenslets": ((9, 8), (1, 1), (5, 3), (0, 0), 2),
    "single pixel cutout": ((5, 6), (2, 2), (1, 1), (1, 0), 1),
}


def problem(name, rng):
    image, period, cutout, anchor, planes = CASES[name]
    H = rng.standard_normal((planes, *period, *cutout))
    return H, image, anchor, rng.standard_normal((planes, *image)), rng.standard_normal(image)


@pytest.mark.few(12)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_pair_is_the_dense_matrix_and_its_transpose(name, method):
    H, shape, anchor, g, f = problem(name, np.random.default_rng(1))
    matrix = dense(H, shape, anchor)
    P = Projector(H, shape, anchor, method, dtype=np.float64)
    assert P.method == method
    assert np.allclose(P.forward(g).ravel(), matrix @ g.ravel(), rtol=0, atol=1e-12)
    assert np.allclose(P.adjoint(f).ravel(), matrix.T @ f.ravel(), rtol=0, atol=1e-12)


@settings(max_examples=25, derandomize=True, deadline=None)
@given(
    image=st.tuples(st.integers(1, 18), st.integers(1, 18)),
    period=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    half=st.tuples(st.integers(0, 5), st.integers(0, 5)),
    anchor=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    method=st.sampled_from(METHODS),
)
def test_forward_and_adjoint_have_equal_inner_products(image, period, half, anchor, method):
    rng = np.random.default_rng(image[0] + 31 * image[1])
    H = rng.standard_normal((2, *period, 2 * half[0] + 1, 2 * half[1] + 1))
    P = Projector(H, image, anchor, method, dtype=np.float64)
    g, f = rng.standard_normal(P.volume_shape), rng.standard_normal(image)
    Hg = P.forward(g)
    size = np.linalg.norm(Hg) * np.linalg.norm(f) + np.linalg.norm(g) * np.linalg.norm(P.adjoint(f))
    assert abs(np.vdot(Hg, f) - np.vdot(g, P.adjoint(f))) <= 1e-12 * max(size, 1e-300)


def test_tiles_and_bands_change_nothing():
    rng = np.random.default_rng(2)
    H = rng.standard_normal((2, 3, 2, 7, 5))
    P = Projector(H, (20, 21), (1, 1), "polyphase", dtype=np.float64)
    g, f = rng.standard_normal(P.volume_shape), rng.standard_normal(P.image_shape)
    for counts, band in itertools.product([(1, 1), (2, 1), (3, 4)], [None, 1]):
        engine = Polyphase(P.grid, TilePlan(P.grid, counts), np.dtype(np.float64), band=band)
        operands = [engine.prepare(plane) for plane in H]
        assert np.allclose(engine.forward(zip(operands, g, strict=True)), P.forward(g), rtol=0, atol=1e-12)
        assert np.allclose(np.stack(list(engine.adjoint(f, operands))), P.adjoint(f), rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_single_precision_agrees_with_convolutions(method):
    rng = np.random.default_rng(3)
    H, g = rng.random((2, 4, 3, 11, 9)), rng.random((2, 40, 41))
    truth = convolved(H, g, (2, 1))
    image = Projector(H, (40, 41), (2, 1), method).forward(g)
    assert image.dtype == np.float32
    assert np.abs(image - truth).max() <= 1e-5 * truth.max()


def test_adjoint_is_the_forward_projection_of_the_transposed_matrix():
    rng = np.random.default_rng(4)
    H, f = rng.random((1, 4, 3, 7, 9)), rng.random((22, 19))
    back = Projector(H, f.shape, dtype=np.float64).adjoint(f)
    assert np.allclose(back[0], Projector(transpose(H), f.shape, dtype=np.float64).forward(f[None]), atol=1e-12)
    # and the transposed view of a PSF matrix swaps the pair
    view = Projector(PSFMatrix(H).T, f.shape, dtype=np.float64)
    assert np.allclose(view.forward(f[None]), back[0], atol=1e-12)


def test_a_wrong_convention_does_not_pass():
    rng = np.random.default_rng(5)
    H, g = rng.random((1, 3, 3, 5, 5)), rng.random((1, 15, 15))
    truth = (dense(H, (15, 15), (1, 2)) @ g.ravel()).reshape(15, 15)
    for wrong, (own, anchor) in {
        "anchor": (H, (2, 1)),
        "rows and columns": (H.transpose(0, 2, 1, 4, 3), (1, 2)),
        "turned pattern": (H[..., ::-1, ::-1], (1, 2)),
        "scan direction": (H[:, ::-1], (1, 2)),
    }.items():
        image = Projector(own, (15, 15), anchor, dtype=np.float64).forward(g)
        assert np.abs(image - truth).max() > 0.05 * truth.max(), wrong


@pytest.mark.parametrize("method", METHODS)
def test_subset_of_phases_is_the_masked_operator(method):
    rng = np.random.default_rng(6)
    H, g, f = rng.standard_normal((2, 4, 3, 7, 5)), rng.standard_normal((2, 17, 16)), rng.standard_normal((17, 16))
    P = Projector(H, f.shape, (1, 2), method, dtype=np.float64)
    phases = rng.random((4, 3)) < 0.4
    mask, Q = P.grid.tiled(phases), P.subset(phases)
    assert Q.method == method
    assert np.allclose(Q.forward(g), P.forward(g) * mask, atol=1e-12)
    assert np.allclose(Q.adjoint(f), P.adjoint(f * mask), atol=1e-12)


def test_planes_come_from_a_psf_matrix_with_its_anchor_rounded_down():
    rng = np.random.default_rng(7)
    H = rng.random((2, 3, 4, 5, 5))
    g = rng.random((2, 12, 13))
    P = Projector(PSFMatrix(H, anchor=(4.9, -1.2)), (12, 13), dtype=np.float64)
    assert P.grid.anchor == (4, -2)
    assert np.allclose(P.forward(g), Projector(H, (12, 13), (4, -2), dtype=np.float64).forward(g))


@pytest.mark.parametrize("method", METHODS)
def test_threshold_drops_small_entries(method):
    rng = np.random.default_rng(8)
    H, g = rng.random((1, 3, 3, 9, 9)), rng.random((1, 14, 14))
    H[:, :, :, 0] *= 0.2  # the outer row falls below the threshold altogether
    whole, cut = H.copy(), np.where(H >= 0.3 * H.max(), H, 0)
    P = Projector(H, (14, 14), method=method, dtype=np.float64, threshold=0.3)
    assert np.allclose(P.forward(g), Projector(cut, (14, 14), method="fft", dtype=np.float64).forward(g))
    assert np.array_equal(H, whole), "H itself is not changed"


def test_empty_planes_and_zeros_project_to_zeros():
    H = np.ones((2, 3, 3, 5, 5))
    H[1] = 0
    for method in METHODS:
        P = Projector(H, (10, 11), method=method)
        assert not P.forward(np.zeros(P.volume_shape)).any()
        assert not P.adjoint(np.ones((10, 11)))[1].any()


def test_planes_that_cannot_be_kept_are_prepared_again():
    rng = np.random.default_rng(9)
    H, g = rng.random((6, 5, 5, 15, 15)), rng.random((6, 60, 60))
    free = Projector(H, (60, 60), method="polyphase", workers=1)
    tight = Projector(H, (60, 60), method="polyphase", workers=1, memory_limit=free.forecast().chosen.memory_bytes // 3)
    cost = tight.forecast().chosen
    assert cost.memory_bytes <= tight.forecast().memory_limit
    assert np.allclose(tight.forward(g), free.forward(g), rtol=1e-4)
    with pytest.raises(InputError, match="at least"):
        Projector(H, (60, 60), method="direct", memory_limit=1000)
    with pytest.raises(InputError, match="period for the method polyphase: expected a shorter period"):
        Projector(H, (60, 60), method="polyphase", memory_limit=1000)


def test_wrong_arguments_and_arrays_are_refused():
    ones = np.ones((1, 3, 3, 5, 5))
    for change, message in (
        ({"H": np.ones((3, 3, 5, 5))}, "5 axes"),
        ({"H": np.ones((1, 3, 3, 4, 5))}, "odd"),
        ({"method": "magic"}, "projection method"),
        ({"dtype": np.int32}, "float32 or float64"),
        ({"threshold": 1.5}, "threshold"),
        ({"image_shape": (0, 5)}, "image shape"),
        ({"phases": np.zeros((3, 3))}, "image phases"),
    ):
        with pytest.raises(InputError, match=message):
            Projector(**{"H": ones, "image_shape": (9, 9), **change})
    P = Projector(ones, (9, 9))
    with pytest.raises(InputError, match="expected"):
        P.forward(np.ones((9, 9)))
    with pytest.raises(InputError, match="finite"):
        P.adjoint(np.full((9, 9), np.nan))
    for wrong, named in ((np.nan, "got NaN or infinity"), (-3e38, r"up to 1e\+12, got 3e\+38")):
        H = ones.copy()
        H[0, 1, 1, 2, 2] = wrong
        with pytest.raises(InputError, match=f"plane 0: .*{named}"):
            Projector(H, (9, 9)).prepare()


def test_a_projector_is_pickled_by_its_file(tmp_path: Path) -> None:
    values = np.random.default_rng(1).random((2, 3, 4, 5, 5)).astype(np.float32)
    save(PSFMatrix(values, anchor=(2.0, 1.0)), tmp_path / "H.h5")
    image = np.random.default_rng(2).random((20, 23))
    phases = np.ones((3, 4), bool)
    phases[0] = False
    with open_psf(tmp_path / "H.h5") as H:
        within = {"method": "reduced", "tolerance": 0.9}
        for how in ({}, {"dtype": np.float64, "phases": phases}, {"threshold": 0.9, "anchor": (5, 6)}, within):
            P = Projector(H, image.shape, **how).prepare()  # type: ignore[arg-type]
            said = pickle.dumps(P)
            assert len(said) < 10_000
            other = pickle.loads(said)
            assert repr(other) == repr(P)
            assert other.tolerance == P.tolerance
            np.testing.assert_array_equal(other.adjoint(image), P.adjoint(image))


def test_dense_patterns_are_arranged_for_many_strips_at_once(monkeypatch):
    """Arranged again for each of 16 strips of the lattice, they took a tenth of the time."""
    laid = []
    lay = direct.place_patterns
    monkeypatch.setattr(direct, "place_patterns", lambda *a: (laid.append(a[3].nbytes), lay(*a)))
    H = np.random.default_rng(0).random((1, 7, 6, 31, 31), np.float32)
    P = Projector(H, (560, 480), method="direct", workers=1)
    P.adjoint(P.forward(np.ones(P.volume_shape, np.float32)))
    assert len(direct.strips_of(P.grid.cells)) == 16
    assert sum(laid) <= 6 * H.nbytes


def test_auto_chooses_the_quickest_method():
    rng = np.random.default_rng(2)
    spots = np.zeros((1, 24, 24, 49, 49), np.float32)
    spots[..., 24, ::12] = 1
    for speeds in (same_speeds, measured_speeds):
        with speeds():
            many_taps = Projector(rng.random((1, 5, 5, 61, 61), np.float32), (240, 240))
            assert many_taps.method == "polyphase" and "set-up" in str(many_taps.forecast())
            assert Projector(spots, (240, 240)).method == "sparse"


def test_spectra_are_as_large_as_forecast():
    H = np.random.default_rng(3).random((2, 4, 5, 17, 17), np.float32)
    P = Projector(H, (90, 91), method="polyphase").prepare()
    plan = P.forecast().plan
    assert isinstance(plan, TilePlan)
    assert P.forecast().chosen.operand_bytes == 2 * plan.spectrum_bytes(8, 20)


RNG = np.random.default_rng(0)
PROBLEMS = {"small": (6, 5, 15, (41, 38)), "cells": (5, 7, 21, (163, 170)), "period": (19, 33, 31, (95, 120))}


def both(P: Projector) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return P.forward(rng.random(P.volume_shape)), P.adjoint(rng.random(P.image_shape))


def assert_same(one: tuple[np.ndarray, ...], two: tuple[np.ndarray, ...]) -> None:
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let even a small projection have the threads that are asked for."""
    monkeypatch.setattr("lfcal.reconstruct.projectors.projector.SMALL_S", 0.0)


@pytest.mark.parametrize("method", ["polyphase:3x2", "direct", "sparse", "reduced", "fft"])
@pytest.mark.parametrize("problem", list(PROBLEMS))
@pytest.mark.few(3)
def test_any_number_of_workers_projects_the_same(threads: None, problem: str, method: str) -> None:
    ny, nx, side, shape = PROBLEMS[problem]
    H = RNG.random((2, ny, nx, side, side), np.float32)
    within = 0.02 if method == "reduced" else 0.0
    phases = np.arange(ny * nx).reshape(ny, nx) % 3 > 0
    for seen in (None, phases):
        one, *others = (Projector(H, shape, None, method, workers=w, tolerance=within, phases=seen) for w in (1, 2, 5))
        wanted = both(one)
        for P in others:
            assert_same(both(P), wanted)


def test_a_recipe_makes_the_same_projections(threads: None) -> None:
    H = RNG.random((2, 5, 7, 21, 21), np.float32)
    tight = Projector(H, (163, 170), method="polyphase:4x3/2")
    assert tight.recipe == "polyphase:4x3/2" and tight.forecast().band == 2
    for P in (Projector(H, (163, 170)), Projector(H, (163, 170), method="polyphase"), tight):
        wanted = both(P)
        assert_same(both(Projector(H, (163, 170), method=P.recipe, workers=1)), wanted)
        there = pickle.loads(pickle.dumps(P))
        assert there.recipe == P.recipe
        assert_same(both(there), wanted)


def test_a_recipe_of_regions(threads: None) -> None:
    matrices = [PSFMatrix(RNG.random((2, 5, 7, 9, 9), np.float32), anchor=(20.0, 30.0 + 70 * k)) for k in range(2)]
    P = FieldProjector(matrices, (60, 161), None, "polyphase")
    assert P.recipe.count("polyphase:") == 2
    wanted = both(P)
    assert_same(both(FieldProjector(matrices, (60, 161), None, P.recipe, workers=1)), wanted)
    assert_same(both(pickle.loads(pickle.dumps(P))), wanted)
    with pytest.raises(InputError, match=r"one method, or one for each of 2 regions, got 3"):
        FieldProjector(matrices, (60, 161), None, "direct+direct+sparse")


def test_recipes_in_words() -> None:
    plan = TilePlan(Projector(np.ones((1, 2, 2, 3, 3)), (80, 80)).grid, (7, 3))
    for band, text in ((7, "polyphase:7x3"), (2, "polyphase:7x3/2")):
        assert recipe_of("polyphase", plan, band) == text
        assert read_recipe(text) == ("polyphase", Tiles(7, 3, band))
    assert recipe_of("sparse", None, None) == "sparse" and read_recipe("sparse") == ("sparse", None)
    for text in ("polyphase:", "polyphase:3", "polyphase:0x3", "polyphase:3x2/0", "direct:3x2", "a:b"):
        with pytest.raises(InputError, match=r"as polyphase:4x3, got '"):
            Projector(np.ones((1, 2, 2, 3, 3)), (8, 8), method=text)
