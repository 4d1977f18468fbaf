"""Solvers: the volume that is known comes nearer with every iteration; a point is what the solver gives."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Curve, Subject, iter_measure_curve, measure_curve
from lfcal.accuracy.parts import solvers
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import SOLVERS
from tests.reconstruct.oracles import lenslet_psf


@pytest.fixture
def h(monkeypatch: pytest.MonkeyPatch) -> Subject:
    monkeypatch.setattr(solvers, "SIDE", 48)
    return Subject.of_matrix(PSFMatrix(lenslet_psf(3, cutout=21).astype(np.float32)), "H", 1)


def by_solver(curve: Curve) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    for point in curve.points:
        found.setdefault(point.settings["solver"], {})[point.settings["iterations"]] = point.error
    return found


@pytest.mark.long
def test_every_solver_comes_nearer_to_the_truth(h: Subject) -> None:
    curve = measure_curve(PARTS.get("solvers"), h, 1000)
    found = by_solver(curve)
    assert set(found) == set(SOLVERS.names()) and curve.stopped == ""
    for name, errors in found.items():
        assert errors[20] < errors[1] < 2, name
    seconds = [r.cost for r in curve.points if r.settings["solver"] == "rl"]
    assert sorted(seconds) == seconds and len(seconds) == len(solvers.SHOWN)


def test_the_first_iteration_is_that_of_richardson_and_lucy(h: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Written out: x A'(b / Ax) / A'1 from an even start, with the operator as a matrix."""
    from lfcal.reconstruct.phantoms import phantom
    from tests.reconstruct.oracles import dense

    monkeypatch.setattr(solvers, "SIDE", 12)
    monkeypatch.setattr(solvers, "SHOWN", (1,))
    small = lenslet_psf(2, cutout=11)
    H = PSFMatrix(small.astype(np.float32))
    curve = measure_curve(PARTS.get("solvers"), Subject.of_matrix(H, "H", 1), 1000)
    shape = (16, 16)
    A = dense(small, shape)
    truth = phantom("vesicle", (2, *shape)).ravel()
    clean = A @ truth
    scale = solvers.FULL * 20e3 / clean.max()
    rng = np.random.default_rng(1)
    image = rng.poisson(clean * scale) + rng.normal(0, 12.0, shape).ravel()
    image = np.maximum(image, 0)
    even = A.T @ np.ones(image.size)
    start = np.full(truth.size, image.sum() / (A @ np.ones(truth.size)).sum())
    x = start * (A.T @ (image / (A @ start))) / even
    off = np.linalg.norm(x - scale * truth) / np.linalg.norm(scale * truth)
    assert by_solver(curve)["rl"][1] == pytest.approx(off, rel=0.02)


def test_closed_early_it_keeps_what_was_reached(h: Subject) -> None:
    work = iter_measure_curve(PARTS.get("solvers"), h, 1000)
    record = next(r for r in work if len(r.curve.points) == 3)  # type: ignore[attr-defined]
    work.close()
    assert by_solver(record.curve) == {"rl": by_solver(record.curve)["rl"]}  # type: ignore[attr-defined]
    assert [r.settings["iterations"] for r in record.curve.points] == [1, 2, 5]  # type: ignore[attr-defined]
