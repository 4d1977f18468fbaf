"""What any HDF5 reader sees of an H file, without knowing lfcal: stored zero is value zero, and one scale for all."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.h5.chunks import encode_chunk
from lfcal.frames import ArraySource
from lfcal.psf import Cutout, PSFMatrix, PSFWriter, assemble, open_psf, save, save_regions
from lfcal.psf._joining import adopt
from lfcal.psf._steps import step_of_range

SHAPE = (3, 4, 5, 9, 11)
FILTERS = ("shuffle", "deflate", "fletcher32")


def recorded(seed: int = 0) -> NDArray[np.float32]:
    """Return patterns less a dark frame: noise about zero and spots, planes of peaks that differ 1,000 times."""
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 2, SHAPE) + rng.integers(0, 2, SHAPE) * rng.exponential(200, SHAPE)
    return (values * np.array([1, 0.03, 30]).reshape(-1, 1, 1, 1, 1)).astype(np.float32)


def as_others_read(path: Path, group: str = "") -> NDArray[np.float64]:
    """Return the values of H as NeXus's words say: stored values times one number."""
    with h5py.File(path, locking=False) as file:
        data = file[f"{group}/H"]
        assert "scale" not in data.attrs and "offset" not in data.attrs
        factor = data.attrs["scaling_factor"]
        assert np.ndim(factor) == 0
        return np.asarray(data[...], np.float64) * factor


HOW = [{"dtype": dtype} for dtype in ("rounded", "float32", "float64")] + [{"store_tolerance": 0.01}]


@pytest.mark.parametrize("how", HOW, ids=lambda how: "-".join(map(str, how.values())))
def test_other_programs_read_the_values_of_h(tmp_path: Path, how: dict[str, object]) -> None:
    path = save(PSFMatrix(recorded()), tmp_path / "H.h5", **how)  # type: ignore[arg-type]
    with open_psf(path) as H:
        np.testing.assert_array_equal(as_others_read(path), H[:])
        for z in range(len(H)):
            within = 0.01 if "store_tolerance" in how else 2e-3
            assert np.abs(H.plane(z) - recorded()[z]).sum() <= within * np.abs(recorded()[z]).sum()


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


def test_a_scaling_factor_of_another_program_is_followed(tmp_path: Path) -> None:
    path = save(PSFMatrix(recorded()), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file["H"].attrs["scaling_factor"] = 0.25
    with open_psf(path) as H:
        np.testing.assert_array_equal(H[:], np.float32(0.25) * recorded())
        np.testing.assert_array_equal(H[1, 2, 3], as_others_read(path)[1, 2, 3])


def test_viewers_are_told_the_unit_of_counts(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    "plane",
    [
        np.arange(-500, 3596).reshape(1, 1, 64, 64)[:, :, 1:, 1:],
        np.arange(65535 - 120, 65536).reshape(1, 1, 11, 11),
        np.arange(2**23, 2**23 + 121).reshape(1, 1, 11, 11),
        np.arange(121).reshape(1, 1, 11, 11) / 8,
        np.zeros((1, 1, 3, 3)),
    ],
    ids=["signed", "16 bits", "sums of frames", "mean of 8 darks", "dark"],
)
def test_whole_numbers_and_eighths_are_kept_exactly(tmp_path: Path, plane: NDArray[np.float64]) -> None:
    with PSFWriter(tmp_path / "H.h5", (1, *plane.shape), dtype="rounded") as writer:
        writer.write_plane(0, plane.astype(np.float32))
    with open_psf(tmp_path / "H.h5") as H:
        np.testing.assert_array_equal(H.plane(0), plane)
        assert np.isnan(H.facts.known()["error"]).all(), "no error is made, and none stated"


@pytest.mark.parametrize("size", [1e-37, 1e-30, 1e7])
def test_planes_of_any_size_are_rounded_or_kept(tmp_path: Path, size: float) -> None:
    plane = (recorded()[0] * size).astype(np.float32)
    with PSFWriter(tmp_path / "H.h5", (1, *plane.shape), dtype="rounded") as writer:
        writer.write_plane(0, plane)
    with open_psf(tmp_path / "H.h5") as H:
        assert np.abs(H.plane(0) - plane).sum(dtype=float) <= 1e-3 * np.abs(plane).sum(dtype=float)
    assert step_of_range(0.0, 0.0) == 0 and step_of_range(-1.0, 65534.0) == 1


@pytest.mark.parametrize(
    ("dtype", "values"), [("uint16", -1.0), ("uint16", 65536.0), ("uint8", 256.0), ("uint16", 0.5), ("uint8", -0.5)]
)
def test_integer_types_take_whole_numbers_that_fit(tmp_path: Path, dtype: str, values: float) -> None:
    H = np.zeros((1, 1, 1, 3, 3), np.float32)
    H[0, 0, 0, 1, 1] = values
    with pytest.raises(InputError, match=rf"plane 0, stored as {dtype}: expected whole numbers from 0 to .*as rounded"):
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


def test_frames_of_integers_take_fewer_bytes_than_with_a_scale_for_each_plane() -> None:
    """The encoding of 0.1, a scale and an offset for each plane, spread 12-bit counts over 16 bits."""
    counts = np.random.default_rng(0).integers(60, 1686, (6, 61, 61))
    spread = np.rint((counts - 60) * (65535 / 1625)).astype(np.uint16)
    as_now, as_before = (sum(len(encode_chunk(p, 1, FILTERS)) for p in one) for one in (counts.astype("f4"), spread))
    assert as_now < 0.95 * as_before


def test_a_plane_of_another_version_is_not_joined(tmp_path: Path) -> None:
    part = save(PSFMatrix(recorded()[:1]), tmp_path / "part.h5", dtype="rounded")
    with h5py.File(part, "r+") as file:
        file.attrs["version"] = 2
    with pytest.raises(FileFormatError, match=r"plane of version 4.*version 2.*run the command again"):
        with PSFWriter(tmp_path / "H.h5", (1, *SHAPE[1:]), dtype="rounded") as writer:
            adopt(writer, 0, part)
    assert not (tmp_path / "H.h5").exists()
