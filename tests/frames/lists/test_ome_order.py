"""Which page of an OME-TIFF holds which plane: as ``TiffData`` states it, whatever ``DimensionOrder`` says."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import InputError, StorageError
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames
from lfcal.frames.formats._ome import ome_facts
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, small_camera

PLANES = 2
Plane = tuple[int, int, int]


def plan() -> ScanPlan:
    return ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), (-40e3, 10e3), START)


def header(order: str, sizes: Plane, inner: str, uuid: str = "", shape: tuple[int, int] = (40, 48)) -> str:
    z, c, t = sizes
    root = f' UUID="urn:uuid:{uuid}"' if uuid else ""
    return (
        f'<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"{root}><Image ID="Image:0"><Pixels '
        f'ID="Pixels:0" DimensionOrder="{order}" Type="uint16" SizeX="{shape[1]}" SizeY="{shape[0]}" SizeZ="{z}" '
        f'SizeC="{c}" SizeT="{t}">{inner}</Pixels></Image></OME>'
    )


def mapped(order: Sequence[Plane], uuid: str = "", file: str = "", first: int = 0) -> str:
    """Return a ``TiffData`` for each page of a file, in the order of its pages."""
    mark = f'<UUID FileName="{file}">urn:uuid:{uuid}</UUID>' if uuid else ""
    return "".join(
        f'<TiffData IFD="{first + k}" FirstZ="{z}" FirstC="{c}" FirstT="{t}" PlaneCount="1">{mark}</TiffData>'
        for k, (z, c, t) in enumerate(order)
    )


def places(order: Sequence[Plane], found: Scan) -> str:
    """Return the stage coordinates of planes whose Z is the depth plane and whose T counts positions."""
    count = ROWS * COLUMNS
    rows = []
    for z, c, t in order:
        x, y, depth = found.stage[z * count + t]
        place = f'PositionX="{x}" PositionXUnit="µm" PositionY="{y}" PositionYUnit="µm" PositionZ="{depth}"'
        rows.append(f'<Plane TheZ="{z}" TheC="{c}" TheT="{t}" {place} PositionZUnit="µm"/>')
    return "".join(rows)


def pixels(order: Sequence[Plane], found: Scan) -> list[NDArray[np.uint16]]:
    positions = found.positions
    return [frame(positions[z * ROWS * COLUMNS + t, 1:], seed=1000 * z + t) for z, _, t in order]


def write(path: Path, frames: Sequence[NDArray[np.uint16]], text: str) -> Path:
    with tifffile.TiffWriter(path) as file:
        for k, image in enumerate(frames):
            about = text.encode() if k == 0 else None
            file.write(image, photometric="minisblack", metadata=None, description=about, contiguous=False)
    return path


@pytest.fixture(scope="module")
def found() -> Scan:
    return scan()


def by_place() -> list[Plane]:
    """Return the planes as a scan records them that goes through the depths at each place."""
    return [(z, 0, t) for t in range(ROWS * COLUMNS) for z in range(PLANES)]


def serpentine() -> list[Plane]:
    """Return the planes as a scan records them that turns round at the end of each row."""
    rows = [[r * COLUMNS + c for c in range(COLUMNS)][:: 1 if r % 2 == 0 else -1] for r in range(ROWS)]
    return [(z, 0, t) for z in range(PLANES) for row in rows for t in row]


SIZES = (PLANES, 1, ROWS * COLUMNS)


@pytest.mark.parametrize("order", [by_place(), serpentine()], ids=["by place", "serpentine"])
def test_stage_positions_go_with_the_pages_that_tiffdata_names(tmp_path: Path, found: Scan, order: list[Plane]) -> None:
    text = header("XYCTZ", SIZES, mapped(order) + places(sorted(order), found))
    write(tmp_path / "s.ome.tif", pixels(order, found), text)
    with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
        notes = " ".join(source.metadata.notes)
        assert "read in the order of TiffData, which differs from DimensionOrder XYCTZ" in notes
        assert "the light agrees" in notes
        for k in range(len(source)):
            z, y, x = source.info(k).position
            np.testing.assert_array_equal(source.read(k), frame((y, x), seed=1000 * z + y * COLUMNS + x))


def test_an_order_that_agrees_is_not_remarked(tmp_path: Path, found: Scan) -> None:
    order = by_place()
    text = header("XYZCT", SIZES, mapped(order) + places(sorted(order), found))
    write(tmp_path / "s.ome.tif", pixels(order, found), text)
    with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
        assert "TiffData" not in " ".join(source.metadata.notes)
        np.testing.assert_array_equal(source.read(1), frame((0, 0), seed=1000))


def test_axes_without_stage_positions_follow_tiffdata(tmp_path: Path) -> None:
    """Z, T and C are depth plane, row and column; the pages lie in an order that no DimensionOrder has."""
    stack = np.random.default_rng(2).integers(0, 4000, (2, 3, 4, 12, 15)).astype(np.uint16)
    order = [(z, x, y) for z, y, x in np.ndindex(2, 3, 4)]
    order = [order[k] for k in np.random.default_rng(3).permutation(len(order))]
    text = header("XYCTZ", (2, 4, 3), mapped(order), shape=(12, 15))
    path = write(tmp_path / "s.ome.tif", [stack[z, t, c] for z, c, t in order], text)
    with open_frames(path) as source:
        assert len(source) == 24 and "differs from DimensionOrder XYCTZ" in source.metadata.notes[0]
        for k in range(24):
            np.testing.assert_array_equal(source.read(k), stack[source.info(k).position])


def test_a_scan_order_counts_the_planes_not_the_pages(tmp_path: Path) -> None:
    """One axis: T counts the positions as they were planned, the pages came otherwise."""
    stack = np.random.default_rng(2).integers(0, 4000, (6, 12, 15)).astype(np.uint16)
    order = [(0, 0, t) for t in (3, 0, 5, 1, 4, 2)]
    path = write(tmp_path / "s.ome.tif", [stack[t] for _, _, t in order], header("XYZCT", (1, 1, 6), mapped(order)))
    with open_frames(path, order="raster", plan_shape=(1, 2, 3)) as source:
        for k in range(6):
            _, y, x = source.info(k).position
            np.testing.assert_array_equal(source.read(k), stack[3 * y + x])


def test_a_scan_that_was_stopped_has_the_planes_that_are_there(tmp_path: Path, found: Scan) -> None:
    order = sorted(by_place())
    text = header("XYCTZ", SIZES, places(order, found))
    write(tmp_path / "s.ome.tif", pixels(order, found)[:-1], text)
    with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
        assert len(source) == len(order) - 1
        assert (
            "pages: 55 of the 56 planes in the OME metadata have a page; the others are missing"
        ) in source.metadata.notes
        np.testing.assert_array_equal([source.info(k).position for k in range(55)], found.positions[:-1])


def test_planes_in_several_files(tmp_path: Path, found: Scan) -> None:
    """Each file has all metadata; UUIDs say which page of which file a plane is."""
    order = serpentine()
    half = 30
    inner = mapped(order[:half], "a", "s_0.ome.tif") + mapped(order[half:], "b", "s_1.ome.tif")
    inner += places(order, found)
    for k, (part, uuid) in enumerate(((order[:half], "a"), (order[half:], "b"))):
        write(tmp_path / f"s_{k}.ome.tif", pixels(part, found), header("XYCTZ", SIZES, inner, uuid))
    for name in ("s_0.ome.tif", "s_1.ome.tif"):
        with open_frames(tmp_path / name, plan=plan()) as source:
            assert len(source) == 56
            for k in range(56):
                z, y, x = source.info(k).position
                np.testing.assert_array_equal(source.read(k), frame((y, x), seed=1000 * z + y * COLUMNS + x))
    (tmp_path / "s_0.ome.tif").unlink()
    with pytest.raises(StorageError, match=r"30 planes are in 's_0\.ome\.tif', which is not in the same"):
        open_frames(tmp_path / "s_1.ome.tif", plan=plan())


def test_no_file_outside_the_folder_is_opened(tmp_path: Path, found: Scan) -> None:
    order = by_place()
    inner = mapped(order[:50], "a", "s.ome.tif") + mapped(order[50:], "b", "../other.ome.tif") + places(order, found)
    write(tmp_path / "other.ome.tif", pixels(order[50:], found), header("XYCTZ", SIZES, inner, "b"))
    (tmp_path / "in").mkdir()
    write(tmp_path / "in" / "s.ome.tif", pixels(order[:50], found), header("XYCTZ", SIZES, inner, "a"))
    with pytest.raises(StorageError, match="which is not in the same"):
        open_frames(tmp_path / "in" / "s.ome.tif", plan=plan())
    with pytest.raises(InputError, match="file of a frame"):
        open_frames(tmp_path / "in" / "s.ome.tif", order="raster", plan_shape=plan().shape[:3])


def planes_of(order: Sequence[Plane]) -> str:
    return "".join(
        f'<Plane TheZ="{z}" TheC="{c}" TheT="{t}" PositionX="{100 * z + t}" PositionY="0"/>' for z, c, t in order
    )


ALL = [(z, 0, t) for z in range(2) for t in range(3)]


@pytest.mark.parametrize(
    ("data", "wanted"),
    [
        # none, or one that says nothing: DimensionOrder, T fastest
        ("", [0, 1, 2, 100, 101, 102]),
        ("<TiffData/>", [0, 1, 2, 100, 101, 102]),
        ('<TiffData IFD="0" PlaneCount="6"/>', [0, 1, 2, 100, 101, 102]),
        # the count of planes is that of the pages where no page is named
        ('<TiffData FirstZ="0"/>', [0, 1, 2, 100, 101, 102]),
        # blocks of planes in DimensionOrder, the second plane of depth first
        ('<TiffData IFD="0" FirstZ="1" PlaneCount="3"/><TiffData IFD="3" PlaneCount="3"/>', [100, 101, 102, 0, 1, 2]),
        # one page each where a page is named
        ('<TiffData IFD="5"/><TiffData IFD="0" FirstT="1"/>', [1, 0]),
    ],
)
def test_what_tiffdata_leaves_out_has_its_default(data: str, wanted: list[int]) -> None:
    facts = ome_facts(header("XYCTZ", (2, 1, 3), data + planes_of(ALL)), 6)
    assert facts["stage_um"][:, 0].tolist() == wanted


@pytest.mark.parametrize(
    "data",
    [
        mapped(ALL) + '<TiffData IFD="2" FirstT="1"/>',
        '<TiffData IFD="0" FirstZ="7"/>',
        '<TiffData IFD="-1"/>',
        '<TiffData IFD="x"/>',
        '<TiffData IFD="0" PlaneCount="99999999999"/>',
    ],
)
def test_metadata_that_contradict_themselves_say_nothing(tmp_path: Path, data: str) -> None:
    facts = ome_facts(header("XYCTZ", (2, 1, 3), data + planes_of(ALL)), 6)
    assert set(facts) == {"order_notes"} and "pages are read in the order of the file" in facts["order_notes"][0]
    path = write(tmp_path / "s.ome.tif", list(np.zeros((6, 40, 48), np.uint16)), header("XYCTZ", (2, 1, 3), data))
    with pytest.raises(InputError, match="positions of the frames"):
        open_frames(path)


def test_sizes_that_no_file_has_are_refused() -> None:
    assert ome_facts(header("XYCTZ", (10**9, 10**9, 10**9), ""), 6) == {}


def test_a_renamed_file_is_still_the_one_that_is_meant() -> None:
    data = mapped(list(reversed(ALL)), "a", "old.ome.tif") + planes_of(ALL)
    assert ome_facts(header("XYCTZ", (2, 1, 3), data), 6, name="new.ome.tif")["stage_um"][0, 0] == 102
