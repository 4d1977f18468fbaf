from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.lattice._rounds import levelled
from lfcal.lattice.fit import fit_lattice
from tests.lattice.white_frames import draw_white

GAINS = np.array([[0.5, 1.0], [1.0, 0.35]])


def behind_filters(frame: np.ndarray) -> np.ndarray:
    rows, columns = frame.shape
    return frame * np.tile(GAINS, (rows // 2 + 1, columns // 2 + 1))[:rows, :columns]


def test_a_bayer_white_image_gives_the_lattice_of_a_grey_one() -> None:
    """A pitch of whole pixels beats with the mosaic: untreated, the places are off by more than a pixel."""
    truth = draw_white((331, 401), 16.0, seed=3)
    fit = fit_lattice(behind_filters(truth.frame - 100.0))
    errors = truth.errors(fit.centres_px(*fit.index.T))
    assert fit.form == "affine" and math.sqrt(float((errors**2).sum(1).mean())) < 0.02


@pytest.mark.parametrize(("pitch", "rotation"), [(4.0, 0.0), (6.0, 0.0), (8.0, 0.003), (15.4, 0.003)])
def test_micro_images_alone_are_no_mosaic(pitch: float, rotation: float) -> None:
    frame = (draw_white((160, 200), pitch, "square", rotation=rotation).frame - 100.0).astype(np.float32)
    assert levelled(frame) is frame


def test_the_gains_are_taken_out_and_the_light_stays() -> None:
    frame = draw_white((160, 200), 15.4, snr=1e6).frame - 100.0
    even = levelled(behind_filters(frame).astype(np.float32))
    np.testing.assert_allclose(even / frame.clip(1), float(GAINS.mean()) * (frame / frame.clip(1)), atol=0.02)


def test_blank_frames_stay() -> None:
    for frame in (np.zeros((64, 64), np.float32), np.full((64, 64), -3, np.float32)):
        assert levelled(frame) is frame
