"""Frames as other programs and cameras write them, after public reports: each is read right, or refused with a reason.

The name of a case is the report (repository and number of the thread) or, if there is none, the situation.
"""

from __future__ import annotations

import gzip
import json
import re
import struct
import unicodedata
import zlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import LfcalError
from lfcal.camera import ScanPlan
from lfcal.frames import chosen_shift, open_frames
from tests.frames.lists.scans import COLUMNS, ROWS, SENSOR, START, frame, scan, small_camera
from tests.frames.scenes import png_chunk

FOUND = scan()
POSITIONS = [tuple(place) for place in FOUND.positions.tolist()]
STAGE = FOUND.stage.tolist()
F = np.stack([frame((y, x), seed=100 * z + 10 * y + x) for z, y, x in POSITIONS])
COUNT = len(F)
PLAN = ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), (-40e3, 10e3), START)
RASTER = {"order": "raster"}

Write = Callable[[Path], Path]


def names(form: str = "z{0}_y{1}_x{2}.tif") -> list[str]:
    return [form.format(*place) for place in POSITIONS]


def numbers(form: str = "shot{}.tif") -> list[str]:
    return [form.format(k) for k in range(COUNT)]


def tiffs(files: Sequence[str] = (), frames: Iterable[Any] = F, others: Sequence[str] = (), **how: Any) -> Write:
    """Return what writes one TIFF for each frame, and ``others`` in the same folder."""

    def write(folder: Path) -> Path:
        for name, values in zip(files or names(), frames, strict=True):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            tifffile.imwrite(folder / name, values, **how)
        for name in others:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(b"\0\5\x16\7" + bytes(90))
        return folder

    return write


def below(name: str, write: Write) -> Write:
    def made(folder: Path) -> Path:
        (folder / name).mkdir()
        return write(folder / name)

    return made


def stack(frames: Any = F, **how: Any) -> Write:
    def write(folder: Path) -> Path:
        tifffile.imwrite(folder / "a.tif", frames, photometric="minisblack", **how)
        return folder / "a.tif"

    return write


def pages(*more: Any, each: Sequence[Any] = F, **last: Any) -> Write:
    """Return what writes one page for each frame, and ``more`` pages with the tags ``last``."""

    def write(folder: Path) -> Path:
        with tifffile.TiffWriter(folder / "a.tif") as file:
            for page in each:
                file.write(page, photometric="minisblack", metadata=None, contiguous=False)
            for page in more:
                file.write(page, photometric="minisblack", metadata=None, contiguous=False, **last)
        return folder / "a.tif"

    return write


def with_small_pictures(folder: Path) -> Path:
    with tifffile.TiffWriter(folder / "a.tif") as file:
        for page in F:
            file.write(page, photometric="minisblack", metadata=None, contiguous=False)
            file.write(page[::4, ::4].copy(), photometric="minisblack", metadata=None, subfiletype=1)
    return folder / "a.tif"


def packed(folder: Path) -> Path:
    """Write 12-bit samples without the 4 empty bits."""
    for name, values in zip(names(), F, strict=True):
        pairs = values.reshape(SENSOR[0], -1, 2)
        parts = (pairs[..., 0] >> 4, (pairs[..., 0] & 15) << 4 | pairs[..., 1] >> 8, pairs[..., 1] & 255)
        raw = np.stack(parts, -1).astype(np.uint8).tobytes()
        short = {256: SENSOR[1], 257: SENSOR[0], 258: 12, 259: 1, 262: 1, 277: 1, 278: SENSOR[0]}
        tags = [(tag, 3, value) for tag, value in short.items()] + [(273, 4, 8), (279, 4, len(raw))]
        entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in sorted(tags))
        head = b"II*\0" + struct.pack("<I", 8 + len(raw)) + raw + struct.pack("<H", len(tags))
        (folder / name).write_bytes(head + entries + bytes(4))
    return folder


def png(bits: int) -> Write:
    """Return what writes PNG files of samples in the upper ``bits``, as their sBIT chunk says."""

    def write(folder: Path) -> Path:
        head = struct.pack(">IIBBBBB", SENSOR[1], SENSOR[0], 16, 0, 0, 0, 0)
        said = png_chunk(b"sBIT", bytes([bits])) + png_chunk(b"gAMA", struct.pack(">I", 45455))
        for name, values in zip(names("z{0}_y{1}_x{2}.png"), F, strict=True):
            body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in (values << (16 - bits)).astype(">u2")))
            parts = png_chunk(b"IHDR", head), said, png_chunk(b"IDAT", body), png_chunk(b"IEND", b"")
            (folder / name).write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
        return folder

    return write


