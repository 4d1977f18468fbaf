"""The eight flips and turns against numpy's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames import AS_IS, ORIENTATIONS, named_orientation

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
