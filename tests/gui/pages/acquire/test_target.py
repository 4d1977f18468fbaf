"""Page Acquire records a target: its images over the frame, phases that fill the map, H of what meets them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options
from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal.psf import open_psf
from lfcal.targets import Target, TargetPlan, Wishes, plan_target
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState, session_counts
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import FolderState, folder_state
from lfcal_gui.pages.acquire.model_live import points_px
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.pages.acquire.step import step
from lfcal_gui.widgets.period_map import PeriodMap
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.targets.common import small

SCAN = ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31, settle_s=0.0)


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    step_um = SCAN.camera.step_um(SCAN.depths_um[0])
    target = Target("square", (3, 3), (45 * step_um, 46 * step_um), 10.0, ((0, 0), (0, 1)))
    return plan_target(SCAN, target, Wishes(tolerance_px=0.5, most_frames=5, level="geometric"))


@pytest.fixture
def file(plan: TargetPlan, tmp_path: Path) -> Path:
    path = tmp_path / "target_plan.json"
    path.write_text(plan.to_json())
    return path


@pytest.fixture
def state() -> ProjectState:
    settings = AcquireSettings(darks=0, reference_every=0)
    return ProjectState(settings=settings.into(ProjectState()))


@pytest.fixture
def page(open_page: OpenPage, context: Context, qtbot: QtBot, file: Path) -> Page:
    context.project.update("plan", plan=SCAN, camera=SCAN.camera)
    made: Page = open_page("acquire")
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    made.panel.recording.open()
    made.panel.setCurrentWidget(made.panel.record)
    made.record.target.take(str(file))
    qtbot.waitUntil(lambda: made.record.target.plan is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    return made


def test_a_target_is_recorded_while_its_phases_fill_the_map(
    page: Page, context: Context, qtbot: QtBot, plan: TargetPlan, tmp_path: Path
) -> None:
    panel, folder = page.panel.record, tmp_path / "session"
    assert "target_plan.json" in panel.source.text() and panel.choose_target.text() == "Single point"
    assert AcquireSettings.of(context.state).devices()["target"].endswith("target_plan.json")
    context.project.update("folder", recording=str(folder))
    idle(context.jobs, qtbot)
    assert panel.map_box.isHidden(), "nothing is covered yet"
    facts = context.reported["acquire"]
    assert (facts["counted"], facts["positions"]) == ("frame", 5)
    assert facts["record_s"] == pytest.approx(3600 * plan.forecast().hours)
    assert facts["frame_bytes"] == pytest.approx(5 * 2 * np.prod(SCAN.camera.sensor.shape))
    seen: list[int] = []
    frame = page.panel.setup.view
    captions: set[str] = set()
    frame.changed.connect(lambda: captions.add(frame.shot.caption))
    frame.changed.connect(lambda: seen.extend(len(marks.points) for marks in frame.overlays))
    qtbot.mouseClick(panel.buttons["start"], Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: page.record.folder.complete, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert "5 of 5 frames" in panel.status.text() and "5 of 5 frames of a target" in panel.folder_words.text()
    assert max(seen) == len(plan.points(0, 4)) and f"frame 5: {max(seen)} points as planned" in captions
    assert without_value(panel.map) == int((plan.shown(0) == 0).sum())
    assert "Complete" in panel.status.text(), "as all frames are there; what they cover is no progress"
    assert {(one.progress, one.word) for one in panel.strip.tiles} == {(None, "")}
    share = 100 * (plan.shown(0) > 0).mean()
    assert 0 < share < 100 and panel.map_words.text() == f"{share:.0f} % of the phases are covered"
    assert len(panel.pictures.curves["energy"].plot.items) == 1
    assert panel.pictures.curves["residual"].blank.words == "Not measured with a target."
    assert not panel.buttons["fit"].isEnabled() and "lfcal fit" in panel.why.text()

    page.record.after.assemble(str(tmp_path / "H.h5"))
    qtbot.waitUntil(lambda: context.state.psf.endswith("H.h5"), timeout=GUARD_MS)
    with open_psf(tmp_path / "H.h5") as H:
        assert "target" in H.provenance and 0 < (H.recorded > 0).sum() < 252
    assert session_counts(str(folder)) == {"done": 5, "total": 5, "counted": "frame"}
    found = folder_state(str(folder))
    assert found.target == plan and found.complete and found.planes() == ()
    idle(context.jobs, qtbot)


def test_what_does_not_go_together_is_refused_in_a_line(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.context.project.update("plan", plan=replace(SCAN, exposure_s=0.5), recording=str(tmp_path / "s"))
    start = page.panel.record.buttons["start"]
    qtbot.waitUntil(start.isEnabled, timeout=GUARD_MS)  # a live frame may be under way
    qtbot.mouseClick(start, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: "a plan for another scan" in page.panel.record.detail.text(), timeout=GUARD_MS)
    (tmp_path / "no.json").write_text("{}")
    page.record.target.take(str(tmp_path / "no.json"))
    qtbot.waitUntil(lambda: not page.context.jobs.busy, timeout=GUARD_MS)
    # the picture that comes behind it leaves it there
    assert "plan of a target" in page.panel.record.detail.text()
    page.context.project.update("folder", recording=str(tmp_path / "t"))
    idle(page.context.jobs, qtbot)
    assert page.panel.record.detail.text() == ""


def test_points_and_command_are_those_of_the_plan(plan: TargetPlan, file: Path) -> None:
    assert np.array_equal(points_px(plan, Position(0, 0, 3)), plan.points(0, 3).pixels)
    with pytest.raises(InputError, match="frame of the target"):
        points_px(plan, Position(0, 0, 5))
    settings = AcquireSettings(target=str(file), device_options=(("brightness", "0.1"),), controls=Options().controls)
    found = step(ProjectState(camera=SCAN.camera, plan=SCAN, settings=settings.into(ProjectState())))
    words = list(found.arguments)
    assert words[:2] == ["acquire", str(file)] and f"--option=target={file}" in words
    assert not any(word.startswith(("--controls", "--order")) for word in words)
    assert "AcquireTarget(" in found.python and "controls" not in found.python
    assert not found.files
    compile(found.python, "script", "exec")


def without_value(period: PeriodMap) -> int:
    """Return how many positions of a map have no value."""
    return int(np.isnan(period.values).sum())


def test_a_target_is_recorded_where_the_stage_is_unless_a_single_point_is_chosen(
    page: Page, context: Context, plan: TargetPlan, file: Path, qtbot: QtBot
) -> None:
    page.record.target.plan, page.record.target._path = plan, str(file)
    settings = replace(AcquireSettings.of(context.state), target=str(file))
    context.project.update("target", settings=settings.into(context.state))
    page.record._field_edited("origin", "1,2,3")
    scan = context.state.plan
    assert scan.stage.origin_um == (1.0, 2.0, 3.0)
    assert page.record.target.to_record(scan, FolderState()) == replace(plan, scan=scan)
    assert any("1,2,3" in word for word in step(context.state, "s").arguments)
    panel = page.panel.record
    qtbot.mouseClick(panel.choose_target, Qt.MouseButton.LeftButton)
    assert "single point" in panel.source.text() and panel.choose_target.text() == "Target …"
    assert AcquireSettings.of(context.state).target == "" and page.record.target.plan is None
    idle(context.jobs, qtbot)
