"""The fit of the optics: what the user chose, and what an H offers to it. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, plain
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import GROUPS, Fit, Setup, kept_aside, lacking, measured_camera, starting_effects
from lfcal.psf import PSFMatrix, noise_of
from lfcal.records import rows
from lfcal.simulate.effects import CATALOGUE
from lfcal.tasks import FitMatrix, most_taken
from lfcal_gui.models import CAMERA_FILE, PLAN_FILE, Field, PageSettings, ProjectState, Stamp, needed_plan
from lfcal_gui.models import stamp_of as file_stamp

STARTS = (("psf", "H's own camera"), ("window", "camera of this window"))
"""Which camera a fit starts from."""

START = Field("camera", "Start from", kind="choice", choices=STARTS, tip="Camera description that the fit starts from")

CORE = ("geometry", "focal_lengths", "iris")
"""Groups that are fitted by default, before the user has chosen."""

HELD = frozenset({"sources", "out", "camera", "plan", "unknowns", "write_h"})
"""Fields of `lfcal.tasks.FitMatrix` that the form does not show.

H, camera and plan are those of the project, unknowns have a list, and buttons decide what is written."""

ROWS = tuple(row for row in rows(FitMatrix) if row.name not in HELD)

HELD_OUT = 0.2


@dataclass(frozen=True)
class FitSettings(PageSettings):
    """What the user chose; `HELD` apart as in `lfcal.tasks.FitMatrix`.

    Attributes
    ----------
    camera
        ``"psf"`` or ``"window"``, see `STARTS`.
    auto
        Whether groups of unknowns are found, or are those of ``groups``.
    groups
        Names of groups; those of a distribution that is not installed are kept.
    """

    page: ClassVar[str] = "fit"

    camera: str = "psf"
    auto: bool = True
    groups: tuple[str, ...] = CORE
    positions: int | None = None
    noise: tuple[float, float] | None = None
    effects: tuple[str, ...] = ()
    hybrid: bool = False

    def __post_init__(self) -> None:
        """Check every value."""
        if self.camera not in dict(STARTS):
            raise InputError.expected("start", " or ".join(dict(STARTS)), self.camera, "choose one of these")
        if not all(isinstance(name, str) for name in self.groups):
            raise InputError.expected("groups", "names", self.groups, "choose some of the list")
        for row in ROWS:
            object.__setattr__(self, row.name, row.value(getattr(self, row.name), row.label))

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``; earlier versions wrote constant and slope of the noise apart."""
        if isinstance(data, Mapping) and (apart := [data.get("constant"), data.get("slope")]) != [None, None]:
            data = {"noise": apart, **data}
        return super().read(data)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Groups that are asked for: those that are installed."""
        return tuple(name for name in self.groups if name in GROUPS)


def group_rows() -> tuple[tuple[str, str, bool], ...]:
    """Return name, title, and whether it is fitted in any case, of every group of unknowns."""
    return tuple((group.name, group.title, group.core) for group in GROUPS)


# -- what an H offers --------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Offer:
    """What an H offers to a fit.

    Attributes
    ----------
    shape
        Of H.
    recorded
        Patterns that were recorded.
    camera
        Name of H's own camera, None where it has none.
    noise
        Mean (constant, slope) of the variance that H or its provenance states, None where neither does.
    problem
        Why what H states of its noise cannot be used; empty where it can, or where it states none.
    plan
        The scan with H's own camera, None where it has none.
    unfit
        Why H and its own camera do not go together, or empty.
    aside
        Number of positions that the session kept from its fits.
    """

    shape: tuple[int, ...]
    recorded: int
    camera: str | None
    noise: tuple[float, float] | None
    problem: str = ""
    plan: ScanPlan | None = None
    unfit: str = ""
    aside: int = 0

    def source_words(self, name: str) -> str:
        """Return a line on the positions of H, which is called ``name``."""
        nz, ny, nx = self.shape[:3]
        planes, positions = f"{nz} plane{'s' * (nz > 1)}", nz * ny * nx
        if self.recorded == positions:
            return f"{name}: all {positions:,} positions recorded, {planes}"
        return f"{name}: {self.recorded:,} of {positions:,} positions recorded, {planes}"

    def use_words(self, positions: int | None) -> str:
        """Return a line on how many are used of how many were asked for."""
        most = most_taken(positions, range(self.aside))
        used = min(most or self.recorded, self.recorded)
        aside = self.aside if self.aside and used == self.recorded else round(HELD_OUT * used)
        return f"{used:,} are used, {aside:,} of them kept aside to judge the fit."

    def noise_words(self, settings: FitSettings) -> tuple[str, str]:
        """Return a line on the noise, and its role: ``"hint"``, or ``"error"`` where something is missing."""
        if settings.noise is not None:
            over = ", not what H states" if self.noise is not None else ""
            return f"Noise as given here{over}.", "hint"
        if self.problem:
            return self.problem, "error"
        if self.noise is None:
            return "H does not state its noise: give constant and slope of the variance.", "error"
        constant, slope = self.noise
        return f"Noise as H states: variance about {constant:.3g} + {slope:.3g} × value.", "hint"

    def camera_words(self, settings: FitSettings, window: Camera, plan: ScanPlan | None) -> tuple[str, str]:
        """Return a line on the camera that the fit starts from, and its role as of `noise_words`.

        ``window`` and ``plan`` are those of the window.
        """
        if self.unfit:
            return f"H does not fit its own camera: {self.unfit}.", "error"
        if self.camera is None:
            if plan is None or plan.shape != self.shape:
                return f"H states no camera: make a plan of its shape {self.shape} in Set up.", "error"
            return f"H states no camera: uses camera, depths and anchor of the plan, {window.name}.", "hint"
        if settings.camera == "window":
            _, refused = self._by_window(window)
            if refused:
                return f"H does not fit {window.name}, the camera of this window: {refused}.", "error"
            return f"Starts from {window.name}, the camera of this window.", "hint"
        return f"Starts from {self.camera}, as H was made with.", "hint"

    def lacking(self, settings: FitSettings, window: Camera, plan: ScanPlan | None) -> dict[str, str]:
        """Return the groups that the fitted camera has no unknowns for, each with the reason.

        ``window`` and ``plan`` are those of the project. The result is empty if neither H nor plan states a camera.
        """
        own = self.plan
        if own is None:
            own = plan if plan is not None and plan.shape == self.shape else None
        elif settings.camera == "window":
            own, _ = self._by_window(window)
        return {} if own is None else lacking_of(own)

    def _by_window(self, window: Camera) -> tuple[ScanPlan | None, str]:
        """Return the plan of H with the camera of the window; None, and why, where its sensor has no room for it."""
        assert self.plan is not None
        try:
            return replace(self.plan, camera=window), ""
        except InputError as error:
            return None, str(error)


def lacking_of(plan: ScanPlan) -> dict[str, str]:
    """Return the groups that a fit of a scan's patterns has no unknowns of, by name, and what it would need."""
    return lacking(Setup(plan.camera, starting_effects(plan), (0.0,) * plan.shape[0]), plan)


