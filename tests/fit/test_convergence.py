"""The rounds of a fit: each tells what the model leaves, of fitted and of left-out patterns."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.base.units import format_share
from lfcal.fit import FitProgress, Measured, iter_fit_camera, measured_of
from tests.fit.common import few_patterns


def rounds_of(measured: Measured) -> list[FitProgress]:
    """Return the rounds of a fit, of which the last one is what the fit says of itself."""
    found: list[FitProgress] = []
    work = iter_fit_camera(measured, unknowns=["geometry"], workers=1)
    fit = drain(work, lambda record: found.append(record) if isinstance(record, FitProgress) else None)
    # but for the unknowns that it counts
    assert found[-1].chi2 == pytest.approx(fit.chi2, rel=0.02)
    return found


@cache
def of_few() -> list[FitProgress]:
    return rounds_of(measured_of(few_patterns()))


def test_what_is_left_falls_from_round_to_round() -> None:
    found = of_few()
    assert [one.stage for one in found[:2]] == ["as described", "as described, round 1"]
    assert found[-1].stage.startswith("finest")
    assert all(one.done == one.total and one.seconds >= 0 for one in found)
    # the description, its gap 1 % off, is seen to be wrong
    assert found[0].held_out > 0.03 and found[0].chi2 > 3 and not found[0].below_noise
    assert found[-1].below_noise and found[-1].held_out < 0.02
    less = f"less than {format_share(found[-1].held_out)} off"
    assert found[-1].note == f"χ² {found[-1].chi2:.3g}, error of held-out patterns {less}"


@pytest.mark.long
def test_what_is_left_is_that_of_left_out_patterns() -> None:
    """Against a left-out pattern that is another one's: it is as wrong as two patterns differ."""
    measured = measured_of(few_patterns())
    good = of_few()
    aside, other = int(np.flatnonzero(measured.held_out)[0]), int(np.flatnonzero(~measured.held_out)[0])
    patterns = measured.patterns.copy()
    patterns[aside] = measured.patterns[other]
    wrong = rounds_of(replace(measured, patterns=patterns))
    approached, good_then = ([one for one in r if one.stage.startswith("approach")][-1] for r in (wrong, good))
    assert approached.held_out > 0.3 > good_then.held_out
    assert approached.chi2 == pytest.approx(good_then.chi2, rel=0.05)
    # then it is found to be an outlier, and none is left
    assert math.isnan(wrong[-1].held_out)


@pytest.mark.long
def test_without_left_out_patterns_nothing_is_said_of_them() -> None:
    measured = measured_of(few_patterns(), held_out=0.0)
    found = rounds_of(measured)
    assert all(math.isnan(one.held_out) and "left-out" not in one.note for one in found)
