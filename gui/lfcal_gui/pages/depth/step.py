"""A depth map as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CommandStep, ProjectState, needed_file
from lfcal_gui.pages.depth.model import DepthSettings, camera_files, task_of


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that measures a depth map; for a path that ends in ``.ply``, it also makes a point cloud."""
    frame = needed_file(project.light_field, "light field", "Depth")
    return CommandStep.of(task_of(DepthSettings.of(project), project, frame, out), camera_files(project))
