"""A target of many points on page Plan: asked for, planned, and with fewer frames than it needs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from gui.models.project import ProjectState
from gui.scenes.stage import Shot, Stage
from lfcal.camera import preset

__all__ = ["target"]


def target(stage: Stage) -> Iterator[Shot]:
    """Plan a target for the bench camera."""
    stage.window.files.start_with(ProjectState(camera=preset("bench")))
    page = stage.page("plan")
    page.make_default()
    page.panel.tabs.setCurrentIndex(1)
    stage.tidy()
    yield Shot("plan_point")
    _type(page, "source", "array")
    _planned(stage, page)
    yield Shot("plan_target")
    _type(page, "most_frames", "30")
    _planned(stage, page)
    yield Shot("plan_target_part")
    _type(page, "source", "array:4x4@1mm")
    _planned(stage, page)
    yield Shot("plan_target_refused")


def _type(page: Any, key: str, text: str) -> None:
    editor = page.panel.target.form.editor(key)
    editor.setText(text)
    editor.textEdited.emit(text)


def _planned(stage: Stage, page: Any) -> None:
    page.plan_target()
    stage.settle()
    stage.tidy()
