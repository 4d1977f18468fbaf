"""Fit of the optics: settings, and the data that an H offers to a fit. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, any_of, plain
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import GROUPS, Fit, Setup, kept_aside, lacking, measured_camera, starting_effects
from lfcal.psf import PSFMatrix, noise_of
from lfcal.records import rows
from lfcal.simulate.effects import CATALOGUE
from lfcal.tasks import FitMatrix, most_taken
from lfcal_gui.models import CAMERA_FILE, PLAN_FILE, Field, PageSettings, ProjectState, Stamp, needed_plan
from lfcal_gui.models import stamp_of as file_stamp

STARTS = (("psf", "H's own camera"), ("window", "camera of this window"))
"""Cameras from which a fit can start."""

START = Field("camera", "Start from", kind="choice", choices=STARTS, tip="Camera description from which the fit starts")

CORE = tuple(group.name for group in GROUPS if group.core)
"""Groups of unknowns that are fitted by default."""

HELD = frozenset({"sources", "out", "camera", "plan", "unknowns", "write_h"})
"""Fields of `lfcal.tasks.FitMatrix` that the form does not show.

H, camera and plan are those of the project, unknowns are in a list, and buttons determine the output."""

ROWS = tuple(row for row in rows(FitMatrix) if row.name not in HELD)

HELD_OUT = 0.2


@dataclass(frozen=True)
class FitSettings(PageSettings):
    """Settings of the fit; fields not listed are as in `lfcal.tasks.FitMatrix`.

    Attributes
    ----------
    camera
        ``"psf"`` or ``"window"``, see `STARTS`.
    auto
        Whether groups of unknowns are chosen automatically instead of by ``groups``.
    groups
        Names of groups; those of a package that is not installed are kept.
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
            raise InputError.expected("start", any_of(dict(STARTS)), self.camera, "choose one of these")
        if not all(isinstance(name, str) for name in self.groups):
            raise InputError.expected("groups", "a list of names", self.groups, "choose groups in the list")
        for row in ROWS:
            object.__setattr__(self, row.name, row.value(getattr(self, row.name), row.label))

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``; earlier versions stored constant and slope of the noise separately."""
        if isinstance(data, Mapping) and (apart := [data.get("constant"), data.get("slope")]) != [None, None]:
            data = {"noise": apart, **data}
        return super().read(data)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Chosen groups that are installed."""
        return tuple(name for name in self.groups if name in GROUPS)


def group_rows() -> tuple[tuple[str, str, bool], ...]:
    """Return name and title of each group of unknowns, and whether the automatic choice always includes it."""
    return tuple((group.name, group.title, group.core) for group in GROUPS)


