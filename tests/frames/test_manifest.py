"""Manifests: read, written, and never trusted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.frames import FrameEntry, Manifest, Position, read_manifest, write_manifest
from lfcal.frames.manifest import resolve_inside

ENTRIES = (
    FrameEntry("a/b 1.tif", Position(0, 1, 2), 3, 0.02, -0.25, 0.125),
    FrameEntry("ü.tif", Position(1, 0, 0)),
)


@pytest.mark.parametrize("suffix", ["csv", "json"])
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    write_manifest(tmp_path / f"m.{suffix}", Manifest(ENTRIES))
    assert read_manifest(tmp_path / f"m.{suffix}") == Manifest(ENTRIES)
    assert len(list(tmp_path.iterdir())) == 1


def test_json_holds_what_frames_must_be(tmp_path: Path) -> None:
    manifest = Manifest(ENTRIES, (2, 2, 3), (20, 30), "uint16", 12, "GRBG")
    write_manifest(tmp_path / "m.json", manifest)
    assert read_manifest(tmp_path / "m.json") == manifest
    with pytest.raises(InputError, match=r"name it \.json"):
        write_manifest(tmp_path / "m.csv", manifest)
    assert not (tmp_path / "m.csv").exists()


def test_plain_csv(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_bytes(
        b"\xef\xbb\xbffile, z, y, x, exposure_s\r\na.png, 0, 1, 2,\r\n\r\nb.png,0,1,3,0.5\r\n"
    )
    first, second = read_manifest(tmp_path / "m.csv").entries
    assert first == FrameEntry("a.png", Position(0, 1, 2))
    assert second == FrameEntry("b.png", Position(0, 1, 3), exposure_s=0.5)


def test_plain_json_list(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text('[{"file": "a.png", "z": 0, "y": 1, "x": 2}]')
    assert read_manifest(tmp_path / "m.json").entries == (FrameEntry("a.png", Position(0, 1, 2)),)


def test_coverage_tells_missing_and_repeated_positions() -> None:
    places = [(0, 0, 0), (0, 0, 2), (0, 1, 1), (0, 1, 1)]
    manifest = Manifest(tuple(FrameEntry(f"{k}.png", Position(*p)) for k, p in enumerate(places)))
    missing, several = manifest.coverage()
    assert missing == ((0, 0, 1), (0, 1, 0), (0, 1, 2))
    assert several == ((0, 1, 1),)


BAD_CSV = {
    "no column x": ("file,z,y\na.png,0,0\n", "m.csv line 2: expected columns file, page, z, y, x"),
    "unknown column": ("file,z,y,x,exposure\na.png,0,0,0,1\n", "unknown 'exposure'"),
    "not a number": ("file,z,y,x\na.png,0,0,two\n", "m.csv line 2, x: expected a whole number, got 'two'"),
    "half a step": ("file,z,y,x\na.png,0,0,1.5\n", "m.csv line 2, x: expected a whole number, got '1.5'"),
    "negative": ("file,z,y,x\na.png,0,0,-1\n", "m.csv line 2: x of a.png: expected a whole number ≥ 0"),
    "NaN drift": ("file,z,y,x,dy\na.png,0,0,1,nan\n", "m.csv line 2, dy: expected a number, got 'nan'"),
    "no exposure": (
        "file,z,y,x,exposure_s\na.png,0,0,1,0\n",
        "m.csv line 2: exposure_s of a.png: expected a number ≥ 1e-12 and ≤ 1e+09",
    ),
    "surplus value": ("file,z,y,x\na.png,0,0,1,7,8\n", "unknown 'surplus values'"),
    "empty": ("", "frames of the session: expected at least one, got none"),
    "page listed twice": ("file,z,y,x\na.png,0,0,1\na.png,0,0,2\n", "a.png page 0: expected one position, got several"),
    "missing value": ("file,z,y,x\na.png,0,0,\n", "m.csv line 2: expected columns file, page, z, y, x"),
}


@pytest.mark.parametrize("kind", BAD_CSV)
def test_bad_csv(tmp_path: Path, kind: str) -> None:
    text, words = BAD_CSV[kind]
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_manifest(tmp_path / "m.csv")
    assert words in str(caught.value) and "\n" not in str(caught.value)


FRAMES: list[dict[str, Any]] = [{"file": "a.png", "z": 0, "y": 1, "x": 2}]
BAD_JSON: dict[str, tuple[Any, str]] = {
    "a number": (7, "a list of objects"),
    "frames of another kind": ({"frames": [1, 2]}, "a list of objects"),
    "another format": ({"format": "other", "frames": FRAMES}, "lfcal-manifest version 1, got 'other'"),
    "a later version": ({"version": 2, "frames": FRAMES}, "version 2"),
    "unknown entry": ({"frames": FRAMES, "shapes": [1, 2]}, "got 'shapes'"),
    "frame shape": ({"frames": FRAMES, "shape": [1, 2, 3]}, "frame shape: expected (rows, columns)"),
    "plan shape": ({"frames": FRAMES, "plan_shape": 7}, "scan"),
    "position outside": ({"frames": FRAMES, "plan_shape": [1, 2, 2]}, "x of a.png page 0: expected 0 … 1, got 2"),
    "dtype": ({"frames": FRAMES, "dtype": "object"}, "frame dtype"),
    "bit depth": ({"frames": FRAMES, "bit_depth": 99}, "bit depth"),
    "colour filter": ({"frames": FRAMES, "cfa": "GRB"}, "colour filter pattern"),
    "colour filter as number": ({"frames": FRAMES, "cfa": 12}, "colour filter pattern"),
    "boolean": ({"frames": [{**FRAMES[0], "x": True}]}, "x: expected a whole number"),
}


@pytest.mark.parametrize("kind", BAD_JSON)
def test_bad_json(tmp_path: Path, kind: str) -> None:
    body, words = BAD_JSON[kind]
    (tmp_path / "m.json").write_text(json.dumps(body))
    with pytest.raises(InputError) as caught:
        read_manifest(tmp_path / "m.json")
    assert words in str(caught.value) and "m.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("data", [b"{", b"\xff\xfe\x00", b"[" * 100_000, b'{"frames": NaN}'])
def test_damaged_json(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "m.json").write_bytes(data)
    with pytest.raises(FileFormatError, match=r"m\.json"):
        read_manifest(tmp_path / "m.json")


def test_other_name_and_missing_file(tmp_path: Path) -> None:
    (tmp_path / "m.txt").write_text("file,z,y,x\n")
    with pytest.raises(FileFormatError, match=r"a \.csv or \.json manifest"):
        read_manifest(tmp_path / "m.txt")
    with pytest.raises(StorageError, match="No such file"):
        read_manifest(tmp_path / "m.csv")
    with pytest.raises(InputError, match=r"ending in \.csv or \.json"):
        write_manifest(tmp_path / "m.txt", Manifest(ENTRIES))


@pytest.mark.parametrize("name", ["/etc/passwd", "../a.png", "b/../../a.png", "C:/a.png"])
def test_path_that_leads_out_is_refused_at_once(name: str) -> None:
    with pytest.raises(UnsafeFileError, match="got one outside"):
        FrameEntry(name, Position(0, 0, 0))


@pytest.mark.parametrize("name", ["", "a\\b.png", "a\0b.png"])
def test_unusable_path(name: str) -> None:
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
    (root / "inner").mkdir()
    for name in ("loop.png", "absent.png", "inner", "absent/a.png"):
        with pytest.raises(StorageError, match=name):
            resolve_inside(root, [name])


def test_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file is a file; check the path"):
        write_manifest(tmp_path / "file" / "m.csv", Manifest(ENTRIES))
    with pytest.raises(StorageError, match="is a folder; give the path of a file"):
        (tmp_path / "m.csv").mkdir()
        write_manifest(tmp_path / "m.csv", Manifest(ENTRIES))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "m.csv"]


def test_a_wrong_number_of_frames_is_told_beside_the_scan() -> None:
    with pytest.raises(InputError, match="24 for a scan of 2 x 3 x 4"):
        Manifest.from_order([("a.tif", 0)], (2, 3, 4), "raster")
