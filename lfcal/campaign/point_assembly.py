"""Assemble H from those points in frames of a target that match positions of the scan.

Each such point becomes a frame at its position. Results about the target are stored in the provenance of H, for the
quality metrics.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfcal.base import InputError, Region, Work, plain
from lfcal.campaign.points import Points, iter_points_of
from lfcal.frames import FrameInfo, FrameMetadata, FrameSource, Position, Samples, SourceView
from lfcal.psf import AssemblyReport, AssemblySettings, iter_assemble_plan
from lfcal.targets import Phases, TargetPlan, may_resample

__all__ = ["PointFrames", "iter_assemble_points", "shown_positions", "target_facts"]


def shown_positions(
    points: Points, tolerance_px: float | None = None, *, resampled: bool = False
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the plan position (z, y, x) that each point matches, ``(n, 3)`` (-1: none), and its deviation.

    The deviation (row, column) has the shape ``(n, 2)`` (px). Along each axis, it is that of the phase or that of the
    chief ray, whichever is larger.

    A point matches a position if its phase in the array's period matches. Its chief ray must also have the same offset
    from the nearest pixel centre as that of the position. The period is not a whole number of pixels, and the same
    light displaced by half a pixel has a different pattern. Both conditions are therefore needed. Resampling cannot
    restore an undersampled pattern; points with such patterns can only be used in a fit.

    Parameters
    ----------
    points
        Points found in the frames.
    tolerance_px
        Largest deviation of phase and chief ray along rows and along columns (px). None: `TargetPlan.tolerance_px` of
        the plan.
    resampled
        Whether patterns are shifted by the fraction of a pixel between chief ray and pixel centre. In this case, only
        the phase must match, and the deviation is that fraction. The pixels must be fine enough to sample all details
        of the patterns (`may_resample`).
    """
    scan = points.plan.scan
    limit = points.plan.tolerance_px if tolerance_px is None else tolerance_px
    phases = Phases.of(scan)
    tree = cKDTree(phases.wanted(), boxsize=phases.period)
    own = phases.at(points.pixels)
    nearest = np.asarray(tree.query(own, p=np.inf)[1], np.intp)
    off = own - phases.wanted()[nearest]
    off -= phases.period * np.round(off / phases.period)
    aside = points.pixels - np.array(scan.anchor)
    aside -= np.round(aside)
    worst = np.where(np.abs(aside) > np.abs(off), aside, off)
    index = np.c_[points.z, nearest // scan.period[1], nearest % scan.period[1]].astype(np.intp)
    index[(np.abs(off if resampled else worst) > limit + 1e-9).any(1)] = -1
    return index, aside if resampled else worst


class PointFrames(SourceView):
    """A source of frames with one point each, extracted from full frames with many points.

    The frame of a point is the full frame, shifted by whole pixels to where the scan expects the point's image. It is
    scaled to the brightness of the median hole. In `samples`, pixels outside the cutout, and those in it that receive
    light from neighbours, are marked as invalid.

    Parameters
    ----------
    source
        Full frames in which ``points`` were found.
    points
        Points found in the frames.
    tolerance_px
        As in `shown_positions`.
    resampled
        As in `shown_positions`. None: True if the camera's pixels are fine enough.

    Raises
    ------
    InputError
        If no point matches a position of the scan.
    """

    def __init__(
        self,
        source: FrameSource,
        points: Points,
        tolerance_px: float | None = None,
        *,
        resampled: bool | None = None,
    ) -> None:
        super().__init__(source)
        self.resampled = may_resample(points.plan.scan.camera) if resampled is None else resampled
        index, off = shown_positions(points, tolerance_px, resampled=self.resampled)
        keep: NDArray[np.bool_] = np.array((index >= 0).all(1))
        if not keep.any():
            limit = points.plan.tolerance_px if tolerance_px is None else tolerance_px
            raise InputError.expected(
                "points of the frames",
                f"at least one within {limit:g} px of a position of the scan",
                f"none of the {len(points)} points",
                "make the plan with the measured pose of the target, or use lfcal fit, which accepts all points",
            )
        self.unused = int((~keep).sum())
        self.points, self._index, self._off = points.only(keep), index[keep], off[keep]
        scan = points.plan.scan
        places = np.floor(np.array(scan.anchor) + 0.5) + self._index[:, 1:]
        self._origins = (places - self.points.middles).astype(np.intp)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, float32, because values are scaled to holes of equal brightness."""
        return np.dtype(np.float32)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return ``known`` without saturation, bit depth and target, but with the number of unused points."""
        known = replace(known, saturation=None, bit_depth=None, points_left_out=self.unused)
        return replace(known, target=None, target_frames=None)

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def info(self, index: int) -> FrameInfo:
        """Return origin, exposure and label of frame ``index``, the position of its point, and the deviation."""
        points = self.points
        info = self.source.info(int(points.frame[index]))
        row, column = points.holes[index].tolist()
        return FrameInfo(
            (Position(*self._index[index].tolist()),),
            (int(self._origins[index, 0]), int(self._origins[index, 1])),
            info.exposure_s,
            (float(self._off[index, 0]), float(self._off[index, 1])),
            label=f"{info.label}, hole ({row}, {column})",
        )

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the frame of a point, or a ``region`` of it, scaled to the brightness of the median hole."""
        values = self.source.read(int(self.points.frame[index]), region)
        scaled: NDArray[Any] = np.asarray(values, np.float32) / np.float32(self.points.brightness[index])
        return scaled

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the frame of a point, or a ``region`` of it, with its noise and its mask of valid samples.

        Samples are valid if they are in the cutout of the point, valid in the full frame, and beyond the reach of the
        patterns of neighbours.
        """
        share = float(self.points.brightness[index])
        found = self.source.samples(int(self.points.frame[index]), region)
        values = np.asarray(found.values, np.float32) / np.float32(share)
        alone = self._alone(index, values.shape, region)
        valid = alone if found.valid is None else alone & found.valid
        noise = None if found.noise is None else found.noise.scaled(1 / share)
        return Samples(values, None if valid.all() else valid, noise, found.saturated)

    def _alone(self, index: int, shape: tuple[int, ...], region: Region | None) -> NDArray[np.bool_]:
        """Return a mask of the pixels in the cutout of a point that no neighbour's pattern reaches."""
        out = np.zeros(shape, np.bool_)
        first = (0, 0) if region is None else (region[0].start, region[1].start)
        own = tuple(slice(p.start - f, p.stop - f) for p, f in zip(self.points.region(index), first, strict=True))
        inside = tuple(slice(max(0, p.start), min(n, p.stop)) for p, n in zip(own, shape, strict=True))
        part = tuple(slice(i.start - p.start, i.stop - p.start) for i, p in zip(inside, own, strict=True))
        if all(p.stop > p.start for p in inside):
            out[inside] = self.points.alone(index)[part]
        return out


DOUBTFUL = 0.6
"""Confidence below which the label of a hole is doubtful."""

MOST = 20
"""Largest number of stored mistakes."""


def target_facts(points: Points) -> dict[str, Any]:
    """Return the results for a target as plain JSON types.

    ``crosstalk`` is the largest fraction of light from neighbours in a cutout. It is the plan's value for equally
    bright holes, multiplied by the largest ratio of a neighbour's brightness to that of the point. ``stage_px`` is the
    rms deviation of frames from their planned positions, without the mean of each plane. ``pose_rms_px`` is the median
    over all frames of the rms deviation of the holes' images from the lattice (both in px). ``doubtful`` is the
    fraction of holes with an uncertain label or at a wrong position, and ``missing`` the largest number of missing
    holes in a frame. ``points`` and ``frames`` are counts. ``brightness_spread`` is the robust relative standard
    deviation of the holes' brightness. ``pose``, ``pose_sigma``, ``scale`` and ``distortion`` are results of the first
    frame, and ``mistakes`` lists deviations from the target's description.
    """
    found = list(points.found.values())
    confidence = np.concatenate([one.confidence for one in found])
    wrong = sum(len(m.positions) for one in found for m in one.mistakes if m.kind == "displaced")
    usual = np.concatenate([one.light / np.median(one.light) for one in found])
    return {
        "points": len(points),
        "frames": len(found),
        "crosstalk": max(points.plan.crosstalk) * _brighter(points),
        "brightness_spread": float(1.4826 * np.median(np.abs(usual - 1))),
        "pose_rms_px": float(np.median([one.fit.rms_px for one in found])),
        "stage_px": _stage_error_px(points),
        "doubtful": float(((confidence < DOUBTFUL).sum() + wrong) / len(confidence)),
        "missing": max(sum(len(m.positions) for m in one.mistakes if m.kind.startswith("missing")) for one in found),
        "pose": plain(found[0].fit.pose),
        "pose_sigma": plain(found[0].fit.sigma),
        "scale": list(found[0].fit.scale),
        "distortion": found[0].fit.bend,
        "mistakes": [{"kind": m.kind, "says": m.detail, "frames": n} for m, n in points.mistakes[:MOST]],
    }


def _brighter(points: Points) -> float:
    """Return the largest ratio of a neighbour's brightness to that of a point's own hole."""
    most = 1.0
    for one in points.found.values():
        at = {tuple(hole): light for hole, light in zip(one.holes.tolist(), one.light.tolist(), strict=True)}
        for (row, column), light in at.items():
            beside = [at.get((row + a, column + b), 0.0) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]
            most = max(most, max(beside) / max(light, 1e-9))
    return most


def _stage_error_px(points: Points) -> float:
    """Return the rms deviation of frames from their planned positions (pixels), without the mean of each plane."""
    scan = points.plan.scan
    away: dict[int, list[tuple[float, float]]] = {}
    for k, one in points.found.items():
        z = int(points.z[points.frame == k][0]) if (points.frame == k).any() else 0
        step = scan.camera.step_um(scan.depths_um[z])
        # the prior of a pose is its planned value in this frame
        row, column = one.moved_px
        away.setdefault(z, []).append((one.fit.pose.down_um / step - row, one.fit.pose.right_um / step - column))
    squares = [np.square(np.array(own) - np.mean(own, axis=0)).sum(1) for own in away.values()]
    return float(np.sqrt(np.concatenate(squares).mean()))


class AssembledPoints(NamedTuple):
    """Result of assembling H, points found, number of points that match no position, and results for the target."""

    report: AssemblyReport
    points: Points
    unused: int
    facts: dict[str, Any]


def iter_assemble_points(
    view: FrameSource, plan: TargetPlan, out: str | os.PathLike[str], settings: AssemblySettings | None = None
) -> Work[AssembledPoints]:
    """Find the points of all frames, and assemble H from those that match a position of the scan; yield progress.

    For the conditions of a match, see `shown_positions`.

    Parameters
    ----------
    view
        Full frames with their dark level subtracted.
    plan
        The target with its planned positions.
    out
        Path of the H file to write.
    settings
        As in `lfcal.psf.iter_assemble_plan`; positions without a point remain empty. If the pixels are fine enough,
        patterns are resampled to whole pixels, by default with band-limited interpolation.

    Raises
    ------
    InputError
        If the frames do not belong to the plan, the points of a frame cannot be labelled, or no point matches a
        position.
    """
    points = yield from iter_points_of(view, plan)
    single = PointFrames(view, points)
    facts = target_facts(points) | {"left_out": single.unused}
    how = settings or AssemblySettings()
    if single.resampled and not how.interpolation:
        how = replace(how, interpolation="fourier")
    work = iter_assemble_plan(single, plan.scan, out, how, provenance={"target": facts})
    return AssembledPoints((yield from work), points, single.unused, facts)
