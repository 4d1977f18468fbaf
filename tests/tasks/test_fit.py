"""Fits as tasks: every route gives the same bits, kinds of input refuse fields of others, and corrections apply."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import InputError, LfcalError, Work
from lfcal.fit.stored import StoredFit
from lfcal.frames import CorrectionRecipe
from lfcal.psf import save
from lfcal.tasks import (
    CheckMatrix,
    CheckMatrixByScan,
    FitFrames,
    FitMatrix,
    FitTarget,
    PredictObject,
    ValidateFit,
    ValidateFitByFrames,
    Watch,
    job_of,
    load_job,
    python_of,
    task_set,
)
from lfcal.tasks.task import Task
from tests.cli import conftest
from tests.cli.conftest import Lfcal
from tests.fit.commands import undrawn
from tests.fit.common import few_fit, few_patterns
from tests.tasks.routes import check_every_route

lfcal = conftest.lfcal


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    save(few_patterns(), tmp_path / "few.h5")
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    return tmp_path


def found(folder: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Return H of a fit, and its numbers without the time and the place."""
    numbers = json.loads((folder / "fit.json").read_text())
    with h5py.File(folder / "H.h5") as file:
        return np.asarray(file["H"][:]), {key: numbers[key] for key in numbers if key not in ("fitted", "task")}


def test_every_route_gives_the_same_bits(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = FitMatrix(sources=place / "few.h5", out=place / "direct", unknowns="geometry", noise=(64.0, 1.0))
    check_every_route(lfcal, monkeypatch, task, place)
    first = place / "direct"
    task.run()
    lfcal("run", first / "H.h5", "-o", "again").ok()
    (wanted, numbers), (values, told) = found(first), found(place / "again")
    np.testing.assert_array_equal(values, wanted)
    assert told == numbers
    kept = json.loads((first / "fit.json").read_text())["task"]
    assert kept == task.to_dict(absolute=True, outputs=False) and kept["noise"] == [64.0, 1.0]


TASKS: tuple[Task, ...] = (
    FitFrames(sources=("a", "b"), plan="plan.json", corrections=CorrectionRecipe(dark="dark"), hybrid=True),
    FitMatrix(sources="H.h5", camera="bench", effects=("crosstalk=0.01", "more.json"), write_h=False, positions=0),
    FitTarget(sources="frames", regions="3x3", unknowns="geometry, iris"),
    CheckMatrix(matrix="H.h5", frames=("one.tif", "two.tif"), limit="3%", noise="64,0.5"),
    CheckMatrixByScan(matrix="H.h5", frames="session", plan="plan.json", positions=9),
    ValidateFit(fit="fit", sources="H.h5", other=True),
    ValidateFitByFrames(fit="fit", sources="session", orientation="rot90"),
    Watch(psf="H.h5", frames=("a.tif", "b"), quiet=("monday", "c.tif"), mean=3, rate="2%", noise="64,1", out="watch"),
    PredictObject(fit="fit", frame="frame.tif", scene="object.npy"),
)


@pytest.mark.parametrize("task", TASKS, ids=lambda task: type(task).__name__)
def test_a_task_goes_to_texts_and_back(task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # what the input is decides which kind it is: here nothing is there
    tasks = task_set(task.name)
    monkeypatch.setitem(vars(tasks), "choose", lambda _: type(task))
    Path("job.toml").write_text(job_of(task))
    read, _ = load_job(Path("job.toml"))
    assert read == task
    made: dict[str, Any] = {}
    exec(python_of(task).replace(".run()", ""), made)
    assert made["made"] == task


def test_a_wrong_value_ends_in_one_sentence() -> None:
    for kind, wrong, words in (
        (FitMatrix, {"unknowns": "gap"}, "unknowns: expected auto or groups of unknowns, got gap"),
        (FitMatrix, {"noise": "64"}, "noise: expected CONSTANT,SLOPE of the variance"),
        (FitMatrix, {"positions": -1}, "positions: expected a whole number ≥ 0"),
        (FitMatrix, {"hybrid": True, "write_h": False}, "--hybrid: expected an H to write"),
        (CheckMatrix, {"limit": 2.0}, "limit: expected a number > 0 and < 1"),
    ):
        with pytest.raises(InputError) as error:
            kind(**({"sources": "H.h5"} if kind is FitMatrix else {"matrix": "H.h5", "frames": "f.tif"}), **wrong)
        assert words in str(error.value) and "\n" not in str(error.value), wrong


CORRECTIONS = {
    "--dark": "dark",
    "--black-level": "100",
    "--white": "white.tif",
    "--defect-list": "hot.txt",
    "--mask": "mask.png",
    "--white-mode": "pixels",
    "--white-floor": "0.1",
    "--background": "border",
    "--exposure": "none",
    "--saturation": "4000",
}


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("fit", "frames/"), FitFrames),
        (("fit", "check", "H.h5", "frame.tif"), CheckMatrix),
        (("fit", "validate", "fit", "frames"), ValidateFitByFrames),
        (("fit", "object", "fit", "frame.tif", "--scene", "object.npy"), PredictObject),
    ],
)
def test_frames_have_all_corrections_of_an_assembly(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], kind: type[Any]
) -> None:
    """All corrections of lfcal assemble, so that frames need not be assembled first."""
    monkeypatch.chdir(tmp_path)
    seen: list[Any] = []

    def work(task: object, _: object) -> Work[tuple[()]]:
        seen.append(task)
        yield from ()
        return ()

    monkeypatch.setattr(kind, "work", work)
    monkeypatch.setattr(kind, "files", lambda *_: ())
    lfcal(*words, "--defects", *(word for pair in CORRECTIONS.items() for word in pair))
    (task,) = seen
    recipe = task.corrections
    assert type(task) is kind and recipe.defects and recipe.saturation == 4000 and recipe.background == "border"
    assert (recipe.dark, recipe.white, recipe.white_mode, recipe.white_floor) == ("dark", "white.tif", "pixels", 0.1)
    assert recipe.black_level == 100 and recipe.exposure == "none"
    assert (recipe.defect_list, recipe.mask) == ("hot.txt", "mask.png")


def test_a_fit_of_regions_is_read_by_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("field").mkdir()
    task = ValidateFit(fit=Path("field"), sources=(Path("centre.h5"),))
    for text, words in (
        ('{"regions": []}', "expected a fit of several regions"),
        ('{"regions": [{"name": "../away"}]}', "expected a fit of several regions"),
        ("[]", "expected a fit of several regions"),
        ("{", "field.json"),
    ):
        Path("field", "field.json").write_text(text)
        with pytest.raises(LfcalError, match=words):
            task.files("out")
    stored = StoredFit.of(few_fit())
    monkeypatch.setattr("lfcal.fit.stored.read_fit", lambda folder: replace(stored, folder=folder))
    Path("field", "field.json").write_text('{"regions": [{"name": "centre"}, {"name": "edge"}]}')
    assert [str(path) for path in task.files("out")] == [
        "field/centre/validation.json",
        "field/centre/report/validation.png",
    ]
    assert task.files("in") == (Path("centre.h5"), Path("field/field.json"))
    elsewhere = replace(task, sources=(Path("corner.h5"),))
    with pytest.raises(InputError, match=r"regions of the fit: centre, edge, got corner; .*--other"):
        elsewhere.files("out")
    assert [path.parent for path in replace(elsewhere, other=True).files("out")] == [
        Path("field"),
        Path("field/report"),
    ]
    with pytest.raises(InputError, match="expected one recording, got 2"):
        replace(task, sources=(Path("a.h5"), Path("b.h5")), other=True).files("out")
