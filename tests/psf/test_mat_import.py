"""H out of files of other codes, written here from the sources of those codes; no real file was at hand."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.signal import convolve2d

from lfcal.base.errors import FileFormatError, InputError, UnsafeFileError
from lfcal.psf import PSFMatrix, export, open_psf, save
from lfcal.psf.lens_centre import lens_centre_of
from lfcal.psf.opening import opening_notes
from lfcal.reconstruct import Projector
from tests.psf.test_matlab import forward_project

Array = NDArray[Any]


def save_v73(path: Path, **variables: Any) -> Path:
    """Write what MATLAB's save(..., '-v7.3') leaves: HDF5 behind 512 bytes, axes reversed."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            file[name] = np.atleast_2d(np.asarray(value)).T
            file[name].attrs["MATLAB_class"] = np.bytes_(b"double")
    return path


def prevedel(path: Path, H: Array, crops: Array | None = None, **more: Any) -> Path:
    """computePSF_GUI.m, its last line: the variables by which such a file is known among them."""
    n, depths = H.shape[2], np.arange(H.shape[4]) * 2e-6 - 4e-6
    crops = np.array([[1, H.shape[0]]] * H.shape[4]) if crops is None else crops
    return save_v73(path, H=H, CAindex=crops, Nnum=n, x3objspace=depths, OSR=3, x1objspace=np.arange(n), **more)


@pytest.mark.parametrize(("side", "crops"), [(6, None), (5, [[1, -1], [2, -2], [3, 4]])])
def test_h_projects_as_in_their_code(tmp_path: Path, side: int, crops: list[list[int]] | None) -> None:
    """Rows first, planes cropped by CAindex, also to windows off the centre or even; patterns even or odd."""
    rng = np.random.default_rng(side)
    H = rng.random((side, side, 3, 3, 3))
    windows = None if crops is None else np.array([(a, b if b > 0 else side + 1 + b) for a, b in crops])
    path = prevedel(tmp_path / "H.mat", H, windows)
    volume = rng.random((12, 9, 3))
    theirs = forward_project(H, volume, np.array([[1, side]] * 3) if windows is None else windows)
    with open_psf(path) as found:
        assert found.shape == (3, 3, 3, 5 if side == 5 else 7, 5 if side == 5 else 7)
        np.testing.assert_allclose(found.depths, [-4.0, -2.0, 0.0], atol=1e-9)
        ours = Projector(found, (12, 9), method="direct", dtype=np.float64).forward(volume.transpose(2, 0, 1))
        np.testing.assert_allclose(ours, theirs, rtol=1e-5)
        np.testing.assert_array_equal(found[1, 2, 1], found.plane(1)[2, 1])
        assert "rows first" in " ".join(found.provenance["notes"])
        lens = lens_centre_of(found)
        assert lens is not None and lens.position == (1.0, 1.0)
        assert found.path == str(path)
        np.testing.assert_allclose(np.asarray(found.T.T), np.asarray(found))


def test_a_quarter_of_the_positions_is_mirrored(tmp_path: Path) -> None:
    """fast-light-field saves positions up to the middle (ReducedMatrix); the rest are mirror images."""
    rng = np.random.default_rng(0)
    quarter = rng.random((5, 5, 2, 2, 1))
    # H of a lens mirrored in its middle: the middle position is its own mirror image
    quarter[:, :, 1] = (quarter[:, :, 1] + quarter[::-1, :, 1]) / 2
    quarter[:, :, :, 1] = (quarter[:, :, :, 1] + quarter[:, ::-1, :, 1]) / 2
    full = np.empty((5, 5, 3, 3, 1))
    for aa in range(3):
        for bb in range(3):
            one = quarter[:, :, min(aa, 2 - aa), min(bb, 2 - bb)]
            full[:, :, aa, bb] = one[:: -1 if aa == 2 else 1, :: -1 if bb == 2 else 1]
    with h5py.File(tmp_path / "H.mat", "w") as file:  # no 512 bytes: written by h5py
        file["H"] = quarter.T.astype("f4")
        file["CAindex"], file["ReducedMatrix"], file["x3objspace"] = np.array([[1, 5]]), True, [3e-6]
    with open_psf(tmp_path / "H.mat") as found:
        assert found.shape == (1, 3, 3, 5, 5) and found.depths[0] == pytest.approx(3.0)
        np.testing.assert_allclose(np.asarray(found)[0], full[..., 0].transpose(2, 3, 0, 1), rtol=1e-6)
        for y, x in np.ndindex(3, 3):
            np.testing.assert_array_equal(found[0, y, x], found.plane(0)[y, x])
        assert "mirrored" in " ".join(found.provenance["notes"])


