"""Frames become H: whole scans, single positions, and the level that must be subtracted first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, drain
from lfcal.frames import ArraySource, CorrectionChain, CorrectionRecipe, Dark, Noise, corrected, corrected_view
from lfcal.frames.source import FrameInfo, Position
from lfcal.psf import Cutout, assemble, assemble_plan, iter_assemble, open_psf
from lfcal.psf._pedestal import pedestal_share
from lfcal.psf.assembly import AssemblyProgress, AssemblySettings, find_plan_cutout
from lfcal.psf.cutout import Gatherer
from lfcal.psf.picked import iter_pick
from tests.acquire.rigs import small_plan
from tests.psf.conftest import ListSource, coded_frames
from tests.psf.test_orientation import a_plan, upright

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
    order = np.random.default_rng(0).permutation(len(source))
    shuffled = ListSource([source.frames[k] for k in order], [source.positions[k] for k in order])
    np.testing.assert_array_equal(np.asarray(assemble(shuffled, SHAPE, CUTOUT).matrix), expected(stack))
    between = assemble(source, SHAPE, Cutout((7, 9), anchor=(12.3, 14.8)))
    assert between.residual_px == pytest.approx((0.3, 0.2)), "what the nearest pixel leaves"


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


BROKEN = {
    "nan": r"frame 4.*NaN",
    "zero": "only zeros",
    "saturated": "frame 4.*saturated",
    "shape": "frame 4.*pixels",
    "outside": "frame 4.*inside",
    "negative": "frame 4.*inside",
}


def test_bad_frames_are_named(frames: Frames, tmp_path: Path) -> None:
    for kind, words in BROKEN.items():
        source = corrected(_broken(frames[0], kind), CorrectionChain())
        with pytest.raises(InputError, match=words) as error:
            assemble(source, SHAPE, CUTOUT, out=tmp_path / "H.h5")
        assert "\n" not in str(error.value)
    empty = ListSource(frames[0].frames, frames[0].positions)
    empty.__class__ = type("Empty", (ListSource,), {"__len__": lambda self: 0})
    with pytest.raises(InputError, match="none"):
        assemble(empty, SHAPE, CUTOUT)
    assert list(tmp_path.iterdir()) == []


def test_frames_of_integers_are_stored_exactly(tmp_path: Path) -> None:
    """Every type keeps the counts of frames that nothing corrects, and says that it makes no error."""
    source, stack = coded_frames(seed=9)
    for dtype in ("rounded", "uint16", "float32"):
        matrix = assemble(source, SHAPE, CUTOUT, out=tmp_path / f"{dtype}.h5", dtype=dtype).matrix
        np.testing.assert_array_equal(np.asarray(matrix), expected(stack))
        assert np.isnan(matrix.facts.known()["error"]).all()
        with h5py.File(tmp_path / f"{dtype}.h5", locking=False) as file:
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


# -- single positions --------------------------------------------------------------------------------------------------


PLAN = small_plan((2, 3), 2)


def picked_frames(count: int = 12) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 4000, (count, 96, 96)).astype(np.uint16)


PLACES = [(z, y, x) for z in range(2) for y in range(2) for x in range(3)]


@pytest.mark.long
def test_patterns_are_those_of_assembly() -> None:
    source = ArraySource(picked_frames(), PLACES)
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
    work = iter_pick(Counting(picked_frames(), PLACES), PLAN, np.array([(1, 1, 1)]))
    assert [next(work).done for _ in range(2)] == [0, 1]
    assert seen == {PLACES.index((1, 1, 1))}


def test_repeats_are_averaged_and_pixels_beyond_the_frame_are_marked() -> None:
    places = [(0, 0, 0), (0, 0, 0), (1, 1, 1)]
    source = ArraySource(picked_frames(3), places, drifts=[(-43.0, 0.0), (-43.0, 0.0), (0.0, 0.0)])
    found = drain(iter_pick(source, PLAN, np.array([(0, 0, 0), (1, 1, 1)])))
    assert found.recorded[0, 0, 0] == 2 and found.recorded[1, 1, 1] == 1
    cut = picked_frames(3)[:2, :16, 38:59].mean(0)
    np.testing.assert_allclose(found[0, 0, 0][5:], cut, rtol=1e-6)
    assert not found.valid(0, 0, 0)[:5].any() and found.valid(0, 0, 0)[5:].all()


def test_positions_without_a_frame_or_outside_the_plan_are_refused() -> None:
    source = ArraySource(picked_frames(11), PLACES[:11])
    without = r"expected a position that has a frame, got \(1, 1, 2\)"
    outside = r"expected three numbers from 0, below \(2, 2, 3\)"
    for place, words in (((1, 1, 2), without), ((2, 0, 0), outside), ((0, -1, 0), outside)):
        with pytest.raises(InputError, match=words):
            drain(iter_pick(source, PLAN, np.array([place])))


# -- the level of the frames -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scan():
    plan = a_plan((60, 72), (3, 4), (25.0, 30.0), 2, (25, 25))
    raw, places = upright(plan, width=4.0, noise=2.0)
    return plan, ArraySource(np.rint(raw).astype(np.uint16), places)


def test_a_wrong_level_is_refused_with_its_size(scan):
    plan, raw = scan
    for off in (-50.0, -10.0, 10.0, 200.0, 1500.0):
        view = corrected_view(raw, CorrectionRecipe(black_level=100.0 + off), plan)
        words = r"after subtracting the dark or black level\); give dark frames"
        with pytest.raises(InputError, match=words) as caught:
            find_plan_cutout(view, plan, AssemblySettings())
        said = float(str(caught.value).split("a constant level of ")[1].split(" (")[0])
        assert said == pytest.approx(-off, abs=0.3)
        assert ("more than all their light" in str(caught.value)) == (off > 100)
        find_plan_cutout(view, plan, AssemblySettings(keep_pedestal=True))
        border = corrected_view(raw, CorrectionRecipe(black_level=100.0 + off, background="border"), plan)
        find_plan_cutout(border, plan, AssemblySettings())
    for off in (-0.4, 0.0, 0.4):  # right but for its rounding
        view = corrected_view(raw, CorrectionRecipe(black_level=100.0 + off), plan)
        cutout = find_plan_cutout(view, plan, AssemblySettings())
        infos = tuple(view.info(k) for k in range(len(view)))
        level, _, seen = pedestal_share(Gatherer(view, infos, cutout), [0, 1])
        assert seen and level == pytest.approx(-off, abs=0.15)  # the median of whole numbers would be one


def test_a_mosaic_whose_colours_do_not_come_back_is_refused(scan):
    plan, raw = scan
    recipe = CorrectionRecipe(black_level=100.0)

    def chosen(cfa, period):
        sensor = replace(plan.camera.sensor, cfa=cfa)
        seen = replace(plan, camera=replace(plan.camera, sensor=sensor), period=period)
        return find_plan_cutout(corrected_view(raw, recipe, seen), seen, AssemblySettings(strict=False))

    with pytest.raises(InputError, match=r"got 3 x 4 pixels, after which the same point .* scan 6 x 4 positions"):
        chosen("RGGB", (3, 4))
    chosen("", (3, 4))
    chosen("RGGB", (2, 4))


def test_noise_alone_is_no_level(scan):
    plan, raw = scan
    rng = np.random.default_rng(0)
    values = np.rint(100 + 2 * rng.standard_normal((len(raw), *raw.shape))).astype(np.uint16)
    dark = ArraySource(values, [raw.info(k).position for k in range(len(raw))])
    find_plan_cutout(corrected_view(dark, CorrectionRecipe(black_level=100.0), plan), plan, AssemblySettings())


@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (-1.5, True)])
def test_the_darkest_part_of_dim_cutouts_is_noise_unless_it_is_certain(off, refused):
    # frames that are cutouts have no place without light: the darkest of 64 blocks counts, and noise makes it negative
    plan = a_plan((200, 200), (1, 1), (100.0, 100.0), 3, (181, 181))
    raw, places = upright(plan, width=2.0, noise=3.0)
    dim = (raw - 100.0) * 0.5 + 100.0 + off
    rng = np.random.default_rng(0)
    raw = [np.rint(np.clip(one + 3.0 * rng.standard_normal(one.shape), 0, None)).astype(np.uint16) for one in dim]
    view = corrected_view(ArraySource(np.stack(raw), places), CorrectionRecipe(black_level=100.0), plan)
    cutout = find_plan_cutout(view, plan, AssemblySettings(keep_pedestal=True))
    gatherer = Gatherer(view, tuple(view.info(k) for k in range(len(view))), cutout)
    found = [pedestal_share(gatherer, [k]) for k in range(len(view))]
    assert not any(seen for _, _, seen in found)
    assert all((level < 0) == refused for level, _, _ in found)
