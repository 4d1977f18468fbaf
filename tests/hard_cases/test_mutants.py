"""Every hard case bites: with naive code in the place of the library's its figure exceeds the bound."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hard_cases.mutants import MUTANTS
from tests.hard_cases.record import load_cases
from tests.hard_cases.rewrite import Mutant

CASES = load_cases()


def test_every_case_has_a_naive_form() -> None:
    assert {mutant.row for mutant in MUTANTS} == set(CASES)


def test_every_naive_form_finds_the_code_that_it_replaces() -> None:
    """Most forms run with --long alone: code that has moved on would leave them behind for months."""
    for mutant in MUTANTS:
        with pytest.MonkeyPatch.context() as patch:
            mutant.plant(patch)


def marked(mutant: Mutant) -> object:
    marks = [pytest.mark.long] if mutant.long else []
    return pytest.param(mutant, marks=marks, id=f"{mutant.row}: {mutant.naive}")


@pytest.mark.few(3)
@pytest.mark.hard_case
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mutant", [marked(m) for m in MUTANTS])
def test_the_naive_form_is_caught(mutant: Mutant, monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES[mutant.row]
    mutant.plant(monkeypatch)
    with np.errstate(all="ignore"):
        if mutant.raises is not None:
            with pytest.raises(mutant.raises):
                case.figure()
            return
        figure = float(case.figure())
    assert not figure <= case.bound, f"{mutant.naive}: {figure:.3g} is within {case.bound:g}"
