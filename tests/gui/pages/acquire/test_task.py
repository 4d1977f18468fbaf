"""Acquire as a task: every field of the records has a place on the page, and all routes record the same session."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire import Options, RedoList, SessionFile, recipe_of
from lfcal.base import drain
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.records import rows
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil, RunSettings, load_job
from lfcal_gui.models import CommandStep, ProjectState, fields_of
from lfcal_gui.pages.acquire.model import FIELDS, HELD, MORE, UNTIL, AcquireSettings
from lfcal_gui.pages.acquire.model_recorder import Recorder
from lfcal_gui.pages.acquire.model_station import Station, open_station
from lfcal_gui.pages.acquire.step import assembled, iter_assembly, step
from tests.acquire.rigs import small_plan
from tests.cli import conftest
from tests.cli.conftest import Run

lfcal = conftest.lfcal
Lfcal = Callable[..., Run]
PLAN = small_plan((2, 3), 2, settle_s=0.0)
CHOSEN = AcquireSettings(
    device_options=(("optics", "pattern"), ("seed", "3")),
    darks=2,
    reference_every=4,
    bracket=(1.0, 0.25),
    check_stage=False,
    tolerance=(3.0, 3.0, 9.0),
)


def frames(folder: Path) -> np.ndarray:
    with open_frames(folder) as source:
        return np.stack([source.read(k) for k in range(len(source))])


@pytest.fixture
def station() -> Iterator[Station]:
    made = open_station(PLAN, CHOSEN.backend, CHOSEN.devices(), CHOSEN.stage)
    yield made
    made.close()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def recorded(station: Station, out: Path) -> Acquire:
    """Record as the page does; return the task."""
    task = CHOSEN.task(str(out / "session.json"), str(out))
    drain(Recorder(task, PLAN, task.options()).work(station))
    return task


def project_of(out: str) -> ProjectState:
    return ProjectState(plan=PLAN, recording=out, settings={"acquire": CHOSEN.to_dict()})


def write_files(made: CommandStep) -> None:
    for name, text in made.files:
        Path(name).write_text(text)


def test_every_route_records_the_same(lfcal: Lfcal, station: Station, folder: Path) -> None:
    task = every_route(lfcal, station, folder, CHOSEN)
    first = SessionFile.read(folder / "window")
    assert first.options == task.options() != Options() and first.options.bracket == (1.0, 0.25)
    for name in ("command", "python"):
        session = SessionFile.read(folder / name)
        assert (session.options, session.plan, session.devices) == (first.options, PLAN, first.devices), name
    (by_window, _), (by_command, _) = (load_job(folder / name / "job.json") for name in ("window", "command"))
    assert by_window == dataclasses.replace(by_command, plan=folder / "window/session.json", out=folder / "window")


def test_every_route_records_a_list_of_positions(lfcal: Lfcal, station: Station, folder: Path) -> None:
    half = [(0, 0, 1), (1, 1, 2)]
    RedoList.of(half).write(Path("half.json"))
    chosen = dataclasses.replace(CHOSEN, positions="half.json", bracket=None)
    every_route(lfcal, station, folder, chosen)
    for name in ("window", "command", "python"):
        there = SessionFile.read(folder / name).acknowledged(folder / name)
        assert [tuple(place) for place in np.argwhere(there).tolist()] == half, name
    project = ProjectState(plan=PLAN, recording="command", settings={"acquire": chosen.to_dict()})
    assert not any("half.json" in word for word in step(project, resume=True).arguments), "a session keeps its list"


def test_a_session_of_the_window_continues_by_its_job(lfcal: Lfcal, station: Station, folder: Path) -> None:
    out = folder / "window"
    task = CHOSEN.task(str(out / "session.json"), str(out))
    recorder = Recorder(task, PLAN, task.options())
    for record in recorder.work(station):
        if record.stage == "record" and record.done >= 2:
            recorder.control.stop()
    assert len(frames(out)) < PLAN.n_positions
    done = lfcal("run", out / "job.json", "--resume")
    assert done.code == 0, done.err
    assert len(frames(out)) == PLAN.n_positions


def test_how_a_session_began_is_not_in_the_command_that_continues_it() -> None:
    resumed = step(project_of("s"), resume=True)
    assert "--resume" in resumed.arguments and "RunSettings(resume=True)" in resumed.python
    assert not any(word.startswith(("--darks", "--bracket", "--reference")) for word in resumed.arguments)
    assert "--tolerance=3,3,9" in resumed.arguments, "how the stage is driven may change"


def test_every_route_makes_the_same_h(lfcal: Lfcal, station: Station, folder: Path) -> None:
    task, out = recorded(station, folder / "s"), folder / "s"
    recipe = recipe_of(out)
    drain(iter_assembly(out, folder / "window.h5", None, recipe)).matrix.close()
    made = assembled(str(out), "command.h5", None, recipe)
    assert lfcal(*made.arguments).code == 0
    exec(assembled(str(out), "python.h5", None, recipe).script(), {})
    with open_psf(folder / "window.h5") as first:
        kept = task.to_dict(absolute=True, outputs=False)
        assert first.provenance["earlier_tasks"] == [kept] and first.provenance["task"]["task"] == "assemble"
        for name in ("command.h5", "python.h5"):
            with open_psf(folder / name) as H:
                np.testing.assert_array_equal(np.asarray(H), np.asarray(first), err_msg=name)
                assert H.provenance["task"] == first.provenance["task"]


def test_a_target_and_an_error_of_h_are_other_tasks() -> None:
    target = dataclasses.replace(CHOSEN, target="target.json")
    assert isinstance(target.task("target.json", "s"), AcquireTarget) and target.options().bracket == (1.0, 0.25)
    until = dataclasses.replace(CHOSEN, extent="error", bracket=None, most=40)
    task = until.task("plan.json", "s")
    assert isinstance(task, AcquireUntil) and task.until_error == 0.005 and until.goal() == task.goal
    assert isinstance(until.task("plan.json", "s", begun=True, redo="r.json"), Acquire)
    chosen = dataclasses.replace(until, unknowns=("iris", "distance"), positions="half.json")
    assert chosen.task("plan.json", "s") == dataclasses.replace(task, unknowns=("iris", "distance"))


OLD = {
    **{"backend": "sim", "stage": "", "device_options": [["optics", "pattern"]], "target": "", "extent": "whole"},
    **{"coarse": True, "error": 0.002, "most": None, "bracket": [1.0], "darks": 0, "dark_every": 0, "controls": 2},
    **{"reference_every": 100, "retries": 5, "on_suspect": "stop", "allow_automatic": False, "check_stage": False},
    **{"suspend": "temperature=20:22; lamp=95:105", "steady_s": 4.0, "margin_px": 3, "tolerance_um": []},
    "overshoot_um": [0.0, 0.0, 5.0],
}
"""Settings as earlier versions stored them."""


def test_projects_of_earlier_versions_and_others_keep_all_values_but_bad_ones() -> None:
    found, refused = AcquireSettings.read(OLD)
    assert not refused
    assert found == AcquireSettings(
        device_options=(("optics", "pattern"),),
        until_error=0.002,
        order="coarse",
        darks=0,
        controls=2,
        retries=5,
        check_stage=False,
        suspend=("temperature=20:22", "lamp=95:105"),
        steady=4.0,
        margin=3,
        overshoot=(0.0, 0.0, 5.0),
    )
    assert AcquireSettings.read(found.to_dict()) == (found, ())
    plain = AcquireSettings.read({**OLD, "suspend": "", "darks": 8, "dark_every": 50})[0]
    assert (plain.steady, plain.darks, plain.dark_every) == (None, None, 50)
    found, refused = AcquireSettings.read({**CHOSEN.to_dict(), "retries": -1, "suspend": ["temperature"]})
    assert found == dataclasses.replace(CHOSEN, retries=None, suspend=()) and len(refused) == 2
    assert "settings of acquire: retries: " in refused[0] and "settings of acquire: suspend: " in refused[1]


def test_a_session_is_recorded_with_the_plan_of_another(folder: Path) -> None:
    (folder / "plan.json").write_text(PLAN.to_json())
    quick: dict[str, Any] = {"option": ("optics=pattern",), "check_stage": False, "darks": 0, "reference_every": 0}
    Acquire(plan="plan.json", out="first", **quick).run()
    Acquire(plan="first/session.json", out="second", **quick).run(RunSettings())
    assert SessionFile.read(Path("second")).plan == PLAN


def every_route(lfcal: Lfcal, station: Station, folder: Path, chosen: AcquireSettings) -> Acquire:
    """Record ``window``, ``command`` and ``python`` by these settings; return the task of the window."""
    out = folder / "window"
    task = chosen.task(str(out / "session.json"), str(out))
    drain(Recorder(task, PLAN, task.options()).work(station))
    project = ProjectState(plan=PLAN, recording="command", settings={"acquire": chosen.to_dict()})
    made = step(project)
    write_files(made)
    done = lfcal(*made.arguments)
    assert done.code == 0, done.err
    exec(step(dataclasses.replace(project, recording="python")).script(), {})
    for name in ("command", "python"):
        np.testing.assert_array_equal(frames(folder / name), frames(out), err_msg=name)
    return task


def test_every_field_is_in_a_form_or_has_its_own_widget_with_label_and_help() -> None:
    every = [one.key for one in (*FIELDS, *MORE, *UNTIL)]
    fields = set(every)
    assert len(every) == len(fields)
    for kind in (Acquire, AcquireTarget, AcquireUntil):
        assert {row.name for row in rows(kind)} <= (fields - {"frames_averaged"}) | HELD, kind
    own = {one.name for one in dataclasses.fields(AcquireSettings)}
    assert own - fields == {"backend", "stage", "device_options", "target", "extent"}
    assert fields - own == {"frames_averaged", "origin"}, "they are the plan's"
    for field in (*fields_of(Acquire), *UNTIL):
        assert field.label and field.tip.endswith((".", ")")), field.key
