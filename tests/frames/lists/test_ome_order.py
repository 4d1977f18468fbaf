"""Which page of a stack holds which plane: as `TiffData` states it, or as the axes of OME and ImageJ say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames, scan_positions
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
        words = "pages: 55 of the 56 planes in the OME metadata have a page; the others are missing"
        assert words in source.metadata.notes
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


PLAIN = [0, 1, 2, 100, 101, 102]
BLOCKS = '<TiffData IFD="0" FirstZ="1" PlaneCount="3"/><TiffData IFD="3" PlaneCount="3"/>'
DEFAULTS: dict[str, list[int]] = {
    # none, or one that says nothing: DimensionOrder, T fastest
    "": PLAIN,
    "<TiffData/>": PLAIN,
    '<TiffData IFD="0" PlaneCount="6"/>': PLAIN,
    # the count of planes is that of the pages where no page is named
    '<TiffData FirstZ="0"/>': PLAIN,
    # blocks of planes in DimensionOrder, the second plane of depth first
    BLOCKS: [100, 101, 102, 0, 1, 2],
    # one page each where a page is named
    '<TiffData IFD="5"/><TiffData IFD="0" FirstT="1"/>': [1, 0],
}


def test_what_tiffdata_leaves_out_has_its_default() -> None:
    for data, wanted in DEFAULTS.items():
        facts = ome_facts(header("XYCTZ", (2, 1, 3), data + planes_of(ALL)), 6)
        assert facts["stage_um"][:, 0].tolist() == wanted, data
    data = mapped(list(reversed(ALL)), "a", "old.ome.tif") + planes_of(ALL)
    renamed = ome_facts(header("XYCTZ", (2, 1, 3), data), 6, name="new.ome.tif")
    assert renamed["stage_um"][0, 0] == 102, "a renamed file is still the one that is meant"


def test_metadata_that_contradict_themselves_say_nothing(tmp_path: Path) -> None:
    for data in (
        mapped(ALL) + '<TiffData IFD="2" FirstT="1"/>',
        *('<TiffData IFD="0" FirstZ="7"/>', '<TiffData IFD="-1"/>', '<TiffData IFD="x"/>'),
        '<TiffData IFD="0" PlaneCount="99999999999"/>',
    ):
        facts = ome_facts(header("XYCTZ", (2, 1, 3), data + planes_of(ALL)), 6)
        assert set(facts) == {"order_notes"} and "pages are read in the order of the file" in facts["order_notes"][0]
        path = write(tmp_path / "s.ome.tif", list(np.zeros((6, 40, 48), np.uint16)), header("XYCTZ", (2, 1, 3), data))
        with pytest.raises(InputError, match="positions of the frames"):
            open_frames(path)
    assert ome_facts(header("XYCTZ", (10**9, 10**9, 10**9), ""), 6) == {}, "sizes that no file has"


# -- axes of stacks ----------------------------------------------------------------------------------------------------


STACK = np.random.default_rng(0).integers(0, 4000, (2, 3, 4, 12, 15)).astype(np.uint16)  # z, y, x, row, column


def write_stack(path: Path, stack: np.ndarray, axes: str, **how: Any) -> Path:
    tifffile.imwrite(path, stack, photometric="minisblack", metadata={"axes": axes}, **how)
    return path


def test_three_axes_are_depth_row_and_column(tmp_path: Path) -> None:
    for axes, order, how in (
        ("ZTCYX", (0, 1, 2, 3, 4), {"ome": True}),
        ("TZCYX", (1, 0, 2, 3, 4), {"ome": True}),
        ("TCZYX", (1, 2, 0, 3, 4), {"ome": True}),
        ("TZCYX", (1, 0, 2, 3, 4), {"imagej": True}),
    ):
        name = "stack.ome.tif" if "ome" in how else "stack.tif"
        path = write_stack(tmp_path / name, np.ascontiguousarray(STACK.transpose(order)), axes, **how)
        with open_frames(path) as source:
            assert len(source) == 24
            for k in range(24):
                np.testing.assert_array_equal(source.read(k), STACK[source.info(k).position])
    path = write_stack(tmp_path / "plane.ome.tif", STACK[0], "TCYX", ome=True)
    with open_frames(path, plan_shape=(1, 3, 4)) as source:
        for k in range(12):
            np.testing.assert_array_equal(source.read(k), STACK[(0, *source.info(k).position[1:])])
    stack = np.zeros((2, 2, 3, 2, 8, 9), np.uint16)
    stack += np.arange(stack.size, dtype=np.uint16).reshape(stack.shape)
    path = write_stack(tmp_path / "many.ome.tif", stack, "TZCAYX", ome=True)
    with pytest.raises(FileFormatError, match="axes of the pages: expected three or fewer, got TZCA"):
        open_frames(path)


def test_planes_of_positions_need_their_order(tmp_path: Path) -> None:
    """Micro-Manager's way: time runs over the positions, within each over the depths."""
    scan = scan_positions((2, 3, 4), "serpentine")
    stack = np.stack([STACK[p] for p in scan]).reshape(2, 12, 12, 15).transpose(1, 0, 2, 3)
    path = write_stack(tmp_path / "scan.ome.tif", np.ascontiguousarray(stack), "TZYX", ome=True)
    with pytest.raises(InputError, match=r"positions of the frames in .*scan\.ome\.tif: expected a manifest"):
        open_frames(path)
    with open_frames(path, order="serpentine", plan_shape=(2, 3, 4)) as source:
        for k in range(24):
            np.testing.assert_array_equal(source.read(k), STACK[source.info(k).position])


