"""Frames of one array, and parts of frames."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.axes import check_region, grow_region, whole
from lfcal.base.errors import InputError
from lfcal.frames import (
    ArraySource,
    CorrectionChain,
    Defects,
    FrameInfo,
    FrameSource,
    Position,
    channel_source,
    corrected,
    open_frames,
)
from tests.frames.scenes import session


def test_five_axes_are_positions() -> None:
    frames = session()
    source = ArraySource(frames)
    assert isinstance(source, FrameSource)
    assert len(source) == 24 and source.shape == (20, 30) and source.dtype == np.uint16
    for k in range(24):
        np.testing.assert_array_equal(source.read(k), frames[source.info(k).position])
    source.read(3)[:] = 0
    assert frames.min() > 0, "a frame that was read is a copy"


def test_region_is_the_crop_of_the_frame() -> None:
    for source in (ArraySource(session()),):
        part = source.read(0, (slice(2, 9), slice(None, 4)))
        np.testing.assert_array_equal(part, source.read(0)[2:9, :4])
        assert part.flags.c_contiguous


def test_exposure_and_drift() -> None:
    source = ArraySource(
        session((2, 20, 30)), [(0, 0, 0), (0, 0, 1)], exposures_s=[0.1, 0.2], drifts=[(0, 0), (0.5, -1)]
    )
    assert source.info(1).exposure_s == 0.2
    assert source.info(1).drift == (0.5, -1.0)
    assert ArraySource(session(), metadata={"exposure_s": 0.25}).info(7).exposure_s == 0.25
    unknown = ArraySource(session()).info(0)
    assert unknown.exposure_s is None and unknown.drift is None and unknown.saturated is None
    assert unknown.origin == (0, 0) and unknown.label == "frames[0]"


def test_frames_of_several_points_have_no_single_position() -> None:
    info = FrameInfo((Position(0, 0, 0), Position(0, 1, 1)), label="target")
    with pytest.raises(InputError, match="target: expected one point source, got 2"):
        _ = info.position


def test_big_endian_samples_become_native() -> None:
    source = ArraySource(session().astype(">u2"))
    assert source.dtype.isnative and source.read(0).dtype.isnative
    np.testing.assert_array_equal(source.read(5), session().reshape(-1, 20, 30)[5])


@pytest.mark.parametrize(
    ("frames", "more", "words"),
    [
        (np.zeros((3, 4)), {}, "axes"),
        (np.zeros((3, 0, 4)), {}, "axes"),
        (np.zeros((2, 3, 4), complex), {}, "complex128"),
        (np.zeros((2, 3, 4)), {}, "expected 2 positions, got none"),
        (np.zeros((2, 3, 4)), {"positions": [(0, 0, 0)]}, "expected 2, one per frame, got 1"),
        (np.zeros((1, 3, 4)), {"positions": [(0, 0, 0)], "exposures_s": [1, 2]}, "exposures of frames"),
    ],
)
def test_unusable_arrays(frames: np.ndarray, more: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        ArraySource(frames, **more)


def test_index_and_region_out_of_range() -> None:
    source = ArraySource(session())
    for index in (-1, 24):
        with pytest.raises(InputError, match="frame index: expected 0 … 23"):
            source.read(index)
    for rows in (slice(-1, 5), slice(5, 5), slice(0, 21), slice(0, 10, 2)):
        with pytest.raises(InputError, match="region rows: expected start < stop within 0 … 20"):
            source.read(0, (rows, slice(0, 5)))


def test_grown_region_stops_at_the_border() -> None:
    assert grow_region((slice(1, 5), slice(20, 29)), 2, (20, 30)) == (slice(0, 7), slice(18, 30))
    assert check_region((slice(None), slice(None)), (20, 30)) == whole((20, 30))


def test_a_pixel_mask_travels_with_the_frames(tmp_path: Path) -> None:
    """Masked pixels are not valid and do not count as saturated, in views and files alike."""
    frames = session((2, 20, 30))
    frames[0, 3, 4] = frames[0, 5, 6] = 4095
    mask = np.ones((20, 30), bool)
    mask[3, 4] = mask[10, 11] = False
    places, facts = [(0, 0, 0), (0, 0, 1)], {"saturation": 4095.0, "cfa": "GRBG"}
    source = ArraySource(frames, places, mask=mask, metadata=facts)
    with h5py.File(tmp_path / "stack.h5", "w") as file:
        file["frames"], file["positions"], file["mask"] = frames, np.array(places), mask.astype(np.uint8)
    view = corrected(source, CorrectionChain((Defects([(10, 11)], (20, 30)),)))
    for found, expected in ((source, {(3, 4), (5, 6), (10, 11)}), (view, {(3, 4), (5, 6)})):
        samples = found.samples(0)
        assert samples.valid is not None and samples.saturated == 1
        assert set(map(tuple, np.argwhere(~samples.valid).tolist())) == expected
        part = found.samples(0, (slice(5, 12), slice(6, 30)))
        assert part.valid is not None and not part.valid[0, 0] and part.saturated == 1
    red = channel_source(source, "B").samples(0)
    assert red.valid is not None and np.argwhere(~red.valid).tolist() == [[1, 2], [2, 3]]
    with open_frames(tmp_path / "stack.h5") as stack:
        assert stack.info(1).mask is not None and not stack.samples(1).valid[10, 11]  # type: ignore[index]
    with pytest.raises(InputError, match=r"pixel mask: expected \d+ x \d+ px, got 3 x 3 px"):
        ArraySource(frames, places, mask=np.ones((3, 3)))
