"""Plan as tasks: the page, its commands and their Python write the same plans."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base import InputError, drain
from lfcal.camera import ScanPlan, StageAxes, preset
from lfcal.records import rows
from lfcal.tasks import PlanScan, PlanTarget, Task, command_of
from lfcal_gui.models import CommandStep, ProjectState, fields_of
from lfcal_gui.pages.setup.model_picture import ScanCosts
from lfcal_gui.pages.setup.model_scan import (
    HELD,
    apply_change,
    default_plan,
    half_of,
    list_text,
    path_lines,
    scan_path,
    scan_task,
    values_of,
)
from lfcal_gui.pages.setup.model_target import HELD_OF_TARGET, OF_SCAN, RATES, PlanSettings, iter_target, target_task
from lfcal_gui.pages.setup.step import scan_step, target_step
from tests.camera.test_plan import camera_of
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.targets.common import small

Lfcal = Callable[..., Run]
lfcal = conftest.lfcal

SCAN = ScanPlan.for_camera(small(), virtual_depths=(4.0,), cutout=31)
EDITS: dict[str, dict[str, Any]] = {
    "nothing": {},
    "planes": {"virtual_depths": "3:5:0.7", "exposure": "0.1, 0.2, 0.3"},
    "depths": {"depths": "-27mm, -26.5 mm"},
    "all": {
        **{"depths": "-26000.123", "cutout": "33x35", "anchor": "120.25,110", "stage": "-y, +x, -z", "order": "raster"},
        **{"exposure": "0.03", "settle": 0.125, "average": 3, "resample": True},
    },
    "left to the camera": {"cutout": "", "anchor": "", "virtual_depths": "3.1234567, 4"},
}


def edited(plan: ScanPlan, edits: dict[str, Any]) -> ScanPlan:
    for key, value in edits.items():
        found, why = apply_change(plan, key, value)
        assert found is not None, why
        plan = found
    return plan


def go_every_route(lfcal: Lfcal, made: CommandStep, task: Task, out: str) -> None:
    """Write ``out`` with ``command`` and ``python`` in the place of its name."""
    for name, text in made.files:
        Path(name).write_text(text, encoding="utf-8")
    assert made.arguments == tuple(shlex.split(command_of(task))[1:])
    done = lfcal(*(word.replace(out, "command") for word in made.arguments))
    assert done.code == 0, done.err
    exec(made.script().replace(out, "python"), {})


@pytest.mark.parametrize("case", EDITS)
def test_every_route_writes_the_plan(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    plan = edited(default_plan(SCAN.camera) if case == "left to the camera" else SCAN, EDITS[case])
    project = ProjectState(camera=plan.camera, plan=plan, settings={"plan": {"speed": 500.0, "frame_rate": 20.0}})
    task = scan_task(plan, "mine.json", speed=500.0, frame_rate=20.0)
    go_every_route(lfcal, scan_step(project, "mine.json"), task, "mine")
    for name in ("command", "python"):
        assert Path(f"{name}.json").read_text(encoding="utf-8") == plan.to_json(), name


HALF = ScanPlan.for_camera(camera_of((6.0, 12.0), 1), virtual_depths=(3.0, 4.0), cutout=31)


def test_every_route_writes_half_cell_scans(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    settings = PlanSettings(half_cell=True)
    project = ProjectState(camera=HALF.camera, plan=HALF, settings=settings.into(ProjectState()))
    task = scan_task(HALF, "mine.json", half_cell=True, list_file=Path("mine_positions.json"))
    made = scan_step(project, "mine.json")
    go_every_route(lfcal, made, task, "mine")
    moved = replace(project, plan=replace(HALF, stage=StageAxes(origin_um=(1.0, 2.0, 3.0))))
    exec(scan_step(moved, "moved.json").script(), {})
    half = half_of(HALF)
    assert 2 * len(half) == HALF.n_positions
    for name in ("command", "python", "moved"):
        if name != "moved":
            assert Path(f"{name}.json").read_text(encoding="utf-8") == HALF.to_json(), name
        assert Path(f"{name}_positions.json").read_text(encoding="utf-8") == list_text(half), name
    odd = replace(project, camera=SCAN.camera, plan=replace(SCAN, resample=True))
    with pytest.raises(InputError, match="half-cell scan: expected frames that are not resampled"):
        scan_step(odd, "odd.json")


def test_a_half_cell_scan_is_drawn_and_forecast_by_half() -> None:
    half = half_of(HALF)
    rows, whole = (dict(ScanCosts.of(HALF, PlanSettings(), one, None).rows()) for one in (half, None))
    assert rows["Positions"] == f"{len(half):,} of {HALF.n_positions:,} (half cell)"
    assert int(rows["Frames"]) * 2 == int(whole["Frames"]) and rows["H, float32"] == whole["H, float32"]
    assert 2 * len(scan_path(HALF, half)) == len(scan_path(HALF)) == 72
    assert len(list(path_lines(HALF, ",", half))) == 37


@pytest.mark.parametrize(
    "settings",
    [
        PlanSettings("array:6x6@1021.3um", most_frames=4, pose="rotation=1", regions="1x3", speed=500.0),
        PlanSettings("array,hole=20um", 0.4, 0.02, 3, pose_within="rotation=0.5", frame_rate=20.0),
    ],
)
def test_every_route_writes_targets(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: PlanSettings
) -> None:
    monkeypatch.chdir(tmp_path)
    made = drain(iter_target(SCAN, settings)).plan
    project = ProjectState(camera=SCAN.camera, plan=SCAN, settings=settings.into(ProjectState()))
    go_every_route(lfcal, target_step(project, "mine.json"), target_task(settings, "mine.json"), "mine")
    for name in ("command", "python"):
        assert Path(f"{name}.json").read_text(encoding="utf-8") == made.to_json(), name


def test_every_field_is_in_a_form_or_set_elsewhere() -> None:
    scan = {one.key for one in fields_of(PlanScan, without=HELD)}
    assert scan | HELD == {row.name for row in rows(PlanScan)} and set(values_of(SCAN)) | set(OF_SCAN) == scan
    target = {one.key for one in fields_of(PlanTarget, without=HELD_OF_TARGET)}
    assert target | HELD_OF_TARGET == {row.name for row in rows(PlanTarget)}
    assert scan >= set(RATES)
    kept = {one.name: one.default for one in fields(PlanSettings)}
    assert kept.keys() == target | set(OF_SCAN)
    for row in (*rows(PlanScan), *rows(PlanTarget)):
        if row.name == "peak":  # a command forecasts no noise unless it is asked to
            continue
        assert row.name not in kept or kept[row.name] == ("" if row.default is MISSING else row.default), row.name


def test_settings_of_earlier_projects_are_read() -> None:
    old = {
        "source": "array:3x3@2mm",
        "tolerance_px": 0.2,
        "crosstalk": 0.01,
        "most_frames": 7,
        "pose": "",
        "regions": "",
    }
    assert PlanSettings.read(old) == (PlanSettings("array:3x3@2mm", 0.2, 0.01, 7), ())
    assert PlanSettings.read({"source": "point", "tolerance_px": 0.1}) == (PlanSettings(), ())
    found, refused = PlanSettings.read({**old, "tolerance_px": 0.9, "regions": "3"})
    assert found == PlanSettings("array:3x3@2mm", crosstalk=0.01, most_frames=7) and len(refused) == 2
    assert "tolerance: expected a number ≥ 0.01 and ≤ 0.5, got 0.9" in refused[0]


def test_a_plan_of_another_period_keeps_it_and_its_origin() -> None:
    stage = StageAxes(origin_um=(1.0, 2.0, 3.0))
    plan = replace(SCAN, period=(3, 4), stage=stage)
    changed = edited(plan, {"virtual_depths": "3,4", "stage": "-x,+y,+z", "cutout": "33"})
    assert changed.period == (3, 4) and changed.cutout == (33, 33) and changed.virtual_depths == pytest.approx((3, 4))
    assert changed.stage == replace(stage, right="-x")
    assert edited(replace(SCAN, stage=stage), {"settle": 0.1}).stage == stage
    project = ProjectState(camera=SCAN.camera, plan=replace(SCAN, stage=stage))
    assert "ScanPlan.from_json" in scan_step(project).python, "no command states the origin of a stage"


def test_what_is_wrong_is_named_as_the_form_names_it() -> None:
    plan = default_plan(preset("bench"))
    for key, value, said in (
        ("virtual_depths", "", "Virtual depths: expected one or more, got none"),
        ("virtual_depths", "1,000", "Virtual depths: expected numbers without leading zeros"),
        ("cutout", "40", "odd"),
        ("exposure", "0", "Exposure: expected a number > 0, got 0"),
        ("stage", "+x,+y", "three axes, such as"),
        ("order", "spiral", "Order: expected"),
    ):
        found, why = apply_change(plan, key, value)
        assert found is None and said in why, why
