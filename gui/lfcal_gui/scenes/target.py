"""A target of many points: planned, with fewer frames than it needs, as it lies, and recorded."""

from __future__ import annotations

from collections.abc import Iterator
from shutil import rmtree
from typing import Any

from lfcal.camera import preset
from lfcal_gui.models import ProjectState
from lfcal_gui.scenes.recording import settle_live
from lfcal_gui.scenes.stage import Capture, Stage

__all__ = ["target"]


def target(stage: Stage) -> Iterator[Capture]:
    """Plan a target for the bench camera, and record it."""
    stage.window.files.start_with(ProjectState(camera=preset("bench")))
    page = stage.page("setup")
    page.make_default()
    page.target.show()
    stage.tidy()
    yield Capture("plan_point", page.target)
    _type(page, "source", "array")
    _planned(stage, page)
    yield Capture("plan_target", page.target)
    _type(page, "most_frames", "30")
    _planned(stage, page)
    yield Capture("plan_target_part", page.target)
    yield from _recorded(stage, page)
    page = stage.page("setup")
    _type(page, "source", "array:4x4@1mm")
    _planned(stage, page)
    yield Capture("plan_target_refused", page.target)


def _recorded(stage: Stage, plan: Any) -> Iterator[Capture]:
    """Record the target that was planned, with the simulator."""
    _type(plan, "pose", "rotation=0.2")
    _type(plan, "regions", "1x3")
    _planned(stage, plan)
    yield Capture("plan_target_pose", plan.target)
    file = stage.folder / "target_plan.json"
    file.write_text(plan.target.panel.found.plan.to_json(), encoding="utf-8")
    page = stage.page("acquire")
    page.panel.setCurrentWidget(page.panel.record)
    page.record.target.take(str(file))
    stage.settle()
    folder = stage.folder / "target_session"
    rmtree(folder, ignore_errors=True)
    page.record.folder_choice.take(str(folder))
    stage.settle()
    stage.tidy()
    yield Capture("acquire_target_ready")
    page.record.start()
    stage.until(lambda: page.record.recording, "the recording to begin")
    stage.until(lambda: not page.record.recording, "the recording to end")
    settle_live(stage, page)
    stage.tidy()
    yield Capture("acquire_target_complete")


def _type(page: Any, key: str, text: str) -> None:
    editor = page.target.panel.form.editor(key)
    editor.setText(text)
    editor.textEdited.emit(text)


def _planned(stage: Stage, page: Any) -> None:
    page.target.plan_target()
    stage.settle()
    stage.tidy()
