"""Stored types of H: errors worked out by hand, bytes counted."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts.storage import HALF
from lfcal.psf import PSFMatrix


@pytest.fixture(scope="module")
def values() -> np.ndarray:
    rng = np.random.default_rng(3)
    return (rng.random((1, 4, 5, 9, 11)) ** 4).astype(np.float32)


def test_errors_are_those_of_rounding_and_bytes_those_of_the_samples(values: np.ndarray) -> None:
    curve = measure_curve(PARTS.get("storage"), Subject.of_matrix(PSFMatrix(values), "H"), 100)
    assert curve.stopped == ""
    by = {(r.settings["dtype"], r.settings["compression"]): r for r in curve.points}
    true = values.astype(np.float64)
    step = 2.0 ** np.floor(np.log2(true.max() / 65535))
    off = np.abs(np.round(true / step) * step - true).sum() / true.sum()
    assert by["rounded", "gzip"].error == pytest.approx(off, rel=2e-3)
    assert by["rounded", "gzip"].cost < 0.8 * by["float32", "gzip"].cost
    assert by["float32", "gzip"].error == by["float64", "zstd"].error == 0
    for dtype, size in (("rounded", 4), ("float32", 4), ("float64", 8)):
        assert by[dtype, "none"].cost == size * values.size, "all patterns are in the sample"
        assert by[dtype, "gzip"].cost < by[dtype, "none"].cost * 1.1
    # eleven bits of digits: between half and none of the last one is lost
    assert 2**-14 < by["float16", "gzip"].error < 2**-11 and by["float16", "gzip"].note == HALF
    assert {r.unit for r in curve.points} == {"bytes"} and curve.best is not None and curve.best.error == 0


def test_bytes_are_scaled_to_the_whole_h(plan: object) -> None:
    H = PSFMatrix(np.ones((2, 30, 40, 3, 3), np.float32))
    curve = measure_curve(PARTS.get("storage"), Subject.of_matrix(H, "H"), 100)
    plain = next(r for r in curve.points if r.label == "float32, none")
    assert plain.cost == 4 * H.size
