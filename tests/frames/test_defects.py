"""Defect pixels: found over the frames, interpolated from their own colour, masked or listed in files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError, LfcalError
from lfcal.base.progress import Progress
from lfcal.frames import (
    ArraySource,
    CorrectionChain,
    CorrectionRecipe,
    Defects,
    channel_source,
    corrected_view,
    find_defects,
    iter_find_defects,
)
from lfcal.frames.cfa import channel_names, channel_phase, check_cfa, same_colour_offsets
from tests.frames.scenes import session

SHAPE = (90, 120)
HOT = [(0, 0), (10, 11), (40, 40), (41, 41), (88, 118)]
DEAD = [(45, 60), (50, 70)]
STUCK = [(42, 66)]


def spots(count: int, cfa: str, *, lit: bool = True, seed: int = 3) -> ArraySource:
    """Return frames of a grid of spots that moves, on a sensor with known defects."""
    rng = np.random.default_rng(seed)
    rows, columns = (np.arange(n)[:, None] for n in SHAPE)
    frames = np.empty((count, *SHAPE))
    for k in range(count):
        frame = 100 + rng.normal(0, 3, SHAPE)
        y, x = 45 + 8 * np.sin(1.7 * k), 65 + 10 * np.cos(2.3 * k)
        if lit:
            down = np.exp(-((rows - y - 10 * np.arange(7) + 30) ** 2) / 4.5).sum(axis=1)
            across = np.exp(-((columns - x - 10 * np.arange(9) + 40) ** 2) / 4.5).sum(axis=1)
            frame += 2000 * np.outer(down, across)
        for p in HOT:
            frame[p] += 500
        for p in DEAD:
            frame[p] = 100 + rng.normal(0, 3)
        for p in STUCK:
            frame[p] = 900
        frames[k] = frame
    metadata = {"cfa": cfa} if cfa else {}
    return ArraySource(frames.round().astype(np.uint16), [(0, 0, k) for k in range(count)], metadata=metadata)


@pytest.mark.parametrize(("count", "cfa"), [(24, "GRBG"), (40, "")])
def test_every_defect_is_found_and_nothing_else(count: int, cfa: str) -> None:
    found = find_defects(spots(count, cfa))
    kinds = {tuple(p): kind for p, kind in zip(np.asarray(found.pixels).tolist(), found.kinds, strict=True)}
    assert kinds == {**dict.fromkeys(HOT, "hot"), **dict.fromkeys(DEAD, "dead"), **dict.fromkeys(STUCK, "stuck")}
    assert found.cfa == cfa
    assert found.describe()["hot"] == len(HOT)


def test_dark_frames_show_hot_pixels_only() -> None:
    found = find_defects(spots(8, "", lit=False))
    assert np.asarray(found.pixels).tolist() == sorted(map(list, HOT + STUCK))
    assert set(found.kinds) == {"hot"}


def test_a_sensor_without_defects_has_none() -> None:
    frames = np.random.default_rng(1).poisson(300, (12, 150, 160))
    for dtype in (np.uint16, np.float32):
        assert len(find_defects(ArraySource(frames.astype(dtype), [(0, 0, k) for k in range(12)]))) == 0


def test_frames_of_one_position_would_show_spots_as_hot_pixels() -> None:
    """The defects stay while the spots move; where nothing moves they cannot be told apart."""
    frame = np.random.default_rng(1).poisson(300, SHAPE)
    frame[30, 40] = 3000
    still = ArraySource(np.stack([frame] * 8).astype(np.uint16), [(0, 0, 0)] * 8)
    assert np.asarray(find_defects(still).pixels).tolist() == [[30, 40]]


def test_search_reports_progress_and_reads_no_more_than_asked() -> None:
    source = spots(24, "")
    read: list[int] = []
    chosen = [0, 5, 9, 14, 18, 23]
    plain = source.read
    source.read = lambda k: (read.append(k), plain(k))[1]  # type: ignore[method-assign]
    work = iter_find_defects(source, frames=6)
    records = list(work)
    assert all(isinstance(r, Progress) for r in records) and records[-1].fraction == 1
    assert read == chosen * 2


def test_pixels_that_no_spot_covers_are_not_taken_for_dead() -> None:
    """Between the few places where sharp spots stood, pixels see nothing while their neighbours do."""
    rows, columns = np.indices(SHAPE)
    frames = np.random.default_rng(4).normal(100, 3, (8, *SHAPE))
    for k, (y, x) in enumerate([(40, 40), (44, 40), (40, 44), (44, 44), (40, 42), (44, 42), (42, 40), (42, 44)]):
        frames[k] += 3000 * np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / (2 * 0.6**2))
    frames = frames.round().astype(np.uint16)
    span = np.ptp(frames, axis=0)
    assert span[42, 42] < 0.1 * np.sort(span[41:44, 41:44].ravel())[2], "it looks dead by its span alone"
    assert len(find_defects(ArraySource(frames, [(0, 0, k) for k in range(8)]))) == 0


def test_too_few_frames() -> None:
    with pytest.raises(InputError, match="frames to find defects in: expected at least 3, got 2"):
        find_defects(ArraySource(np.ones((2, 9, 9)), [(0, 0, 0), (0, 0, 1)]))


# -- repair ----------------------------------------------------------------------------------------------------


def test_bayer_repair_uses_the_same_colour() -> None:
    mosaic = np.zeros((12, 12), np.float32)
    for k, value in enumerate((10, 20, 30, 10)):  # green, red, blue, green
        mosaic[k // 2 :: 2, k % 2 :: 2] = value
    broken = mosaic.copy()
    pixels = [(4, 4), (4, 5), (5, 4), (5, 5), (0, 0), (11, 11)]
    for p in pixels:
        broken[p] = 9999
    np.testing.assert_array_equal(CorrectionChain((Defects(pixels, (12, 12), "GRBG"),)).apply(broken), mosaic)
    wrong = CorrectionChain((Defects(pixels, (12, 12)),)).apply(broken)
    assert np.abs(wrong - mosaic).max() > 5, "neighbours of another colour give another value"


def plane_image() -> np.ndarray:
    rows, columns = np.indices((30, 40))
    return (3.0 * rows - 2.0 * columns + 500).astype(np.float32)


def test_repair_of_a_plane_is_exact() -> None:
    broken, pixels = plane_image(), [(10, 10), (20, 30), (5, 6)]
    for p in pixels:
        broken[p] = 0
    repaired = CorrectionChain((Defects(pixels, (30, 40)),)).apply(broken)
    np.testing.assert_allclose(repaired, plane_image(), atol=1e-3)


def test_masked_values_are_repaired_without_being_listed() -> None:
    broken = plane_image()
    broken[10, 10] = np.nan
    broken[20:25, 20:25] = np.nan
    result = CorrectionChain((Defects([], (30, 40)),)).apply(broken)
    assert result[10, 10] == plane_image()[10, 10]
    assert np.isfinite(result[20, 20:25]).all() and np.isnan(result[21:24, 21:24]).all(), "too far from a good pixel"
    assert np.isnan(CorrectionChain().apply(broken)).sum() == 26, "without the step they stay marked"


def test_unusable_defects_are_refused() -> None:
    for pixels, more, words in (
        ([(30, 5)], {}, "on the sensor of 30 x 40 px, got"),
        ([(-1, 5)], {}, "on the sensor"),
        ([(5, 5)], {"kinds": ("hot", "dead")}, "kinds of defects: expected as many as defective pixels (1), got 2"),
        ([(5, 5)], {"cfa": "GRB"}, "colour filter pattern"),
        ([(r, c) for r in range(10) for c in range(10)], {}, "at most 5 % of the sensor, got 8.33 %"),
        ([(r, c) for r in range(7) for c in range(7)], {}, "only defective ones within two periods"),
    ):
        with pytest.raises(InputError) as caught:
            Defects(pixels, (30, 40), **more)  # type: ignore[arg-type]
        assert words in str(caught.value) and "\n" not in str(caught.value)


def test_defects_are_sorted_and_counted_once() -> None:
    found = Defects([(5, 6), (1, 2), (5, 6)], (30, 40), kinds=("hot", "dead", "hot"))
    assert np.asarray(found.pixels).tolist() == [[1, 2], [5, 6]] and found.kinds == ("dead", "hot")
    assert len(found) == 2 and found.mask().sum() == 2
    assert len(Defects([], (30, 40))) == 0


# -- colour filter patterns ------------------------------------------------------------------------------------


def test_channel_names_are_numbered_by_rows() -> None:
    assert channel_names("GRBG") == ("G1", "R", "B", "G2")
    assert channel_names("RGGB") == ("R", "G1", "G2", "B")
    assert channel_names("RGBW") == ("R", "G", "B", "W")
    assert channel_phase("GRBG", "G2") == (1, 1)
    with pytest.raises(InputError, match="expected G1, R, B or G2, got 'G'"):
        channel_phase("GRBG", "G")
    with pytest.raises(InputError, match="monochrome"):
        channel_phase("", "G")
    for cfa in ("RGB", "XYZW", 7):
        with pytest.raises(InputError, match="colour filter pattern"):
            check_cfa(cfa)  # type: ignore[arg-type]


def test_nearest_same_colour_neighbours() -> None:
    mono = same_colour_offsets("")[0][0]
    assert sorted(map(tuple, mono[0].tolist())) == [(-1, 0), (0, -1), (0, 1), (1, 0)]
    green, red = same_colour_offsets("GRBG")[0]
    assert sorted(map(tuple, green[0].tolist())) == [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    assert sorted(map(tuple, red[0].tolist())) == [(-2, 0), (0, -2), (0, 2), (2, 0)]


# -- masks and lists in files ------------------------------------------------------------------------------------------


SENSOR = (20, 30)
FRAMES = session((3, *SENSOR))
PLACES = [(0, 0, k) for k in range(3)]
LOST = np.zeros(SENSOR, np.bool_)
LOST[4, 7] = LOST[5, 7] = LOST[0, 29] = True
LOST_PIXELS = [tuple(pixel) for pixel in np.argwhere(LOST).tolist()]
FORMS: dict[str, Callable[[Path], object]] = {
    "mask.npy": lambda path: np.save(path, LOST),
    "mask.tif": lambda path: tifffile.imwrite(path, LOST.astype(np.uint8) * 255, photometric="minisblack"),
    "nan.tif": lambda path: tifffile.imwrite(path, np.where(LOST, np.float32(np.nan), np.float32(0))),
    "mask.png": lambda path: cv2.imwrite(str(path), LOST.astype(np.uint8)),
    "mask.txt": lambda path: path.write_text("# hot pixels\n" + "\n".join(f"{r},{c}" for r, c in LOST_PIXELS)),
    "blanks.lst": lambda path: path.write_text("\n".join(f"{r} {c}" for r, c in LOST_PIXELS)),
    "xy.csv": lambda path: path.write_text("X;Y;kind\n" + "\n".join(f"{c};{r};hot" for r, c in LOST_PIXELS)),
}


def source(frames: Any = FRAMES, **more: Any) -> ArraySource:
    return ArraySource(frames, PLACES[: len(frames)], **more)


def view_of(frames: Any = FRAMES, *, recipe: dict[str, Any], **more: Any) -> Any:
    return corrected_view(source(frames, **more), CorrectionRecipe(exposure="none", **recipe))


def test_masked_pixels_are_not_valid_and_all_others_are_as_before(tmp_path: Path) -> None:
    for name, write in FORMS.items():
        write(tmp_path / name)
        found = view_of(recipe={"mask": tmp_path / name}).samples(1)
        np.testing.assert_array_equal(~found.valid, LOST, err_msg=name)
        np.testing.assert_array_equal(found.values[~LOST], FRAMES[1][~LOST], err_msg=name)
        around = [FRAMES[1][r, c] for r, c in ((0, 28), (1, 28), (1, 29))]
        assert np.isfinite(found.values).all() and min(around) <= found.values[0, 29] <= max(around)
    with h5py.File(tmp_path / "maps.h5", "w") as file:
        file["entry/pixel_mask"] = LOST.astype(np.uint32)
    for name in ("maps.h5", "maps.h5::/entry/pixel_mask"):
        np.testing.assert_array_equal(~view_of(recipe={"mask": tmp_path / name}).samples(0).valid, LOST)


def test_a_region_is_that_of_the_whole_frame(tmp_path: Path) -> None:
    np.save(tmp_path / "mask.npy", LOST)
    for recipe in ({}, {"background": "plane"}, {"defects": True}):
        view = view_of(recipe={"mask": tmp_path / "mask.npy", **recipe})
        whole = view.samples(2)
        for region in (np.s_[3:6, 6:9], np.s_[0:2, 27:30], np.s_[4:5, 7:8]):
            part = view.samples(2, region)
            np.testing.assert_allclose(part.values, whole.values[region], rtol=1e-6)
            assert np.array_equal(whole.valid[region], np.ones(part.values.shape) if part.valid is None else part.valid)


def test_masked_pixels_enter_neither_background_nor_neighbours_nor_counts(tmp_path: Path) -> None:
    """A bright dead column at the border would raise the background, and a repaired pixel next to it."""
    frames = np.full((3, *SENSOR), 100, np.uint16)
    lost = np.zeros(SENSOR, np.bool_)
    lost[:, :6] = lost[10:13, 10:12] = True
    frames[:, lost] = 4095
    np.save(tmp_path / "mask.npy", lost)
    (tmp_path / "hot.txt").write_text("11,12\n")
    frames[:, 11, 12] = 3000
    recipe = {"mask": tmp_path / "mask.npy", "background": "plane", "defect_list": tmp_path / "hot.txt"}
    found = view_of(frames, recipe=recipe, metadata={"saturation": 4095.0}).samples(0)
    np.testing.assert_allclose(found.values[~lost], 0.0, atol=1e-3)
    assert found.saturated == 0 and np.array_equal(found.valid, ~lost)


def test_listed_pixels_are_interpolated_and_stay_valid(tmp_path: Path) -> None:
    frames = FRAMES.copy()
    frames[:, 4, 7] = 4095
    (tmp_path / "hot.txt").write_text("4,7\n")
    view = view_of(frames, recipe={"defect_list": tmp_path / "hot.txt"}, metadata={"saturation": 4095.0})
    found, near = view.samples(0), frames[0, 3:6, 6:9].astype(float)
    assert found.valid is None or found.valid.all()
    # the nearest ring of good neighbours: left, right, above, below
    assert found.values[4, 7] == pytest.approx(np.mean([near[0, 1], near[2, 1], near[1, 0], near[1, 2]]))
    known = {"kind": "defects", "count": 1, "cfa": "", "listed": 1, "crc32": ""}
    assert view.chain.describe()["steps"][0] | {"crc32": ""} == known


def test_listed_and_found_pixels_are_repaired_together_and_masked_ones_are_not_searched(tmp_path: Path) -> None:
    frames = np.random.default_rng(1).normal(100, 2, (3, *SENSOR))
    for r, c in ((4, 7), (10, 10), (15, 20)):
        frames[:, r, c] = 900
    (tmp_path / "hot.txt").write_text("4,7\n")
    (tmp_path / "mask.txt").write_text("15,20\n")
    recipe = {"defect_list": tmp_path / "hot.txt", "mask": tmp_path / "mask.txt", "defects": True}
    (defects,) = (step for step in view_of(frames, recipe=recipe).chain.steps if hasattr(step, "kinds"))
    assert [tuple(p) for p in defects.pixels] == [(4, 7), (10, 10)] and defects.kinds == ("listed", "hot")


def test_a_mask_of_the_sensor_is_cut_to_frames_of_a_part_and_to_one_colour(tmp_path: Path) -> None:
    part, place = FRAMES[:, 3:15, 5:25], (3, 5)
    np.save(tmp_path / "sensor.npy", LOST)
    np.save(tmp_path / "part.npy", LOST[3:15, 5:25])
    (tmp_path / "list.txt").write_text("\n".join(f"{r},{c}" for r, c in LOST_PIXELS))
    for name in ("sensor.npy", "part.npy", "list.txt"):
        view = view_of(part, recipe={"mask": tmp_path / name}, metadata={"origin": place}, origins=[place] * 3)
        np.testing.assert_array_equal(~view.samples(0).valid, LOST[3:15, 5:25], err_msg=name)
    # frames at several places of the sensor
    places = [(0, 0), (3, 5), (8, 10)]
    cut = np.stack([frame[r : r + 12, c : c + 20] for frame, (r, c) in zip(FRAMES, places, strict=True)])
    view = view_of(cut, recipe={"mask": tmp_path / "sensor.npy"}, origins=places)
    for k, (r, c) in enumerate(places):
        valid = view.samples(k).valid
        lost = np.zeros((12, 20), bool) if valid is None else ~valid
        np.testing.assert_array_equal(lost, LOST[r : r + 12, c : c + 20])
    mosaic = source(metadata={"cfa": "GRBG"})
    for name in ("sensor.npy", "list.txt"):
        view = corrected_view(channel_source(mosaic, "R"), CorrectionRecipe(mask=tmp_path / name, exposure="none"))
        np.testing.assert_array_equal(~view.samples(0).valid, LOST[0::2, 1::2])


DEEP = r"expected one image with axes \(row, column\), got float64 of shape \(2, 20, 30\)"
NO_MASKS: list[tuple[str, Any, str, str]] = [
    ("small.npy", np.zeros((9, 9)), "mask", "expected 20 x 30 px, as the frames come from the camera, got 9 x 9"),
    ("all.npy", np.ones(SENSOR), "mask", "mask: expected at least one usable pixel"),
    ("many.npy", np.ones(SENSOR), "defect_list", "at most 5 % of the sensor, got 100 %; .*--mask"),
    ("deep.npy", np.zeros((2, *SENSOR)), "mask", DEEP),
    ("out.txt", "4,7\n20,3\n", "mask", "rows and columns from 0 on a sensor of 20 x 30 px, got 20,3"),
    ("three.txt", "1 4 7\n", "mask", "columns row and column, or y and x, got 3 columns without names"),
    ("odd.csv", "row,column\n4.5,7\n", "defect_list", "line 2: expected whole numbers, got 4.5, 7"),
    ("names.csv", "a,b\n4,7\n", "mask", "columns row and column, or y and x, got a, b"),
]


def test_files_that_mark_no_pixels_are_refused(tmp_path: Path) -> None:
    for name, content, field, words in NO_MASKS:
        path = tmp_path / name
        path.write_text(content) if isinstance(content, str) else np.save(path, content)
        with pytest.raises(LfcalError, match=words):
            view_of(recipe={field: path})
