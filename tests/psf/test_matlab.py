"""What MATLAB, Octave and the codes written for them find in a `.mat` file, and the centre of a lens in H."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.psf import PSFMatrix, export, open_psf
from lfcal.psf._matlab import MatOptions, crop_index, mat_notes
from lfcal.psf.lens_centre import lens_centre_of, lens_centred

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


def test_order_of_axes_element_by_element(tmp_path: Path) -> None:
    """MATLAB's linear index runs fastest over s: H(s, t, x, y, z); rows first for codes that use imread."""
    export(matrix(), tmp_path / "H.mat", include_transpose=False, compress=False)
    values = padded(np.asarray(matrix()))
    with h5py.File(tmp_path / "H.mat") as file:
        flat = file["H"][...].ravel()
    ns, nt, nx, ny, _ = PADDED[::-1]
    for z, y, x, t, s in [(0, 0, 0, 0, 1), (1, 2, 3, 4, 6), (1, 0, 2, 3, 0)]:
        assert flat[s + ns * (t + nt * (x + nx * (y + ny * z)))] == values[z, y, x, t, s]
    export(matrix(), tmp_path / "R.mat", rows_first=True)
    with h5py.File(tmp_path / "R.mat") as file:
        np.testing.assert_array_equal(file["H"][...], values.transpose(0, 2, 1, 4, 3))
        np.testing.assert_array_equal(file["Nnum"][...], [[3], [4]])
        assert bytes(file["axisOrder"][:, 0].tolist()) == b"tsyxz"


def test_one_window_fits_rows_and_columns_and_leaves_out_exact_zeros_only(tmp_path: Path) -> None:
    """The codes crop by CAindex in both directions: a cutout that is not square would be cropped off its centre."""
    image = np.zeros((9, 9))
    image[4, 4] = 1
    assert crop_index(image) == (5, 5)
    image[2, 5] = 1e-300
    assert crop_index(image) == (3, 7)
    assert crop_index(np.zeros((5, 5))) == (3, 3)
    values = np.zeros((1, 3, 3, 5, 9), np.float32)
    values[..., 2, 4] = 1.0
    export(PSFMatrix(values), tmp_path / "H.mat")
    with h5py.File(tmp_path / "H.mat") as file:
        H, (first, last) = file["H"][...].T, file["CAindex"][:, 0].astype(int)
        window = H[first - 1 : last, first - 1 : last, 0, 0, 0]
        assert window.shape == (1, 1) and window[0, 0] == 1.0


def test_periods_that_the_codes_cannot_use_are_named() -> None:
    def said(ny: int, nx: int) -> str:
        return " ".join(mat_notes(PSFMatrix(np.ones((1, ny, nx, 3, 3)), depths=[-500.0], camera=preset("bench"))))

    assert "the period is 3 x 4; codes that require a square period" in said(3, 4)
    assert "odd Nnum" in said(4, 4) and "Nnum" not in said(3, 3)


# -- lens centre -------------------------------------------------------------------------------------------------------


Array = NDArray[Any]


