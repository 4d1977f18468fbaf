from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.psf import PSFMatrix, export, iter_export, open_psf
from lfcal.psf._export import ExportOptions, export_notes
from lfcal.psf._matlab import MatOptions, mat_notes

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


def test_the_view_exports_as_ht(tmp_path: Path) -> None:
    export(matrix().T, tmp_path / "HT.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "HT.npy", mmap_mode="r"), np.asarray(matrix().T))


def test_a_mat_file_gets_its_options_and_no_others() -> None:
    given = ExportOptions(compress=False, rows_first=True, lens_centred=True, dtype="uint16", position=(1, 2))
    assert given.mat == MatOptions(compress=False, rows_first=True, lens_centred=True)
    assert ExportOptions().mat == MatOptions()


def test_only_mat_files_have_readers_who_take_something_else() -> None:
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
    for name, options in {
        "H.npy": {"compress": False},
        "H.mat": {"position": (0, 0)},
        "H.h5": {"rows_first": True},
        "H.tif": {"include_transpose": False},
        "H.tiff": {"lens_centred": True},
    }.items():
        with pytest.raises(InputError, match=f"options of {Path(name).suffix} files: expected .*leave this option out"):
            export(matrix(), tmp_path / name, **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
    export(matrix(), tmp_path / "H.h5", compress=False, dtype="rounded")
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["H"].dtype == np.float32 and file["step"][...].all() and file["H"].compression is None
