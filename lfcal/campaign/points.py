"""Find the points in frames of a target: their labels, positions on the sensor, and patterns for a fit.

Repeated measurements of a hole at the same position are averaged, which reduces their variance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Finding, InputError, Work, check_number, check_tuple, drained, format_count
from lfcal.camera import ScanPlan, half_extent_px
from lfcal.fit import FieldRegion, Measured, Regional
from lfcal.frames import FrameSource, Noise
from lfcal.targets import FoundPoints, TargetPlan, find_points, frames_of

__all__ = ["Points", "iter_points_of", "measured_modulo", "measured_points", "points_of", "tiles_of"]

F8 = NDArray[np.float64]

DIM = 0.2
"""Light, relative to the median hole, below which a point is not used."""

SURE = 0.3
"""Smallest confidence of a label."""

MOST_DEVIATION_PX = 0.5
"""Largest offset of a centroid from the lattice (pixels, or six times the rms if larger); other light is not a hole."""


@dataclass(frozen=True, eq=False)
class Points:
    """Usable points of a target's frames: their labels are reliable, and their cutouts are completely on the sensor.

    Attributes
    ----------
    plan
        The recorded plan.
    frame, z
        Frame index and plane index of each point, ``(n,)``.
    holes
        Label (row, column) of each point's hole, ``(n, 2)``.
    pixels
        Sensor position (row, column) of each chief ray (px), ``(n, 2)``; the cutout is centred on the nearest pixel.
    brightness
        Light of each point relative to the median hole in its frame, ``(n,)``.
    away_um
        Object depth of each point, ``(n,)`` (µm), according to the pose of the target in its frame.
    found
        Results for each frame, by its index.
    """

    data: ClassVar[str] = "target"

    plan: TargetPlan
    frame: NDArray[np.intp]
    z: NDArray[np.intp]
    holes: NDArray[np.intp]
    pixels: F8
    brightness: F8
    away_um: F8
    found: Mapping[int, FoundPoints]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.frame)

    @property
    def middles(self) -> NDArray[np.intp]:
        """The pixel (row, column) at the middle of each cutout, ``(n, 2)``."""
        whole: NDArray[np.intp] = np.floor(self.pixels + 0.5).astype(np.intp)
        return whole

    @property
    def residuals(self) -> F8:
        """Chief-ray position minus the nearest pixel, (row, column) for each point, ``(n, 2)`` (pixels)."""
        rest: F8 = self.pixels - self.middles
        return rest

    def only(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Points:
        """Return only the points that ``which``, a mask or indices, selects."""
        names = ("frame", "z", "holes", "pixels", "brightness", "away_um")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def region(self, k: int) -> tuple[slice, slice]:
        """Return the slices (rows, columns) of the sensor that the cutout of point ``k`` covers."""
        (row, column), (nt, ns) = self.middles[k].tolist(), self.plan.scan.cutout
        top, left = row - (nt - 1) // 2, column - (ns - 1) // 2
        return slice(top, top + nt), slice(left, left + ns)

    def alone(self, k: int) -> NDArray[np.bool_]:
        """Return a mask ``(nt, ns)`` of the pixels in the cutout of point ``k`` that no neighbour's pattern reaches."""
        found, scan = self.found[int(self.frame[k])], self.plan.scan
        rows, columns = (np.arange(part.start, part.stop) for part in self.region(k))
        radius = half_extent_px(scan.camera, scan.depths_um[int(self.z[k])])
        away = np.abs(found.pixels - self.pixels[k]).max(1)
        near = (away < radius + max(scan.cutout)) & (found.holes != self.holes[k]).any(1)
        out = np.ones((len(rows), len(columns)), np.bool_)
        for row, column in found.pixels[near].tolist():
            out &= np.hypot(rows[:, None] - row, columns[None, :] - column) > radius
        return out

    @property
    def known(self) -> str:
        """Text with the numbers of points and frames, and the median of the frames' rms deviations from the lattice."""
        rms = float(np.median([one.fit.rms_px for one in self.found.values()]))
        seen = f"{format_count(len(self), 'point', 'points')} in {format_count(len(self.found), 'frame', 'frames')}"
        return f"found: {seen}; their images are {rms:.2f} px (rms) from the lattice"

    @property
    def mistakes(self) -> tuple[tuple[Finding, int], ...]:
        """Deviations from the target's description, with the number of frames that show each, most frequent first."""
        counts: dict[tuple[str, tuple[tuple[int, ...], ...]], tuple[Finding, int]] = {}
        for found in self.found.values():
            for one in found.mistakes:
                first, count = counts.get((one.kind, one.positions), (one, 0))
                counts[one.kind, one.positions] = first, count + 1
        return tuple(sorted(counts.values(), key=lambda pair: -pair[1]))


