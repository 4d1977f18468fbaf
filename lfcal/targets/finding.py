"""Holes of a target in a frame: their positions and labels, and deviations of the target from its description."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfcal.base import Finding, InputError, any_of, format_pixels
from lfcal.camera import Camera, half_extent_px
from lfcal.targets._mistakes import mistakes_of
from lfcal.targets._pose_fit import PoseFit, fit_pose
from lfcal.targets._spots import Spots, find_spots
from lfcal.targets.images import HoleImages, hole_images
from lfcal.targets.target import Target

__all__ = ["FoundPoints", "find_points"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]

REACH = 3.3
"""Largest distance of neighbours in pitches, so that one or two missing rows do not divide the lattice."""

OFF = 0.22
"""Largest displacement of a neighbour from its expected position, in pitches."""

NEAR = 0.3
"""Largest displacement, in pitches, of the first neighbours, from which the basis is measured."""


def refined_basis(pixels: Array, basis: Array) -> Array:
    """Return the two lattice vectors ``(2, 2)`` of the spots: medians of the differences near those in ``basis``.

    ``basis`` contains the expected vectors, and ``pixels`` ``(n, 2)`` the positions of the spots. All are (row, column)
    in px.

    Raises
    ------
    InputError
        If there are several spots, but no difference between two of them is close to one of the vectors.
    """
    tree = cKDTree(pixels)
    longest = float(np.linalg.norm(basis, axis=1).max())
    pairs = np.array(sorted(tree.query_pairs(1.5 * longest)), np.intp).reshape(-1, 2)
    away = pixels[pairs[:, 1]] - pixels[pairs[:, 0]] if len(pairs) else np.zeros((0, 2))
    away = np.concatenate([away, -away])
    found = basis.copy()
    for _ in range(4):
        for k in range(2):
            close = np.linalg.norm(away - found[k], axis=1) < NEAR * np.linalg.norm(basis[k])
            if close.any():
                found[k] = np.median(away[close], axis=0)
    near = [(np.linalg.norm(away - b, axis=1) < OFF * np.linalg.norm(b)).sum() for b in found]
    if len(pixels) > 1 and not any(near):
        apart = " or ".join(dict.fromkeys(f"{length:.1f}" for length in np.linalg.norm(basis, axis=1)))
        nearest = np.asarray(tree.query(pixels, 2)[0])[:, 1]
        raise InputError.expected(
            "lattice of the points in the frame",
            f"neighbours at {apart} px within 15° of the expected directions",
            f"none; the typical distance of the nearest neighbour is {np.median(nearest):.1f} px",
            "check the pitch, the depth and the rotation of the target",
        )
    return found


def lattice_labels(pixels: Array, basis: Array) -> tuple[Index, NDArray[np.bool_]]:
    """Return the lattice positions ``(n, 2)`` of spots, and a mask of the spots that have one.

    The positions ``pixels`` ``(n, 2)`` of the spots and the lattice vectors ``basis`` are (row, column) in px. Each
    spot is labelled relative to a labelled neighbour, the most certain step first, so that labels follow tilt and
    distortion. Only the largest connected group of spots is labelled. Spots between lattice positions, or at an
    occupied one, have no position.
    """
    n = len(pixels)
    label, has = np.zeros((n, 2), np.intp), np.zeros(n, np.bool_)
    tree = cKDTree(pixels)
    inverse = np.linalg.inv(basis)
    reach = REACH * float(np.linalg.norm(basis, axis=1).max())
    near = [list(tree.query_ball_point(at, reach)) for at in pixels]

    def steps(k: int) -> list[tuple[float, int, int, tuple[int, int]]]:
        out = []
        for other in near[k]:
            step = (pixels[other] - pixels[k]) @ inverse
            whole = np.rint(step)
            far = float(np.abs(step - whole).max())
            if other != k and whole.any() and far < OFF:
                out.append((far + 0.2 * float(np.abs(whole).sum()), k, other, (int(whole[0]), int(whole[1]))))
        return out

    left = set(range(n))
    best: tuple[Index, NDArray[np.bool_]] = (label, has)
    # the largest connected part is the target, because growth may begin at a ghost or at dirt
    while left:
        start = max(left, key=lambda k: sum(1 for s in steps(k) if s[2] in left))
        label, has = np.zeros((n, 2), np.intp), np.zeros(n, np.bool_)
        has[start] = True
        taken = {(0, 0)}
        heap = steps(start)
        heapq.heapify(heap)
        while heap:
            _, k, other, (a, b) = heapq.heappop(heap)
            at = (int(label[k, 0]) + a, int(label[k, 1]) + b)
            if has[other] or at in taken:
                continue
            label[other], has[other] = at, True
            taken.add(at)
            for step in steps(other):
                heapq.heappush(heap, step)
        if has.sum() > best[1].sum():
            best = label, has
        left -= set(np.flatnonzero(has).tolist())
        if len(left) <= best[1].sum():
            break
    return best


TURNS = {
    "as described": (False, 0),
    "turned by 90°": (False, 1),
    "turned by 180°": (False, 2),
    "turned by 270°": (False, 3),
    "mirrored left to right": (True, 0),
    "mirrored and turned by 90°": (True, 1),
    "mirrored top to bottom": (True, 2),
    "mirrored and turned by 270°": (True, 3),
}
"""Orientations of an array: whether it is mirrored, and the number of quarter turns after that."""


@dataclass(frozen=True, eq=False)
class Match:
    """A possible assignment of lattice positions to the holes of a target.

    Attributes
    ----------
    shift
        Shift from lattice positions to those of the holes (rows, columns).
    turn
        Orientation of the target, one of `TURNS`.
    hits, misses, extra
        Number of spots on holes; of holes in the frame without a spot, where an empty row or column counts once; and of
        spots without a hole.
    """

    shift: tuple[int, int]
    turn: str
    hits: int
    misses: int
    extra: int

    @property
    def score(self) -> int:
        """Score of the agreement between spots and holes, ``hits - misses - 2 extra``; larger is better."""
        return self.hits - self.misses - 2 * self.extra


def places_of(holes: Index, target: Target) -> Index:
    """Return the lattice positions ``(n, 2)`` of holes (row, column); rows of a hexagonal array are sheared."""
    out = np.array(holes, np.intp)
    if target.kind == "hexagonal":
        out[:, 1] -= out[:, 0] // 2
    return out


def holes_of(places: Index, target: Target) -> Index:
    """Return the holes ``(n, 2)`` as (row, column) at lattice positions; the inverse of `places_of`."""
    out = np.array(places, np.intp)
    if target.kind == "hexagonal":
        out[:, 1] += out[:, 0] // 2
    return out


def turned_absent(target: Target, turn: str) -> Target | None:
    """Return the target with its absent holes as seen in the orientation ``turn``; None if that is impossible.

    ``turn`` is one of `TURNS`. It is impossible if the turned array has holes at other positions, as after a quarter
    turn of a rectangular array.
    """
    mirror, quarters = TURNS[turn]
    if quarters % 2 and (target.shape[0] != target.shape[1] or target.pitch_um[0] != target.pitch_um[1]):
        return None
    if target.kind == "hexagonal" and (quarters % 2 or mirror or (quarters and target.shape[0] % 2)):
        return None
    there = np.ones(target.shape, np.bool_)
    for hole in target.absent:
        there[hole] = False
    seen = np.rot90(there[:, ::-1] if mirror else there, quarters)
    return replace(target, absent=tuple((int(r), int(c)) for r, c in np.argwhere(~seen)))


def matches(
    places: Index,
    target: Target,
    on_frame: NDArray[np.bool_],
    around: tuple[int, int],
    reach: int,
) -> Iterator[Match]:
    """Yield possible assignments of lattice positions to the holes of a target.

    If the target has absent holes, assignments in the other orientations of `TURNS` are included.

    Parameters
    ----------
    places
        Lattice positions of the spots ``(n, 2)``.
    target
        The target as described.
    on_frame
        Mask ``(rows, columns)`` of the lattice positions that the frame shows completely, for counting misses. Its
        element ``around`` is position (0, 0) of the lattice.
    around
        Row and column of lattice position (0, 0) in ``on_frame``.
    reach
        Smallest number of spots on holes in an assignment.
    """
    seen = np.zeros(on_frame.shape, np.bool_)
    inside = places + np.array(around)
    seen[tuple(inside.T)] = True
    turns = TURNS if target.absent else ("as described",)
    for turn in turns:
        own = turned_absent(target, turn)
        if own is None:
            continue
        holes = places_of(own.holes, own)
        low, high = holes.min(0) - places.max(0), holes.max(0) - places.min(0)
        for a in range(int(low[0]), int(high[0]) + 1):
            for b in range(int(low[1]), int(high[1]) + 1):
                at = holes - np.array([a, b]) + np.array(around)
                within = ((at >= 0) & (at < np.array(on_frame.shape))).all(1)
                at = at[within]
                shown = seen[tuple(at.T)]
                hits = int(shown.sum())
                if hits < reach:
                    continue
                misses = _misses(holes[within], on_frame[tuple(at.T)], shown)
                yield Match((a, b), turn, hits, misses, len(places) - hits)


def _misses(holes: Index, there: NDArray[np.bool_], shown: NDArray[np.bool_]) -> int:
    """Return the number of holes that should be visible and are not; an empty row or column is counted once."""
    gone, rows = there & ~shown, 0
    for axis in (0, 1):
        for k in np.unique(holes[gone, axis]).tolist():
            own = there & (holes[:, axis] == k)
            if own.sum() > 1 and not (own & shown).any():
                gone, rows = gone & ~own, rows + 1
    return int(gone.sum()) + rows


RIVAL = 2
"""Difference from the best `Match.score` up to which another assignment is possible as well."""

ENOUGH = 0.5
"""Fraction of the spots that must be on holes."""

ON_PLACE = 0.2
"""Distance of a spot from its hole, in pitches, at which the confidence of the label is 0."""


@dataclass(frozen=True, eq=False)
class FoundPoints:
    """Holes of a target that were found in a frame.

    Attributes
    ----------
    holes
        Labels (row, column) of the n holes on the target, row by row, ``(n, 2)``.
    pixels
        Position (row, column) of each image on the sensor according to the fitted pose (px), ``(n, 2)``.
    sigma_px
        Standard deviations of ``pixels`` (px), ``(n, 2)``.
    seen
        Centroid (row, column) of the light of each image (px), ``(n, 2)``.
    light
        Sum of each pattern minus the dark level (counts), ``(n,)``.
    confidence
        Confidence of each label, from 0 to 1, based on the displacement and the relative brightness of the image,
        ``(n,)``.
    away_um, shift
        Depth of each hole, and relative motion of its image, as in `HoleImages`.
    fit
        Fitted pose, with further results of the fit.
    mistakes
        Deviations of the target from its description.
    dark
        Dark level of the frame (counts).
    moved_px
        Planned displacement (rows, columns) of the image of the target's middle from the optical axis (px).

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import FoundPoints, TargetCamera, TargetPlan, find_points, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> target = parse_target("array:3x3@2mm")
    >>> plan = TargetPlan(scan, target, (((0.0, 0.0),),), 0.1, (0.0,), "geometric")
    >>> dim = TargetCamera(plan, effects=(), brightness=[1, 1, 1, 1, 0.3, 1, 1, 1, 1], level="geometric")
    >>> points: FoundPoints = find_points(dim.read(0), target, scan.camera, scan.depths_um[0])
    >>> print(points.pixels[4].round(1).tolist(), *points.mistakes)
    [159.5, 159.5] hole (row, column) (1, 1) with only 31 % of the light of others: dirty or partly closed
    """

    holes: Index
    pixels: Array
    sigma_px: Array
    seen: Array
    light: Array
    confidence: Array
    away_um: Array
    shift: Array
    fit: PoseFit
    mistakes: tuple[Finding, ...]
    dark: float
    moved_px: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        """Return the number of holes."""
        return len(self.holes)

    @property
    def deviation(self) -> Array:
        """Centroid of each image minus its position `pixels`, (rows, columns) in px, ``(n, 2)``."""
        away: Array = self.seen - self.pixels
        return away


def find_points(
    values: NDArray[np.floating],
    target: Target,
    camera: Camera,
    z_um: float,
    *,
    offset_px: tuple[float, float] = (0.0, 0.0),
    valid: NDArray[np.bool_] | None = None,
) -> FoundPoints:
    """Find the holes of ``target`` that a frame shows, each with its label and the position of its image.

    Parameters
    ----------
    values
        The frame ``(rows, columns)``, raw or with its dark level subtracted.
    target
        The target, with its approximate pose.
    camera, z_um
        The camera, and the depth to which the target's pose refers (µm).
    offset_px
        Displacement of the target in this frame, as the displacement (rows, columns) of images of points in the depth
        plane (px).
    valid
        Mask ``(rows, columns)``, True at valid pixels. None: all are valid.

    Raises
    ------
    InputError
        If the frame does not have the shape of the sensor, there are no points, or the points do not form a lattice
        like that of the target. Also if the target is mirrored or rotated, or the labelling is ambiguous. The message
        states which.

    Examples
    --------
    >>> import math
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Pose, TargetCamera, TargetPlan, find_points, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> target = replace(parse_target("array:3x3@2mm,absent=0:0"), within=Pose.parse("rotation=3"))
    >>> plan = TargetPlan(scan, target, (((0.0, 0.0),),), 0.1, (0.0,), "geometric")
    >>> turned = replace(target, pose=Pose.parse("rotation=1"))
    >>> frame = TargetCamera(plan, effects=(), really=turned, level="geometric").read(0)
    >>> points = find_points(frame, target, scan.camera, scan.depths_um[0])
    >>> print(f"{len(points)} holes, turned by {math.degrees(points.fit.pose.rotation_rad):.1f} degrees")
    8 holes, turned by 1.0 degrees
    """
    if values.shape != camera.sensor.shape:
        raise InputError.expected(
            "frame", format_pixels(camera.sensor.shape), format_pixels(values.shape), "give whole sensor frames"
        )
    step = camera.step_um(z_um)
    moved = replace(
        target.pose,
        right_um=target.pose.right_um + offset_px[1] * step,
        down_um=target.pose.down_um + offset_px[0] * step,
    )
    planned = replace(target, pose=moved)
    radius = half_extent_px(camera, z_um)
    basis = _basis(planned, step)
    apart = target.nearest_um / step if target.kind != "point" else 4 * radius
    spots = find_spots(np.asarray(values, np.float64), radius, apart, valid)
    if target.kind == "point":
        spots = spots.only(np.array([int(spots.light.argmax())]))
        holes = np.zeros((1, 2), np.intp)
    else:
        spots, holes = _labelled(spots, planned, camera, z_um, (basis, radius))
    fit = fit_pose(planned, camera, z_um, holes, spots.pixels)
    return _collected(spots, holes, fit, planned, (camera, z_um, radius))


def _basis(target: Target, step_um: float) -> Array:
    """Return the lattice vectors ``(2, 2)`` (px) from an image to the next row, and to the next image in its row."""
    down, right = target.pitch_um
    lean = right / 2 if target.kind == "hexagonal" else 0.0
    flat = np.array([[lean, down], [right, 0.0]])
    turned: Array = (flat @ target.pose.turn()[:2, :2].T)[:, ::-1] / step_um
    return turned


def _labelled(
    spots: Spots, target: Target, camera: Camera, z_um: float, seen: tuple[Array, float]
) -> tuple[Spots, Index]:
    """Return the spots that are holes, and the numbers of these holes."""
    basis, radius = seen
    lattice = refined_basis(spots.pixels, basis)
    places, has = lattice_labels(spots.pixels, lattice)
    used, places = spots.only(has), places[has]
    least = max(2, math.ceil(ENOUGH * len(spots)))
    if len(used) < least:
        wanted = f"at least {least} of {len(spots)} on one lattice"
        raise InputError.expected(
            "points in the frame", wanted, f"{len(used)}", "check the pitch and the depth of the target"
        )
    found = _chosen(used, places, target, camera, (z_um, lattice, radius))
    holes = holes_of(places + np.array(found.shift), target)
    there = {tuple(h) for h in target.holes.tolist()}
    keep = np.array([tuple(h) in there for h in holes.tolist()])
    return used.only(keep), holes[keep]


def _chosen(spots: Spots, places: Index, target: Target, camera: Camera, seen: tuple[float, Array, float]) -> Match:
    """Return the single assignment of the lattice to the holes of the target.

    Raises
    ------
    InputError
        If there is none, or more than one, or the target has another orientation than described.
    """
    z_um, lattice, radius = seen
    on_frame, around = _shown(spots, places, lattice, camera.sensor.shape, radius)
    least = max(1, int(ENOUGH * len(places)))
    every = sorted(matches(places, target, on_frame, around, least), key=lambda m: -m.score)
    if not every:
        got = f"{len(places)} points that do not fit {target.shape[0]} x {target.shape[1]} holes"
        raise InputError.expected(
            "points in the frame", "the holes of the target", got, "check the numbers of rows and columns of the target"
        )
    rivals = [one for one in every if one.score >= every[0].score - RIVAL]
    right = [one for one in rivals if one.turn == "as described"]
    if not right:
        own = turned_absent(target, every[0].turn)
        assert own is not None
        raise InputError.expected(
            "target",
            "the marks as described",
            f"the target {every[0].turn} ({every[0].hits} points on its holes, {every[0].misses} missing)",
            "mount the target as described, or change its description",
        )
    if len(right) == 1:
        return right[0]
    near = [one for one in right if _within(one, spots, places, target, (camera, z_um, lattice))]
    if len(near) == 1:
        return near[0]
    shifts = any_of(f"{a.shift[0] - right[0].shift[0]}:{a.shift[1] - right[0].shift[1]}" for a in right[1:5])
    raise InputError.expected(
        "labels of the points",
        "a unique assignment to the holes of the target",
        f"{len(right)} assignments that differ by {shifts} (rows:columns) and fit equally well",
        "state the position of the target to within half a pitch, or mark the target with absent holes",
    )


def _shown(
    spots: Spots, places: Index, lattice: Array, sensor: tuple[int, int], radius: float
) -> tuple[NDArray[np.bool_], tuple[int, int]]:
    """Return the mask of lattice positions that the frame shows completely, and the position of (0, 0) in it."""
    design = np.c_[places, np.ones(len(places))].astype(float)
    if np.linalg.matrix_rank(design) == 3:
        fit = np.linalg.lstsq(design, spots.pixels, rcond=None)[0]
    else:
        fit = np.vstack([lattice, (spots.pixels - places @ lattice).mean(0)])
    corners = np.array([(r, c) for r in (0, sensor[0]) for c in (0, sensor[1])]) - fit[2]
    far = np.rint(corners @ np.linalg.inv(fit[:2])).astype(np.intp)
    low = np.minimum(far.min(0), places.min(0)) - 1
    high = np.maximum(far.max(0), places.max(0)) + 1
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    pixels = grid @ fit[:2] + fit[2]
    # at the edge, a pattern may count as complete or not
    margin = radius + 1.5
    whole = ((pixels >= margin) & (pixels <= np.array(sensor) - 1 - margin)).all(-1)
    return whole, (int(-low[0]), int(-low[1]))


def _within(one: Match, spots: Spots, places: Index, target: Target, seen: tuple[Camera, float, Array]) -> bool:
    """Return whether an assignment agrees with the stated position of the target."""
    camera, z_um, lattice = seen
    step = camera.step_um(z_um)
    images = hole_images(replace(target, absent=()), camera, z_um)
    holes = holes_of(places + np.array(one.shift), target)
    inside = ((holes >= 0) & (holes < np.array(target.shape))).all(1)
    which = holes[inside] @ np.array([target.shape[1], 1])
    away = np.median(spots.pixels[inside] - images.pixels[which], axis=0)
    allowed = np.array([target.within.down_um, target.within.right_um]) / step
    beyond = np.maximum(np.abs(away) - allowed, 0.0)
    return bool((np.abs(beyond @ np.linalg.inv(lattice)) < 0.5).all())


def _collected(
    spots: Spots, holes: Index, fit: PoseFit, target: Target, seen: tuple[Camera, float, float]
) -> FoundPoints:
    """Return the points in the order of their holes, and the deviations from the description."""
    camera, z_um, radius = seen
    images = fit.images(target, camera, z_um)
    order = {tuple(h): k for k, h in enumerate(images.holes.tolist())}
    which = np.array([order[tuple(h)] for h in holes.tolist()], np.intp)
    rank = np.argsort(which, kind="stable")
    which, spots = which[rank], spots.only(rank)
    own = HoleImages(images.holes[which], images.pixels[which], images.away_um[which], images.shift[which])
    step = camera.step_um(z_um)
    pitch = target.nearest_um / step if target.kind != "point" else 4 * radius
    off = np.linalg.norm(spots.pixels - own.pixels, axis=1)
    usual = float(np.median(spots.light))
    confidence = np.clip(1 - off / (ON_PLACE * pitch), 0.0, 1.0) * np.clip(spots.light / (0.5 * usual), 0.0, 1.0)
    found = mistakes_of(target, fit, images, which, spots, (camera, step, radius))
    sigma = fit.pixel_sigma(target, camera, z_um)[which]
    return FoundPoints(
        own.holes,
        own.pixels,
        sigma,
        spots.pixels,
        spots.light,
        confidence,
        own.away_um,
        own.shift,
        fit,
        found,
        spots.dark,
        (target.pose.down_um / step, target.pose.right_um / step),
    )
