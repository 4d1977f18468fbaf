"""The error of a step that is read off a list: of order one beside what it truly is off, however places are wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.frames.lists._grid import find_grid
from lfcal.frames.lists.derived import rounding, step_error, step_size

TRIES = 60


def pulls_of(
    *,
    step: float | None = None,
    digit: float = 0.0,
    scatter: float = 0.0,
    columns: float = 0.0,
    turn: float = 0.0,
    shape: tuple[int, int] = (33, 19),
) -> np.ndarray:
    """Return errors of the step of scans that begin anywhere, each over its stated error."""
    rng = np.random.default_rng(1)
    index = np.array(list(np.ndindex(*shape)))
    found = []
    for _ in range(TRIES):
        true = rng.uniform(24, 26) if step is None else step
        rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        places = index * true @ rotation + rng.uniform(-500, 500, 2) + rng.normal(0, 1, index.shape) * scatter
        shared = [rng.normal(0, 1, n)[index[:, k]] * columns for k, n in enumerate(shape)]
        places += np.stack(shared, axis=1)
        places = np.round(places / digit) * digit if digit else places
        (plane,) = find_grid(places, np.zeros(len(places)), "list").planes
        found.append((step_size(plane.steps) - true) / step_error(places, plane))
    return np.array(found)


CASES = {
    "rounded": {"digit": 1.0},
    "rounded finely": {"digit": 0.1},
    "rounded to quarters": {"digit": 0.25},
    "rounded alike in all columns": {"step": 24.994, "digit": 1.0},
    "rounded coarsely": {"digit": 2.5},
    "a single row": {"digit": 1.0, "shape": (33, 1)},
    "few columns": {"digit": 1.0, "shape": (7, 4)},
    "scattered": {"scatter": 1.0},
    "scattered and rounded": {"scatter": 0.5, "digit": 1.0},
    "columns scattered as a whole": {"columns": 1.0},
    "turned and scattered": {"scatter": 1.0, "turn": 0.1},
}


@pytest.mark.few(4)
@pytest.mark.parametrize("case", CASES)
def test_errors_are_as_stated(case: str) -> None:
    pulls = pulls_of(**CASES[case])  # type: ignore[arg-type]
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.4 and np.abs(pulls).max() < 5


def test_a_turned_rounded_list_is_not_thought_too_good() -> None:
    assert np.sqrt(np.mean(pulls_of(digit=1.0, turn=0.1) ** 2)) < 1.4


def test_steps_of_whole_digits_are_not_exact() -> None:
    """All places lie on a grid of 25, which every step from 24.97 to 25.03 is rounded to."""
    index = np.array(list(np.ndindex(33, 19)))
    places = 25.0 * index + 3
    (plane,) = find_grid(places, np.zeros(len(places)), "list").planes
    assert 1 / 33 / 5 < step_error(places, plane) < 1 / 33


def test_one_place_has_no_step() -> None:
    (plane,) = find_grid(np.zeros((1, 2)), np.zeros(1), "list").planes
    assert step_error(np.zeros((1, 2)), plane) == 0


@pytest.mark.parametrize(
    ("values", "unit"),
    [((12.5, 100.0, -7.25), 0.25), ((1000.0, 1025.0), 2.5), ((1.0, 2.5, 4.1), 0.1), ((math.pi, math.e), 0.0)],
)
def test_the_digit_that_values_are_rounded_to(values: tuple[float, ...], unit: float) -> None:
    assert rounding(np.array(values), 25.0) == pytest.approx(unit)
