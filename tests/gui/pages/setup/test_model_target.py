from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.targets import Pose, Wishes, parse_target, plan_target
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.setup import model_scan as model
from lfcal_gui.pages.setup.model_target import (
    MOST_DRAWN,
    PlaneDrawing,
    PlannedTarget,
    PlanSettings,
    iter_target,
    point_lines,
    read_plan,
    table_rows,
)
from tests.targets.common import small

SCAN = ScanPlan.for_camera(small(), virtual_depths=(4.0,), cutout=31)
ARRAY = "array:6x6@1021.3um"


def test_words_of_no_target_are_refused_in_one_line() -> None:
    asked = PlanSettings()
    assert not asked.many and asked.changed("source", " array ").many
    for key, value in (("source", "array:6x6"), ("tolerance", 0.0), ("crosstalk", "2")):
        with pytest.raises(InputError) as refused:
            asked.changed(key, value)
        assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="Largest number of frames"):
        asked.changed("most_frames", 0)


def test_settings_go_into_a_project_and_back() -> None:
    asked = PlanSettings(ARRAY, 0.2, 0.01, 7)
    project = ProjectState(settings=asked.into(ProjectState()))
    assert PlanSettings.of(ProjectState.from_json(project.to_json())) == asked
    damaged = ProjectState(settings={"plan": {"source": "nonsense"}})
    assert PlanSettings.of(damaged) == PlanSettings()


def test_a_plan_is_the_library_s_and_its_drawing_tells_what_is_covered() -> None:
    found = drain(iter_target(SCAN, PlanSettings(ARRAY, most_frames=12)))
    (plane,) = found.planes
    assert len(found.plan.offsets_px[0]) == 12 and found.plan.target == parse_target(ARRAY)
    assert found.plan == plan_target(SCAN, parse_target(ARRAY), Wishes(most_frames=12))
    assert (plane.few, plane.many) == found.plan.points_a_frame(0)
    assert plane.coverage == found.plan.coverage(0) < 1
    for frame in (0, 11):  # as the plan returns them for a single frame
        rows = plane.points[plane.points[:, 0] == frame, 1:]
        np.testing.assert_allclose(rows, found.plan.points(0, frame).pixels)
    ((depth, frames, least, *_, covered, _),), _ = table_rows(found)
    assert depth.endswith("m") and frames == "12" and least == str(found.plan.least_frames(0)) and "%" in covered
    summary = {name: (ours, single) for name, ours, single in found.summary()}
    assert summary["Frames"] == ("12", "252")
    # the noise compared with a single point
    assert all(summary["Noise, middle plane"]) and "Frames, 3 regions" not in summary
    assert found.coding.startswith("Showing 7 frames together, coded: does not pay at 16000 electrons")
    assert found.coding_briefly == "Showing 7 frames together, coded: does not pay."
    assert summary["Phases, all planes"] == (f"{100 * plane.coverage:.2g} %", "100 %")
    lines = list(point_lines(plane, ","))
    assert lines[0] == "frame,row_px,column_px\n" and len(lines) == len(plane.points) + 1
    assert lines[1].startswith("1,") and lines[-1].startswith("12,")


def test_phases_in_the_summary_are_those_of_all_planes() -> None:
    scan = ScanPlan.for_camera(small(), virtual_depths=(4.0, 3.0), cutout=31)
    found = drain(iter_target(scan, PlanSettings("array:4x4@1300um", tolerance=0.3, most_frames=12)))
    shown = [found.plan.shown(z) > 0 for z in range(2)]
    assert shown[0].mean() != shown[1].mean()
    summary = {name: ours for name, ours, _ in found.summary()}
    assert summary["Phases, all planes"] == f"{100 * np.mean(shown):.2g} %"


def test_pose_and_regions_are_those_of_the_command() -> None:
    asked = PlanSettings(ARRAY, most_frames=3).changed("pose", "rotation=1,right=0.2mm").changed("regions", "1x3")
    for key, value in (("pose", "turn=1"), ("regions", "3")):
        with pytest.raises(InputError):
            asked.changed(key, value)
    found = drain(iter_target(SCAN, asked))
    assert (
        found.plan.target.pose == Pose.parse("rotation=1,right=200")
        and len(found.made.facts["regions"]["regions"]) == 3
    )
    summary = {name: given for name, *given in found.summary()}
    assert summary["Frames, 3 regions"] == ["3", "756"]
    assert PlanSettings.of_plan(found.plan).pose == "rotation=1,right=200"


def test_a_saved_plan_is_read_again_with_what_it_shows(tmp_path: Path) -> None:
    plan = plan_target(SCAN, parse_target(ARRAY), Wishes(most_frames=3))
    (tmp_path / "target.json").write_text(plan.to_json())
    (tmp_path / "scan.json").write_text(SCAN.to_json())
    found = read_plan(str(tmp_path / "target.json"))
    assert (
        isinstance(found, PlannedTarget)
        and found.plan == plan
        and len(found.made.facts["expected_error"][0]["error"]) == 3
    )
    assert read_plan(str(tmp_path / "scan.json")) == SCAN


def test_whole_frames_are_drawn_and_never_none() -> None:
    frames = np.repeat(np.arange(4.0), MOST_DRAWN // 3)
    plane = PlaneDrawing(np.column_stack([frames, frames, frames]), 1, 1, np.ones((2, 2), np.intp))
    assert set(plane.drawn()[:, 0]) == {0.0, 1.0, 2.0}
    one = PlaneDrawing(np.zeros((MOST_DRAWN + 1, 3)), 1, 1, np.ones((2, 2), np.intp))
    assert len(one.drawn()) == MOST_DRAWN + 1


def test_the_scan_path_as_a_table() -> None:
    head, first, *rest = model.path_lines(SCAN, "\t")
    assert head == "y\tx\trow_px\tcolumn_px\n" and len(rest) == 251
    assert [float(part) for part in first.split("\t")] == pytest.approx([0, 0, *SCAN.anchor])
    y, x, row, column = (float(part) for part in rest[-1].split("\t"))
    assert (row, column) == pytest.approx((SCAN.anchor[0] + y, SCAN.anchor[1] + x), abs=0.5)
