"""Projections come out the same to the last bit for any number of workers, and elsewhere by their recipe."""

import pickle

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import FieldProjector, Projector
from lfcal.reconstruct.projectors._recipe import Tiles, read_recipe, recipe_of
from lfcal.reconstruct.projectors._tiles import TilePlan

RNG = np.random.default_rng(0)
PROBLEMS = {"small": (6, 5, 15, (41, 38)), "cells": (5, 7, 21, (163, 170)), "period": (19, 33, 31, (95, 120))}


def pair(P: Projector) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return P.forward(rng.random(P.volume_shape)), P.adjoint(rng.random(P.image_shape))


def assert_same(one: tuple[np.ndarray, ...], two: tuple[np.ndarray, ...]) -> None:
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.fixture(autouse=True)
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """However small a projection, let it have the threads that are asked for."""
    monkeypatch.setattr("lfcal.reconstruct.projectors.projector.SMALL_S", 0.0)


LONG_FFT = pytest.param("fft", marks=pytest.mark.long)


@pytest.mark.parametrize("method", ["polyphase:3x2", "direct", "sparse", "reduced", LONG_FFT])
@pytest.mark.parametrize("problem", list(PROBLEMS))
@pytest.mark.few(3)
def test_any_number_of_workers(problem: str, method: str) -> None:
    ny, nx, side, shape = PROBLEMS[problem]
    H = RNG.random((2, ny, nx, side, side), np.float32)
    within = 0.02 if method == "reduced" else 0.0
    phases = np.arange(ny * nx).reshape(ny, nx) % 3 > 0
    for seen in (None, phases):
        one, *others = (Projector(H, shape, None, method, workers=w, tolerance=within, phases=seen) for w in (1, 2, 5))
        wanted = pair(one)
        for P in others:
            assert_same(pair(P), wanted)


def test_a_recipe_makes_it_again() -> None:
    H = RNG.random((2, 5, 7, 21, 21), np.float32)
    tight = Projector(H, (163, 170), method="polyphase:4x3/2")
    assert tight.recipe == "polyphase:4x3/2" and tight.forecast().band == 2
    for P in (Projector(H, (163, 170)), Projector(H, (163, 170), method="polyphase"), tight):
        wanted = pair(P)
        assert_same(pair(Projector(H, (163, 170), method=P.recipe, workers=1)), wanted)
        there = pickle.loads(pickle.dumps(P))
        assert there.recipe == P.recipe
        assert_same(pair(there), wanted)


def test_a_recipe_of_regions() -> None:
    matrices = [PSFMatrix(RNG.random((2, 5, 7, 9, 9), np.float32), anchor=(20.0, 30.0 + 70 * k)) for k in range(2)]
    P = FieldProjector(matrices, (60, 161), None, "polyphase")
    assert P.recipe.count("polyphase:") == 2
    wanted = pair(P)
    assert_same(pair(FieldProjector(matrices, (60, 161), None, P.recipe, workers=1)), wanted)
    assert_same(pair(pickle.loads(pickle.dumps(P))), wanted)
    with pytest.raises(InputError, match=r"one method, or one for each of 2 regions, got 3"):
        FieldProjector(matrices, (60, 161), None, "direct+direct+sparse")


@pytest.mark.parametrize("text", ["polyphase:", "polyphase:3", "polyphase:0x3", "polyphase:3x2/0", "direct:3x2", "a:b"])
def test_what_is_no_recipe(text: str) -> None:
    with pytest.raises(InputError, match=r"as polyphase:4x3, got '"):
        Projector(np.ones((1, 2, 2, 3, 3)), (8, 8), method=text)


def test_words() -> None:
    plan = TilePlan(Projector(np.ones((1, 2, 2, 3, 3)), (80, 80)).grid, (7, 3))
    for band, text in ((7, "polyphase:7x3"), (2, "polyphase:7x3/2")):
        assert recipe_of("polyphase", plan, band) == text
        assert read_recipe(text) == ("polyphase", Tiles(7, 3, band))
    assert recipe_of("sparse", None, None) == "sparse" and read_recipe("sparse") == ("sparse", None)
