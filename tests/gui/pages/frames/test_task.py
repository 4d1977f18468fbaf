"""Frames as a task: every field of the record can be set on the page, and all routes give the same H."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.base import drain
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal.records import rows
from lfcal.tasks import Assemble
from lfcal_gui.context import Context
from lfcal_gui.models import CommandStep, ProjectState, check_of, fields_of, options_in, shown_of
from lfcal_gui.pages.frames.model import HELD, FrameSettings, iter_assembly, load_frame, open_imported, task_of
from lfcal_gui.pages.frames.step import step
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.gui.conftest import OpenPage

lfcal = conftest.lfcal
SAMPLE = Path(__file__).parents[4] / "sample_data" / "session"
CHOSEN = FrameSettings(
    use_white=False,
    use_background=True,
    interpolation="linear",
    options=(("cutout", (41, 31)), ("dtype", "float32"), ("pad", True), ("strict", True)),
)


def values(path: Path) -> np.ndarray:
    with h5py.File(path) as file:
        return np.asarray(file["H"][:])


def test_every_field_is_in_the_form_or_has_a_widget_of_its_own() -> None:
    names = {row.name for row in rows(Assemble)}
    assert {one.key for one in fields_of(Assemble, without=HELD)} | HELD == names
    own = {one.name for one in dataclasses.fields(FrameSettings)}
    assert {"frames", "out", "plan"} == {name for name in HELD - own if f"use_{name}" not in own}


def test_every_field_has_label_and_help() -> None:
    for field in fields_of(Assemble):
        assert field.label and field.tip.endswith((".", ")")), field.key


def test_the_form_shows_and_refuses_what_the_command_does() -> None:
    shown, check = shown_of(Assemble, CHOSEN.option_values), check_of(Assemble)
    assert (shown["cutout"], shown["dtype"], shown["pad"], shown["lost"]) == ("41, 31", "float32", True, "0.5 %")
    for key, value in shown.items():
        if key not in HELD:
            assert not check(key, value), (key, value)
    assert "expected a number > 0 and ≤ 1" in check("white_floor", 2.0)
    assert "expected rounded or float32" in check("dtype", "float16")
    assert options_in(Assemble, {"cutout": "41x31", "lost": "0.5%"}) == {"cutout": (41, 31)}


def test_values_that_need_another_one_are_refused() -> None:
    kept, refused = FrameSettings.read({**CHOSEN.to_dict(), "options": [["lost", 0.1]], "pattern": "z{z}.png"})
    assert kept.pattern == "z{z}.png" and kept.options == () and kept.interpolation == "linear"
    assert refused == ("settings of frames: options: lost: expected cutout auto, got as planned; leave lost out",)


@pytest.fixture
def plan() -> ScanPlan:
    return ScanPlan.from_json((SAMPLE / "plan.json").read_text())


def test_the_window_its_command_and_its_python_give_the_same_bits(
    lfcal: Callable[..., Run], plan: ScanPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = dataclasses.replace(CHOSEN, dark=str(SAMPLE / "dark"))
    frames = str(SAMPLE / "frames")
    opened = open_imported(frames, settings, plan)
    report = drain(iter_assembly(opened, "window.h5"))
    report.matrix.close()
    loaded = load_frame(opened, Position(0, 9, 9))
    assert loaded.window[2:] == (41, 31) and loaded.crop is not None and loaded.crop[1].shape == (41, 31)
    opened.close()
    project = ProjectState(frames=frames, plan=plan, settings={"frames": settings.to_dict()})
    steps: list[CommandStep] = [step(project, name) for name in ("command.h5", "python.h5")]
    for name, text in steps[0].files:
        Path(name).write_text(text)
    assert lfcal(*shlex.split(shlex.join(steps[0].arguments))).code == 0
    exec(steps[1].script(), {})
    for name in ("command.h5", "python.h5"):
        np.testing.assert_array_equal(values(tmp_path / name), values(tmp_path / "window.h5"), err_msg=name)
    assert task_of(settings, frames, "H.h5").settings.cutout == (41, 31)


def test_a_file_that_is_chosen_is_kept_with_the_project(open_page: OpenPage, context: Context) -> None:
    """The path of a list stayed a path, and the project could not be saved."""
    page = open_page("frames")
    for key in ("leave_out", "fill"):
        page._edited(key, f"{key}.json")  # type: ignore[attr-defined]
        assert f"{key}.json" in context.state.to_json()
        assert FrameSettings.of(context.state).option_values[key] == Path(f"{key}.json")
