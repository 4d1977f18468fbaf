"""Recordings: every route records the same frames, and what has no effect is refused in each."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire import RedoList
from lfcal.base import InputError
from lfcal.camera import RegionPlan
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.records import rows
from lfcal.tasks import (
    Acquire,
    AcquireRegions,
    AcquireTarget,
    AcquireUntil,
    RunSettings,
    Task,
    command_of,
    job_of,
    load_job,
    python_of,
    words_of,
)
from tests.acquire.rigs import small_plan
from tests.cli import conftest
from tests.tasks.routes import Lfcal, go_every_route

lfcal = conftest.lfcal
QUICK: dict[str, Any] = {"option": ("optics=pattern",), "check_stage": False, "darks": 2, "reference_every": 0}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write the plan of a scan and one of regions."""
    plan = small_plan((2, 3), 1, settle_s=0.0)
    (tmp_path / "plan.json").write_text(plan.to_json())
    regions = RegionPlan(plan, ("left", "right"), (plan.anchor, (plan.anchor[0], plan.anchor[1] + 4)))
    (tmp_path / "regions.json").write_text(regions.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def frames(folder: Path) -> Any:
    with open_frames(folder) as source:
        return np.stack([source.read(k) for k in range(len(source))])


def test_every_route_records_the_same_frames(lfcal: Lfcal, place: Path) -> None:
    task = Acquire(plan=place / "plan.json", out=place / "s", bracket=(1.0, 0.25), overshoot=(1.0, 1.0, 1.0), **QUICK)
    first, *others = go_every_route(lfcal, task, place / "s")
    for folder in others:
        np.testing.assert_array_equal(frames(folder), frames(first), err_msg=folder.name)


def test_every_route_records_the_same_regions(lfcal: Lfcal, place: Path) -> None:
    task = AcquireRegions(plan=place / "regions.json", out=place / "two", pack=False, **QUICK)
    first, *others = go_every_route(lfcal, task, place / "two")
    for name in ("left", "right"):
        for folder in others:
            np.testing.assert_array_equal(frames(folder / name), frames(first / name), err_msg=folder.name)


def kept(task: Task) -> dict[str, Any]:
    """Return what a session, and H of it, keep of the task that recorded it."""
    return task.to_dict(absolute=True, outputs=False)


def stopped(lfcal: Lfcal, plan: Path, at: int) -> Task:
    """Record until a fault stops the session; return the task, as a job of the devices without the fault."""
    quick = [*words_of(Acquire(plan=plan, out=Path("s"), **QUICK))]
    lfcal(*quick, "--option", f"faults=times out@{at}*9").refused("positions are safe")
    task, _ = load_job(plan.parent / "s" / "job.json", {"option": list(QUICK["option"])})
    return task


def test_a_session_continues_by_its_job_and_by_python(lfcal: Lfcal, place: Path) -> None:
    task, run = stopped(lfcal, place / "plan.json", 4), RunSettings(resume=True)
    assert words_of(task, run)[-1] == "--resume" and "resume" not in task.to_dict()
    job = place / "job.toml"
    job.write_text(job_of(task, run))
    assert load_job(job) == (task, run)
    job.write_text(job_of(task))
    lfcal("run", job).refused("choose another folder, or resume this session")
    lfcal("run", job, "--resume").ok()
    assert len(frames(place / "s")) == 6
    exec(python_of(task, run), {})
    assert len(frames(place / "s")) == 6, "a session that is complete stays so"
    shutil.rmtree(place / "s")
    exec(python_of(stopped(lfcal, place / "plan.json", 4), run), {})
    assert len(frames(place / "s")) == 6


def test_a_session_and_h_of_it_keep_the_task(lfcal: Lfcal, place: Path) -> None:
    out, matrix = place / "s", place / "H.h5"
    task = Acquire(plan=place / "plan.json", out=out, assemble=matrix, **QUICK)
    task.run()
    assert load_job(out / "job.json") == (Acquire(plan=place / "plan.json", out=out, **QUICK), RunSettings())
    with open_psf(matrix) as H:
        assert H.provenance["earlier_tasks"] == [kept(task)] and H.provenance["task"]["task"] == "assemble"
    lfcal("run", matrix, "-o", place / "again.h5").ok()
    with open_psf(matrix) as H, open_psf(place / "again.h5") as other:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(other))
    lfcal("transpose", matrix, "-o", place / "HT.h5").ok()
    with open_psf(place / "HT.h5") as HT:
        assert [one["task"] for one in HT.provenance["earlier_tasks"]] == ["acquire", "assemble"]


