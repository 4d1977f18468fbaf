from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.frames import CorrectionChain, Dark
from lfcal.frames.source import Position
from lfcal.psf import Cutout, assemble, iter_assemble, open_psf
from tests.psf.conftest import ListSource, coded_frames

Frames = tuple[ListSource, NDArray[np.uint16]]
SHAPE = (2, 3, 4)
CUTOUT = Cutout((7, 9), anchor=(12, 15))


def expected(stack: NDArray[np.uint16], cutout: Cutout = CUTOUT) -> NDArray[np.float32]:
    """Cut as plainly as it can be written."""
    nt, ns = cutout.shape
    H = np.zeros((*stack.shape[:3], nt, ns), np.float32)
    for z, y, x in np.ndindex(stack.shape[:3]):
        row, column = int(cutout.anchor[0]) + y, int(cutout.anchor[1]) + x
        H[z, y, x] = stack[z, y, x, row - nt // 2 : row + nt // 2 + 1, column - ns // 2 : column + ns // 2 + 1]
    return H


def test_frames_become_h(frames: Frames, tmp_path: Path) -> None:
    source, stack = frames
    report = assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5", depths=[-5, 5])
    np.testing.assert_array_equal(np.asarray(report.matrix), expected(stack))
    assert (report.frames, report.missing, report.duplicates, report.notes) == (24, (), (), ())
    assert report.matrix.anchor == (12, 15)
    in_memory = assemble(source, SHAPE, CUTOUT).matrix
    np.testing.assert_array_equal(np.asarray(in_memory), expected(stack))
    wrong = Cutout((7, 9), anchor=(13, 15))
    assert not np.array_equal(np.asarray(assemble(source, SHAPE, wrong).matrix), expected(stack))


def test_any_order_gives_the_same(frames: Frames) -> None:
    source, stack = frames
    order = np.random.default_rng(0).permutation(len(source))
    shuffled = ListSource([source.frames[k] for k in order], [source.positions[k] for k in order])
    np.testing.assert_array_equal(np.asarray(assemble(shuffled, SHAPE, CUTOUT).matrix), expected(stack))


def test_missing_and_duplicate_positions_are_recorded(frames: Frames, tmp_path: Path) -> None:
    source, stack = frames
    keep = [k for k in range(24) if k not in (5, 17)] + [3]
    partial = ListSource([source.frames[k] for k in keep], [source.positions[k] for k in keep])
    partial.frames[-1] = source.frames[3] // 2  # the second recording of position 3: it counts
    report = assemble(partial, SHAPE, CUTOUT, out=tmp_path / "H.h5")
    assert report.missing == (Position(*source.positions[5]), Position(*source.positions[17]))
    assert report.duplicates == (Position(*source.positions[3]),)
    with open_psf(tmp_path / "H.h5") as H:
        assert H.recorded[source.positions[5]] == 0 and H.recorded[source.positions[3]] == 2
        np.testing.assert_array_equal(H.missing, [source.positions[5], source.positions[17]])
        assert not H[source.positions[5]].any()
        truth = expected((stack // 2).astype(np.uint16))[source.positions[3]]
        np.testing.assert_array_equal(H[source.positions[3]], truth)
    for part in (partial, ListSource([*source.frames, source.frames[0]], [*source.positions, (0, 0, 0)])):
        with pytest.raises(InputError, match=r"missing|given twice"):
            assemble(part, SHAPE, CUTOUT, strict=True, out=tmp_path / "strict.h5")
    assert not (tmp_path / "strict.h5").exists()


def test_a_cutout_off_the_sensor(frames: Frames, tmp_path: Path) -> None:
    source, stack = frames
    over = Cutout((7, 9), anchor=(2, 15))
    with pytest.raises(InputError, match=r"\(z, y, x\) = \(0, 0, 0\).*rows -1\.\.5"):
        assemble(source, SHAPE, over, out=tmp_path / "H.h5")
    assert list(tmp_path.iterdir()) == []
    assert source.reads == 0, "the error comes before the first frame is read"
    report = assemble(source, SHAPE, Cutout((7, 9), anchor=(2, 15), outside="zero"))
    assert report.padded == tuple(Position(z, 0, x) for z in range(2) for x in range(4))
    H = np.asarray(report.matrix)
    assert not H[:, 0, :, 0].any()
    np.testing.assert_array_equal(H[0, 0, 0, 1:], stack[0, 0, 0, 0:6, 11:20])


def test_corrections_keep_the_sign_and_count_saturation_first(frames: Frames) -> None:
    source, stack = frames
    dark = np.random.default_rng(5).integers(0, 65000, source.shape).astype(np.uint16)
    source.frames[7][0, 0] = 65535  # far from the cutout, and yet counted
    report = assemble(source, SHAPE, CUTOUT, corrections=CorrectionChain((Dark(dark),)))
    truth = expected(stack)
    for z, y, x in np.ndindex(SHAPE):
        truth[z, y, x] -= dark[12 + y - 3 : 12 + y + 4, 15 + x - 4 : 15 + x + 5]
    np.testing.assert_array_equal(np.asarray(report.matrix), truth)
    assert truth.min() < 0 and report.saturated == 1
    assert report.matrix.saturated is not None
    assert report.matrix.saturated[source.positions[7]] == 1


class Cropped(ListSource):
    """Frames that are themselves parts of the sensor, as a recording holds them."""

    def origin(self, index: int) -> tuple[int, int]:
        _, y, x = self.positions[index]
        return 12 + y - 5, 15 + x - 6


def test_frames_that_are_cutouts_already(frames: Frames) -> None:
    source, stack = frames
    parts = [stack[p][12 + p[1] - 5 : 12 + p[1] + 6, 15 + p[2] - 6 : 15 + p[2] + 7] for p in source.positions]
    dark = np.random.default_rng(6).integers(0, 500, source.shape).astype(np.uint16)
    chain = CorrectionChain((Dark(dark),))
    H = assemble(Cropped(parts, source.positions), SHAPE, CUTOUT, corrections=chain).matrix
    whole = assemble(source, SHAPE, CUTOUT, corrections=chain).matrix
    np.testing.assert_array_equal(np.asarray(H), np.asarray(whole))


def test_drift_moves_the_window(frames: Frames) -> None:
    source, stack = frames
    drift = np.zeros((24, 2))
    drift[10] = (2, -3)
    moved = np.asarray(assemble(source, SHAPE, CUTOUT, drift=drift).matrix)
    truth = expected(stack)
    p = source.positions[10]
    row, column = 12 + p[1] + 2, 15 + p[2] - 3
    truth[p] = stack[p][row - 3 : row + 4, column - 4 : column + 5]
    np.testing.assert_array_equal(moved, truth)
    with pytest.raises(InputError, match="drift"):
        assemble(source, SHAPE, CUTOUT, drift=np.zeros((3, 2)))


def test_the_rest_that_nearest_leaves_is_reported(frames: Frames) -> None:
    source, _ = frames
    report = assemble(source, SHAPE, Cutout((7, 9), anchor=(12.3, 14.8)))
    assert report.residual_px == pytest.approx((0.3, 0.2))


def test_cancelling_leaves_nothing(frames: Frames, tmp_path: Path) -> None:
    source, _ = frames
    work = iter_assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5")
    records = [next(work), next(work)]
    work.close()
    assert list(tmp_path.iterdir()) == []
    assert records[0].total == 24 and records[1].done > 0


def _broken(source: ListSource, kind: str) -> tuple[ListSource, dict[str, Any]]:
    frames = [f.copy() for f in source.frames]
    positions = list(source.positions)
    if kind == "nan":
        frames = [f.astype(np.float32) for f in frames]
        frames[4][14, 17] = np.nan
    elif kind == "zero":
        frames = [f * 0 for f in frames]
    elif kind == "saturated":
        frames[4][:] = 65535
    elif kind == "shape":
        frames[4] = frames[4][:-1]
    elif kind == "outside":
        positions[4] = (0, 0, 99)
    elif kind == "negative":
        positions[4] = (0, -1, 0)
    return ListSource(frames, positions), {"corrections": CorrectionChain()}


@pytest.mark.parametrize(
    ("kind", "word"),
    [
        ("nan", r"frame 4.*NaN"),
        ("zero", "only zeros"),
        ("saturated", "frame 4.*saturated"),
        ("shape", "frame 4.*pixels"),
        ("outside", "frame 4.*inside"),
        ("negative", "frame 4.*inside"),
    ],
)
def test_bad_frames_are_named(frames: Frames, tmp_path: Path, kind: str, word: str) -> None:
    source, options = _broken(frames[0], kind)
    with pytest.raises(InputError, match=word) as error:
        assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5", **options)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_no_frames_at_all(frames: Frames) -> None:
    source, _ = frames
    empty = ListSource(source.frames, source.positions)
    empty.__class__ = type("Empty", (ListSource,), {"__len__": lambda self: 0})
    with pytest.raises(InputError, match="none"):
        assemble(empty, SHAPE, CUTOUT)


def test_uint16_storage(tmp_path: Path) -> None:
    source, stack = coded_frames(seed=9)
    report = assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5", dtype="uint16")
    np.testing.assert_allclose(np.asarray(report.matrix), expected(stack), atol=0.51)
