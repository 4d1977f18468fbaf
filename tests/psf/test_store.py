"""The H file: what is written comes back, other programs read it, and what must not be believed is refused."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import files
from lfcal.base.errors import FileFormatError, InputError, LfcalError, StorageError, UnsafeFileError
from lfcal.base.h5.chunks import PIPELINE, decode_chunk, encode_chunk
from lfcal.base.h5.reading import H5Data
from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.frames import ArraySource
from lfcal.psf import Cutout, Facts, PSFMatrix, PSFWriter, assemble, iter_save, open_psf, regions_of, save, save_regions
from lfcal.psf import _chunk_codec as chunk_codec
from lfcal.psf._chunk_codec import chunk_pipeline, parallel_read, parallel_write
from lfcal.psf._export import export
from lfcal.psf._joining import adopt
from lfcal.psf._steps import step_of_range
from lfcal.psf.facts import Origin, pack_valid
from lfcal.psf.saving import iter_transpose_file

SHAPE = (2, 3, 4, 5, 7)


def values(dtype: str = "float32") -> np.ndarray:
    rng = np.random.default_rng(2)
    return (rng.normal(size=SHAPE) * 100 + 500).astype(dtype)


def test_values_and_what_is_known_come_back(tmp_path: Path) -> None:
    known = {"depths": [-1.5, 2.5], "camera": preset("bench"), "anchor": (10.25, 20.5), "provenance": {"who": "test"}}
    for dtype, compression in (("float32", "gzip"), ("float64", "zstd"), ("uint16", "none"), ("uint16", "zstd")):
        H = PSFMatrix(values(dtype), recorded=np.arange(24).reshape(2, 3, 4), **known)  # type: ignore[arg-type]
        save(H, tmp_path / "H.h5", compression=compression)
        with open_psf(tmp_path / "H.h5") as back:
            np.testing.assert_array_equal(np.asarray(back), values(dtype))
            assert back.dtype == np.dtype(dtype)
            assert back.camera == preset("bench") and back.anchor == (10.25, 20.5)
            np.testing.assert_array_equal(back.depths, [-1.5, 2.5])
            np.testing.assert_array_equal(back.recorded, H.recorded)
            assert back.provenance["who"] == "test"


def test_the_layout_and_the_checksums_are_those_of_the_format(tmp_path: Path) -> None:
    """Recomputed from the description in the file alone; what is not measured is absent."""
    save(PSFMatrix(values()), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        data = file["H"]
        assert data.chunks == (1, 1, 1, 5, 7)
        assert (data.compression, data.compression_opts, data.shuffle, data.fletcher32) == ("gzip", 1, True, True)
        assert file.attrs["format"] == "lfcal-psf" and file.attrs["axes"] == "z,y,x,t,s"
        np.testing.assert_array_equal(data[...], values())  # read by HDF5 itself
        np.testing.assert_allclose(file["depth_sum"][...], values().sum((1, 2), dtype=float))
        each = b"".join(zlib.crc32(p.astype("<f4").tobytes()).to_bytes(4, "little") for row in data[0] for p in row)
        assert file["checksum"][0] == zlib.crc32(each)
        t0, t1, s0, s1 = file["used_window"][0]
        lit = np.argwhere(data[0].any(axis=(0, 1)))
        assert [t0, s0] == lit.min(axis=0).tolist() and [t1, s1] == lit.max(axis=0).tolist()
    with open_psf(tmp_path / "H.h5") as H:
        assert set(H.facts.known()) == {"recorded", "error"}
        assert H.facts.error is not None and np.isnan(H.facts.error).all(), "no error is stated, not none made"
        assert H.saturated is None


def test_rounding_to_16_bits_keeps_the_sign_and_makes_a_smaller_file(tmp_path: Path) -> None:
    signed = values() - 600  # most of it negative
    save(PSFMatrix(signed), tmp_path / "H.h5", dtype="rounded")
    save(PSFMatrix(signed), tmp_path / "full.h5")
    with h5py.File(tmp_path / "H.h5") as small, h5py.File(tmp_path / "full.h5") as full:
        assert small["H"].id.get_storage_size() < 0.8 * full["H"].id.get_storage_size()
        np.testing.assert_array_equal(small["H"][...] % small["step"][...][..., None, None], 0)
    with open_psf(tmp_path / "H.h5") as back:
        assert np.asarray(back).min() < -100 and back.T[1, 2, 3].dtype == np.float32
        np.testing.assert_allclose(np.asarray(back.T.T), np.asarray(back))
        for z in range(len(back)):
            np.testing.assert_allclose(back.depth_sum(z), back.plane(z).sum(axis=(0, 1), dtype=float), rtol=1e-6)


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


def test_nan_complex_numbers_and_a_full_disk_leave_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = values()
    bad[1, 2, 3, 0, 0] = np.nan
    with pytest.raises(InputError, match="plane 1: expected finite values"):
        save(PSFMatrix(bad), tmp_path / "H.h5")
    with pytest.raises(InputError, match="plane 0: expected real numbers, got complex64"):
        save(PSFMatrix(values().astype(np.complex64)), tmp_path / "H.h5")
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    with pytest.raises(StorageError, match="free some space"):
        save(PSFMatrix(values()), tmp_path / "H.h5")
    assert list(tmp_path.iterdir()) == []


def _truncated(path: Path) -> None:
    save(PSFMatrix(values()), path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(SHAPE, "f4")
    layout[0] = h5py.VirtualSource("other.h5", "H", SHAPE[1:])
    file.create_virtual_dataset("H", layout)


RAW = [("raw.bin", 0, h5py.h5f.UNLIMITED)]
CHUNKED: dict[str, Any] = {"chunks": (1, 1, 1, 5, 7)}
LIES: dict[str, Callable[[h5py.File], object]] = {
    "no data": lambda file: None,
    "external link": lambda file: file.__setitem__("H", h5py.ExternalLink("elsewhere.h5", "/H")),
    "external storage": lambda file: file.create_dataset("H", SHAPE, "f4", external=RAW),
    "virtual": _virtual,
    "huge": lambda file: file.create_dataset("H", (10**5, 999, 999, 999, 999), "f4", chunks=(1, 1, 1, 999, 999)),
    "unwritten": lambda file: file.create_dataset("H", SHAPE, "f4", **CHUNKED),
    "strings": lambda file: file.create_dataset("H", data=np.full(SHAPE, b"x")),
}
UNSAFE = {"external link", "external storage", "virtual", "huge", "strings"}


def test_files_that_must_not_be_believed(tmp_path: Path) -> None:
    """Parts of a file that lie are the subject of `test_crafted_files`."""
    path = tmp_path / "H.h5"
    for make in (lambda p: p.write_text("hello"), lambda p: p.write_bytes(b""), _truncated):
        make(path)
        with pytest.raises(FileFormatError):
            open_psf(path)
    for name, lie in {"foreign": None, **LIES}.items():
        with h5py.File(path, "w") as file:
            if lie is None:
                file["data"] = np.zeros(3)
            else:
                file.attrs["format"], file.attrs["version"] = "lfcal-psf", 1
                file["depths"] = np.arange(2.0)
                lie(file)
        with pytest.raises(LfcalError) as error:
            open_psf(path)
        assert "\n" not in str(error.value) and isinstance(error.value, FileFormatError | InputError), name
        assert isinstance(error.value, UnsafeFileError) == (name in UNSAFE), name


def test_a_flipped_bit_in_the_data_is_found_and_the_chunk_named(tmp_path: Path) -> None:
    target = tmp_path / "H.h5"
    save(PSFMatrix(values()), target)
    with h5py.File(target) as file:
        info = file["H"].id.get_chunk_info_by_coord((1, 2, 3, 0, 0))
    raw = bytearray(target.read_bytes())
    raw[info.byte_offset + info.size // 2] ^= 0x10
    target.write_bytes(raw)
    with open_psf(target) as H:
        assert H[0, 0, 0].shape == (5, 7)
        for read in (lambda: H[1, 2, 3], lambda: H.plane(1)):
            with pytest.raises(FileFormatError, match=r"H\.h5:/H, chunk \(1, 2, 3, 0, 0\): expected checksum"):
                read()


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no such file"):
        open_psf(tmp_path / "none.h5")
    with pytest.raises(StorageError, match="folder"):
        open_psf(tmp_path)
    with pytest.raises(StorageError, match="folder"):
        save(PSFMatrix(values()), tmp_path)
    np.save(tmp_path / "H.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FileFormatError, match="pickled"):
        open_psf(tmp_path / "H.npy")
    with pytest.raises(StorageError):
        save(PSFMatrix(values()), tmp_path / "H.npy" / "H.h5")


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


def test_version_1_knows_less(tmp_path: Path) -> None:
    """The corpus of old files shows that they open; this is what is read of one."""
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
        assert H.saturated is not None and (H.saturated == -1).all(), "zeros that were not counted"
    words = "expected an H file with checksums, got a file of version 1, which has none"
    with pytest.raises(FileFormatError, match=words):
        open_psf(path, check=True)


def test_regions_of_the_field_share_a_file(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    centre = PSFMatrix(values(), anchor=(1, 2))
    corner = PSFMatrix(values() * 3, anchor=(30, 40), facts=facts(values().shape))
    save_regions({"centre": centre, "corner": corner}, path)
    assert regions_of(path) == ("centre", "corner")
    with open_psf(path, check=True) as H:
        assert H.region == "centre" and np.array_equal(np.asarray(H), values())
    with open_psf(path, region="corner", check=True) as H:
        assert H.anchor == (30, 40) and np.array_equal(np.asarray(H), values() * 3)
        np.testing.assert_array_equal(H.recorded, corner.recorded)
    with pytest.raises(InputError, match="region: expected centre or corner, got 'edge'"):
        open_psf(path, region="edge")
    for name in ("a/b", "", "."):
        words = f"region of the field: expected a name .*, got {re.escape(repr(name))}; rename"
        with pytest.raises(InputError, match=words):
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


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_pipes_are_refused_instead_of_waited_for(tmp_path: Path) -> None:
    for name in ("H.h5", "H.npy", "H.mat"):
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


# -- as other programs read it -----------------------------------------------------------------------------------------


RECORDED = (3, 4, 5, 9, 11)


def recorded(seed: int = 0) -> NDArray[np.float32]:
    """Return patterns less a dark frame: noise about zero and spots, planes of peaks that differ 1,000 times."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 2, RECORDED) + rng.integers(0, 2, RECORDED) * rng.exponential(200, RECORDED)
    return (values * np.array([1, 0.03, 30]).reshape(-1, 1, 1, 1, 1)).astype(np.float32)


