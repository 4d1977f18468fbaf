"""Measure stage-to-image scale, rotation and sign from a few moves, and the movement in depth.

A scan with a wrong sign yields a useless H that looks correct, so the sign is measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.acquire._looking import Looker
from lfcal.acquire._motion import check_limits
from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.base import Clock, InputError, Work
from lfcal.camera import ScanPlan, StageAxes, half_extent_px, rms_radius_px
from lfcal.devices import LimitError, Limits, Rig
from lfcal.frames import AS_IS, nearest_orientation
from lfcal.psf import either_words

__all__ = [
    "CELL_PX",
    "PHASE",
    "DepthFit",
    "DepthLook",
    "StageFit",
    "check_axes",
    "check_depth",
    "check_stage",
    "depth_fit",
    "fit_stage",
    "iter_stage_fit",
    "phase_drift",
    "places_about",
    "room",
]

SENSES = ("right", "down")
CELL_PX = 0.25
"""Tolerated displacement of the image over one period due to an error of scale or angle (pixels)."""
PHASE = 0.1
"""Tolerated displacement of the lenslets' pattern, in periods, between places that should look the same."""


@dataclass(frozen=True, slots=True)
class StageFit:
    """Measured motion of the image with the stage, compared with the plan.

    Attributes
    ----------
    matrix
        Matrix ``((a, b), (c, d))`` that converts a planned movement (right, down) of the image to the measured one;
        ideally the unit matrix.
    axes
        Axes and origin of the stage according to the measurement.
    residual_px
        RMS distance of the centroids from the fit (px).
    """

    matrix: tuple[tuple[float, float], tuple[float, float]]
    axes: StageAxes
    residual_px: float

    @property
    def scale(self) -> tuple[float, float]:
        """Ratios (right, down) of measured to planned movement of the image; ideally 1."""
        (a, b), (c, d) = self.matrix
        return math.hypot(a, c), math.hypot(b, d)

    @property
    def mirrored(self) -> bool:
        """Whether the image moves as a mirror image of the plan: one axis is reversed, or the two are swapped."""
        (a, b), (c, d) = self.matrix
        return a * d - b * c < 0

    @property
    def orientation(self) -> str:
        """Name of the orientation in `lfcal.frames.ORIENTATIONS` that makes the live image move as planned."""
        (a, b), (c, d) = self.matrix
        return nearest_orientation(((d, c), (b, a)))[0].name

    @property
    def rotation_rad(self) -> float:
        """Rotation of the image's movement relative to the plan (rad), positive from right towards down (clockwise)."""
        (a, b), (c, d) = self.matrix
        sign = -1.0 if self.mirrored else 1.0
        return math.atan2(c - sign * b, a + sign * d)


def fit_stage(plan: ScanPlan, z: int, stage_um: ArrayLike, image_px: ArrayLike) -> StageFit:
    """Fit the motion of the image with the stage to positions in one depth plane.

    Parameters
    ----------
    plan
        The plan with which the motion is compared.
    z
        Index of the depth plane.
    stage_um
        Positions (x, y, z) read back from the stage (µm), ``(N, 3)``: three or more, not on one line.
    image_px
        Centroids (row, column) of the image on the sensor (px), ``(N, 2)``.

    Raises
    ------
    InputError
        If the moves do not span the plane, or the image did not move.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> import numpy as np
    >>> from lfcal.acquire.setup import StageFit, fit_stage
    >>> step = plan.camera.step_um(plan.depths_um[0])
    >>> stage = [(x * step, y * step, plan.depths_um[0]) for x, y in ((0, 0), (10, 0), (0, 10))]
    >>> found: StageFit = fit_stage(plan, 0, stage, [(50, 60), (50, 70), (60, 60)])  # images as (row, column)
    >>> print([round(s, 3) for s in found.scale], f"{abs(found.rotation_rad):.3f} rad", found.mirrored)
    [1.0, 1.0] 0.000 rad False
    """
    objects = plan.stage.to_object(np.asarray(stage_um, float))[:, :2]
    seen = np.asarray(image_px, float)[:, ::-1]
    moves = objects / plan.camera.step_um(plan.depths_um[z])
    design = np.column_stack([moves, np.ones(len(moves))])
    spread = np.linalg.svd(moves - moves.mean(axis=0), compute_uv=False) if len(moves) > 2 else np.zeros(2)
    if len(moves) < 3 or spread[-1] < 1e-3 * spread[0] or spread[0] == 0:
        raise InputError.expected(
            "moves of the stage",
            "three or more positions, not on one line",
            f"{len(moves)}{' on one line' if len(moves) > 2 else ''}",
            "move the stage along both lateral axes",
        )
    solution, *_ = np.linalg.lstsq(design, seen, rcond=None)
    matrix = solution[:2].T
    residual = float(np.sqrt(((design @ solution - seen) ** 2).sum(axis=1).mean()))
    # centroids that consist of noise give a matrix near zero
    if np.linalg.norm(matrix) < 0.05:
        raise InputError.expected(
            "image",
            "one that moves with the stage",
            "a stationary one",
            "check which stage carries the source, and the focus",
        )
    (a, b), (c, d) = matrix.tolist()
    return StageFit(((a, b), (c, d)), _axes(plan, z, matrix, solution[2]), residual)