LAST: dict[str, Callable[[Path, Any], object]] = {
    "last.npy": lambda path, stack: np.save(path, stack),
    "last.h5": lambda path, stack: h5py.File(path, "w").create_dataset("frames", data=stack).file.close(),
    "last.tif": lambda path, stack: tifffile.imwrite(path, stack, photometric="minisblack"),
}


@pytest.mark.parametrize("name", LAST)
def test_frames_along_the_last_axis(tmp_path: Path, name: str) -> None:
    """Programs that store (row, column, frame), after gms_plugin_hdf5#2."""
    plan = ScanPlan(small_camera(), (3, 4), (9, 11), (-4e4, -2e4, 0.0, 1e4, 2e4), (20, 20))
    frames = np.random.default_rng(2).integers(0, 4000, (60, *plan.camera.sensor.shape)).astype(np.uint16)
    LAST[name](tmp_path / name, np.ascontiguousarray(np.moveaxis(frames, 0, -1)))
    with open_frames(tmp_path / name, order="raster", plan=plan) as source:
        assert any("60 along the last axis" in note for note in source.metadata.notes)
        for k in (59, 0, 7):
            np.testing.assert_array_equal(source.read(k), frames[k])
            region = (slice(2, 9), slice(1, 4))
            np.testing.assert_array_equal(source.read(k, region), frames[k][region])
    # there are fewer rows than positions: without a sensor it may also be a scan that stopped early
    words = "60 frames along one axis, got 40 along the first axis and 60 along the last"
    with pytest.raises(FileFormatError, match=words):
        open_frames(tmp_path / name, order="raster", plan_shape=plan.shape[:3])


def test_the_first_axis_wins_where_both_fit_and_a_large_stack_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "both.npy", STACK.reshape(24, 12, 15)[:12, :, :12])
    with open_frames(tmp_path / "both.npy", order="raster", plan_shape=(1, 3, 4)) as source:
        np.testing.assert_array_equal(source.read(3), STACK.reshape(24, 12, 15)[3, :, :12])
    np.save(tmp_path / "last.npy", np.moveaxis(STACK.reshape(24, 12, 15)[:6], 0, -1))
    monkeypatch.setattr("lfcal.frames.formats._axes.LARGEST", 1000)
    with pytest.raises(InputError, match=r"frames along the last axis: expected at most .*numpy\.moveaxis"):
        open_frames(tmp_path / "last.npy", order="raster", plan_shape=(1, 2, 3))


def test_one_axis_of_length_1_is_left_out(tmp_path: Path) -> None:
    """Deep-learning code stores (frame, channel, row, column), after dipy#3112 and MouseLand/suite2p#701."""
    frames = STACK[0].reshape(12, 12, 15)
    for shape, name in product(((12, 1, 12, 15), (1, 12, 12, 15), (12, 12, 15, 1)), ("last.npy", "last.h5")):
        LAST[name](tmp_path / name, frames.reshape(shape))
        with open_frames(tmp_path / name, order="raster", plan_shape=(1, 3, 4)) as source:
            for k in (0, 5, 11):
                np.testing.assert_array_equal(source.read(k), frames[k])
                np.testing.assert_array_equal(source.read(k, (slice(1, 5), slice(3, 9))), frames[k, 1:5, 3:9])
