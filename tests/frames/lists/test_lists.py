"""Lists of other programs, and stage coordinates that OME-TIFF and Micro-Manager keep with the frames."""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe, Position, corrected_view, open_frames
from lfcal.frames.formats._ome import ome_facts
from lfcal.frames.lists.entries import located, manifest_of
from lfcal.frames.lists.list_file import any_listing, read_micromanager
from lfcal.frames.lists.listing import Listing, read_listing
from lfcal.frames.lists.table import Table, find_columns, parse_columns, read_table
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, small_camera, write_frames
from tests.frames.scenes import session, write_pngs

PLACES = np.array([[10.5, -2.25, 0.125], [11.5, -2.25, 0.125], [10.5, -1.25, 1000.0]])


def written(path: Path, separator: str, decimal: str, header: str, *, bom: bool = False, end: str = "\n") -> Path:
    rows = [header.replace(",", separator)] if header else []
    for k, place in enumerate(PLACES):
        numbers = [f"{value:.3f}".replace(".", decimal) for value in place]
        rows.append(separator.join([f"img_{k}.tif", *numbers]))
    path.write_bytes((b"\xef\xbb\xbf" if bom else b"") + (end.join(rows) + end).encode())
    return path


FORMS = [
    *((",", ".", "comma"), (";", ",", "semicolon"), (";", ".", "semicolon"), ("\t", ".", "tab")),
    *(("\t", ",", "tab"), ("  ", ".", "blanks"), ("|", ".", "bar")),
]


def test_separators_and_decimal_signs(tmp_path: Path) -> None:
    for (separator, decimal, words), bom in product(FORMS, (False, True)):
        end = "\r\n" if bom else "\n"
        path = written(tmp_path / "a.txt", separator, decimal, "Name,PosX,PosY,PosZ", bom=bom, end=end)
        found = read_listing(path)
        np.testing.assert_array_equal(found.places, PLACES)
        assert found.files == ("img_0.tif", "img_1.tif", "img_2.tif") and found.unit == ""
        assert found.notes[0].startswith(f"columns: file=Name, z=PosZ, y=PosY, x=PosX; separated by {words}")


def test_comments_the_line_of_spreadsheets_and_quotes(tmp_path: Path) -> None:
    text = 'sep=;\n# made by hand\nFile;"X (mm)";"Y [mm]"\n\n"a; b.tif";1,5;2\n'
    (tmp_path / "a.csv").write_text(text)
    found = read_listing(tmp_path / "a.csv")
    assert found.files == ("a; b.tif",) and found.unit == "um" and not found.has_depth
    np.testing.assert_array_equal(found.places[0, :2], [1500, 2000])


HEADERS: dict[str, tuple[str, float]] = {
    "filename,stage_x,stage_y,stage_z": ("", 1.0),
    "Bild,X (um),Y (um),Z (um)": ("um", 1.0),
    "Image Name,x_mm,y_mm,z_mm": ("um", 1e3),
    "path,XPositionUm,YPositionUm,ZPositionUm": ("um", 1.0),
    "FileName,PosX[µm],PosY[µm],PosZ[µm]": ("um", 1.0),
    "file path,Stage X /mm,Stage Y /mm,depth (mm)": ("um", 1e3),
}


def test_names_of_columns_are_understood_or_stated(tmp_path: Path) -> None:
    for header, (unit, scale) in HEADERS.items():
        found = read_listing(written(tmp_path / "a.csv", ",", ".", header))
        assert found.unit == unit, header
        np.testing.assert_allclose(found.places, PLACES * scale)
    path = written(tmp_path / "a.csv", ",", ".", "A,B,C,D")
    np.testing.assert_allclose(read_listing(path, "file=a,x_mm=B,y_mm=c,z_mm=4").places, PLACES * 1e3)
    headless = read_listing(written(tmp_path / "b.csv", ";", ",", ""), "file=1,x_um=2,y_um=3")
    np.testing.assert_array_equal(headless.places[:, :2], PLACES[:, :2])


