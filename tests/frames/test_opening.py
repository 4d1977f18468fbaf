"""A session opens from a folder, a manifest or a file of many frames, with every position right."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    FolderSource,
    FrameEntry,
    FrameSource,
    Manifest,
    Position,
    open_frames,
    open_image,
    open_unplaced,
    recorded_times,
    scan_positions,
    write_manifest,
)
from tests.frames.scenes import session, write_dng, write_pngs

FRAMES = session()
PLAN = FRAMES.shape[:3]
NAMES = "z{z}_y{y}_x{x}.png"


def assert_session(source: FolderSource, frames: np.ndarray = FRAMES) -> None:
    assert isinstance(source, FrameSource)
    assert (len(source), source.shape, source.dtype) == (24, (20, 30), np.dtype(np.uint16))
    for k in range(len(source)):
        np.testing.assert_array_equal(source.read(k), frames[source.info(k).position])
        np.testing.assert_array_equal(
            source.read(k, (slice(3, 9), slice(4, 30))), frames[source.info(k).position][3:9, 4:]
        )
    assert sorted(source.info(k).position for k in range(24)) == sorted(scan_positions(PLAN))


def test_folder_by_names(tmp_path: Path) -> None:
    write_pngs(tmp_path, FRAMES)
    (tmp_path / "dark.png").write_bytes((tmp_path / "z0_y0_x0.png").read_bytes())
    plan = ScanPlan(preset("bench"), PLAN[1:], (9, 11), tuple(-1e4 * k for k in range(PLAN[0])), (8, 9))
    assert_session(open_frames(tmp_path, pattern=NAMES, plan=plan))
    source = open_frames(tmp_path, pattern=NAMES, plan_shape=PLAN)
    assert_session(source)
    assert source.info(0).label == "z0_y0_x0.png"
    assert source.metadata.plan_shape == PLAN
    assert source.manifest.coverage() == ((), ())
    (tmp_path / "z1_y2_x3.png").rename(tmp_path / "z1_y02_x2.png")
    source = open_frames(tmp_path, pattern=NAMES, plan_shape=PLAN)
    assert source.manifest.coverage() == ((Position(1, 2, 3),), (Position(1, 2, 2),)), "missing, and repeated"


def test_folder_with_a_subfolder_or_a_file_for_each_plane(tmp_path: Path) -> None:
    for z in range(2):
        (tmp_path / f"z{z}").mkdir()
        for y, x in np.ndindex(3, 4):
            cv2.imwrite(str(tmp_path / f"z{z}" / f"{y}_{x}.png"), FRAMES[z, y, x])
    assert_session(open_frames(tmp_path, pattern="z{z}/{y}_{x}.png"))
    (tmp_path / "planes").mkdir()
    for z in range(2):
        pages = FRAMES[z].reshape(12, 20, 30)
        tifffile.imwrite(tmp_path / "planes" / f"plane{z}.tif", pages, photometric="minisblack")
    assert_session(open_frames(tmp_path / "planes", order="raster", plan_shape=PLAN))


@pytest.mark.parametrize(("order", "other"), [("serpentine", "raster"), ("raster", "serpentine")])
def test_folder_by_scan_order(tmp_path: Path, order: str, other: str) -> None:
    for k, position in enumerate(scan_positions(PLAN, order)):
        cv2.imwrite(str(tmp_path / f"img{k + 95}.png"), FRAMES[position])
    assert_session(open_frames(tmp_path, order=order, plan_shape=PLAN))
    with pytest.raises(AssertionError):
        assert_session(open_frames(tmp_path, order=other, plan_shape=PLAN))


def test_folder_by_its_manifest(tmp_path: Path) -> None:
    names = write_pngs(tmp_path, FRAMES)
    entries = [
        FrameEntry(name, Position(*p), 0, 0.01 * (k + 1), 0.5, -k / 8)
        for k, (name, p) in enumerate(zip(names, np.ndindex(*PLAN), strict=True))
    ]
    for suffix in ("csv", "json"):
        path = tmp_path / f"manifest.{suffix}"
        write_manifest(path, Manifest(tuple(reversed(entries))))
        for place in (tmp_path, path):
            source = open_frames(place)
            assert_session(source)
            assert source.info(0).exposure_s == pytest.approx(0.24)
            assert source.info(0).drift == (0.5, -23 / 8)
        path.unlink()
    assert len(open_frames(tmp_path, manifest=Manifest(tuple(entries[:3])))) == 3


STACK = np.stack([FRAMES[p] for p in scan_positions(PLAN, "serpentine")])


STACKS: dict[str, Callable[[Path], object]] = {
    "a.tif": lambda path: tifffile.imwrite(path, STACK, photometric="minisblack"),
    "b.tif": lambda path: tifffile.imwrite(path, STACK, photometric="minisblack", compression="zlib"),
    "a.npy": lambda path: np.save(path, STACK),
}


def test_file_by_scan_order(tmp_path: Path) -> None:
    for name, write in STACKS.items():
        write(tmp_path / name)
        with open_frames(tmp_path / name, order="serpentine", plan_shape=PLAN) as source:
            assert_session(source)
            assert source.info(3).label == f"{name} page 3"
        with pytest.raises(InputError, match="expected 20 for a scan of 2 x 2 x 5, got 24"):
            open_frames(tmp_path / name, order="serpentine", plan_shape=(2, 2, 5))


def test_a_stack_that_stopped_early_is_used(tmp_path: Path) -> None:
    """Its frames are the first of the scan, and the numbers are said (waveorder#7, tifffile#186)."""
    np.save(tmp_path / "a.npy", STACK[:-5])
    with open_frames(tmp_path / "a.npy", order="serpentine", plan_shape=PLAN) as source:
        assert len(source) == 19
        words = "frames: 19 for 24 positions; they are taken as the first 19 of a scan that stopped early"
        assert source.metadata.notes == (words,)
        for k in range(19):
            np.testing.assert_array_equal(source.read(k), FRAMES[tuple(source.info(k).position)])


def test_five_axes_and_tables_need_no_order(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", FRAMES)
    assert_session(open_frames(tmp_path / "a.npy"))
    positions = np.array(scan_positions(PLAN, "serpentine"))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"] = STACK
        file["positions"] = positions
        file["exposure_s"] = np.full(24, 0.5)
        file["five"] = FRAMES
    with open_frames(tmp_path / "a.h5") as source:
        assert_session(source)
        assert source.info(23).exposure_s == 0.5
    with open_frames(tmp_path / "a.h5", dataset="five") as source:
        assert_session(source)
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["positions"][2, 1] = -1
    with pytest.raises(FileFormatError, match="positions: expected whole numbers from 0"):
        open_frames(tmp_path / "a.h5")


def test_files_are_released(tmp_path: Path) -> None:
    STACKS["b.tif"](tmp_path / "b.tif")
    source = open_frames(tmp_path / "b.tif", order="raster", plan_shape=PLAN)
    source.read(0)
    del source
    gc.collect()  # an unclosed file would be a warning, and so an error
    source = open_frames(tmp_path / "b.tif", order="raster", plan_shape=PLAN)
    source.close()
    source.close()
    with pytest.raises(InputError, match="the folder of frames is closed"):
        source.read(0)


def test_raw_frames_bring_their_mosaic(tmp_path: Path) -> None:
    frames = session((2, 40, 60), top=1000)
    for x in range(2):
        write_dng(tmp_path / f"y0_x{x}.dng", frames[x])
    source = open_frames(tmp_path, pattern="y{y}_x{x}.dng")
    assert source.metadata.cfa == "GRBG" and source.metadata.saturation == 1023
    np.testing.assert_array_equal(source.read(1), frames[1])
    write_dng(tmp_path / "y0_x1.dng", frames[1], (0, 1, 1, 2))
    source = open_frames(tmp_path, pattern="y{y}_x{x}.dng")
    with pytest.raises(FileFormatError, match=r"y0_x1\.dng, colour filter: expected GRBG, got RGGB; correct its"):
        source.read(1)
    expected = Manifest(source.manifest.entries, cfa="BGGR")
    with pytest.raises(FileFormatError, match=r"y0_x0\.dng, colour filter: expected BGGR, got GRBG"):
        open_frames(tmp_path, manifest=expected)
    # a tag that exchanges greens for red and blue
    scene = np.random.default_rng(2).integers(200, 250, (40, 60)).astype(np.uint16)
    scene[0::2, 1::2] *= 3  # red, of GRBG
    write_dng(tmp_path / "y0_x0.dng", scene)
    assert open_frames(tmp_path, pattern="y{y}_x{x}.dng").metadata.cfa == "GRBG"
    write_dng(tmp_path / "y0_x0.dng", scene, (0, 1, 1, 2))
    with pytest.raises(FileFormatError, match=r"y0_x0\.dng, green pixels of RGGB: .* correct the Bayer tag"):
        open_frames(tmp_path, pattern="y{y}_x{x}.dng")


# -- what is wrong with single frames shows when they are read ---------------------------------------------

Damage = Callable[[Path], object]


def _write(path: Path, frame: np.ndarray) -> None:
    tifffile.imwrite(path, frame, photometric="minisblack")


BLANK = np.zeros((20, 30), np.uint16)
FIRST = FRAMES[0, 0, 0]
BAD_FRAMES: dict[str, tuple[Damage, str]] = {
    "another shape": (lambda p: _write(p, FIRST[:-1]), "a1.tif, size: expected 20 x 30 px, got 19 x 30 px"),
    "rows and columns swapped": (lambda p: _write(p, FIRST.T), "size: expected 20 x 30 px, got 30 x 20 px"),
    "8 bits": (lambda p: _write(p, FIRST.astype(np.uint8)), "a1.tif, samples: expected uint16, got uint8"),
    "floats": (lambda p: _write(p, FIRST.astype(np.float32)), "samples: expected uint16, got float32"),
    "all zero": (lambda p: _write(p, BLANK), "a1.tif, (z, y, x) = (0, 0, 1): expected an image"),
    "all saturated": (lambda p: _write(p, BLANK + np.uint16(4095)), "the value 4095 in every pixel"),
    "more bits": (lambda p: _write(p, FIRST * 16), "(z, y, x) = (0, 0, 1): expected values below 4096"),
    "removed": (lambda p: p.unlink(), "a1.tif, (z, y, x) = (0, 0, 1): No such file"),
    "cut short": (lambda p: p.write_bytes(p.read_bytes()[:-9]), "(z, y, x) = (0, 0, 1): expected an intact TIFF file"),
}


def test_bad_frame_is_named_and_others_can_be_read(tmp_path: Path) -> None:
    entries = tuple(FrameEntry(f"a{k}.tif", Position(0, 0, k)) for k in range(3))
    for damage, words in BAD_FRAMES.values():
        for k in range(3):
            _write(tmp_path / f"a{k}.tif", FRAMES[0, 0, k])
        source = open_frames(tmp_path, manifest=Manifest(entries, bit_depth=12))
        assert source.metadata.saturation == 4095
        damage(tmp_path / "a1.tif")
        with pytest.raises(LfcalError) as caught:
            source.read(1)
        assert words in str(caught.value) and "\n" not in str(caught.value)
        np.testing.assert_array_equal(source.read(2), FRAMES[0, 0, 2])
    _write(tmp_path / "a.tif", FRAMES[0, 0])
    pages = Manifest(tuple(FrameEntry("a.tif", Position(0, 0, k), k) for k in range(6)))
    with open_frames(tmp_path, manifest=pages) as source:
        with pytest.raises(FileFormatError, match="expected page 5, got 4 pages"):
            source.read(5)
    _write(tmp_path / "y0_x0.tif", BLANK)
    assert open_frames(tmp_path, pattern="y{y}_x{x}.tif", blank="accept").read(0).max() == 0


def test_nan_is_refused_or_masked(tmp_path: Path) -> None:
    frame = FRAMES[0, 0, 0].astype(np.float32)
    frame[3, 4], frame[5, 6] = np.nan, -np.inf
    tifffile.imwrite(tmp_path / "y0_x0.tif", frame)
    source = open_frames(tmp_path, pattern="y{y}_x{x}.tif", nan="refuse")
    with pytest.raises(FileFormatError, match=r"y0_x0\.tif, \(.*\): expected finite values, got 2 NaN or infinite"):
        source.read(0)
    with pytest.raises(FileFormatError, match="got 1 NaN"):
        source.read(0, (slice(0, 4), slice(0, 10)))
    found = open_frames(tmp_path, pattern="y{y}_x{x}.tif", nan="mask").samples(0)
    assert found.valid is not None and np.argwhere(~found.valid).tolist() == [[3, 4], [5, 6]]
    assert np.array_equal(found.values[found.valid], frame[found.valid])
    around = [frame[r, c] for r in (2, 3, 4) for c in (3, 4, 5) if (r, c) != (3, 4)]
    assert min(around) <= found.values[3, 4] <= max(around)


def test_pixels_that_never_have_a_value_are_masked(tmp_path: Path) -> None:
    """Dead pixels and the border of a registration are NaN in every frame (hexrdgui#1753, corgidrp#892)."""
    frames = np.array([FRAMES[0, 0, k] for k in range(3)], np.float32)
    frames[:, :, -6:], frames[:, 3, 4] = np.nan, np.inf
    for k, frame in enumerate(frames):
        _write(tmp_path / f"y0_x{k}.tif", frame)
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        (note,) = source.metadata.notes
        assert note == f"masked: {frames.shape[1] * 6 + 1} pixels without a finite value in any frame"
        for k in range(3):
            found, mask = source.samples(k), source.info(k).mask
            assert mask is not None and np.array_equal(mask, np.isfinite(frames[k]))
            assert found.valid is not None and np.array_equal(found.valid, mask)
            assert np.isfinite(found.values).all() and np.array_equal(found.values[mask], frames[k][mask])
    frames[1, 7, 7] = np.nan
    tifffile.imwrite(tmp_path / "y0_x1.tif", frames[1])
    with open_frames(tmp_path, pattern="y{y}_x{x}.tif") as source:
        source.read(0)
        with pytest.raises(FileFormatError, match=r"y0_x1\.tif.*got 1 NaN or infinite; .*--nan mask"):
            source.read(1)
    with pytest.raises(FileFormatError, match="NaN"):
        open_frames(tmp_path, pattern="y{y}_x{x}.tif", nan="refuse").read(0)


def test_the_orientation_of_a_dng_is_left_alone(tmp_path: Path) -> None:
    """It says how a picture is to be held; the mosaic, its pattern and its levels stay as the sensor has them."""
    mosaic = np.random.default_rng(1).integers(64, 1000, (40, 48)).astype(np.uint16)
    write_dng(tmp_path / "plain.dng", mosaic)
    plain = open_image(tmp_path / "plain.dng")
    for orientation in (3, 6, 8):
        write_dng(tmp_path / "turned.dng", mosaic, orientation=orientation)
        turned = open_image(tmp_path / "turned.dng")
        np.testing.assert_array_equal(turned.read(), mosaic)
        assert dict(turned.metadata) == dict(plain.metadata)
        assert turned.metadata["black_level"] == (64.0,) * 4 and turned.metadata["saturation"] == 1023


# -- what cannot be opened ------------------------------------------------------------------------------------

TWO_WAYS = {"order": "raster", "pattern": NAMES, "plan_shape": PLAN}
CANNOT: list[tuple[dict[str, Any], str]] = [
    ({"order": "raster"}, "expected a manifest, a name pattern, or a scan order"),
    (TWO_WAYS, "one source of them, got pattern and order"),
    ({"order": "spiral", "plan_shape": PLAN}, "scan order: expected serpentine or raster"),
    ({"pattern": "a{y}_{x}.png"}, "files: expected names like 'a{y}_{x}.png', got 'z0_y0_x0.png'"),
    ({"pattern": NAMES, "plan_shape": (1, 3, 4)}, "z of z1_y0_x0.png page 0: expected 0 … 0, got 1"),
    ({"order": "raster", "plan_shape": (2, 3, 5)}, "frames: expected 30 for a scan of 2 x 3 x 5, got 24"),
    ({"pattern": NAMES, "nan": "ignore"}, "NaN in frames: expected auto, mask or refuse"),
    ({"pattern": NAMES, "colour": "r"}, "colour: expected R, G or B"),
]


def test_options_that_open_nothing_are_refused(tmp_path: Path) -> None:
    names = write_pngs(tmp_path, FRAMES)
    for options, words in CANNOT:
        with pytest.raises(InputError) as caught:
            open_frames(tmp_path, **options)
        assert words in str(caught.value) and "\n" not in str(caught.value)
    manifest = Manifest((FrameEntry(names[0], Position(0, 0, 0)),), plan_shape=PLAN)
    with pytest.raises(InputError, match=r"scan shape: expected \(2, 3, 4\) as in the manifest"):
        open_frames(tmp_path, manifest=manifest, plan_shape=(3, 3, 4))
    write_manifest(tmp_path / "manifest.json", manifest)
    (tmp_path / "manifest.csv").write_text("file,z,y,x\n")
    with pytest.raises(InputError, match=r"expected one, got manifest\.json and manifest\.csv"):
        open_frames(tmp_path)


def test_files_that_are_outside_the_session_or_missing_are_refused(tmp_path: Path) -> None:
    root = tmp_path / "session"
    root.mkdir()
    names = write_pngs(tmp_path, FRAMES)
    (root / names[0]).symlink_to(tmp_path / names[0])
    with pytest.raises(UnsafeFileError, match="a path inside"):
        open_frames(root, pattern=NAMES)
    (root / "manifest.csv").write_text(f"file,z,y,x\n../{names[0]},0,0,0\n")
    with pytest.raises(UnsafeFileError, match="got one outside"):
        open_frames(root)
    (tmp_path / "manifest.csv").write_text(f"file,z,y,x\n{names[0]},0,0,0\nabsent.png,0,0,1\n")
    with pytest.raises(StorageError, match=r"absent\.png: no such file"):
        open_frames(tmp_path)
    with pytest.raises(StorageError, match="no such file or folder"):
        open_frames(tmp_path / "elsewhere")


def test_an_ndtiff_without_an_index_is_read_in_order(tmp_path: Path) -> None:
    """Micro-manager#1784: the files are there, and the index is empty."""
    _write(tmp_path / "b_NDTiffStack.tif", FRAMES[0, 0])
    (tmp_path / "NDTiff.index").write_bytes(b"")
    with pytest.raises(InputError, match="an NDTiff index, got an empty one; state the order"):
        open_frames(tmp_path)
    with open_frames(tmp_path, order="raster", plan_shape=(1, 1, 4)) as frames:
        np.testing.assert_array_equal(frames.read(2), FRAMES[0, 0, 2])


# -- times of recording ------------------------------------------------------------------------------------------------


PAGE = np.arange(400, dtype=np.uint16).reshape(20, 20)


def test_pages_state_their_times(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for minute in (1, 2):
            file.write(PAGE, datetime=f"2026:05:01 10:0{minute}:00", metadata=None)
    with open_unplaced(tmp_path / "a.tif") as source:
        found = recorded_times(source)
    assert [f"{one:%Y-%m-%d %H:%M}" for one in found if one] == ["2026-05-01 10:01", "2026-05-01 10:02"]


def test_files_without_times_have_those_of_the_system(tmp_path: Path) -> None:
    for k in range(2):
        tifffile.imwrite(tmp_path / f"{k}.tif", PAGE, datetime="2026:05:01 10:00:00" if k else None)
        os.utime(tmp_path / f"{k}.tif", (1e9 + k, 1e9 + k))
    with open_unplaced(tmp_path) as source:
        assert recorded_times(source) == [datetime.fromtimestamp(1e9 + k, UTC) for k in range(2)]
    tifffile.imwrite(tmp_path / "0.tif", np.stack([PAGE, PAGE + 1]))
    with open_unplaced(tmp_path) as source:
        assert recorded_times(source) == [None, None, None]
