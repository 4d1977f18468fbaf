"""Volumes as OME-TIFF, OME-Zarr and NeXus files: what other programs read there, and what is refused."""

from __future__ import annotations

import json
import shutil
import sys
import warnings
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.files import MAX_EXPANSION, replace_store
from lfcal.reconstruct.frame_files import frames_of
from lfcal.reconstruct.volumes import (
    VolumeFacts,
    load_volume,
    open_ome_zarr,
    save_volume,
    volume_facts,
    write_volumes,
)
from tests.architecture.sources import ROOT
from tests.frames.test_containers import FRAMES, write_ndtiff, write_zarr

zarr: Any = pytest.importorskip("zarr", reason="zarr is not installed")

MANIFEST = ROOT / "lfcal" / "napari" / "napari.yaml"
NAMES = {"ome": "http://www.openmicroscopy.org/Schemas/OME/2016-06"}


def metadata_of(path: Path) -> tuple[dict[str, str], list[dict[str, str]], dict[str, str]]:
    """Return what a file states of its pixels, of each plane, and elsewhere."""
    with tifffile.TiffFile(path) as file:
        assert file.is_ome and file.ome_metadata is not None
        root = ElementTree.fromstring(file.ome_metadata)
    pixels = root.find(".//ome:Pixels", NAMES)
    assert pixels is not None
    more = {str(m.get("K")): str(m.text) for m in root.iterfind(".//ome:M", NAMES)}
    return dict(pixels.attrib), [dict(plane.attrib) for plane in pixels.iterfind("ome:Plane", NAMES)], more


@pytest.mark.parametrize("name", ["v.ome.tif", "v.OME.TIFF"])
def test_ome_tiff_has_sizes_and_uneven_depths(tmp_path: Path, name: str) -> None:
    save_volume(tmp_path / name, VOLUME, depths_um=DEPTHS, voxel_um=(27.37, 25.5), details={"solver": "µ"})
    pixels, planes, more = metadata_of(tmp_path / name)
    assert (pixels["SizeZ"], pixels["SizeY"], pixels["SizeX"], pixels["SizeT"]) == ("3", "8", "9", "1")
    assert float(pixels["PhysicalSizeY"]) == 27.37 and float(pixels["PhysicalSizeX"]) == 25.5
    assert float(pixels["PhysicalSizeZ"]) == pytest.approx(8531)
    assert {pixels[f"PhysicalSize{axis}Unit"] for axis in "XYZ"} == {"µm"}
    assert [float(plane["PositionZ"]) for plane in planes] == list(DEPTHS)
    assert {plane["PositionZUnit"] for plane in planes} == {"µm"}
    assert json.loads(more["lfcal"]) == {"solver": "µ"}
    np.testing.assert_array_equal(load_volume(tmp_path / name), VOLUME)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_series_is_one_file_with_time(tmp_path: Path) -> None:
    series = np.random.default_rng(1).random((4, 3, 8, 9), np.float32)
    facts = VolumeFacts(np.array([-1.0, 0.0, 4.0]), (2.0, 2.0))
    with write_volumes(tmp_path / "t.ome.tif", series.shape, facts) as add:
        for volume in series:
            add(volume)
    pixels, planes, _ = metadata_of(tmp_path / "t.ome.tif")
    assert pixels["SizeT"] == "4" and [float(p["PositionZ"]) for p in planes] == [-1, 0, 4] * 4
    assert [int(plane["TheT"]) for plane in planes] == [k for k in range(4) for _ in range(3)]
    with tifffile.TiffFile(tmp_path / "t.ome.tif") as file:
        assert file.series[0].axes == "TZYX"
        np.testing.assert_array_equal(file.series[0].asarray(), series)


def test_files_state_nothing_unknown(tmp_path: Path) -> None:
    save_volume(tmp_path / "v.ome.tif", VOLUME)
    pixels, planes, _ = metadata_of(tmp_path / "v.ome.tif")
    assert not any(key.startswith("PhysicalSize") for key in pixels) and not planes
    save_volume(tmp_path / "v.zarr", VOLUME)
    image = image_of(tmp_path / "v.zarr")
    assert not any("unit" in axis for axis in image["axes"])
    assert image["datasets"][0]["coordinateTransformations"] == [{"type": "scale", "scale": [1.0] * 4}]