def offer_of(matrix: PSFMatrix) -> Offer:
    """Return what an H or HT offers; looks at its facts and not at its patterns."""
    matrix = matrix.T if matrix.is_transposed else matrix
    recorded = np.asarray(matrix.recorded) > 0
    noise, problem = _noise(matrix, recorded)
    offer = Offer(matrix.shape, int(recorded.sum()), None, noise, problem, aside=len(kept_aside(matrix)))
    if matrix.camera is None:
        return offer
    depths = tuple(float(z) for z in matrix.depths)
    plan, unfit = None, ""
    try:
        plan = ScanPlan(matrix.camera, matrix.period, matrix.cutout, depths, matrix.anchor)
    except InputError as error:  # a file may hold any anchor
        unfit = str(error)
    return replace(offer, camera=matrix.camera.name, plan=plan, unfit=unfit)


def _noise(matrix: PSFMatrix, recorded: NDArray[np.bool_]) -> tuple[tuple[float, float] | None, str]:
    known, said = matrix.facts.noise, noise_of(matrix.provenance)
    own = np.empty((0, 2)) if known is None else np.asarray(known, np.float64)[recorded]
    if not len(own) or not np.isfinite(own).all():
        return None if said is None else (said.floor, said.slope), ""
    # samples that include a black level have a negative variance at 0
    if (own[:, 0] < 0).any():
        return None, "H was assembled with its black level: assemble it with a dark frame, or give the noise here."
    constant, slope = own.mean(0).tolist()
    return (constant, slope), ""


# -- the task ----------------------------------------------------------------------------------------------
def task_of(
    settings: FitSettings, project: ProjectState, offer: Offer | None, out: Path = Path("fit"), where: Path = Path()
) -> FitMatrix:
    """Return how a camera is fitted to the H of a project, whose camera and plan are in files in the folder ``where``.

    Groups that the page greys out are not asked for; None as the ``offer``: H is not there yet.
    """
    files = dict(task_files(settings, project, offer))
    without = {} if offer is None else offer.lacking(settings, project.camera, project.plan)
    groups = [name for name in settings.unknowns if name not in without]
    if not settings.auto and not groups:
        lost = next((f"{name}, which needs {without[name]}" for name in settings.unknowns), "none")
        wanted = "one group or more that the camera has" if settings.unknowns else "one group or more"
        raise InputError.expected("unknowns", wanted, lost, "choose others, or those that help")
    return FitMatrix(
        sources=(Path(project.psf),),
        out=out,
        camera=str(where / CAMERA_FILE) if CAMERA_FILE in files else "",
        plan=where / PLAN_FILE if PLAN_FILE in files else None,
        unknowns="auto" if settings.auto else ",".join(groups),
        **{row.name: getattr(settings, row.name) for row in ROWS},
    )


def task_files(settings: FitSettings, project: ProjectState, offer: Offer | None) -> tuple[tuple[str, str], ...]:
    """Return the files that the task reads besides H, by name and text."""
    bare = offer is not None and offer.camera is None
    camera = ((CAMERA_FILE, project.camera.to_json()),) if settings.camera == "window" else ()
    return (*camera, (PLAN_FILE, needed_plan(project).to_json())) if bare else camera


def stamp_of(project: ProjectState) -> Stamp | None:
    """Return the project's H as its file is now, None where there is none."""
    return file_stamp(project.psf)


# -- what a fitted camera changes in the project ---------------------------------------------------------
@dataclass(frozen=True)
class FitUse:
    """Changes of the project if the fitted camera is used.

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
        """Return whether a project still has this camera: it was not changed or undone."""
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
            words.append("the plan now uses this camera")
        except LfcalError as error:
            plan = None
            words.append(f"the plan does not fit this camera and was removed ({error})")
    settings = {**project.settings, "simulate": _simulate(project, fit)}
    words.append("Record > Compute has the effects of the fit")
    if any(fit.setup.depth_errors_um) or fit.setup.stage_scale:
        words.append("fitted depths and stage scale are not part of a camera: the plan keeps its own")
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