def conv2_same(image: Array, kernel: Array) -> Array:
    """MATLAB's conv2(image, kernel, 'same'), by its definition."""
    rows, columns = kernel.shape
    full = np.zeros((image.shape[0] + rows - 1, image.shape[1] + columns - 1))
    for i, j in np.argwhere(image):
        full[i : i + rows, j : j + columns] += image[i, j] * kernel
    # MATLAB: the central part starts at ceil((kernel + 1) / 2), counted from 1
    top, left = -(-(rows + 1) // 2) - 1, -(-(columns + 1) // 2) - 1
    return full[top : top + image.shape[0], left : left + image.shape[1]]


def forward_project(H: Array, volume: Array, crops: Array) -> Array:
    """forwardProjectACC.m of Prevedel et al. 2014, line by line; ``H(i, j, aa, bb, cc)``, ``volume(i, j, cc)``."""
    n = H.shape[2]
    total = np.zeros(volume.shape[:2])
    for cc in range(volume.shape[2]):
        first, last = int(crops[cc, 0]), int(crops[cc, 1])
        for aa in range(1, n + 1):
            for bb in range(1, n + 1):
                space = np.zeros(volume.shape[:2])
                space[aa - 1 :: n, bb - 1 :: n] = volume[aa - 1 :: n, bb - 1 :: n, cc]
                total += conv2_same(space, H[first - 1 : last, first - 1 : last, aa - 1, bb - 1, cc])
    return total


def matlab(path: Path) -> dict[str, Array]:
    """Return the variables of a v7.3 file as MATLAB sees them: axes reversed."""
    with h5py.File(path) as file:
        return {name: np.asarray(data[...]).T for name, data in file.items()}


def lens_world(grid: tuple[int, int], n: int, light: Array) -> Array:
    """Light a sensor through lenses: the image of a point at pixel p is light[p - q] dimmed by distance to the lens.

    ``grid`` is a pixel with a lens's centre. Returned as K[p, q]: light at pixel q of a point imaged at p, on a ring of
    6 n pixels, so that the whole world repeats with n.
    """
    size = 6 * n
    K = np.zeros((size, size, size, size))
    half = len(light) // 2
    rows, columns = np.mgrid[:size, :size]
    d = [(a - g + n // 2) % n - n // 2 for a, g in zip((rows, columns), grid, strict=True)]
    dim = 1.0 / (1.0 + d[0] ** 2 + 0.5 * np.abs(d[1]) + 0.1 * d[1])
    for p in np.ndindex(size, size):
        for t, s in np.ndindex(*light.shape):
            q = (p[0] + t - half) % size, (p[1] + s - half) % size
            K[(*p, *q)] = light[t, s] * dim[q]
    return K


def h_of_world(K: Array, anchor: tuple[int, int], n: int, side: int) -> Array:
    """Return the H that a scan from pixel ``anchor`` on records."""
    size, half = K.shape[0], side // 2
    H = np.zeros((1, n, n, side, side))
    for y, x, t, s in np.ndindex(n, n, side, side):
        p = anchor[0] + y, anchor[1] + x
        H[0, y, x, t, s] = K[p[0] % size, p[1] % size, (p[0] + t - half) % size, (p[1] + s - half) % size]
    return H


def square_camera(n: int, pixels: int, offset_px: tuple[float, float] = (0.0, 0.0)) -> Camera:
    camera = preset("lfm_20x05")
    pixel = camera.sensor.pixel_um
    lattice = replace(
        camera.lattice, pitch_um=n * pixel, clear_um=None, offset_um=(offset_px[1] * pixel, offset_px[0] * pixel)
    )
    return replace(camera, lattice=lattice, sensor=replace(camera.sensor, shape=(pixels, pixels)))


@pytest.mark.parametrize(("n", "rows_first"), [pytest.param(3, True, marks=pytest.mark.long), (5, False)])
def test_the_reader_projects_as_the_world_does(tmp_path: Path, n: int, rows_first: bool) -> None:
    """An image rectified by the reader has a lens on pixel ceil(n/2) of each period; H from any anchor must fit it."""
    light = np.array([[0.0, 1.0, 0.5], [2.0, 4.0, 1.0], [0.25, 0.5, 3.0]])
    pixels = 6 * n + (1 - (6 * n) % 2)  # an odd sensor has a pixel in its middle, where the lens is
    lens = (pixels // 2, pixels // 2)
    K = lens_world(lens, n, light)
    anchor = (lens[0] + 4, lens[1] - 2)
    camera = square_camera(n, pixels)
    H = PSFMatrix(h_of_world(K, anchor, n, 3), camera=camera, anchor=anchor, depths=[5.0])
    export(H, tmp_path / "H.mat", lens_centred=True, rows_first=rows_first)
    found = matlab(tmp_path / "H.mat")
    middle = (n + 1) // 2 - 1
    np.testing.assert_allclose(found["lensCentre"], [[middle + 1, middle + 1]])

    # what the reader sees: pixel 0 of its image lies `middle` pixels before a lens
    first = (lens[0] - middle - n, lens[1] - middle - n)
    volume = np.zeros((3 * n, 3 * n, 1))
    rng = np.random.default_rng(n)
    volume[2:-2, 2:-2, 0] = rng.random((3 * n - 4, 3 * n - 4))
    world = np.zeros((3 * n, 3 * n))
    size = K.shape[0]
    index = [(np.arange(3 * n) + f) % size for f in first]
    for i, j in np.ndindex(3 * n, 3 * n):
        world += volume[i, j, 0] * K[index[0][i], index[1][j]][np.ix_(*index)]
    theirs = volume if rows_first else volume.transpose(1, 0, 2)
    seen = forward_project(found["H"], theirs, found["CAindex"])
    np.testing.assert_allclose(seen if rows_first else seen.T, world, atol=1e-6)

    # as it was scanned it does not fit
    export(H, tmp_path / "raw.mat", rows_first=rows_first)
    raw = matlab(tmp_path / "raw.mat")
    off = forward_project(raw["H"], theirs, raw["CAindex"])
    assert np.abs((off if rows_first else off.T) - world).max() > 0.1
    # unless the reader's frames are cropped from `anchor` on
    row, column = (int(v) - 1 for v in (raw["anchor"][0] if rows_first else raw["anchor"][0, ::-1]))
    assert (row, column) == anchor


def test_back_projection_is_the_transpose_of_it(tmp_path: Path) -> None:
    n = 3
    values = np.random.default_rng(0).random((2, n, n, 5, 5))
    H = PSFMatrix(values, camera=square_camera(n, 31), anchor=(4, 6), depths=[1.0, 2.0])
    export(H, tmp_path / "H.mat", lens_centred=True, rows_first=True)
    found = matlab(tmp_path / "H.mat")
    rng = np.random.default_rng(1)
    volume, image = rng.random((9, 9, 2)), rng.random((9, 9))
    ahead = forward_project(found["H"], volume, found["CAindex"])
    back = np.zeros_like(volume)
    for cc in range(2):  # backwardProjectACC.m
        back[..., cc] = forward_project(found["Ht"][..., cc : cc + 1], image[..., None], found["CAindex"][cc : cc + 1])
    assert (ahead * image).sum() == pytest.approx((volume * back).sum())


def test_a_half_pixel_is_reported_and_moved_on_request() -> None:
    """The microscope preset: its lenses are centred between pixels."""
    camera = preset("lfm_20x05")
    plan = ScanPlan.for_camera(camera, depths_um=[0.0], cutout=11)
    values = np.zeros(plan.shape, np.float32)
    values[..., 4:7, 4:7] = np.random.default_rng(2).random((*plan.shape[:3], 3, 3))
    H = PSFMatrix(values, camera=camera, anchor=plan.anchor, depths=plan.depths_um)
    lens = lens_centre_of(H)
    assert lens is not None and not lens.agrees and not lens.is_whole
    np.testing.assert_allclose(np.abs(lens.rest), 0.5)
    assert len(mat_notes(H)) == 1 and "8.50" in mat_notes(H)[0] and "--lens-centred" in mat_notes(H)[0]
    (left,) = mat_notes(H, MatOptions(lens_centred=True))
    assert "0.50" in left and "--interpolation cubic" in left
    assert mat_notes(H, MatOptions(lens_centred=True, interpolation="cubic")) == ()
    # linear interpolation by half a pixel is the mean of neighbours
    moved = lens_centred(H, lens, "linear")
    rolled = np.roll(values[0], lens.shift, (0, 1))
    step = int(np.sign(lens.rest[0])), int(np.sign(lens.rest[1]))
    mean = sum(np.roll(rolled, (-a * step[0], -b * step[1]), (2, 3)) for a in (0, 1) for b in (0, 1)) / 4
    np.testing.assert_allclose(moved.plane(0), mean, atol=1e-6)
    np.testing.assert_array_equal(moved[0, 3, 4], moved.plane(0)[3, 4])


def test_moved_patterns_fit_a_rectified_image() -> None:
    """Interpolating every image of a point is interpolating the image of all points."""
    n = 3
    camera = square_camera(n, 31, (0.3, -0.4))
    values = np.zeros((1, n, n, 9, 9))
    values[..., 3:6, 3:6] = np.random.default_rng(3).random((1, n, n, 3, 3))
    H = PSFMatrix(values, camera=camera, anchor=(9, 9), depths=[1.0])
    lens = lens_centre_of(H)
    assert lens is not None
    np.testing.assert_allclose(lens.rest, (0.3, -0.4), atol=1e-9)
    volume = np.zeros((27, 27, 1))
    volume[9:18, 9:18] = np.random.default_rng(4).random((9, 9, 1))
    crops = np.array([[1, 9]])
    plain = forward_project(lens_centred(H, lens).plane(0)[None].transpose(3, 4, 1, 2, 0), volume, crops)
    moved = forward_project(lens_centred(H, lens, "linear").plane(0)[None].transpose(3, 4, 1, 2, 0), volume, crops)
    down = 0.7 * plain + 0.3 * np.roll(plain, -1, 0)
    np.testing.assert_allclose(moved, 0.6 * down + 0.4 * np.roll(down, 1, 1), atol=1e-5)


def test_where_the_lens_is_unknown_it_is_said(tmp_path: Path) -> None:
    H = PSFMatrix(np.ones((1, 3, 3, 3, 3), np.float32))
    assert "not state where its lenses are" in mat_notes(H)[0]
    with pytest.raises(InputError, match="lens-centred export: expected an H with its camera"):
        export(H, tmp_path / "H.mat", lens_centred=True)
    assert not list(tmp_path.iterdir())
    export(H, tmp_path / "H.mat")
    assert not {"anchor", "lensCentre"} & set(matlab(tmp_path / "H.mat"))


def test_a_file_says_where_its_lens_is(tmp_path: Path) -> None:
    camera = square_camera(5, 101)
    H = PSFMatrix(np.ones((1, 5, 5, 3, 3), np.float32), camera=camera, anchor=(40, 42), depths=[1.0])
    for rows_first in (False, True):
        export(H, tmp_path / "H.mat", rows_first=rows_first)
        with open_psf(tmp_path / "H.mat") as back:
            assert back.anchor == (40, 42)
            lens = lens_centre_of(back)
            assert lens is not None and lens == lens_centre_of(H)
        (tmp_path / "H.mat").unlink()
    export(H, tmp_path / "H.mat", lens_centred=True)
    with open_psf(tmp_path / "H.mat") as back:
        lens = lens_centre_of(back)
        assert lens is not None and lens.agrees and mat_notes(back) == ()


def test_three_types_count_lenses_of_type_0_only() -> None:
    """A plan moved by a lenslet has its nearest lens of type 0 elsewhere than its nearest lens."""
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=3)
    pitch = camera.lattice.pitch_um / camera.sensor.pixel_um
    for step in (0, 1, 2):
        anchor = (plan.anchor[0], plan.anchor[1] + round(step * pitch))
        H = PSFMatrix(np.ones(plan.shape, np.float32), camera=camera, anchor=anchor, depths=plan.depths_um)
        lens = lens_centre_of(H)
        assert lens is not None
        at = np.array(anchor) + lens.position
        q, r = _indices(camera, at)
        assert camera.lattice.type_of(round(q), round(r)) == 0
        np.testing.assert_allclose((q, r), np.round((q, r)), atol=0.05)


def _indices(camera: Camera, pixel: Array) -> tuple[float, float]:
    point = camera.sensor_um(pixel) - np.array(camera.lattice.offset_um)
    q, r = point @ np.linalg.inv(camera.lattice.basis_um())
    return float(q), float(r)