VOLUME = np.random.default_rng(0).random((3, 8, 9), np.float32)
DEPTHS = (-5983.0, 0.5, 11079.0)


def image_of(path: Path) -> dict[str, Any]:
    """Return what the folder says, as plain JSON: readers of any language see this."""
    (image,) = json.loads((path / ".zattrs").read_text())["multiscales"]
    return dict(image)


def test_ome_zarr_has_sizes_and_uneven_depths(tmp_path: Path) -> None:
    path = tmp_path / "v.ome.zarr"
    save_volume(path, VOLUME, depths_um=DEPTHS, voxel_um=(27.37, 25.5), details={"solver": "µ"})
    image = image_of(path)
    assert image["version"] == "0.4" and image["name"] == "v"
    axes = [("t", "time", None), *((name, "space", "micrometer") for name in "zyx")]
    assert [(axis["name"], axis["type"], axis.get("unit")) for axis in image["axes"]] == axes
    (level,) = image["datasets"]
    scale, start = level["coordinateTransformations"]
    assert scale == {"type": "scale", "scale": [1.0, 8531.0, 27.37, 25.5]}
    assert start == {"type": "translation", "translation": [0.0, -5983.0, 0.0, 0.0]}
    own = json.loads((path / ".zattrs").read_text())["lfcal"]
    sizes = {"depths_um": list(DEPTHS), "voxel_um": [27.37, 25.5]}
    assert own == {"version": 1, "details": {"solver": "µ"}, **sizes}
    stored = zarr.open_array(path / level["path"], mode="r")
    assert stored.shape == (1, 3, 8, 9) and stored.metadata.zarr_format == 2
    np.testing.assert_array_equal(load_volume(path), VOLUME)
    assert [p.name for p in tmp_path.iterdir()] == ["v.ome.zarr"]


def test_chunks_are_planes_that_any_reader_can_decode(tmp_path: Path) -> None:
    """By hand, as a reader of another language would: zlib, little-endian float32, names t/z/y/x."""
    save_volume(tmp_path / "v.zarr", VOLUME)
    said = json.loads((tmp_path / "v.zarr" / "0" / ".zarray").read_text())
    assert said["compressor"]["id"] == "zlib" and said["filters"] is None
    assert said["dimension_separator"] == "/" and said["dtype"] == "<f4" and said["chunks"] == [1, 1, 8, 9]
    chunk = zlib.decompress((tmp_path / "v.zarr" / "0" / "0" / "2" / "0" / "0").read_bytes())
    np.testing.assert_array_equal(np.frombuffer(chunk, "<f4").reshape(8, 9), VOLUME[2])
    # large planes are several chunks; empty ones are stored, too: a missing chunk is lost data
    volume = np.zeros((1, 1100, 5), np.float32)
    volume[0, 1050, 3] = 2
    save_volume(tmp_path / "w.zarr", volume)
    assert json.loads((tmp_path / "w.zarr" / "0" / ".zarray").read_text())["chunks"] == [1, 1, 1024, 5]
    assert sorted(p.name for p in (tmp_path / "w.zarr" / "0" / "0" / "0").iterdir()) == ["0", "1"]
    np.testing.assert_array_equal(load_volume(tmp_path / "w.zarr"), volume)


def test_a_series_has_times_and_an_origin(tmp_path: Path) -> None:
    series = np.random.default_rng(1).random((4, 3, 8, 9), np.float32)
    facts = VolumeFacts(np.array([4.0, 0.0, -1.0]), (2.0, 3.0), {}, (-8.0, -12.0), [0.0, 0.5, 1.0, 1.5])
    with write_volumes(tmp_path / "t.ome.zarr", series.shape, facts) as add:
        for volume in series:
            add(volume)
    image = image_of(tmp_path / "t.ome.zarr")
    assert image["axes"][0] == {"name": "t", "type": "time", "unit": "second"}
    scale, start = image["datasets"][0]["coordinateTransformations"]
    assert scale["scale"] == [0.5, 2.5, 2.0, 3.0]
    # the given planes are from far to near
    assert start["translation"] == [0.0, -1.0, -8.0, -12.0]
    array, _, own = open_ome_zarr(tmp_path / "t.ome.zarr")
    np.testing.assert_array_equal(array[...], series[:, ::-1])
    assert own["depths_um"] == [-1.0, 0.0, 4.0] and own["times_s"] == [0.0, 0.5, 1.0, 1.5]
    with pytest.raises(InputError, match="a volume"):
        load_volume(tmp_path / "t.ome.zarr")