def test_exposures_have_the_unit_that_their_column_states(tmp_path: Path) -> None:
    for name, value, seconds in (
        *(("exposure_ms", "20", 0.02), ("Exposure (s)", "0.5", 0.5), ("exposure_us", "700", 0.0007)),
        *(("Exp", "20", 0.02), ("ExposureTime", "0.02", 0.02)),
    ):
        (tmp_path / "a.csv").write_text(f"file,x_um,y_um,{name}\na.tif,1.5,2,{value}\n")
        found = read_listing(tmp_path / "a.csv")
        assert found.exposures == pytest.approx((seconds,))
        assert "_" in name or "(" in name or "taken as" in found.notes[0]


TIMES = "ExposureTime: expected a unit, because the times are large, got 20000 without a unit; state the unit in the"
BAD: list[tuple[str, str, str]] = [
    ("file,PosX,x_stage,y\na,1.5,2,3\n", "", "column of x: expected one, got 'PosX' or 'x_stage'; state"),
    ("A,x,y\nb,1.5,2\n", "", "column of file: expected a name such as"),
    ("A,B,y\nb,1.5,2\n", "", "got columns A, B, y; state the column (--columns file=COLUMN,x=COLUMN)"),
    ("A,x,y\nb,1.5,2\n", "file=B", "expected one of A, x, y, got 'B'"),
    ("A,x,y\nb,1.5,2\n", "name=A", "--columns: expected ROLE=COLUMN"),
    ("A,x,y\nb,1.5,2\n", "x=x,x=y", "each of file, page, z, y, x, exposure, dy, dx at most once"),
    ("A,x,y\nb,1.5,2\n", "x_ms=x", "--columns: expected ROLE=COLUMN"),
    ("file,x,y\na,1.5\n", "", "a.csv line 2: expected 3 cells, got 2"),
    ("file,x,y\na,1,5,2,5\n", "", "separate the columns by semicolons"),
    ("file;x;y\na;1,5;2.5\n", "", "a point or a comma throughout, got 1,5 and 2.5"),
    ("file,x,x\na,1,2\n", "", "unique column names, got 'x' twice"),
    ("file,x_um,y_um\na,here,2\n", "", "a.csv line 2, x_um: expected a number, got 'here'"),
    ("file,x_um,y_um\na,inf,2\n", "", "expected a number, got 'inf'"),
    ("file,x_um,PosY\na,1.5,2\n", "", "unit of PosY: expected that of the other axes"),
    ("file,x_um,y_index\na,1.5,2\n", "", "expected position numbers throughout, or lengths"),
    ("file,x_index,y_index,z_mm\na,1,2,0.5\n", "", "--columns y_index=…,x_index=…,z_index=…"),
    ("file,x_um,y_um,plane\na,1.5,2,0.5\n", "", "line 2, plane: expected a plane number, counted from 0"),
    ("file,x_um,y_um,plane\na,1.5,2,2\n", "", "from 0 or 1, got 2; correct it, or state that it is a le"),
    ("file,x_um,y_um,exposure_s\na,1,2,0\n", "", "line 2, exposure_s: expected a time above 0"),
    ("file,x_um,y_um,ExposureTime\na,1,2,20000\n", "", TIMES),
    ("file,x_um,y_um,exposure_s\na,1,2,20000\n", "", "at most 1000 s, got 20000 s; correct its unit (for exam"),
    ("file,x,y\n", "", "expected a row for each frame, got only a header"),
    ("# nothing\n", "", "a table with a row for each frame"),
    ("file,x_um,y_um\n,1,2\n", "", "line 2, file: expected the name of a file"),
]


def test_lists_that_are_wrong_give_one_line(tmp_path: Path) -> None:
    for text, columns, words in BAD:
        (tmp_path / "a.csv").write_text(text)
        with pytest.raises(InputError) as caught:
            read_listing(tmp_path / "a.csv", columns)
        assert words in str(caught.value) and "\n" not in str(caught.value)