def _axes(plan: ScanPlan, z: int, matrix: NDArray[np.float64], at_origin: NDArray[np.float64]) -> StageAxes:
    """Return stage axes that fit ``matrix``, with the origin where the image is at the sensor's centre."""
    old = plan.stage
    planned = (old.right, old.down)
    # the larger pair of entries shows the stage axis that moves the image sideways
    swapped = abs(matrix[0, 1]) + abs(matrix[1, 0]) > abs(matrix[0, 0]) + abs(matrix[1, 1])
    names = []
    for image in range(2):
        axis = planned[1 - image if swapped else image]
        names.append(axis if matrix[image, 1 - image if swapped else image] >= 0 else _turned(axis))
    centre = np.array(plan.camera.sensor.centre_px[::-1])
    shift = np.linalg.solve(matrix, centre - at_origin) * plan.camera.step_um(plan.depths_um[z])
    moved = old.to_stage(np.array([shift[0], shift[1], 0.0]))
    x, y, depth = moved.tolist()
    return StageAxes(names[0], names[1], old.away, (x, y, depth))


def _turned(axis: str) -> str:
    return ("-" if axis[0] == "+" else "+") + axis[1]


def check_axes(fit: StageFit, plan: ScanPlan) -> None:
    """Raise `InputError` if, compared with ``plan``, a lateral stage axis is reversed, or the two are swapped."""
    old, new = plan.stage, fit.axes
    if (old.right, old.down) != (new.right, new.down):
        why = "" if fit.orientation == AS_IS else f": {either_words(fit.orientation)}"
        raise InputError.expected(
            "stage axes (right, down)",
            f"{old.right}, {old.down} as in the plan",
            f"{new.right}, {new.down} as measured in the image{why}",
            "set the measured axes in the plan; otherwise, the scan runs in the wrong direction",
        )


