"""Mosaics channel by channel and with their gains."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.frames import (
    ArraySource,
    CorrectionChain,
    Dark,
    balanced_source,
    channel_source,
    corrected,
)
from tests.frames.scenes import session

FRAMES = session((2, 21, 30))


def mosaic(cfa: str = "GRBG", **more: object) -> ArraySource:
    known = {"cfa": cfa, "black_level": (1.0, 2.0, 3.0, 4.0), "saturation": 4095.0, **more}
    return ArraySource(FRAMES, [(0, 0, 0), (0, 0, 1)], drifts=[(0, 0), (1.0, -3.0)], metadata=known)


@pytest.mark.parametrize(("channel", "r", "c"), [("G1", 0, 0), ("R", 0, 1), ("B", 1, 0), ("G2", 1, 1)])
def test_channel_of_a_bayer_mosaic(channel: str, r: int, c: int) -> None:
    source = channel_source(mosaic(), channel)
    assert source.shape == FRAMES[0, r::2, c::2].shape
    np.testing.assert_array_equal(source.read(1), FRAMES[1, r::2, c::2])
    assert source.dtype == np.uint16 and source.info(1).position == (0, 0, 1)
    assert source.metadata.channel_phase == (r, c) and source.metadata.pixel_step == 2
    assert source.metadata.black_level == 2 * r + c + 1 and source.metadata.cfa == ""
    assert source.info(1).drift == (0.5, -1.5)
    assert source.info(1).label == f"frames[1] {channel}"


@given(st.integers(0, 9), st.integers(1, 10), st.integers(0, 14), st.integers(1, 15), st.sampled_from(["G1", "R", "B"]))
@settings(derandomize=True, deadline=None, max_examples=40)
def test_region_of_a_channel_is_its_crop(r: int, rows: int, c: int, columns: int, channel: str) -> None:
    for source in (channel_source(mosaic(), channel), balanced_source(mosaic(), (1.0, 2.0, 3.0, 1.5))):
        at = slice(r, min(source.shape[0], r + rows)), slice(c, min(source.shape[1], c + columns))
        np.testing.assert_array_equal(source.read(1, at), source.read(1)[at])


def test_pattern_of_four_by_four() -> None:
    cfa = "RRGGRRGGGGBBGGBB"
    names = {"R1": (0, 0), "R2": (0, 1), "R3": (1, 0), "G8": (3, 1), "B4": (3, 3)}
    for name, (r, c) in names.items():
        np.testing.assert_array_equal(channel_source(mosaic(cfa), name).read(0), FRAMES[0, r::4, c::4])


def test_gains_multiply_each_colour() -> None:
    gains = (1.0, 2.0, 4.0, 1.5)
    expected = FRAMES[0].astype(np.float32)
    for k, gain in enumerate(gains):
        expected[k // 2 :: 2, k % 2 :: 2] *= np.float32(gain)
    for source in (balanced_source(mosaic(), gains), balanced_source(mosaic(gains=gains))):
        np.testing.assert_array_equal(source.read(0), expected)
        assert source.dtype == np.float32 and source.metadata.balanced_by == gains
        assert source.metadata.saturation is None and source.metadata.cfa == "GRBG"


def test_channels_of_corrected_frames() -> None:
    clean = corrected(mosaic(), CorrectionChain((Dark(level=10.0),)))
    np.testing.assert_array_equal(channel_source(clean, "R").read(0), FRAMES[0, 0::2, 1::2].astype(np.float32) - 10)


@pytest.mark.parametrize("gains", [None, (1.0, 2.0), (1.0, 0.0, 1.0, 1.0), (1.0, float("nan"), 1.0, 1.0)])
def test_unusable_gains(gains: tuple[float, ...] | None) -> None:
    with pytest.raises(InputError, match="colour gains: expected positive numbers for G1, R, B, G2"):
        balanced_source(mosaic(), gains)


def test_monochrome_frames_have_no_channels() -> None:
    with pytest.raises(InputError, match="monochrome"):
        channel_source(mosaic(""), "R")
    with pytest.raises(InputError, match="a colour mosaic"):
        balanced_source(mosaic(""), (1.0,))