def as_meant(H: Array) -> Array:
    """Return MATLAB's ``H(t, s, y, x, z)`` in lfcal's order."""
    return H.transpose(4, 2, 3, 0, 1)


def test_nnum_or_caindex_means_rows_first(tmp_path: Path) -> None:
    """A MATLAB user's own file: no variable of Prevedel's window, but the terms of that family."""
    H, path = np.random.default_rng(1).random((5, 5, 3, 3, 2)), tmp_path / "H.mat"
    crops = {"CAindex": [[1, 5], [1, 5]]}
    for known in ({"Nnum": 3}, crops, {"Nnum": 3, **crops}):
        save_v73(path, H=H, x3objspace=[-1e-6, 1e-6], **known)
        with open_psf(path) as found:
            np.testing.assert_array_equal(np.asarray(found), as_meant(H))
            (note,) = opening_notes(found)
            assert "H(t, s, y, x, z), rows first" in note and next(iter(known)) in note and "columns-first" in note
        with open_psf(path, mat_order="columns-first") as found:
            np.testing.assert_array_equal(np.asarray(found), as_meant(H).transpose(0, 2, 1, 4, 3))
            assert opening_notes(found) == ("read as H(s, t, x, y, z), columns first, as requested",)


def test_an_order_that_nothing_states_is_said_and_can_be_stated(tmp_path: Path) -> None:
    H = np.random.default_rng(2).random((5, 5, 3, 3, 2))
    path = save_v73(tmp_path / "H.mat", H=H)
    with open_psf(path) as found:
        np.testing.assert_array_equal(np.asarray(found), as_meant(H).transpose(0, 2, 1, 4, 3))
        (note,) = opening_notes(found)
        assert "columns first, because nothing in the file states" in note and "--mat-order rows-first" in note
    with open_psf(path, mat_order="rows-first") as found:
        np.testing.assert_array_equal(np.asarray(found), as_meant(H))
        np.testing.assert_array_equal(np.asarray(pickle.loads(pickle.dumps(found))), as_meant(H))
    with pytest.raises(InputError, match=r"expected rows-first or columns-first, got tsyxz"):
        open_psf(path, mat_order="tsyxz")


@pytest.mark.parametrize("rows_first", [False, True])
def test_a_file_that_states_its_order_is_not_read_in_another(tmp_path: Path, rows_first: bool) -> None:
    H = np.random.default_rng(3).random((2, 3, 3, 5, 5)).astype(np.float32)
    path = export(PSFMatrix(H), tmp_path / "H.mat", rows_first=rows_first)
    own, other = ("rows-first", "columns-first") if rows_first else ("columns-first", "rows-first")
    with open_psf(path, mat_order=own) as found:
        np.testing.assert_array_equal(np.asarray(found), H)
        assert opening_notes(found)[0].endswith("as its axisOrder states")
    with pytest.raises(InputError, match=f"order of its axes: expected {own}, as its axisOrder states, got {other}"):
        open_psf(path, mat_order=other)


def test_what_applies_to_another_format_or_name_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "H.npy", np.ones((1, 2, 2, 3, 3)))
    save(PSFMatrix(np.ones((1, 2, 2, 3, 3))), tmp_path / "H.h5")
    for name in ("H.npy", "H.h5"):
        with pytest.raises(InputError, match=r"expected a \.mat file"):
            open_psf(tmp_path / name, mat_order="rows-first")
    with pytest.raises(InputError, match="region: expected an lfcal H file"):
        open_psf(tmp_path / "H.npy", region="edge")
    with pytest.raises(InputError, match="checksums: expected an lfcal H file"):
        open_psf(tmp_path / "H.npy", check=True)
    prevedel(tmp_path / "m.h5", np.ones((3, 3, 3, 3, 1)))
    with pytest.raises(FileFormatError, match=r"got an HDF5 file of another kind; rename it to \.mat"):
        open_psf(tmp_path / "m.h5")
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file.create_group("optics")
    with pytest.raises(FileFormatError, match=r"rename it to \.lfc"):
        open_psf(tmp_path / "c.h5")


def mat(path: Path, write: Callable[[h5py.File], object]) -> Path:
    """Write a v7.3 file of any content."""
    with h5py.File(path, "w", userblock_size=512) as file:
        write(file)
    return path


def sparse_h(file: h5py.File) -> None:
    """Write a sparse matrix as MATLAB does: a group with its rows in the attribute MATLAB_sparse."""
    group = file.create_group("H")
    group.attrs["MATLAB_class"] = np.bytes_(b"double")
    group.attrs["MATLAB_sparse"] = np.uint64(25)
    group["data"], group["ir"], group["jc"] = np.ones(2), np.zeros(2, np.uint64), np.arange(3, dtype=np.uint64)


