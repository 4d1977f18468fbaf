"""From a scan and a target to a plan; and what a plan shows when the target lies otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfcal.base import Clock, InputError, Work, check_number, drained, format_length, format_share
from lfcal.camera import ScanPlan
from lfcal.targets._covering import FINEST_PX, iter_cover
from lfcal.targets._pitches import proposed_target
from lfcal.targets._tails import Tails, simulated_tails
from lfcal.targets.images import HoleImages, hole_images
from lfcal.targets.phases import Phases
from lfcal.targets.plan import TargetPlan
from lfcal.targets.pose import Pose
from lfcal.targets.target import Target

__all__ = ["Wishes", "iter_plan_target", "plan_target", "poses_within", "propose_target", "shown_within"]


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a plan must keep.

    Attributes
    ----------
    tolerance_px
        How far off the phase of an image may be to show a position, in rows and in columns (pixels).
    crosstalk
        Most light of neighbours in a cutout, over that of its own point.
    most_frames
        No more frames than this for a plane; None: as many as all phases need.
    level
        How tails are computed: ``"auto"`` (waves) or ``"geometric"``.

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
        check_number("crosstalk allowed", self.crosstalk, at_least=1e-6, below=1)


def propose_target(scan: ScanPlan, wishes: Wishes | None = None, *, hole_um: float = 0.0) -> Target:
    """Return the array of holes that shows all phases of the middle plane with the fewest frames.

    Holes are as close to each other as crosstalk allows, in all planes.

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
    # a pitch is more or fewer pixels in another plane
    least = max(
        simulated_tails(scan, z, level=wishes.level).least_pitch(wishes.crosstalk) * steps[z] / steps[middle]
        for z in planes
    )
    return proposed_target(scan, middle, least, wishes.tolerance_px, hole_um=hole_um)[0]


def iter_plan_target(scan: ScanPlan, target: Target, wishes: Wishes | None = None) -> Work[TargetPlan]:
    """Plan where ``target`` is put so that its holes show all phases of ``scan`` with few frames.

    Every plane is planned for itself: its magnification is another one. The pose is taken as it is stated; see
    `shown_within` for one that is not known so well.

    Raises
    ------
    InputError
        If no hole's cutout is on the sensor, or holes are too close together.

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
            raise InputError.expected("target", wanted, "none", "move it, or choose another pose")
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
    """Return what says in which plane crosstalk is worst, and how far apart holes keep the limit in all planes."""
    worst = int(np.argmax(crosstalk))
    # of a posed target images are closer in one place than in another
    wider = max(light.least_pitch(limit) / _nearest_px(holes) for light, holes in zip(tails, images, strict=True))
    return InputError.expected(
        f"crosstalk of holes {format_length(target.nearest_um)} apart in the plane at "
        f"{format_length(scan.depths_um[worst])}",
        f"at most {format_share(limit)}",
        format_share(crosstalk[worst]),
        f"take holes {format_length(wider * target.nearest_um)} apart, or allow more",
    )


def _nearest_px(images: HoleImages) -> float:
    """Return how close the closest two images are (pixels), infinite where there is one."""
    if len(images) < 2:
        return math.inf
    distances = np.asarray(cKDTree(images.pixels).query(images.pixels, 2)[0])
    return float(distances[:, 1].min())


def poses_within(target: Target, count: int, seed: int = 0) -> Iterator[Pose]:
    """Iterate over poses drawn evenly from the bounds of the target's pose."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield target.pose.off_by(target.within, rng.uniform(-1.0, 1.0, 6))


def shown_within(plan: TargetPlan, z: int, *, count: int = 8, seed: int = 0) -> NDArray[np.float64]:
    """Return what share of the positions the plan shows for each of some poses within the target's bounds ``(count,)``.

    Offsets are as planned, the pose is not: with bounds beyond the tolerance at the target's rim its holes lie on
    phases that nobody chose. A frame that is recorded first and measured tells the pose, and the plan of that pose
    covers all.
    """
    poses = poses_within(plan.target, count, seed)
    return np.array([plan.coverage(z, target=replace(plan.target, pose=pose)) for pose in poses])