# -- what an H offers --------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Offer:
    """Data that an H offers to a fit.

    Attributes
    ----------
    shape
        Shape of H.
    recorded
        Number of recorded patterns.
    camera
        Name of the camera stated in H; None if there is none.
    noise
        Mean (constant, slope) of the variance stated in H or its provenance; None if not stated.
    problem
        Why the noise stated in H cannot be used; empty if it can, or if there is none.
    plan
        Scan plan with the camera of H; None if there is none.
    unfit
        Why H and its camera do not match; empty if they do.
    aside
        Number of positions held out by the session.
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
        """Return a line of text on the positions of the H called ``name``."""
        nz, ny, nx = self.shape[:3]
        planes, positions = f"{nz} plane{'s' * (nz > 1)}", nz * ny * nx
        if self.recorded == positions:
            return f"{name}: all {positions:,} positions recorded, {planes}"
        return f"{name}: {self.recorded:,} of {positions:,} positions recorded, {planes}"

    def use_words(self, positions: int | None) -> str:
        """Return a line of text on the number of positions that are used, for the requested number."""
        most = most_taken(positions, range(self.aside))
        used = min(most or self.recorded, self.recorded)
        aside = self.aside if self.aside and used == self.recorded else round(HELD_OUT * used)
        return f"{used:,} are used, {aside:,} of them held out to test the fit."

    def noise_words(self, settings: FitSettings) -> tuple[str, str]:
        """Return a line of text on the noise, and its role: ``"hint"``, or ``"error"`` if something is missing."""
        if settings.noise is not None:
            over = ", not as stated in H" if self.noise is not None else ""
            return f"Noise as given here{over}.", "hint"
        if self.problem:
            return self.problem, "error"
        if self.noise is None:
            return "H does not state its noise: enter the constant and slope of the variance.", "error"
        constant, slope = self.noise
        return f"Noise as stated in H: variance about {constant:.3g} + {slope:.3g} × value.", "hint"

    def camera_words(self, settings: FitSettings, window: Camera, plan: ScanPlan | None) -> tuple[str, str]:
        """Return a line of text on the camera from which the fit starts, and its role as in `noise_words`.

        ``window`` and ``plan`` are camera and plan of the project.
        """
        if self.unfit:
            return f"H does not match its own camera: {self.unfit}.", "error"
        if self.camera is None:
            if plan is None or plan.shape != self.shape:
                return f"H states no camera: make a plan of its shape {self.shape} in Set up.", "error"
            return (
                f"H states no camera. The fit uses the camera {window.name}, the depths and the anchor of the plan."
            ), "hint"
        if settings.camera == "window":
            _, refused = self._by_window(window)
            if refused:
                return f"H does not match {window.name}, the camera of this window: {refused}.", "error"
            return f"The fit starts from {window.name}, the camera of this window.", "hint"
        return f"The fit starts from {self.camera}, the camera of H.", "hint"

    def lacking(self, settings: FitSettings, window: Camera, plan: ScanPlan | None) -> dict[str, str]:
        """Return the groups for which the fitted camera has no unknowns, each with the reason.

        ``window`` and ``plan`` are camera and plan of the project. The result is empty if neither H
        nor plan states a camera.
        """
        own = self.plan
        if own is None:
            own = plan if plan is not None and plan.shape == self.shape else None
        elif settings.camera == "window":
            own, _ = self._by_window(window)
        return {} if own is None else lacking_of(own)

    def _by_window(self, window: Camera) -> tuple[ScanPlan | None, str]:
        """Return the plan of H with the camera of the window, or None and the reason if its sensor is too small."""
        assert self.plan is not None
        try:
            return replace(self.plan, camera=window), ""
        except InputError as error:
            return None, str(error)


def lacking_of(plan: ScanPlan) -> dict[str, str]:
    """Return the groups without unknowns in a fit of this scan, by name, with what they would need."""
    return lacking(Setup(plan.camera, starting_effects(plan), (0.0,) * plan.shape[0]), plan)


def offer_of(matrix: PSFMatrix) -> Offer:
    """Return what an H or HT offers to a fit, from its metadata, without reading patterns."""
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
        return None, "H was assembled with its black level: assemble it with a dark frame, or enter the noise here."
    constant, slope = own.mean(0).tolist()
    return (constant, slope), ""


# -- the task ----------------------------------------------------------------------------------------------
def task_of(
    settings: FitSettings, project: ProjectState, offer: Offer | None, out: Path = Path("fit"), where: Path = Path()
) -> FitMatrix:
    """Return the task that fits a camera to a project's H; camera and plan are files in the folder ``where``.

    Groups that the page greys out are not fitted. ``offer`` is None if H is not read yet.
    """
    files = dict(task_files(settings, project, offer))
    without = {} if offer is None else offer.lacking(settings, project.camera, project.plan)
    groups = [name for name in settings.unknowns if name not in without]
    if not settings.auto and not groups:
        lost = next((f"{name}, which needs {without[name]}" for name in settings.unknowns), "none")
        wanted = "one group or more that the camera has" if settings.unknowns else "one group or more"
        raise InputError.expected("unknowns", wanted, lost, "tick groups, or choose automatically")
    return FitMatrix(
        sources=(Path(project.psf),),
        out=out,
        camera=str(where / CAMERA_FILE) if CAMERA_FILE in files else "",
        plan=where / PLAN_FILE if PLAN_FILE in files else None,
        unknowns="auto" if settings.auto else ",".join(groups),
        **{row.name: getattr(settings, row.name) for row in ROWS},
    )


def task_files(settings: FitSettings, project: ProjectState, offer: Offer | None) -> tuple[tuple[str, str], ...]:
    """Return name and content of the files that the task reads in addition to H."""
    bare = offer is not None and offer.camera is None
    camera = ((CAMERA_FILE, project.camera.to_json()),) if settings.camera == "window" else ()
    return (*camera, (PLAN_FILE, needed_plan(project).to_json())) if bare else camera


def stamp_of(project: ProjectState) -> Stamp | None:
    """Return the current stamp of the project's H; None if there is none."""
    return file_stamp(project.psf)


# -- what a fitted camera changes in the project ---------------------------------------------------------
@dataclass(frozen=True)
class FitUse:
    """Changes of the project if the fitted camera is used.

    Attributes
    ----------
    changes
        Changed entries of the project.
    words
        Description of what changed and what did not.
    """

    changes: Mapping[str, Any]
    words: str

    def holds(self, project: ProjectState) -> bool:
        """Return whether a project still uses this camera."""
        camera = self.changes["camera"]
        return bool(project.camera == camera and project.camera.marks == camera.marks)


def use_of(project: ProjectState, fit: Fit) -> FitUse:
    """Return the changes of the project that use the fitted camera and effects.

    The plan keeps its positions on the sensor, its depths and its exposures. A plan that does not match the camera
    is removed.
    """
    camera = measured_camera(fit)
    words = [f"In use: fitted camera {camera.name}"]
    plan = project.plan
    if plan is not None:
        try:
            plan = replace(plan, camera=camera)
            words.append("the plan now uses this camera")
        except LfcalError as error:
            plan = None
            words.append(f"the plan does not fit this camera and was removed ({error})")
    settings = {**project.settings, "simulate": _simulate(project, fit)}
    words.append("Record > Compute now uses the effects of the fit")
    if any(fit.setup.depth_errors_um) or fit.setup.stage_scale:
        words.append("fitted depths and stage scale are not part of a camera: the plan keeps its values")
    return FitUse({"camera": camera, "plan": plan, "settings": settings}, "; ".join(words) + ".")


def _simulate(project: ProjectState, fit: Fit) -> dict[str, Any]:
    """Return the settings of Record > Compute with the effects on H replaced by those of the fit."""
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
    """Return whether an effect does not change H; True also for effects that are not installed."""
    return not isinstance(name, str) or name not in CATALOGUE or not CATALOGUE.get(name).acts_on.enters_h
