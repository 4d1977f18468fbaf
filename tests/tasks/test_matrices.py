"""Transpose, reduce and export: every route gives the same file, and what does not apply is refused in each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.psf import MAT_ORDERS, PSFMatrix, open_psf, save
from lfcal.records import rows
from lfcal.tasks import ExportH5, ExportMat, ExportNpy, ExportTiff, Reduce, Task, Transpose, load_job, task_set
from tests.cli import conftest
from tests.tasks.routes import Lfcal, go_every_route

lfcal = conftest.lfcal
FORMATS = (ExportMat, ExportH5, ExportNpy, ExportTiff)


def test_a_task_without_its_input_is_refused(tmp_path: Path) -> None:
    for name in ("assemble", "export", "transpose"):
        (tmp_path / "job.toml").write_text(f'task = "{name}"\nout = "x.h5"\n')
        with pytest.raises(InputError, match="expected a value, got none; state this value"):
            load_job(tmp_path / "job.toml")


@pytest.fixture
def H(tmp_path: Path) -> Path:
    """Write an H of two planes, 3 x 3 positions and 5 x 7 pixels, which an earlier task made."""
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    path = tmp_path / "H.h5"
    save(PSFMatrix(values, depths=(-5.0, 5.0), provenance={"task": {"task": "assemble"}}), path)
    return path


def contents(path: Path) -> Any:
    """Return the values of a file; of formats that hold nothing else all bytes."""
    if path.suffix not in (".h5", ".mat"):
        return path.read_bytes()
    with h5py.File(path) as file:
        found: dict[str, Any] = {}
        file.visititems(
            lambda name, one: found.update({name: np.asarray(one[()]).tobytes()} if hasattr(one, "shape") else {})
        )
    return found


TASKS: tuple[tuple[type[Task], str, dict[str, Any]], ...] = (
    (Transpose, "out.h5", {"method": "paper", "compression": "none"}),
    (Reduce, "out.h5", {"tolerance": 0.02, "compression": "zstd"}),
    (ExportMat, "out.mat", {"no_ht": True, "rows_first": True, "uncompressed": True}),
    (ExportH5, "out.h5", {"transposed": True, "dtype": "float32"}),
    (ExportNpy, "out.npy", {"transposed": True}),
    (ExportTiff, "out.tif", {"position": (2, 1)}),
)


@pytest.mark.parametrize(("kind", "name", "more"), TASKS)
def test_every_route_gives_the_same_bits_and_keeps_the_task(
    lfcal: Lfcal, H: Path, tmp_path: Path, kind: type[Task], name: str, more: dict[str, Any]
) -> None:
    task = kind(source=H, out=tmp_path / name, **more)  # type: ignore[call-arg]
    first, *others = go_every_route(lfcal, task, tmp_path / name)
    if first.suffix == ".h5":
        others.append(tmp_path / "again.h5")
        lfcal("run", first, "-o", others[-1]).ok()
        with open_psf(first) as made:
            known = made.provenance
        assert known["task"] == task.to_dict(absolute=True, outputs=False)
        assert known["earlier_tasks"] == [{"task": "assemble"}]
        if kind is Reduce:
            Reduce(source=first, out=tmp_path / "small.h5").run()[0].close()
            with open_psf(tmp_path / "small.h5") as made:
                assert [one["task"] for one in made.provenance["earlier_tasks"]] == ["assemble", task.name]
    for path in others:
        assert contents(path) == contents(first), path.name


@pytest.mark.parametrize("kind", FORMATS)
def test_a_format_has_no_options_of_others(lfcal: Lfcal, H: Path, tmp_path: Path, kind: type[ExportMat]) -> None:
    own, name = {row.name for row in rows(kind)}, f"x{kind.suffixes[0]}"
    others = {row.name: row for one in FORMATS for row in rows(one) if row.name not in own}
    assert others
    for option, row in others.items():
        text = {"interpolation": "linear", "dtype": "rounded", "position": "1,1"}.get(option, "")
        with pytest.raises(TypeError, match=option):
            kind(source=H, out=tmp_path / name, **{option: row.value(text, option) if text else True})
        lfcal("export", H, "-o", tmp_path / name, row.flag, *([text] if text else [])).refused(
            f"{row.flag}: expected", f"got {kind.input_words}"
        )
        value = f'"{text}"' if text else "true"
        (tmp_path / "job.toml").write_text(f'task = "export"\nsource = "H.h5"\nout = "{name}"\n{option} = {value}\n')
        with pytest.raises(InputError, match=f"{option}: expected .*, got {kind.input_words}"):
            load_job(tmp_path / "job.toml")
    assert not (tmp_path / name).exists()


def test_a_format_is_that_of_the_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"out: expected a \.mat file, got x\.npy"):
        ExportMat(source="H.h5", out="x.npy")
    with pytest.raises(InputError, match="--out: expected a value, got none"):
        task_set("export").make({"source": Path("H.h5")}, str)
    with pytest.raises(InputError, match=r"suffix of the output file: expected .mat .h5 .npy .tif .tiff, got .xyz"):
        task_set("export").make({"source": Path("H.h5"), "out": Path("a.xyz")}, str)


def test_the_order_of_axes_is_that_of_a_mat_file() -> None:
    assert tuple(MAT_ORDERS) == next(row.choices for row in rows(Transpose) if row.name == "mat_order")
    for kind, out in ((Transpose, "out.h5"), (Reduce, "out.h5"), (ExportNpy, "out.npy")):
        with pytest.raises(InputError, match=r"mat_order: expected a \.mat file, got H\.h5"):
            kind(source="H.h5", out=out, mat_order="rows-first")
        assert kind(source="H.mat", out=out, mat_order="rows-first")