def iter_points_of(source: FrameSource, plan: TargetPlan, frames: Sequence[int] | None = None) -> Work[Points]:
    """Find the points of all frames, or of those chosen by ``frames``, and return the usable ones.

    Parameters
    ----------
    source
        Full frames with their dark level subtracted: pass the corrected view. ``metadata.target_frames``, or else the
        plan's order, identifies the frames.
    plan
        The target with its planned positions.
    frames
        Indices of the frames to read. None: all.

    Yields
    ------
    Progress
        Counted in frames.

    Raises
    ------
    InputError
        If the frames do not belong to the plan, the points of a frame cannot be labelled, or no point is usable.
    """
    order = frames_of(source, plan)
    chosen = list(range(len(source))) if frames is None else list(frames)
    clock, found = Clock("find points", len(chosen)), {}
    yield clock.at(0)
    for done, k in enumerate(chosen, 1):
        found[k] = _of_frame(source, plan, k, order[k])
        yield clock.at(done)
    use = {k: _usable(one, plan) for k, one in found.items()}
    points = Points(
        plan,
        np.concatenate([np.full(len(use[k]), k, np.intp) for k in found]),
        np.concatenate([np.full(len(use[k]), order[k][0], np.intp) for k in found]),
        np.concatenate([one.holes[use[k]] for k, one in found.items()]),
        np.concatenate([one.pixels[use[k]] for k, one in found.items()]),
        np.concatenate([one.light[use[k]] / np.median(one.light) for k, one in found.items()]),
        np.concatenate([one.away_um[use[k]] for k, one in found.items()]),
        found,
    )
    if not len(points):
        raise InputError.expected(
            "points of the frames", "at least one usable point", "none", "check the lamp and the target"
        )
    return points


points_of = drained(iter_points_of)


def _of_frame(source: FrameSource, plan: TargetPlan, k: int, at: tuple[int, int]) -> FoundPoints:
    z, number = at
    scan, label = plan.scan, source.info(k).label or f"frame {k}"
    # use saturated pixels too: they are the brightest, and the centroid is more accurate with them
    values = np.asarray(source.samples(k).values, np.float64)
    try:
        return find_points(values, plan.target, scan.camera, scan.depths_um[z], offset_px=plan.offsets_px[z][number])
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _usable(found: FoundPoints, plan: TargetPlan) -> NDArray[np.intp]:
    """Return the indices of the points that can be used."""
    half = (np.array(plan.scan.cutout) - 1) // 2
    middles = np.floor(found.pixels + 0.5)
    usable = ((middles >= half) & (middles <= np.array(plan.scan.camera.sensor.shape) - 1 - half)).all(1)
    usable &= (found.light > DIM * np.median(found.light)) & (found.confidence > SURE)
    usable &= np.linalg.norm(found.deviation, axis=1) < max(MOST_DEVIATION_PX, 6 * found.fit.rms_px)
    return np.flatnonzero(usable)


HELD_OUT_EVERY = 5
"""Every n-th point is held out."""

SAME_PX = 0.05
"""Distance below which positions of one hole are repeats (pixels)."""

Tile = tuple[slice, slice]


