"""Projection: the sums it is held against are the operator, entry by entry; thresholds lose what they cut."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts import projection
from lfcal.accuracy.parts.projection import PointByPoint
from lfcal.psf import PSFMatrix
from tests.reconstruct.oracles import dense, lenslet_psf


def test_point_by_point_is_the_operator() -> None:
    rng = np.random.default_rng(0)
    H, shape, anchor = rng.random((2, 3, 4, 5, 7)), (11, 13), (2, 5)
    matrix = dense(H, shape, anchor)
    points = PointByPoint(PSFMatrix(H), anchor, shape)
    voxels = [(0, 0, 0), (1, 10, 12), (0, 5, 6), (1, 4, 1)]
    values = rng.random(4)
    volume = np.zeros((2, *shape))
    volume[tuple(np.array(voxels).T)] = values
    np.testing.assert_allclose(points.forward(voxels, values).ravel(), matrix @ volume.ravel(), rtol=1e-12)
    image = rng.random(shape)
    back = (matrix.T @ image.ravel()).reshape(volume.shape)
    np.testing.assert_allclose(points.adjoint(voxels, image), back[tuple(np.array(voxels).T)], rtol=1e-12)


@pytest.fixture
def curve(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(projection, "SIDE", 40)
    H = PSFMatrix(lenslet_psf(1, cutout=21).astype(np.float32), anchor=(1.0, 3.0))
    return measure_curve(PARTS.get("projection"), Subject.of_matrix(H, "H", 1), 1000)


def test_precision_is_that_of_its_type_and_thresholds_cost_accuracy(curve: object) -> None:
    points = curve.points  # type: ignore[attr-defined]
    assert curve.stopped == ""  # type: ignore[attr-defined]
    exact = [r for r in points if not r.settings["threshold"]]
    # sums over some hundreds of entries
    assert all(r.error < (1e-12 if r.settings["double"] else 1e-4) for r in exact) and len(exact) >= 4
    assert {r.settings["method"] for r in exact} == {"polyphase", "direct", "sparse"}
    cut = {r.settings["threshold"]: r.error for r in points if r.settings["method"] == "sparse"}
    assert cut[0.0] < cut[1e-4] <= cut[1e-3] < cut[1e-2] < cut[5e-2] < 0.3


def test_an_entry_below_the_threshold_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two entries, 1 and 0.004: without the second the image of a point lacks 0.4 % of its norm."""
    monkeypatch.setattr(projection, "SIDE", 40)
    values = np.zeros((1, 2, 2, 5, 5), np.float32)
    values[..., 2, 2], values[..., 2, 3] = 1, 0.004
    monkeypatch.setattr(projection, "SETTINGS", (("sparse", True, 0.0), ("sparse", True, 0.01)))
    monkeypatch.setattr(projection, "POINTS", 1)
    points = measure_curve(PARTS.get("projection"), Subject.of_matrix(PSFMatrix(values), "H", 1), 1000).points
    errors = {r.settings["threshold"]: r.error for r in points}
    assert errors[0.0] < 1e-7 and errors[0.01] == pytest.approx(0.004, rel=0.6)