def check_stage(fit: StageFit, plan: ScanPlan, *, cell_px: float = CELL_PX, residual_px: float = 2.0) -> None:
    """Raise `InputError` if the stage does not move the image as planned.

    Parameters
    ----------
    fit, plan
        The measurement, and the plan with which it is compared.
    cell_px, residual_px
        Largest displacement of the image over one period that an error of scale or angle may cause (px). Largest RMS
        residual of the fit (px).

    Examples
    --------
    >>> from lfcal.acquire.setup import check_stage, iter_stage_fit
    >>> from lfcal.camera import ScanPlan, StageAxes, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import InputError
    >>> from lfcal.base import drain
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> rig = simulated_rig(plan, axes=StageAxes("-x", "+y", "+z"))  # mounted reversed
    >>> try:
    ...     check_stage(drain(iter_stage_fit(rig, plan)), plan)
    ... except InputError as error:
    ...     print(str(error).partition(":")[0])
    stage axes (right, down)
    """
    check_axes(fit, plan)
    for value, sense, period in zip(fit.scale, SENSES, plan.period[::-1], strict=True):
        if abs(value - 1) * period > cell_px:
            raise InputError.expected(
                f"image movement to the {sense}" if sense == "right" else "image movement down",
                f"{period} ± {cell_px:.2g} px for a stage movement of one period of the plan",
                f"{value * period:.2f} px ({100 * (value - 1):+.2f} %)",
                "correct the camera's magnification or working distance in the plan, or the stage's scale",
            )
    most = cell_px / max(plan.period)
    if abs(fit.rotation_rad) > most:
        raise InputError.expected(
            "angle between stage and sensor",
            f"below {math.degrees(most):.2f}° ({cell_px:g} px over one period of the plan)",
            f"{math.degrees(fit.rotation_rad):.2f}°",
            "rotate the camera until its rows are parallel to the stage axis",
        )
    if fit.residual_px > residual_px:
        raise InputError.expected(
            "image movement",
            f"linear within {residual_px:g} px rms",
            f"{fit.residual_px:.2f} px",
            "check the stage, and that only one spot is visible",
        )


def iter_stage_fit(
    rig: Rig, plan: ScanPlan, *, z: int = 0, options: Options | None = None, control: Control | None = None
) -> Work[StageFit]:
    """Measure how the image moves with the stage, at the five positions of `places_about` in plane ``z``.

    No files are written, and the stage returns to its previous position.

    Parameters
    ----------
    rig, plan, options, control
        As in `lfcal.acquire.iter_record`.
    z
        Index of the depth plane.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire.setup import iter_stage_fit
    >>> from lfcal.base import drain
    >>> found = drain(iter_stage_fit(simulated_rig(plan), plan))
    >>> print(found.axes.right, found.axes.down, [round(s, 2) for s in found.scale])
    +x +y [1.0, 1.0]
    """
    options, control = options or Options(), control or Control()
    targets = places_about(plan, z, rig.stage.limits, options.motion(plan).overshoot_um)
    clock = Clock("stage and image", len(targets))
    stage: list[tuple[float, float, float]] = []
    seen: list[tuple[float, float]] = []
    with Looker(rig, plan, options, control, targets=targets) as looker:
        for k, (x, y, depth) in enumerate(targets.tolist()):
            yield clock.at(k)
            stage.append(looker.go((x, y, depth)))
            seen.append(looker.find_spot(plan.exposures[z]))
    yield clock.at(len(targets))
    return fit_stage(plan, z, stage, seen)


def phase_drift(plan: ScanPlan) -> NDArray[np.float64]:
    """Return the fraction ``(y, x)`` by which the lenslets' period exceeds the plan's; zeros with resampling."""
    if plan.resample:
        return np.zeros(2)
    drift: NDArray[np.float64] = np.array(plan.period_residual_px) / np.array(plan.period)
    return drift


