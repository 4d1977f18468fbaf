"""Gains of planes: those that no pattern tells are between their neighbours', and it is said."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.fit import Fit, fit_camera
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.files import fit_dict, iter_write_model
from lfcal.fit.model import Fineness, predict
from lfcal.fit.report import iter_fit_report
from lfcal.psf import open_psf
from tests.fit.common import measured, setup_of, small_plan

PLAN = replace(small_plan(15, (2.2, 2.4, 2.6, 2.9)), period=(2, 4))
GAINS = 4e4 * np.array([1.0, 1.1, 1.2, 1.35])


@pytest.fixture(scope="module")
def fit() -> tuple[Fit, np.ndarray]:
    """Return the fit of patterns of two of four planes, and H as it truly is at every plane."""
    index = np.argwhere(np.ones(PLAN.shape[:3], bool))
    light = predict(setup_of(PLAN), PLAN, index, np.zeros((len(index), 2)), Fineness.finest)
    truth = (light * GAINS[index[:, 0], None, None]).reshape(PLAN.shape)
    rng = np.random.default_rng(0)
    there = index[np.isin(index[:, 0], [0, 2])]
    clean = truth[tuple(there.T)]
    noisy = rng.poisson(np.maximum(clean, 0)) + 8.0 * rng.standard_normal(clean.shape)
    return fit_camera(measured(PLAN, noisy, there, (64.0, 1.0)), unknowns=["geometry"], workers=1), truth


def test_h_of_a_plane_without_patterns_is_in_the_units_of_the_others(fit: tuple[Fit, np.ndarray]) -> None:
    found, truth = fit
    H = np.asarray(found.model(workers=1))
    error = np.sqrt(np.square(H - truth).sum((1, 2, 3, 4)) / np.square(truth).sum((1, 2, 3, 4)))
    # between two planes their gains tell it, beyond them the nearest one does
    assert (error[:3] < 0.02).all() and error[3] < 0.15
    assert found.unseen == (1, 3) and found.levels.gains[3] == found.levels.gains[2]
    assert found.levels.gains[0] < found.levels.gains[1] < found.levels.gains[2]


@pytest.mark.long
def test_it_is_said_in_numbers_report_and_file(fit: tuple[Fit, np.ndarray], tmp_path: Path) -> None:
    found, _ = fit
    assert found.unseen_words.startswith("planes 1, 3: ")
    assert fit_dict(found)["planes_without_patterns"] == [1, 3]
    drain(iter_write_model(found, tmp_path / "H.h5", workers=1))
    with open_psf(tmp_path / "H.h5") as H:
        said = H.provenance["fit"]
        assert said["planes_without_patterns"] == [1, 3] and said["gains"] == found.levels.gains.tolist()
    index = np.array(list(found.residuals))
    light = predict(found.setup, PLAN, index, np.zeros((len(index), 2)), Fineness.coarse)
    patterns = measured(PLAN, light * 4e4, index, (64.0, 1.0))
    page = drain(iter_fit_report(found, patterns, tmp_path / "report")).read_text()
    assert html.escape(found.unseen_words) in page


def test_gains_between_are_by_depth_in_any_order() -> None:
    levels = PatternLevels(np.array([3.0, 1.0, 1.0, 7.0, 1.0]), np.zeros(5), np.zeros(0))
    depths = (30.0, 40.0, 20.0, 70.0, 90.0)
    gains = levels.between(np.array([0, 3]), depths).gains
    np.testing.assert_allclose(gains, [3.0, 4.0, 3.0, 7.0, 7.0])
    assert (levels.between(np.arange(5), depths).gains == levels.gains).all()
