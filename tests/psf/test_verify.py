"""H files are checked plane by plane and against the specification."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, StorageError
from lfcal.base.h5.reading import H5File
from lfcal.camera import preset
from lfcal.frames.source import Position
from lfcal.psf import Facts, PSFMatrix, save, save_regions, verify
from lfcal.psf._specification import SCHEMA, deviations_of, schema
from lfcal.psf._verify import iter_verify
from lfcal.psf.facts import pack_valid

SHAPE = (2, 3, 4, 9, 11)
VALUES = np.random.default_rng(3).random(SHAPE).astype(np.float32)


def flip(path: Path, offset: int) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 0x08
    path.write_bytes(data)


def offset_of(path: Path, name: str, at: tuple[int, ...] = ()) -> int:
    with h5py.File(path, "r") as file:
        data = file[name].id
        if not at:
            return int(data.get_offset())
        info = data.get_chunk_info_by_coord((*at, 0, 0))
        return int(info.byte_offset) + int(info.size) // 2


@pytest.mark.parametrize(
    ("dtype", "compression"),
    [
        ("rounded", "gzip"),
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in (("float32", "gzip"), ("rounded", "zstd"), ("float32", "none"))
        ),
    ],
)
def test_each_damaged_pattern_is_located(tmp_path: Path, dtype: str, compression: str) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5", dtype=dtype, compression=compression)
    clean = verify(path)
    assert clean.ok and clean.compared and (clean.planes, clean.missing, clean.damaged) == (2, 0, ())
    for at in ((0, 0, 0), (1, 2, 3), (1, 0, 2)):
        flip(path, offset_of(path, "H", at))
    assert {(d.z, d.what): d.positions for d in verify(path).damaged} == {
        (0, "damaged"): (Position(0, 0, 0),),
        (1, "damaged"): (Position(1, 0, 2), Position(1, 2, 3)),
    }
    assert [(p.done, p.total, p.stage) for p in iter_verify(path)] == [(k, 2, "check planes") for k in range(3)]


def test_values_written_by_others_are_seen_though_they_decode(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file["H"][1, 1, 1, 4, 4] += 0.5
    assert [(d.z, d.what) for d in verify(path).damaged] == [(1, "changed"), (1, "depth sum changed")]
    with h5py.File(path, "r+") as file:
        file["H"][0, 2, 3, 4, 4] = np.nan
    assert (0, "not finite", (Position(0, 2, 3),)) in {(d.z, d.what, d.positions) for d in verify(path).damaged}


def test_checksums_sums_and_uncertainty_are_compared_too(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    for name, what in (("checksum", "changed"), ("depth_sum", "depth sum changed")):
        save(PSFMatrix(VALUES), path, dtype="rounded")
        flip(path, offset_of(path, name) + 6 if name == "depth_sum" else offset_of(path, name))
        (found,) = verify(path).damaged
        assert (found.z, found.what) == (0, what)
    recorded = np.ones(SHAPE[:3], np.uint16)
    recorded[0, 1, 2] = recorded[1, 0, 0] = 0
    save(PSFMatrix(VALUES, uncertainty=0.1 * VALUES, recorded=recorded), path)
    assert verify(path).ok and verify(path).missing == 2, "missing positions are no fault"
    flip(path, offset_of(path, "uncertainty", (1, 2, 0)))
    (found,) = verify(path).damaged
    assert (found.z, found.what, found.positions) == (1, "uncertainty damaged", (Position(1, 2, 0),))


def test_a_file_without_checksums_says_so(tmp_path: Path) -> None:
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
        del file["checksum"]
    check = verify(path)
    assert check.ok and not check.compared
    flip(path, offset_of(path, "H", (1, 1, 1)))
    assert [d.positions for d in verify(path).damaged] == [(Position(1, 1, 1),)]


def test_every_region_of_the_field_is_read(tmp_path: Path) -> None:
    path = save_regions({"centre": PSFMatrix(VALUES), "edge": PSFMatrix(VALUES[:1])}, tmp_path / "H.h5")
    assert verify(path).planes == 3
    flip(path, offset_of(path, "regions/edge/H", (0, 1, 2)))
    assert [(d.region, d.positions) for d in verify(path).damaged] == [("edge", (Position(0, 1, 2),))]


def test_what_is_no_h_file_is_refused(tmp_path: Path) -> None:
    for name in ("gone.npy", "gone.mat", "gone.h5"):
        with pytest.raises(StorageError, match=f"{name}: no such file or folder; check the path"):
            verify(tmp_path / name)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = VALUES
    with pytest.raises(FileFormatError, match="expected an lfcal H file"):
        verify(tmp_path / "other.h5")
    path = save(PSFMatrix(VALUES), tmp_path / "H.h5")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileFormatError, match="expected an intact HDF5 file"):
        verify(path)


# -- specification -----------------------------------------------------------------------------------------------------


COMPLETE = (2, 3, 4, 5, 7)
PAGE = Path(__file__).parents[2] / "docs" / "files.md"
MATRIX = schema()["$defs"]["matrix"]["properties"]


def matrix() -> PSFMatrix:
    """Return an H of which everything is known."""
    positions, ones = COMPLETE[:3], np.ones(COMPLETE[:3])
    facts = Facts.of(
        positions,
        COMPLETE[3:],
        recorded=ones,
        saturated=ones,
        noise=np.ones((*positions, 2)),
        spread=ones,
        valid=pack_valid(np.ones(COMPLETE, np.bool_)),
        error=[0.01, 0.02],
        bound=np.full((2, 3), 0.001),
        origin=ones,
    )
    values = np.random.default_rng(0).random(COMPLETE).astype("f4")
    return PSFMatrix(
        values, depths=[1.0, 2.0], camera=preset("bench"), anchor=(3.0, 4.0), facts=facts, uncertainty=0.1 * values
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return save(matrix(), tmp_path / "H.h5")


def test_what_is_written_is_as_specified(tmp_path: Path) -> None:
    path, H = tmp_path / "H.h5", matrix()
    for how in (
        *({"dtype": "float32"}, {"dtype": "rounded", "compression": "none"}, {"dtype": "float64"}),
        *({"store_tolerance": 0.005}, {"store_tolerance": 0.005, "compression": "none"}),
    ):
        assert verify(save(H, path, **how)).deviations == ()  # type: ignore[arg-type]
    assert verify(save_regions({"middle": H, "corner": H.T}, path)).deviations == ()


def test_schema_and_writer_name_the_same_entries(path: Path) -> None:
    with h5py.File(path) as file:
        datasets = {name for name, entry in file.items() if isinstance(entry, h5py.Dataset)}
        attributes, own = set(file.attrs), set(file["H"].attrs)
    steps = {"step"}  # of what is rounded
    assert datasets == set(MATRIX["datasets"]["properties"]) - steps
    with h5py.File(save(matrix(), path.with_name("small.h5"), store_tolerance=0.005)) as file:
        assert {name for name, entry in file.items() if isinstance(entry, h5py.Dataset)} == datasets | steps
    top = schema()["properties"]["attributes"]["properties"]
    # what viewers go by is theirs: the specification leaves it alone
    assert attributes - {"NX_class", "default"} == set(MATRIX["attributes"]["properties"]) | set(top)
    theirs = {"interpretation"}
    assert own - theirs == set(MATRIX["datasets"]["properties"]["H"]["properties"]["attributes"]["properties"])


def test_schema_and_page_agree() -> None:
    """Each line of the page's tables: name, type, shape, and whether it must be there."""
    text = PAGE.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]+) \| (yes|no) \|", text, re.MULTILINE)
    said = {name: (kind.strip(), shape.strip(" `"), must == "yes") for name, kind, shape, must in rows}
    wanted: dict[str, tuple[str, str, bool]] = {}
    for name, entry in MATRIX["datasets"]["properties"].items():
        kind = entry["properties"]["dtype"]
        shape = f"({', '.join(map(str, entry['dimensions']))}{',' if len(entry['dimensions']) == 1 else ''})"
        wanted[name] = (kind.get("const") or ", ".join(kind["enum"]), shape, name in MATRIX["datasets"]["required"])
    assert {name: said.get(name) for name in wanted} == wanted
    top = schema()["properties"]["attributes"]
    for part in (MATRIX["attributes"], top):
        for name, entry in part["properties"].items():
            row = re.search(rf"^\| `{name}` \| ([^|]+) \| (yes|no) \|", text, re.MULTILINE)
            assert row, name
            assert (row[2] == "yes") == (name in part["required"]), name
            for value in (entry.get("const"), *entry.get("enum", ())):
                assert value is None or f"`{value}`" in row[1], (name, row[1])
    assert SCHEMA.name in text


