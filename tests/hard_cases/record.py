"""Hard cases that state the failure, the measured quantity and its bound, from which a table is made.

A case is a function without arguments that returns the measured value; the decorator turns it into a test::

    @hard_case("Source on the native plane", wrong="1/a is infinite", measure="error against the reference", bound=0.01)
    def test_native_plane() -> float: ...
"""

from __future__ import annotations

import functools
import importlib
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

__all__ = ["CASES", "HardCase", "hard_case", "load_cases", "worst"]


@dataclass(frozen=True)
class HardCase:
    """One case: its place, the failure of naive code, the measured quantity, and its bound."""

    module: str
    name: str
    wrong: str
    measure: str
    bound: float
    figure: Callable[[], float]


CASES: dict[str, HardCase] = {}


def hard_case(
    name: str, *, wrong: str, measure: str, bound: float
) -> Callable[[Callable[[], float]], Callable[[], None]]:
    """Return a decorator that registers a case and asserts that its value is finite and at most ``bound``."""

    def register(function: Callable[[], float]) -> Callable[[], None]:
        assert name not in CASES, f"two hard cases are called {name!r}"
        module = function.__module__.rpartition("test_")[2]
        CASES[name] = HardCase(module, name, wrong, measure, bound, function)

        @pytest.mark.hard_case
        @functools.wraps(function)
        def test() -> None:
            figure = float(function())
            assert math.isfinite(figure), figure
            assert figure <= bound, f"{name}: {figure:.3g} exceeds {bound:g}"

        return test

    return register


def worst(*values: float) -> float:
    """Return the largest value, or NaN if there is one, which `max` ignores unless it comes first."""
    return float(np.max([float(value) for value in values]))


def load_cases() -> dict[str, HardCase]:
    """Import every module of hard cases and return the registered ones by name."""
    import tests.hard_cases as package

    for module in pkgutil.iter_modules(package.__path__):
        if module.name.startswith("test_") and module.name not in ("test_table", "test_mutants"):
            importlib.import_module(f"tests.hard_cases.{module.name}")
    return dict(CASES)
