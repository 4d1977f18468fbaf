"""The camera as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import CAMERA_FILE, Step

__all__ = ["step"]


def step(project: ProjectState) -> Step:
    """Return how the camera is shown."""
    python = f"""
from lfcal.camera import Camera

camera = Camera.from_json(Path({CAMERA_FILE!r}).read_text(encoding="utf-8"))
print(camera.name, camera.pitch_px, camera.marks.paths("assumed"))
"""
    return Step(("camera", "show", CAMERA_FILE), python, ((CAMERA_FILE, project.camera.to_json()),))
