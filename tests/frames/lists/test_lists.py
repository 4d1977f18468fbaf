"""Lists of other programs: separators, decimal signs, names of columns, names of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError, StorageError
from lfcal.frames import Position, open_frames
from lfcal.frames.lists.entries import located, manifest_of
from lfcal.frames.lists.listing import Listing, read_listing
from lfcal.frames.lists.table import Table, find_columns, parse_columns, read_table
from tests.frames.scenes import session, write_pngs

PLACES = np.array([[10.5, -2.25, 0.125], [11.5, -2.25, 0.125], [10.5, -1.25, 1000.0]])


def written(path: Path, separator: str, decimal: str, header: str, *, bom: bool = False, end: str = "\n") -> Path:
    rows = [header.replace(",", separator)] if header else []
    for k, place in enumerate(PLACES):
        numbers = [f"{value:.3f}".replace(".", decimal) for value in place]
        rows.append(separator.join([f"img_{k}.tif", *numbers]))
    path.write_bytes((b"\xef\xbb\xbf" if bom else b"") + (end.join(rows) + end).encode())
    return path


FORMS = {
    "comma": (",", ".", "comma"),
    "semicolon and decimal comma": (";", ",", "semicolon"),
    "semicolon": (";", ".", "semicolon"),
    "tab": ("\t", ".", "tab"),
    "tab and decimal comma": ("\t", ",", "tab"),
    "blanks": ("  ", ".", "blanks"),
    "bar": ("|", ".", "bar"),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("bom", [False, True])
def test_separators_and_decimal_signs(tmp_path: Path, form: str, bom: bool) -> None:
    separator, decimal, words = FORMS[form]
    path = written(tmp_path / "a.txt", separator, decimal, "Name,PosX,PosY,PosZ", bom=bom, end="\r\n" if bom else "\n")
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


HEADERS = {
    "filename,stage_x,stage_y,stage_z": ("", None),
    "Bild,X (um),Y (um),Z (um)": ("um", 1.0),
    "image,X (um),Y (um),Z (um)": ("um", 1.0),
    "Image Name,x_mm,y_mm,z_mm": ("um", 1e3),
    "path,XPositionUm,YPositionUm,ZPositionUm": ("um", 1.0),
    "FileName,PosX[µm],PosY[µm],PosZ[µm]": ("um", 1.0),
    "file path,Stage X /mm,Stage Y /mm,depth (mm)": ("um", 1e3),
}


@pytest.mark.parametrize("header", HEADERS)
def test_names_of_columns(tmp_path: Path, header: str) -> None:
    unit, scale = HEADERS[header]
    found = read_listing(written(tmp_path / "a.csv", ",", ".", header))
    assert found.unit == unit
    np.testing.assert_allclose(found.places, PLACES * (scale or 1.0))


def test_columns_as_told(tmp_path: Path) -> None:
    header = "A,B,C,D"
    found = read_listing(written(tmp_path / "a.csv", ",", ".", header), "file=a,x_mm=B,y_mm=c,z_mm=4")
    np.testing.assert_allclose(found.places, PLACES * 1e3)
    headless = read_listing(written(tmp_path / "b.csv", ";", ",", ""), "file=1,x_um=2,y_um=3")
    np.testing.assert_array_equal(headless.places[:, :2], PLACES[:, :2])


@pytest.mark.parametrize(
    ("name", "value", "seconds"),
    [
        ("exposure_ms", "20", 0.02),
        ("Exposure (s)", "0.5", 0.5),
        ("Exp", "20", 0.02),
        ("ExposureTime", "0.02", 0.02),
        ("exposure_us", "700", 0.0007),
    ],
)
def test_exposures(tmp_path: Path, name: str, value: str, seconds: float) -> None:
    (tmp_path / "a.csv").write_text(f"file,x_um,y_um,{name}\na.tif,1.5,2,{value}\n")
    found = read_listing(tmp_path / "a.csv")
    assert found.exposures == pytest.approx((seconds,))
    assert "_" in name or "(" in name or "taken as" in found.notes[0]


BAD = {
    "two for x": ("file,PosX,x_stage,y\na,1.5,2,3\n", "", "column of x: expected one, got 'PosX' or 'x_stage'; state"),
    "no file": ("A,x,y\nb,1.5,2\n", "", "column of file: expected a name such as"),
    "what there is": ("A,B,y\nb,1.5,2\n", "", "got columns A, B, y; state the column (--columns file=COLUMN,x=COLUMN)"),
    "not a column": ("A,x,y\nb,1.5,2\n", "file=B", "expected one of A, x, y, got 'B'"),
    "no role": ("A,x,y\nb,1.5,2\n", "name=A", "--columns: expected ROLE=COLUMN"),
    "role twice": ("A,x,y\nb,1.5,2\n", "x=x,x=y", "each of file, page, z, y, x, exposure, dy, dx at most once"),
    "unit of time": ("A,x,y\nb,1.5,2\n", "x_ms=x", "--columns: expected ROLE=COLUMN"),
    "short row": ("file,x,y\na,1.5\n", "", "a.csv line 2: expected 3 cells, got 2"),
    "decimal commas": ("file,x,y\na,1,5,2,5\n", "", "separate the columns by semicolons"),
    "both signs": ("file;x;y\na;1,5;2.5\n", "", "a point or a comma throughout, got 1,5 and 2.5"),
    "twice named": ("file,x,x\na,1,2\n", "", "unique column names, got 'x' twice"),
    "no number": ("file,x_um,y_um\na,here,2\n", "", "a.csv line 2, x_um: expected a number, got 'here'"),
    "infinite": ("file,x_um,y_um\na,inf,2\n", "", "expected a number, got 'inf'"),
    "units of some": ("file,x_um,PosY\na,1.5,2\n", "", "unit of PosY: expected that of the other axes"),
    "counts and lengths": ("file,x_um,y_index\na,1.5,2\n", "", "expected position numbers throughout, or lengths"),
    "counts and a length": ("file,x_index,y_index,z_mm\na,1,2,0.5\n", "", "--columns y_index=…,x_index=…,z_index=…"),
    "half a plane": (
        "file,x_um,y_um,plane\na,1.5,2,0.5\n",
        "",
        "line 2, plane: expected a plane number, counted from 0",
    ),
    "planes from 2": (
        "file,x_um,y_um,plane\na,1.5,2,2\n",
        "",
        "from 0 or 1, got 2; correct it, or state that it is a le",
    ),
    "exposure": ("file,x_um,y_um,exposure_s\na,1,2,0\n", "", "line 2, exposure_s: expected a time above 0"),
    "microseconds": (
        "file,x_um,y_um,ExposureTime\na,1,2,20000\n",
        "",
        "ExposureTime: expected a unit of such large times, got 20000 without a unit; state the unit in the "
        "contents of the "
        "columns (--columns exposure_us=Ex",
    ),
    "hours": (
        "file,x_um,y_um,exposure_s\na,1,2,20000\n",
        "",
        "at most 1000 s, got 20000 s; correct its unit (for exam",
    ),
    "no rows": ("file,x,y\n", "", "expected a row for each frame, got only a header"),
    "empty": ("# nothing\n", "", "a table with a row for each frame"),
    "no name": ("file,x_um,y_um\n,1,2\n", "", "line 2, file: expected the name of a file"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_lists(tmp_path: Path, case: str) -> None:
    text, columns, words = BAD[case]
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_listing(tmp_path / "a.csv", columns)
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("header", "unit", "counted"),
    [
        ("file,x_mm,y_mm,plane", "um", True),
        ("file,x,y,plane", "", True),
        ("file,x_um,y_um,z_index", "um", True),
        ("file,x_index,y_index,plane", "index", False),
    ],
)
def test_planes_are_counted_beside_lengths(tmp_path: Path, header: str, unit: str, counted: bool) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\na,1.5,-2,1\nb,2.5,-2,1\nc,1.5,-2,2\n")
    found = read_listing(tmp_path / "a.csv")
    assert (found.unit, found.counted) == (unit, counted) and found.places[:, 2].tolist() == [1, 1, 2]
    assert found.places[0, 0] == (1500 if "mm" in header else 1.5)


def test_a_column_of_planes_beside_counted_places(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    "name",
    [
        "a/img_1.tif",
        r"a\img_1.tif",
        r"D:\scans\today\a\img_1.tif",
        "/home/me/a/img_1.tif",
        "./a/img_1.tif",
        "a/IMG_1.TIF",
        "a/img_1",
        r"C:a\img_1",
    ],
)
def test_files_as_other_systems_write_them(tmp_path: Path, name: str) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "img_1.tif").write_bytes(b"x")
    (tmp_path / "a" / "img_1.txt").write_bytes(b"x")
    assert located(listing(name), tmp_path).files == ("a/img_1.tif",)


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


def test_rows_of_one_file_are_its_pages(tmp_path: Path) -> None:
    (tmp_path / "stack.tif").write_bytes(b"x")
    found = located(listing("stack.tif", "stack.tif"), tmp_path)
    assert found.pages == (0, 1) and "its rows are taken as its pages" in found.notes[-1]


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
    with pytest.raises(
        InputError, match=r"column of file: .*columns Bild, row, col, Exp; state .*--columns file=COLUMN"
    ):
        open_frames(tmp_path)
    source = open_frames(tmp_path, columns="file=Bild")
    assert source.info(5).position == Position(0, 1, 2) and source.info(5).exposure_s == pytest.approx(0.02)
    assert any("y=row (index)" in note for note in source.metadata.notes)
    with pytest.raises(InputError, match="stage coordinates: expected the plan of the scan"):
        open_frames(tmp_path, columns="file=Bild,y_um=row,x_um=col")
    (tmp_path / "other.tsv").write_text("x")
    with pytest.raises(InputError, match=r"one, got other\.tsv, scan\.csv"):
        open_frames(tmp_path)