def room(plan: ScanPlan) -> NDArray[np.intp]:
    """Return by how many whole periods a cutout can move on the sensor, ``((up, left), (down, right))``.

    The cutout is the one at the middle of the period, in the first plane.
    """
    image, factors = plan.image_px([0, *(n // 2 for n in plan.period)]), np.array(plan.resample_factors)
    half, size = (np.array(plan.cutout) - 1) / 2 / factors, np.array(plan.camera.sensor.shape)
    periods = np.array(plan.period) / factors
    return np.array([(image - half) / periods, (size - 1 - image - half) / periods]).clip(0).astype(np.intp)


def places_about(
    plan: ScanPlan, z: int, limits: Limits, overshoot_um: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Return five stage positions (x, y, z), ``(5, 3)`` (µm): the middle of a period, and a rectangle around it.

    Along each axis, the corners are whole periods away from the middle, so that the pattern of the lenslets is the same
    there. The distance is three periods, or a tenth of the sensor if that is more. It is smaller if rounding of the
    period would shift the pattern by more than `PHASE`. It is also smaller if the cutout would leave the sensor, or the
    stage its travel. If the sensor has no room for a whole period, the distance is one period. ``z`` is the index of
    the depth plane, ``limits`` the travel of the stage, and ``overshoot_um`` as in `Motion` (µm).

    Raises
    ------
    LimitError
        If corners one period away are outside the travel of the stage.
    """
    middle = np.array([z, *(n // 2 for n in plan.period)])
    period = np.array(plan.period) / np.array(plan.resample_factors)
    before, after = room(plan)
    cut = before + after < 1
    before[cut], after[cut] = 1, 1
    reach = np.maximum(3, np.rint(np.array(plan.camera.sensor.shape) / 10 / period).astype(int))
    # the plan's period is rounded to whole pixels; over this many periods, the error is still small
    drift = np.maximum(np.abs(phase_drift(plan)), 1e-9)
    reach = np.maximum(1, np.minimum(reach, np.minimum(PHASE / drift, 1e6).astype(int)))
    while True:
        low, high = np.minimum(reach, before), np.minimum(reach, after)
        corners = np.array([[-low[0], -low[1]], [-low[0], high[1]], [high[0], -low[1]], [high[0], high[1]]])
        moves = np.vstack([[0, 0], corners]) * np.array(plan.period)
        places = plan.stage_um(middle + np.pad(moves, ((0, 0), (1, 0))))
        try:
            check_limits(places, limits, overshoot_um)
        except LimitError:
            if (reach <= 1).all():
                raise
            reach = np.maximum(reach - 1, 1)
        else:
            return places


ENOUGH = 0.1
"""Largest error of the depth scale at which the change of magnification is used."""
GROWTH_OFF, SPREAD_OFF, SPREAD_NOTED = 0.05, 1 / 3, 0.06
"""Deviations of the depth scale that are refused (by growth, by spread), and one (by spread) that is only noted.

The scale by growth also depends on the working distance of the lens, the scale by spread on how the source fills the
aperture.
"""
STILL = 0.2
"""Fraction of the expected movement below which a depth axis is reported not to move."""
ALIKE, APART_PX = 0.98, 2.0
"""Correlation above which two planes count as the same, and smallest expected motion of the edge for this (pixels)."""


class DepthLook(NamedTuple):
    """Measurements in one plane: the fit, the RMS radius of the light at each position (px), and the middle cutout."""

    fit: StageFit
    spread: NDArray[np.float64]
    frame: NDArray[Any]


@dataclass(frozen=True, slots=True)
class DepthFit:
    """Measured movement in depth from the first to the last plane, compared with the plan.

    Attributes
    ----------
    scale, error
        Ratio of measured to planned movement (ideally 1), and its standard deviation; NaN if it cannot be measured.
    by
        Quantity that was measured: ``"growth"`` of the image's movement with depth, or ``"spread"`` of the pattern if
        that growth is too small to be measured. Otherwise, the reason why neither is measurable.
    """

    scale: float
    error: float
    by: str


def depth_fit(
    plan: ScanPlan, looks: Sequence[DepthLook], slope_error: NDArray[np.float64], optics: str = ""
) -> DepthFit:
    """Return the movement in depth compared with the plan, from measurements in the first and the last plane.

    Parameters
    ----------
    plan
        Plan with which the movement is compared.
    looks
        Measurements in the first and in the last plane.
    slope_error
        Relative standard deviations of the measured movement of the image (right, down).
    optics
        ``"pattern"`` if frames show the simulator's quick pattern, which does not spread with depth; empty for a real
        camera.
    """
    step, last = (plan.camera.step_um(plan.depths_um[z]) for z in (0, -1))
    grows = last / step - 1
    error = float(np.mean(slope_error)) / abs(grows) if grows else math.inf
    if error <= ENOUGH:
        first_seen, last_seen = (math.sqrt(abs(np.linalg.det(np.array(look.fit.matrix)))) for look in looks)
        return DepthFit((last / last_seen / (step / first_seen) - 1) / grows, error, "growth")
    if optics == "pattern":
        return DepthFit(math.nan, math.nan, "the simulator's quick pattern does not spread with depth")
    first, second = looks
    edges = [half_extent_px(plan.camera, plan.depths_um[z]) for z in (0, -1)]
    if abs(edges[1] - edges[0]) > APART_PX and _correlation(first.frame, second.frame) > ALIKE:
        return DepthFit(0.0, 0.0, "spread")
    places = [_depth_of(plan, z, look.spread) for z, look in zip((0, -1), looks, strict=True)]
    if not any(known for _, known in places):
        return DepthFit(math.nan, math.nan, "patterns cover too few lenslets")
    away = places[1][0] - places[0][0]
    return DepthFit(away / (plan.depths_um[-1] - plan.depths_um[0]), SPREAD_NOTED / 3, "spread")


def _depth_of(plan: ScanPlan, z: int, spread: NDArray[np.float64]) -> tuple[float, bool]:
    """Return the depth (µm) at which the light spreads as measured, and whether the spread depends on depth.

    The depth is on the plan's side of the focus. Near the focus, the spread does not depend on depth, and the planned
    depth is returned.
    """
    camera, planned = plan.camera, plan.depths_um[z]
    if not camera.has_lattice or rms_radius_px(camera, planned) < camera.pitch_px:
        return planned, False
    share = np.linspace(0.0, 4.0, 201)
    radii = np.array([rms_radius_px(camera, planned * s) for s in share])
    # it grows with the distance from focus
    start = int(np.argmin(radii))
    return planned * float(np.interp(float(np.median(spread)), radii[start:], share[start:])), True


def _correlation(a: NDArray[Any], b: NDArray[Any]) -> float:
    rows, columns = (min(a.shape[k], b.shape[k]) for k in range(2))
    with np.errstate(invalid="ignore", divide="ignore"):  # a cutout without any light has no correlation
        return float(np.corrcoef(a[:rows, :columns].ravel(), b[:rows, :columns].ravel())[0, 1])


def check_depth(fit: DepthFit, plan: ScanPlan) -> tuple[str, ...]:
    """Return remarks on the movement in depth; raise `InputError` if it differs too much from the plan.

    The tolerance is `GROWTH_OFF` or `SPREAD_OFF`, depending on the quantity that was measured, plus three standard
    deviations. If the movement could not be measured, a remark says so.
    """
    if math.isnan(fit.scale):
        return (f"depth axis not checked: {fit.by}",)
    off, axis = abs(fit.scale - 1), plan.stage.away[1]
    way = abs(plan.depths_um[-1] - plan.depths_um[0])
    by = "the growth of the image's movement" if fit.by == "growth" else "the growth of the pattern"
    what = f"depth axis {axis} of the stage"
    if off > (GROWTH_OFF if fit.by == "growth" else SPREAD_OFF) + 3 * fit.error:
        got = f"{fit.scale:.3f} times that, inferred from {by}"
        remedy = (
            f"correct the scale of axis {axis}, or the camera's working distance, or record without this check "
            "(--no-check-stage)"
        )
        if abs(fit.scale) < STILL + 3 * fit.error:
            got, remedy = "the image of one plane in both", f"axis {axis} does not move: check its drive"
        elif fit.scale < 0:
            remedy = "the axis is reversed: set the opposite sense in the plan"
        raise InputError.expected(what, f"a move of {way:g} µm from the first to the last plane", got, remedy)
    edges = [half_extent_px(plan.camera, plan.depths_um[z]) for z in (0, -1)]
    moved = max(abs(edges[1] - edges[0]), 1e-9)
    notes = () if fit.by == "growth" else (f"sense of the {what} not checked: the camera is telecentric",)
    if off <= (max(CELL_PX / moved, 3 * fit.error) if fit.by == "growth" else SPREAD_NOTED):
        return notes
    how = f"{fit.scale:.3f} ± {fit.error:.3f} times as far as planned, inferred from {by}"
    return (*notes, f"{what} moves {how}: check its scale")
