"""A depth map as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CommandStep, ProjectState, needed_file
from lfcal_gui.pages.depth.model import DepthSettings, camera_files, task_of


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the light field becomes a depth map; with a name that ends in ``.ply``, a point cloud as well."""
    frame = needed_file(project.light_field, "light field", "Depth")
    return CommandStep.of(task_of(DepthSettings.of(project), project, frame, out), camera_files(project))
