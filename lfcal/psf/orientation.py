"""Find the orientation of the frames of a scan by comparing the pattern's path with the path that the plan predicts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work, drained, format_pixels
from lfcal.camera import ScanPlan
from lfcal.frames import AS_IS, ORIENTATIONS, FrameSource
from lfcal.psf._spot_path import SpotPath, iter_spot_path

__all__ = [
    "AS_IS",
    "ORIENTATIONS",
    "FoundOrientation",
    "either_words",
    "find_orientation",
    "iter_find_orientation",
    "orientation_of_path",
]

CERTAIN = 4.0
"""Factor by which the second best orientation must fit worse."""

MOST = 10.0
"""Residuals count at most as this multiple of the best residual; larger ones contain no further evidence."""

KEPT = 0.7
"""Fraction of the frames of a plane that must agree; the others may be dark, wrong or exchanged."""

FLOOR_PX = 0.3
"""Smallest error of a centroid of a pattern of lenslet spots (pixels)."""

FEW = 5
"""Number of frames of a plane below which any orientation would fit, because step and offset are free."""

GAINS = (0.3, 3.0)
"""Ratio of measured to planned motion that is accepted: a step may be wrong, or part of the light not move."""

SCAN = {
    "as is": "",
    "rot90": "x and y of stage or scan are swapped and one is reversed",
    "rot180": "both axes of stage or scan are reversed",
    "rot270": "x and y of stage or scan are swapped and one is reversed",
    "mirror x": "the x axis of stage or scan is reversed",
    "mirror y": "the y axis of stage or scan is reversed",
    "transpose": "x and y of stage or scan are swapped",
    "anti-transpose": "x and y of stage or scan are swapped and both reversed",
}
"""Error of the scan that would make the image move as in frames with each orientation."""


def either_words(name: str) -> str:
    """Return a text with both possible causes of an image motion: frames of orientation ``name``, or the scan axes."""
    return f"the frames are {ORIENTATIONS[name].words}, or {SCAN[name]} relative to the plan"


@dataclass(frozen=True, slots=True)
class FoundOrientation:
    """Orientation of the frames, derived from the path of the pattern.

    Attributes
    ----------
    name
        Orientation of the frames, one of `lfcal.frames.orientation.ORIENTATIONS`; empty if undetermined.
    cause
        ``"frames"``: the frames are flipped or turned. ``"scan"``: the frames are upright, but the axes of the scan
        differ from those of the plan. ``"either"``: the two cannot be distinguished. Empty if the frames are upright or
        nothing can be determined.
    margin
        Ratio of the misfit of the second-best orientation to that of the best, 1 to 10; `CERTAIN` if only the position
        of the path distinguishes them.
    residual_px
        Residual of the path under the best orientation (pixels); NaN if several orientations fit, or if light was found
        in fewer than three frames.
    offset_px
        Displacement (rows, columns) of the pattern from its planned position after turning the frames upright (pixels).
        NaN if `residual_px` is NaN, unless several orientations fit and upright frames fit best.
    frames
        Number of frames in which the pattern was found.
    reason
        Reason why the orientation is undetermined; otherwise empty.
    """

    name: str = ""
    cause: str = ""
    margin: float = 1.0
    residual_px: float = math.nan
    offset_px: tuple[float, float] = (math.nan, math.nan)
    frames: int = 0
    reason: str = ""

    @property
    def wrong(self) -> bool:
        """Whether the frames or the scan certainly differ from the plan."""
        return self.name not in ("", AS_IS)

    @property
    def words(self) -> str:
        """Description of the result, as a clause."""
        if not self.name:
            return f"the orientation of the frames cannot be determined: {self.reason}"
        if not self.wrong or self.cause == "frames":
            return f"the frames are {ORIENTATIONS[self.name].words}"
        return f"{SCAN[self.name]} relative to the plan" if self.cause == "scan" else either_words(self.name)


def iter_find_orientation(source: FrameSource, plan: ScanPlan) -> Work[FoundOrientation]:
    """Return the orientation of the frames of a scan, determined from the path of the pattern.

    About 20 frames are read. The path of the pattern is compared with the planned path in all eight orientations.

    Parameters
    ----------
    source
        Frames in the orientation as delivered, preferably corrected. They show the whole sensor, or parts of it at
        known positions.
    plan
        Scan plan, from which the expected path is computed.
    """
    path = yield from iter_spot_path(source, plan.shape[:3], plan.cutout)
    whole = all(source.info(int(k)).origin == (0, 0) for k in path.indices)
    expected = plan.image_px(path.positions)
    drifts = [source.info(int(k)).drift for k in path.indices]
    expected += np.array([drift or (0.0, 0.0) for drift in drifts]).reshape(-1, 2)
    return orientation_of_path(path, expected, source.shape if whole else plan.camera.sensor.shape, plan)


find_orientation = drained(iter_find_orientation)


def orientation_of_path(
    path: SpotPath, expected: NDArray[np.float64], frame: tuple[int, int], plan: ScanPlan
) -> FoundOrientation:
    """Return the orientation of frames in which the pattern followed ``path``.

    The direction of the motion is compared with that of the plan separately in each plane; step size and offset are
    fitted. The position of the path distinguishes orientations with the same motion. It also distinguishes turned
    frames from upright frames of a scan along other axes.

    Parameters
    ----------
    path
        Observed positions of the pattern.
    expected
        Planned positions of the image in the frames of ``path``, ``(n, 2)`` as (row, column) in sensor pixels.
    frame
        Number of rows and columns of a complete frame as delivered.
    plan
        Scan plan, which states the shape of the upright sensor and of the cutout.
    """
    if len(path.indices) < 3:
        reason = f"light in {len(path.indices)} of {path.looked} frames"
        return FoundOrientation(frames=len(path.indices), reason=reason)
    fits = _fits(path, expected, frame)
    order = sorted(fits, key=lambda name: fits[name].misfit)
    best = fits[order[0]]
    alike = [name for name in order if fits[name].misfit < CERTAIN * best.misfit]
    # neither the origin of a stage nor the position of a path is more accurate than the residual of the path
    slack = max(2.0, 0.1 * max(plan.cutout), 2 * best.residual_px)
    name, reason = order[0], ""
    if len(alike) > 1:
        name, reason = _by_place(alike, fits, slack, frame, plan.camera.sensor.shape)
    if not name:
        place = best.offset_px if order[0] == AS_IS else (math.nan, math.nan)
        margin = fits[order[1]].misfit / best.misfit
        return FoundOrientation(frames=len(path.indices), margin=margin, offset_px=place, reason=reason)
    rivals = [fits[other].misfit for other in order if other not in alike]
    cause, reason = _cause(name, path, expected, fits[name], frame, plan.camera.sensor.shape, slack=slack)
    return FoundOrientation(
        "" if reason else name,
        cause,
        min(rivals, default=math.inf) / best.misfit if len(alike) == 1 else CERTAIN,
        fits[name].residual_px,
        fits[name].offset_px,
        len(path.indices),
        reason,
    )


@dataclass(frozen=True, slots=True)
class _Fit:
    """How an orientation fits: misfit in units of the best, residual and offset of the path (pixels)."""

    misfit: float
    residual_px: float
    offset_px: tuple[float, float]


def _fits(path: SpotPath, expected: NDArray[np.float64], frame: tuple[int, int]) -> dict[str, _Fit]:
    planes = [path.positions[:, 0] == z for z in np.unique(path.positions[:, 0])]
    turned = {name: one.places(path.seen, frame) for name, one in ORIENTATIONS.items()}
    left = {name: [_residual(seen[p], expected[p]) for p in planes] for name, seen in turned.items()}
    # the residual of the best orientation is the accuracy in a plane: a plane whose pattern does not move says nothing
    least = [max(FLOOR_PX, min(values)) for values in zip(*left.values(), strict=True)]
    weights = [int(p.sum()) for p in planes]
    found = {}
    for name, values in left.items():
        worse = [min(value / unit, MOST) ** 2 for value, unit in zip(values, least, strict=True)]
        misfit = math.sqrt(max(1.0, float(np.average(worse, weights=weights))))
        row, column = np.median(turned[name] - expected, axis=0).tolist()
        found[name] = _Fit(misfit, min(values), (row, column))
    return found


def _residual(seen: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Return the rms distance of a path from the expected one, with offset and step free, of the frames that agree.

    The result is `FLOOR_PX` if there are too few frames to decide.
    """
    if len(seen) < FEW:
        return FLOOR_PX
    move, plan = seen - np.median(seen, axis=0), expected - np.median(expected, axis=0)
    keep = np.ones(len(move), bool)
    distance = np.zeros(len(move))
    for _ in range(3):
        a, b = (part - part[keep].mean(axis=0) for part in (move, plan))
        norm = float((b[keep] ** 2).sum())
        gain = float((a[keep] * b[keep]).sum()) / norm if norm > 0 else 1.0
        distance = np.hypot(*(a - np.clip(gain, *GAINS) * b).T)
        keep = distance <= np.quantile(distance, KEPT)
    return float(np.sqrt(np.mean(distance[keep] ** 2)))