def test_one_of_version_0_5_is_read(tmp_path: Path) -> None:
    group = zarr.open_group(tmp_path / "new.zarr", mode="w", zarr_format=3)
    stored = group.create_array("s0", shape=(1, *VOLUME.shape), chunks=(1, 1, 8, 9), dtype="<f4")
    stored[0] = VOLUME
    axes = [{"name": name} for name in "tzyx"]
    group.attrs["ome"] = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": [{"path": "s0"}]}]}
    np.testing.assert_array_equal(load_volume(tmp_path / "new.zarr"), VOLUME)


def test_damaged_ome_zarr_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(FileFormatError, match="an OME-Zarr image"):
        load_volume(tmp_path / "empty.zarr")
    with pytest.raises(StorageError, match="no such file or folder"):
        load_volume(tmp_path / "none.zarr")
    path = tmp_path / "v.zarr"
    save_volume(path, VOLUME)
    piece = path / "0" / "0" / "1" / "0" / "0"
    piece.write_bytes(piece.read_bytes()[:20])
    with pytest.raises(FileFormatError, match="intact chunks"):
        load_volume(path)
    said = json.loads((path / "0" / ".zarray").read_text())
    (path / "0" / ".zarray").write_text(json.dumps(said | {"shape": [1, 10**6, 10**6, 10**6]}))
    with pytest.raises(FileFormatError, match="bytes on disk"):
        load_volume(path)
    # bytes are counted, not values: two thirds as many bytes as there can be, and four thirds
    most = MAX_EXPANSION * sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    (path / "0" / ".zarray").write_text(json.dumps(said | {"shape": [1, 1, 1, int(most / 6)]}))
    open_ome_zarr(path)
    (path / "0" / ".zarray").write_text(json.dumps(said | {"shape": [1, 1, 1, int(most / 3)]}))
    with pytest.raises(FileFormatError, match="bytes on disk"):
        open_ome_zarr(path)


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "v.zarr"
    save_volume(path, VOLUME)
    with pytest.raises(RuntimeError, match="stop"), write_volumes(path, (2, 3, 8, 9), VolumeFacts()) as add:
        add(VOLUME)
        raise RuntimeError("stop")
    np.testing.assert_array_equal(load_volume(path), VOLUME)
    save_volume(path, 2 * VOLUME)
    np.testing.assert_array_equal(load_volume(path), 2 * VOLUME)
    assert [p.name for p in tmp_path.iterdir()] == ["v.zarr"]
    # a folder of other files is never replaced
    (tmp_path / "mine.zarr").mkdir()
    (tmp_path / "mine.zarr" / "notes.txt").write_text("mine")
    with pytest.raises(StorageError, match="this folder contains other files; choose another name"):
        save_volume(tmp_path / "mine.zarr", VOLUME)
    assert (tmp_path / "mine.zarr" / "notes.txt").read_text() == "mine"


def test_a_folder_is_restored_after_a_kill_between_two_names(tmp_path: Path) -> None:
    path, aside = tmp_path / "v.zarr", tmp_path / ".v.zarr.before"
    save_volume(path, VOLUME)
    path.rename(aside)
    (tmp_path / ".v.zarr.999999999.part").mkdir()
    with pytest.raises(RuntimeError, match="stop"), replace_store(path):
        np.testing.assert_array_equal(load_volume(path), VOLUME)
        raise RuntimeError("stop")
    assert [p.name for p in tmp_path.iterdir()] == ["v.zarr"]
    shutil.copytree(path, aside)
    save_volume(path, 2 * VOLUME)
    np.testing.assert_array_equal(load_volume(path), 2 * VOLUME)
    assert [p.name for p in tmp_path.iterdir()] == ["v.zarr"]


