"""The Fit page: what the user chose, and what an H offers to a fit. No Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import GROUPS, Setup, lacking, starting_effects
from lfcal.psf import PSFMatrix
from lfcal_gui.models import Field, PageSettings, ProjectState, Stamp
from lfcal_gui.models import stamp_of as file_stamp

__all__ = [
    "CORE",
    "FIELDS",
    "START",
    "FitSettings",
    "Offer",
    "Stamp",
    "group_rows",
    "lacking_of",
    "offer_of",
    "stamp_of",
]

START = (("psf", "H's own camera"), ("window", "camera of this window"))
"""Which camera a fit starts from."""

CORE = ("geometry", "focal_lengths", "iris")
"""Groups that are chosen where nobody has chosen yet."""

HELD_OUT = 0.2

FIELDS = (
    Field("camera", "Start from", kind="choice", choices=START, tip="The camera as described, where the fit starts"),
    Field(
        "positions",
        "Positions",
        kind="int",
        tip="Recorded positions that are used, spread evenly over period and planes; 0: all of them.\n"
        "A fifth is never fitted, and tells how good the fit is.",
    ),
    Field(
        "constant",
        "Noise: constant",
        tip="Variance of a sample of no light, in squared counts.\nEmpty: as H states.",
        optional=True,
    ),
    Field(
        "slope",
        "Noise: slope",
        tip="By how much the variance grows for each count of light; 1 / gain where that is in electrons per count.\n"
        "Empty: as H states.",
        optional=True,
    ),
)


@dataclass(frozen=True)
class FitSettings(PageSettings):
    """What the user chose.

    Attributes
    ----------
    camera
        ``"psf"`` or ``"window"``, see `START`.
    positions
        Recorded positions that are used, spread evenly; 0: all.
    auto
        Whether groups of unknowns are found, or are those of ``groups``.
    groups
        Names of groups; those of a distribution that is not installed are kept.
    constant, slope
        Variance of a sample: constant + slope x value; None: as H states.
    """

    page: ClassVar[str] = "fit"

    camera: str = "psf"
    positions: int = 40
    auto: bool = True
    groups: tuple[str, ...] = CORE
    constant: float | None = None
    slope: float | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        if self.camera not in dict(START):
            raise InputError.expected("start", " or ".join(dict(START)), self.camera, "choose one of these")
        if self.positions != 0 and self.positions < 3:
            raise InputError.expected("positions", "3 or more, or 0 for all", self.positions, "correct it")
        if not all(isinstance(name, str) for name in self.groups):
            raise InputError.expected("groups", "names", self.groups, "choose some of the list")
        for name, value in (("constant", self.constant), ("slope", self.slope)):
            if value is not None and not (_number(value) and math.isfinite(value) and value >= 0):
                raise InputError.expected(f"noise: {name}", "0 or more, or nothing", value, "correct it")

    @property
    def unknowns(self) -> str | tuple[str, ...]:
        """What is asked of the library: ``"auto"``, or the groups that are installed."""
        return "auto" if self.auto else tuple(name for name in self.groups if name in GROUPS)

    @property
    def noise(self) -> tuple[float, float] | None:
        """Constant and slope, None: as H states.

        Raises
        ------
        InputError
            Where one is given without the other.
        """
        if self.constant is None and self.slope is None:
            return None
        if self.constant is None or self.slope is None:
            raise InputError.expected("noise", "constant and slope", "one of them", "give both, or neither")
        if self.constant + self.slope <= 0:
            raise InputError.expected("noise", "a variance above 0", "0", "give constant and slope")
        return float(self.constant), float(self.slope)


def _number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


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
        Mean (constant, slope) of the variance that H states, None where it states none.
    problem
        Why what H states of its noise cannot be used; empty where it can, or where it states none.
    plan
        The scan with H's own camera, None where it has none.
    unfit
        Why H and its own camera do not go together, or empty.
    """

    shape: tuple[int, ...]
    recorded: int
    camera: str | None
    noise: tuple[float, float] | None
    problem: str = ""
    plan: ScanPlan | None = None
    unfit: str = ""

    def source_words(self, name: str) -> str:
        """Return a line on the positions of H, which is called ``name``."""
        nz, ny, nx = self.shape[:3]
        planes, positions = f"{nz} plane{'s' * (nz > 1)}", nz * ny * nx
        if self.recorded == positions:
            return f"{name}: all {positions:,} positions recorded, {planes}"
        return f"{name}: {self.recorded:,} of {positions:,} positions recorded, {planes}"

    def use_words(self, positions: int) -> str:
        """Return a line on how many are used of how many were asked for."""
        used = self.recorded if positions == 0 else min(positions, self.recorded)
        aside = round(HELD_OUT * used)
        return f"{used:,} are used, {aside:,} of them kept aside to judge the fit."

    def noise_words(self, settings: FitSettings) -> tuple[str, str]:
        """Return a line on the noise, and its role: ``"hint"``, or ``"error"`` where something is missing."""
        if (settings.constant is None) != (settings.slope is None):
            return "Noise needs both constant and slope, or neither.", "error"
        if settings.constant is not None:
            if settings.constant + (settings.slope or 0) <= 0:
                return "Without noise nothing is weighed: give a variance above 0.", "error"
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
                return f"H has no camera of its own: make a plan of its shape {self.shape} on the Plan page.", "error"
            return f"H has no camera of its own: takes camera, depths and anchor of the plan, {window.name}.", "hint"
        if settings.camera == "window":
            _, refused = self._by_window(window)
            if refused:
                return f"H does not fit {window.name}, the camera of this window: {refused}.", "error"
            return f"Starts from {window.name}, the camera of this window.", "hint"
        return f"Starts from {self.camera}, as H was made with.", "hint"

    def lacking(self, settings: FitSettings, window: Camera, plan: ScanPlan | None) -> dict[str, str]:
        """Return the groups that the camera of the fit has no unknowns of, by name, and what it would need for them.

        ``window`` and ``plan`` are those of the window; nothing where there is no camera to tell it from.
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
    if matrix.camera is None:
        return Offer(matrix.shape, int(recorded.sum()), None, noise, problem)
    depths = tuple(float(z) for z in matrix.depths)
    plan, unfit = None, ""
    try:
        plan = ScanPlan(matrix.camera, matrix.period, matrix.cutout, depths, matrix.anchor)
    except InputError as error:  # a file may hold any anchor
        unfit = str(error)
    return Offer(matrix.shape, int(recorded.sum()), matrix.camera.name, noise, problem, plan, unfit)


def _noise(matrix: PSFMatrix, recorded: NDArray[np.bool_]) -> tuple[tuple[float, float] | None, str]:
    known = matrix.facts.noise
    if known is None or not recorded.any():
        return None, ""
    own = np.asarray(known, np.float64)[recorded]
    if not np.isfinite(own).all():
        return None, ""
    # of samples above a black level the variance begins there, and at 0 it would be below nothing
    if (own[:, 0] < 0).any():
        return None, "H was assembled with its black level: assemble it with a dark frame, or give the noise here."
    constant, slope = own.mean(0).tolist()
    return (constant, slope), ""


def stamp_of(project: ProjectState) -> Stamp | None:
    """Return the project's H as its file is now, None where there is none."""
    return file_stamp(project.psf)
