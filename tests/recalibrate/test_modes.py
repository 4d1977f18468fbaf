"""Combinations of unknowns that frames do not determine."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.recalibrate._modes import Modes

NAMES = ("gap", "focal", "offset")
PRECISION = np.array([4.0, 4.0, 1.0])
BOTH = np.array([1, 1, 0]) / np.sqrt(2)
OTHER = np.array([1, -1, 0]) / np.sqrt(2)
INFORMATION = 400 * np.outer(OTHER, OTHER) + 4 * 1.5 * np.outer(BOTH, BOTH) + np.diag([0, 0, 99.0])


def test_a_common_change_that_is_not_determined_is_named_and_not_followed() -> None:
    modes = Modes.of(INFORMATION, PRECISION)
    assert modes.undetermined(NAMES) == (("gap", "focal"),)
    found = modes.estimate(INFORMATION @ np.array([3.0, 1.0, 2.0]))
    assert found == pytest.approx(OTHER * (OTHER @ [3, 1, 2]) * 400 / 404 + np.array([0, 0, 2 * 0.99]))
    assert modes.covariance @ BOTH == pytest.approx(BOTH / 4)  # that of the prior
    assert modes.covariance @ OTHER == pytest.approx(OTHER / 404)


def test_determined_unknowns_are_those_of_least_squares_with_a_prior() -> None:
    information = INFORMATION + 40 * np.outer(BOTH, BOTH)
    modes = Modes.of(information, PRECISION)
    assert modes.undetermined(NAMES) == ()
    whole = np.linalg.inv(information + np.diag(PRECISION))
    assert modes.covariance == pytest.approx(whole)
    assert modes.estimate(np.array([1.0, 2.0, 3.0])) == pytest.approx(whole @ [1, 2, 3])


def test_an_unknown_without_any_information_stays() -> None:
    modes = Modes.of(np.diag([50.0, 0.0, 50.0]), PRECISION)
    assert modes.undetermined(NAMES) == (("focal",),)
    assert modes.estimate(np.array([1.0, 1.0, 1.0]))[1] == 0