def test_the_message_without_zarr_has_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zarr", None)
    match = r"OME-Zarr files need the library zarr; install it with pip install \"lfcal\[zarr\]\"$"
    with pytest.raises(InputError, match=match):
        save_volume(tmp_path / "v.ome.zarr", VOLUME)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["v.tif", "v.ome.tif", "v.ome.zarr", "v.h5", "v.npy"])
def test_volumes_and_metadata_are_read_as_written(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Unsorted depths; what was not known stays unknown."""
    depths = [-20.0, -32.5, -26.0]
    grid = {"voxel_um": 2.5, "origin_um": (-5.0, -7.5)}
    save_volume(tmp_path / name, VOLUME, depths_um=depths, voxel_um=(1.25, 2.5), origin_um=(1.0, 2.0))
    save_volume(tmp_path / f"bare_{name}", VOLUME)
    save_volume(tmp_path / f"grid_{name}", VOLUME, voxel_um=(2.5, 2.5), origin_um=(-5.0, -7.5), details=grid)
    monkeypatch.setattr("lfcal.reconstruct.volumes.IMAGEJ_BYTES", 0)  # as for the largest files
    save_volume(tmp_path / f"large_{name}", VOLUME, depths_um=depths, voxel_um=2.0)
    for one in ("", "bare_", "grid_", "large_"):
        np.testing.assert_array_equal(load_volume(tmp_path / f"{one}{name}"), VOLUME)
    facts, bare, made, large = (volume_facts(tmp_path / f"{one}{name}") for one in ("", "bare_", "grid_", "large_"))
    assert bare == VolumeFacts()
    if name == "v.npy":
        assert facts == VolumeFacts()
        return
    np.testing.assert_allclose(facts.depths_um, depths)
    np.testing.assert_allclose(facts.voxel_um, (1.25, 2.5), rtol=1e-5)
    assert large.depths_um is not None and large.depths_um.tolist() == depths and large.voxel_um == (2.0, 2.0)
    assert made.voxel_um == (2.5, 2.5) and made.origin_um == (-5.0, -7.5) and made.depths_um is None


DOWN, UP = np.array([-20.0, -26.0, -32.0]), np.array([-32.0, -26.0, -20.0])
FACTS = {
    "far to near": VolumeFacts(DOWN, (2.0, 3.0), {"solver": "rl"}, (-8.0, -12.0), [5.0, 7.0]),
    "near to far": VolumeFacts(UP, (2.0, 3.0), {}, (-8.0, -12.0), [0.0, 0.5]),
    "unsorted": VolumeFacts(np.array([0.0, 10.0, 5.0]), (2.5, 2.5), {}, (4.0, 0.0), [1.0, 3.5]),
    "depths only": VolumeFacts(np.array([3.0, 2.0, 1.0])),
    "nothing": VolumeFacts(),
}
"""Metadata of a series of two volumes."""

Placed = list[tuple[tuple[float | None, ...], float]]
"""Time, depth, row and column of every voxel as another program computes them, None where unknown, and its value."""


def spread(values: Any, axes: list[list[float | None]]) -> Placed:
    array = np.asarray(values)
    places = [tuple(axis[k] for axis, k in zip(axes, at, strict=True)) for at in np.ndindex(array.shape)]
    return list(zip(places, array.ravel().tolist(), strict=True))


def by_imagej(path: Path) -> Placed:
    """As FileOpener and Calibration of ImageJ do: (index - origin) * side; frames are ``finterval`` seconds apart."""
    with tifffile.TiffFile(path) as file:
        values = file.series[0].asarray()
        assert file.series[0].axes == "TZYX"
        lines = dict(line.split("=", 1) for line in file.pages[0].description.splitlines() if "=" in line)
        ratios = [file.pages[0].tags[f"{axis}Resolution"].value for axis in "YX"]
    assert lines["ImageJ"] and lines["unit"] == "um"
    sides = [float(lines.get("spacing", 0)), *(d / n for n, d in ratios)]
    known = ["spacing" in lines, *([ratios != [(1, 1)] * 2] * 2)]
    interval = float(lines["finterval"]) if "finterval" in lines else None
    axes: list[list[float | None]] = [[None if interval is None else interval * k for k in range(2)]]
    for axis, n, side, stated in zip("zyx", values.shape[1:], sides, known, strict=True):
        origin = float(lines.get(f"{axis}origin", 0))
        axes.append([round((k - origin) * side, 4) if stated else None for k in range(n)])
    return spread(values, axes)


def by_ome(path: Path) -> Placed:
    """By the schema of OME 2016-06: the position of every plane, sizes of pixels, and seconds since the first one."""
    pixels, planes, _ = metadata_of(path)
    values = tifffile.imread(path).reshape(2, 3, 4, 5)
    number = {(int(plane["TheT"]), int(plane["TheZ"])): plane for plane in planes}
    units = {f"{key}Unit" for key in ("PhysicalSizeX", "PhysicalSizeY", "PhysicalSizeZ", "TimeIncrement")}
    assert {key for key in pixels if key.endswith("Unit")} <= units
    out: Placed = []
    for t, z, y, x in np.ndindex(values.shape):
        said = number.get((t, z), {})
        place: list[float | None] = [float(said[name]) if name in said else None for name in ("DeltaT", "PositionZ")]
        for axis, k in (("Y", y), ("X", x)):
            side = pixels.get(f"PhysicalSize{axis}")
            place.append(None if side is None else float(said[f"Position{axis}"]) + k * float(side))
        out.append((tuple(place), float(values[t, z, y, x])))
    if "TimeIncrement" in pixels:
        assert float(pixels["TimeIncrement"]) == float(planes[-1]["DeltaT"]) - float(planes[0]["DeltaT"])
    return out


def by_ome_types(path: Path) -> Placed:
    """By ome-types, which also validates the metadata against the schema."""
    ome_types = pytest.importorskip("ome_types", reason="ome-types is not installed")
    pytest.importorskip("lxml", reason="lxml, with which ome-types validates, is not installed")
    pixels = ome_types.from_tiff(path, validate=True).images[0].pixels
    values = tifffile.imread(path).reshape(2, 3, 4, 5)
    planes = {(plane.the_t, plane.the_z): plane for plane in pixels.planes}
    sides = {axis: getattr(pixels, f"physical_size_{axis}") for axis in "yx"}
    units = {unit.value for plane in planes.values() for unit in (plane.position_z_unit, plane.delta_t_unit)}
    assert units <= {"µm", "s"}
    out: Placed = []
    for t, z, y, x in np.ndindex(values.shape):
        plane = planes.get((t, z))
        place: list[float | None] = [None, None] if plane is None else [plane.delta_t, plane.position_z]
        for axis, k in (("y", y), ("x", x)):
            side = sides[axis]
            place.append(None if side is None else getattr(plane, f"position_{axis}") + k * side)
        out.append((tuple(place), float(values[t, z, y, x])))
    return out


def placed_by(values: Any, axes: list[dict[str, Any]], transformations: list[dict[str, Any]]) -> Placed:
    """Place voxels at index * scale + translation, in the units of the axes."""
    scale, *rest = transformations
    start = rest[0]["translation"] if rest else [0.0] * 4
    places = [
        [k * side + first if "unit" in axis else None for k in range(n)]
        for axis, side, first, n in zip(axes, scale["scale"], start, values.shape, strict=True)
    ]
    return spread(values, places)


def by_ngff(path: Path) -> Placed:
    """By https://ngff.openmicroscopy.org/0.4/."""
    image = image_of(path)
    (level,) = image["datasets"]
    values = zarr.open_array(path / level["path"], mode="r")[...]
    return placed_by(values, image["axes"], level["coordinateTransformations"])


def by_ome_zarr(path: Path) -> Placed:
    """By the reader of ome-zarr."""
    pytest.importorskip("ome_zarr", reason="ome-zarr is not installed")
    pytest.importorskip("dask", minversion="2025.1")  # with which it reads; earlier ones do not know zarr 3
    from ome_zarr.io import parse_url
    from ome_zarr.reader import Reader

    (node,) = Reader(parse_url(path))()
    (values,), (transformations,) = node.data, node.metadata["coordinateTransformations"]
    return placed_by(np.asarray(values), node.metadata["axes"], transformations)


def by_napari(path: Path) -> Placed:
    """By npe2 with the manifest of lfcal: index * scale + translate, in the units of the layer."""
    with warnings.catch_warnings():  # when it is imported
        warnings.simplefilter("ignore")
        npe2 = pytest.importorskip("npe2", reason="npe2 is not installed")
        manager = npe2.PluginManager()
        manager.register(npe2.PluginManifest.from_file(MANIFEST))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(npe2.PluginManager, "instance", lambda: manager)
            ((values, words, kind),) = npe2.read([str(path)], stack=False)
    assert kind == "image"
    axes = [{} if unit == "pixel" else {"unit": unit} for unit in words["units"]]
    transformations = [{"scale": words["scale"]}, {"translation": words["translate"]}]
    return placed_by(np.asarray(values), axes, transformations)


def by_nexus(path: Path) -> Placed:
    """By the rules of NeXus for the default plot, with h5py alone."""
    with h5py.File(path) as file:
        group = file[file.attrs["default"]]
        group = group[group.attrs["default"]]
        assert group.attrs["NX_class"] == "NXdata"
        axes = [group[name] for name in group.attrs["axes"]]
        places = [list(axis[()]) if axis.attrs["units"] else [None] * len(axis) for axis in axes]
        return spread(group[group.attrs["signal"]][()], places)


READERS = [
    ("v.tif", by_imagej),
    ("v.ome.tif", by_ome),
    pytest.param("v.ome.tif", by_ome_types, marks=pytest.mark.long),  # takes seconds to import
    ("v.ome.zarr", by_ngff),
    pytest.param("v.ome.zarr", by_ome_zarr, marks=pytest.mark.long),
    ("v.ome.zarr", by_napari),
    ("v.h5", by_nexus),
    ("v.h5", by_napari),
]


@pytest.mark.parametrize("facts", FACTS.values(), ids=FACTS)
@pytest.mark.parametrize(("name", "read"), READERS)
def test_other_programs_place_every_voxel_correctly(tmp_path: Path, name: str, read: Any, facts: VolumeFacts) -> None:
    """The value of each voxel is read at its place and time in the given volume."""
    series = np.random.default_rng(3).random((2, 3, 4, 5), np.float32)
    with write_volumes(tmp_path / name, series.shape, facts) as add:
        for volume in series:
            add(volume)
    times = list(facts.times_s) if facts.times_s is not None else [None] * 2
    if name == "v.tif" and facts.times_s is not None:  # ImageJ has intervals, no start
        times = [0.0, facts.times_s[1] - facts.times_s[0]]
    depths = [None] * 3 if facts.depths_um is None else facts.depths_um.tolist()
    lateral: list[list[float | None]] = [
        [None] * n
        if facts.voxel_um is None or facts.origin_um is None
        else [facts.origin_um[k] + i * facts.voxel_um[k] for i in range(n)]
        for k, n in enumerate((4, 5))
    ]
    # values are all different, so sorting by them pairs the voxels
    expected, found = (
        sorted(places, key=lambda place: place[1])
        for places in (spread(series, [times, depths, *lateral]), read(tmp_path / name))
    )
    assert found == expected
    known = volume_facts(tmp_path / name)
    assert known.details == facts.details
    for one in ("depths_um", "voxel_um", "origin_um", "times_s"):
        stated = getattr(facts, one)
        assert (getattr(known, one) is None) == (stated is None), one
        if stated is not None:
            np.testing.assert_allclose(getattr(known, one), stated, rtol=1e-6)


def test_stacks_of_other_programs_are_loaded(tmp_path: Path) -> None:
    """Without tags of the resolution, and with damaged metadata of OME, which say nothing of the values."""
    tifffile.imwrite(tmp_path / "v.tif", VOLUME, photometric="minisblack", metadata=None)
    data = bytearray((tmp_path / "v.tif").read_bytes())
    # the numbers of both tags, 282 and 283, become private ones
    for tag, other in ((282, 65000), (283, 65001)):
        data = data.replace(tag.to_bytes(2, "little") + b"\x05\0\x01\0", other.to_bytes(2, "little") + b"\x05\0\x01\0")
    (tmp_path / "v.tif").write_bytes(data)
    with tifffile.TiffFile(tmp_path / "v.tif") as file:
        assert "XResolution" not in file.pages[0].tags
    np.testing.assert_array_equal(load_volume(tmp_path / "v.tif"), VOLUME)
    assert volume_facts(tmp_path / "v.tif") == VolumeFacts()
    save_volume(tmp_path / "v.ome.tif", VOLUME, depths_um=[1.0, 2.0, 3.0])
    data = (tmp_path / "v.ome.tif").read_bytes()
    (tmp_path / "v.ome.tif").write_bytes(data.replace(b'PositionZ="2.0"', b'PositionZ="2.o"'))
    np.testing.assert_array_equal(load_volume(tmp_path / "v.ome.tif"), VOLUME)
    with pytest.raises(FileFormatError, match="metadata of a volume"):
        volume_facts(tmp_path / "v.ome.tif")


def test_wrong_volumes_are_refused(tmp_path: Path) -> None:
    for name, volume, more, what in (
        ("v.tif", VOLUME, {"depths_um": [1.0, 2.0]}, "depths of the volume: expected 3, got 2"),
        ("v.jpg", VOLUME, {}, "volume file"),
        ("v.h5", VOLUME[0], {}, "three axes"),
    ):
        with pytest.raises(InputError, match=what):
            save_volume(tmp_path / name, volume, **more)
    times = pytest.raises(InputError, match="times of the volume: expected 2, got 1")
    with times, write_volumes(tmp_path / "v.h5", (2, *VOLUME.shape), VolumeFacts(times_s=[1.0])):
        pass
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["v.tif", "v.ome.tif", "v.ome.zarr", "v.h5", "v.npy"])
def test_volumes_that_the_file_does_not_state_are_refused(tmp_path: Path, name: str) -> None:
    """Values of another shape, or too few volumes, made a file that could not be read correctly."""
    for volumes, what in (
        ([VOLUME, VOLUME[:, 1:]], r"volume: expected shape \(3, 8, 9\), got shape \(3, 7, 9\)"),
        ([VOLUME], "volumes of the file: expected 2, got 1"),
    ):
        with pytest.raises(InputError, match=what), write_volumes(tmp_path / name, (2, 3, 8, 9), VolumeFacts()) as add:
            for volume in volumes:
                add(volume)
        assert not list(tmp_path.iterdir())