def test_planes_may_be_counted_where_the_other_axes_are_lengths(tmp_path: Path) -> None:
    for header, unit, counted in (
        ("file,x_mm,y_mm,plane", "um", True),
        ("file,x,y,plane", "", True),
        ("file,x_um,y_um,z_index", "um", True),
        ("file,x_index,y_index,plane", "index", False),
    ):
        (tmp_path / "a.csv").write_text(f"{header}\na,1.5,-2,1\nb,2.5,-2,1\nc,1.5,-2,2\n")
        found = read_listing(tmp_path / "a.csv")
        assert (found.unit, found.counted) == (unit, counted) and found.places[:, 2].tolist() == [1, 1, 2]
        assert found.places[0, 0] == (1500 if "mm" in header else 1.5)
    (tmp_path / "a.csv").write_text("file,x,y,plane\na,0,0,1\nb,1,0,1\nc,0,0,2\n")
    assert read_listing(tmp_path / "a.csv").unit == "index"


def test_a_role_that_no_column_is_to_hold_is_not_found(tmp_path: Path) -> None:
    table = read_table(written(tmp_path / "a.csv", ",", ".", "file,x,y,z"))
    assert [str(c) for c in find_columns(table, parse_columns("z="))] == ["file=file", "y=y", "x=x"]
    assert [str(c) for c in find_columns(table, parse_columns("z=,page=4"))][1] == "page=z"
    with pytest.raises(InputError, match="column of file: expected a name such as"):
        find_columns(table, parse_columns("file="))


def test_other_columns_are_left_alone(tmp_path: Path) -> None:
    table = Table("t", ("time", "file", "x set", "y set", "temperature", "comment"), (), (), "tab")
    assert [str(c) for c in find_columns(table)] == ["file=file", "y=y set", "x=x set"]
    (tmp_path / "a.csv").write_text("a b c\n1 2 3\n")
    assert read_table(tmp_path / "a.csv").rows == (("1", "2", "3"),)
    assert parse_columns("y_index=Row, x=Col") == {"y": ("Row", "index"), "x": ("Col", "")}


# -- files -------------------------------------------------------------------------------------------------------


def listing(*files: str, unit: str = "index") -> Listing:
    places = np.array([[k, 0, np.nan] for k in range(len(files))], float)
    return Listing("list.csv", files, (0,) * len(files), places, unit)


def test_files_are_found_as_other_systems_write_them(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for suffix in ("tif", "txt"):
        (tmp_path / "a" / f"img_1.{suffix}").write_bytes(b"x")
    for name in (
        *("a/img_1.tif", r"a\img_1.tif", r"D:\scans\today\a\img_1.tif", "/home/me/a/img_1.tif"),
        *("./a/img_1.tif", "a/IMG_1.TIF", "a/img_1", r"C:a\img_1"),
    ):
        assert located(listing(name), tmp_path).files == ("a/img_1.tif",), name
    (tmp_path / "stack.tif").write_bytes(b"x")
    found = located(listing("stack.tif", "stack.tif"), tmp_path)
    assert found.pages == (0, 1) and "its rows are taken as its pages" in found.notes[-1]


def test_files_that_are_not_there_or_not_meant(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "out.tif").write_bytes(b"x")
    for name in ("../out.tif", "gone.tif", "/etc/passwd"):
        with pytest.raises(StorageError, match="is not in"):
            located(listing(name), tmp_path / "in")
    for suffix in ("tif", "png"):
        (tmp_path / "in" / f"b.{suffix}").write_bytes(b"x")
    with pytest.raises(StorageError, match=r"may be b\.(tif|png) or b\.(tif|png)"):
        located(listing("b"), tmp_path / "in")


# -- numbers of positions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [None, (1, 2, 3)])
def test_positions_counted_from_one(shape: tuple[int, int, int] | None) -> None:
    places = np.array([[x, y, np.nan] for y in (1, 2) for x in (1, 2, 3)], float)
    files = tuple(f"{k}.tif" for k in range(6))
    manifest, notes = manifest_of(Listing("l", files, (0,) * 6, places, "index"), plan_shape=shape)
    assert manifest.entries[-1].position == Position(0, 1, 2) and "counted from 1" in notes[-1]
    with pytest.raises(InputError, match="numbers from 1, got a smaller one"):
        manifest_of(Listing("l", files, (0,) * 6, places - [1, 1, 0], "index"), first=1)


def test_a_list_with_other_names_opens(tmp_path: Path) -> None:
    write_pngs(tmp_path, session((1, 2, 3, 20, 30)))
    rows = [f"z0_y{y}_x{x};{y + 1};{x + 1};20" for y in range(2) for x in range(3)]
    (tmp_path / "scan.csv").write_text("Bild;row;col;Exp\n" + "\n".join(rows))
    words = r"column of file: .*columns Bild, row, col, Exp; state .*--columns file=COLUMN"
    with pytest.raises(InputError, match=words):
        open_frames(tmp_path)
    source = open_frames(tmp_path, columns="file=Bild")
    assert source.info(5).position == Position(0, 1, 2) and source.info(5).exposure_s == pytest.approx(0.02)
    assert any("y=row (index)" in note for note in source.metadata.notes)
    with pytest.raises(InputError, match="stage coordinates: expected the plan of the scan"):
        open_frames(tmp_path, columns="file=Bild,y_um=row,x_um=col")
    (tmp_path / "other.tsv").write_text("x")
    with pytest.raises(InputError, match=r"one, got other\.tsv, scan\.csv"):
        open_frames(tmp_path)


# -- OME-TIFF ----------------------------------------------------------------------------------------------------------


def plan() -> ScanPlan:
    return ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), (-40e3, 10e3), START)