def edited(path: Path, change: Callable[[Any], None]) -> tuple[str, ...]:
    with h5py.File(path, "r+") as file:
        change(file)
    return verify(path).deviations


def replaced(name: str, value: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        del file[name]
        file[name] = value

    return change


def attribute(name: str, value: Any = None, place: str = "/") -> Callable[[Any], None]:
    def change(file: Any) -> None:
        if value is None:
            del file[place].attrs[name]
        else:
            file[place].attrs[name] = value

    return change


DEVIATIONS: list[tuple[Callable[[Any], None], str]] = [
    (lambda file: file.__delitem__("used_window"), "/used_window: missing"),
    (attribute("provenance"), ", attribute provenance: missing"),
    (attribute("provenance", "{"), ", attribute provenance: expected JSON, got '{'"),
    (attribute("scaling_factor", place="H"), "/H, attribute scaling_factor: missing"),
    (replaced("depths", np.array([1.0, 2.0], "f4")), "/depths, dtype: expected 'float64', got 'float32'"),
    (replaced("spread", np.ones((2, 3, 3), "f4")), "/spread: expected shape (nz, ny, nx) = (2, 3, 4), got (2, 3, 3)"),
    (replaced("valid", np.ones((2, 3, 4, 4), "u1")), "= (2, 3, 4, 5), got (2, 3, 4, 4)"),
    (attribute("axes", "z,x,y,s,t"), "attribute axes: expected 'z,y,x,t,s'"),
    (attribute("anchor", np.zeros(3)), ", attribute anchor: expected shape (2) = (2,), got (3,)"),
]


def test_each_deviation_is_named(path: Path) -> None:
    whole = path.read_bytes()
    for change, line in DEVIATIONS:
        path.write_bytes(whole)
        found = edited(path, change)
        assert any(line in one for one in found), found
        # a file that cannot be opened at all says so once more
        assert len([one for one in found if "cannot be opened" not in one]) == 1, found
        assert not verify(path).ok


def test_several_deviations_are_all_named_also_in_a_region(tmp_path: Path) -> None:
    save_regions({"middle": matrix(), "corner": matrix()}, tmp_path / "H.h5")

    def change(file: Any) -> None:
        del file["checksum"], file["regions/corner/error"], file["regions/corner"].attrs["matrix"]

    assert set(edited(tmp_path / "H.h5", change)) == {
        "/checksum: missing",
        "/regions/corner/error: missing",
        "/regions/corner, attribute matrix: missing",
    }


def test_patterns_of_even_size_and_whole_chunks_deviate(tmp_path: Path) -> None:
    save(PSFMatrix(np.ones(COMPLETE, "f4"), depths=[1.0, 2.0]), tmp_path / "H.h5")

    def change(file: Any) -> None:
        attributes = dict(file["H"].attrs)
        del file["H"]
        file.create_dataset("H", data=np.ones((2, 3, 4, 6, 7), "f4"))
        file["H"].attrs.update(attributes)

    found = edited(tmp_path / "H.h5", change)
    assert any("/H, shape[3]: expected any value except a multiple of 2, got 6" in one for one in found), found
    assert any("/H, chunks: expected array, got None" in one for one in found)
    assert any("/depth_sum: expected shape (nz, nt, ns) = (2, 6, 7), got (2, 5, 7)" in one for one in found)


def test_files_of_version_1_need_less(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 1
        del file["used_window"], file["checksum"], file["uncertainty"]
    check = verify(path)
    assert check.ok and check.deviations == ()
    with h5py.File(path, "r+") as file:
        file["depths"][:] = 1.0  # a fault that only opening sees
    with pytest.raises(FileFormatError, match="different depths for all planes"):
        verify(path)


def test_what_cannot_be_read_is_said_once(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["depths"]
        file.create_group("depths")
    with H5File(path) as opened:
        said = [line for line in deviations_of(opened) if "depths" in line]
    assert len(said) == 1 and said[0].startswith("/depths: ")
