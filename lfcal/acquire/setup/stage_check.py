"""Check the stage before a session: sign, scale, angle, repeatability, and movement in depth.

A fault of the stage affects every frame, and cannot be seen in a single one. Properties that cannot be measured are
noted.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._looking import Looker
from lfcal.acquire.control import Control
from lfcal.acquire.frame_plan import FramePlan
from lfcal.acquire.lighting import Lighting
from lfcal.acquire.options import Options
from lfcal.acquire.session_file import optics_of
from lfcal.acquire.setup.stage_fit import (
    CELL_PX,
    PHASE,
    DepthFit,
    DepthLook,
    StageFit,
    check_axes,
    check_depth,
    check_stage,
    depth_fit,
    fit_stage,
    phase_drift,
    places_about,
    room,
)
from lfcal.acquire.spots import Spot, find_spot
from lfcal.base import Clock, InputError, Work
from lfcal.camera import ScanPlan
from lfcal.devices import CameraError, CheckedStage, DeviceLost, LimitError, Point, Rig, StageError, WrongFrame

__all__ = ["STAGE", "StageCheck", "iter_stage_check"]

R = TypeVar("R")

STAGE = "stage check"
"""Label of the check's progress; its last note contains the notes of `StageCheck`."""
STILL, VISITS = 3, 5
"""Exposures without a move, and visits of the middle of the cell: they show the scatter without and with moves."""
REPEAT_PX = 0.25
"""Largest RMS distance of the image of one place from its mean, along an axis (pixels)."""
FLOOR_PX = 0.05
"""Smallest assumed error of a centroid (pixels)."""
ROUGH = 0.1
"""Relative scale error that is detected even if the lenslets' pattern does not cancel between the places."""
AWAY_PX, NEAR, TRIES = 0.3, 0.2, 3
"""Displacement above which images are taken again (pixels), largest scale error for this, and number of repetitions."""
FOCUSED_SIGMAS = 20.0


@dataclass(frozen=True, slots=True)
class StageCheck:
    """Result of checking the stage with a few moves.

    Attributes
    ----------
    fits
        Fits of the image's motion in the first plane and, if there are several planes, in the last.
    repeat_px
        RMS deviation of the image, per axis, from its mean position over several visits to one stage position (px).
        NaN: not measured.
    depth
        Measured movement in depth compared with the plan. None: not measured.
    notes
        Omitted checks and remarks, one sentence each.
    frames
        Number of frames taken.
    """

    fits: tuple[StageFit, ...] = ()
    repeat_px: float = math.nan
    depth: DepthFit | None = None
    notes: tuple[str, ...] = ()
    frames: int = 0

    @property
    def words(self) -> str:
        """One-line result, as it is stored in ``session.json``."""
        if not self.fits:
            return "; ".join(self.notes) or "stage not checked: check_stage is off"
        right, down = self.fits[0].scale
        said = [f"checked: scale right {right:.4f}, down {down:.4f}, repeatability {self.repeat_px:.2f} px rms"]
        if self.depth is not None:
            said.append(f"depth scale {self.depth.scale:.3f} ± {self.depth.error:.3f}")
        return "; ".join((*said, *self.notes))


def _left_out(why: str) -> StageCheck:
    return StageCheck(notes=(f"stage not checked: {why}",))


def iter_stage_check(
    rig: Rig, plan: ScanPlan | FramePlan, options: Options | None = None, control: Control | None = None
) -> Work[StageCheck]:
    """Check the stage at five positions in the first and the last plane, and visit the middle one several times.

    Nothing is recorded, and the stage returns to its previous position. Checks that are not possible are listed in
    `StageCheck.notes`: for a target, and if the travel is too short or another program moves the stage. There is no
    check if `Options.check_stage` is off.

    Parameters
    ----------
    rig, plan, options, control
        As in `lfcal.acquire.iter_record`.

    Raises
    ------
    InputError
        If there is no light, or the stage does not move the image as planned. Axes may be reversed or swapped, or a
        scale error may move the source by more than 0.25 px over a period. The repeatability at one position may be
        worse than 0.25 px (rms). The movement in depth may differ from the plan.
    DeviceError
        If a device fails more often than `Options.retries` allows.
    Cancelled
        If a stop was requested through the control.

    Examples
    --------
    >>> from lfcal.acquire.setup import StageCheck, iter_stage_check
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[2.0, 4.0])
    >>> found: StageCheck = drain(iter_stage_check(simulated_rig(plan), plan))
    >>> print(found.frames, "frames:", [round(scale, 2) for scale in found.fits[0].scale], found.notes)
    16 frames: [1.0, 1.0] ()
    """
    options, control = options or Options(), control or Control()
    if not options.check_stage:  # omitted by the user, so no note is needed
        return StageCheck()
    found = None
    if not isinstance(plan, ScanPlan):
        found = _left_out("sign and scale can be measured only with a single point, not with a target")
    elif CheckedStage.of(rig.stage).moved_elsewhere:
        found = _left_out("another program moves it")
    else:
        travel = rig.stage.limits, options.motion(plan).overshoot_um
        try:
            planes = [places_about(plan, z, *travel) for z in sorted({0, len(plan.depths_um) - 1})]
        except InputError as error:
            found = _left_out(str(error))
    if found is None:
        assert isinstance(plan, ScanPlan)
        found = yield from _measured(rig, plan, options, control, planes)
    clock = Clock(STAGE, found.frames)
    yield clock.at(found.frames, "; ".join(found.notes))
    return found