def hdf5(fill: Callable[[h5py.File], object], name: str = "a.h5") -> Write:
    def write(folder: Path) -> Path:
        with h5py.File(folder / name, "w") as file:
            fill(file)
        return folder / name

    return write


def stored(data: NDArray[Any]) -> Write:
    return hdf5(lambda file: file.create_dataset("data", data=data))


def begun(count: int) -> Callable[[h5py.File], None]:
    """Return what stores a dataset for all frames of which only ``count`` were written."""

    def fill(file: h5py.File) -> None:
        data = file.create_dataset("entry/data/data", F.shape, F.dtype, chunks=(1, *SENSOR))
        data[:count] = F[:count]

    return fill


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(F.shape, F.dtype)
    layout[:] = h5py.VirtualSource("data_000001.h5", "data", F.shape)
    file.create_virtual_dataset("frames", layout)


def master(file: h5py.File) -> None:
    file["entry/data/data_000001"] = h5py.ExternalLink("data_000001.h5", "/entry/data/data")


def fits(*cards: str, frames: Any = F, first: bool = True, table: bool = False) -> Write:
    """Return what writes a FITS stack, in the first array or behind an empty one."""

    def header(*lines: str) -> bytes:
        return b"".join(line.ljust(80).encode() for line in (*lines, "END")).ljust(2880)

    def write(folder: Path) -> Path:
        n, rows, columns = frames.shape
        empty = header("SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 0", "EXTEND  = T")
        sizes = ("BITPIX  = 16", "NAXIS   = 3", f"NAXIS1  = {columns}", f"NAXIS2  = {rows}", f"NAXIS3  = {n}")
        own = ("SIMPLE  = T",) if first else ("XTENSION= 'IMAGE   '", "PCOUNT  = 0", "GCOUNT  = 1")
        kind = ("XTENSION= 'BINTABLE'", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 8", "NAXIS2  = 1", "ZIMAGE  = T")
        own_header = header(*kind) if table else header(own[0], *sizes, *own[1:], "BZERO   = 32768", *cards)
        data = (frames.astype(np.int32) - 32768).astype(">i2").tobytes()
        body = (b"" if first else empty) + own_header + (bytes(2880) if table else data)
        (folder / "a.fits").write_bytes(body + bytes(-len(body) % 2880))
        return folder / "a.fits"

    return write


def micromanager(files: Sequence[str], change: Callable[[dict[str, Any], int], object], write: Write) -> Write:
    def made(folder: Path) -> Path:
        body: dict[str, Any] = {"Summary": {"Slices": 2}}
        for k, (name, (x, y, z)) in enumerate(zip(files, STAGE, strict=True)):
            entry = {"FileName": name, "XPositionUm": x, "YPositionUm": y, "ZPositionUm": z, "BitDepth": 12}
            change(entry, k)
            body[f"FrameKey-{k}-0-0"] = entry
        (folder / "metadata.txt").write_text(json.dumps(body))
        write(folder)
        return folder

    return made


def sequenced(entry: dict[str, Any], k: int) -> None:
    entry |= {"ZPositionUm": 10.0, "SliceIndex": POSITIONS[k][0]}


def unmoved(entry: dict[str, Any], _: int) -> None:
    entry |= {"XPositionUm": 0.0, "YPositionUm": 0.0, "ZPositionUm": 0.0}


TWO_STACKS = ["a_MMStack.ome.tif"] * 40 + ["a_MMStack_1.ome.tif"] * (COUNT - 40)


def two_stacks(folder: Path) -> Path:
    for name, part in zip(dict.fromkeys(TWO_STACKS), (F[:40], F[40:]), strict=True):
        tifffile.imwrite(folder / name, part, photometric="minisblack", metadata=None)
    return folder


def ome(unit: str, scale: float = 1.0, *, more: int = 0, cut: bool = False) -> Write:
    def place(s: Sequence[float]) -> str:
        axes = zip("XYZ", s, strict=True)
        return " ".join(f'Position{axis}="{n * scale}" Position{axis}Unit="{unit}"' for axis, n in axes)

    def write(folder: Path) -> Path:
        planes = "".join(
            f'<Plane TheZ="{z}" TheC="0" TheT="{y * COLUMNS + x}" {place(s)}/>'
            for (z, y, x), s in zip(POSITIONS, STAGE, strict=True)
        )
        text = (
            '<?xml version="1.0" encoding="UTF-8"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">'
            f'<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYTZC" Type="uint16" SizeX="{SENSOR[1]}" '
            f'SizeY="{SENSOR[0]}" SizeZ="2" SizeC="1" SizeT="{ROWS * COLUMNS}">{planes}</Pixels></Image></OME>'
        )
        said = (text[: len(text) // 2] if cut else text).encode()
        with tifffile.TiffWriter(folder / "a.ome.tif") as file:
            for k, page in enumerate([*F, *F[-1:].repeat(more, 0)]):
                description = said if k == 0 else None
                file.write(page, photometric="minisblack", metadata=None, contiguous=False, description=description)
        return folder / "a.ome.tif"

    return write


def saved(save: Callable[[Path], object], name: str) -> Write:
    def write(folder: Path) -> Path:
        save(folder / name)
        return folder / name

    return write


NFD = unicodedata.normalize("NFD", "Öffentlich é 测试")
GAP = [f"run2_20230823_{k:04d}.tiff" for k in range(COUNT + 1) if k != 20]
AS_STORED: dict[str, tuple[Write, dict[str, Any]]] = {
    "lucalista/shinestacker#22": (tiffs(others=[f"._{name}" for name in names()]), {}),
    "scverse/spatialdata-io#260": (tiffs(numbers(), others=[f"._{name}" for name in numbers()]), RASTER),
    "Rolf-Hempel/PlanetarySystemStacker#44": (tiffs(numbers(), others=[".DS_Store", "Thumbs.db"]), RASTER),
    "motioneye-project/motioneye#89": (tiffs(names("z{0}/y{1}_x{2}.tif"), others=["z0/.AppleDouble/y0_x0.tif"]), {}),
    "soft-matter/pims#103": (tiffs(numbers()), RASTER),
    "justinfx/fileseq#97": (tiffs([f"a.{k:03d}.tif" if k % 2 else f"a.{k:02d}.tif" for k in range(COUNT)]), RASTER),
    "bluesky/tiled#555": (tiffs([f"run2_20230823_{k:04d}.tiff" for k in range(COUNT)]), RASTER),
    "MouseLand/suite2p#502": (tiffs(names("z{0}_y{1}_x{2}.TIF")), {}),
    "opencv/opencv#4292": (below(NFD, tiffs()), {}),
    "python-pillow/Pillow#4063": (tiffs(extratags=[(274, "H", 1, 6, True)]), {}),
    "geotiffjs/geotiff.js#27": (tiffs(frames=F.astype(np.float32), compression="zlib", predictor=3), {}),
    "geosolutions-it/imageio-ext#117": (tiffs(compression="lzw", predictor=2), {}),
    "ome/bioformats#4098": (tiffs(frames=F.astype(np.int64)), {}),
    "imageio/imageio#982": (tiffs(frames=F.astype(np.int32)), {}),
    "tlnagy/TiffImages.jl#58": (packed, {}),
    "scalableminds/webknossos-libs#1481": (stack(imagej=True, truncate=True, metadata={"axes": "ZYX"}), RASTER),
    "hyperspy/hyperspy#2511": (pages(F[0, ::4, ::4].copy(), subfiletype=1), RASTER),
    "small picture after each frame": (with_small_pictures, RASTER),
    "blink1073/tifffile#8": (ome("µm", cut=True), RASTER),
    "ome/bioformats#2400": (ome("reference frame"), {}),
    "ome/bioformats#4240": (ome("m", 1e-6), {}),
    "one page too many": (ome("µm", more=1), {}),
    "ome/bioformats#2308": (micromanager(TWO_STACKS, lambda *_: None, two_stacks), {}),
    "micro-manager/micro-manager#264": (micromanager(numbers(), sequenced, tiffs(numbers())), {}),
    "suncasa/suncasa-src#251": (fits(first=False), RASTER),
    "siyu6974/QuickLook.Plugin.FitsViewer#3": (fits("ROWORDER= 'TOP-DOWN'"), RASTER),
    "OpenChemistry/tomviz#1812": (saved(lambda path: np.save(path, np.asfortranarray(F)), "a.npy"), RASTER),
}
"""Frames that are read with the stored samples, each at its position."""


def read(path: Path, **how: Any) -> tuple[dict[tuple[int, ...], NDArray[Any]], tuple[str, ...]]:
    """Return the frame of each position, and the notes."""
    with open_frames(path, plan=PLAN, **how) as source:
        return {tuple(source.info(k).position): source.read(k) for k in range(len(source))}, source.metadata.notes


@pytest.mark.parametrize("case", AS_STORED)
def test_frames_are_read_as_they_were_recorded(tmp_path: Path, case: str) -> None:
    write, how = AS_STORED[case]
    found, _ = read(write(tmp_path), **how)
    assert sorted(found) == sorted(POSITIONS)
    for place, values in zip(POSITIONS, F, strict=True):
        np.testing.assert_array_equal(found[place], values, err_msg=str(place))


FORTRAN = np.asfortranarray(F.transpose(2, 1, 0))
NOTED: dict[str, tuple[Write, dict[str, Any], str]] = {
    "bluesky/tiled#555, a gap": (tiffs(GAP), RASTER, "order: the file names skip 20"),
    "micro-manager/micro-manager#264": (*AS_STORED["micro-manager/micro-manager#264"], "planes: numbered by SliceInd"),
    "bluesky/ophyd#935": (hdf5(begun(40)), RASTER, "40 of 56 were written to a.h5"),
    "astropy/astropy#6841": (fits("ROWORDER= 'BOTTOM-UP'", frames=F[:, ::-1]), RASTER, "mirror-y .*--orientation"),
    "OpenChemistry/tomviz#1809": (
        saved(lambda path: np.save(path, FORTRAN), "a.npy"),
        RASTER,
        "56 along the last axis of a.npy, each of 48 x 40 px",
    ),
}


@pytest.mark.parametrize("case", NOTED)
def test_what_is_taken_for_granted_is_noted(tmp_path: Path, case: str) -> None:
    write, how, words = NOTED[case]
    _, notes = read(write(tmp_path), **how)
    assert any(re.search(words, note) for note in notes), notes


def test_samples_in_the_upper_bits_are_found(tmp_path: Path) -> None:
    """LabVIEW stores 12 bits so (imageio/imageio#1049), and Raspberry Pi scripts (raspberrypi/picamera2#311)."""
    with open_frames(png(12)(tmp_path), plan=PLAN) as source:
        assert chosen_shift("auto", source)[0] == 4
        np.testing.assert_array_equal(source.read(7), F[7] << 4)


HOLLOW = np.where(np.arange(COUNT)[:, None, None] == 55, 0, F)
LONGER = np.concatenate([F, np.full_like(F[:4], 65535)])
REFUSED: dict[str, tuple[Write, dict[str, Any], str]] = {
    "bluesky/tiled#555, one missing": (
        tiffs(GAP[:-1], np.delete(F, 20, 0)),
        RASTER,
        "expected 56 .* got 55; .*; the file names skip 20",
    ),
    "scifio/scifio#159": (pages(each=[*F[:9], F[9][:30], *F[10:]]), RASTER, "page 9.* got uint16, 30 x 48 px"),
    "h5py/h5py#1546": (
        hdf5(virtual),
        RASTER,
        "a virtual dataset of data_000001.h5; open the file that contains the data",
    ),
    "dials/dials#1088": (
        hdf5(master),
        RASTER,
        "links to data_000001.h5::/entry/data/data; .*open the file that contai",
    ),
    "areaDetector/ADAndor#41": (stored(HOLLOW), RASTER, "page 55, .*the value 0 in every pixel"),
    "slsdetectorgroup/slsDetectorPackage#474": (stored(LONGER), RASTER, "expected 56 for a scan of 2 x 4 x 7, got 60"),
    "a dataset with holes": (
        hdf5(lambda file: begun(40)(file) or file["entry/data/data"].__setitem__(50, F[50])),
        RASTER,
        "expected all chunks written, got 15 missing",
    ),
    "astropy/astropy#5999": (fits(first=False, table=True), RASTER, "a compressed table; export it uncompressed"),
    "micro-manager/micro-manager#184": (
        micromanager(numbers(), unmoved, tiffs(numbers())),
        {},
        "the same ones for all 56 frames; .*--order",
    ),
    "a .npz archive": (saved(lambda path: np.savez(path, F), "a.npz"), RASTER, r"\.npz archive; .*numpy\.save"),
    "a gzip archive": (saved(lambda path: path.write_bytes(gzip.compress(b"II*")), "a.tif.gz"), RASTER, "unpack it"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_the_reason_is_one_line(tmp_path: Path, case: str) -> None:
    write, how, words = REFUSED[case]
    with pytest.raises(LfcalError, match=words) as caught:
        read(write(tmp_path), **how)
    assert "\n" not in str(caught.value)
