"""Patterns of a few positions: those of assembly, and no other frame read."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.frames import ArraySource
from lfcal.psf import assemble_plan
from lfcal.psf.picked import iter_pick
from tests.acquire.rigs import small_plan

PLAN = small_plan((2, 3), 2)


def frames(count: int = 12) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 4000, (count, 96, 96)).astype(np.uint16)


PLACES = [(z, y, x) for z in range(2) for y in range(2) for x in range(3)]


def test_patterns_are_those_of_assembly() -> None:
    source = ArraySource(frames(), PLACES)
    H = assemble_plan(source, PLAN).matrix
    chosen = np.array([(0, 1, 2), (1, 0, 0)])
    found = drain(iter_pick(source, PLAN, chosen))
    assert found.shape == H.shape and found.camera == PLAN.camera and found.anchor == H.anchor
    np.testing.assert_array_equal(np.argwhere(found.recorded), chosen)
    for z, y, x in chosen.tolist():
        np.testing.assert_array_equal(found[z, y, x], H[z, y, x])
        assert found.plane(z)[y, x].tolist() == H[z, y, x].tolist()
    assert not found[0, 0, 0].any() and found.plane(1).astype(bool).any((2, 3)).sum() == 1
    np.testing.assert_array_equal(found.T.plane(1), found.T.T.T[1])
    np.testing.assert_array_equal(np.asarray(found)[1], found.plane(1))


def test_no_other_frame_is_read() -> None:
    class Counting(ArraySource):
        def read(self, index: int, region: object = None) -> np.ndarray:
            seen.add(index)
            return super().read(index, region)  # type: ignore[arg-type]

    seen: set[int] = set()
    work = iter_pick(Counting(frames(), PLACES), PLAN, np.array([(1, 1, 1)]))
    assert [next(work).done for _ in range(2)] == [0, 1]
    assert seen == {PLACES.index((1, 1, 1))}


def test_repeats_are_averaged_and_pixels_beyond_the_frame_are_marked() -> None:
    places = [(0, 0, 0), (0, 0, 0), (1, 1, 1)]
    source = ArraySource(frames(3), places, drifts=[(-43.0, 0.0), (-43.0, 0.0), (0.0, 0.0)])
    found = drain(iter_pick(source, PLAN, np.array([(0, 0, 0), (1, 1, 1)])))
    assert found.recorded[0, 0, 0] == 2 and found.recorded[1, 1, 1] == 1
    cut = frames(3)[:2, :16, 38:59].mean(0)
    np.testing.assert_allclose(found[0, 0, 0][5:], cut, rtol=1e-6)
    assert not found.valid(0, 0, 0)[:5].any() and found.valid(0, 0, 0)[5:].all()


def test_a_position_without_a_frame_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected a position that has a frame, got \(1, 1, 2\)"):
        drain(iter_pick(ArraySource(frames(11), PLACES[:11]), PLAN, np.array([(1, 1, 2)])))


@pytest.mark.parametrize("place", [(2, 0, 0), (0, -1, 0)])
def test_a_position_outside_the_plan_is_refused(place: tuple[int, int, int]) -> None:
    with pytest.raises(InputError, match=r"expected three numbers from 0, below \(2, 2, 3\)"):
        drain(iter_pick(ArraySource(frames(11), PLACES[:11]), PLAN, np.array([place])))