class _Looks(NamedTuple):
    """Measurements in one plane: read-back (µm), centroid (row, column) and spread (pixels) at each position.

    ``visits`` contains all centroids at the middle of the cell, ``still`` the centroids there without a move, and
    ``frame`` the cutout there.
    """

    stage: NDArray[np.float64]
    places: NDArray[np.float64]
    spread: NDArray[np.float64]
    visits: NDArray[np.float64]
    still: NDArray[np.float64]
    frame: NDArray[Any]


def _measured(
    rig: Rig, plan: ScanPlan, options: Options, control: Control, planes: list[NDArray[np.float64]]
) -> Work[StageCheck]:
    last = len(plan.depths_um) - 1
    Lighting(rig, control, options.light_settle_s).switch(True)
    clock = Clock(STAGE, VISITS + 4 + (len(planes) - 1) * 5)
    looks: list[_Looks] = []
    notes: list[str] = []
    with Looker(rig, plan, options, control, targets=np.vstack(planes), bracket=(1.0,)) as looker:
        watch = _Watch(looker, plan, options, control)
        for places, z in zip(planes, (0, last), strict=False):
            watch.turn(z, VISITS if not looks else 1)
            try:
                looks.append((yield from watch.looks(places, clock)))
            except _NoSpot as error:
                if not looks and _has_room(plan) and not watch.focused(places):
                    raise InputError(f"stage: {error}") from error
                notes.append(f"{'stage' if not looks else 'depth axis'} not checked: {error}")
                break
        for k, look in enumerate(looks):
            watch.turn(z := (0, last)[k], 1)
            looks[k] = yield from _centred(watch, plan, z, planes[k], look, clock)
    if not looks:
        return StageCheck(notes=tuple(notes), frames=watch.frames)
    return _judged(plan, looks, optics_of(rig), notes, watch.frames)


def _centred(
    watch: _Watch, plan: ScanPlan, z: int, places: NDArray[np.float64], look: _Looks, clock: Clock
) -> Work[_Looks]:
    """Return measurements at positions where the image is at its planned position in spite of a scale error.

    At fractions of a period, the centroid of a pattern does not move like the source: a depth scale of 1.1 was measured
    as 1.06.
    """
    step, objects = plan.camera.step_um(plan.depths_um[z]), plan.stage.to_object(places)
    planned = (objects[:, :2] - objects[0, :2]) / step
    for _ in range(TRIES):
        away = np.abs((look.places - look.places[0])[:, ::-1] - planned).max()
        matrix = np.array(fit_stage(plan, z, look.stage, look.places).matrix)
        if away < AWAY_PX or np.abs(matrix - np.eye(2)).max() > NEAR:
            break
        objects[:, :2] = objects[0, :2] + step * planned @ np.linalg.inv(matrix).T
        try:
            again = yield from watch.looks(plan.stage.to_stage(objects), clock)
        except LimitError:
            break
        look = look._replace(stage=again.stage, places=again.places)
    return look


class _NoSpot(InputError):
    """No light is significant."""