@pytest.fixture(scope="module")
def found() -> Scan:
    """Return a scan in an unusual order, with the stage reversed."""
    ordered = scan(right="-x", origin=(120.0, -40.0, 7.0))
    order = np.random.default_rng(5).permutation(len(ordered.stage))
    return Scan(ordered.camera, ordered.depths, ordered.positions[order], ordered.stage[order])


def write_ome(path: Path, found: Scan, exposure: tuple[float, str] = (20.0, "ms"), **pixels: Any) -> None:
    frames = np.stack([frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)])
    planes: dict[str, Any] = {f"Position{a}": (found.stage[:, k] / 1e3).tolist() for k, a in enumerate("XYZ")}
    planes |= {f"Position{a}Unit": ["mm"] * len(frames) for a in "XYZ"}
    planes |= {"ExposureTime": [exposure[0]] * len(frames), "ExposureTimeUnit": [exposure[1]] * len(frames)}
    tifffile.imwrite(path, frames, ome=True, metadata={"axes": "TYX", "Plane": planes, **pixels})


def test_an_ome_stack_says_where_each_page_belongs(tmp_path: Path, found: Scan) -> None:
    write_ome(tmp_path / "s.ome.tif", found, PhysicalSizeX=1.0, PhysicalSizeXUnit="µm")
    with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
        np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
        assert source.info(3).exposure_s == pytest.approx(0.02)
        notes = " ".join(source.metadata.notes)
        assert "-x,+y,+z move the image" in notes and "pixel size: 1 µm in the frames" in notes
        assert source.metadata.pixel_um == 1.0 and "stage_um" not in source.metadata.other
        np.testing.assert_array_equal(source.read(7), frame(found.positions[7, 1:], seed=7))
    assert any_listing(tmp_path / "s.ome.tif").exposures is not None


def test_exposures_that_are_implausible_are_left_out_and_known_pixel_sizes_not_remarked(
    tmp_path: Path, found: Scan
) -> None:
    """Cameras count microseconds, and programs write their number where the format means seconds."""
    path, camera = tmp_path / "s.ome.tif", found.camera
    write_ome(path, found, exposure=(20_000.0, "s"))
    read = any_listing(path)
    assert read.exposures is None and "20000 s in s.ome.tif is implausible" in read.notes[-1]
    write_ome(path, found, exposure=(20_000.0, "µs"))
    assert any_listing(path).exposures == pytest.approx((0.02,) * len(found.stage))
    for size in (camera.sensor.pixel_um, camera.step_um(0.0)):
        write_ome(path, found, PhysicalSizeX=size)
        with open_frames(path, plan=plan()) as source:
            assert not any(note.startswith("pixels") for note in source.metadata.notes)


OME = (
    '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image>'
    '<Pixels DimensionOrder="XYCZT" {}>{}</Pixels></Image></OME>'
)
PLANE = '<Plane TheC="0" TheZ="{}" TheT="{}" PositionX="{}" PositionY="0" {}/>'