def _by_place(
    alike: list[str],
    fits: dict[str, _Fit],
    slack: float,
    frame: tuple[int, int],
    sensor: tuple[int, int],
) -> tuple[str, str]:
    """Return the orientation of ``alike`` whose path is where planned, or ``""``, and why there is none, or ``""``."""
    # frames whose shape fits the sensor are never turned by 90 degrees
    shaped = [one for one in alike if ORIENTATIONS[one].shape(frame) == sensor] or alike
    away = sorted((math.hypot(*fits[name].offset_px), name) for name in shaped)
    near, name = away[0]
    if near < 2 * slack and (len(away) == 1 or away[1][0] > 3 * near + 2 * slack):
        return name, ""
    words = " and ".join(one.replace("as is", "upright frames") for one in sorted(alike)[:3])
    more = f" and {len(alike) - 3} more" if len(alike) > 3 else ""
    return "", f"the pattern's path fits {words}{more} alike"


def _cause(
    name: str,
    path: SpotPath,
    expected: NDArray[np.float64],
    fit: _Fit,
    frame: tuple[int, int],
    sensor: tuple[int, int],
    *,
    slack: float,
) -> tuple[str, str]:
    """Return the cause as in `FoundOrientation`, and the reason why it is undetermined; empty if it is determined."""
    by_frames, by_scan = ORIENTATIONS[name].shape(frame) == sensor, frame == sensor
    turned = f"their shape, {format_pixels(frame)}, is that of frames turned by 90 degrees"
    if name == AS_IS:
        known = by_scan or not _some_turn_fits(frame, sensor)
        return "", "" if known else f"{turned}, but the pattern moves as planned"
    if not by_frames and not by_scan:
        if _some_turn_fits(frame, sensor):
            return "", f"{turned}, but the pattern moves along rows as planned"
        # frames cropped or binned by other programs: positions have no meaning
        return "either", ""
    if by_frames != by_scan:
        return ("frames" if by_frames else "scan"), ""
    if_frames = math.hypot(*fit.offset_px)
    if_scan = math.hypot(*np.median(path.seen - expected, axis=0).tolist())
    if abs(if_frames - if_scan) < max(2 * slack, min(if_frames, if_scan)):
        return "either", ""
    return ("frames" if if_frames < if_scan else "scan"), ""


def _some_turn_fits(frame: tuple[int, int], sensor: tuple[int, int]) -> bool:
    return any(one.shape(frame) == sensor for one in ORIENTATIONS.values())
