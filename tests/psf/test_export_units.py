"""Exports in units: the same file as without, and after a stop the rest of it alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import InputError, StorageError
from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.psf import PSFMatrix, _export, make, open_psf, save, save_regions
from lfcal.psf._export import ExportOptions, iter_export
from lfcal.work import RunChoice, parts_folder
from tests.psf.test_joining import contents

GO_ON = RunChoice("threads", 1, begun="resume")

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
    values = np.random.default_rng(5).random((3, 4, 6, 7, 9)).astype(np.float32)
    path = tmp_path / "H.h5"
    save(PSFMatrix(values, depths=[10.0, 30.0, 45.0], camera=preset("bench"), anchor=(100.0, 90.0)), path)
    return path


def stored(path: Path) -> Any:
    """Return what is in a file; the head of a MATLAB file tells the time."""
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
def test_it_goes_on_with_what_was_done(
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
        exported(psf, out, options, turned, GO_ON)
    assert made == ["H0"] and not out.exists()
    full = False
    exported(psf, out, options, turned, GO_ON)
    assert len(made) == len(set(made)) and stored(out) == expected and not parts_folder(out).exists()


def test_what_an_export_refuses_is_refused_before_anything_is_made(psf: Path, tmp_path: Path) -> None:
    for path, options in ((tmp_path / "x.foo", ExportOptions()), (tmp_path / "x.npy", ExportOptions(compress=True))):
        with pytest.raises(InputError):
            exported(psf, path, options, run=GO_ON)
    with pytest.raises(InputError):
        exported(psf, psf, ExportOptions(), run=GO_ON)
    assert [path.name for path in tmp_path.iterdir()] == ["H.h5"]


@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npy"])
def test_a_matrix_without_a_file_has_no_units(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match="a matrix opened from a file"):
        drain(iter_export(PSFMatrix(np.ones((1, 2, 2, 3, 3))), tmp_path / f"H{suffix}", run=GO_ON))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mat", ".npy"])
def test_another_region_is_exported_in_units(psf: Path, tmp_path: Path, suffix: str) -> None:
    """Units of an export opened the first region of a file, whichever was given."""
    with open_psf(psf) as H:
        save_regions({"centre": H, "edge": PSFMatrix(2 * H[:], depths=H.depths)}, tmp_path / "field.h5")
    with open_psf(tmp_path / "field.h5", region="edge") as edge:
        drain(iter_export(edge, tmp_path / f"one{suffix}"))
        drain(iter_export(edge, tmp_path / f"two{suffix}", run=RunChoice("threads", 1)))
    assert stored(tmp_path / f"two{suffix}") == stored(tmp_path / f"one{suffix}")
