"""Planning of a target's frames: pitch, smallest spacing of holes, offsets, and coverage with other poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfcal.base import Clock, InputError, Work, check_number, drained, format_length, format_pixels, format_share
from lfcal.camera import ScanPlan
from lfcal.simulate import PlaneResponse, plan_effects
from lfcal.simulate.accuracy import steps_for
from lfcal.simulate.effects import Effect, IrisDiffraction, LensletDiffraction
from lfcal.simulate.engines import EnergyError
from lfcal.targets.images import HoleImages, hole_images
from lfcal.targets.offsets import FINEST_PX, iter_cover, line_offsets
from lfcal.targets.phases import Phases
from lfcal.targets.plan import TargetPlan
from lfcal.targets.pose import Pose
from lfcal.targets.target import Target

__all__ = [
    "Tails",
    "Wishes",
    "iter_plan_target",
    "plan_target",
    "poses_within",
    "propose_target",
    "shown_within",
    "simulated_tails",
]

WIDEST = 2.5
"""Largest examined pitch, relative to the smallest; wider ones put too few holes on the sensor."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposed pitch of the holes along one axis.

    Attributes
    ----------
    pitch_px
        Distance between neighbouring images (pixels): a whole number of the array's periods plus ``step`` pixels.
    step
        Difference between the phases of neighbouring holes (pixels).
    holes
        Number of holes along the axis that fit on the sensor with complete cutouts at every offset within a period.
    frames
        Number of offsets along this axis with which the holes show all its phases.
    """

    pitch_px: float
    step: int
    holes: int
    frames: int


def proposed_axis(phases: Phases, axis: int, least_px: float, tolerance_px: float) -> Proposal:
    """Propose the pitch along ``axis`` that needs the fewest frames; among equals, the one with the most holes.

    Holes that are p pixels apart, p an integer, show the phases 0, p, 2p … modulo the period. They show all phases if p
    and the period have no common divisor. The array's period is not an integer, so each cycle leaves a residual. The
    pitch is therefore a whole number of periods plus a few whole pixels (a vernier). Neighbouring holes show equally
    spaced phases, and a target covers the period at most once. ``axis`` is 0 for rows or 1 for columns; the other
    arguments are as in `proposed_target`.
    """
    plan, length, count = phases.plan, float(phases.period[axis]), phases.plan.period[axis]
    # offsets extend half a period in either direction, plus a pixel for rounding
    room = plan.camera.sensor.shape[axis] - plan.cutout[axis] - length - 1
    best: Proposal | None = None
    for pitch, step in _pitches(length, least_px):
        holes = 1 + max(0, math.floor(room / pitch))
        fewest = math.ceil(count / holes)
        if best is not None and (fewest, -holes) > (best.frames, -best.holes):
            continue
        at = np.mod((np.arange(holes) - (holes - 1) / 2) * pitch, length)
        offsets, whole = line_offsets(at, count, length, tolerance_px)
        if whole and (best is None or (len(offsets), -holes) < (best.frames, -best.holes)):
            best = Proposal(pitch, step, holes, len(offsets))
    assert best is not None  # one hole can show every phase, with one offset each
    return best


def _pitches(length: float, least_px: float) -> list[tuple[float, int]]:
    """Return pitches of whole periods plus whole pixels, and these pixels, from the smallest pitch upwards (pixels)."""
    steps = range(-math.floor(length / 2), math.floor(length / 2) + 1)
    turns = range(math.floor(least_px / length), math.ceil(WIDEST * max(least_px, length) / length) + 1)
    found = [(turn * length + step, step) for turn in turns for step in steps]
    return sorted(pair for pair in found if pair[0] >= least_px and pair[1])


def proposed_target(
    plan: ScanPlan, z: int, least_px: float, tolerance_px: float, *, hole_um: float = 0.0
) -> tuple[Target, tuple[Proposal, Proposal]]:
    """Return the array of holes, parallel to the sensor, that shows all phases of plane ``z`` with the fewest frames.

    The pitches of its rows and columns may differ. The period of a hexagonal lenslet array is wider than high by an
    irrational factor, so no single pitch suits both. The second result contains the `Proposal` for the rows and that
    for the columns.

    Parameters
    ----------
    plan, z
        The scan, and the index of the plane, which determines the magnification and the pitch of the images.
    least_px
        Smallest distance between images (pixels).
    tolerance_px
        Largest deviation of a phase (pixels).
    hole_um
        Diameter of the holes (µm); 0: points.

    Raises
    ------
    InputError
        If the sensor is too small for two cutouts.
    """
    phases = Phases.of(plan)
    rows, columns = (proposed_axis(phases, axis, least_px, tolerance_px) for axis in (0, 1))
    if rows.holes * columns.holes < 2:
        room = f"a sensor with room for two cutouts {least_px:g} px apart"
        raise InputError.expected(
            "target", room, f"one of {format_pixels(plan.camera.sensor.shape)}", "record a single point instead"
        )
    step = plan.camera.step_um(plan.depths_um[z])
    pitch = (rows.pitch_px * step, columns.pitch_px * step)
    return Target("square", (rows.holes, columns.holes), pitch, hole_um), (rows, columns)


PHASES = 3
"""Number of phases per axis for averaging patterns, because neighbours may have any phase."""

TOLERANCE = 0.1
"""Relative L1 error by which effects are chosen; diffraction, which causes the tails, is always included."""

WITHOUT_GRID = 0.003
"""Relative L1 error if the scene does not fit on a grid: windows about lenslets must be wide to contain tails."""

WINDOWS = (4.0, 3.0, 2.5, 2.0, 1.5)
"""Widths of the window in cutouts; the first that fits on a grid is used, and light outside is neglected."""

KEPT = 32
"""Number of results for tails kept in memory, so that proposal and plan share them."""


@dataclass(frozen=True, eq=False)
class Tails:
    """The light of a point over a wide area about its chief ray, averaged over phases.

    Attributes
    ----------
    light
        Mean pattern ``(rows, columns)`` with odd sides, normalised to a sum of 1 in its cutout. The window is four
        cutouts wide, or the widest that fits on the grid of a wave computation (`WINDOWS`).
    cutout
        Rows and columns ``(nt, ns)`` of a cutout.
    level
        How the pattern was computed: ``"geometric"`` or by waves.
    """

    light: NDArray[np.float64]
    cutout: tuple[int, int]
    level: str

    def share(self, away_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the light ``(n,)`` that points displaced by ``away_px`` ``(n, 2)`` contribute to a cutout.

        It is relative to the light of the cutout's own point.
        """
        sums = np.pad(self.light.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        shape = np.array(self.light.shape)
        half = (np.array(self.cutout) - 1) // 2
        middle = (shape - 1) // 2 - np.rint(away_px).astype(np.intp)
        (top, left), (bottom, right) = (np.clip(middle + d, 0, shape).T for d in (-half, half + 1))
        shares: NDArray[np.float64] = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
        return np.maximum(shares, 0.0)

    def grid(self, pitch_px: tuple[float, float]) -> float:
        """Return the crosstalk in a rectangular grid of equally bright points, ``pitch_px`` (rows, columns) apart.

        Points outside the window of `light` are ignored.
        """
        reach = [int(n // p) + 1 for n, p in zip(self.light.shape, pitch_px, strict=True)]
        index = np.mgrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1].reshape(2, -1).T
        others = index[(index != 0).any(axis=1)]
        return float(self.share(others * np.array(pitch_px)).sum())

    def among(self, images: HoleImages) -> float:
        """Return the largest crosstalk in any cutout of ``images``, for equally bright holes."""
        if len(images) < 2:
            return 0.0
        # distant holes do not matter, and tables of all pairs of thousands would be large
        sums = np.zeros(len(images))
        near = np.array(self.light.shape)
        for k, place in enumerate(images.pixels):
            away = images.pixels - place
            close = (np.abs(away) < near).all(axis=1)
            close[k] = False
            sums[k] = self.share(away[close]).sum()
        return float(sums.max())

    def least_pitch(self, crosstalk: float) -> int:
        """Return the smallest pitch (pixels) of a square grid whose crosstalk is at most ``crosstalk``.

        Raises
        ------
        InputError
            If there is no such pitch below twice the longer side of the cutout.
        """
        first, last = (max(self.cutout) - 1) // 2, 2 * max(self.cutout)
        for pitch in range(first, last):
            if self.grid((pitch, pitch)) <= crosstalk:
                return pitch
        raise InputError.expected(
            "crosstalk",
            "a limit that can be met with points at most two cutouts apart",
            crosstalk,
            "allow more crosstalk",
        )


@lru_cache(maxsize=KEPT)
def simulated_tails(plan: ScanPlan, z: int, *, level: str = "auto") -> Tails:
    """Return the tails of plane ``z``: the mean over phases of simulated patterns of the plan's camera.

    If possible, waves are computed on one grid for the whole array, because windows around single lenslets would cut
    the tails off. An error tolerance would not reveal this: tails contain less than a percent of a pattern's light.

    Parameters
    ----------
    plan, z
        The scan and the index of the plane.
    level
        ``"geometric"``: rays, whose patterns have no tails; ``"auto"``: waves, with the diffraction of lenslets and
        iris.

    Raises
    ------
    InputError
        If there is no light in the cutout.
    """
    on = dict.fromkeys((LensletDiffraction.name, IrisDiffraction.name), "on")
    effects = plan_effects(plan, TOLERANCE, on).effects
    response = _response(plan, z, effects, WINDOWS[0], level=level, tolerance=TOLERANCE)
    light = None
    if response.level == "wave" and (light := _light_by_grid(plan, z, effects)) is None:
        response = _response(plan, z, effects, WINDOWS[0], level=level, tolerance=WITHOUT_GRID)
    if light is None:
        light = _light(response)
    bare = Tails(light, plan.cutout, response.level)
    own = float(bare.share(np.zeros((1, 2)))[0])
    if not own > 0:
        raise InputError.expected(
            "simulated light", "some light in the cutout", "none", "check the cutout and the depths"
        )
    light /= own
    light.setflags(write=False)  # cached for later calls
    return Tails(light, plan.cutout, response.level)


def _response(plan: ScanPlan, z: int, effects: Sequence[Effect], window: float, **how: Any) -> PlaneResponse:
    """Return the response of a plane in a window of the given width in cutouts."""
    rows, columns = (2 * int(window * n / 2) + 1 for n in plan.cutout)
    return PlaneResponse(plan, z, effects, cutout=(rows, columns), on_sensor=True, **how)


def _light(response: PlaneResponse) -> NDArray[np.float64]:
    """Return the mean pattern over phases."""
    ys, xs = (np.unique(np.linspace(0, n - 1, PHASES + 1).astype(np.intp)[:-1]) for n in response.scene.period)
    mean: NDArray[np.float64] = response.rows(ys, xs).mean(axis=(0, 1), dtype=np.float64)
    return mean


def _light_by_grid(plan: ScanPlan, z: int, effects: Sequence[Effect]) -> NDArray[np.float64] | None:
    """Return the mean pattern by waves on the finest grid, in the widest window that fits on one; None if none fits.

    A grid of 4 samples per pixel, which is sufficient for spots, loses a fifth of the light in the far tails.
    """
    for window in WINDOWS:
        steps = steps_for(_response(plan, z, effects, window).scene, "wave")
        if steps[-1].level == "grid":
            try:
                return _light(_response(plan, z, effects, window, level="grid", sampling=steps[-1].sampling))
            except EnergyError:  # too coarse for its window: a finer grid allows only a smaller window
                continue
    return None


@dataclass(frozen=True, slots=True)
class Wishes:
    """Limits for the plan of a target.

    Attributes
    ----------
    tolerance_px
        Largest difference between the phase of an image and that of a position that it shows, in rows and in columns
        (px).
    crosstalk
        Largest light from neighbouring points in a cutout, as a fraction of the light from the point at its centre.
    most_frames
        Largest number of frames for each plane. None: as many as all phases require.
    level
        Method with which the crosstalk is computed: ``"auto"`` (wave optics) or ``"geometric"`` (rays).

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Wishes, parse_target, plan_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> wishes = Wishes(tolerance_px=0.25, crosstalk=0.01, most_frames=10, level="geometric")
    >>> plan = plan_target(scan, parse_target("array:3x3@2mm"), wishes)
    >>> print(f"{len(plan.frames)} frames show {plan.coverage(0):.0%} of the positions")
    10 frames show 14% of the positions
    """

    tolerance_px: float = 0.1
    crosstalk: float = 0.005
    most_frames: int | None = None
    level: str = "auto"

    def __post_init__(self) -> None:
        """Check every value."""
        check_number("tolerance of a phase (px)", self.tolerance_px, at_least=FINEST_PX, at_most=0.5)
        check_number("allowed crosstalk", self.crosstalk, at_least=1e-6, below=1)


def propose_target(scan: ScanPlan, wishes: Wishes | None = None, *, hole_um: float = 0.0) -> Target:
    """Return the array of holes, of diameter ``hole_um`` (µm), that shows all phases of ``scan`` in the fewest frames.

    The number of frames is that of the middle plane. The holes are so far apart that the crosstalk is within the limit
    in ``wishes`` (None: the defaults) in all planes.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Wishes, propose_target
    >>> scan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[20.0])  # 15 x 15 positions
    >>> target = propose_target(scan, Wishes(level="geometric"))
    >>> print(target.shape, "holes,", [round(um / scan.camera.step_um(20.0)) for um in target.pitch_um], "px apart")
    (24, 29) holes, [86, 86] px apart
    """
    wishes = wishes or Wishes()
    planes = range(len(scan.depths_um))
    middle = len(planes) // 2
    steps = [scan.camera.step_um(depth) for depth in scan.depths_um]
    # the pitch in pixels depends on the plane
    least = max(
        simulated_tails(scan, z, level=wishes.level).least_pitch(wishes.crosstalk) * steps[z] / steps[middle]
        for z in planes
    )
    return proposed_target(scan, middle, least, wishes.tolerance_px, hole_um=hole_um)[0]


def iter_plan_target(scan: ScanPlan, target: Target, wishes: Wishes | None = None) -> Work[TargetPlan]:
    """Return a plan of positions of ``target`` in which few frames show as many phases of ``scan`` as possible.

    Each plane is planned separately, because its magnification differs. The stated pose is assumed to be exact; for an
    uncertain pose, see `shown_within`. ``wishes`` are the limits for the plan (None: the defaults), among them the
    number of frames. `TargetPlan.coverage` returns the fraction of positions shown.

    Raises
    ------
    InputError
        If the cutout of no hole is completely on the sensor, or the crosstalk between holes exceeds its limit.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Wishes, iter_plan_target, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> wishes = Wishes(tolerance_px=0.25, most_frames=3, level="geometric")
    >>> for step in iter_plan_target(scan, parse_target("array:3x3@2mm"), wishes):
    ...     print(step.stage, step.count)
    light of neighbouring holes 0 of 1
    offsets of the target 0 of 627
    offsets of the target 9 of 627
    offsets of the target 18 of 627
    offsets of the target 27 of 627
    """
    wishes, phases = wishes or Wishes(), Phases.of(scan)
    images, tails, offsets = [], [], []
    clock = Clock("light of neighbouring holes", len(scan.depths_um))
    for z, depth in enumerate(scan.depths_um):
        yield clock.at(z)
        images.append(hole_images(target, scan.camera, depth))
        if not images[z].whole(scan.camera.sensor.shape, scan.cutout).any():
            wanted = f"a hole whose cutout of {scan.cutout[0]} x {scan.cutout[1]} px is on the sensor"
            raise InputError.expected("target", wanted, "none", "move the target, or choose another pose")
        tails.append(simulated_tails(scan, z, level=wishes.level))
    crosstalk = tuple(light.among(holes) for light, holes in zip(tails, images, strict=True))
    if max(crosstalk) > wishes.crosstalk:
        raise _too_close(scan, target, tails, images, crosstalk, wishes.crosstalk)
    for holes in images:
        found = yield from iter_cover(phases, holes, wishes.tolerance_px, most=wishes.most_frames)
        offsets.append(tuple((float(row), float(column)) for row, column in found.offsets_px))
    return TargetPlan(scan, target, tuple(offsets), wishes.tolerance_px, crosstalk, tails[-1].level)


plan_target = drained(
    iter_plan_target,
    """
    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Target, Wishes, plan_target
    >>> scan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=[20.0])  # 15 x 15 positions
    >>> pitch = (7 * 15 + 1) * scan.camera.step_um(20.0)  # every hole a pixel farther in the period than the last one
    >>> plan = plan_target(scan, Target("square", (15, 15), (pitch, pitch)), Wishes(level="geometric"))
    >>> print(f"{len(plan.frames)} frame shows {plan.coverage(0):.0%} of the positions")
    1 frame shows 100% of the positions
    """,
)


def _too_close(
    scan: ScanPlan,
    target: Target,
    tails: Sequence[Tails],
    images: Sequence[HoleImages],
    crosstalk: Sequence[float],
    limit: float,
) -> InputError:
    """Return the error that states the largest crosstalk, and a pitch that meets the limit in all planes."""
    worst = int(np.argmax(crosstalk))
    # the spacing of images of a tilted target varies over the field
    wider = max(light.least_pitch(limit) / _nearest_px(holes) for light, holes in zip(tails, images, strict=True))
    return InputError.expected(
        f"crosstalk of holes {format_length(target.nearest_um)} apart in the plane at "
        f"{format_length(scan.depths_um[worst])}",
        f"at most {format_share(limit)}",
        format_share(crosstalk[worst]),
        f"choose holes {format_length(wider * target.nearest_um)} apart, or allow more crosstalk",
    )


def _nearest_px(images: HoleImages) -> float:
    """Return the smallest distance between two images (pixels); infinite for a single image."""
    if len(images) < 2:
        return math.inf
    distances = np.asarray(cKDTree(images.pixels).query(images.pixels, 2)[0])
    return float(distances[:, 1].min())


def poses_within(target: Target, count: int, seed: int = 0) -> Iterator[Pose]:
    """Iterate over ``count`` random poses, uniformly distributed around `Target.pose` within `Target.within`."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield target.pose.off_by(target.within, rng.uniform(-1.0, 1.0, 6))


def shown_within(plan: TargetPlan, z: int, *, count: int = 8, seed: int = 0) -> NDArray[np.float64]:
    """Return the fraction of positions of plane ``z`` shown for each of ``count`` random poses, as in `poses_within`.

    If an error of the pose displaces holes by more than the tolerance, they show other phases than planned. To show all
    phases, determine the pose from a first recorded frame, and make a plan for that pose.
    """
    poses = poses_within(plan.target, count, seed)
    return np.array([plan.coverage(z, target=replace(plan.target, pose=pose)) for pose in poses])
