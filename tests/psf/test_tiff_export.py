"""TIFF exports as ImageJ and Bio-Formats read them: by tifffile, which knows the rules of both."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.psf import PSFMatrix, export
from lfcal.psf import _tiff_export as tiff_export
from lfcal.psf._export import export_files

SHAPE = (2, 3, 4, 5, 7)


def matrix(dtype: str = "float32", **more: Any) -> PSFMatrix:
    values = np.arange(np.prod(SHAPE)).reshape(SHAPE).astype(dtype)
    return PSFMatrix(values, **{"depths": [-20.0, 35.0], **more})


def pixel_um(file: tifffile.TiffFile) -> float:
    count, length = file.pages[0].tags["XResolution"].value
    return float(length / count)


@pytest.mark.parametrize("dtype", ["float32", "uint16", "uint8"])
def test_imagej_opens_h_as_a_hyperstack(tmp_path: Path, dtype: str) -> None:
    camera = preset("bench")
    H = matrix(dtype, camera=camera)
    assert export(H, tmp_path / "H.tif") == tmp_path / "H.tif" == export_files(H, tmp_path / "H.tif")[0]
    with tifffile.TiffFile(tmp_path / "H.tif") as file:
        assert file.is_imagej and not file.is_ome
        about: dict[str, Any] = file.imagej_metadata or {}
        assert (about["slices"], about["frames"], about["hyperstack"]) == (2, 12, True)
        assert about["unit"] == "um" and about["spacing"] == pytest.approx(55.0)
        assert pixel_um(file) == pytest.approx(camera.sensor.pixel_um, rel=1e-6)
        series = file.series[0]
        assert series.axes == "TZYX" and series.shape == (12, 2, 5, 7)
        stack = series.asarray().reshape(3, 4, 2, 5, 7)
        np.testing.assert_array_equal(stack.transpose(2, 0, 1, 3, 4), np.asarray(H))
        # pages in the order of the file: depth first, then the next position
        assert about["Labels"][:3] == ["z=-20 um y=0 x=0", "z=35 um y=0 x=0", "z=-20 um y=0 x=1"]
        np.testing.assert_array_equal(file.pages[3].asarray(), np.asarray(H)[1, 0, 1])
        assert "y slow, x fast" in about["Info"] and "-20 35" in about["Info"]


def test_one_position_is_a_stack_over_depth(tmp_path: Path) -> None:
    H = matrix()
    export(H, tmp_path / "one.tif", position=(2, 1))
    with tifffile.TiffFile(tmp_path / "one.tif") as file:
        about: dict[str, Any] = file.imagej_metadata or {}
        assert file.is_imagej and file.series[0].axes == "ZYX" and about["slices"] == 2
        assert about["unit"] == "pixel" and about["zunit"] == "um", "without a camera a pixel has no size"
        np.testing.assert_array_equal(file.asarray(), np.asarray(H)[:, 2, 1])
    with pytest.raises(InputError, match="position"):
        export(H, tmp_path / "one.tif", position=(3, 0))


def test_pixels_of_ht_lie_in_the_volume(tmp_path: Path) -> None:
    camera = preset("bench")
    H = matrix(camera=camera, depths=[900.0, 1000.0])
    export(H.T, tmp_path / "HT.tif")
    with tifffile.TiffFile(tmp_path / "HT.tif") as file:
        assert pixel_um(file) == pytest.approx(camera.step_um(1000.0), rel=1e-6)
        assert "HT" in str((file.imagej_metadata or {})["Info"])


def test_depths_that_are_not_even_are_said(tmp_path: Path) -> None:
    values = np.ones((3, 1, 1, 3, 3), np.float32)
    export(PSFMatrix(values, depths=[0.0, 10.0, 40.0]), tmp_path / "H.tif")
    with tifffile.TiffFile(tmp_path / "H.tif") as file:
        about: dict[str, Any] = file.imagej_metadata or {}
        assert about["spacing"] == 20.0 and "not evenly spaced" in about["Info"] and "z=40 um" in about["Labels"][2]


@pytest.mark.parametrize("dtype", ["float64", "int16"])
def test_other_numbers_are_ome_tiff(tmp_path: Path, dtype: str) -> None:
    H = matrix(dtype, camera=preset("bench"))
    export(H, tmp_path / "H.tif")
    with tifffile.TiffFile(tmp_path / "H.tif") as file:
        assert file.is_ome and not file.is_imagej
        assert file.series[0].axes == "TZYX"
        np.testing.assert_array_equal(_positions(file), np.asarray(H))
        root = ElementTree.fromstring(file.ome_metadata or "")
    space = {"o": root.tag[1:].partition("}")[0]}
    pixels = root.find(".//o:Pixels", space)
    assert pixels is not None and pixels.get("SizeZ") == "2" and pixels.get("SizeT") == "12"
    assert float(pixels.get("PhysicalSizeZ", "0")) == 55.0 and pixels.get("PhysicalSizeXUnit") == "µm"
    planes = pixels.findall("o:Plane", space)
    assert [float(p.get("PositionZ", "nan")) for p in planes[:2]] == [-20.0, 35.0]
    assert pixels.findall("o:Plane", space)[1].get("PositionZUnit") == "µm"
    with pytest.raises(InputError, match="values for TIFF"):
        export(matrix("int64"), tmp_path / "I.tif")
    assert not (tmp_path / "I.tif").exists()


def test_a_large_h_is_a_file_for_each_plane(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff_export, "ONE_FILE_BYTES", 1000)
    H = matrix()
    files = export_files(H, tmp_path / "H.tif")
    export(H, tmp_path / "H.tif")
    assert sorted(tmp_path.iterdir()) == files == [tmp_path / "H_z000.tif", tmp_path / "H_z001.tif"]
    for z, path in enumerate(files):
        with tifffile.TiffFile(path) as file:
            assert file.is_imagej and (file.imagej_metadata or {})["frames"] == 12
            np.testing.assert_array_equal(file.asarray().reshape(SHAPE[1:]), np.asarray(H)[z])
    assert export_files(H, tmp_path / "H.tif", (0, 0)) == [tmp_path / "H.tif"]


def _positions(file: tifffile.TiffFile) -> NDArray[Any]:
    return file.asarray().reshape(3, 4, 2, 5, 7).transpose(2, 0, 1, 3, 4)
