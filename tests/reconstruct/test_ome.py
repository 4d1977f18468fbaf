"""Volumes as OME-TIFF: what other programs read there."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile

from lfcal.reconstruct.volumes import VolumeFacts, load_volume, save_volume, write_volumes

NAMES = {"ome": "http://www.openmicroscopy.org/Schemas/OME/2016-06"}


def told(path: Path) -> tuple[dict[str, str], list[dict[str, str]], dict[str, str]]:
    """Return what a file says of its pixels, of each plane, and beside."""
    with tifffile.TiffFile(path) as file:
        assert file.is_ome and file.ome_metadata is not None
        root = ElementTree.fromstring(file.ome_metadata)
    pixels = root.find(".//ome:Pixels", NAMES)
    assert pixels is not None
    beside = {str(m.get("K")): str(m.text) for m in root.iterfind(".//ome:M", NAMES)}
    return dict(pixels.attrib), [dict(plane.attrib) for plane in pixels.iterfind("ome:Plane", NAMES)], beside


@pytest.mark.parametrize("name", ["v.ome.tif", "v.OME.TIFF"])
def test_sizes_and_uneven_depths_are_told(tmp_path: Path, name: str) -> None:
    volume = np.random.default_rng(0).random((3, 8, 9), np.float32)
    depths = (-5983.0, 0.5, 11079.0)
    save_volume(tmp_path / name, volume, depths_um=depths, voxel_um=(27.37, 25.5), details={"solver": "µ"})
    pixels, planes, beside = told(tmp_path / name)
    assert (pixels["SizeZ"], pixels["SizeY"], pixels["SizeX"], pixels["SizeT"]) == ("3", "8", "9", "1")
    assert float(pixels["PhysicalSizeY"]) == 27.37 and float(pixels["PhysicalSizeX"]) == 25.5
    assert float(pixels["PhysicalSizeZ"]) == pytest.approx(8531)
    assert {pixels[f"PhysicalSize{axis}Unit"] for axis in "XYZ"} == {"µm"}
    assert [float(plane["PositionZ"]) for plane in planes] == list(depths)
    assert {plane["PositionZUnit"] for plane in planes} == {"µm"}
    assert json.loads(beside["lfcal"]) == {"solver": "µ"}
    np.testing.assert_array_equal(load_volume(tmp_path / name), volume)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_series_is_one_file_with_time(tmp_path: Path) -> None:
    series = np.random.default_rng(1).random((4, 3, 8, 9), np.float32)
    facts = VolumeFacts(np.array([-1.0, 0.0, 4.0]), (2.0, 2.0))
    with write_volumes(tmp_path / "t.ome.tif", series.shape, facts) as add:
        for volume in series:
            add(volume)
    pixels, planes, _ = told(tmp_path / "t.ome.tif")
    assert pixels["SizeT"] == "4" and [float(p["PositionZ"]) for p in planes] == [-1, 0, 4] * 4
    assert [int(plane["TheT"]) for plane in planes] == [k for k in range(4) for _ in range(3)]
    with tifffile.TiffFile(tmp_path / "t.ome.tif") as file:
        assert file.series[0].axes == "TZYX"
        np.testing.assert_array_equal(file.series[0].asarray(), series)


def test_what_nobody_knows_is_not_told(tmp_path: Path) -> None:
    save_volume(tmp_path / "v.ome.tif", np.zeros((2, 8, 9)))
    pixels, planes, _ = told(tmp_path / "v.ome.tif")
    assert not any(key.startswith("PhysicalSize") for key in pixels) and not planes
