"""The camera as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CAMERA_FILE, CommandStep, ProjectState

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the camera is shown, or written to ``out`` first."""
    name = out or CAMERA_FILE
    python = f"""
from lfcal.camera import Camera

camera = Camera.from_json(Path({name!r}).read_text(encoding="utf-8"))
print(camera.name, camera.pitch_px, camera.marks.paths("assumed"))
"""
    return CommandStep(("camera", "show", name), python, ((name, project.camera.to_json()),))
