"""What a fit says of itself in a line."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from lfcal.fit.model_error import INCOMPLETE, ChiSquare
from tests.fit.test_validate import fit_of, plan_of


@pytest.mark.parametrize(
    ("lit", "sigma", "begins", "complete"),
    [
        (1.01, 0.02, "chi² 1.010; error of the model", True),
        (1.2, 0.02, "model incomplete: chi² 1.200, 10 sigma above 1", False),
        # noise that is stated too large makes every sigma and limit too large
        (0.8, 0.02, "chi² 0.800, 10 sigma below 1: the noise is smaller than stated", True),
        # at the limit: no less noise than stated, and not complete
        (1 - INCOMPLETE / 8, 1 / 8, f"chi² {1 - INCOMPLETE / 8:.3f}; error of the model", True),
        (1 + INCOMPLETE / 8, 1 / 8, "model incomplete", False),
        # and no samples beyond the unknowns tell nothing: a 1 would be no measurement
        (1.0, math.inf, "chi² unknown: the samples do not outnumber the unknowns", True),
    ],
)
def test_the_verdict_says_what_chi_square_tells(lit: float, sigma: float, begins: str, complete: bool) -> None:
    fit = replace(fit_of(plan_of()), chi_square=ChiSquare(lit, lit, sigma))
    assert fit.verdict.startswith(begins) and fit.complete is complete