def tile_plan(scan: ScanPlan, corner: tuple[float, float], shape: tuple[int, int]) -> ScanPlan:
    """Return a scan plan whose positions are the pixels of a part of the sensor.

    ``corner`` is the first pixel (row, column) of the part, and ``shape`` its number of rows and columns. All other
    values are those of ``scan``.
    """
    return replace(scan, period=shape, anchor=(float(corner[0]), float(corner[1])))


def tiles_of(sensor: tuple[int, int], cutout: tuple[int, int], parts: tuple[int, int]) -> tuple[Tile, ...]:
    """Return the parts of the sensor, row by row, each as slices of rows and columns.

    Together they contain every pixel whose cutout is completely on the sensor. ``sensor`` and ``cutout`` are sizes
    (rows, columns) in px, and ``parts`` is the number of parts (rows, columns), 1 to 16 each.
    """
    parts = check_tuple("parts of the field (rows, columns)", parts, 2, integer=True, at_least=1, at_most=16)
    edges = []
    for size, side, count in zip(sensor, cutout, parts, strict=True):
        half = (side - 1) // 2
        edges.append(np.linspace(half, size - half, count + 1).round().astype(int).tolist())
    rows, columns = ([slice(a, b) for a, b in pairwise(one)] for one in edges)
    return tuple((row, column) for row in rows for column in columns)


def measured_points(
    source: FrameSource, points: Points, parts: tuple[int, int] = (3, 3), *, most: int | None = None
) -> Regional:
    """Return the patterns of points, each with its position in a part of the field.

    A pattern is the mean over all frames that show the same hole at the same position. Every fifth one is held out.

    Parameters
    ----------
    source, points
        The frames with their dark level subtracted, and the points found in them.
    parts
        Number of parts of the sensor (rows, columns); each is computed with the optics of its middle.
    most
        Largest number of points, spread evenly over the parts. None: all.

    Raises
    ------
    InputError
        If the noise of the frames is unknown.
    """
    scan = points.plan.scan
    tiles = tiles_of(scan.camera.sensor.shape, scan.cutout, parts)
    firsts = _firsts(points)
    middles, part = points.middles[firsts], np.zeros(len(firsts), np.intp)
    for k, tile in enumerate(tiles):
        low, high = ([getattr(side, end) for side in tile] for end in ("start", "stop"))
        part[((middles >= low) & (middles < high)).all(1)] = k
    chosen = _spread(part, most)
    cut = _cut(source, points, firsts[chosen])
    used, number = np.unique(part[chosen], return_inverse=True)
    corners = np.array([(tiles[k][0].start, tiles[k][1].start) for k in used.tolist()])
    regions = tuple(_region(tiles[k], parts, k) for k in used.tolist())
    own = points.only(firsts[chosen])
    return Regional(
        tile_plan(scan, regions[0].anchor, regions[0].period),
        np.c_[own.z, own.middles - corners[number]].astype(np.intp),
        cut.patterns,
        cut.noise,
        own.residuals,
        cut.valid,
        np.arange(len(own)) % HELD_OUT_EVERY == 0,
        regions=regions,
        region=number.astype(np.intp),
    )


def measured_modulo(source: FrameSource, points: Points, *, most: int | None = None) -> Measured:
    """Return points as patterns of a scan of one period, as if the period were a whole number of pixels.

    Positions are rounded and reduced modulo the period. This is an approximation; chi² of a fit shows its error.
    ``source`` and ``points`` are as in `measured_points`. ``most`` is the largest number of points. None: all.
    """
    scan = points.plan.scan
    firsts = _firsts(points)
    chosen = firsts[_spread(np.zeros(len(firsts), np.intp), most)]
    cut, own = _cut(source, points, chosen), points.only(chosen)
    anchor = np.floor(np.array(scan.anchor) + 0.5).astype(np.intp)
    index = np.c_[own.z, (own.middles - anchor) % np.array(scan.period)].astype(np.intp)
    aside = np.arange(len(own)) % HELD_OUT_EVERY == 0
    return Measured(scan, index, cut.patterns, cut.noise, np.zeros((len(own), 2)), cut.valid, aside)


