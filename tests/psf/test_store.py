from __future__ import annotations

import os
import re
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.psf import Facts, PSFMatrix, PSFWriter, iter_save, open_psf, regions_of, save, save_regions
from lfcal.psf._export import export
from lfcal.psf.facts import Origin, pack_valid
from lfcal.psf.saving import iter_transpose_file

SHAPE = (2, 3, 4, 5, 7)


def values(dtype: str = "float32") -> np.ndarray:
    rng = np.random.default_rng(2)
    return (rng.normal(size=SHAPE) * 100 + 500).astype(dtype)


@pytest.mark.parametrize("compression", ["gzip", "zstd", "none"])
@pytest.mark.parametrize("dtype", ["float32", "float64", "uint16"])
def test_round_trip(tmp_path: Path, dtype: str, compression: str) -> None:
    H = PSFMatrix(
        values(dtype),
        depths=[-1.5, 2.5],
        camera=preset("bench"),
        anchor=(10.25, 20.5),
        recorded=np.arange(24).reshape(2, 3, 4),
        provenance={"who": "test"},
    )
    save(H, tmp_path / "H.h5", compression=compression)
    with open_psf(tmp_path / "H.h5") as back:
        np.testing.assert_array_equal(np.asarray(back), values(dtype))
        assert back.dtype == np.dtype(dtype)
        assert back.camera == preset("bench")
        assert back.anchor == (10.25, 20.5)
        np.testing.assert_array_equal(back.depths, [-1.5, 2.5])
        np.testing.assert_array_equal(back.recorded, H.recorded)
        assert back.provenance["who"] == "test"


def test_the_layout_is_that_of_the_format(tmp_path: Path) -> None:
    save(PSFMatrix(values()), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        data = file["H"]
        assert data.chunks == (1, 1, 1, 5, 7)
        assert (data.compression, data.compression_opts, data.shuffle, data.fletcher32) == ("gzip", 1, True, True)
        assert file.attrs["format"] == "lfcal-psf" and file.attrs["axes"] == "z,y,x,t,s"
        np.testing.assert_array_equal(data[...], values())  # read by HDF5 itself
        np.testing.assert_allclose(file["depth_sum"][...], values().sum((1, 2), dtype=float))


def test_rounding_to_16_bits_keeps_the_sign_and_makes_a_smaller_file(tmp_path: Path) -> None:
    signed = values() - 600  # most of it negative
    save(PSFMatrix(signed), tmp_path / "H.h5", dtype="rounded")
    save(PSFMatrix(signed), tmp_path / "full.h5")
    with h5py.File(tmp_path / "H.h5") as small, h5py.File(tmp_path / "full.h5") as full:
        assert small["H"].id.get_storage_size() < 0.8 * full["H"].id.get_storage_size()
        np.testing.assert_array_equal(small["H"][...] % small["step"][...][..., None, None], 0)
    with open_psf(tmp_path / "H.h5") as back:
        step = np.ptp(signed, axis=(1, 2, 3, 4)) / 65535
        error = np.abs(np.asarray(back) - signed).max((1, 2, 3, 4))
        assert (error <= 0.51 * step).all()
        assert np.asarray(back).min() < -100
        np.testing.assert_allclose(np.asarray(back.T.T), np.asarray(back))
        one = back.T[1, 2, 3]
        assert one.dtype == np.float32


def test_ht_files_transpose_back(tmp_path: Path) -> None:
    save(PSFMatrix(values()).T, tmp_path / "HT.h5")
    with open_psf(tmp_path / "HT.h5") as HT:
        assert HT.is_transposed and not HT.T.is_transposed
        np.testing.assert_array_equal(np.asarray(HT.T), values())


def test_cancelling_leaves_nothing_and_keeps_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "H.h5"
    save(PSFMatrix(values()), target)
    before = target.read_bytes()
    work = iter_save(PSFMatrix(values() * 2), target)
    next(work)
    next(work)
    work.close()
    assert target.read_bytes() == before
    assert list(tmp_path.iterdir()) == [target]


def test_a_nan_is_refused(tmp_path: Path) -> None:
    bad = values()
    bad[1, 2, 3, 0, 0] = np.nan
    with pytest.raises(InputError, match="plane 1: expected finite values"):
        save(PSFMatrix(bad), tmp_path / "H.h5")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_seen_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lfcal.base import files

    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: os.statvfs_result and type("U", (), {"free": 1000}))
    with pytest.raises(StorageError, match="free some space"):
        save(PSFMatrix(values()), tmp_path / "H.h5")
    assert list(tmp_path.iterdir()) == []


