"""Masks and lists of defective pixels in files: how they are read, and what they do to frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import LfcalError
from lfcal.frames import ArraySource, CorrectionRecipe, channel_source, corrected_view
from tests.frames.scenes import session

SHAPE = (20, 30)
FRAMES = session((3, *SHAPE))
PLACES = [(0, 0, k) for k in range(3)]
LOST = np.zeros(SHAPE, np.bool_)
LOST[4, 7] = LOST[5, 7] = LOST[0, 29] = True
PIXELS = [tuple(pixel) for pixel in np.argwhere(LOST).tolist()]
FORMS: dict[str, Callable[[Path], object]] = {
    "mask.npy": lambda path: np.save(path, LOST),
    "mask.tif": lambda path: tifffile.imwrite(path, LOST.astype(np.uint8) * 255, photometric="minisblack"),
    "nan.tif": lambda path: tifffile.imwrite(path, np.where(LOST, np.float32(np.nan), np.float32(0))),
    "mask.png": lambda path: cv2.imwrite(str(path), LOST.astype(np.uint8)),
    "mask.txt": lambda path: path.write_text("# hot pixels\n" + "\n".join(f"{r},{c}" for r, c in PIXELS)),
    "blanks.lst": lambda path: path.write_text("\n".join(f"{r} {c}" for r, c in PIXELS)),
    "xy.csv": lambda path: path.write_text("X;Y;kind\n" + "\n".join(f"{c};{r};hot" for r, c in PIXELS)),
}


def source(frames: Any = FRAMES, **more: Any) -> ArraySource:
    return ArraySource(frames, PLACES[: len(frames)], **more)


def view_of(frames: Any = FRAMES, *, recipe: dict[str, Any], **more: Any) -> Any:
    return corrected_view(source(frames, **more), CorrectionRecipe(exposure="none", **recipe))


@pytest.mark.parametrize("name", FORMS)
def test_masked_pixels_are_not_valid_and_all_others_are_as_before(tmp_path: Path, name: str) -> None:
    FORMS[name](tmp_path / name)
    found = view_of(recipe={"mask": tmp_path / name}).samples(1)
    np.testing.assert_array_equal(~found.valid, LOST)
    np.testing.assert_array_equal(found.values[~LOST], FRAMES[1][~LOST])
    around = [FRAMES[1][r, c] for r, c in np.ndindex(SHAPE) if abs(r - 0) <= 1 and abs(c - 29) <= 1 and not LOST[r, c]]
    assert np.isfinite(found.values).all() and min(around) <= found.values[0, 29] <= max(around)


@pytest.mark.parametrize("name", ["maps.h5", "maps.h5::/entry/pixel_mask"])
def test_a_mask_within_hdf5(tmp_path: Path, name: str) -> None:
    with h5py.File(tmp_path / "maps.h5", "w") as file:
        file["entry/pixel_mask"] = LOST.astype(np.uint32)
    np.testing.assert_array_equal(~view_of(recipe={"mask": tmp_path / name}).samples(0).valid, LOST)


@pytest.mark.parametrize("rows,columns", [((3, 6), (6, 9)), ((0, 2), (27, 30)), ((4, 5), (7, 8))])
def test_a_region_is_that_of_the_whole_frame(tmp_path: Path, rows: Any, columns: Any) -> None:
    np.save(tmp_path / "mask.npy", LOST)
    region = (slice(*rows), slice(*columns))
    for recipe in ({}, {"background": "plane"}, {"defects": True}):
        view = view_of(recipe={"mask": tmp_path / "mask.npy", **recipe})
        whole, part = view.samples(2), view.samples(2, region)
        np.testing.assert_allclose(part.values, whole.values[region], rtol=1e-6)
        assert np.array_equal(whole.valid[region], np.ones(part.values.shape) if part.valid is None else part.valid)


def test_masked_pixels_enter_neither_background_nor_neighbours_nor_counts(tmp_path: Path) -> None:
    """A bright dead column at the border would raise the background, and a repaired pixel next to it."""
    frames = np.full((3, *SHAPE), 100, np.uint16)
    lost = np.zeros(SHAPE, np.bool_)
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
    assert view.chain.describe()["steps"][0] | {"crc32": ""} == {
        **{"kind": "defects", "count": 1, "cfa": "", "listed": 1},
        "crc32": "",
    }


def test_listed_and_found_pixels_are_repaired_together_and_masked_ones_are_not_searched(tmp_path: Path) -> None:
    frames = np.random.default_rng(1).normal(100, 2, (3, *SHAPE))
    for r, c in ((4, 7), (10, 10), (15, 20)):
        frames[:, r, c] = 900
    (tmp_path / "hot.txt").write_text("4,7\n")
    (tmp_path / "mask.txt").write_text("15,20\n")
    recipe = {"defect_list": tmp_path / "hot.txt", "mask": tmp_path / "mask.txt", "defects": True}
    (defects,) = (step for step in view_of(frames, recipe=recipe).chain.steps if hasattr(step, "kinds"))
    assert [tuple(p) for p in defects.pixels] == [(4, 7), (10, 10)] and defects.kinds == ("listed", "hot")


def test_a_mask_of_the_sensor_is_cut_to_frames_of_a_part(tmp_path: Path) -> None:
    part, place = FRAMES[:, 3:15, 5:25], (3, 5)
    known = {"origin": place}
    np.save(tmp_path / "sensor.npy", LOST)
    np.save(tmp_path / "part.npy", LOST[3:15, 5:25])
    (tmp_path / "list.txt").write_text("\n".join(f"{r},{c}" for r, c in PIXELS))
    for name in ("sensor.npy", "part.npy", "list.txt"):
        view = view_of(part, recipe={"mask": tmp_path / name}, metadata=known, origins=[place] * 3)
        np.testing.assert_array_equal(~view.samples(0).valid, LOST[3:15, 5:25], err_msg=name)


def test_frames_at_several_places_of_the_sensor(tmp_path: Path) -> None:
    places = [(0, 0), (3, 5), (8, 10)]
    cut = np.stack([frame[r : r + 12, c : c + 20] for frame, (r, c) in zip(FRAMES, places, strict=True)])
    np.save(tmp_path / "sensor.npy", LOST)
    view = view_of(cut, recipe={"mask": tmp_path / "sensor.npy"}, origins=places)
    for k, (r, c) in enumerate(places):
        valid = view.samples(k).valid
        np.testing.assert_array_equal(
            ~(np.ones((12, 20), bool) if valid is None else valid), LOST[r : r + 12, c : c + 20]
        )


def test_one_colour_takes_the_mosaic_s_mask(tmp_path: Path) -> None:
    mosaic = source(metadata={"cfa": "GRBG"})
    np.save(tmp_path / "mask.npy", LOST)
    (tmp_path / "list.txt").write_text("\n".join(f"{r},{c}" for r, c in PIXELS))
    for name in ("mask.npy", "list.txt"):
        view = corrected_view(channel_source(mosaic, "R"), CorrectionRecipe(mask=tmp_path / name, exposure="none"))
        np.testing.assert_array_equal(~view.samples(0).valid, LOST[0::2, 1::2])


@pytest.mark.parametrize(
    ("name", "write", "field", "words"),
    [
        ("small.npy", np.zeros((9, 9)), "mask", "expected 20 x 30 px, as the frames come from the camera, got 9 x 9"),
        ("all.npy", np.ones(SHAPE), "mask", "mask: expected at least one usable pixel"),
        ("many.npy", np.ones(SHAPE), "defect_list", "at most 5 % of the sensor, got 100 %; .*--mask"),
        (
            "deep.npy",
            np.zeros((2, *SHAPE)),
            "mask",
            r"expected one image with axes \(row, column\), got float64 \(2, 20, 30\)",
        ),
        ("out.txt", "4,7\n20,3\n", "mask", "rows and columns from 0 on a sensor of 20 x 30 px, got 20,3"),
        ("three.txt", "1 4 7\n", "mask", "columns row and column, or y and x, got 3 columns without names"),
        ("odd.csv", "row,column\n4.5,7\n", "defect_list", "line 2: expected whole numbers, got 4.5, 7"),
        ("names.csv", "a,b\n4,7\n", "mask", "columns row and column, or y and x, got a, b"),
    ],
)
def test_files_that_mark_no_pixels(tmp_path: Path, name: str, write: Any, field: str, words: str) -> None:
    path = tmp_path / name
    path.write_text(write) if isinstance(write, str) else np.save(path, write)
    with pytest.raises(LfcalError, match=words):
        view_of(recipe={field: path})