def as_others_read(path: Path, group: str = "") -> NDArray[np.float64]:
    """Return the values of H as NeXus's words say: stored values times one number."""
    with h5py.File(path, locking=False) as file:
        data = file[f"{group}/H"]
        assert "scale" not in data.attrs and "offset" not in data.attrs
        factor = data.attrs["scaling_factor"]
        assert np.ndim(factor) == 0
        return np.asarray(data[...], np.float64) * factor


def test_other_programs_read_the_values_of_h(tmp_path: Path) -> None:
    for how in ({"dtype": "rounded"}, {"dtype": "float32"}, {"dtype": "float64"}, {"store_tolerance": 0.01}):
        path = save(PSFMatrix(recorded()), tmp_path / "H.h5", **how)  # type: ignore[arg-type]
        with open_psf(path) as H:
            np.testing.assert_array_equal(as_others_read(path), H[:])
            for z in range(len(H)):
                within = 0.01 if "store_tolerance" in how else 2e-3
                assert np.abs(H.plane(z) - recorded()[z]).sum() <= within * np.abs(recorded()[z]).sum()
    # the scaling factor of another program is followed
    path = save(PSFMatrix(recorded()), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file["H"].attrs["scaling_factor"] = 0.25
    with open_psf(path) as H:
        np.testing.assert_array_equal(H[:], np.float32(0.25) * recorded())
        np.testing.assert_array_equal(H[1, 2, 3], as_others_read(path)[1, 2, 3])


def test_the_default_of_assembly_has_no_pedestal(tmp_path: Path) -> None:
    """The sum of a pattern that h5py reads is the light of the pattern, also with negative values in the plane."""
    rng = np.random.default_rng(1)
    frames = rng.normal(0, 3, (1, 2, 2, 16, 16)).astype(np.float32)
    frames[..., 6:10, 6:10] += 900
    matrix = assemble(ArraySource(frames), (1, 2, 2), Cutout((5, 5), (7, 8)), tmp_path / "H.h5", dtype="rounded").matrix
    stored = as_others_read(tmp_path / "H.h5")
    assert stored.min() < 0
    for y, x in np.ndindex(2, 2):
        pattern = frames[0, y, x, 5 + y : 10 + y, 6 + x : 11 + x]
        assert stored[0, y, x].sum() == pytest.approx(pattern.sum(), rel=1e-4)
        np.testing.assert_array_equal(stored[0, y, x], matrix[0, y, x])


def test_regions_and_transposes_are_stored_alike(tmp_path: Path) -> None:
    H = PSFMatrix(recorded())
    save_regions({"centre": H, "edge": PSFMatrix(-recorded(1))}, tmp_path / "R.h5", dtype="rounded")
    with open_psf(tmp_path / "R.h5", region="edge") as edge:
        np.testing.assert_array_equal(as_others_read(tmp_path / "R.h5", "regions/edge"), edge[:])
    save(H.T, tmp_path / "HT.h5", dtype="rounded")
    with open_psf(tmp_path / "HT.h5") as HT:
        np.testing.assert_array_equal(as_others_read(tmp_path / "HT.h5"), HT[:])


def test_viewers_find_the_unit_of_counts(tmp_path: Path) -> None:
    frames = ArraySource(np.ones((1, 2, 2, 16, 16), np.uint16))
    assemble(frames, (1, 2, 2), Cutout((5, 5), (7, 8)), tmp_path / "H.h5")
    save(PSFMatrix(recorded()), tmp_path / "simulated.h5")
    for name, unit in (("H.h5", "counts"), ("simulated.h5", "")):
        with h5py.File(tmp_path / name) as file:
            assert file["entry/H/H"].attrs["units"] == unit
            assert "scaling_factor" in file["H"].attrs["long_name"]
            assert str(file.attrs["creator"]).startswith("lfcal ")


def test_values_are_rounded_no_more_than_to_16_bits_of_their_plane(tmp_path: Path) -> None:
    """Each plane has its own step, however bright the others are, and the stated error is the true one."""
    truth = recorded().astype(np.float64)
    with open_psf(save(PSFMatrix(recorded()), tmp_path / "H.h5", dtype="rounded")) as H:
        error = np.abs(H[:] - truth)
        for z in range(len(H)):
            span = max(truth[z].max(), 0) - min(truth[z].min(), 0)
            assert error[z].max() <= span / 65535 / 2 * 1.0001
            stated = error[z].sum() / np.abs(truth[z]).sum()
            assert H.facts.known()["error"][z] == pytest.approx(stated, rel=1e-6)


def rounded(folder: Path, plane: NDArray[Any]) -> Path:
    with PSFWriter(folder / "H.h5", (1, *plane.shape), dtype="rounded") as writer:
        writer.write_plane(0, plane.astype(np.float32))
    return folder / "H.h5"


def test_whole_numbers_and_eighths_are_kept_exactly(tmp_path: Path) -> None:
    """Signed counts, 16 bits, sums of frames, means of eight darks, and darkness."""
    for plane in (
        np.arange(-500, 3596).reshape(1, 1, 64, 64)[:, :, 1:, 1:],
        np.arange(65535 - 120, 65536).reshape(1, 1, 11, 11),
        np.arange(2**23, 2**23 + 121).reshape(1, 1, 11, 11),
        np.arange(121).reshape(1, 1, 11, 11) / 8,
        np.zeros((1, 1, 3, 3)),
    ):
        with open_psf(rounded(tmp_path, plane)) as H:
            np.testing.assert_array_equal(H.plane(0), plane)
            assert np.isnan(H.facts.known()["error"]).all(), "no error is made, and none stated"
    for size in (1e-37, 1e-30, 1e7):
        plane = (recorded()[0] * size).astype(np.float32)
        with open_psf(rounded(tmp_path, plane)) as H:
            assert np.abs(H.plane(0) - plane).sum(dtype=float) <= 1e-3 * np.abs(plane).sum(dtype=float)
    assert step_of_range(0.0, 0.0) == 0 and step_of_range(-1.0, 65534.0) == 1


def test_integer_types_take_whole_numbers_that_fit(tmp_path: Path) -> None:
    H = np.zeros((1, 1, 1, 3, 3), np.float32)
    for dtype, value in (("uint16", -1.0), ("uint16", 65536.0), ("uint8", 256.0), ("uint16", 0.5), ("uint8", -0.5)):
        H[0, 0, 0, 1, 1] = value
        words = rf"plane 0, stored as {dtype}: expected whole numbers from 0 to .*as rounded"
        with pytest.raises(InputError, match=words):
            save(PSFMatrix(H), tmp_path / "H.h5", dtype=dtype)
    assert not list(tmp_path.iterdir())


def test_no_negative_zero_is_stored(tmp_path: Path) -> None:
    """It would take a bit for nothing, and read as -0."""
    noise = np.random.default_rng(0).normal(0, 0.2, (1, 1, 1, 31, 31)).astype(np.float32)
    noise[0, 0, 0, 0, 0] = 60000
    for how in ({"dtype": "rounded"}, {"store_tolerance": 0.5}):
        save(PSFMatrix(noise), tmp_path / "H.h5", **how)  # type: ignore[arg-type]
        stored = as_others_read(tmp_path / "H.h5")
        assert (stored == 0).any() and not np.signbit(stored[stored == 0]).any()


def test_a_plane_of_another_version_is_not_joined(tmp_path: Path) -> None:
    part = save(PSFMatrix(recorded()[:1]), tmp_path / "part.h5", dtype="rounded")
    with h5py.File(part, "r+") as file:
        file.attrs["version"] = 2
    with pytest.raises(FileFormatError, match=r"plane of version 4.*version 2.*run the command again"):
        with PSFWriter(tmp_path / "H.h5", (1, *RECORDED[1:]), dtype="rounded") as writer:
            adopt(writer, 0, part)
    assert not (tmp_path / "H.h5").exists()


# -- NeXus -------------------------------------------------------------------------------------------------------------


PLOTTED = (2, 3, 4, 5, 7)


class Axis(NamedTuple):
    name: str
    values: NDArray[Any]
    units: str
    label: str


class Plot(NamedTuple):
    signal: NDArray[Any]
    label: str
    title: str
    axes: list[Axis]


def default_plot(path: Path) -> Plot:
    """Read a NeXus file: https://manual.nexusformat.org/datarules.html, version 3 of associating axes with data."""
    with h5py.File(path) as file:
        group: Any = file
        classes = []
        while True:
            classes.append(group.attrs["NX_class"])
            if "default" not in group.attrs:
                break
            name = group.attrs["default"]
            assert "/" not in name and isinstance(group[name], h5py.Group)
            group = group[name]
        assert classes == ["NXroot", "NXentry", "NXdata"]
        return read_data(group)


def read_data(group: Any) -> Plot:
    signal = group[group.attrs["signal"]]
    names = [name.decode() if isinstance(name, bytes) else name for name in group.attrs["axes"]]
    assert len(names) == signal.ndim
    axes = []
    for k, name in enumerate(names):
        scale = group[name]
        assert scale.shape == (signal.shape[k],) and int(group.attrs[f"{name}_indices"]) == k
        assert scale.dtype.kind in "iuf"
        axes.append(Axis(name, scale[()], scale.attrs["units"], scale.attrs["long_name"]))
    return Plot(signal[()], signal.attrs["long_name"], group["title"][()].decode(), axes)


def test_viewers_open_the_depth_sums_with_their_axes(tmp_path: Path) -> None:
    H = PSFMatrix(np.random.default_rng(0).random(PLOTTED).astype("f4"), depths=[-20.0, 35.0])
    for name, matrix in (("H", H), ("HT", H.T)):
        save(matrix, tmp_path / "H.h5")
        plot = default_plot(tmp_path / "H.h5")
        np.testing.assert_allclose(plot.signal, np.asarray(matrix).sum((1, 2), dtype=float))
        assert plot.title.startswith(f"{name}: ") and plot.label == f"{name} summed over all positions"
        depth, row, column = plot.axes
        assert depth.values.tolist() == [-20.0, 35.0] and depth.units == "um" and "depth" in depth.label
        assert row.values.tolist() == [-2, -1, 0, 1, 2] and column.values.tolist() == [-3, -2, -1, 0, 1, 2, 3]
        assert row.units == column.units == "px" and "row" in row.label and "column" in column.label
    save(H, tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        plot = read_data(file["entry/H"])
    assert plot.signal.shape == PLOTTED and [axis.name for axis in plot.axes] == ["depths", "y", "x", "t", "s"]


def test_every_link_is_hard_and_the_file_opens(tmp_path: Path) -> None:
    matrix = PSFMatrix(np.ones(PLOTTED, "f4"))
    save_regions({"middle": matrix, "corner": matrix}, tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file:
        kinds: list[type] = []
        file.visit(lambda name: kinds.append(type(file.get(name, getlink=True))))
        assert set(kinds) == {h5py.HardLink}
        assert file["entry/depth_sum/depth_sum"] == file["depth_sum"], "a link, not a copy"
    assert default_plot(tmp_path / "H.h5").signal.shape == (2, 5, 7)
    with open_psf(tmp_path / "H.h5", region="corner", check=True) as H:
        assert H.shape == PLOTTED


# -- chunks ------------------------------------------------------------------------------------------------------------


OPTIONS = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}


def sample(shape: tuple[int, ...], dtype: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = np.floor(rng.random(shape) ** 4 * 250)
    return (values % 2 if dtype == "?" else values).astype(dtype)


def create(path: Path, shape: tuple[int, ...], dtype: str, **options: object) -> h5py.File:
    file = h5py.File(path, "w")
    file.create_dataset("H", shape, dtype, chunks=(1, 1, 1, *shape[3:]), **{**OPTIONS, **options})
    return file


CHUNKS = [
    *((dtype, (1, 3, 2, 3, 7)) for dtype in ("?", "u1", "i2", ">u2", "<f4", ">f4", "<f8", "<c8", "<c16")),
    *(("<f4", shape) for shape in ((2, 2, 3, 1, 1), (2, 1, 1, 11, 9), (1, 2, 2, 45, 31))),
]


def test_chunks_coded_outside_of_hdf5_are_those_that_it_writes_and_reads(tmp_path: Path) -> None:
    for dtype, shape in CHUNKS:
        ours, theirs = sample(shape, dtype), sample(shape, dtype, 1)
        with create(tmp_path / "a.h5", shape, dtype) as file:
            stored = sum(parallel_write(file["H"], z, ours[z], workers=2) for z in range(shape[0]))
            assert stored == file["H"].id.get_storage_size()
        with h5py.File(tmp_path / "a.h5", "r+") as file:
            np.testing.assert_array_equal(file["H"][...], ours)
            file["H"][...] = theirs
            file.flush()
            for z in range(shape[0]):
                plane = parallel_read(H5Data(file["H"], holes=True), z, workers=2)
                assert plane.dtype == theirs.dtype
                np.testing.assert_array_equal(plane, theirs[z])
            mask, raw = file["H"].id.read_direct_chunk((0, 0, 0, 0, 0))
            np.testing.assert_array_equal(decode_chunk(raw, dtype, shape[3:], mask), theirs[0, 0, 0])


def test_any_choice_of_the_three_filters(tmp_path: Path) -> None:
    array, bare = sample((2, 2, 3, 9, 7), "f4"), {"compression": None, "compression_opts": None}
    plain: dict[str, object] = {"shuffle": False, "fletcher32": False}
    for options in ({"fletcher32": False}, {"shuffle": False}, bare, plain | {"compression_opts": 9}, plain | bare):
        with create(tmp_path / "a.h5", array.shape, "f4", **options) as file:
            file["H"][0] = array[0]
            parallel_write(file["H"], 1, array[1])
            assert np.array_equal(file["H"][...], array), options
            assert np.array_equal(parallel_read(H5Data(file["H"], holes=True), 1), array[1]), options
    # filters left out of one chunk
    raw = encode_chunk(array[0, 0, 0], filters=("shuffle", "fletcher32"))
    with create(tmp_path / "a.h5", (1, 1, 1, 9, 7), "f4") as file:
        assert chunk_pipeline(file["H"]) == PIPELINE
        file["H"].id.write_direct_chunk((0, 0, 0, 0, 0), raw, filter_mask=0b010)
        assert np.array_equal(file["H"][0, 0, 0], array[0, 0, 0])
        assert np.array_equal(parallel_read(H5Data(file["H"], holes=True), 0)[0, 0], array[0, 0, 0])


def test_chunks_never_written_hold_the_fill_value(tmp_path: Path) -> None:
    array = sample((1, 2, 2, 5, 3), "f4")
    with create(tmp_path / "a.h5", array.shape, "f4", fillvalue=-3.0) as file:
        assert np.all(parallel_read(H5Data(file["H"], holes=True), 0) == -3)
        file["H"][0, 1, 0] = array[0, 1, 0]
        out = np.empty(array.shape[1:], "f4")
        assert parallel_read(H5Data(file["H"], holes=True), 0, out=out) is out
        assert np.array_equal(out, file["H"][0])
        assert np.array_equal(out[1, 0], array[0, 1, 0])


def test_other_storage_goes_through_hdf5(tmp_path: Path) -> None:
    array = sample((1, 2, 2, 5, 3), "f4")
    for options in ({"chunks": (1, 1, 1, 3, 3)}, {"compression": "lzf", "compression_opts": None}):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            settings = {**OPTIONS, "chunks": (1, 1, 1, 5, 3), **options}
            dataset = file.create_dataset("H", array.shape, array.dtype, **settings)
            assert chunk_pipeline(dataset) is None
            assert parallel_write(dataset, 0, array[0]) == dataset.id.get_storage_size()
            assert np.array_equal(parallel_read(H5Data(dataset, holes=True), 0), array[0])


def test_planes_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with create(tmp_path / "a.h5", (1, 2, 2, 5, 3), "u2") as file:
        with pytest.raises(InputError, match=r"plane 0: expected uint16 of shape \(2, 2, 5, 3\)"):
            parallel_write(file["H"], 0, np.zeros((2, 2, 3, 5), "u2"))
        with pytest.raises(InputError, match="float64"):
            parallel_write(file["H"], 0, np.zeros((2, 2, 5, 3)))
        with pytest.raises(InputError, match="0 to 0"):
            parallel_read(H5Data(file["H"], holes=True), 1)
        with pytest.raises(InputError, match="0 to 0"):
            parallel_write(file["H"], -1, np.zeros((2, 2, 5, 3), "u2"))
        assert file["H"].id.get_num_chunks() == 0
        parallel_write(file["H"], 0, np.ones((2, 2, 5, 3), "u1").transpose(1, 0, 2, 3))
        assert np.all(file["H"][...] == 1)


def test_memory_stays_bounded_while_threads_run_behind() -> None:
    started, finished = 0, []

    def work(batch: list[int]) -> int:
        finished.append(batch)
        return len(batch)

    def batches():
        nonlocal started
        for k in range(100):
            started += 1
            yield [k]

    ahead = [started - k for k, _ in enumerate(chunk_codec._in_threads(work, batches(), 3))]
    assert len(finished) == 100
    assert max(ahead) <= 8


def test_the_first_failure_ends_the_work() -> None:
    def work(batch: list[int]) -> int:
        return 1 // batch[0]

    with pytest.raises(ZeroDivisionError):
        list(chunk_codec._in_threads(work, iter([[1], [0], *[[1]] * 50]), 2))
