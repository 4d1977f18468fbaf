"""Every option of ``lfcal export`` and ``lfcal transpose`` changes the file, or is refused for that kind of file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, open_psf, save
from tests.cli.conftest import Run
from tests.psf.test_mat_import import prevedel

Lfcal = Callable[..., Run]

GZIP, ZSTD = 1, 32015
"""Numbers of the filters in HDF5."""


@pytest.fixture
def H(tmp_path: Path) -> PSFMatrix:
    """Save an H of two planes, 3 x 3 positions, 5 x 7 pixels."""
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    matrix = PSFMatrix(values, depths=(-5.0, 5.0))
    save(matrix, tmp_path / "H.h5")
    return matrix


def compression_of(path: Path) -> list[int]:
    """Return the filters that compress H, without those that sort bytes or add a checksum."""
    with h5py.File(path) as file:
        plist = file["H"].id.get_create_plist()
        filters = [plist.get_filter(k)[0] for k in range(plist.get_nfilters())]
    return [number for number in filters if number in (GZIP, ZSTD)]


def test_mat_without_ht_rows_first_uncompressed(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    assert lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "all.mat").code == 0
    options = ("--no-ht", "--rows-first", "--uncompressed")
    done = lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "H.mat", *options)
    assert done.code == 0, done.err
    with h5py.File(tmp_path / "all.mat") as both, h5py.File(tmp_path / "H.mat") as one:
        assert "Ht" in both and "Ht" not in one
        # square, for the codes that crop rows and columns alike
        square = np.pad(np.asarray(H), [(0, 0)] * 3 + [(1, 1), (0, 0)])
        np.testing.assert_allclose(both["H"][()], square, rtol=1e-6)
        # H(t, s, y, x, z) of MATLAB, whose axes HDF5 lists the other way round
        np.testing.assert_allclose(one["H"][()], square.transpose(0, 2, 1, 4, 3), rtol=1e-6)
    assert compression_of(tmp_path / "all.mat") and not compression_of(tmp_path / "H.mat")


def test_lens_centred_by_whole_pixels_and_by_what_they_leave(lfcal: Lfcal, tmp_path: Path) -> None:
    camera = preset("lfm_20x05")  # its lenses are centred between pixels
    plan = ScanPlan.for_camera(camera, depths_um=[0.0], cutout=3)
    values = np.random.default_rng(1).random(plan.shape, np.float32)
    save(PSFMatrix(values, camera=camera, anchor=plan.anchor, depths=[0.0]), tmp_path / "H.h5")
    export = ("export", tmp_path / "H.h5", "--no-ht", "--force", "--out", tmp_path / "H.mat")
    told = lfcal(*export)
    assert (
        told.code == 0
        and "a lens is centred on row 8.50 and column 8.50" in told.err
        and "row 8 and column 8" in told.err
    )
    rolled = lfcal(*export, "--lens-centred")
    assert rolled.code == 0 and "the centre of the lens is (+0.50, +0.50) px" in rolled.err
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_allclose(file["lensCentre"][()], [[8.5], [8.5]])
        np.testing.assert_allclose(file["H"][()], values)
    moved = lfcal(*export, "--lens-centred", "--interpolation", "linear", "--json")
    assert moved.code == 0 and isinstance(moved.json, dict) and moved.json["notes"] == []
    with h5py.File(tmp_path / "H.mat") as file:
        np.testing.assert_allclose(file["lensCentre"][()], [[8], [8]])
        mean = (values[..., :-1, :] + values[..., 1:, :]) / 2
        np.testing.assert_allclose(file["H"][()][..., :2, :2], (mean[..., :-1] + mean[..., 1:]) / 2, rtol=1e-5)
    refused = lfcal(*export, "--interpolation", "linear")
    assert refused.code == 2 and "--interpolation: expected --lens-centred, got none" in refused.err
    odd = lfcal(*export, "--lens-centred", "--interpolation", "sinc")
    assert odd.code == 2 and "interpolation: expected nearest, linear, cubic or fourier" in odd.err


def test_another_codes_file_becomes_an_h_file_and_says_how_it_was_read(lfcal: Lfcal, tmp_path: Path) -> None:
    prevedel(tmp_path / "theirs.mat", np.random.default_rng(2).random((5, 5, 3, 3, 2)), np.array([[1, 5], [2, 4]]))
    done = lfcal("export", tmp_path / "theirs.mat", "--out", tmp_path / "H.h5")
    assert done.code == 0 and "CAindex" in done.err and "rows first" in done.err
    assert lfcal("verify", tmp_path / "H.h5").code == 0
    again = lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "H.mat", "--lens-centred", "--json")
    assert again.code == 0 and isinstance(again.json, dict), "its lenses are where its code puts them"
    assert all("lens" not in note for note in again.json["notes"])
    with open_psf(tmp_path / "H.h5") as ours, open_psf(tmp_path / "H.mat") as back:
        np.testing.assert_allclose(np.asarray(back), np.asarray(ours))


def test_without_a_camera_no_lens_is_centred(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    done = lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "H.mat", "--lens-centred")
    assert done.code == 2 and "expected an H with its camera" in done.err and done.err.count("\n") == 1
    assert not (tmp_path / "H.mat").exists()


@pytest.mark.parametrize("suffix", [".npy", ".h5"])
def test_transposed(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"HT{suffix}"
    assert lfcal("export", tmp_path / "H.h5", "--out", out, "--transposed").code == 0
    if suffix == ".npy":
        np.testing.assert_array_equal(np.load(out), np.asarray(H.T))
        return
    with open_psf(out) as matrix:
        assert matrix.is_transposed
        np.testing.assert_array_equal(np.asarray(matrix), np.asarray(H.T))


def test_one_position_as_a_stack_and_an_uncompressed_file(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    assert lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "p.tif", "--position", "2,1").code == 0
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "p.tif"), np.asarray(H)[:, 2, 1])
    assert lfcal("export", tmp_path / "H.h5", "--out", tmp_path / "u.h5", "--uncompressed").code == 0
    assert compression_of(tmp_path / "H.h5") and not compression_of(tmp_path / "u.h5")


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("x.mat", ("--transposed",), "expected a .h5 file, a .npy file or a .tif file, got a .mat file"),
        ("x.npy", ("--no-ht",), "expected a .mat file or a file for one code (--for), got a .npy file"),
        ("x.h5", ("--rows-first",), "expected a .mat file, got a .h5 file"),
        ("x.npy", ("--uncompressed",), "expected a .mat file, a .h5 file or "),
        ("x.mat", ("--position", "1,1"), "expected a .tif file"),
        ("x.tif", ("--lens-centred",), "expected a .mat file, got a .tif file"),
        ("x.h5", ("--lens-centred", "--interpolation", "cubic"), "expected a .mat file, got a .h5 file"),
        ("x.tif", ("--dtype", "rounded"), "expected a .h5 file, got a .tif file"),
        ("x.tif", ("--resume",), "expected work that is done in units, got a .tif file"),
        ("x.tif", ("--position", "1"), "--position: expected y,x, got '1'"),
        ("x", ("--no-ht",), "got no suffix"),
        ("x.tif", ("--for", "olaf"), "expected a .mat file for oLaF, got x.tif"),
        ("x.mat", ("--for", "other"), "expected olaf, prevedel, pyolaf"),
        ("x.npz", ("--for", "pyolaf", "--sparse"), "--sparse: expected --for olaf"),
        ("x.npz", ("--for", "pyolaf", "--rows-first"), "expected a .mat file, got a file for one code"),
        ("x.tif", ("--for", "flfm"), "H for FLFM: expected one pattern for each plane, got 3 x 3 positions"),
    ],
)
def test_what_a_format_would_ignore_is_refused(
    lfcal: Lfcal, H: PSFMatrix, tmp_path: Path, name: str, options: tuple[str, ...], words: str
) -> None:
    done = lfcal("export", tmp_path / "H.h5", "--out", tmp_path / name, *options)
    assert done.code == 2 and words in done.err and done.err.count("\n") == 1
    assert not (tmp_path / name).exists()


def test_transpose_to_a_file_by_any_compression_and_threads(lfcal: Lfcal, H: PSFMatrix, tmp_path: Path) -> None:
    for compression, numbers in (("zstd", [ZSTD]), ("none", [])):
        out = tmp_path / f"{compression}.h5"
        done = lfcal("transpose", tmp_path / "H.h5", "--out", out, "--compression", compression, "--workers", 1)
        assert done.code == 0, done.err
        assert compression_of(out) == numbers
        with open_psf(out) as matrix:
            np.testing.assert_array_equal(np.asarray(matrix), np.asarray(H.T))
    assert lfcal("transpose", tmp_path / "H.h5", "--out", tmp_path / "n.h5", "--workers", 0).code == 2
    assert not (tmp_path / "n.h5").exists()
