"""The background is what the border shows, spots left out."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.frames import Background, CorrectionChain
from lfcal.frames.corrections.steps import border_strips


@pytest.mark.parametrize(("shape", "width"), [((30, 40), 5), ((30, 40), 14), ((30, 40), 15), ((3, 4), 8), ((1, 1), 1)])
def test_strips_cover_the_border_once(shape: tuple[int, int], width: int) -> None:
    count = np.zeros(shape, int)
    for region in border_strips(shape, width):
        count[region] += 1
    expected = np.ones(shape, int)
    if 2 * width < min(shape):
        expected[width:-width, width:-width] = 0
    np.testing.assert_array_equal(count, expected)


def tilted(noise: float = 0.0) -> np.ndarray:
    rows, columns = np.indices((200, 300))
    return (50 + 0.1 * rows - 0.05 * columns + np.random.default_rng(5).normal(0, noise, rows.shape)).astype(np.float32)


def test_plane_is_found_to_rounding() -> None:
    assert np.abs(CorrectionChain((Background("plane"),)).apply(tilted())).max() < 1e-3


def test_spots_on_the_border_and_light_in_the_middle_do_not_move_the_plane() -> None:
    frame = tilted(2.0)
    frame[:8, 100:110] += 3000
    frame[60:150, 80:220] += 1000
    clean = CorrectionChain((Background("plane"),)).apply(frame)
    rest = np.ones(frame.shape, bool)
    rest[:8, 100:110] = rest[60:150, 80:220] = False
    assert abs(clean[rest].mean()) < 0.2
    assert np.abs(clean[rest] - (frame - tilted())[rest]).max() < 0.5


def test_median_of_the_border() -> None:
    frame = np.full((50, 60), 7, np.uint16)
    frame[20:30, 20:30] = 500
    clean = CorrectionChain((Background("border", width=3),)).apply(frame)
    assert clean[0, 0] == 0 and clean[25, 25] == 493


def test_what_lies_below_the_background_is_negative() -> None:
    frame = np.full((50, 60), 7, np.uint16)
    frame[25, 25] = 2
    assert CorrectionChain((Background("constant", 7.5),)).apply(frame)[25, 25] == -5.5
    assert CorrectionChain((Background("border"),)).apply(frame)[25, 25] == -5


def test_plane_of_frames_too_small_or_masked() -> None:
    np.testing.assert_allclose(CorrectionChain((Background("plane"),)).apply(np.full((2, 2), 5.0)), 0, atol=1e-5)
    masked = np.full((20, 30), np.nan, np.float32)
    assert np.isnan(CorrectionChain((Background("plane"),)).apply(masked)).all()
    masked[10, 10] = 4
    masked[0, :] = 3
    assert CorrectionChain((Background("border"),)).apply(masked)[10, 10] == 1
