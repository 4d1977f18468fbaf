"""Fit as a task: every field of the record is on the page, and window, command and Python give the same."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import drain
from lfcal.camera import ScanPlan
from lfcal.psf import Facts, PSFMatrix, save
from lfcal.records import rows
from lfcal.tasks import FitMatrix, command_of
from lfcal_gui.models import ProjectState, fields_of
from lfcal_gui.pages.h.model_fit import HELD, START, FitSettings
from lfcal_gui.pages.h.model_fit_run import FitRun, asked_of, iter_fit
from lfcal_gui.pages.h.step_fit import step
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.fit.commands import undrawn
from tests.fit.common import few_patterns

lfcal = conftest.lfcal
Lfcal = Callable[..., Run]
FEW = FitSettings(auto=False, groups=("geometry",))


def test_every_field_is_in_the_form_or_has_a_widget_of_its_own() -> None:
    entries = {one.key for one in fields_of(FitMatrix, without=HELD)}
    assert entries | HELD == {row.name for row in rows(FitMatrix)} and START.key in HELD
    assert entries <= {one.name for one in fields(FitSettings)}
    assert all(one.label and one.tip.endswith((".", ")")) for one in fields_of(FitMatrix))


def found(folder: Path) -> tuple[str, np.ndarray, dict[str, Any], dict[str, Any]]:
    """Return camera, H, task of H, and numbers of a fit without the time."""
    numbers = json.loads((folder / "fit.json").read_text())
    del numbers["fitted"]
    with h5py.File(folder / "H.h5") as file:
        told = json.loads(file.attrs["provenance"])["task"]
        return (folder / "camera.json").read_text(), np.asarray(file["H"][:]), told, numbers


def bare() -> PSFMatrix:
    """Return the few patterns as H of nothing but values."""
    few = few_patterns()
    return PSFMatrix(np.asarray(few), facts=Facts.of(few.shape[:3], few.cutout, recorded=few.recorded))


CASES = {
    "camera of the window": (
        replace(FEW, camera="window", groups=("geometry", "depths"), positions=5, noise=(60.0, 1.1), hybrid=True),
        few_patterns,
    ),
    "of nothing but values": (replace(FEW, noise=(64.0, 1.0), effects=("crosstalk=0.01",)), bare),
}


@pytest.mark.parametrize("case", CASES)
def test_all_routes_give_the_same_fit(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    settings, make = CASES[case]
    save(make(), "few.h5")
    few = few_patterns()
    camera = replace(few.camera, lattice=replace(few.camera.lattice, gap_um=1.004 * few.camera.lattice.gap_um))
    plan = ScanPlan(few.camera, few.period, few.cutout, tuple(few.depths), few.anchor)
    project = ProjectState(psf="few.h5", camera=camera, plan=plan)
    kept = FitRun()
    drain(iter_fit(asked_of(project, settings), kept))
    drain(kept.found.iter_saved(tmp_path / "window"))
    drain(kept.found.iter_model(tmp_path / "alone" / "model.h5"))
    copied = step(replace(project, settings=settings.into(project)), "command")
    for name, text in copied.files:
        Path(name).write_text(text)
    assert lfcal(*shlex.split(shlex.join(copied.arguments))).code == 0
    exec(copied.script().replace("'command'", "'script'"), {})
    task = kept.found.question.task_in(tmp_path / "window")
    assert lfcal("run", "window/H.h5", "-o", "again").code == 0
    wanted = found(tmp_path / "window")
    assert wanted[2] == wanted[3].pop("task") == task.to_dict(absolute=True, outputs=False)
    for name in ("command", "script", "again"):
        got = found(tmp_path / name)
        assert got[0] == wanted[0], name
        np.testing.assert_array_equal(got[1], wanted[1], err_msg=name)
        told = got[3].pop("task")
        assert got[3] == wanted[3], name
        held = {"camera", "plan"} if name in ("command", "script") else set()
        assert {key: told[key] for key in told if key not in held} == {
            key: wanted[2][key] for key in wanted[2] if key not in held
        }
    with h5py.File("alone/model.h5") as file:
        alone = json.loads(file.attrs["provenance"])["task"]
        assert alone["unknowns"] == "geometry" and alone["sources"] == [str(tmp_path / "few.h5")]
        if not settings.hybrid:
            np.testing.assert_array_equal(np.asarray(file["H"][:]), wanted[1])
    assert "unknowns=geometry" in command_of(task), "a group that the camera lacks is not asked for"