class _Watch:
    """Frames that are taken at positions one after the other, and again after a temporary fault."""

    def __init__(self, looker: Looker, plan: ScanPlan, options: Options, control: Control) -> None:
        self._looker, self._plan, self._options, self._control = looker, plan, options, control
        self._z, self._visits = 0, 1
        self.frames = 0

    def turn(self, z: int, visits: int) -> None:
        """Select plane ``z``, with ``visits`` visits at the middle of the cell."""
        self._z, self._visits = z, visits

    def looks(self, places: NDArray[np.float64], clock: Clock) -> Work[_Looks]:
        """Return the measurements at ``places`` ``(5, 3)``, returning to the first place if it has several visits."""
        order = [0] + [k for corner in range(1, 5) for k in ((corner, 0) if self._visits > 1 else (corner,))]
        stage, still = np.zeros((5, 3)), np.zeros((0, 2))
        seen: list[list[Spot]] = [[] for _ in places]
        for count, k in enumerate(order):
            yield clock.at(min(clock.total - 1, (self._z > 0) * (VISITS + 4) + count))
            stage[k] = self._go(places[k])
            frame = self._expose()
            spot = _spot(frame)
            if count == 0:
                middle = self._cutout(frame)
                if self._visits > 1:
                    still = _centroids([spot, *(_spot(self._expose()) for _ in range(STILL - 1))])
            seen[k].append(spot)
        means = np.array([_centroids(spots).mean(axis=0) for spots in seen])
        spread = np.array([np.mean([spot.radius for spot in spots]) for spots in seen])
        return _Looks(stage, means, spread, _centroids(seen[0]), still, middle)

    def focused(self, places: NDArray[np.float64]) -> bool:
        """Return whether light in single pixels moves with the stage, as for a source in focus."""
        lit = []
        for place in places[:2]:
            self._go(place)
            lit.append(_single_pixels(self._expose()))
        return lit[0] != lit[1]

    def _go(self, place: NDArray[np.float64]) -> Point:
        if self._control.stopping:
            raise self._control.aborted()
        x, y, z = place.tolist()
        return self._again(lambda: self._looker.go((x, y, z)))

    def _expose(self) -> NDArray[Any]:
        self.frames += 1
        seconds = self._plan.exposures[self._z]
        return self._again(lambda: self._looker.expose(seconds))

    def _again(self, take: Callable[[], R]) -> R:
        """Return the result of ``take``, after at most the allowed number of device faults."""
        for left in range(self._options.retries, -1, -1):
            try:
                return take()
            except (WrongFrame, DeviceLost, LimitError):
                raise
            except (CameraError, StageError):
                if not left:
                    raise
        raise AssertionError

    def _cutout(self, frame: NDArray[Any]) -> NDArray[Any]:
        middle = self._plan.image_px([self._z, *(n // 2 for n in self._plan.period)])
        top, left = (max(0, int(c) - n // 2) for c, n in zip(middle, self._plan.cutout, strict=True))
        return frame[top : top + self._plan.cutout[0], left : left + self._plan.cutout[1]].copy()


def _spot(frame: NDArray[Any]) -> Spot:
    try:
        return find_spot(frame)
    except InputError as error:
        raise _NoSpot(str(error)) from error


def _centroids(spots: list[Spot]) -> NDArray[np.float64]:
    return np.array([(spot.row, spot.column) for spot in spots])


def _scatter(places: NDArray[np.float64]) -> float:
    """Return the standard deviation of ``places`` ``(n, 2)`` per axis (pixels)."""
    return math.sqrt(float(places.var(axis=0, ddof=1).mean()))


def _single_pixels(frame: NDArray[Any]) -> frozenset[int]:
    """Return the pixels far above the noise, by flat index."""
    level = float(np.median(frame))
    noise = max(1.4826 * float(np.median(np.abs(frame - level))), 0.3)
    return frozenset(np.flatnonzero(frame > level + FOCUSED_SIGMAS * noise).tolist())


def _has_room(plan: ScanPlan) -> bool:
    return bool((room(plan).sum(axis=0) > 0).all())


def _check_repeat(repeat: float, still: float, notes: list[str]) -> None:
    """Raise `InputError` if the stage is not repeatable; note if the light is too faint to measure this."""
    if repeat <= REPEAT_PX:
        return
    if repeat <= 3 * still:
        notes.append(
            f"the repeatability of the stage was not checked: the image scatters by {still:.2f} px without a move"
        )
        return
    raise InputError.expected(
        f"image at one position, visited {VISITS} times",
        f"a scatter of at most {REPEAT_PX:g} px rms",
        f"{repeat:.2f} px rms ({still:.2f} px without a move)",
        "the stage is not repeatable: check coupling, load and encoder, or record without this check "
        "(--no-check-stage)",
    )


def _judged(plan: ScanPlan, looks: list[_Looks], optics: str, notes: list[str], frames: int) -> StageCheck:
    """Return the result of the check; raise `InputError` if the stage does not move as planned."""
    still, repeat = _scatter(looks[0].still), _scatter(looks[0].visits)
    _check_repeat(repeat, still, notes)
    planes = (0, len(plan.depths_um) - 1)
    fits = tuple(fit_stage(plan, z, look.stage, look.places) for z, look in zip(planes, looks, strict=False))
    check_axes(fits[0], plan)
    moves = plan.stage.to_object(looks[0].stage)[:, :2] / plan.camera.step_um(plan.depths_um[0])
    # error of the slopes of a fit to four corners
    error = max(FLOOR_PX, still, repeat, *(fit.residual_px for fit in fits)) / np.ptp(moves, axis=0)
    rough, seen = "", ROUGH
    if not _has_room(plan):
        rough = "the sensor has no room to move the cutout by a period"
    elif (np.abs(phase_drift(plan)) > PHASE).any():
        rough = "the plan's period is not the lenslets'"
        # between lenslets, a centroid is wrong by up to half a pitch
        seen = max(ROUGH, plan.camera.pitch_px / 2 / float(np.ptp(moves, axis=0).min()))
    if rough:
        notes.append(f"stage scale checked only to {100 * seen:.0f} %, depth axis not checked: {rough}")
    depth = None
    if len(fits) == 2 and not rough:
        depth = depth_fit(
            plan,
            [DepthLook(fit, look.spread, look.frame) for fit, look in zip(fits, looks, strict=True)],
            error,
            optics,
        )
        notes += check_depth(depth, plan)
    most = max(plan.period)
    for fit in fits:
        check_stage(fit, plan, cell_px=seen * most if rough else max(CELL_PX, 4 * float(error.max()) * most))
    return StageCheck(fits, repeat, depth, tuple(notes), frames)
