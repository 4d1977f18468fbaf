"""Codes on a display: is it fine enough, and what it shows."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.multiplex import display_fit, display_frames, s_matrix


def test_a_display_is_judged_by_its_pixel_in_the_image() -> None:
    step = preset("r29").step_um(0.0)
    fine, equal = display_fit(step, step / 8), display_fit(step, step)
    assert fine.fits and fine.placing_px == 0 and "fine enough" in fine.words
    assert equal.fits and equal.image_px == pytest.approx(1), "one display pixel to each position"
    coarse = display_fit(step, 3 * step)
    assert not coarse.fits and coarse.image_px == pytest.approx(3)
    assert "too coarse" in coarse.words and f"{step:.4g} µm" in coarse.words and "3 times" in coarse.words
    odd = display_fit(10.0, 4.0)  # 2.5 to a step: positions fall between pixels
    assert not odd.fits and odd.placing_px == pytest.approx(0.2) and "too coarse" in odd.words
    assert display_fit(10.0, 1.9).fits and display_fit(10.0, 1.9).placing_px == pytest.approx(0.095)
    for bad in ((0, 1), (1, 0), (1, np.nan), (np.inf, 1)):
        with pytest.raises(InputError):
            display_fit(*bad)


def test_frames_show_the_code_at_the_points() -> None:
    code, places = s_matrix(7), np.array([[2, 3], [2, 4], [2, 5], [3, 3], [3, 4], [3, 5], [4, 3]])
    fit = display_fit(10.0, 5.0)
    frames = list(display_frames(code, places, fit, (11, 12)))
    assert len(frames) == 7 and all(frame.shape == (11, 12) and frame.dtype == np.uint8 for frame in frames)
    # a block of 5 x 5 display pixels in the middle
    spots = (places - places.min(0)) * 2 + [3, 3]
    for frame, lit in zip(frames, code, strict=True):
        np.testing.assert_array_equal(frame[spots[:, 0], spots[:, 1]], 255 * lit)
        assert (frame > 0).sum() == lit.sum()
    many = list(display_frames(code / 2, places, fit, (40, 60), repeat=(6, 7)))
    assert (many[0] > 0).sum() == 3 * 4 * code[0].sum() and set(np.unique(many[0])) == {0, 128}
    # blocks of 3 x 3 display pixels may touch
    near = list(display_frames(code, places, display_fit(5.0, 5.0), (9, 9), repeat=(3, 3)))
    assert (near[0] > 0).sum() == 9 * code[0].sum()
    for bad in ({"shape": (4, 60)}, {"repeat": (1, 1), "shape": (40, 60)}):
        with pytest.raises(InputError):
            list(display_frames(code, places, fit, bad.pop("shape"), **bad))
    with pytest.raises(InputError, match="display pixel for each"):
        list(display_frames(code, places, display_fit(10.0, 30.0), (40, 60)))
    with pytest.raises(InputError, match="positions"):
        list(display_frames(code, places[:3], fit, (40, 60)))
