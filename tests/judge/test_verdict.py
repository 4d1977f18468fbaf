"""The verdict on an H never contradicts the faults and metrics that stand beside it, whatever these are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import Merit
from lfcal.judge import Inspection
from lfcal.judge.fault import FAULTS, FoundFault
from lfcal.judge.inspection import BAD, BAD_SHARE, FAIR, FAIR_SHARE
from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.telling import compared_words
from tests.judge.common import clean, matrix

BAND: dict[Merit, tuple[tuple[float, float], tuple[float, float]]] = {
    "good": ((0.0, 0.99 * FAIR), (0.0, 0.99 * FAIR_SHARE)),
    "fair": ((FAIR, 0.99 * BAD), (FAIR_SHARE, 0.99 * BAD_SHARE)),
    "bad": ((BAD, 2.0), (BAD_SHARE, 1.0)),
}
"""Costs, and shares of the light where no cost was measured, of faults of each merit."""


@pytest.fixture(scope="module")
def quality() -> QualityReport:
    found = inspect(matrix(clean()), workers=1)
    metrics = (m if m.merit in ("good", "unknown") else replace(m, merit="good", cost=0.0) for m in found.metrics)
    return replace(found, metrics=tuple(metrics))


def drawn(rng: np.random.Generator, merit: Merit) -> FoundFault:
    faults = list(FAULTS)
    costs, shares = BAND[merit]
    cost = float(rng.uniform(*costs)) if rng.random() < 0.6 else None
    share = float(rng.uniform(*shares) if cost is None else rng.random())
    return FoundFault(faults[rng.integers(len(faults))], "3 pixels", 12.0, share, cost=cost)


@pytest.mark.parametrize("seed", range(60))
def test_the_verdict_says_what_the_table_says(quality: QualityReport, seed: int) -> None:
    rng = np.random.default_rng(seed)
    merits: list[Merit] = [("good", "fair", "bad")[k] for k in rng.integers(1 + seed % 3, size=rng.integers(0, 8))]
    findings = tuple(drawn(rng, merit) for merit in merits)
    changed = {quality.metrics[k].key for k in rng.integers(len(quality.metrics), size=rng.integers(0, 6))}
    worse: tuple[Merit, ...] = ("fair", "bad")
    metrics = tuple(
        replace(m, merit=worse[rng.integers(1 + seed % 2)]) if m.key in changed else m for m in quality.metrics
    )
    compared = int(rng.integers(2)) * 60
    found = Inspection(replace(quality, metrics=metrics), findings, compared, 0.01, "" if compared else "why", 1.0)
    verdict = found.verdict

    assert not findings or "no fault" not in verdict, "beside a table of faults"
    assert not findings or "no fault" not in compared_words(found)
    standing = [m for m in metrics if found.settled(m) is None and not found.withdrawn(m)]
    every = {*merits, *(m.merit for m in standing if m.merit != "unknown")}
    worst = next(merit for merit in ("bad", "fair", "good") if merit in every)
    starts = {"bad": "should not be used", "fair": "is usable, but should be checked", "good": "is good"}
    assert verdict.startswith(f"This H {starts[worst]}") and found.merit == worst
    assert found.bad == (worst == "bad")
    # what decides is named, or counted among the others
    names = [f.title for f, merit in zip(findings, merits, strict=True) if merit == worst]
    names += [m.spec.title.lower() for m in standing if m.merit == worst and worst != "good"]
    missing = [name for name in names if name.lower() not in verdict.lower()]
    assert (
        not missing or f"and {len(names) - (3 if worst == 'bad' else 4)} more" in verdict or not (compared or findings)
    )
    if worst == "good" and compared:
        assert f"by {sum(m.merit == 'good' for m in metrics)} check" in verdict


@pytest.mark.parametrize(
    ("cost", "many", "words"),
    [
        (0.01, 1, "show 1 fault that costs a reconstruction almost nothing"),
        (0.01, 2, "show 2 faults that cost a reconstruction almost nothing"),
        (None, 1, "show 1 fault that is too small to matter"),
        (None, 2, "show 2 faults that are too small to matter"),
    ],
)
def test_faults_that_cost_nothing_are_said_to_be_there(
    quality: QualityReport, cost: float | None, many: int, words: str
) -> None:
    one = FoundFault(FAULTS.get("bad_pixels"), "2 pixels", 12.0, 0.001, cost=cost)
    found = Inspection(quality, (one,) * many, 60, 0.01, "", 1.0)
    assert words in found.verdict and "(bad pixels of the sensor" in found.verdict


def test_patterns_alone_show_faults_too(quality: QualityReport) -> None:
    one = FoundFault(FAULTS.get("saturated"), "values end", 12.0, 0.2, cost=0.01)
    found = Inspection(quality, (one,), 0, 0.2, "its camera leaves 20 % of the light unexplained", 1.0)
    assert "its patterns show 1 fault that costs" in found.verdict and "saturated values" in found.verdict
    assert "the patterns alone show these faults" in compared_words(found)
