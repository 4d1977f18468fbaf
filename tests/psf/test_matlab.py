"""What MATLAB, Octave and the codes written for them find in a ``.mat`` file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, export
from lfcal.psf._matlab import crop_index, mat_notes

SHAPE = (2, 3, 4, 5, 7)
PADDED = (2, 3, 4, 7, 7)


def matrix(dtype: str = "float32") -> PSFMatrix:
    values = np.arange(np.prod(SHAPE)).reshape(SHAPE).astype(dtype)
    return PSFMatrix(values, depths=[-20.0, 35.0])


def padded(values: NDArray[Any]) -> NDArray[Any]:
    """Square: a row of zeros above and below."""
    return np.pad(values, [(0, 0)] * 3 + [(1, 1), (0, 0)])


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
        assert set(file) == {"H", "Ht", "Nnum", "CAindex", "x3objspace", "axisOrder", "cutout"}
        data = file["H"]
        assert data.shape == PADDED, "HDF5 (z, y, x, t, s) is MATLAB (s, t, x, y, z), square"
        assert data.attrs["MATLAB_class"] == b"uint16"
        names = {data.id.get_create_plist().get_filter(k)[0] for k in range(data.id.get_create_plist().get_nfilters())}
        assert names <= {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
        np.testing.assert_array_equal(data[...], padded(np.asarray(H)))
        np.testing.assert_array_equal(file["Ht"][...], padded(np.asarray(H.T)))
        assert file["Nnum"].attrs["MATLAB_class"] == b"double"
        np.testing.assert_array_equal(file["Nnum"][...], [[4], [3]])  # MATLAB: [nx ny]
        np.testing.assert_allclose(file["x3objspace"][...].ravel(), [-20e-6, 35e-6])
        assert file["CAindex"].shape == (2, 2)
        np.testing.assert_array_equal(file["CAindex"][...], [[1, 1], [7, 7]])
        np.testing.assert_array_equal(file["cutout"][...], [[7], [5]])  # MATLAB: [ns nt]
        assert file["axisOrder"].attrs["MATLAB_class"] == b"char" and file["axisOrder"].attrs["MATLAB_int_decode"] == 2
        assert file["axisOrder"].shape == (5, 1) and bytes(file["axisOrder"][:, 0].tolist()) == b"stxyz"


def test_matlab_order_element_by_element(tmp_path: Path) -> None:
    """MATLAB's linear index runs fastest over s: H(s, t, x, y, z)."""
    export(matrix(), tmp_path / "H.mat", include_transpose=False, compress=False)
    values = padded(np.asarray(matrix()))
    with h5py.File(tmp_path / "H.mat") as file:
        flat = file["H"][...].ravel()
        ns, nt, nx, ny, _ = PADDED[::-1]
        for z, y, x, t, s in [(0, 0, 0, 0, 1), (1, 2, 3, 4, 6), (1, 0, 2, 3, 0)]:
            linear = s + ns * (t + nt * (x + nx * (y + ny * z)))
            assert flat[linear] == values[z, y, x, t, s]


def test_rows_first_for_codes_that_use_imread(tmp_path: Path) -> None:
    export(matrix(), tmp_path / "H.mat", rows_first=True)
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_array_equal(file["H"][...], padded(np.asarray(matrix())).transpose(0, 2, 1, 4, 3))
        np.testing.assert_array_equal(file["Nnum"][...], [[3], [4]])
        assert bytes(file["axisOrder"][:, 0].tolist()) == b"tsyxz"


def test_crop_index_leaves_out_exact_zeros_only() -> None:
    image = np.zeros((9, 9))
    image[4, 4] = 1
    assert crop_index(image) == (5, 5)
    image[2, 5] = 1e-300
    assert crop_index(image) == (3, 7)
    assert crop_index(np.zeros((5, 5))) == (3, 3)


def test_one_window_fits_rows_and_columns_of_any_cutout(tmp_path: Path) -> None:
    """The codes crop by CAindex in both directions: a cutout that is not square would be cropped off its centre."""
    values = np.zeros((1, 3, 3, 5, 9), np.float32)
    values[..., 2, 4] = 1.0
    export(PSFMatrix(values), tmp_path / "H.mat")
    with h5py.File(tmp_path / "H.mat") as file:
        H, (first, last) = file["H"][...].T, file["CAindex"][:, 0].astype(int)
        window = H[first - 1 : last, first - 1 : last, 0, 0, 0]
        assert window.shape == (1, 1) and window[0, 0] == 1.0


def test_periods_that_the_codes_cannot_use_are_told() -> None:
    def said(ny: int, nx: int) -> str:
        return " ".join(mat_notes(PSFMatrix(np.ones((1, ny, nx, 3, 3)), depths=[-500.0], camera=preset("bench"))))

    assert "the period is 3 x 4; codes that require a square period" in said(3, 4)
    assert "odd Nnum" in said(4, 4) and "Nnum" not in said(3, 3)
