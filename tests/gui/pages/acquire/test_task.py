"""Acquire as a task: every field of the records has a place on the page, and all routes record the same session."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire import Options, RedoList, SessionFile
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.stills import recipe_of
from lfcal.base import drain
from lfcal.devices import Rig, open_rig
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.records import rows
from lfcal.tasks import Acquire, AcquireTarget, AcquireUntil, RunSettings, job_of, load_job
from lfcal_gui.models import CommandStep, ProjectState, check_of, fields_of, options_in, shown_of
from lfcal_gui.pages.acquire.model import FIELDS, HELD, MORE, UNTIL, AcquireSettings
from lfcal_gui.pages.acquire.model_recorder import Recorder
from lfcal_gui.pages.acquire.model_station import Station, open_station
from lfcal_gui.pages.acquire.step import assembled, iter_assembly, step
from tests.acquire.rigs import small_plan
from tests.cli import conftest
from tests.cli.conftest import Run

lfcal = conftest.lfcal
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


def recorded(station: Station, out: Path, **how: Any) -> Acquire:
    """Record as the page does; return the task."""
    begun = bool(how)
    listed = str(out / "lfcal-redo.json") if how.get("redo") else ""
    task = CHOSEN.task(str(out / "session.json"), str(out), begun=begun, redo=listed)
    assert isinstance(task, Acquire)
    drain(Recorder(task, PLAN, task.options(out if begun else None), **how).work(station))
    return task


def project_of(out: str) -> ProjectState:
    return ProjectState(plan=PLAN, recording=out, settings={"acquire": CHOSEN.to_dict()})


def write_files(made: CommandStep) -> None:
    for name, text in made.files:
        Path(name).write_text(text)


def test_every_field_is_in_a_form_or_has_its_own_widget() -> None:
    for kind in (Acquire, AcquireTarget, AcquireUntil):
        shown = {one.key for one in (*FIELDS, *MORE, *UNTIL)} - {"frames_averaged"}
        assert {row.name for row in rows(kind)} <= shown | HELD, kind
    own = {one.name for one in dataclasses.fields(AcquireSettings)}
    fields = {one.key for one in (*FIELDS, *MORE, *UNTIL)}
    assert own - fields == {"backend", "stage", "device_options", "target", "extent"}
    assert fields - own == {"frames_averaged", "origin"}, "they are the plan's"
    every = [one.key for one in (*FIELDS, *MORE, *UNTIL)]
    assert len(every) == len(set(every))


def test_every_field_has_label_and_help() -> None:
    for field in (*fields_of(Acquire), *UNTIL):
        assert field.label and field.tip.endswith((".", ")")), field.key


def test_forms_offer_no_value_first_and_several_values_by_semicolons() -> None:
    fields = {one.key: one for one in MORE}
    assert fields["on_suspect"].choices == ((None, "default (stop)"), ("stop", "stop"), ("flag", "flag"))
    assert [value for value, _ in fields["check_stage"].choices] == [None, True, False]
    assert fields["check_origin"].tip.startswith("Check the origin")
    given = {"suspend": " temperature=20:22 ;lamp=90: ", "on_suspect": None, "check_stage": False}
    found = options_in(Acquire, given)
    assert found == {"suspend": ("temperature=20:22", "lamp=90:"), "check_stage": False}
    assert shown_of(Acquire, found)["suspend"] == "temperature=20:22; lamp=90:"
    assert shown_of(Acquire, {})["suspend"] == "" and shown_of(Acquire, {})["on_suspect"] is None
    assert "expected" in check_of(Acquire)("on_suspect", "ask")


def test_the_window_its_command_its_python_and_its_job_record_the_same(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
    task = recorded(station, folder / "window")
    made = step(project_of("command"))
    write_files(made)
    done = lfcal(*made.arguments)
    assert done.code == 0, done.err
    exec(step(project_of("python")).script(), {})
    again = dataclasses.replace(task, out=folder / "job")
    Path("job.toml").write_text(job_of(again))
    assert lfcal("run", "job.toml").code == 0, "the window's session has the plan"
    first = SessionFile.read(folder / "window")
    assert first.options == task.options() != Options() and first.options.bracket == (1.0, 0.25)
    for name in ("command", "python", "job"):
        np.testing.assert_array_equal(frames(folder / name), frames(folder / "window"), err_msg=name)
        session = SessionFile.read(folder / name)
        assert (session.options, session.plan, session.devices) == (first.options, PLAN, first.devices), name


def test_a_list_of_positions_is_recorded_by_every_route(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
    half = [(0, 0, 1), (1, 1, 2)]
    RedoList.of(half).write(Path("half.json"))
    chosen = dataclasses.replace(CHOSEN, positions="half.json", bracket=None)
    out = folder / "window"
    task = chosen.task(str(out / "session.json"), str(out))
    drain(Recorder(task, PLAN, task.options()).work(station))
    project = ProjectState(plan=PLAN, recording="command", settings={"acquire": chosen.to_dict()})
    made = step(project)
    write_files(made)
    assert lfcal(*made.arguments).code == 0
    exec(step(dataclasses.replace(project, recording="python")).script(), {})
    Path("job.toml").write_text(job_of(dataclasses.replace(task, out=folder / "job")))
    assert lfcal("run", "job.toml").code == 0
    for name in ("window", "command", "python", "job"):
        np.testing.assert_array_equal(frames(folder / name), frames(out), err_msg=name)
        there = SessionFile.read(folder / name).acknowledged(folder / name)
        assert [tuple(place) for place in np.argwhere(there).tolist()] == half, name
    assert not any("half.json" in word for word in step(project, resume=True).arguments), "a session keeps its list"


class Lamp:
    """A lamp without a switch: a person covers the lens, in the window or where the command asks."""

    def __init__(self, rig: Rig) -> None:
        assert rig.light is not None
        self.light, self.covered = rig.light, 0
        self.rig = dataclasses.replace(rig, light=None)

    def turn(self) -> None:
        self.covered += 1
        self.light.switch(self.covered % 2 == 0)

    def readline(self) -> str:
        self.turn()
        return "\n"


def test_a_lens_is_covered_for_the_same_frames_by_window_and_command(
    lfcal: Callable[..., Run], station: Station, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = dataclasses.replace(CHOSEN, cover=True, bracket=None)
    lamps, opened = [Lamp(station.rig)], open_rig
    station.rig = lamps[0].rig

    def without_light(*asked: Any, **how: Any) -> Rig:
        lamps.append(Lamp(opened(*asked, **how)))
        monkeypatch.setattr("sys.stdin", lamps[1])
        return lamps[1].rig

    out, asked = folder / "window", list[str]()
    task = chosen.task(str(out / "session.json"), str(out))
    recorder = Recorder(task, PLAN, task.options())

    def answer() -> None:
        while len(asked) < 3:
            if recorder.cover.asked and not recorder.cover._answered.is_set():
                asked.append(recorder.cover.asked)
                if not recorder.cover.skippable:
                    lamps[0].turn()
                recorder.cover.answer()
            time.sleep(0.001)

    person = threading.Thread(target=answer)
    person.start()
    drain(recorder.work(station))
    person.join()
    assert [words.split()[0] for words in asked] == ["Dark", "Cover", "Uncover"]
    made = step(ProjectState(plan=PLAN, recording="command", settings={"acquire": chosen.to_dict()}))
    write_files(made)
    monkeypatch.setattr("lfcal.devices.open_rig", without_light)
    done = lfcal(*made.arguments)
    assert done.code == 0 and lamps[0].covered == lamps[1].covered == 2, done.err
    for name in ("window", "command"):
        np.testing.assert_array_equal(frames(folder / name), frames(out), err_msg=name)
        with RecordingSource(folder / name) as source, RecordingSource(out) as first:
            (dark,), (other,) = (one.metadata.darks.values() for one in (source, first))
            np.testing.assert_array_equal(dark.frame, other.frame, err_msg=name)


def test_the_window_keeps_the_task_as_the_command_does(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
    recorded(station, folder / "window")
    made = step(project_of("command"))
    write_files(made)
    assert lfcal(*made.arguments).code == 0
    (by_window, _), (by_command, _) = (load_job(folder / name / "job.json") for name in ("window", "command"))
    assert by_window == dataclasses.replace(by_command, plan=folder / "window/session.json", out=folder / "window")


def test_a_session_of_the_window_continues_by_its_job(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
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


def test_positions_are_recorded_again_by_window_and_command(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
    redo = [(1, 0, 2)]
    for out in ("window", "command"):
        recorded(station, folder / out)
    recorded(station, folder / "window", redo=redo)
    made = step(project_of("command"), redo=redo)
    write_files(made)
    done = lfcal(*made.arguments)
    assert done.code == 0, done.err
    for out in ("window", "command"):
        assert SessionFile.read(folder / out).redo == ((), ((1, 0, 2),))
    assert (folder / "window" / "job-002.json").is_file()


def test_how_a_session_began_is_not_in_the_command_that_continues_it() -> None:
    resumed = step(project_of("s"), resume=True)
    assert "--resume" in resumed.arguments and "RunSettings(resume=True)" in resumed.python
    assert not any(word.startswith(("--darks", "--bracket", "--reference")) for word in resumed.arguments)
    assert "--tolerance=3,3,9" in resumed.arguments, "how the stage is driven may change"


def test_h_of_a_session_is_the_same_by_window_command_and_python(
    lfcal: Callable[..., Run], station: Station, folder: Path
) -> None:
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


def test_projects_of_earlier_versions_keep_what_was_chosen() -> None:
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


def test_one_bad_value_keeps_all_others_and_is_named() -> None:
    found, refused = AcquireSettings.read({**CHOSEN.to_dict(), "retries": -1, "suspend": ["temperature"]})
    assert found == dataclasses.replace(CHOSEN, retries=None, suspend=()) and len(refused) == 2
    assert "settings of acquire: retries: " in refused[0] and "settings of acquire: suspend: " in refused[1]


def test_a_session_is_recorded_with_the_plan_of_another(folder: Path) -> None:
    (folder / "plan.json").write_text(PLAN.to_json())
    quick: dict[str, Any] = {"option": ("optics=pattern",), "check_stage": False, "darks": 0, "reference_every": 0}
    Acquire(plan="plan.json", out="first", **quick).run()
    Acquire(plan="first/session.json", out="second", **quick).run(RunSettings())
    assert SessionFile.read(Path("second")).plan == PLAN
