"""What a fitted camera changes in the project: camera, plan, and the effects of Record > Compute. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from lfcal.base import LfcalError, plain
from lfcal.fit import Fit, measured_camera
from lfcal.simulate.effects import CATALOGUE
from lfcal_gui.models import ProjectState

__all__ = ["FitUse", "use_of"]


@dataclass(frozen=True)
class FitUse:
    """What becomes of the project.

    Attributes
    ----------
    changes
        Entries that change.
    words
        What changed, and what did not.
    """

    changes: Mapping[str, Any]
    words: str

    def holds(self, project: ProjectState) -> bool:
        """Return whether a project has this camera: nobody took it back or changed it."""
        camera = self.changes["camera"]
        return bool(project.camera == camera and project.camera.marks == camera.marks)


def use_of(project: ProjectState, fit: Fit) -> FitUse:
    """Return what the project becomes with the camera and effects as found.

    The plan keeps its positions on the sensor, its depths and its exposures; one that does not go with the camera is
    dropped.
    """
    camera = measured_camera(fit)
    words = [f"In use: camera {camera.name} as found"]
    plan = project.plan
    if plan is not None:
        try:
            plan = replace(plan, camera=camera)
            words.append("the plan goes on with it")
        except LfcalError as error:
            plan = None
            words.append(f"the plan does not go with it and was dropped ({error})")
    settings = {**project.settings, "simulate": _simulate(project, fit)}
    words.append("Record > Compute has the effects of the fit")
    if any(fit.setup.depth_errors_um) or fit.setup.stage_scale:
        words.append("depths and the stage's scale that were found are no part of a camera: the plan has its own")
    return FitUse({"camera": camera, "plan": plan, "settings": settings}, "; ".join(words) + ".")


def _simulate(project: ProjectState, fit: Fit) -> dict[str, Any]:
    """Return the settings of Record > Compute with the effects of the fit in the place of all others that act on H."""
    own = project.settings.get("simulate")
    kept: dict[str, Any] = dict(own) if isinstance(own, Mapping) else {}
    overrides = [list(one) for one in _entries(kept, "overrides") if _on_frames(one[0])]
    magnitudes = [list(one) for one in _entries(kept, "magnitudes") if _on_frames(one[0])]
    for effect in fit.effects:
        overrides.append([effect.name, "on"])
        for field in fields(effect):  # type: ignore[arg-type]  # effects are dataclasses
            value = getattr(effect, field.name)
            if value is not None:
                magnitudes.append([effect.name, field.name, plain(value), "measured"])
    return {**kept, "overrides": sorted(overrides), "magnitudes": sorted(magnitudes, key=lambda one: one[:2])}


def _entries(settings: Mapping[str, Any], name: str) -> list[Any]:
    found = settings.get(name, ())
    return [one for one in found if isinstance(one, list | tuple) and one] if isinstance(found, list | tuple) else []


def _on_frames(name: object) -> bool:
    """Return whether an effect leaves H as it is; those that are not installed are kept, too."""
    return not isinstance(name, str) or name not in CATALOGUE or not CATALOGUE.get(name).acts_on.enters_h