def _plain(path: Path, **kwargs: object) -> h5py.File:
    file = h5py.File(path, "w")
    file.attrs["format"], file.attrs["version"] = "lfcal-psf", 1
    file["depths"] = np.arange(2.0)
    return file


def _bad_files(folder: Path) -> dict[str, Path]:
    """Write one file of every kind that must not be believed."""
    made: dict[str, Path] = {}

    def path(name: str) -> Path:
        made[name] = folder / f"{name}.h5"
        return made[name]

    path("text").write_text("hello")
    path("empty").write_bytes(b"")
    save(PSFMatrix(values()), path("truncated"))
    data = made["truncated"].read_bytes()
    made["truncated"].write_bytes(data[: len(data) // 2])
    with h5py.File(path("foreign"), "w") as file:
        file["data"] = np.zeros(3)
    with _plain(path("newer")) as file:
        file.attrs["version"] = 99
        file["H"] = values()
    with _plain(path("no_data")):
        pass
    with _plain(path("external_link")) as file:
        file["H"] = h5py.ExternalLink(str(folder / "elsewhere.h5"), "/H")
    with _plain(path("external_storage")) as file:
        file.create_dataset("H", SHAPE, "f4", external=[(str(folder / "raw.bin"), 0, h5py.h5f.UNLIMITED)])
    with _plain(path("virtual")) as file:
        layout = h5py.VirtualLayout(SHAPE, "f4")
        layout[0] = h5py.VirtualSource(str(folder / "other.h5"), "H", SHAPE[1:])
        file.create_virtual_dataset("H", layout)
    with _plain(path("huge")) as file:
        file.create_dataset("H", (10**5, 999, 999, 999, 999), "f4", chunks=(1, 1, 1, 999, 999))
    with _plain(path("unwritten")) as file:
        file.create_dataset("H", SHAPE, "f4", chunks=(1, 1, 1, 5, 7))
    with _plain(path("strings")) as file:
        file.create_dataset("H", data=np.full(SHAPE, b"x"))
    with _plain(path("even_cutout")) as file:
        file["H"] = np.zeros((2, 3, 4, 4, 4))
    with _plain(path("four_axes")) as file:
        file["H"] = np.zeros((2, 3, 5, 5))
    with _plain(path("bad_camera")) as file:
        file["H"] = values()
        file.attrs["camera"] = "{not json"
    return made


def test_files_that_must_not_be_believed(tmp_path: Path) -> None:
    for name, path in _bad_files(tmp_path).items():
        with pytest.raises(LfcalError) as error:
            open_psf(path)
        assert "\n" not in str(error.value), name
        assert isinstance(error.value, FileFormatError | InputError), name
    unsafe = {"external_link", "external_storage", "virtual", "huge", "strings"}
    for name in unsafe:
        with pytest.raises(UnsafeFileError):
            open_psf(tmp_path / f"{name}.h5")


def test_a_flipped_bit_in_the_data_is_found(tmp_path: Path) -> None:
    target = tmp_path / "H.h5"
    save(PSFMatrix(values()), target)
    with h5py.File(target) as file:
        info = file["H"].id.get_chunk_info_by_coord((1, 2, 3, 0, 0))
    raw = bytearray(target.read_bytes())
    raw[info.byte_offset + info.size // 2] ^= 0x10
    target.write_bytes(raw)
    with open_psf(target) as H:
        assert H[0, 0, 0].shape == (5, 7)
        with pytest.raises(FileFormatError):
            H[1, 2, 3]
        with pytest.raises(FileFormatError):
            H.plane(1)


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no such file"):
        open_psf(tmp_path / "none.h5")
    with pytest.raises(StorageError, match="folder"):
        open_psf(tmp_path)
    with pytest.raises(StorageError, match="folder"):
        save(PSFMatrix(values()), tmp_path)


def test_pickled_npy_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "H.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="pickled"):
        open_psf(tmp_path / "H.npy")


def test_writing_into_a_file_as_folder(tmp_path: Path) -> None:
    (tmp_path / "f").write_text("")
    with pytest.raises(StorageError):
        save(PSFMatrix(values()), tmp_path / "f" / "H.h5")


def test_writer_checks_its_planes(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="shape"), PSFWriter(tmp_path / "a.h5", SHAPE) as writer:
        writer.write_plane(0, np.zeros((1, 1, 5, 7), np.float32))
    with pytest.raises(InputError, match="once"), PSFWriter(tmp_path / "b.h5", SHAPE) as writer:
        writer.write_plane(0, values()[0])
        writer.write_plane(0, values()[0])
    for options in ({"dtype": "int3"}, {"compression": "rar"}, {"depths": [1, 2, 3]}):
        with pytest.raises(InputError):
            PSFWriter(tmp_path / "c.h5", SHAPE, **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def facts(shape: tuple[int, ...]) -> Facts:
    nz, ny, nx, nt, ns = shape
    rng = np.random.default_rng(1)
    mask = rng.random((nz, ny, nx, nt, ns)) > 0.1
    return Facts.of(
        (nz, ny, nx),
        (nt, ns),
        recorded=rng.integers(0, 3, (nz, ny, nx)),
        saturated=rng.integers(-1, 4, (nz, ny, nx)),
        noise=rng.random((nz, ny, nx, 2)),
        spread=np.where(rng.random((nz, ny, nx)) > 0.5, np.nan, 0.01),
        valid=pack_valid(mask),
        error=rng.random(nz),
    )


def test_everything_known_of_the_positions_comes_back(tmp_path: Path) -> None:
    known = facts(values().shape)
    H = PSFMatrix(values(), facts=known, region="upper left", anchor=(3.0, 4.5))
    save(H, tmp_path / "H.h5")
    save(H.T, tmp_path / "HT.h5")
    with open_psf(tmp_path / "H.h5", check=True) as plain, open_psf(tmp_path / "HT.h5", check=True) as turned:
        for found in (plain, turned.T):
            assert found.region == "upper left" and found.anchor == (3.0, 4.5)
            assert set(found.facts.known()) == set(known.known())
            for name, value in known.known().items():
                np.testing.assert_array_equal(getattr(found.facts, name), value, err_msg=name)
        assert turned.is_transposed and np.array_equal(turned.plane(0), H.T.plane(0))
        bits = np.unpackbits(known.valid[0, 1, 2], count=values().shape[3] * values().shape[4])  # type: ignore[index]
        np.testing.assert_array_equal(plain.valid(0, 1, 2).ravel(), bits)


def test_what_nobody_measured_is_absent(tmp_path: Path) -> None:
    save(PSFMatrix(values()), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H:
        assert set(H.facts.known()) == {"recorded", "error"}
        assert H.facts.error is not None and np.isnan(H.facts.error).all(), "no error is stated, not none made"
        assert H.saturated is None


def test_rounding_is_stated_as_error_and_holds(tmp_path: Path) -> None:
    save(PSFMatrix(values()), tmp_path / "H.h5", dtype="rounded")
    with open_psf(tmp_path / "H.h5") as H:
        truth = values().astype(float)
        real = np.abs(np.asarray(H) - truth).sum(axis=(1, 2, 3, 4)) / np.abs(truth).sum(axis=(1, 2, 3, 4))
        assert H.facts.error is not None
        np.testing.assert_allclose(H.facts.error, real, rtol=1e-4)


def test_stored_sums_are_those_of_the_stored_values(tmp_path: Path) -> None:
    save(PSFMatrix(values()), tmp_path / "H.h5", dtype="rounded")
    with open_psf(tmp_path / "H.h5") as H:
        for z in range(len(H)):
            np.testing.assert_allclose(H.depth_sum(z), H.plane(z).sum(axis=(0, 1), dtype=float), rtol=1e-6)


def test_a_changed_plane_fails_its_checksum(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    save(PSFMatrix(values()), path, compression="none")
    open_psf(path, check=True).close()
    with h5py.File(path, "r+") as file:
        file["H"][1, 0, 0, 0, 0] += 1
    with pytest.raises(FileFormatError, match=r"H\.h5, plane 1: expected checksum"):
        open_psf(path, check=True)
    with h5py.File(path, "r+") as file:
        file["H"][1, 0, 0, 0, 0] -= 1
    open_psf(path, check=True).close()


def test_checksum_is_the_documented_one(tmp_path: Path) -> None:
    """Recomputed from the description in the file alone."""
    save(PSFMatrix(values()), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        plane = file["H"][0]
        each = b"".join(zlib.crc32(p.astype("<f4").tobytes()).to_bytes(4, "little") for row in plane for p in row)
        assert file["checksum"][0] == zlib.crc32(each)
        t0, t1, s0, s1 = file["used_window"][0]
        lit = np.argwhere(plane.any(axis=(0, 1)))
        assert [t0, s0] == lit.min(axis=0).tolist() and [t1, s1] == lit.max(axis=0).tolist()


def test_version_2_without_a_default_plot_still_opens(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    save(PSFMatrix(values()), path)
    with h5py.File(path, "r+") as file:
        del file["entry"], file.attrs["default"], file.attrs["NX_class"]
        for name in ("units", "long_name"):
            del file["depths"].attrs[name]
    with open_psf(path, check=True) as H:
        np.testing.assert_array_equal(np.asarray(H), values())


def test_version_1_still_opens(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    save(PSFMatrix(values(), recorded=np.full(values().shape[:3], 2)), path)
    with h5py.File(path, "r+") as file:
        for name in ("used_window", "checksum", "error", "entry"):
            del file[name]
        file.attrs["version"] = 1
        del file.attrs["region"]
        file["saturated"] = np.zeros(values().shape[:3], np.uint32)
    with open_psf(path) as H:
        np.testing.assert_array_equal(np.asarray(H), values())
        assert (H.recorded == 2).all() and H.facts.error is None and H.region == ""
        assert H.saturated is not None and (H.saturated == -1).all(), "zeros that nobody counted"
    with pytest.raises(
        FileFormatError, match="expected an H file with checksums, got a file of version 1, which has none"
    ):
        open_psf(path, check=True)


def test_regions_of_the_field_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    centre, corner = (
        PSFMatrix(values(), anchor=(1, 2)),
        PSFMatrix(values() * 3, anchor=(30, 40), facts=facts(values().shape)),
    )
    save_regions({"centre": centre, "corner": corner}, path)
    assert regions_of(path) == ("centre", "corner")
    with open_psf(path, check=True) as H:
        assert H.region == "centre" and np.array_equal(np.asarray(H), values())
    with open_psf(path, region="corner", check=True) as H:
        assert H.anchor == (30, 40) and np.array_equal(np.asarray(H), values() * 3)
        np.testing.assert_array_equal(H.recorded, corner.recorded)
    with pytest.raises(InputError, match="region: expected centre or corner, got 'edge'"):
        open_psf(path, region="edge")
    with pytest.raises(InputError, match="region of the field"):
        save_regions({"a/b": centre}, tmp_path / "bad.h5")
    for name in ("", "."):
        told = f"region of the field: expected a name .*, got {re.escape(repr(name))}; rename"
        with pytest.raises(InputError, match=told):
            save_regions({"centre": centre, name: centre}, tmp_path / "bad.h5")
    assert not (tmp_path / "bad.h5").exists()


def test_a_file_is_never_replaced_by_its_own_transpose_or_copy(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    save(PSFMatrix(values()), path)
    (tmp_path / "link.h5").symlink_to(path)
    before = path.read_bytes()
    with open_psf(path) as H:
        for work in (
            iter_save(H.T, path),
            iter_transpose_file(H, path),
            iter_transpose_file(H, tmp_path / "link.h5", method="paper"),
            iter_save(H, tmp_path / "." / "link.h5"),
        ):
            with pytest.raises(InputError, match="output: expected a file other than the input"):
                drain(work)
        with pytest.raises(InputError, match="a file other than the input"):
            export(H, path)
    assert path.read_bytes() == before and len(list(tmp_path.iterdir())) == 2


def test_complex_h_is_refused_not_cut_to_its_real_part(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="plane 0: expected real numbers, got complex64"):
        save(PSFMatrix(values().astype(np.complex64)), tmp_path / "H.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
@pytest.mark.parametrize("name", ["H.h5", "H.npy", "H.mat"])
def test_pipes_are_refused_instead_of_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(StorageError, match="is a pipe or a device; give the path of a file"):
        open_psf(tmp_path / name)


def test_uncertainty_and_origin_are_kept_and_read_back(tmp_path: Path) -> None:
    """Rounded up to steps of the plane's largest; of a measured pattern the noise's; a plane without any reads 0."""
    rng = np.random.default_rng(0)
    values = rng.random((2, 2, 3, 5, 5)).astype(np.float32)
    sigma = (rng.random((2, 2, 3, 5, 5)) ** 4).astype(np.float32)
    origin = np.zeros((2, 2, 3), np.uint8)
    origin[0, 1] = [Origin.HYBRID, Origin.MODEL, Origin.OUTLIER]
    facts = Facts.of((2, 2, 3), (5, 5), origin=origin, noise=np.full((2, 2, 3, 2), 0.25))
    with PSFWriter(tmp_path / "H.h5", values.shape) as writer:
        writer.write_plane(1, values[1], facts=facts.plane(1))
        writer.write_plane(0, values[0], facts=facts.plane(0), uncertainty=sigma[0])
    with open_psf(tmp_path / "H.h5") as H:
        assert H.facts.origin is not None
        np.testing.assert_array_equal(H.facts.origin, origin)
        for x in range(3):
            found = H.uncertainty(0, 1, x)
            assert found is not None and np.all(found >= sigma[0, 1, x] * (1 - 1e-6))
            assert np.all(found <= sigma[0, 1, x] * (1 + 1 / 128)), "rounded up"
        np.testing.assert_allclose(H.uncertainty(0, 0, 0), np.sqrt(0.25 + 0.25 * values[0, 0, 0]), rtol=1e-6)
        assert H.stated_uncertainty is not None and not H.stated_uncertainty.plane(1).any()
    for wrong in (sigma[0, 1:], -sigma[0], np.full_like(sigma[0], np.nan)):
        with (
            pytest.raises(InputError, match="uncertainty of plane 0"),
            PSFWriter(tmp_path / "bad.h5", (1, *values.shape[1:])) as writer,
        ):
            writer.write_plane(0, values[0], uncertainty=wrong)
    assert not (tmp_path / "bad.h5").exists()
    with pytest.raises(InputError, match="uncertainty: expected shape"):
        PSFMatrix(values, uncertainty=sigma[:1])
