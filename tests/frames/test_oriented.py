"""Frames turned upright behind the corrected view."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames import (
    ORIENTATIONS,
    ArraySource,
    CorrectionChain,
    Dark,
    FrameSource,
    Noise,
    Orientation,
    OrientedSource,
    Position,
    corrected,
)
from lfcal.frames._oriented import oriented
from tests.frames.test_orientation import NUMPY

UPRIGHT = np.arange(3 * 6 * 8, dtype=np.uint16).reshape(3, 6, 8) * 7 + 100
POSITIONS = [Position(0, 0, k) for k in range(3)]


@pytest.mark.parametrize("name", NUMPY)
def test_corrected_frames_turn_as_a_whole_and_in_part(name: str) -> None:
    turn = ORIENTATIONS[name]
    dark = np.random.default_rng(1).integers(0, 90, (6, 8)).astype(np.float32)
    delivered = np.stack([turn.inverse.apply(frame) for frame in UPRIGHT])
    chain = CorrectionChain((Dark(np.ascontiguousarray(turn.inverse.apply(dark))),))
    source = OrientedSource(corrected(ArraySource(delivered, POSITIONS), chain), turn)
    assert source.shape == (6, 8)
    assert np.array_equal(source.read(1), UPRIGHT[1] - dark)
    assert np.array_equal(source.read(2, np.s_[1:3, 4:8]), (UPRIGHT[2] - dark)[1:3, 4:8])
    assert np.array_equal(source.samples(2, np.s_[0:6, 5:7]).values, (UPRIGHT[2] - dark)[:, 5:7])
    assert source.info(1).position == POSITIONS[1]
    assert source.info(1).origin == (0, 0)
    assert source.metadata.orientation == name


@pytest.mark.parametrize("name", NUMPY)
def test_masks_and_saturated_samples_turn_along(name: str) -> None:
    turn = ORIENTATIONS[name]
    mask = np.ones((6, 8), bool)
    mask[0, :3] = False
    frames = UPRIGHT.copy()
    frames[0, 4, 6] = 4095
    delivered = np.stack([turn.inverse.apply(frame) for frame in frames])
    behind = turn.inverse.apply(mask)
    inner = ArraySource(delivered, POSITIONS, mask=behind, metadata={"saturation": 4095.0})
    source = OrientedSource(inner, turn)
    seen = source.info(0).mask
    assert seen is not None
    assert np.array_equal(seen, mask)
    found = source.samples(0)
    assert found.saturated == 1
    assert found.valid is not None
    assert np.array_equal(~found.valid, ~mask | (frames[0] == 4095))


@pytest.mark.parametrize("name", NUMPY)
def test_the_noise_of_each_sample_turns_along(name: str) -> None:
    """With a dark, each sample has a variance of its own: it stayed where it was, or was of another shape."""
    turn = ORIENTATIONS[name]
    dark = np.random.default_rng(3).integers(0, 90, (6, 8)).astype(np.float32)
    known = {"noise": Noise(4.0, 0.5)}

    def seen(orientation: Orientation) -> FrameSource:
        """Return corrected frames of which ``orientation`` makes upright ones."""
        delivered = np.stack([orientation.inverse.apply(frame) for frame in UPRIGHT])
        chain = CorrectionChain((Dark(np.ascontiguousarray(orientation.inverse.apply(dark)), count=2),))
        source = corrected(ArraySource(delivered, POSITIONS, metadata=known), chain)
        return OrientedSource(source, orientation)

    for region in (None, np.s_[1:4, 2:8]):
        wanted, found = seen(ORIENTATIONS["as is"]).samples(1, region), seen(turn).samples(1, region)
        assert wanted.noise is not None and found.noise is not None
        assert isinstance(wanted.noise.constant, np.ndarray) and wanted.noise.constant.std() > 0
        for one, other in zip(found.noise[:2], wanted.noise[:2], strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(found.noise.variance(found.values), wanted.noise.variance(wanted.values))


@pytest.mark.parametrize("name", NUMPY)
def test_cutouts_keep_their_place_on_the_turned_sensor(name: str) -> None:
    turn = ORIENTATIONS[name]
    sensor = np.random.default_rng(2).integers(0, 1000, (20, 30)).astype(np.uint16)
    upright = turn.apply(sensor)
    corner = (4, 9)
    cut = sensor[4:9, 9:16]
    inner = ArraySource(cut[None], POSITIONS[:1], origins=[corner])
    source = OrientedSource(inner, turn, sensor.shape)
    top, left = source.info(0).origin
    rows, columns = source.shape
    assert np.array_equal(source.read(0), upright[top : top + rows, left : left + columns])


def test_a_cutout_beside_the_sensor_is_named() -> None:
    inner = ArraySource(UPRIGHT[:1], POSITIONS[:1], origins=[(4, 9)])
    with pytest.raises(InputError, match="on the sensor of \\(6, 8\\)"):
        OrientedSource(inner, ORIENTATIONS["mirror x"]).info(0)


def test_a_region_beyond_the_turned_frame_is_refused() -> None:
    source = OrientedSource(ArraySource(UPRIGHT, POSITIONS), ORIENTATIONS["rot90"])
    assert source.read(0, np.s_[7:8, 0:6]).shape == (1, 6)
    with pytest.raises(InputError, match="region columns"):
        source.read(0, np.s_[0:2, 0:8])


@pytest.mark.parametrize("k", range(3))
def test_one_cutout_among_whole_frames_is_placed_on_the_sensor(k: int) -> None:
    origins = [(2, 3) if n == k else (0, 0) for n in range(3)]
    turned = oriented(ArraySource(UPRIGHT, POSITIONS, origins=origins), ORIENTATIONS["rot180"], (20, 30))
    assert turned.info(k).origin == (20 - 6 - 2, 30 - 8 - 3)