NOTHING = [
    *("", "<OME", "<!DOCTYPE x [<!ENTITY a 'b'>]><OME/>", OME.format('PhysicalSizeX="-1"', "")),
    OME.format("", PLANE.format(0, "one", 1, "")),
    OME.format("", PLANE.format(0, 0, "nan", "") + PLANE.format(0, 1, 2, "")),
    OME.format("", PLANE.format(0, 0, 1, 'PositionXUnit="parsec"') + PLANE.format(0, 1, 2, "")),
    OME.format("", PLANE.format(0, 0, 1, "") + PLANE.format(0, 1, 1, "")),
    OME.format("", PLANE.format(0, 0, 1, "")),
]


def test_planes_are_put_in_the_order_of_the_pages_and_what_says_nothing_is_left_out() -> None:
    # listed by Z first, stored by T last: Z runs faster
    text = OME.format("", "".join(PLANE.format(z, t, 10 * t + z, "") for z in range(2) for t in range(3)))
    facts = ome_facts(text, 6)
    assert facts["stage_um"][:, 0].tolist() == [0, 1, 10, 11, 20, 21] and np.isnan(facts["stage_um"][:, 2]).all()
    assert "exposure_s" not in facts
    for text in NOTHING:
        assert ome_facts(text, 2) == {}, text


# -- Micro-Manager -----------------------------------------------------------------------------------------------


def metadata_of(found: Scan, names: list[str], version: int) -> dict[str, Any]:
    body: dict[str, Any] = {"Summary": {"PixelSize_um": 0.5, "Slices": 1}}
    common = {"Exposure-ms": 20.0, "PixelSizeUm": 0.5, "BitDepth": 12}
    for k, (name, (x, y, z)) in enumerate(zip(names, found.stage, strict=True)):
        key = f"FrameKey-{k}-0-0" if version == 1 else f"Metadata-Default/{name}"
        place = {"XPositionUm": x, "YPositionUm": y, "ZPositionUm": z}
        body[key] = {"FileName": name if version == 1 else f"Default/{name}", **place, **common}
    return body


@pytest.mark.parametrize("version", [1, 2])
def test_a_folder_of_micro_manager(tmp_path: Path, found: Scan, version: int) -> None:
    folder = tmp_path if version == 1 else tmp_path / "Default"
    names = [f"img_channel000_position000_time{k:09d}_z000.tif" for k in range(len(found.stage))]
    folder.mkdir(exist_ok=True)
    for k, (name, (_, y, x)) in enumerate(zip(names, found.positions, strict=True)):
        tifffile.imwrite(folder / name, frame((y, x), seed=k))
    (tmp_path / "metadata.txt").write_text(json.dumps(metadata_of(found, names, version)))
    source = open_frames(tmp_path, plan=plan())
    np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
    assert source.info(0).exposure_s == pytest.approx(0.02)
    assert source.metadata.saturation == 4095 and source.metadata.pixel_um == 0.5
    assert any("stage coordinates that Micro-Manager wrote" in note for note in source.metadata.notes)


def test_a_stack_of_micro_manager(tmp_path: Path, found: Scan) -> None:
    frames = np.stack([frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)])
    tifffile.imwrite(tmp_path / "scan_MMStack.ome.tif", frames, photometric="minisblack")
    body = metadata_of(found, ["scan_MMStack.ome.tif"] * len(frames), 1)
    (tmp_path / "scan_MMStack_metadata.txt").write_text(json.dumps(body))
    with open_frames(tmp_path, plan=plan()) as source:
        np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
        np.testing.assert_array_equal(source.read(5), frames[5])


