"""The eight flips and turns against numpy's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames import (
    AS_IS,
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
    named_orientation,
)
from lfcal.frames.orientation import oriented

NUMPY: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as is": lambda f: f,
    "rot90": np.rot90,
    "rot180": lambda f: np.rot90(f, 2),
    "rot270": lambda f: np.rot90(f, 3),
    "mirror x": np.fliplr,
    "mirror y": np.flipud,
    "transpose": np.transpose,
    "anti-transpose": lambda f: np.rot90(f, 2).T,
}
FRAME = np.arange(35).reshape(5, 7)


@pytest.mark.parametrize("name", NUMPY)
def test_arrays_places_and_regions_turn_together(name: str) -> None:
    one = ORIENTATIONS[name]
    turned = NUMPY[name](FRAME)
    assert np.array_equal(one.apply(FRAME), turned)
    assert one.shape(FRAME.shape) == turned.shape
    places = np.argwhere(np.ones(FRAME.shape, bool))
    assert np.array_equal(turned[tuple(one.places(places, FRAME.shape).astype(int).T)], FRAME.ravel())
    region = np.s_[1:4, 2:5]
    assert np.array_equal(one.apply(FRAME[one.region(region, FRAME.shape)]), turned[region])


@pytest.mark.parametrize("name", NUMPY)
def test_the_inverse_undoes(name: str) -> None:
    one = ORIENTATIONS[name]
    assert np.array_equal(one.inverse.apply(one.apply(FRAME)), FRAME)
    assert np.allclose(one.moves() @ one.inverse.moves(), np.eye(2))


def test_all_eight_differ_and_are_known_by_both_spellings() -> None:
    assert set(NUMPY) == set(ORIENTATIONS)
    assert len({one.apply(FRAME).tobytes() for one in ORIENTATIONS.values()}) == 8
    assert len({tuple(one.moves().ravel()) for one in ORIENTATIONS.values()}) == 8
    assert named_orientation("mirror-x") is named_orientation("mirror x") is ORIENTATIONS["mirror x"]
    assert named_orientation("as-is").name == AS_IS
    with pytest.raises(InputError, match="orientation: expected as-is, rot90"):
        named_orientation("rot45")


def test_words_say_how_the_frames_lie_that_need_it() -> None:
    # a picture of a letter L, turned clockwise, is put right by numpy's anticlockwise rot90
    letter = np.array([[1, 0], [1, 0], [1, 1]])
    clockwise = np.rot90(letter, -1)
    assert np.array_equal(ORIENTATIONS["rot90"].apply(clockwise), letter)
    assert "clockwise by 90°" in ORIENTATIONS["rot90"].words
    assert not ORIENTATIONS["rot90"].words.startswith("turned anti")


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
    with pytest.raises(InputError, match="on the sensor of 6 x 8 px"):
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
