"""The Accuracy page: settings, subjects of measurement, texts, and use of a measured setting. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from lfcal.accuracy import CostPoint, Curve, format_cost
from lfcal.base import InputError, LfcalError, any_of
from lfcal.reconstruct import SolverChoice
from lfcal.tasks import SimulateH
from lfcal_gui.models import Field, PageSettings, ProjectState, typeset

SUBJECTS = (("plan", "Scan plan"), ("psf", "H"))

FIELDS = (
    Field(
        "subject",
        "Measure",
        kind="choice",
        choices=SUBJECTS,
        tip="Measure the accuracy for a simulation of the plan, or for the values of H",
    ),
    Field("seconds", "Time per measurement", "s", "Approximate time in which one part of the processing is measured"),
    Field("error", "Target error", "%", "Error at which the cost is estimated", scale=0.01),
)


@dataclass(frozen=True)
class AccuracySettings(PageSettings):
    """Settings of the page.

    Attributes
    ----------
    part
        One of `PARTS`.
    subject
        ``"plan"`` or ``"psf"``.
    seconds
        Approximate time to measure one part (s).
    error
        Target error for which the cost is shown (fraction).
    """

    page: ClassVar[str] = "accuracy"

    part: str = "simulation"
    subject: str = "plan"
    seconds: float = 10.0
    error: float = 0.01

    def __post_init__(self) -> None:
        """Check every value; a part of a package that is not installed is kept."""
        if self.subject not in dict(SUBJECTS):
            raise InputError.expected("subject", any_of(dict(SUBJECTS)), self.subject, "choose one of these")
        if not 0 < self.seconds <= 86_400:
            raise InputError.expected(
                "time per measurement (s)",
                "a number above 0 and at most 86400",
                self.seconds,
                "enter a time such as 10",
            )
        if not 0 < self.error <= 10:
            raise InputError.expected(
                "target error (%)",
                "a number above 0 and at most 1000",
                f"{100 * self.error:g}",
                "enter a value such as 1",
            )


def subjects(project: ProjectState) -> tuple[str, ...]:
    """Return the subjects of the project that can be measured."""
    found = (("plan", project.plan is not None), ("psf", bool(project.psf) and Path(project.psf).exists()))
    return tuple(name for name, there in found if there)


def words_of(curve: Curve | None, error: float, *, running: bool, in_use: CostPoint | None = None) -> tuple[str, str]:
    """Return the cost of the target error with the setting in use, and how the error was measured, as text."""
    if curve is None:
        return ("measuring …" if running else "Not measured yet: press Measure."), ""
    if not curve.points:
        longer = "; increase the time per measurement" if curve.stopped.startswith(("ended after", "not begun")) else ""
        reason = f"Not measured: {curve.stopped or 'stopped'}{longer}"
        return ("measuring the reference …" if running else reason), ""
    state = "measuring …" if running else curve.stopped
    how = [f"Measured by: {curve.truth}.", *curve.notes, state]
    answer = curve.answer(error)
    if in_use is not None:
        spent = f"{curve.error_text(in_use.error, error)} for {format_cost(in_use.cost, in_use.unit)}"
        answer += f"\nIn use: {in_use.label} ({spent})"
    return typeset(answer), "\n".join(typeset(line) for line in how if line)


LEVELS = {"debye": "microscope"}
"""Levels with another name in the window."""

NO_USE = {
    "lattice": "Nothing was changed: this result is the number of lenslets that a white image must show.",
    "aperture": "Nothing was changed: the period of the array sets the number of positions per plane.",
    "sampling": "Nothing was changed: the sampling is chosen automatically from the tolerance.",
}
"""Reason why the result changes nothing, for each part without a setting in the project."""


@dataclass(frozen=True)
class PointUse:
    """Result of applying a measured setting.

    Attributes
    ----------
    words
        Description of the change, or why nothing changed.
    label
        Name of the undo step; empty if nothing changes.
    changes
        Entries of the project that change.
    page
        Page that shows the change; empty if none.
    """

    words: str
    label: str = ""
    changes: Mapping[str, Any] | None = None
    page: str = ""


def use_of(project: ProjectState, curve: Curve, point: CostPoint) -> PointUse:
    """Return the changes of the project that apply the measured setting ``point``."""
    maker = _USES.get(curve.part)
    if maker is None:
        return PointUse(NO_USE.get(curve.part, "Nothing was changed: the window has no setting for this part."))
    try:
        return maker(project, point)
    except (LfcalError, KeyError, TypeError) as error:
        return PointUse(f"Nothing was changed: {error}")


DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "simulate": {"tolerance": SimulateH.tolerance, "level": SimulateH.level},
    "reconstruct": {"solver": SolverChoice().name, "iterations": SolverChoice().iterations},
}
"""Settings that a page uses if the project states none, for pages that take a measured setting."""


def in_use(project: ProjectState, curve: Curve) -> CostPoint | None:
    """Return the measured setting that the project uses now; None if it was not measured."""
    return next((point for point in curve.points if _used(project, use_of(project, curve, point).changes)), None)


def _used(project: ProjectState, changes: Mapping[str, Any] | None) -> bool:
    """Return whether ``changes`` leave the project as it is."""
    if changes is None:
        return False
    if "plan" in changes:
        return bool(changes["plan"] == project.plan)
    for page, values in changes["settings"].items():
        stored = project.settings.get(page)
        if values == stored:  # also the settings of other pages, of any type
            continue
        own = {**DEFAULTS.get(page, {}), **(stored if isinstance(stored, Mapping) else {})}
        if any(own.get(name) != value for name, value in values.items()):
            return False
    return True


def _settings(project: ProjectState, page: str, **values: Any) -> dict[str, Any]:
    """Return the settings of all pages with some of one page changed; the page checks them when it reads them."""
    own = project.settings.get(page)
    return {"settings": {**project.settings, page: {**(own if isinstance(own, Mapping) else {}), **values}}}


def _simulation(project: ProjectState, point: CostPoint) -> PointUse:
    tolerance = float(point.settings["tolerance"])
    changes = _settings(project, "simulate", tolerance=tolerance, level="auto")
    return PointUse(f"Compute: tolerance {100 * tolerance:g} %, level auto.", "tolerance", changes, "simulate")


def _planes(project: ProjectState, point: CostPoint) -> PointUse:
    if project.plan is None:
        return PointUse("Nothing was changed: there is no scan plan.")
    depths = tuple(float(z) for z in point.settings["depths_um"])
    plan = replace(project.plan, depths_um=depths, exposure_s=project.plan.exposures[0])
    return PointUse(f"Plan: {len(depths)} planes over the same depths.", "planes", {"plan": plan}, "setup")


def _averaging(project: ProjectState, point: CostPoint) -> PointUse:
    if project.plan is None:
        return PointUse("Nothing was changed: there is no scan plan.")
    given = tuple(float(t) for t in point.settings["exposure_s"])
    exposure = given if len(given) == len(project.plan.depths_um) else given[0]
    frames = int(point.settings["frames_averaged"])
    plan = replace(project.plan, frames_averaged=frames, exposure_s=exposure)
    words = f"Plan: {frames} frame{'s' * (frames > 1)} averaged, exposure {1e3 * given[0]:.4g} ms."
    return PointUse(words, "frames averaged", {"plan": plan}, "setup")


def _recording(project: ProjectState, point: CostPoint) -> PointUse:
    if "fitted_patterns" in point.settings:
        return PointUse("Nothing was changed: lfcal plan fit chooses the positions of a fit.")
    return _averaging(project, point)


def _interpolation(project: ProjectState, point: CostPoint) -> PointUse:
    name = str(point.settings["interpolation"])
    changes = _settings(project, "frames", interpolation=name)
    return PointUse(f"Folder: interpolation {name}.", "interpolation", changes, "frames")


def _projection(project: ProjectState, point: CostPoint) -> PointUse:
    method, double = str(point.settings["method"]), bool(point.settings["double"])
    threshold = float(point.settings["threshold"])
    changes = _settings(project, "reconstruct", method=method, double=double, threshold=threshold)
    precision = "double precision" if double else "single precision"
    words = (
        f"Reconstruct: projector {method}, {precision}, entries of H below {100 * threshold:g} % of the peak omitted."
    )
    return PointUse(words, "projector", changes, "reconstruct")


def _solvers(project: ProjectState, point: CostPoint) -> PointUse:
    solver, iterations = str(point.settings["solver"]), int(point.settings["iterations"])
    changes = _settings(project, "reconstruct", solver=solver, iterations=iterations)
    words = f"Reconstruct: {solver}, {iterations} iteration{'s' * (iterations > 1)}."
    return PointUse(words, "solver", changes, "reconstruct")


def _storage(project: ProjectState, point: CostPoint) -> PointUse:
    dtype, compression = str(point.settings["dtype"]), str(point.settings["compression"])
    if dtype not in ("rounded", "float32") or compression not in ("gzip", "none"):
        return PointUse(
            "Nothing was changed: the window exports H rounded or as float32, with gzip or without. "
            "For other types, use the command line or Python."
        )
    chosen = {"suffix": ".h5", "dtype": dtype, "uncompressed": compression == "none"}
    packed = "with gzip" if compression == "gzip" else "not compressed"
    return PointUse(
        f"Use: Other formats proposes an H file, {dtype}, {packed}.",
        "export",
        _settings(project, "export", **chosen),
        "reconstruct",
    )


def _filters(project: ProjectState, point: CostPoint) -> PointUse:
    if point.settings["route"] != "spatial":
        return PointUse("Nothing was changed: Multiplexing always shows the Fourier route next to the spatial one.")
    name = str(point.settings["filter"])
    return PointUse(
        f"Multiplexing: filter {name}.", "filter", _settings(project, "multiplex", filter=name), "multiplex"
    )


def _bases(project: ProjectState, point: CostPoint) -> PointUse:
    kind, size = str(point.settings["mask"]), int(point.settings["size"])
    changes = _settings(project, "multiplex", family="mask", mask=kind, size=size)
    words = f"Multiplexing: {kind.replace('_', ' ')}, {size} x {size} px. The exposure is that of your session."
    return PointUse(words, "modulator", changes, "multiplex")


_USES: dict[str, Callable[[ProjectState, CostPoint], PointUse]] = {
    "simulation": _simulation,
    "planes": _planes,
    "averaging": _averaging,
    "recording": _recording,
    "interpolation": _interpolation,
    "storage": _storage,
    "projection": _projection,
    "solvers": _solvers,
    "filters": _filters,
    "bases": _bases,
}
"""Function that applies a measured setting, for each part."""