@pytest.mark.parametrize("stacked", [False, True])
def test_channels_of_micro_manager(tmp_path: Path, found: Scan, stacked: bool) -> None:
    """A channel without light is the dark of the other one (micro-manager#910)."""
    count = len(found.stage)
    lit = [frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)]
    dark = [np.rint(np.random.default_rng(k).normal(100, 3, lit[0].shape)).astype(np.uint16) for k in range(count)]
    names = [f"img_{k}.tif" for k in range(2 * count)]
    both = [one for pair in zip(lit, dark, strict=True) for one in pair]
    if stacked:
        names = ["scan_MMStack.ome.tif"] * len(both)
        tifffile.imwrite(tmp_path / names[0], np.stack(both), photometric="minisblack")
    else:
        for name, values in zip(names, both, strict=True):
            tifffile.imwrite(tmp_path / name, values)
    twice = Scan(found.camera, found.depths, np.repeat(found.positions, 2, 0), np.repeat(found.stage, 2, 0))
    body = metadata_of(twice, names, 1)
    frames = [entry for key, entry in body.items() if key != "Summary"]
    for k, entry in enumerate(frames):
        entry["Channel"] = "Dark" if k % 2 else "Lamp"
    (tmp_path / "scan_metadata.txt").write_text(json.dumps(body))
    with open_frames(tmp_path, plan=plan()) as source:
        words = "channels: 'Lamp' is used, out of 'Lamp', 'Dark'; 'Dark' contains its dark frames"
        assert words in source.metadata.notes
        np.testing.assert_array_equal([source.info(k).position for k in range(count)], found.positions)
        np.testing.assert_array_equal(source.read(5), lit[5])
        assert list(source.metadata.darks) == [0.02]
        clean = corrected_view(source, CorrectionRecipe()).read(5)
        np.testing.assert_allclose(clean, lit[5] - np.mean(dark, 0), atol=0.01)
    with open_frames(tmp_path, plan=plan(), columns="channel=Dark") as source:
        np.testing.assert_array_equal(source.read(5), dark[5])
    for k, entry in enumerate(frames):
        entry["Channel"] = "Blue" if k % 2 else "Green"
    (tmp_path / "scan_metadata.txt").write_text(json.dumps(body))
    with pytest.raises(FileFormatError, match=r"got 'Green', 'Blue'; choose one in .*--columns 'channel=Green'"):
        open_frames(tmp_path, plan=plan())
    with pytest.raises(FileFormatError, match=r"expected one of 'Green', 'Blue', got 'green'; choose one"):
        open_frames(tmp_path, plan=plan(), columns="channel=green")


def test_files_without_metadata_or_places_are_refused(tmp_path: Path, found: Scan) -> None:
    path = tmp_path / "metadata.txt"
    for text in ("[]", "{}", '{"Summary": {}}', "{"):
        path.write_text(text)
        with pytest.raises(FileFormatError, match=r"metadata\.txt"):
            read_micromanager(path)
    body = metadata_of(found, ["a.tif"] * len(found.stage), 1)
    body["FrameKey-3-0-0"].pop("XPositionUm")
    path.write_text(json.dumps(body))
    with pytest.raises(FileFormatError, match=r"XPositionUm of a\.tif: expected a number, got None; record with"):
        open_frames(tmp_path, plan=plan())
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((8, 9), np.uint16))
    with pytest.raises(FileFormatError, match="stage coordinates of every page in its metadata, got none"):
        any_listing(tmp_path / "a.tif")


@pytest.mark.parametrize("form", ["x{0:+.2f}um_y{1:+.2f}um_z{2:+.2f}um", "f_z_{2:.3f}um x={0:.2f}um y={1:.2f}um"])
def test_places_in_the_names_of_files(tmp_path: Path, found: Scan, form: str) -> None:
    names = [f"{form.format(*place)}.tif" for place in found.stage]
    write_frames(tmp_path, found, names)
    with open_frames(tmp_path, plan=plan()) as source:
        assert any("stage coordinates in the file names" in note for note in source.metadata.notes)
        for k in range(len(source)):
            name = source.info(k).label
            assert tuple(source.info(k).position) == tuple(found.positions[names.index(name)])


def test_names_in_part_without_a_place_are_not_taken_for_places(tmp_path: Path, found: Scan) -> None:
    names = [f"x{place[0]:+.2f}um_y{place[1]:+.2f}um_z{place[2]:+.2f}um.tif" for place in found.stage]
    write_frames(tmp_path, found, ["other.tif", *names[1:]])
    with pytest.raises(LfcalError):
        open_frames(tmp_path, plan=plan())