def cells(*made: Callable[[h5py.File], Any]) -> Callable[[h5py.File], None]:
    """Return what writes a cell array H of references."""

    def write(file: h5py.File) -> None:
        refs = np.empty((1, 1, len(made)), h5py.ref_dtype)
        for k, make in enumerate(made):
            refs[0, 0, k] = make(file).ref
        file.create_dataset("H", data=refs, dtype=h5py.ref_dtype).attrs["MATLAB_class"] = np.bytes_(b"cell")

    return write


def sparse_cell(file: h5py.File) -> Any:
    group = file.create_group("#refs#/a")
    group.attrs["MATLAB_sparse"] = np.uint64(5)
    group["jc"], group["ir"], group["data"] = np.array([0, 1], "u8"), np.array([7], "u8"), np.ones(1)
    return group


def numbers_as_cells(file: h5py.File) -> None:
    file["H"] = np.zeros((2, 3, 3, 4), np.uint64)
    file["H"].attrs["MATLAB_class"] = np.bytes_(b"cell")


def filled(name: str, value: Any, order: bool = True) -> Callable[[h5py.File], None]:
    """Return what writes an H, and a variable that does not fit it."""

    def write(file: h5py.File) -> None:
        file["H"], file[name] = np.ones((1, 3, 3, 5, 5), "f4"), value
        if order:
            file["axisOrder"] = np.array([[ord(c)] for c in "stxyz"], np.uint16)

    return write


def variable(name: str, *shape: int) -> Callable[[h5py.File], None]:
    return lambda file: file.__setitem__(name, np.ones(shape))


REFUSED: list[tuple[Callable[[h5py.File], object], str]] = [
    (sparse_h, r"expected a full numeric array, got a sparse matrix; .*full\(H\)"),
    # an H of another name is found and named
    (
        variable("psf/H", 2, 3, 3, 5, 5),
        r"expected a variable H, or PSF .*, got psf/H with 5 axes; in MATLAB: H = psf\.H",
    ),
    (variable("LFpsf", 2, 3, 3, 5, 5), r"got LFpsf with 5 axes; in MATLAB: H = LFpsf; save"),
    (variable("psf/wavelength", 3), "got no array of 3 to 5 axes; in MATLAB, with the patterns as H: save"),
    (variable("PSF", 3, 3, 5, 5), "got PSF with 4 axes"),
    (variable("H", 3, 3), "5 axes"),
    # cell arrays of other programs
    (numbers_as_cells, "expected up to 1048576 references"),
    (
        cells(*(lambda file, k=k: file.create_dataset(f"#refs#/{k}", data=np.ones((5, 5 + k))) for k in range(2))),
        r"patterns of one size, got \(5, 5\) and \(6, 5\)",
    ),
    (cells(sparse_cell), "rows and columns that do not fit"),
    # crafted variables
    (filled("axisOrder", np.array([[65]], np.uint16), order=False), "axisOrder"),
    (filled("cutout", [[7.0], [5.0]]), "cutout"),
    (filled("lensCentre", [[1.0]]), "lensCentre"),
    (filled("anchor", [[np.nan], [1.0]]), "anchor"),
]


def test_variables_that_are_no_h_are_refused_with_what_to_do(tmp_path: Path) -> None:
    for write, words in REFUSED:
        with pytest.raises(FileFormatError, match=words):
            open_psf(mat(tmp_path / "H.mat", write))
    with pytest.raises(UnsafeFileError):
        open_psf(mat(tmp_path / "H.mat", lambda file: file.__setitem__("H", h5py.ExternalLink("/etc/passwd", "/H"))))
    (tmp_path / "old.mat").write_bytes(b"MATLAB 5.0 MAT-file, Platform: PCWIN64" + bytes(200))
    with pytest.raises(FileFormatError, match=r"v7\.3"):
        open_psf(tmp_path / "old.mat")


def test_windows_and_depths_that_cannot_be_are_refused(tmp_path: Path) -> None:
    H = np.ones((5, 5, 3, 3, 2))
    for crops in ([[0, 5], [1, 5]], [[1, 6], [1, 5]], [[4, 2], [1, 5]], [[1, 5]], [[1.5, 5], [1, 5]]):
        with pytest.raises(FileFormatError, match=r"CAindex: expected first and last pixel \(1 to 5\)"):
            open_psf(prevedel(tmp_path / "H.mat", H, np.array(crops)))
    path = prevedel(tmp_path / "H.mat", H)
    with h5py.File(path, "r+") as file:
        file["x3objspace"][...] = 1e-6
    with pytest.raises(FileFormatError, match="x3objspace: expected different depths for all planes"):
        open_psf(path)


