"""Simulate as a task: every field can be set on the page, and all routes give the same H and the same frames."""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import InputError, drain
from lfcal.psf import open_psf
from lfcal.records import rows
from lfcal.tasks import command_of, python_of
from lfcal_gui.models import PLAN_FILE, ProjectState
from lfcal_gui.pages.simulate.model import (
    FIELDS,
    HELD,
    KINDS,
    SimulateSettings,
    frames_task,
    matrix_task,
    refusal,
    shown,
)
from lfcal_gui.pages.simulate.page import RESUMED
from lfcal_gui.pages.simulate.step import step
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.gui.pages.simulate.test_model import small_plan

Lfcal = Callable[..., Run]
lfcal = conftest.lfcal
GIVEN = SimulateSettings(0.3, overrides=(("bandwidth", "off"), ("coma", "on")))
GIVEN = GIVEN.with_magnitude("coma", "waves", 0.1 + 0.2, "measured").with_magnitude("coma", "angle_rad", 1e-7)
GIVEN = GIVEN.with_magnitude("zernike", "terms", ((4, 0, 0.1), (3, -1, -0.05)), "measured")
CHOSEN = {
    "one pass": dataclasses.replace(GIVEN, store_tolerance=0.01),
    "passes": dataclasses.replace(GIVEN, progressive=True, store_tolerance=0.01),
    "rays": SimulateSettings(1.5, "geometric", (("vignetting", "on"),)),
}


def values(path: Path) -> dict[str, np.ndarray]:
    """Return all numbers of an H file."""
    found: dict[str, h5py.Dataset] = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, one: found.update({name: one}) if isinstance(one, h5py.Dataset) else None)
        return {name: one[()] for name, one in found.items() if one.dtype.kind in "iuf"}


def known(path: Path) -> dict[str, Any]:
    with open_psf(path) as matrix:
        return {key: matrix.provenance[key] for key in ("task", "plan", "effect_sources")}


@pytest.mark.parametrize("case", CHOSEN)
def test_every_route_gives_the_same_h(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    settings, plan = CHOSEN[case], small_plan()
    drain(matrix_task(settings, "window.h5").work_on(plan, RESUMED)).close()
    project = ProjectState(plan=plan, settings=settings.into(ProjectState()))
    copied = step(project, "command.h5")
    for name, text in copied.files:
        Path(name).write_text(text)
    assert lfcal(*shlex.split(shlex.join(copied.arguments))).code == 0
    exec(step(project, "python.h5").script(), {})
    before = values(Path("window.h5"))
    for path in map(Path, ("command.h5", "python.h5")):
        assert known(path) == known(Path("window.h5"))
        after = values(path)
        assert after.keys() == before.keys()
        for name in before:
            np.testing.assert_array_equal(after[name], before[name], err_msg=f"{path}: {name}")
    assert known(Path("window.h5"))["task"]["camera"] == str(tmp_path / PLAN_FILE)
    assert lfcal("run", "window.h5", "-o", "again.h5").code == 0, "the window's H says how it was made"
    np.testing.assert_array_equal(values(Path("again.h5"))["H"], before["H"])


def test_every_route_gives_the_same_frames(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    plan = dataclasses.replace(small_plan(), depths_um=small_plan().depths_um[:1], exposure_s=0.01, period=(1, 2))
    settings = SimulateSettings(0.5, "geometric", seed=3, peak=0.5).with_magnitude("read_noise", "rms_e", 20.0)
    made = drain(frames_task(settings, "window").work_on(plan, RESUMED))
    assert made.count == 2
    Path(PLAN_FILE).write_text(plan.to_json())
    assert lfcal(*shlex.split(command_of(frames_task(settings, "command")))[1:]).code == 0
    exec(python_of(frames_task(settings, "python")), {})

    def contents(folder: str) -> dict[str, bytes]:
        return {str(path.relative_to(folder)): path.read_bytes() for path in Path(folder).rglob("*.*")}

    assert contents("window") == contents("command") == contents("python")
    truth = json.loads(Path("window/truth.json").read_text())
    assert truth["seed"] == 3 and truth["task"]["seed"] == 3 and truth["task"]["peak"] == 0.5


def test_every_field_is_in_the_form_or_has_a_widget_of_its_own() -> None:
    entries = {field.key for fields in FIELDS for field in fields}
    assert entries | HELD == {row.name for kind in KINDS for row in rows(kind)} and not entries & HELD
    assert entries <= {one.name for one in dataclasses.fields(SimulateSettings)}
    for field in (one for fields in FIELDS for one in fields):
        assert field.label and field.tip.endswith((".", ")")), field.key


def test_the_form_refuses_what_the_command_does_and_passes_lose_nothing() -> None:
    settings = dataclasses.replace(SimulateSettings(), tolerance="3.5%", store_tolerance="1 %")  # type: ignore[arg-type]
    assert (settings.tolerance, settings.store_tolerance) == (0.035, 0.01)
    assert (shown("tolerance", settings), shown("store_tolerance", SimulateSettings())) == ("3.5 %", "")
    assert "Tolerance: expected a number > 0 and ≤ 4" in refusal("tolerance", "5")
    assert "expected auto, geometric" in refusal("level", "waves") and not refusal("level", "reference")
    assert "Seed: expected a whole number" in refusal("seed", -1) and not refusal("store_tolerance", None)
    with pytest.raises(InputError, match="peak"):
        SimulateSettings(peak=0)
    settings = SimulateSettings(progressive=True, store_tolerance=0.1)
    assert command_of(matrix_task(settings, "H.h5")) == f"lfcal simulate {PLAN_FILE} --out=H.h5 --progressive"
    assert "--store-tolerance=0.1" in command_of(matrix_task(dataclasses.replace(settings, progressive=False), "H.h5"))
