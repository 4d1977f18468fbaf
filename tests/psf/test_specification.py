"""The specification of the H file: what the writer writes, what the page says, and what deviates from it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError
from lfcal.base.h5.reading import H5File
from lfcal.camera import preset
from lfcal.psf import Facts, PSFMatrix, save, save_regions, verify
from lfcal.psf._specification import SCHEMA, deviations_of, schema
from lfcal.psf.facts import pack_valid

SHAPE = (2, 3, 4, 5, 7)
PAGE = Path(__file__).parents[2] / "docs" / "files.md"
MATRIX = schema()["$defs"]["matrix"]["properties"]


def matrix() -> PSFMatrix:
    """Return an H of which everything is known."""
    positions, ones = SHAPE[:3], np.ones(SHAPE[:3])
    facts = Facts.of(
        positions,
        SHAPE[3:],
        recorded=ones,
        saturated=ones,
        noise=np.ones((*positions, 2)),
        spread=ones,
        valid=pack_valid(np.ones(SHAPE, np.bool_)),
        error=[0.01, 0.02],
        bound=np.full((2, 3), 0.001),
        origin=ones,
    )
    values = np.random.default_rng(0).random(SHAPE).astype("f4")
    return PSFMatrix(
        values, depths=[1.0, 2.0], camera=preset("bench"), anchor=(3.0, 4.0), facts=facts, uncertainty=0.1 * values
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return save(matrix(), tmp_path / "H.h5")


@pytest.mark.parametrize("dtype", ["float32", "rounded", "float64"])
@pytest.mark.parametrize("compression", ["gzip", "none"])
@pytest.mark.few(4)
def test_what_is_written_is_as_specified(tmp_path: Path, dtype: str, compression: str) -> None:
    save(matrix(), tmp_path / "H.h5", dtype=dtype, compression=compression)
    assert verify(tmp_path / "H.h5").deviations == ()
    save(matrix(), tmp_path / "small.h5", store_tolerance=0.005, compression=compression)
    assert verify(tmp_path / "small.h5").deviations == ()
    save_regions({"middle": matrix(), "corner": matrix().T}, tmp_path / "R.h5")
    assert verify(tmp_path / "R.h5").deviations == ()


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


def replace(name: str, value: Any) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        del file[name]
        file[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda file: file.__delitem__("used_window"), "/used_window: missing"),
        (lambda file: file.attrs.__delitem__("provenance"), ", attribute provenance: missing"),
        (lambda file: file.attrs.__setitem__("provenance", "{"), ", attribute provenance: expected JSON, got '{'"),
        (
            lambda file: file["H"].attrs.__delitem__("scaling_factor"),
            "/H, attribute scaling_factor: missing",
        ),
        (replace("depths", np.array([1.0, 2.0], "f4")), "/depths, dtype: expected 'float64', got 'float32'"),
        (
            replace("spread", np.ones((2, 3, 3), "f4")),
            "/spread: expected shape (nz, ny, nx) = (2, 3, 4), got (2, 3, 3)",
        ),
        (replace("valid", np.ones((2, 3, 4, 4), "u1")), "= (2, 3, 4, 5), got (2, 3, 4, 4)"),
        (lambda file: file.attrs.__setitem__("axes", "z,x,y,s,t"), "attribute axes: expected 'z,y,x,t,s'"),
        (
            lambda file: file.attrs.__setitem__("anchor", np.zeros(3)),
            ", attribute anchor: expected shape (2) = (2,), got (3,)",
        ),
    ],
)
def test_each_deviation_is_named(path: Path, change: Callable[[Any], None], line: str) -> None:
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
    save(PSFMatrix(np.ones(SHAPE, "f4"), depths=[1.0, 2.0]), tmp_path / "H.h5")

    def change(file: Any) -> None:
        attributes = dict(file["H"].attrs)
        del file["H"]
        file.create_dataset("H", data=np.ones((2, 3, 4, 6, 7), "f4"))
        file["H"].attrs.update(attributes)

    found = edited(tmp_path / "H.h5", change)
    assert any("/H, shape[3]: expected any value except a multiple of 2, got 6" in one for one in found), found
    assert any("/H, chunks: expected array, got None" in one for one in found)
    assert any("/depth_sum: expected shape (nz, nt, ns) = (2, 6, 7), got (2, 5, 7)" in one for one in found)


def test_version_1_is_not_held_against_it(path: Path) -> None:
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
