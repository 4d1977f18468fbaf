"""PSFMatrix: indices of numpy, transposes, pickles, xarray, and planes whose depths are unknown."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import preset
from lfcal.judge import inspect
from lfcal.judge.comparison import compare
from lfcal.judge.pairing import pair
from lfcal.judge.report import report
from lfcal.psf import Facts, PSFMatrix, export, open_psf, save
from lfcal.psf import _chunk_codec as chunk_codec

SHAPE = (3, 4, 5, 7, 9)


def brute_transpose(H: np.ndarray) -> np.ndarray:
    _, ny, nx, nt, ns = H.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    out = np.empty_like(H)
    for z, y, x, t, s in np.ndindex(H.shape):
        out[z, y, x, t, s] = H[z, (y + t - ct) % ny, (x + s - cs) % nx, nt - 1 - t, ns - 1 - s]
    return out


def random_matrix(shape: tuple[int, ...] = SHAPE, dtype: str = "float32") -> np.ndarray:
    rng = np.random.default_rng(1)
    return (rng.random(shape) * 100).astype(dtype)


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[PSFMatrix, np.ndarray]]:
    """Store the same values in every way."""
    folder = tmp_path_factory.mktemp("kinds")
    values = random_matrix()
    np.save(folder / "H.npy", values)
    save(PSFMatrix(values), folder / "H.h5")
    made: dict[str, tuple[PSFMatrix, np.ndarray]] = {
        "array": (PSFMatrix(values), values),
        "npy": (open_psf(folder / "H.npy"), values),
        "file": (open_psf(folder / "H.h5"), values),
    }
    integers = random_matrix(dtype="uint16")
    scaled = PSFMatrix(integers, scale=[0.5, 2.0, 1.0], offset=[1.0, 0.0, -3.0])
    truth = integers.astype(np.float32) * np.float32([0.5, 2, 1])[:, None, None, None, None]
    made["scaled"] = (scaled, truth + np.float32([1, 0, -3])[:, None, None, None, None])
    made |= {f"{name}.T": (H.T, brute_transpose(values)) for name, (H, values) in list(made.items())}
    return made


NAMES = ["array", "npy", "file", "scaled", "array.T", "npy.T", "file.T", "scaled.T"]
FEW_NAMES = [name if name in ("file", "scaled.T") else pytest.param(name, marks=pytest.mark.long) for name in NAMES]


def indices() -> st.SearchStrategy[Any]:
    def axis(n: int) -> st.SearchStrategy[Any]:
        return st.one_of(st.integers(-n, n - 1), st.slices(n))

    full = st.tuples(*(axis(n) for n in SHAPE))
    return st.tuples(full, st.integers(0, 5), st.booleans(), st.integers(0, 5)).map(_with_ellipsis)


def _with_ellipsis(drawn: tuple[tuple[Any, ...], int, bool, int]) -> Any:
    index, keep, ellipsis, split = drawn
    if not ellipsis:
        return index[:keep]
    head, tail = index[: min(split, keep)], index[5 - (keep - min(split, keep)) :] if keep > split else ()
    return (*head, Ellipsis, *tail)


@pytest.mark.parametrize("name", FEW_NAMES)
@given(key=indices())
@settings(max_examples=40, deadline=None, derandomize=True)
def test_slicing_is_numpys(name: str, key: Any, kinds: dict[str, tuple[PSFMatrix, np.ndarray]]) -> None:
    H, values = kinds[name]
    np.testing.assert_array_equal(H[key], values[key])


@pytest.mark.parametrize("name", NAMES)
def test_whole_matrix_planes_and_involution(name: str, kinds: dict[str, tuple[PSFMatrix, np.ndarray]]) -> None:
    H, values = kinds[name]
    np.testing.assert_array_equal(np.asarray(H), values)
    assert H.T.T is H
    np.testing.assert_array_equal(np.asarray(H.T), brute_transpose(values))
    for z, plane in enumerate(H):
        np.testing.assert_array_equal(plane, values[z])
        np.testing.assert_allclose(H.depth_sum(z), values[z].sum((0, 1), dtype=np.float64), rtol=1e-6)
        np.testing.assert_allclose(H.T.depth_sum(z), H.depth_sum(z)[::-1, ::-1], rtol=1e-12)
    assert z == len(values) - 1


@pytest.mark.parametrize("key", [5, (0, 0, 0, 0, 9), (0,) * 6, (..., ...), [0, 1], None, True, 1.5])
def test_other_indices_are_refused(key: Any) -> None:
    with pytest.raises(IndexError):
        PSFMatrix(random_matrix())[key]


def test_what_a_matrix_says_of_itself() -> None:
    H = PSFMatrix(random_matrix(), camera=preset("bench"), depths=[-10, 0, 10], anchor=(3.5, 4))
    assert (H.shape, H.ndim, len(H), H.period, H.cutout) == (SHAPE, 5, 3, (4, 5), (7, 9))
    assert H.nbytes == 4 * np.prod(SHAPE) and H.size == np.prod(SHAPE)
    assert H.anchor == (3.5, 4.0) and H.depths.tolist() == [-10, 0, 10]
    assert "bench" in repr(H) and "PSFMatrix.T" in repr(H.T)
    assert H.missing.shape == (0, 3)
    assert H.T.is_transposed and not H.is_transposed


def test_bad_matrices_and_facts_get_one_line() -> None:
    two, H = np.zeros((2, 1, 1, 3, 3)), random_matrix()
    for data, options, words in (
        (np.zeros((2, 2, 3, 3)), {}, "5 axes"),
        (np.zeros((1, 2, 2, 4, 3)), {}, "odd"),
        (np.zeros((1, 0, 2, 3, 3)), {}, "at least one"),
        (np.full((1, 1, 1, 1, 1), "a"), {}, "numbers"),
        (two, {"depths": [1.0]}, "depths"),
        (two, {"depths": [1.0, np.nan]}, "one for each plane"),
        (two, {"camera": preset("bench")}, "depths"),  # a camera needs the depths of its planes
        (two, {"recorded": np.ones((2, 2, 2))}, "recorded"),
        (H, {"facts": Facts(noise=np.zeros(SHAPE[:3]))}, "noise: expected shape"),
        (H, {"saturated": np.zeros((1, 2))}, "saturated: expected shape"),
    ):
        with pytest.raises(InputError, match=words) as error:
            PSFMatrix(data, **options)  # type: ignore[arg-type]
        assert "\n" not in str(error.value)
    assert PSFMatrix(H).saturated is None and PSFMatrix(H).variance(0, 0, 0) is None
    assert PSFMatrix(H).valid(0, 0, 0).all()


def test_a_closed_file_says_so(tmp_path: Path) -> None:
    save(PSFMatrix(random_matrix()), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H:
        assert H[0, 0, 0].shape == (7, 9)
    with pytest.raises(FileFormatError, match="closed"):
        H[1, 0, 0]


def test_only_what_is_used_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(PSFMatrix(random_matrix()), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H, monkeypatch.context() as patch:
        patch.setattr(chunk_codec, "parallel_read", lambda *_: pytest.fail("a whole plane was read"))
        np.testing.assert_array_equal(H[2, 3, 4], random_matrix()[2, 3, 4])
        np.testing.assert_allclose(H.depth_sum(1), random_matrix()[1].sum((0, 1), dtype=float), rtol=1e-7)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="xarray is not installed; run: pip install"):
        PSFMatrix(random_matrix()).to_xarray()


# loading xarray takes longer than all other tests of this module
@pytest.mark.long
def test_the_array_of_xarray_reads_only_what_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(PSFMatrix(random_matrix()), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H, monkeypatch.context() as patch:
        patch.setattr(chunk_codec, "parallel_read", lambda *_: pytest.fail("a whole plane was read"))
        patch.setattr(type(H.planes), "plane", lambda *_: pytest.fail("a whole plane was read"))
        found = H.to_xarray()[2, 1, 3, 2:4]
        np.testing.assert_array_equal(found.values, random_matrix()[2, 1, 3, 2:4])


def test_what_is_kept_cannot_be_written_to(tmp_path: Path) -> None:
    values = random_matrix()
    save(PSFMatrix(values), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as filed:
        for H in (PSFMatrix(values), filed, filed.T):
            sums = H.depth_sum(0).copy()
            for kept in (H.depth_sum(0), H.plane(0), H[0, 1, 2], H[0]):
                if not kept.flags.owndata:
                    with pytest.raises(ValueError, match="read-only"):
                        kept[...] = 1e9
            np.testing.assert_array_equal(H.depth_sum(0), sums)


def test_positions_of_ht_are_pixels_and_have_no_facts() -> None:
    recorded = np.ones(SHAPE[:3])
    recorded[0, 1, 2] = 0
    H = PSFMatrix(random_matrix(), recorded=recorded)
    assert H.missing.tolist() == [[0, 1, 2]]
    for name in ("missing", "recorded", "saturated", "facts"):
        with pytest.raises(InputError, match=r"metadata of the positions: expected H, got HT"):
            getattr(H.T, name)
    assert H.T.T.missing.tolist() == [[0, 1, 2]]


def test_variance_and_uncertainty_of_a_pattern() -> None:
    """A constant, and a slope times the light, which noise may have pushed below zero."""
    values = np.zeros((1, 1, 2, 1, 5), np.float32)
    values[0, 0, 0] = [[-4, 0, 5, 10, 40]]
    noise = np.full((1, 1, 2, 2), np.nan, np.float32)
    noise[0, 0, 0] = 3.0, 0.5
    H = PSFMatrix(values, facts=Facts(noise=noise))
    expected = [[3, 3, 5.5, 8, 23]]
    np.testing.assert_allclose(H.variance(0, 0, 0), expected)
    np.testing.assert_allclose(H.uncertainty(0, 0, 0), np.sqrt(expected), rtol=1e-6)
    assert H.variance(0, 0, 1) is None and H.uncertainty(0, 0, 1) is None


# -- to another process ------------------------------------------------------------------------------------
def test_what_is_in_a_file_travels_as_its_path(tmp_path: Path) -> None:
    values = random_matrix()
    save(
        PSFMatrix(values, depths=-1.0 - np.arange(len(values)), camera=preset("bench"), provenance={"from": "a test"}),
        tmp_path / "H.h5",
    )
    np.save(tmp_path / "H.npy", values)
    for name in ("H.h5", "H.npy"):
        with open_psf(tmp_path / name) as H:
            H.plane(0)  # a plane in hand stays at home
            for matrix in (H, H.T, H.T.T):
                said = pickle.dumps(matrix)
                assert len(said) < 1000
                with pickle.loads(said) as other:
                    np.testing.assert_array_equal(other[:], matrix[:])
                    assert (other.camera, other.provenance) == (H.camera, H.provenance)
                    assert other.is_transposed == matrix.is_transposed and other.T.T is other
    save(PSFMatrix(values).T, tmp_path / "HT.h5")
    with open_psf(tmp_path / "HT.h5") as HT, pickle.loads(pickle.dumps(HT.T)) as other:
        np.testing.assert_array_equal(other[:], values)
        assert not other.is_transposed


def test_what_is_in_memory_travels_by_value() -> None:
    values = random_matrix()
    whole = PSFMatrix(values, depths=[1, 2, 4], scale=2.0, recorded=np.ones(SHAPE[:3]), uncertainty=values)
    for matrix in (whole, whole.T):
        matrix.depth_sum(1)
        other = pickle.loads(pickle.dumps(matrix))
        np.testing.assert_array_equal(other[:], matrix[:])
        np.testing.assert_array_equal(other.depth_sum(1), matrix.depth_sum(1))
        assert other.depths.tolist() == [1, 2, 4] and other.T.T is other
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(whole)).uncertainty(0, 1, 2), values[0, 1, 2])


def test_open_data_of_nobody_do_not_travel(tmp_path: Path) -> None:
    """A memory map would travel by value, gigabytes of it, and an open dataset not at all."""
    np.save(tmp_path / "H.npy", random_matrix())
    with pytest.raises(InputError, match=r"opened by open_psf"):
        pickle.dumps(PSFMatrix(np.load(tmp_path / "H.npy", mmap_mode="r")))
    save(PSFMatrix(random_matrix()), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5") as file, pytest.raises(InputError, match=r"opened by open_psf"):
        pickle.dumps(PSFMatrix(file["H"]).T)


@pytest.mark.long
@pytest.mark.parametrize("kind", NAMES)
def test_the_array_of_xarray_selects_as_numpy_does(kinds: dict[str, tuple[PSFMatrix, np.ndarray]], kind: str) -> None:
    H, values = kinds[kind]
    array = H.to_xarray()
    assert array.dims == ("z", "y", "x", "t", "s") and array.shape == values.shape and array.dtype == H.dtype
    np.testing.assert_array_equal(array.values, values)
    for chosen in ({"z": 1}, {"y": slice(None, None, -2), "t": 3}, {"x": [4, 0, 2], "s": slice(1, 5)}):
        expected = values
        for axis, key in chosen.items():
            k = array.dims.index(axis)
            expected = np.moveaxis(np.moveaxis(expected, k, 0)[key if not isinstance(key, int) else [key]], 0, k)
        found = H.to_xarray().isel(chosen).values
        np.testing.assert_array_equal(
            found, expected.squeeze(tuple(array.dims.index(a) for a, k in chosen.items() if isinstance(k, int)))
        )
    np.testing.assert_array_equal(array.sum(("t", "s")).values, values.sum((3, 4)))


@pytest.mark.long
def test_the_array_of_xarray_has_coordinates_in_units() -> None:
    H = PSFMatrix(random_matrix(), depths=[-20.0, -10.0, 5.0], camera=preset("bench"), anchor=(3.0, 4.0), region="left")
    array = H.to_xarray()
    assert array.name == "H" and H.T.to_xarray().name == "HT"
    assert array.attrs == {"anchor": (3.0, 4.0), "region": "left", "camera": preset("bench").name}
    assert array.sel(z=-10.0, t=0, s=0)[2, 3] == H[1, 2, 3, 3, 4]
    assert array.z.attrs["units"] == "um" and array.t.attrs["units"] == "px"
    assert array.t.values.tolist() == [*range(-3, 4)] and array.x.values.tolist() == [*range(5)]
    assert "units" not in PSFMatrix(random_matrix()).to_xarray().z.attrs


# -- unknown depths ----------------------------------------------------------------------------------------------------


def values(nz=3):
    rng = np.random.default_rng(5)
    t, s = np.indices((15, 15)) - 7.0
    spot = 100 * np.exp(-0.5 * (t**2 + s**2) / 2.5**2)
    return (spot + rng.random((nz, 3, 3, 15, 15))).astype(np.float32)


@pytest.fixture
def npy(tmp_path):
    np.save(tmp_path / "H.npy", values())
    return tmp_path / "H.npy"


def test_planes_have_numbers_and_no_lengths(npy):
    with open_psf(npy) as H:
        assert not H.knows_depths and np.isnan(H.known_depths).all()
        assert H.depths.tolist() == [0.0, 1.0, 2.0]  # what plots and interpolation count by
        assert not H.T.knows_depths
    known = PSFMatrix(values(), depths=[-3.0, -2.0, -1.0])
    assert known.knows_depths and known.known_depths.tolist() == known.depths.tolist() == [-3.0, -2.0, -1.0]


def test_nothing_that_is_written_states_any(npy, tmp_path):
    with open_psf(npy) as H:
        save(H, tmp_path / "H.h5")
        save(H.T, tmp_path / "HT.h5")
        for name in ("H.mat", "one.tif", "again.h5"):
            export(H, tmp_path / name)
        tiff = next(tmp_path.glob("one*.tif"))
    for name in ("H.h5", "HT.h5", "again.h5", "H.mat"):
        with open_psf(tmp_path / name) as found:
            assert not found.knows_depths, name
            assert not (found.T if found.is_transposed else found).knows_depths
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["depths"].attrs["unit"] == "plane" and file["depths"].attrs["units"] == ""
    with h5py.File(tmp_path / "H.mat") as file:
        assert "H" in file and "x3objspace" not in file
    with tifffile.TiffFile(tiff) as file:
        said = str(file.imagej_metadata or file.ome_metadata)
    assert " um" not in said and "PositionZ" not in said and "spacing" not in said
    save(PSFMatrix(values(), depths=[-3.0, -2.0, -1.0]), tmp_path / "known.h5")
    with h5py.File(tmp_path / "known.h5") as file:  # counter-test
        assert file["depths"].attrs["unit"] == "um"


@pytest.mark.long
def test_reports_name_planes_by_their_numbers(npy, tmp_path):
    with open_psf(npy) as H:
        quality = inspect(H)
        report(H, tmp_path / "report")
    assert quality.extent == "" and quality.plane_words(1) == "plane 1"
    assert quality.to_dict()["planes"][1]["depth_um"] is None
    text = next((tmp_path / "report").rglob("*.html")).read_text(encoding="utf-8")
    assert "plane 1" in text and "depths not stated" in text and "1 µm" not in text
    with_depths = inspect(PSFMatrix(values(), depths=[-3000.0, -2000.0, -1000.0]))
    assert with_depths.extent == "-3 mm to -1 mm" and with_depths.plane_words(1, "z") == "z = -2 mm"


def test_planes_are_compared_by_their_numbers(npy):
    known = PSFMatrix(values(), depths=[-3000.0, -2000.0, -1000.0])
    with open_psf(npy) as H:
        for a, b, which in ((H, known, "the first"), (known, H, "the second")):
            found = pair(a, b)
            assert found.planes == ((0, 0), (1, 1), (2, 2))
            assert [note for note in found.notes if note.startswith(which) and "equal numbers" in note]
        assert pair(H, H).planes == ((0, 0), (1, 1), (2, 2)) and pair(H, H).notes == ("both are the same file",)
        assert compare(H, known).correlation == pytest.approx(1.0)
    assert not pair(known, known).notes
