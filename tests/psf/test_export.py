from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.errors import FileFormatError, InputError, UnsafeFileError
from lfcal.psf import PSFMatrix, export, iter_export, open_psf
from lfcal.psf.matlab import crop_index

SHAPE = (2, 3, 4, 5, 7)


def matrix(dtype: str = "float32") -> PSFMatrix:
    values = np.arange(np.prod(SHAPE)).reshape(SHAPE).astype(dtype)
    return PSFMatrix(values, depths=[-20.0, 35.0])


@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npy"])
def test_what_is_written_reads_back(tmp_path: Path, suffix: str) -> None:
    H = matrix()
    export(H, tmp_path / f"H{suffix}")
    with open_psf(tmp_path / f"H{suffix}") as back:
        np.testing.assert_array_equal(np.asarray(back), np.asarray(H))
        if suffix != ".npy":
            np.testing.assert_allclose(back.depths, H.depths)


@pytest.mark.parametrize("compress", [True, False])
def test_the_bytes_of_a_mat_file_are_matlabs(tmp_path: Path, compress: bool) -> None:
    """Guard what Octave and MATLAB look at: the header, the classes, the reversed axes, the filters."""
    H = matrix("uint16")
    path = export(H, tmp_path / "H.mat", compress=compress)
    raw = path.read_bytes()
    assert raw[:19] == b"MATLAB 7.3 MAT-file"
    assert raw[116:124] == bytes(8) and raw[124:128] == b"\x00\x02IM"
    assert raw[512:520] == b"\x89HDF\r\n\x1a\n"
    assert raw[520] in (0, 2), "superblock of the default library version"
    with h5py.File(path) as file:
        assert set(file) == {"H", "Ht", "Nnum", "CAindex", "x3objspace"}
        data = file["H"]
        assert data.shape == SHAPE, "HDF5 (z, y, x, t, s) is MATLAB (s, t, x, y, z)"
        assert data.attrs["MATLAB_class"] == b"uint16"
        names = {data.id.get_create_plist().get_filter(k)[0] for k in range(data.id.get_create_plist().get_nfilters())}
        assert names <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
        np.testing.assert_array_equal(data[...], np.asarray(H))
        np.testing.assert_array_equal(file["Ht"][...], np.asarray(H.T))
        assert file["Nnum"].attrs["MATLAB_class"] == b"double"
        np.testing.assert_array_equal(file["Nnum"][...], [[4], [3]])  # MATLAB: [nx ny]
        np.testing.assert_allclose(file["x3objspace"][...].ravel(), [-20e-6, 35e-6])
        assert file["CAindex"].shape == (2, 2)
        np.testing.assert_array_equal(file["CAindex"][...], [[1, 1], [5, 5]])


def test_matlab_order_element_by_element(tmp_path: Path) -> None:
    """MATLAB's linear index runs fastest over s: H(s, t, x, y, z)."""
    export(matrix(), tmp_path / "H.mat", include_transpose=False, compress=False)
    values = np.asarray(matrix())
    with h5py.File(tmp_path / "H.mat") as file:
        flat = file["H"][...].ravel()
        ns, nt, nx, ny, _ = SHAPE[::-1]
        for z, y, x, t, s in [(0, 0, 0, 0, 1), (1, 2, 3, 4, 6), (1, 0, 2, 3, 0)]:
            linear = s + ns * (t + nt * (x + nx * (y + ny * z)))
            assert flat[linear] == values[z, y, x, t, s]


def test_rows_first_for_codes_that_use_imread(tmp_path: Path) -> None:
    export(matrix(), tmp_path / "H.mat", rows_first=True)
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_array_equal(file["H"][...], np.asarray(matrix()).transpose(0, 2, 1, 4, 3))
        np.testing.assert_array_equal(file["Nnum"][...], [[3], [4]])


def test_crop_index_leaves_out_exact_zeros_only() -> None:
    image = np.zeros((9, 9))
    image[4, 4] = 1
    assert crop_index(image) == (5, 5)
    image[2, 5] = 1e-300
    assert crop_index(image) == (3, 7)
    assert crop_index(np.zeros((5, 5))) == (3, 3)


def test_tiff_stacks(tmp_path: Path) -> None:
    H = matrix()
    export(H, tmp_path / "psf.tif")
    for z in range(2):
        pages = tifffile.imread(tmp_path / f"psf_z{z:03d}.tif")
        np.testing.assert_array_equal(pages.reshape(SHAPE[1:]), np.asarray(H)[z])
    export(H, tmp_path / "one.tif", position=(2, 1))
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "one.tif"), np.asarray(H)[:, 2, 1])
    with pytest.raises(InputError, match="position"):
        export(H, tmp_path / "one.tif", position=(3, 0))


def test_the_view_exports_as_ht(tmp_path: Path) -> None:
    export(matrix().T, tmp_path / "HT.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "HT.npy", mmap_mode="r"), np.asarray(matrix().T))


def test_unknown_format_and_cancel(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="export format"):
        export(matrix(), tmp_path / "H.xyz")
    for suffix in (".mat", ".npy", ".h5"):
        work = iter_export(matrix(), tmp_path / f"H{suffix}")
        next(work)
        work.close()
    assert list(tmp_path.iterdir()) == []


def test_import_of_other_codes_files(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 3, 5, 5)).astype("f4")
    with h5py.File(tmp_path / "single.mat", "w", userblock_size=512) as file:
        file["H"] = values  # MATLAB drops the axis of a single plane
    np.testing.assert_array_equal(np.asarray(open_psf(tmp_path / "single.mat")), values[None])
    (tmp_path / "old.mat").write_bytes(b"MATLAB 5.0 MAT-file, Platform: PCWIN64" + bytes(200))
    with pytest.raises(FileFormatError, match=r"v7\.3"):
        open_psf(tmp_path / "old.mat")
    with h5py.File(tmp_path / "link.mat", "w", userblock_size=512) as file:
        file["H"] = h5py.ExternalLink("/etc/passwd", "/H")
    with pytest.raises(UnsafeFileError):
        open_psf(tmp_path / "link.mat")
    with h5py.File(tmp_path / "flat.mat", "w", userblock_size=512) as file:
        file["H"] = np.zeros((3, 3))
    with pytest.raises(FileFormatError, match="5 axes"):
        open_psf(tmp_path / "flat.mat")
    with h5py.File(tmp_path / "none.mat", "w", userblock_size=512) as file:
        file["PSF"] = values
    with pytest.raises(FileFormatError, match="only PSF"):
        open_psf(tmp_path / "none.mat")


def test_options_of_another_format_are_refused(tmp_path: Path) -> None:
    for name, options in {
        "H.npy": {"compress": False},
        "H.mat": {"position": (0, 0)},
        "H.h5": {"rows_first": True},
        "H.tif": {"include_transpose": False},
    }.items():
        with pytest.raises(InputError, match=f"options of {Path(name).suffix} files: expected .*leave it out"):
            export(matrix(), tmp_path / name, **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
    export(matrix(), tmp_path / "H.h5", compress=False, dtype="uint16")
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["H"].dtype == np.uint16 and file["H"].compression is None