@dataclass(frozen=True, eq=False)
class _Cut:
    """Patterns scaled to equally bright holes ``(n, nt, ns)``, valid pixels, and constant and slope of the noise."""

    patterns: NDArray[np.float32]
    valid: NDArray[np.bool_]
    noise: NDArray[np.float64]


def _repeats(points: Points) -> NDArray[np.intp]:
    """Return, for each point ``(n,)``, the index of its combination of hole and position."""
    _, hole = np.unique(np.c_[points.z, points.holes, points.middles], axis=0, return_inverse=True)
    group, count = np.full(len(points), -1, np.intp), 0
    for own in np.split(np.argsort(hole.ravel(), kind="stable"), np.cumsum(np.bincount(hole.ravel()))[:-1]):
        for k in own.tolist():
            if group[k] < 0:
                left = own[group[own] < 0]
                same = np.abs(points.pixels[left] - points.pixels[k]).max(1) < SAME_PX
                group[left[same]] = count
                count += 1
    return group


def _firsts(points: Points) -> NDArray[np.intp]:
    """Return the first point of each combination of hole and position."""
    return np.sort(np.unique(_repeats(points), return_index=True)[1]).astype(np.intp)


def _cut(source: FrameSource, points: Points, chosen: NDArray[np.intp]) -> _Cut:
    """Return the patterns of points, each the mean of its repeats."""
    group = _repeats(points)
    n, cutout = len(chosen), points.plan.scan.cutout
    out = _Cut(np.zeros((n, *cutout), np.float32), np.zeros((n, *cutout), np.bool_), np.zeros((n, 2)))
    for at, k in enumerate(chosen.tolist()):
        same = np.flatnonzero(group == group[k]).tolist()
        cuts = [_one(source, points, j) for j in same]
        weight = np.stack([good for _, good, _ in cuts]).astype(np.float64)
        total = weight.sum(0)
        out.patterns[at] = (weight * np.stack([v for v, _, _ in cuts])).sum(0) / np.maximum(total, 1)
        out.valid[at] = total > 0
        # the number that most pixels have
        out.noise[at] = np.mean([two for _, _, two in cuts], axis=0) / max(1.0, float(np.median(total)))
    return out


def _one(
    source: FrameSource, points: Points, k: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_], tuple[float, float]]:
    region, share = points.region(k), float(points.brightness[k])
    samples = source.samples(int(points.frame[k]), region)
    values = np.asarray(samples.values, np.float64)
    if samples.noise is None:
        label = source.info(int(points.frame[k])).label or f"frame {points.frame[k]}"
        remedy = "describe the noise of the sensor, or measure it (lfcal camera sensor)"
        raise InputError.expected(f"{label}, noise", "a variance of the samples", "none", remedy)
    alone = points.alone(k)
    good = alone if samples.valid is None else alone & samples.valid
    two: Noise = samples.noise.typical(values).scaled(1 / share)
    return values / share, good, (max(0.0, float(two.constant)), float(two.slope))


def _region(tile: Tile, parts: tuple[int, int], k: int) -> FieldRegion:
    row, column = divmod(k, parts[1])
    rows, columns = tile
    period = (rows.stop - rows.start, columns.stop - columns.start)
    return FieldRegion(f"part-{row}-{column}", period, (float(rows.start), float(columns.start)))


def _spread(part: NDArray[np.intp], most: int | None) -> NDArray[np.intp]:
    """Return the indices of the selected points: equally many of each part, in a reproducible order."""
    order = np.random.default_rng(0).permutation(len(part))
    if most is None or len(part) <= most:
        return order
    check_number("number of points to fit", most, at_least=3, integer=True)
    used: Sequence[int] = np.unique(part).tolist()
    own = [order[part[order] == k][: max(1, most // len(used))] for k in used]
    # take parts in turn, so that held-out points come from all parts
    turns = max(map(len, own))
    return np.array([one[j] for j in range(turns) for one in own if j < len(one)], np.intp)