def test_sessions_of_two_tasks_and_of_a_damaged_one_open(lfcal: Lfcal, place: Path) -> None:
    first = Acquire(plan=place / "plan.json", out=place / "s", **QUICK)
    first.run()
    RedoList.of([(0, 1, 2)]).write(place / "redo.json")
    second = Acquire(plan=place / "plan.json", out=place / "s", redo=place / "redo.json", option=QUICK["option"])
    second.run()
    with open_frames(place / "s") as source:
        assert source.metadata.earlier_tasks == (kept(first), kept(second))
    for job in (place / "s").glob("job*.json"):
        job.unlink()
    for text in ("{", "[]", None):
        if text is None:
            (place / "s" / "job.json").unlink()
        else:
            (place / "s" / "job.json").write_text(text)
        with open_frames(place / "s") as source:
            assert source.metadata.earlier_tasks == () and len(source) == 6


def test_regions_keep_the_task_and_continue_by_it(lfcal: Lfcal, place: Path) -> None:
    task = AcquireRegions(plan=place / "regions.json", out=place / "s", **QUICK)
    faulty = replace(task, option=(*task.option, "faults=times out@9*9"))
    assert lfcal(*words_of(faulty)).code == 2
    for job in ("job.json", "left/job.json"):
        found, _ = load_job(place / "s" / job, {"option": list(task.option)})
        assert found == replace(task, out=found.files("in")[-1]) and found.files("in")[-1].resolve() == place / "s"
    lfcal("run", place / "s" / "left" / "job.json", "--resume").ok()
    for name in ("left", "right"):
        assert len(frames(place / "s" / name)) == 6


def test_a_job_and_a_command_keep_every_value(place: Path) -> None:
    tasks: tuple[Task, ...] = (
        AcquireTarget(plan="t.json", out="s", redo="r.json", suspend=("temperature=20:22",), steady=3.0, cover=True),
        AcquireUntil(plan="p.json", out="s", until_error="0.5%", most=40, unknowns="iris,geometry", order="coarse"),
        Acquire(plan="p.json", out="s", check_stage=True, check_origin=False, pack=False, tolerance="1,2,3", retries=0),
    )
    assert "--check-stage --no-check-origin --no-pack" in command_of(tasks[2])
    for task in tasks:
        data = task.to_dict()
        assert all(row.name in data for row in rows(type(task)))
    (place / "job.toml").write_text(job_of(Acquire(plan="plan.json", out="s", check_stage=False)))
    assert load_job(place / "job.toml")[0] == Acquire(plan=place / "plan.json", out=place / "s", check_stage=False)


def test_what_does_not_apply_is_refused_by_commands_and_jobs(lfcal: Lfcal, place: Path) -> None:
    for words, said in (
        ("plan.json --most 3", "--most: expected a scan until H is good enough (--until-error), got a scan"),
        ("regions.json --redo r.json", "--redo: expected a scan of one region or a target of many points, got several"),
        (
            "plan.json --until-error 1% --positions p.json",
            "--positions: expected a scan of one region, got a scan until",
        ),
        ("plan.json --frame-rate 3", "--frame-rate: expected --dry-run"),
        ("plan.json --darks 0 --cover", "--cover: expected dark frames, got --darks 0"),
        ("plan.json --steady 3", "--steady: expected --suspend"),
        ("plan.json --on-suspect ask", "--on-suspect: expected stop or flag"),
    ):
        lfcal("acquire", *words.split(), "-o", "s").refused(said)
        assert not (place / "s").exists(), words
    (place / "job.toml").write_text('task = "acquire"\nplan = "regions.json"\nout = "s"\npositions = "p.json"')
    with pytest.raises(InputError, match="positions: expected a scan of one region, got several regions"):
        load_job(place / "job.toml")
    job = job_of(Acquire(plan=place / "plan.json", out="s", **QUICK))
    (place / "job.toml").write_text(f'{job}\n[run]\nexecutor = "threads"\n')
    lfcal("run", place / "job.toml").refused("--executor: expected work that is done in units")
