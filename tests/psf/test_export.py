"""Exports of H: formats and their options, in units, TIFF for ImageJ, and the sides of pixels and voxels."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.psf import PSFMatrix, _export, export, iter_export, make, open_psf, save, save_regions
from lfcal.psf import _tiff_export as tiff_export
from lfcal.psf._export import ExportOptions, export_files, export_notes
from lfcal.psf._matlab import MatOptions, mat_notes
from lfcal.psf.voxels import pixel_um, voxel_um
from lfcal.reconstruct.volumes import save_volume
from lfcal.work import RunChoice, parts_folder
from tests.psf.test_joining import contents

SHAPE = (2, 3, 4, 5, 7)


def matrix(dtype: str = "float32") -> PSFMatrix:
    values = np.arange(np.prod(SHAPE)).reshape(SHAPE).astype(dtype)
    return PSFMatrix(values, depths=[-20.0, 35.0])


def test_what_is_written_reads_back(tmp_path: Path) -> None:
    H = matrix()
    for suffix in (".h5", ".mat", ".npy"):
        export(H, tmp_path / f"H{suffix}")
        with open_psf(tmp_path / f"H{suffix}") as back:
            np.testing.assert_array_equal(np.asarray(back), np.asarray(H))
            if suffix != ".npy":
                np.testing.assert_allclose(back.depths, H.depths)
    export(H.T, tmp_path / "HT.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "HT.npy", mmap_mode="r"), np.asarray(H.T))


def test_a_mat_file_gets_its_options_and_notes_and_others_do_not() -> None:
    given = ExportOptions(compress=False, rows_first=True, lens_centred=True, dtype="uint16", position=(1, 2))
    assert given.mat == MatOptions(compress=False, rows_first=True, lens_centred=True)
    assert ExportOptions().mat == MatOptions()
    assert export_notes(matrix(), "H.MAT", ExportOptions()) == mat_notes(matrix()) != ()
    for name in ("H.h5", "H.npy", "H.tif"):
        assert export_notes(matrix(), name, ExportOptions()) == ()


def test_unknown_format_and_cancel(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="export format"):
        export(matrix(), tmp_path / "H.xyz")
    for suffix in (".mat", ".npy", ".h5"):
        work = iter_export(matrix(), tmp_path / f"H{suffix}")
        next(work)
        work.close()
    assert list(tmp_path.iterdir()) == []


def test_options_of_another_format_are_refused(tmp_path: Path) -> None:
    others = {
        **{"H.npy": {"compress": False}, "H.mat": {"position": (0, 0)}, "H.h5": {"rows_first": True}},
        **{"H.tif": {"include_transpose": False}, "H.tiff": {"lens_centred": True}},
    }
    for name, options in others.items():
        with pytest.raises(InputError, match=f"options of {Path(name).suffix} files: expected .*leave this option out"):
            export(matrix(), tmp_path / name, **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
    export(matrix(), tmp_path / "H.h5", compress=False, dtype="rounded")
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["H"].dtype == np.float32 and file["step"][...].all() and file["H"].compression is None


# -- in units ----------------------------------------------------------------------------------------------------------


RESUMED = RunChoice("threads", 1, begun="resume")

WAYS = [
    (".h5", ExportOptions(), False),
    (".h5", ExportOptions(dtype="rounded", compress=False), True),
    (".npy", ExportOptions(), False),
    (".npy", ExportOptions(), True),
    (".mat", ExportOptions(), False),
    (".mat", ExportOptions(compress=False, include_transpose=False, rows_first=True), False),
    (".mat", ExportOptions(lens_centred=True, interpolation="cubic"), False),
    (".tif", ExportOptions(), False),
]


@pytest.fixture
def psf(tmp_path: Path) -> Path:
    values = np.random.default_rng(5).random((3, 3, 4, 5, 7)).astype(np.float32)
    path = tmp_path / "H.h5"
    save(PSFMatrix(values, depths=[10.0, 30.0, 45.0], camera=preset("bench"), anchor=(100.0, 90.0)), path)
    return path


def stored(path: Path) -> Any:
    """Return the content of a file; the header of a MATLAB file contains the time."""
    return contents(path) if h5py.is_hdf5(path) else path.read_bytes()


def exported(psf: Path, path: Path, options: ExportOptions, turned: bool = False, run: RunChoice | None = None) -> Path:
    with open_psf(psf) as H:
        return drain(iter_export(H.T if turned else H, path, **options.given(), run=run))


@pytest.mark.parametrize(("suffix", "options", "turned"), WAYS)
def test_the_same_file_in_units_and_without(
    psf: Path, tmp_path: Path, suffix: str, options: ExportOptions, turned: bool
) -> None:
    expected = stored(exported(psf, tmp_path / f"one{suffix}", options, turned))
    out = tmp_path / f"two{suffix}"
    assert exported(psf, out, options, turned, RunChoice("threads", 1)) == out
    assert stored(out) == expected and not parts_folder(out).exists()


@pytest.mark.parametrize(("suffix", "options", "turned"), WAYS[:-1:2])
def test_a_stopped_export_resumes_with_what_was_done(
    psf: Path, tmp_path: Path, suffix: str, options: ExportOptions, turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = stored(exported(psf, tmp_path / f"one{suffix}", options, turned))
    # an H file is made as every matrix is
    module: Any = make if suffix == ".h5" else _export
    out, made, real = tmp_path / f"two{suffix}", list[str](), module.do_plane
    full = True

    def task(arguments: Any, path: Path, workers: int) -> Any:
        if full and made:
            raise StorageError("two: the disk is full; make room")
        made.append(f"{arguments.get('name', 'H')}{arguments['z']}")
        return (yield from real(arguments, path, workers))

    monkeypatch.setattr(module, "do_plane", task)
    task.__name__ = "do_plane"
    with pytest.raises(StorageError, match="disk is full"):
        exported(psf, out, options, turned, RESUMED)
    assert made == ["H0"] and not out.exists()
    full = False
    exported(psf, out, options, turned, RESUMED)
    assert len(made) == len(set(made)) and stored(out) == expected and not parts_folder(out).exists()


def test_what_an_export_refuses_is_refused_before_anything_is_made(psf: Path, tmp_path: Path) -> None:
    bad = ((tmp_path / "x.foo", ExportOptions()), (tmp_path / "x.npy", ExportOptions(compress=True)))
    for path, options in (*bad, (psf, ExportOptions())):
        with pytest.raises(InputError):
            exported(psf, path, options, run=RESUMED)
    for suffix in (".h5", ".mat", ".npy"):
        with pytest.raises(InputError, match="a matrix opened from a file"):
            drain(iter_export(PSFMatrix(np.ones((1, 2, 2, 3, 3))), tmp_path / f"x{suffix}", run=RESUMED))
    assert [path.name for path in tmp_path.iterdir()] == ["H.h5"]


def test_another_region_is_exported_in_units(psf: Path, tmp_path: Path) -> None:
    """Units of an export opened the first region of a file, whichever was given."""
    with open_psf(psf) as H:
        save_regions({"centre": H, "edge": PSFMatrix(2 * H[:], depths=H.depths)}, tmp_path / "field.h5")
    for suffix in (".mat", ".npy"):
        with open_psf(tmp_path / "field.h5", region="edge") as edge:
            drain(iter_export(edge, tmp_path / f"one{suffix}"))
            drain(iter_export(edge, tmp_path / f"two{suffix}", run=RunChoice("threads", 1)))
        assert stored(tmp_path / f"two{suffix}") == stored(tmp_path / f"one{suffix}")


# -- TIFF --------------------------------------------------------------------------------------------------------------


def images(dtype: str = "float32", **more: Any) -> PSFMatrix:
    return PSFMatrix(np.asarray(matrix(dtype)), **{"depths": [-20.0, 35.0], **more})


def stored_pixel_um(file: tifffile.TiffFile) -> float:
    count, length = file.pages[0].tags["XResolution"].value
    return float(length / count)


@pytest.mark.parametrize("dtype", ["float32", "uint16", "uint8"])
def test_imagej_opens_h_as_a_hyperstack(tmp_path: Path, dtype: str) -> None:
    camera = preset("bench")
    H = images(dtype, camera=camera)
    assert export(H, tmp_path / "H.tif") == tmp_path / "H.tif" == export_files(H, tmp_path / "H.tif")[0]
    with tifffile.TiffFile(tmp_path / "H.tif") as file:
        assert file.is_imagej and not file.is_ome
        about: dict[str, Any] = file.imagej_metadata or {}
        assert (about["slices"], about["frames"], about["hyperstack"]) == (2, 12, True)
        assert about["unit"] == "um" and about["spacing"] == pytest.approx(55.0)
        assert stored_pixel_um(file) == pytest.approx(camera.sensor.pixel_um, rel=1e-6)
        series = file.series[0]
        assert series.axes == "TZYX" and series.shape == (12, 2, 5, 7)
        stack = series.asarray().reshape(3, 4, 2, 5, 7)
        np.testing.assert_array_equal(stack.transpose(2, 0, 1, 3, 4), np.asarray(H))
        # pages in the order of the file: depth first, then the next position
        assert about["Labels"][:3] == ["z=-20 um y=0 x=0", "z=35 um y=0 x=0", "z=-20 um y=0 x=1"]
        np.testing.assert_array_equal(file.pages[3].asarray(), np.asarray(H)[1, 0, 1])
        assert "y slow, x fast" in about["Info"] and "-20 35" in about["Info"]


def test_one_position_is_a_stack_over_depth(tmp_path: Path) -> None:
    H = images()
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
    H = images(camera=camera, depths=[900.0, 1000.0])
    export(H.T, tmp_path / "HT.tif")
    with tifffile.TiffFile(tmp_path / "HT.tif") as file:
        assert stored_pixel_um(file) == pytest.approx(camera.step_um(1000.0), rel=1e-6)
        assert "HT" in str((file.imagej_metadata or {})["Info"])


def test_depths_that_are_not_even_are_said(tmp_path: Path) -> None:
    export(PSFMatrix(np.ones((3, 1, 1, 3, 3), np.float32), depths=[0.0, 10.0, 40.0]), tmp_path / "H.tif")
    with tifffile.TiffFile(tmp_path / "H.tif") as file:
        about: dict[str, Any] = file.imagej_metadata or {}
        assert about["spacing"] == 20.0 and "not evenly spaced" in about["Info"] and "z=40 um" in about["Labels"][2]


@pytest.mark.parametrize("dtype", ["float64", "int16"])
def test_other_numbers_are_ome_tiff(tmp_path: Path, dtype: str) -> None:
    H = images(dtype, camera=preset("bench"))
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
        export(images("int64"), tmp_path / "I.tif")
    assert not (tmp_path / "I.tif").exists()


def test_a_large_h_is_a_file_for_each_plane(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff_export, "ONE_FILE_BYTES", 1000)
    H = images()
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


# -- sides of pixels and voxels ----------------------------------------------------------------------------------------


SCALE = (0.8, 0.5)


def resampled() -> PSFMatrix:
    values = np.random.default_rng(1).random((2, 3, 3, 9, 9), np.float32)
    about = {"cutout": {"interpolation": "cubic", "scale": SCALE}}
    return PSFMatrix(values, depths=[-2.0, 2.0], camera=preset("lfm_60x12"), provenance=about)


def resolution(path: Path) -> tuple[float, float]:
    """Return (rows, columns) in µm as the TIFF's tags state them."""
    with tifffile.TiffFile(path) as file:
        tags = file.pages.first.tags
        y, x = (tags[name].value for name in ("YResolution", "XResolution"))
    return y[1] / y[0], x[1] / x[0]


def test_sides_of_pixels_and_voxels_follow_the_scale_of_each_axis_in_every_file(tmp_path: Path) -> None:
    H = resampled()
    assert pixel_um(H) == pytest.approx((6.5 / 0.8, 6.5 / 0.5))
    assert voxel_um(H) == pytest.approx((6.5 / 60 / 0.8, 6.5 / 60 / 0.5))
    assert pixel_um(PSFMatrix(H.plane(0)[None])) is None
    save_volume(tmp_path / "v.tif", np.ones((2, 9, 9)), depths_um=H.depths, voxel_um=voxel_um(H))
    assert resolution(tmp_path / "v.tif") == pytest.approx(voxel_um(H), rel=1e-4)
    export(H, tmp_path / "h.tif")
    assert resolution(export_files(H, tmp_path / "h.tif")[0]) == pytest.approx(pixel_um(H), rel=1e-4)
    export(H, tmp_path / "h.mat")
    with h5py.File(tmp_path / "h.mat") as file:
        columns, rows = file["voxelSize"][()].ravel() * 1e6
    assert (rows, columns) == pytest.approx(voxel_um(H))
