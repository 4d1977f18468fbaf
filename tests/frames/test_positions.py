"""Positions of frames: from scan orders, file names and manifests."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import (
    FrameEntry,
    Manifest,
    NamePattern,
    Position,
    open_frames,
    read_manifest,
    scan_positions,
    write_manifest,
)
from lfcal.frames.manifest import resolve_inside
from lfcal.frames.positions import guess_pattern, natural_key
from tests.frames.scenes import session, write_pngs

SMALL = st.integers(1, 5)


@given(SMALL, SMALL, SMALL, st.sampled_from(["serpentine", "raster"]))
@settings(derandomize=True, deadline=None)
def test_every_position_once_and_serpentine_moves_by_single_steps(nz: int, ny: int, nx: int, order: str) -> None:
    positions = scan_positions((nz, ny, nx), order)
    plan = ScanPlan(preset("bench"), (ny, nx), (3, 3), tuple(-1e4 * k for k in range(nz)), (8, 9), order=order)
    assert positions == [Position(*p) for p in plan.order_indices().tolist()], "as in the plan of the scan"
    assert sorted(positions) == [Position(*p) for p in np.ndindex(nz, ny, nx)]
    if order == "raster":
        assert positions == sorted(positions)
    else:
        moves = np.abs(np.diff(np.array(positions), axis=0)).sum(axis=1)
        assert (moves == 1).all()


@given(st.tuples(*[st.integers(0, 999)] * 3), st.integers(0, 99), st.integers(0, 1))
@settings(derandomize=True, deadline=None)
def test_names_round_trip(place: tuple[int, int, int], page: int, first: int) -> None:
    pattern = NamePattern("plane{z:03d}/y{y}_x{x:02d}_{page}.tif", first=first)
    assert pattern.parse(pattern.name(Position(*place), page)) == (Position(*place), page)


Z_Y_X = "z{z}_y{y}_x{x}.png"


def test_names_that_fit_a_pattern() -> None:
    for template, name, position in (
        (Z_Y_X, "z1_y02_x003.png", (1, 2, 3)),
        ("y{y}_x{x}.png", "y2_x3.png", (0, 2, 3)),
        ("*_y{y}_x{x}_*.tif", "run7_y2_x3_12h30.tif", (0, 2, 3)),
        ("z{z}/z{z}_y{y}_x{x}.png", "z4/z4_y2_x3.png", (4, 2, 3)),
        ("a+b(c)_{y}.{x}", "a+b(c)_5.6", (0, 5, 6)),
    ):
        assert NamePattern(template).parse(name) == (position, 0)
    for template, name in (
        *((Z_Y_X, "z1_y2_x3.tif"), (Z_Y_X, "z1_y2_x-3.png"), (Z_Y_X, "dir/z1_y2_x3.png")),
        *(("z{z}/z{z}_y{y}_x{x}.png", "z4/z5_y2_x3.png"), ("*_y{y}_x{x}.png", "a/b_y2_x3.png")),
    ):
        assert NamePattern(template).parse(name) is None
    # counted from one
    assert NamePattern("y{y}_x{x}.png", first=1).parse("y1_x4.png") == ((0, 0, 3), 0)
    with pytest.raises(InputError, match="numbers from 1, got 0"):
        NamePattern("y{y}_x{x}.png", first=1).parse("y0_x4.png")


def test_unusable_patterns_and_scan_shapes_are_refused() -> None:
    for template in ("", "z{z}.png", "/y{y}_x{x}.png", "../y{y}_x{x}.png", "y{y}\\x{x}.png", "y{y}_x{x}_{t}.png"):
        with pytest.raises(InputError, match="name pattern: expected"):
            NamePattern(template)
    for shape in ((2, 3), (0, 3, 4), (2, 3, 2.5), (10**5, 10**5, 10)):
        with pytest.raises(InputError, match=r"scan|positions"):
            scan_positions(shape)  # type: ignore[arg-type]


def test_natural_order() -> None:
    names = ["img10.png", "img2.png", "img1.png", "b.png", "2_1.png"]
    assert sorted(names, key=natural_key) == ["2_1.png", "b.png", "img1.png", "img2.png", "img10.png"]


SHAPE = (2, 3, 4)
ALL = list(product(range(2), range(3), range(4)))
FORMS = {
    "img_x{x}_y{y}_z{z}.tif": "img_x{x:03d}_y{y:03d}_z{z}.tif",
    "plane{z}/row-{y}_col-{x}.png": "plane{z}/row-{y}_col-{x}.png",
    "run7_Z{z}Y{y}X{x}.tiff": "run7_Z{z:02d}Y{y:02d}X{x:02d}.tiff",
    "z{z}r{y}c{x}.pgm": "z{z}r{y}c{x}.pgm",
}


def test_words_before_the_numbers_give_the_pattern() -> None:
    for template, written in FORMS.items():
        names = [written.format(z=z, y=y, x=x) for z, y, x in ALL]
        guess = guess_pattern(names, SHAPE)
        assert guess.certain and guess.templates == (template,)
        form = NamePattern(template)
        assert [form.parse(name)[0] for name in names] == [Position(*p) for p in ALL]  # type: ignore[index]


def test_numbers_without_words_are_told_apart_by_the_scan() -> None:
    names = [f"pos-{z:03d}-{y:03d}-{x:03d}.png" for z, y, x in ALL]
    orders = {SHAPE: "pos-{z}-{y}-{x}.png", (2, 4, 3): "pos-{z}-{x}-{y}.png", (4, 2, 3): "pos-{y}-{x}-{z}.png"}
    for shape, template in orders.items():
        assert guess_pattern(names, shape).templates == (template,)
    assert len(guess_pattern(names).templates) == 6 and not guess_pattern(names).certain
    assert guess_pattern(names, (5, 5, 5)).templates == ()
    square = [f"pos-{y}-{x}.png" for y, x in product(range(3), range(3))]
    assert guess_pattern(square, (1, 3, 3)).templates == ("pos-{y}-{x}.png", "pos-{x}-{y}.png")
    # one plane, and numbers that are constant
    names = [f"run12_z1_y{y}_x{x}.png" for y, x in product(range(3), range(4))]
    assert guess_pattern(names, (1, 3, 4)).templates == ("run12_z1_y{y}_x{x}.png",)
    assert guess_pattern(names, SHAPE).templates == ("run12_z{z}_y{y}_x{x}.png",)


def test_names_that_hold_no_position() -> None:
    for names in ([], ["dark.png"], ["a{1}_{2}.png", "a{2}_{2}.png"], ["a.png", "b.png"]):
        guess = guess_pattern(names, SHAPE)
        assert guess.templates == () and not guess.certain and guess.numbered == 0
    assert guess_pattern([f"img_{k:05d}.tif" for k in range(24)], SHAPE).numbered == 24


def test_what_a_folder_of_unclear_names_is_asked(tmp_path: Path) -> None:
    places = list(product(range(3), range(3)))
    names = write_pngs(tmp_path, session((1, 3, 3, 20, 30)))
    (tmp_path / "overview.png").write_bytes((tmp_path / names[0]).read_bytes())
    with pytest.raises(InputError, match=r"9 of 10 names that look like 'z0_y\{y\}_x\{x\}\.png'"):
        open_frames(tmp_path)
    (tmp_path / "overview.png").unlink()
    for name, (y, x) in zip(names, places, strict=True):
        (tmp_path / name).rename(tmp_path / f"pos-{y}-{x}.png")
    with pytest.raises(InputError, match=r"'pos-\{y\}-\{x\}\.png' or 'pos-\{x\}-\{y\}\.png'; give --pattern"):
        open_frames(tmp_path, plan_shape=(1, 3, 3))
    for k, path in enumerate(sorted(tmp_path.iterdir())):
        path.rename(tmp_path / f"frame{k:03d}.png")
    words = r"9 numbered files such as frame\d+\.png; give their list .* their order: --order serpentine"
    with pytest.raises(InputError, match=words):
        open_frames(tmp_path, plan_shape=(1, 3, 3))


def test_names_count_from_one_or_zero(tmp_path: Path) -> None:
    names = write_pngs(tmp_path, session((1, 2, 3, 20, 30)))
    for name in names:
        y, x = int(name[4]) + 1, int(name[7]) + 1
        (tmp_path / name).rename(tmp_path / f"y{y}x{x}.png")
    assert open_frames(tmp_path).info(5).position == Position(0, 1, 2)
    assert open_frames(tmp_path, first=0).info(5).position == Position(0, 2, 3)
    (tmp_path / "y1x1.png").unlink()
    assert open_frames(tmp_path, plan_shape=(1, 2, 3)).info(0).position == Position(0, 0, 1)
    # one number beyond the scan that starts at 1 fits: this is a scan from zero whose first rows are missing
    assert open_frames(tmp_path, plan_shape=(1, 4, 4)).info(0).position == Position(0, 1, 2)


# -- manifests ---------------------------------------------------------------------------------------------------------


ENTRIES = (
    FrameEntry("a/b 1.tif", Position(0, 1, 2), 3, 0.02, -0.25, 0.125),
    FrameEntry("ü.tif", Position(1, 0, 0)),
)


def test_manifests_round_trip(tmp_path: Path) -> None:
    for suffix in ("csv", "json"):
        write_manifest(tmp_path / f"m.{suffix}", Manifest(ENTRIES))
        assert read_manifest(tmp_path / f"m.{suffix}") == Manifest(ENTRIES)
    assert len(list(tmp_path.iterdir())) == 2
    # JSON states what frames must be as well
    manifest = Manifest(ENTRIES, (2, 2, 3), (20, 30), "uint16", 12, "GRBG")
    write_manifest(tmp_path / "m.json", manifest)
    assert read_manifest(tmp_path / "m.json") == manifest
    with pytest.raises(InputError, match=r"name it \.json"):
        write_manifest(tmp_path / "n.csv", manifest)
    assert not (tmp_path / "n.csv").exists()


def test_plain_lists_are_manifests(tmp_path: Path) -> None:
    text = b"\xef\xbb\xbffile, z, y, x, exposure_s\r\na.png, 0, 1, 2,\r\n\r\nb.png,0,1,3,0.5\r\n"
    (tmp_path / "m.csv").write_bytes(text)
    first, second = read_manifest(tmp_path / "m.csv").entries
    assert first == FrameEntry("a.png", Position(0, 1, 2))
    assert second == FrameEntry("b.png", Position(0, 1, 3), exposure_s=0.5)
    (tmp_path / "m.json").write_text('[{"file": "a.png", "z": 0, "y": 1, "x": 2}]')
    assert read_manifest(tmp_path / "m.json").entries == (first,)


def test_coverage_lists_missing_and_repeated_positions() -> None:
    places = [(0, 0, 0), (0, 0, 2), (0, 1, 1), (0, 1, 1)]
    manifest = Manifest(tuple(FrameEntry(f"{k}.png", Position(*p)) for k, p in enumerate(places)))
    missing, several = manifest.coverage()
    assert missing == ((0, 0, 1), (0, 1, 0), (0, 1, 2))
    assert several == ((0, 1, 1),)


BAD_CSV = {
    "file,z,y\na.png,0,0\n": "m.csv line 2: expected columns file, page, z, y, x",
    "file,z,y,x,exposure\na.png,0,0,0,1\n": "unknown 'exposure'",
    "file,z,y,x\na.png,0,0,two\n": "m.csv line 2, x: expected a whole number, got 'two'",
    "file,z,y,x\na.png,0,0,1.5\n": "m.csv line 2, x: expected a whole number, got '1.5'",
    "file,z,y,x\na.png,0,0,-1\n": "m.csv line 2: x of a.png: expected a whole number ≥ 0",
    "file,z,y,x,dy\na.png,0,0,1,nan\n": "m.csv line 2, dy: expected a number, got 'nan'",
    "file,z,y,x,exposure_s\na.png,0,0,1,0\n": "line 2: exposure_s of a.png: expected a number ≥ 1e-12 and ≤ 1e+09",
    "file,z,y,x\na.png,0,0,1,7,8\n": "unknown 'surplus values'",
    "": "frames of the session: expected at least one, got none",
    "file,z,y,x\na.png,0,0,1\na.png,0,0,2\n": "a.png page 0: expected one position, got several",
    "file,z,y,x\na.png,0,0,\n": "m.csv line 2: expected columns file, page, z, y, x",
}


FRAMES: list[dict[str, Any]] = [{"file": "a.png", "z": 0, "y": 1, "x": 2}]
BAD_JSON: list[tuple[Any, str]] = [
    (7, "a list of objects"),
    ({"frames": [1, 2]}, "a list of objects"),
    ({"format": "other", "frames": FRAMES}, "lfcal-manifest version 1, got 'other'"),
    ({"version": 2, "frames": FRAMES}, "version 2"),
    ({"frames": FRAMES, "shapes": [1, 2]}, "got 'shapes'"),
    ({"frames": FRAMES, "shape": [1, 2, 3]}, "frame shape: expected (rows, columns)"),
    ({"frames": FRAMES, "plan_shape": 7}, "scan"),
    ({"frames": FRAMES, "plan_shape": [1, 2, 2]}, "x of a.png page 0: expected 0 … 1, got 2"),
    ({"frames": FRAMES, "dtype": "object"}, "frame dtype"),
    ({"frames": FRAMES, "bit_depth": 99}, "bit depth"),
    ({"frames": FRAMES, "cfa": "GRB"}, "colour filter pattern"),
    ({"frames": FRAMES, "cfa": 12}, "colour filter pattern"),
    ({"frames": [{**FRAMES[0], "x": True}]}, "x: expected a whole number"),
]


def test_manifests_that_are_wrong_give_one_line(tmp_path: Path) -> None:
    bad = [("m.csv", text, words) for text, words in BAD_CSV.items()]
    bad += [("m.json", json.dumps(body), words) for body, words in BAD_JSON]
    for name, text, words in bad:
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError) as caught:
            read_manifest(tmp_path / name)
        message = str(caught.value)
        assert words in message and (name in message or name == "m.csv") and "\n" not in message, text
    for data in (b"{", b"\xff\xfe\x00", b"[" * 100_000, b'{"frames": NaN}'):
        (tmp_path / "m.json").write_bytes(data)
        with pytest.raises(FileFormatError, match=r"m\.json"):
            read_manifest(tmp_path / "m.json")
    with pytest.raises(InputError, match="24 for a scan of 2 x 3 x 4"):
        Manifest.from_order([("a.tif", 0)], (2, 3, 4), "raster")


def test_manifests_of_another_name_or_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    (tmp_path / "m.txt").write_text("file,z,y,x\n")
    with pytest.raises(FileFormatError, match=r"a \.csv or \.json manifest"):
        read_manifest(tmp_path / "m.txt")
    with pytest.raises(StorageError, match="No such file"):
        read_manifest(tmp_path / "m.csv")
    with pytest.raises(InputError, match=r"ending in \.csv or \.json"):
        write_manifest(tmp_path / "m.txt", Manifest(ENTRIES))
    with pytest.raises(StorageError, match=r"m\.txt is a file; check the path"):
        write_manifest(tmp_path / "m.txt" / "m.csv", Manifest(ENTRIES))
    (tmp_path / "m.csv").mkdir()
    with pytest.raises(StorageError, match="is a folder; give the path of a file"):
        write_manifest(tmp_path / "m.csv", Manifest(ENTRIES))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.csv", "m.txt"]


def test_paths_that_lead_out_or_cannot_be_are_refused_at_once() -> None:
    for name in ("/etc/passwd", "../a.png", "b/../../a.png", "C:/a.png"):
        with pytest.raises(UnsafeFileError, match="got one outside"):
            FrameEntry(name, Position(0, 0, 0))
    for name in ("", "a\\b.png", "a\0b.png"):
        with pytest.raises(InputError, match="file of a frame"):
            FrameEntry(name, Position(0, 0, 0))


def test_links_are_followed_before_paths_are_compared(tmp_path: Path) -> None:
    root, outside = tmp_path / "session", tmp_path / "outside"
    root.mkdir()
    outside.mkdir()
    (outside / "a.png").touch()
    (root / "real.png").touch()
    (root / "link.png").symlink_to(outside / "a.png")
    (root / "folder").symlink_to(outside)
    (root / "inside.png").symlink_to(root / "real.png")
    (root / "loop.png").symlink_to(root / "loop.png")
    (tmp_path / "alias").symlink_to(root)
    for name in ("link.png", "folder/a.png"):
        with pytest.raises(UnsafeFileError, match=f"file of a frame '{name}': expected a path inside"):
            resolve_inside(root, [name])
    assert resolve_inside(root, ["inside.png"]) == {"inside.png": root / "real.png"}
    assert resolve_inside(tmp_path / "alias", ["real.png"]) == {"real.png": root / "real.png"}
    content = tmp_path / ".git" / "annex" / "objects" / "a.png"  # as datalad keeps it (datalad/datalad#33)
    content.parent.mkdir(parents=True)
    content.touch()
    (root / "annexed.png").symlink_to(content)
    assert resolve_inside(root, ["annexed.png"]) == {"annexed.png": content}
    (root / "inner").mkdir()
    for name in ("loop.png", "absent.png", "inner", "absent/a.png"):
        with pytest.raises(StorageError, match=name):
            resolve_inside(root, [name])
