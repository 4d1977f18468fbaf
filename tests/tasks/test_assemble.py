"""One record per task: command, Python, job file and an H file made again give the same bits."""

from __future__ import annotations

import dataclasses
import inspect
import re
import traceback
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import lfcal as lfcal_package
from lfcal.base import FileFormatError, InputError, LfcalError, Progress
from lfcal.frames import CorrectionRecipe
from lfcal.psf import AssemblySettings
from lfcal.psf.store import MatrixGroup
from lfcal.records import rows
from lfcal.tasks import Assemble, command_of, job_of, load_job, task_set
from tests.cli import conftest
from tests.cli.conftest import Lfcal
from tests.tasks.routes import check_every_route

lfcal = conftest.lfcal
ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_data" / "recorded"


def values(path: Path) -> np.ndarray:
    with h5py.File(path) as file:
        return np.asarray(file["H"][:])


@pytest.fixture
def task(tmp_path: Path) -> Assemble:
    settings = AssemblySettings(cutout=(41, 31), dtype="float32", compression="none")
    return Assemble(
        frames=SAMPLE, out=tmp_path / "H.h5", corrections=CorrectionRecipe(exposure="none"), settings=settings
    )


def test_every_route_gives_the_same_bits(
    lfcal: Lfcal, task: Assemble, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_every_route(lfcal, monkeypatch, task, tmp_path)
    first, routes = tmp_path / "H.h5", [tmp_path / "again.h5"]
    task.run()[0].close()
    lfcal("run", first, "-o", routes[-1]).ok()
    how: dict[str, Any] = {"exposure": "none", "cutout": "41x31", "dtype": "float32", "compression": "none"}
    routes.append(tmp_path / "by_name.h5")
    lfcal_package.assemble(SAMPLE, routes[-1], **how)[0].close()
    read = load_job(routes[-1], {"out": str(routes[-1])})[0]
    assert command_of(task).replace("H.h5", "by_name.h5") == command_of(read)
    before = values(first)
    for path in routes:
        np.testing.assert_array_equal(values(path), before, err_msg=path.name)


def test_a_job_keeps_every_value(task: Assemble, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(job_of(task))
    assert load_job(tmp_path / "job.toml")[0] == task
    said = (tmp_path / "job.toml").read_text()
    for row in rows(Assemble):
        assert f"{row.name} = " in said or row.default is None, "what is at its default is kept, too"


def test_what_a_job_reads_is_shown_before_it_runs(lfcal: Lfcal, task: Assemble, tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text(job_of(task))
    shown = lfcal("run", tmp_path / "job.toml", "--show")
    assert shown.code == 0 and f"reads: {SAMPLE}" in shown.out and command_of(task) in shown.out
    assert not (tmp_path / "H.h5").exists()
    task.run()[0].close()
    lfcal("run", tmp_path / "H.h5").refused("the file that is used as the job cannot be replaced")
    assert lfcal("run", tmp_path / "H.h5", "--show", "--json").json["reads"] == [str(SAMPLE)]


def test_a_wrong_job_ends_in_one_sentence(tmp_path: Path) -> None:
    begun = 'task = "assemble"\nframes = "f"\n'
    for text, words in (
        ("frames = 3", "add the task"),
        ('task = "asemble"', "did you mean assemble?"),
        (f'{begun}ouut = "H.h5"', "did you mean out?"),
        (f'{begun}out = "H.h5"\n[settings]\nlost = 2', "settings.lost: expected a number > 0"),
        (begun, "--out: expected a value"),
        ("task = ", "expected TOML"),
        (f'{begun}out = "H.h5"\n[run]\nwokers = 2', "run"),
    ):
        (tmp_path / "job.toml").write_text(text)
        with pytest.raises((InputError, FileFormatError)) as error:
            load_job(tmp_path / "job.toml")
        assert words in str(error.value) and "\n" not in str(error.value), text


def test_provenance_has_every_value() -> None:
    for kind in task_set("assemble").kinds:
        said = kind(frames=Path("f"), out=Path("o")).to_dict()
        for row in rows(kind):
            place: Any = said
            for name in row.path[:-1]:
                place = place[name]
            assert row.name in place and dataclasses.is_dataclass(kind)


def test_from_the_command_to_h_few_files_are_passed_and_few_values_handed_on(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is on the way when a plane of H is written: where one has to look who follows a value."""
    passed: list[tuple[str, int]] = []
    write = MatrixGroup.write_plane

    def noted(*args: Any, **more: Any) -> Any:
        for frame, _ in traceback.walk_stack(None):
            code, path = frame.f_code, Path(frame.f_code.co_filename)
            if path.is_relative_to(ROOT / "lfcal"):
                passed.append((path.relative_to(ROOT).as_posix(), code.co_argcount + code.co_kwonlyargcount))
        return write(*args, **more)

    monkeypatch.setattr(MatrixGroup, "write_plane", noted)
    lfcal("assemble", SAMPLE, "-o", tmp_path / "H.h5", "--workers", 1).ok()
    files = {file for file, _ in passed}
    assert {"lfcal/cli/_task_command.py", "lfcal/tasks/assembly.py", "lfcal/psf/make.py"} < files
    assert len(files) <= 15 and max(values for _, values in passed) <= 12


def test_python_has_every_field_as_a_keyword_with_type_default_and_help() -> None:
    known = {row.name: row for row in rows(Assemble)}
    given = dict(inspect.signature(lfcal_package.assemble).parameters)
    assert given.pop("run").default is None and given.pop("on_progress").default is None
    assert given.keys() == known.keys()
    words = re.sub(r"\s+", " ", inspect.getdoc(lfcal_package.assemble) or "")
    kinds: dict[type, str] = {Path: "str | Path"}
    for name, one in given.items():
        row = known[name]
        assert one.default == (inspect.Parameter.empty if row.default is dataclasses.MISSING else row.default), name
        assert kinds.get(row.kind, "str | Path" if row.opt.file else row.kind.__name__) in one.annotation, name
        assert ("None" in one.annotation) is row.optional, name
        assert f"{name} : {one.annotation} {row.described} " in words, name
    assert (
        "Largest fraction of a pattern's energy that may be outside an automatic cutout. (> 0, < 1; default: 0.005)"
        in words
    )


def test_python_reports_progress_to_a_function(tmp_path: Path) -> None:
    records: list[Progress] = []
    lfcal_package.assemble(SAMPLE, tmp_path / "H.h5", on_progress=records.append)
    assert records[-1].done == records[-1].total > 1


def test_a_wrong_value_in_python_ends_in_one_sentence(tmp_path: Path) -> None:
    cutout = "cutout: expected auto, or odd numbers of pixels such as '41', '41x41' or (41, 41), got 40"
    for values, words in (
        ({"lost": 2}, "lost: expected a number > 0 and < 1, got 2"),
        ({"pad": "yes"}, "pad: expected true or false, got 'yes'"),
        ({"cutout": 40}, cutout),
        ({"lost": "1%"}, "lost: expected cutout auto, got as planned"),
        ({"white_floor": 0.1}, "white_floor: expected white, got none"),
        ({"background": 3.0}, "background: expected text, got 3.0"),
        ({"frames": "nowhere"}, "nowhere"),
    ):
        with pytest.raises(LfcalError) as error:
            lfcal_package.assemble(**{"frames": SAMPLE, "out": tmp_path / "H.h5", **values})
        assert words in str(error.value) and "\n" not in str(error.value)
        assert not (tmp_path / "H.h5").exists(), values
