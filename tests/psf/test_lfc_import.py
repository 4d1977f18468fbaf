"""H out of napari-LF calibrations, written here as its LightFieldCalibration.save does; no real file was at hand."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, LfcalError, UnsafeFileError
from lfcal.psf import open_psf
from lfcal.reconstruct import Projector

Array = NDArray[Any]
NU, LENSLETS = 5, 7


@pytest.fixture
def database(monkeypatch: pytest.MonkeyPatch) -> type:
    """Return a class that pickles as napari-LF's does."""
    module = ModuleType("lflib.optics")
    made = type("PsfDatabase", (), {"__module__": "lflib.optics"})
    module.PsfDatabase = made  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lflib", ModuleType("lflib"))
    monkeypatch.setitem(sys.modules, "lflib.optics", module)
    return made


def psfs(database: type, share: int, depths: list[float], seed: int = 0) -> Any:
    """Return random splats of three lenslets each way, for each voxel of a lenslet."""
    rng = np.random.default_rng(seed)
    db = database()
    db.nu, db.nv, db.ns, db.nt = np.int64(NU), NU, LENSLETS, np.int64(LENSLETS)
    db.supersample_factor, db.z_coords, db.z_center = share, depths, 0.0
    db.x_coords = np.linspace(-1, 1, share)
    db.max_coefficient, db.raw_splats = np.float32(0.5), {}
    db.psf_coordinates, db.psf_coefficients = {}, {}
    for x, y, z in np.ndindex(share, share, len(depths)):
        count = 30
        at = rng.permutation(9 * NU * NU)[:count]
        lenslet, pixel = at // NU**2, at % NU**2
        uvst = np.stack([pixel % NU, pixel // NU, lenslet % 3 - 1, lenslet // 3 - 1], 1).astype(np.int32)
        db.psf_coordinates[x, y, z] = uvst
        db.psf_coefficients[x, y, z] = rng.random(count).astype(np.float32)
    return db


def save_lfc(path: Path, db: Any = None, protocol: int = 4, raw: bytes | None = None) -> Path:
    """LightFieldCalibration.save of napari-LF 0.1.7, its optics and PSFs."""
    with h5py.File(path, "w") as file:
        file.attrs["timestamp"] = "2023-05-12"
        optics = file.create_group("optics")
        optics.attrs["ulens_pitch"], optics.attrs["ulens_profile"] = 125.0, "rect"
        geometry = file.create_group("geometry")
        geometry.attrs["nu"] = NU
        if db is not None or raw is not None:
            file.create_group("rayspread").attrs["num_z_slices"] = 2
            data = np.frombuffer(pickle.dumps(db, protocol) if raw is None else raw, np.uint8)
            file.create_group("psf").create_dataset("psf_db", data=data, compression="gzip")
    return path


def project(db: Any, volume: Array) -> Array:
    """cl_project_wavespread of napari-LF 0.1.7, work item by work item; ``volume[y, x, z]``."""
    share = db.supersample_factor
    image = np.zeros((LENSLETS * NU, LENSLETS * NU))
    for (dx, dy, z), uvst in db.psf_coordinates.items():
        for (u, v, ds, dt), light in zip(uvst.tolist(), db.psf_coefficients[dx, dy, z].tolist(), strict=True):
            for t in range(LENSLETS):
                for s in range(LENSLETS):
                    column, row = (s - ds) * share + dx, (t - dt) * share + dy
                    if 0 <= column < volume.shape[1] and 0 <= row < volume.shape[0]:
                        image[t * NU + v, s * NU + u] += light * volume[row, column, z]
    return image


@pytest.mark.parametrize(("share", "protocol"), [(1, 2), (2, 5), (5, 2)])
def test_h_projects_as_napari_lf_does(tmp_path: Path, database: type, share: int, protocol: int) -> None:
    db = psfs(database, share, [-3.0, 4.0])
    path = save_lfc(tmp_path / "c.lfc", db, protocol)
    fine = np.random.default_rng(1).random((LENSLETS * NU, LENSLETS * NU, 2))
    # each pixel belongs to the voxel that its middle lies in
    owner = ((np.arange(LENSLETS * NU) + 0.5) * share / NU).astype(int)
    volume = np.zeros((LENSLETS * share, LENSLETS * share, 2))
    np.add.at(volume, np.ix_(owner, owner), fine)
    with open_psf(path) as H:
        assert H.period == (NU, NU) and H.depths.tolist() == [3.0, -4.0]
        shape = (LENSLETS * NU, LENSLETS * NU)
        ours = Projector(H, shape, method="direct", dtype=np.float64).forward(fine.transpose(2, 0, 1))
        np.testing.assert_allclose(ours, project(db, volume), rtol=1e-5)
        assert f"{share} x {share} voxels" in H.provenance["notes"][0]


def test_a_file_without_psfs_says_what_it_holds(tmp_path: Path) -> None:
    path = save_lfc(tmp_path / "c.lfc")
    with pytest.raises(FileFormatError, match=r"expected PSFs \(psf/psf_db\), got only optics and geometry; calibrate"):
        open_psf(path)
    with h5py.File(path, "r+") as file:
        file.create_group("rayspread")["rayspread_db"] = np.zeros(3, np.uint8)
    with pytest.raises(FileFormatError, match=r"optics and geometry and rayspread \(ray optics\)"):
        open_psf(path)


class Evil:
    """What pickles as a call that makes a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return open, (str(self.path), "w")


def test_a_pickle_runs_nothing(tmp_path: Path, database: type) -> None:
    db = psfs(database, 1, [0.0])
    target = tmp_path / "ran"
    evil = Evil(target)
    for k, value in enumerate((evil, {"a": evil}, np.array([evil], object), sys.exit, np.load)):
        db.extra = value
        with pytest.raises(UnsafeFileError, match="expected numbers and arrays, got a pickle that contains") as caught:
            open_psf(save_lfc(tmp_path / f"{k}.lfc", db))
        assert "\n" not in str(caught.value)
    assert not target.exists()


def test_damaged_pickles_are_one_line(tmp_path: Path, database: type) -> None:
    whole = pickle.dumps(psfs(database, 1, [0.0]), 4)
    rng = np.random.default_rng(0)
    for k in range(60):
        data = bytearray(whole[: len(whole) - int(rng.integers(0, 2)) * int(rng.integers(1, 400))])
        for at in rng.integers(0, len(data), 3):
            data[at] ^= 1 << int(rng.integers(0, 8))
        try:
            open_psf(save_lfc(tmp_path / f"{k}.lfc", raw=bytes(data))).close()
        except LfcalError as error:
            assert "\n" not in str(error)


def test_small_pickles_that_would_take_gigabytes(tmp_path: Path, database: type) -> None:
    """Lists that refer to one list many times, seven deep; a part with a number that the reader makes room for."""
    db, nested = psfs(database, 1, [0.0]), [0]
    for _ in range(6):
        nested = [nested] * 400  # type: ignore[list-item]
    db.extra = nested
    with open_psf(save_lfc(tmp_path / "nested.lfc", db)) as H:
        assert H.shape[0] == 1
    raw = b"\x80\x02K\x01r" + (1 << 28).to_bytes(4, "little") + b"."
    with pytest.raises(UnsafeFileError, match="part number"):
        open_psf(save_lfc(tmp_path / "memo.lfc", raw=raw))


ONE = (0, 0, 0)
IMPOSSIBLE: list[tuple[str, Any, str]] = [
    ("nu", 0, "nu, a whole number from 1 to 1000"),
    ("nv", "wide", "nv, a whole number"),
    ("supersample_factor", 9, "up to 5 voxels"),
    *(("z_coords", value, "a depth for each plane") for value in ([], ["near"], [1.0, 1.0], [10**400])),
    ("psf_coordinates", {ONE: [[1], [2, 3]]}, "voxel (0, 0, 0)"),
    ("psf_coordinates", {}, "voxel (0, 0, 0)"),
    ("psf_coefficients", {ONE: np.full(30, np.nan, "f4")}, "finite coefficient"),
    *(("psf_coordinates", {ONE: np.full((30, 4), n)}, "far beyond") for n in (1 << 20, 4096, np.iinfo(np.int64).min)),
    ("psf_coordinates", {ONE: np.full((30, 4), 1 << 63, np.uint64)}, "far beyond"),
]


def test_numbers_that_cannot_be_are_refused(tmp_path: Path, database: type) -> None:
    for name, value, words in IMPOSSIBLE:
        db = psfs(database, 1, [0.0])
        setattr(db, name, value)
        with pytest.raises(FileFormatError) as caught:
            open_psf(save_lfc(tmp_path / "c.lfc", db))
        assert words in str(caught.value), name
