"""The one way a matrix is made: the same planes in memory, in a file, in units, and joined from other files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.progress import Clock, Work, drain
from lfcal.frames import ArraySource
from lfcal.psf import Cutout, PSFMatrix, assemble, iter_save, iter_save_regions, open_psf, save
from lfcal.psf._joining import adopt
from lfcal.psf.facts import Facts
from lfcal.psf.filling import Filled
from lfcal.psf.layout import Header, Plane, Stored
from lfcal.psf.make import PlaneSource, Reopening, Zeros, iter_make, iter_write, iter_write_regions, units_of
from lfcal.psf.saving import MatrixPlanes, iter_transpose_file
from lfcal.psf.store import PSFWriter
from lfcal.work import RunChoice, parts_folder

SHAPE = (3, 2, 4, 5, 7)
DEPTHS = [100.0, 250.0, 300.0]


def facts_of(z: int) -> Facts:
    """Return facts that differ from plane to plane: the last one knows least."""
    if z == 2:
        return Facts.of(SHAPE[1:3], SHAPE[3:])
    known: dict[str, Any] = {"saturated": np.full((2, 4), z), "error": 0.01 * (z + 1)}
    if z == 1:
        known |= {"noise": np.ones((2, 4, 2)), "valid": np.full((2, 4, 5), 254), "origin": np.ones((2, 4))}
    return Facts.of(SHAPE[1:3], SHAPE[3:], **known)


def write(path: Path, planes: list[int], values: np.ndarray, uncertain: int | None, **how: Any) -> Path:
    with PSFWriter(path, (len(planes), *SHAPE[1:]), depths=[DEPTHS[z] for z in planes], **how) as writer:
        for k, z in enumerate(planes):
            stated = np.abs(values[z]) / 50 if z == uncertain else None
            writer.write_plane(k, values[z], facts=facts_of(z), uncertainty=stated)
    return path


def join(parts: list[Path], writer: PSFWriter) -> None:
    with writer:
        for z, part in enumerate(parts):
            adopt(writer, z, part)


def contents(path: Path) -> dict[str, Any]:
    """Return every dataset as stored, chunk by chunk, and every attribute of an HDF5 file.

    Seconds in the provenance are left out: they differ from run to run.
    """
    found: dict[str, Any] = {}

    def look(name: str, entry: Any) -> None:
        found.update({f"{name}@{key}": np.asarray(value).tolist() for key, value in entry.attrs.items()})
        if f"{name}@provenance" in found:
            found[f"{name}@provenance"] = re.sub(r'seconds": [0-9.e-]+', 'seconds": 0', found[f"{name}@provenance"])
        if isinstance(entry, h5py.Dataset):
            found[name] = np.asarray(entry[()]).tobytes()
            if entry.chunks:
                chunks: list[Any] = []
                entry.id.chunk_iter(lambda c: chunks.append(c.chunk_offset))
                found[f"{name} stored"] = {at: entry.id.read_direct_chunk(at) for at in chunks}

    with h5py.File(path) as file:
        look("", file)
        file.visititems(look)
    return found


@pytest.mark.parametrize("dtype", ["float32", "rounded"])
@pytest.mark.parametrize("compression", ["gzip", "zstd", "none"])
@pytest.mark.parametrize("uncertain", [None, 1])
@pytest.mark.few(6)
def test_the_file_that_one_writer_would_have_written(
    tmp_path: Path, dtype: str, compression: str, uncertain: int | None
) -> None:
    values = np.random.default_rng(1).random(SHAPE).astype(np.float32)
    values[:, :, :, 0] = 0  # a window of the cutout is in use
    how: dict[str, Any] = {"dtype": dtype, "compression": compression}
    common = how | {"anchor": (3.0, 4.0), "provenance": {"from": "a test"}, "region": "corner"}
    whole = write(tmp_path / "whole.h5", [0, 1, 2], values, uncertain, **common)
    parts = [write(tmp_path / f"{z}.h5", [z], values, uncertain, **how) for z in range(3)]
    joined = tmp_path / "joined.h5"
    join(parts, PSFWriter(joined, SHAPE, depths=DEPTHS, **common))
    assert contents(joined) == contents(whole)
    with open_psf(joined, check=True) as found, open_psf(whole) as wanted:
        np.testing.assert_array_equal(found[:], wanted[:])
        assert found.depths.tolist() == DEPTHS


def test_parts_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    values = np.ones(SHAPE, np.float32)
    parts = [write(tmp_path / f"{z}.h5", [z], values, None, compression="none") for z in range(3)]
    two = write(tmp_path / "two.h5", [0, 1], values, None, compression="none")
    joined, plain, one = tmp_path / "joined.h5", {"compression": "none"}, (1, *SHAPE[1:])
    for given, shape, how, error, words in (
        (parts, SHAPE, {}, InputError, "stored like the other planes"),
        (parts, (3, 2, 4, 5, 9), plain, InputError, "plane 0"),
        ([two], one, plain, FileFormatError, "one plane"),
        ([tmp_path / "gone.h5"], one, {}, StorageError, "no such file"),
        (parts[:2], SHAPE, plain, InputError, r"without planes \[2\]"),
    ):
        with pytest.raises(error, match=words):
            join(given, PSFWriter(joined, shape, **how))  # type: ignore[arg-type]
    assert not joined.exists() and not list(tmp_path.glob(".joined*"))


# -- planes of any source ----------------------------------------------------------------------------------------------


MADE = (3, 2, 4, 5, 7)
THREADS = RunChoice("threads", 1)
SOURCES: list[Numbered] = []
"""Those that units have opened."""


class Numbered(PlaneSource):
    """Planes of their numbers, some of which are made where they are joined."""

    def __init__(self, held: bool = True, here: tuple[int, ...] = ()) -> None:
        self.header = Header(MADE, depths=(1.0, 2.0, 4.0), anchor=(3.0, 4.0), provenance={"simulated": {"by": "test"}})
        self.held, self.here = held, here
        self.closed = 0
        self.memory: list[int] = []

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        yield Clock("number", 1).at(0)
        values = zeros()
        assert not values.any() and values.shape == MADE[1:]
        self.memory.append(values.ctypes.data)
        values += z + 1
        values[0, 0] += np.arange(5)[:, None]
        uncertainty = np.full(MADE[1:], 0.5, np.float32) if z == 1 else None
        facts = Facts.of((2, 4), (5, 7), error=0.25)
        return Plane(values, facts, uncertainty, {"plane": z} if z < 2 else None)

    def reopening(self, z: int, stored: Stored) -> Reopening | None:
        if z in self.here:
            return None
        return Reopening(f"{__name__}:opened", {"held": self.held}, held=self.held)

    def close(self) -> None:
        self.closed += 1


def opened(values: Mapping[str, Any], workers: int) -> Numbered:
    """Open what makes the planes, as other processes do."""
    SOURCES.append(Numbered(values["held"]))
    return SOURCES[-1]


@pytest.fixture
def written(tmp_path: Path) -> Path:
    return drain(iter_write(Numbered(), tmp_path / "written.h5"))


def test_memory_and_file_hold_the_same(written: Path) -> None:
    kept = drain(iter_make(Numbered()))
    with open_psf(written) as H:
        np.testing.assert_array_equal(kept[:], H[:])
        assert kept.stated_uncertainty is not None and H.stated_uncertainty is not None
        for z in range(3):
            np.testing.assert_array_equal(kept.stated_uncertainty.plane(z), H.stated_uncertainty.plane(z))
        assert kept.depths.tolist() == H.depths.tolist() and kept.anchor == H.anchor == (3.0, 4.0)
        np.testing.assert_array_equal(kept.facts.known()["error"], H.facts.known()["error"])
        assert kept.provenance == {name: value for name, value in H.provenance.items() if name != "lfcal"}
        assert kept.provenance["simulated"] == {"by": "test", "planes": [{"plane": 0}, {"plane": 1}, None]}


def test_units_write_the_same_file(written: Path, tmp_path: Path) -> None:
    out = tmp_path / "units.h5"
    for held, here in product((True, False), ((), (1,), (0, 1, 2))):
        SOURCES.clear()
        source = Numbered(held, here)
        drain(iter_write(source, out, run=THREADS))
        assert contents(out) == contents(written) and not parts_folder(out).exists()
        # what is expensive to open is that of this process; what is not is opened for each plane and closed again
        assert [one.closed for one in SOURCES] == ([] if held else [1] * (3 - len(here)))
        assert source.closed == 1
    source = Numbered()
    drain(iter_write(source, out))
    assert len(set(source.memory)) == 1, "a file takes the memory of one plane"


def test_units_depend_on_how_values_are_stored() -> None:
    prints = {
        units_of(Numbered(), stored)[0].fingerprint()
        for stored in (Stored(), Stored("float64"), Stored(compression="none"), Stored(store_tolerance=0.1))
    }
    assert len(prints) == 4
    assert list(units_of(Numbered(here=(0, 2)), Stored())) == [1]


def test_what_cannot_be_made_is_refused_before_a_plane_is() -> None:
    source = Numbered()
    with pytest.raises(InputError, match="H that is made unit by unit: expected the name of the file"):
        drain(iter_make(source, run=THREADS))
    for wrong in ({"dtype": "int7"}, {"compression": "zip"}, {"store_tolerance": 2.0}):
        with pytest.raises(InputError, match=r"stored type|compression|storage tolerance"):
            Stored(**wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="depths of the planes: expected 3 values"):
        Header(MADE, depths=(1.0, 2.0))
    assert not source.memory


def test_planes_of_no_finite_values_are_refused(tmp_path: Path) -> None:
    class Infinite(Numbered):
        def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
            made = yield from super().iter_plane(z, zeros, workers)
            made.values[1, 1] = np.nan
            return made

    for out in (None, tmp_path / "H.h5"):
        with pytest.raises(InputError, match="plane 0: expected finite values"):
            drain(iter_make(Infinite(), out))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
@pytest.mark.parametrize("turned", [False, True])
def test_saved_and_transposed_in_units(tmp_path: Path, executor: str, turned: bool) -> None:
    H = PSFMatrix(np.random.default_rng(1).random(MADE).astype(np.float32), depths=(1.0, 2.0, 4.0), anchor=(1.0, 2.0))
    run = RunChoice(executor, 1)
    with pytest.raises(InputError, match="a matrix opened from a file"):
        drain(iter_save(H, tmp_path / "two.h5", run=run))
    with open_psf(save(H, tmp_path / "H.h5")) as H:
        matrix = H.T if turned else H
        drain(iter_save(matrix, tmp_path / "one.h5"))
        drain(iter_save(matrix, tmp_path / "two.h5", run=run))
        assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
        for method in ("exact", "paper-padded") if H.period == (3, 5) else ("exact",):
            drain(iter_transpose_file(matrix, tmp_path / "one.h5", method=method))
            drain(iter_transpose_file(matrix, tmp_path / "two.h5", method=method, run=run))
            assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5")
            with open_psf(tmp_path / "two.h5") as HT:
                np.testing.assert_array_equal(HT[:], matrix.T[:])
    assert {path.name for path in tmp_path.iterdir()} == {"H.h5", "one.h5", "two.h5"}


def test_regions_are_written_with_progress_and_can_be_cancelled(tmp_path: Path) -> None:
    values = np.random.default_rng(2).random((2, 2, 2, 3, 3))
    matrices = {"centre": PSFMatrix(values, depths=(1.0, 2.0)), "edge": PSFMatrix(2 * values, depths=(1.0, 2.0))}
    out = tmp_path / "field.h5"
    work = iter_save_regions(matrices, out)
    assert [next(work).count for _ in range(4)] == ["0 of 4", "1 of 4", "2 of 4", "3 of 4"]
    work.close()
    assert not list(tmp_path.iterdir())
    drain(iter_save_regions(matrices, out))
    for name, matrix in matrices.items():
        with open_psf(out, region=name) as H:
            np.testing.assert_array_equal(H[:], matrix[:])


@pytest.mark.long
def test_regions_of_any_source(tmp_path: Path) -> None:
    H = PSFMatrix(np.ones(MADE), depths=(1.0, 2.0, 4.0))
    sources: dict[str, tuple[PlaneSource, Stored]] = {
        "a": (MatrixPlanes(H), Stored("float64")),
        "b": (Numbered(), Stored(store_tolerance=0.1)),
    }
    drain(iter_write_regions(sources, tmp_path / "field.h5"))
    with open_psf(tmp_path / "field.h5") as first, open_psf(tmp_path / "field.h5", region="b") as second:
        assert first.dtype == np.float64 and second.provenance["simulated"]["by"] == "test"
        assert second.facts.bound is not None


def test_frames_are_assembled_in_units_where_it_is_said_which_they_are(tmp_path: Path) -> None:
    frames = ArraySource(np.full((3, 16, 16), 7, np.uint16), [(0, 0, 0), (0, 0, 1), (0, 1, 0)])
    missing: list[tuple[int, ...]] = []

    def fill(z: int, values: Any, facts: Facts) -> Work[Filled]:
        yield Clock("fill", 1).at(0)
        assert facts.recorded is not None
        missing.extend(map(tuple, np.argwhere(facts.recorded == 0).tolist()))
        values[facts.recorded == 0] = 3
        return Filled(facts, None)

    how: dict[str, Any] = {"fill": fill, "workers": 1}
    assemble(frames, (1, 2, 2), Cutout((5, 5), anchor=(7, 8)), tmp_path / "one.h5", **how).matrix.close()
    with pytest.raises(InputError, match="distinguishes these frames"):
        assemble(frames, (1, 2, 2), Cutout((5, 5), anchor=(7, 8)), tmp_path / "two.h5", **how, run=THREADS)
    assert {path.name for path in tmp_path.iterdir()} == {"one.h5"}
    how |= {"run": THREADS, "reopening": Reopening("", {"frames": "sevens"})}
    assemble(frames, (1, 2, 2), Cutout((5, 5), anchor=(7, 8)), tmp_path / "two.h5", **how).matrix.close()
    assert contents(tmp_path / "one.h5") == contents(tmp_path / "two.h5") and missing == [(1, 1)] * 2


@pytest.mark.parametrize("run", [None, THREADS])
def test_what_is_known_after_the_last_plane_is_kept(tmp_path: Path, run: RunChoice | None) -> None:
    class Counting(Numbered):
        def late_provenance(self) -> Mapping[str, Any]:
            return {"planes made": len(self.memory)}

    here = (0, 1, 2)
    drain(iter_write(Counting(here=here), tmp_path / "H.h5", run=run))
    drain(iter_write_regions({"a": (Counting(), Stored()), "b": (Counting(), Stored())}, tmp_path / "field.h5"))
    found = [drain(iter_make(Counting())).provenance]
    for path, region in (("H.h5", ""), ("field.h5", ""), ("field.h5", "b")):
        with open_psf(tmp_path / path, region=region) as H:
            found.append(H.provenance)
    assert [one["planes made"] for one in found] == [3] * 4
    assert all(one["simulated"]["by"] == "test" for one in found)
