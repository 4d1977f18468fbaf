"""Plans: every route writes the same file, and what has no effect is refused in each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.tasks import (
    PlanDisplay,
    PlanFit,
    PlanRecorded,
    PlanRegions,
    PlanScan,
    PlanTarget,
    Task,
    command_of,
    job_of,
    load_job,
)
from tests.cli import conftest
from tests.tasks.routes import Lfcal, check_every_route, go_every_route

lfcal = conftest.lfcal


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a small camera, the plan of its scan, and the list of its stage coordinates."""
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(200, 200)))
    scan = ScanPlan.for_camera(camera, virtual_depths=(4.0,), cutout=31)
    (tmp_path / "camera.json").write_text(camera.to_json())
    (tmp_path / "scan.json").write_text(scan.to_json())
    lines = [f"{k}.tif,{x!r},{y!r}" for k, (x, y, _) in enumerate(scan.stage_um().tolist())]
    (tmp_path / "stage.csv").write_text("\n".join(["file,x_um,y_um", *lines]) + "\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def tasks_of(place: Path) -> dict[str, Task]:
    out, scan = place / "out.json", place / "scan.json"
    camera: dict[str, Any] = {"camera": str(place / "camera.json"), "cutout": (31, 33), "out": out}
    wishes: dict[str, Any] = {"plan": scan, "out": out, "tolerance": 0.5, "most_frames": 2}
    return {
        "scan": PlanScan(
            **camera, depths=(-20000.0, -26000.0 / 3), exposure=(0.02, 0.05), anchor=(60.5, 70.0), stage="-y,+x,-z"
        ),
        "preset": PlanScan(camera="bench", virtual_depths="3,4", half_cell=False, average=2, resample=True, out=out),
        "regions": PlanRegions(**camera, virtual_depths=(4.0,), regions="1x2", settle=0.1),
        "recorded": PlanRecorded(**camera, positions=place / "stage.csv", depths=(-26000.0,)),
        "fit": PlanFit(plan=scan, count=4, candidates=12, unknowns="iris,geometry", position_error=0.1, out=out),
        "target": PlanTarget(**wishes, source="array:3x3@2mm", pose="rotation=1", crosstalk=0.02),
        "display": PlanDisplay(**wishes, source="display:2000x2000@5um"),
    }


def test_every_route_writes_the_same_plan(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, task in tasks_of(place).items():
        (place / "out.json").unlink(missing_ok=True)
        if name in ("fit", "target", "display"):
            check_every_route(lfcal, monkeypatch, task, place)
            continue
        first, *others = go_every_route(lfcal, task, place / "out.json")
        assert len(others) == 3 and {path.read_bytes() for path in others} == {first.read_bytes()}, name
        for path in others:
            path.unlink()


def test_a_preset_is_no_path(place: Path) -> None:
    task = tasks_of(place)["preset"]
    (place / "job.toml").write_text(job_of(task))
    assert load_job(place / "job.toml")[0] == task and task.to_dict(absolute=True)["camera"] == "bench"
    assert task.files("in") == () and "lfcal plan bench --virtual-depths=3,4" in command_of(task)


def test_what_does_not_apply_is_refused_by_commands_and_jobs(lfcal: Lfcal, place: Path) -> None:
    scan, listed = "plan bench --virtual-depths 3", "plan bench --positions l.csv"
    for words, said in (
        (f"{scan} --frames f", "--frames: expected a recorded scan (--positions), got a scan of"),
        (f"{listed} --average 2", "--average: expected a scan of one region or a scan of several"),
        (f"{listed} --regions 2x2", "--regions: expected a scan of several regions (--regions)"),
        (f"{scan} --regions 2x2 --half-cell", "--half-cell: expected a scan of one region"),
        (f"{scan} --exposure 0.1,-1", "--exposure: expected a number > 0, got -1"),
        (f"{scan} --exposure fast", "--exposure: expected numbers, got 'fast'"),
        (f"{scan} --cutout auto", "--cutout: expected one number or two"),
        ("plan target scan.json array --patterns p", "--patterns: expected a display, got a target that a stage"),
        ("plan target scan.json display:9x9@5um --pose tilt_right=1", "--pose: expected a target that a stage moves"),
    ):
        lfcal(*words.split(), "-o", "o.json").refused(said)
        assert not (place / "o.json").exists(), words
    for job, said in (
        ('task = "plan"\ncamera = "bench"\nvirtual_depths = [3]\nframes = "f"', "frames: expected a recorded scan"),
        ('task = "plan"\ncamera = "bench"\nvirtual_depths = [3]\ndepths = [1]', "(--virtual-depths), got both"),
        ('task = "plan fit"\nplan = "scan.json"', "--count: expected a value"),
        ('task = "plan target"\nplan = "p"\nsource = "array"\npatterns = "p"', "patterns: expected a display"),
    ):
        (place / "job.toml").write_text(job)
        with pytest.raises(InputError) as error:
            load_job(place / "job.toml")
        assert said in str(error.value)


def test_python_knows_the_fields_of_a_kind_only() -> None:
    with pytest.raises(TypeError, match="frames"):
        PlanScan(camera="bench", virtual_depths=(3.0,), frames="f")  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="patterns"):
        PlanTarget(plan=Path("p"), source="array", patterns=Path("p"))  # type: ignore[call-arg]
