"""Recordings: every route records the same frames, and what has no effect is refused in each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import RegionPlan
from lfcal.frames import open_frames
from lfcal.records import rows
from lfcal.tasks import (
    Acquire,
    AcquireRegions,
    AcquireTarget,
    AcquireUntil,
    Task,
    command_of,
    job_of,
    load_job,
    task_set,
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
    task = AcquireRegions(plan=place / "regions.json", out=place / "s", pack=False, **QUICK)
    first, *others = go_every_route(lfcal, task, place / "s")
    for name in ("left", "right"):
        for folder in others:
            np.testing.assert_array_equal(frames(folder / name), frames(first / name), err_msg=folder.name)


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


def test_a_field_of_another_kind_is_refused() -> None:
    tasks = task_set("acquire")
    for kind in tasks.kinds:
        for other in {row.name for one in tasks.kinds for row in rows(one)} - {row.name for row in rows(kind)}:
            with pytest.raises(InputError) as error:
                tasks.refuse(kind, [other])
            assert str(error.value).endswith(f"got {kind.input_words}; leave it out")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "plan.json --most 3",
            "--most: expected a scan until H is good enough (--until-error), got a scan",
        ),
        ("regions.json --redo r.json", "--redo: expected a scan of one region or a target of many points, got several"),
        (
            "plan.json --until-error 1% --positions p.json",
            "--positions: expected a scan of one region, got a scan until",
        ),
        ("plan.json --frame-rate 3", "--frame-rate: expected --dry-run"),
        ("plan.json --darks 0 --cover", "--cover: expected dark frames, got --darks 0"),
        ("plan.json --steady 3", "--steady: expected --suspend"),
        ("plan.json --on-suspect ask", "--on-suspect: expected stop or flag"),
    ],
)
def test_what_does_not_apply_is_refused_on_the_command_line(lfcal: Lfcal, place: Path, words: str, said: str) -> None:
    done = lfcal("acquire", *words.split(), "-o", "s")
    assert done.code == 2 and said in done.err and done.err.count("\n") == 1, done.err
    assert not (place / "s").exists()


def test_what_does_not_apply_is_refused_in_a_job(place: Path) -> None:
    (place / "job.toml").write_text('task = "acquire"\nplan = "regions.json"\nout = "s"\npositions = "p.json"')
    with pytest.raises(InputError, match="positions: expected a scan of one region, got several regions"):
        load_job(place / "job.toml")