def test_damaged_metadata_are_reported_in_a_line(tmp_path: Path) -> None:
    for name, good, bad in (
        ("v.ome.tif", b'SizeZ="3"', b'SizeZ="B"'),
        ("v.ome.tif", b'PositionZ="-20.0"', b'PositionZ="-2o.0"'),
        ("v.ome.tif", b"stored_planes&quot;: [2, 1, 0]", b"stored_planes&quot;: [2, 1, 1]"),
        ("v.tif", b'"stored_planes": [2, 1, 0]', b'"stored_planes": [2, 1, 1]'),
        ("v.tif", b'{"stored_planes"', b'["stored_planes"'),
    ):
        path = tmp_path / name
        save_volume(path, VOLUME, depths_um=DOWN)
        data = path.read_bytes()
        good, bad = (good, bad) if good in data else (good.replace(b"&quot;", b'"'), bad.replace(b"&quot;", b'"'))
        assert data.count(good) == 1
        path.write_bytes(data.replace(good, bad))
        with pytest.raises(FileFormatError, match=r"^[^\n]*metadata of a volume[^\n]*copy the file again[^\n]*$"):
            volume_facts(path)


SERIES = FRAMES.reshape(24, 16, 18)[:3]


@pytest.mark.parametrize("kind", ["zarr", "ndtiff"])
def test_a_series_of_frames_is_read_from_a_folder_of_an_acquisition_program(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "beads.ome.zarr"
    if kind == "zarr":
        write_zarr(path, SERIES, "tyx", "0.5")
    else:
        write_ndtiff(path, [({"time": k}, frame, {}) for k, frame in enumerate(SERIES)])
    found = frames_of(path)
    assert [frame.name for frame in found] == ["beads_0000", "beads_0001", "beads_0002"]
    for frame, expected in zip(found, SERIES, strict=True):
        np.testing.assert_array_equal(frame.read(), expected)
    # a unit of work is repeated if any of these files changes
    inside = {str(file) for file in path.rglob("*") if file.is_file()}
    assert set(found[0].inputs) == inside and len(inside) > 1
