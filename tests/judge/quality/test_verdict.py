"""The verdict is a sentence: what is wrong, where, what it costs, the remedy, and what remains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.quality.verdict import counted, counted_words
from lfcal.psf import PSFMatrix
from tests.judge.quality.faults import base
from tests.judge.quality.scenes import hexagonal

FIVE = np.array([(0, 3, 4), (1, 2, 7), (2, 5, 1), (2, 5, 2), (3, 8, 8)], np.intp)


@pytest.fixture(scope="module")
def clean() -> QualityReport:
    return inspect(PSFMatrix(base(hexagonal())))


def with_misplaced(clean: QualityReport, shape: tuple[int, int, int]) -> QualityReport:
    """Return the report of an H of so many positions of which five are misplaced."""
    spec = clean["misplaced"].spec
    frames = int(np.prod(shape))
    cost = spec.cost.of(5.0, spec.limits, frames)
    one = replace(clean["misplaced"], value=5.0, merit="bad", cost=cost, positions=FIVE)
    metrics = tuple(one if m.key == "misplaced" else m for m in clean.metrics)
    return replace(clean, shape=(*shape, 41, 41), metrics=metrics)


def test_five_of_many_positions_make_a_good_H_with_five_to_repeat(clean: QualityReport) -> None:
    found = with_misplaced(clean, (9, 19, 33))
    assert found.merit == "good" and len(found.redo()) == 5
    assert found.verdict.startswith("This H is good but for 5 positions to record again: misplaced frames.")
    assert "5 of 5,643 positions (z, y, x): (0, 3, 4), (1, 2, 7), (2, 5, 1) …" in found.verdict
    assert "it costs 0.018 (NRMSE, typical)" in found.verdict and "Record these positions again" in found.verdict
    assert f"What remains is good by {counted(found.metrics)['good'] - 1} checks" in found.verdict


def test_five_of_few_positions_must_not_be_used(clean: QualityReport) -> None:
    found = with_misplaced(clean, (4, 10, 10))
    assert found.merit == "fair" and "What remains is good" in found.verdict
    assert with_misplaced(clean, (4, 5, 5)).merit == "bad"


def test_a_value_without_bound_is_shown(clean: QualityReport) -> None:
    """The contrast of an H without any noise, for one; it once ended the list of checks with an OverflowError."""
    metric = clean["misplaced"]
    unit = f" {metric.spec.unit}" if metric.spec.unit else ""
    assert [replace(metric, value=v).text for v in (np.inf, -np.inf)] == [f"∞{unit}", f"-∞{unit}"]


def test_the_metrics_are_counted(clean: QualityReport) -> None:
    words = counted_words(clean.metrics)
    assert sum(counted(clean.metrics).values()) == len(clean.metrics)
    assert words.endswith("not applicable") and " good" in words and "1 unknown" in words
