"""Left-aligned samples: found, named, moved down with their levels; mixtures are refused."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames import ArraySource
from lfcal.frames.aligned import ShiftedSource, chosen_shift, find_shift
from tests.frames import scenes

FRAMES = scenes.session((1, 2, 4, 24, 30), top=1000).reshape(8, 24, 30)
PLACES = [(0, y, x) for y in range(2) for x in range(4)]


def source(frames: np.ndarray, **facts: object) -> ArraySource:
    return ArraySource(frames, PLACES, metadata=facts)


@pytest.mark.parametrize("bits", [0, 1, 2, 4, 6])
def test_alignment_is_found(bits: int) -> None:
    assert find_shift(source(FRAMES << np.uint16(bits))) == bits
    shift, note = chosen_shift("auto", source(FRAMES << np.uint16(bits)))
    assert shift == bits and (f"shifted down to {16 - bits} bits" in note or not bits)


def test_frames_without_light_do_not_mislead() -> None:
    frames = (FRAMES << np.uint16(4)).copy()
    frames[0] = 0
    frames[-1] = 1024
    frames[-1, 5, 5] = 2048
    assert find_shift(source(frames)) == 4
    assert find_shift(source(frames.astype(np.float32))) == 0


def test_a_mixture_is_refused() -> None:
    frames = (FRAMES << np.uint16(4)).copy()
    frames[-1] >>= 4
    with pytest.raises(InputError, match=r"the same in all frames, got 0 empty low bits in .* and 4 in"):
        chosen_shift("auto", source(frames))
    shift, note = chosen_shift("0", source(frames))
    assert shift == 0 and "the same in all frames" in note
    hidden = (FRAMES << np.uint16(4)).copy()
    hidden[2] += 1  # a frame that is not looked at shows when it is read
    view = ShiftedSource(source(hidden), find_shift(source(hidden)))
    with pytest.raises(InputError, match="samples with 4 empty low bits, got samples that use them"):
        view.read(2)


def test_a_proposal_and_a_slip() -> None:
    assert "--shift auto" in chosen_shift("0", source(FRAMES << np.uint16(4)))[1]
    assert chosen_shift("0", source(FRAMES)) == (0, "") and chosen_shift("4", source(FRAMES)) == (4, "")
    with pytest.raises(InputError, match="auto or a number of bits, got 'four'"):
        chosen_shift("four", source(FRAMES))


def test_levels_move_with_the_samples() -> None:
    plain = ShiftedSource(source(FRAMES << np.uint16(4)), 4)
    assert plain.metadata.bit_depth == 12 and plain.metadata.saturation == 4095
    stated = ShiftedSource(source(FRAMES << np.uint16(4), saturation=65520.0, black_level=(160.0, 320.0)), 4)
    assert stated.metadata.saturation == 4095 and stated.metadata.black_level == (10, 20)
    full = (FRAMES << np.uint16(4)).copy()
    full[0, 0, 0] = 4095 << 4
    assert ShiftedSource(source(full), 4).samples(0).saturated == 1