def test_the_axis_of_a_single_plane_may_be_missing(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 3, 5, 5)).astype("f4")  # MATLAB drops the axis
    path = mat(tmp_path / "single.mat", lambda file: file.__setitem__("H", values))
    np.testing.assert_array_equal(np.asarray(open_psf(path)), values[None])


@pytest.mark.parametrize("suffix", [".mat", ".npy"])
def test_patterns_of_even_size_are_padded_and_that_is_said(tmp_path: Path, suffix: str) -> None:
    """Square lenslets of 2k pixels make even kernels, whose middle is pixel n/2 + 1 (doda42/LFToolbox#13)."""
    stored = np.random.default_rng(0).random((2, 3, 3, 8, 6)).astype(np.float32)
    path = tmp_path / f"H{suffix}"
    if suffix == ".npy":
        np.save(path, stored)
    else:
        with h5py.File(path, "w") as file:
            file["H"] = stored
    with open_psf(path) as H:
        assert H.shape == (2, 3, 3, 9, 7)
        np.testing.assert_array_equal(H[1, 2, 0][:8, :6], stored[1, 2, 0])
        assert not H[1, 2, 0][8:].any() and not H[1, 2, 0][:, 6:].any()
        assert any("8 x 6 px are padded with zeros to 9 x 7" in note for note in opening_notes(H))
        scene = np.random.default_rng(1).random((2, 12, 12)).astype(np.float32)
        found = Projector(H, (12, 12)).forward(scene)
    expected = np.zeros((12, 12))
    for z, r, c in np.ndindex(2, 12, 12):  # every voxel adds its pattern with pixel n/2 + 1 at the voxel
        for t, s in np.ndindex(8, 6):
            p, q = r + t - 4, c + s - 3
            if 0 <= p < 12 and 0 <= q < 12:
                expected[p, q] += scene[z, r, c] * stored[z, r % 3, c % 3, t, s]
    np.testing.assert_allclose(found, expected, rtol=1e-4)


# -- stacks of patterns, one for each plane ----------------------------------------------------------------
STACK = np.random.default_rng(4).random((3, 5, 8)).astype(np.float32)
"""Patterns (z, t, s) with an even number of columns."""


def stack_in(path: Path, variable: str = "") -> Path:
    if path.suffix == ".npy":
        np.save(path, STACK)
    elif path.suffix == ".mat":
        save_v73(path, **{variable: STACK.transpose(1, 2, 0), "x3objspace": [-2e-6, 0.0, 2e-6]})
    else:
        tifffile.imwrite(path, STACK, photometric="minisblack")
    return path


@pytest.mark.parametrize(("suffix", "variable"), [(".npy", ""), (".tif", ""), (".mat", "PSF"), (".mat", "H")])
def test_a_stack_of_patterns_has_a_period_of_one_pixel(tmp_path: Path, suffix: str, variable: str) -> None:
    """The image of a volume is the sum of SciPy's convolutions, and the stack can be exported as H."""
    with open_psf(stack_in(tmp_path / f"psf{suffix}", variable)) as found:
        assert found.shape == (3, 1, 1, 5, 9) and len(opening_notes(found)) == 2
        assert (
            "one pattern for each plane" in opening_notes(found)[0] and "5 x 8 px are padded" in opening_notes(found)[1]
        )
        volume = np.random.default_rng(5).random((3, 20, 30))
        whole = sum(convolve2d(plane, pattern) for plane, pattern in zip(volume, STACK, strict=True))
        wanted = np.asarray(whole)[2:22, 4:34]  # the middle of 8 pixels is the fifth, as for MATLAB's conv2
        ours = Projector(found, (20, 30), method="direct", dtype=np.float64).forward(volume)
        np.testing.assert_allclose(ours, wanted, rtol=1e-5)
        export(found, tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as again:
        np.testing.assert_array_equal(again[:, 0, 0, :, :8], STACK)
        if variable:
            np.testing.assert_allclose(again.depths, [-2.0, 0.0, 2.0], atol=1e-9)


def test_a_damaged_stack_of_patterns_is_refused(tmp_path: Path) -> None:
    whole = stack_in(tmp_path / "psf.tif")
    whole.write_bytes(whole.read_bytes()[:200])
    with pytest.raises(FileFormatError, match=r"psf\.tif"):
        open_psf(whole)
    with pytest.raises(InputError, match="region"):
        open_psf(whole, region="a")
    for values, how in ((np.zeros((2, 3, 4, 5), np.float32), "minisblack"), (np.zeros((20, 30, 3), np.uint8), "rgb")):
        tifffile.imwrite(whole, values, photometric=how)
        with pytest.raises(InputError, match="one pattern for each plane"):
            open_psf(whole)
