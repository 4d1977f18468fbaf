"""A checkerboard is a lattice, too: what tells it from micro-images."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice.fit import check_cell, fit_lattice
from tests.lattice.white_frames import draw_white


def checkerboard(side: float, turn: float, blur: float, noise: float = 20.0) -> np.ndarray:
    y, x = np.mgrid[:240, :260]
    u, v = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    fields = 1000.0 * ((np.floor(u / side) + np.floor(v / side)) % 2) + 100
    soft = cv2.GaussianBlur(fields, (0, 0), blur) if blur else fields
    return soft + np.random.default_rng(1).normal(0, noise, soft.shape)


@pytest.mark.few(1)
@pytest.mark.parametrize(("side", "turn", "blur"), [(8.0, 0.0, 0.0), (11.0, 0.1, 1.0), (15.3, 0.78, 1.5)])
def test_a_checkerboard_is_no_white_image(side: float, turn: float, blur: float) -> None:
    with pytest.raises(InputError, match="checkerboard"):
        fit_lattice(checkerboard(side, turn, blur))


@pytest.mark.few(2)
@pytest.mark.parametrize("fill", [0.5, 0.75, 0.85, 1.0])
def test_micro_images_of_any_size_are(fill: float) -> None:
    assert fit_lattice(draw_white((200, 220), kind="square", fill=fill).frame).kind == "square"


def test_micro_images_that_are_not_resolved_are_not_judged() -> None:
    """Two crossed sines are their own negative half a diagonal away, too."""
    frame = draw_white((200, 220), 6.0, "square", fill=0.8, snr=100.0).frame.astype(float)
    assert fit_lattice(cv2.GaussianBlur(frame, (0, 0), 1.5)).kind == "square"


def test_a_blank_cell_is_left_to_others() -> None:
    check_cell(np.ones((12, 12)))
