from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, drain
from lfcal.frames import ArraySource, CorrectionChain, Dark, Noise, corrected
from lfcal.frames.source import FrameInfo, Position
from lfcal.psf import Cutout, assemble, iter_assemble, open_psf
from lfcal.psf.assembly import AssemblyProgress
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
    assert (report.frames, report.missing, report.repeated) == (24, (), ())
    assert report.saturated is None and report.unknown_saturation == 24, "16-bit frames of an unknown camera"
    assert not report.notes
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


def test_missing_and_repeated_positions_are_recorded(frames: Frames, tmp_path: Path) -> None:
    source, stack = frames
    keep = [k for k in range(24) if k not in (5, 17)] + [3]
    partial = ListSource([source.frames[k] for k in keep], [source.positions[k] for k in keep])
    partial.frames[-1] = source.frames[3] // 2  # the second recording of position 3: the mean of both counts
    report = assemble(partial, SHAPE, CUTOUT, out=tmp_path / "H.h5")
    assert report.missing == (Position(*source.positions[5]), Position(*source.positions[17]))
    assert report.repeated == (Position(*source.positions[3]),)
    assert any("once and averaged; they differ by" in note for note in report.notes)
    with open_psf(tmp_path / "H.h5") as H:
        at = source.positions[3]
        assert H.recorded[source.positions[5]] == 0 and H.recorded[at] == 2
        np.testing.assert_array_equal(H.missing, [source.positions[5], source.positions[17]])
        assert not H[source.positions[5]].any()
        pair = np.stack([expected(stack)[at], expected((stack // 2).astype(np.uint16))[at]]).astype(float)
        np.testing.assert_allclose(H[at], pair.mean(axis=0))
        assert H.facts.spread is not None
        assert H.facts.spread[at] == pytest.approx(
            np.sqrt(pair.var(axis=0, ddof=1).mean() / np.mean(pair.mean(axis=0) ** 2)), rel=1e-5
        )
        assert report.spread == pytest.approx(float(H.facts.spread[at]))
        assert np.isnan(H.facts.spread[source.positions[4]]), "one frame has no spread"
        variance = H.variance(*at)
        assert variance is not None
        np.testing.assert_allclose(variance, pair.var(axis=0, ddof=1).mean() / 2, rtol=1e-5)
    for part in (partial, ListSource([*source.frames, source.frames[0]], [*source.positions, (0, 0, 0)])):
        with pytest.raises(InputError, match=r"without a frame|with several frames"):
            assemble(part, SHAPE, CUTOUT, strict=True, out=tmp_path / "strict.h5")
    assert not (tmp_path / "strict.h5").exists()


def test_repeats_are_weighted_by_their_noise_and_skip_what_is_saturated() -> None:
    stack = np.full((3, 9, 9), 100.0, np.float32)
    stack[1], stack[2] = 130.0, 160.0
    stack[2, 4, 4] = 4095.0

    class Noisy(ArraySource):
        def samples(self, index: int, region: Any = None) -> Any:
            noise = (Noise(1.0, 0.0), Noise(2.0, 0.0), Noise(4.0, 0.0))[index]
            return super().samples(index, region)._replace(noise=noise)

    source = Noisy(stack, [(0, 0, 0)] * 3, metadata={"saturation": 4095.0})
    H = assemble(source, (1, 1, 1), Cutout((3, 3), anchor=(4, 4))).matrix
    weights = np.array([1, 1 / 2, 1 / 4])
    every = float((weights * [100, 130, 160]).sum() / weights.sum())
    unsaturated = float((weights[:2] * [100, 130]).sum() / weights[:2].sum())
    assert H[0, 0, 0, 0, 0] == pytest.approx(every, rel=1e-6)
    assert H[0, 0, 0, 1, 1] == pytest.approx(unsaturated, rel=1e-6), "the saturated sample is left out"
    assert H.valid(0, 0, 0).all() and H.saturated is not None and H.saturated[0, 0, 0] == 1
    variance = H.variance(0, 0, 0)
    assert variance is not None
    np.testing.assert_allclose(variance, (weights**2 * [1, 2, 4]).sum() / weights.sum() ** 2, rtol=1e-6)


def test_mask_noise_and_saturation_travel_from_the_frame_to_the_file(tmp_path: Path) -> None:
    raw = np.random.default_rng(2).integers(100, 4000, (2, 32, 40)).astype(np.uint16)
    raw[1, 12, 16] = 4095  # the centre of position x = 1
    facts = {"saturation": 4095.0, "noise": Noise(9.0, 0.25)}
    source = corrected(ArraySource(raw, [(0, 0, 0), (0, 0, 1)], metadata=facts), CorrectionChain((Dark(level=64.0),)))
    report = assemble(source, (1, 1, 2), CUTOUT, tmp_path / "H.h5")
    assert (report.saturated, report.unknown_saturation) == (1, 0)
    with open_psf(tmp_path / "H.h5") as H:
        mask = np.ones((7, 9), bool)
        assert np.array_equal(H.valid(0, 0, 0), mask)
        mask[3, 4] = False
        assert np.array_equal(H.valid(0, 0, 1), mask)
        np.testing.assert_allclose(H.variance(0, 0, 1), 9 + 0.25 * np.maximum(H[0, 0, 1], 0), rtol=1e-6)
        assert H.saturated is not None
        np.testing.assert_array_equal(H.saturated[0, 0], [0, 1])


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


def test_corrections_keep_the_sign_and_saturation_is_that_of_the_raw_frame(frames: Frames) -> None:
    source, stack = frames
    dark = np.random.default_rng(5).integers(0, 65000, source.shape).astype(np.uint16)
    p = source.positions[7]
    source.frames[7][12 + p[1], 15 + p[2]] = 65535
    source.frames[8][0, 0] = 65535  # far from the cutout: H does not know of it
    report = assemble(corrected(source, CorrectionChain((Dark(dark),))), SHAPE, CUTOUT)
    truth = expected(stack)
    truth[p][3, 4] = 65535
    for z, y, x in np.ndindex(SHAPE):
        truth[z, y, x] -= dark[12 + y - 3 : 12 + y + 4, 15 + x - 4 : 15 + x + 5]
    np.testing.assert_array_equal(np.asarray(report.matrix), truth)
    assert truth.min() < 0 and report.saturated == 1 and report.unknown_saturation == 23
    assert report.matrix.saturated is not None
    assert report.matrix.saturated[p] == 1 and report.matrix.saturated[source.positions[8]] == -1


class Cropped(ListSource):
    """Frames that are themselves parts of the sensor, as a recording holds them."""

    def info(self, index: int) -> FrameInfo:
        _, y, x = self.positions[index]
        return FrameInfo((Position(*self.positions[index]),), (12 + y - 5, 15 + x - 6), label=f"frame {index}")


def test_frames_that_are_cutouts_already(frames: Frames) -> None:
    source, stack = frames
    parts = [stack[p][12 + p[1] - 5 : 12 + p[1] + 6, 15 + p[2] - 6 : 15 + p[2] + 7] for p in source.positions]
    dark = np.random.default_rng(6).integers(0, 500, source.shape).astype(np.uint16)
    chain = CorrectionChain((Dark(dark),))
    H = assemble(corrected(Cropped(parts, source.positions), chain), SHAPE, CUTOUT).matrix
    whole = assemble(corrected(source, chain), SHAPE, CUTOUT).matrix
    np.testing.assert_array_equal(np.asarray(H), np.asarray(whole))
    with pytest.raises(InputError, match=r"expected rows 7\.\.17, columns 9\.\.21, got rows 6\.\.18"):
        assemble(Cropped(parts, source.positions), SHAPE, Cutout((13, 9), anchor=(12, 15)))


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


def test_the_residual_that_nearest_leaves_is_reported(frames: Frames) -> None:
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


def _broken(source: ListSource, kind: str) -> ListSource:
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
        frames[4] = frames[4][:10]
    elif kind == "outside":
        positions[4] = (0, 0, 99)
    elif kind == "negative":
        positions[4] = (0, -1, 0)
    return ListSource(frames, positions)


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
    source = corrected(_broken(frames[0], kind), CorrectionChain())
    with pytest.raises(InputError, match=word) as error:
        assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5")
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_no_frames_at_all(frames: Frames) -> None:
    source, _ = frames
    empty = ListSource(source.frames, source.positions)
    empty.__class__ = type("Empty", (ListSource,), {"__len__": lambda self: 0})
    with pytest.raises(InputError, match="none"):
        assemble(empty, SHAPE, CUTOUT)


@pytest.mark.parametrize("dtype", ["rounded", "uint16", "float32"])
def test_frames_of_integers_are_stored_exactly(tmp_path: Path, dtype: str) -> None:
    """Every type keeps the counts of frames that nothing corrects, and says that it makes no error."""
    source, stack = coded_frames(seed=9)
    matrix = assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5", dtype=dtype).matrix
    np.testing.assert_array_equal(np.asarray(matrix), expected(stack))
    assert np.isnan(matrix.facts.known()["error"]).all()
    with h5py.File(tmp_path / "H.h5", locking=False) as file:
        np.testing.assert_array_equal(file["H"][...], expected(stack))


def test_the_records_show_h_as_it_fills(frames: Frames) -> None:
    source, _ = frames
    records: list[Progress] = []
    made = drain(iter_assemble(source, SHAPE, CUTOUT, workers=1), records.append)
    shown = [record for record in records if isinstance(record, AssemblyProgress)]
    assert [record.plane for record in shown] == [z for z in range(SHAPE[0]) for _ in range(SHAPE[1])]
    there = [int(np.isfinite(record.energy[0]).sum()) for record in shown[: SHAPE[1]]]
    assert there == sorted(there) and there[-1] == SHAPE[1] * SHAPE[2] and there[0] >= SHAPE[2]
    assert np.isnan(shown[0].energy[1]).all()
    light = [made.matrix.plane(z).sum((2, 3), dtype=float) for z in range(SHAPE[0])]
    np.testing.assert_allclose(shown[-1].energy, light, rtol=1e-6)
