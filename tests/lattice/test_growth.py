from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.lattice._forms import DistortionFrame
from lfcal.lattice._model import LatticeModel
from lfcal.lattice.fit import fit_lattice, start_reach, tracking_form
from tests.lattice.white_frames import barrel, draw_white


@pytest.mark.long
def test_a_distortion_of_half_a_pitch_does_not_lose_the_lattice() -> None:
    """3 px with a pitch of 6.5 px: about a straight lattice the corners would be placed on the wrong side of a gap."""
    shape = (380, 470)
    reach = math.hypot(*shape) / 2
    truth = draw_white(shape, 6.5, "square", rotation=0.3, bend=barrel(3.0, reach), dead=0.02, seed=2)
    fit = fit_lattice(truth.frame)
    errors = truth.errors(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    assert math.sqrt((errors**2).sum(1).mean()) < 0.02
    # neighbours are neighbours: no row was skipped on the way
    drawn = truth.indices(fit.centres_px(fit.index[:, 0], fit.index[:, 1]))
    matrix = np.linalg.lstsq(np.column_stack([fit.index, np.ones(len(fit.index))]), drawn, rcond=None)[0]
    assert np.abs(matrix[:2]).round(6).tolist() in ([[1, 0], [0, 1]], [[0, 1], [1, 0]])


def test_the_first_region_is_small_but_never_too_small() -> None:
    frame = DistortionFrame.of((4384, 6576))

    def reach(pitch: float, frame: DistortionFrame = frame) -> float:
        return start_reach(LatticeModel("square", np.zeros(2), np.array([pitch, 0.0]), 1.0), frame)

    assert reach(15.0) == 700.0
    assert reach(90.0) == 900.0
    small = DistortionFrame.of((100, 120))
    assert 3 * (reach(24.0, small) / 24.0) ** 2 >= 60


def test_what_runs_ahead_is_no_more_than_a_cubic() -> None:
    assert tracking_form(100000).degree == 3
    assert tracking_form(12).name == "affine"
