"""Measurements of one depth plane that all metrics share, made in one pass over its patterns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk
from lfcal.camera import Camera
from lfcal.judge.quality._dark import DarkCorners, dark_corners, darkness
from lfcal.judge.quality._field import Parts, split
from lfcal.judge.quality._kernels import step_pass
from lfcal.judge.quality._periodicity import Periodicity
from lfcal.judge.quality._positions import Positions, measure_positions
from lfcal.judge.quality._steps import odd_frames, seam_ratio, unlike_displaced
from lfcal.judge.quality._sums import DOUBT, EdgeLight, edge_light
from lfcal.judge.quality._sums import diameter as diameter_of
from lfcal.judge.quality._sums import spread as spread_of
from lfcal.judge.quality.pattern_table import PatternTable
from lfcal.psf import PSFMatrix, copied_positions
from lfcal.psf.aperture import Aperture

__all__ = [
    "PASSES",
    "Continuity",
    "Faulty",
    "PlaneContext",
    "PlaneMeasures",
    "has_elemental_images",
    "iter_measure",
    "lattice_camera",
]

STEP_S = 1.5e-8
"""Additional processor time (s) for each value of a plane whose steps are compared by numpy."""

DARK_FRAME = 0.2
"""Fraction of the median energy below which a pattern counts as missing."""

SLIPPED = 32
"""Number of patterns from which the effect of a displacement is estimated."""

PASSES = 6
"""Progress records of a plane: one for each pass over its patterns or their table."""


def lattice_camera(matrix: PSFMatrix) -> Camera | None:
    """Return the camera of an H if it has a lenslet lattice, which some metrics require; otherwise None."""
    camera = matrix.camera
    return camera if camera is not None and camera.has_lattice else None


def has_elemental_images(matrix: PSFMatrix) -> bool:
    """Return whether patterns are elemental images: according to the camera or, without one, if the period is 1 x 1."""
    return matrix.period == (1, 1) if matrix.camera is None else not matrix.camera.has_lattice


@dataclass(frozen=True, slots=True, eq=False)
class PlaneContext:
    """Facts about a plane before its patterns are read.

    Attributes
    ----------
    matrix, z
        H, not transposed, and the index of the plane.
    depth_sum
        Sum ``(nt, ns)`` of the patterns of the plane, as stated in H.
    aperture
        The iris fitted to the sum.
    waves
        Wave vectors (x, y) of the lenslet lattice, ``(2 or 3, 2)`` (rad/px of H).
    tiling
        Result of the check of periodicity with control frames. None: there are none.
    expected
        Mean pattern expected from the camera, ``(nt, ns)``, with a total light of 1. None: unknown.
    """

    matrix: PSFMatrix
    z: int
    depth_sum: NDArray[np.float64]
    aperture: Aperture
    waves: NDArray[np.float64]
    tiling: Periodicity | None = None
    expected: NDArray[np.float64] | None = None

    @property
    def corner_tail(self) -> float:
        """Upper bound of the light in a dark pixel from the tails of a pattern; 0 if unknown.

        It is a fraction of the energy of the pattern.
        """
        if self.expected is None or not self.expected.any():
            return 0.0
        corners = dark_corners(self.expected[None, None].astype(np.float32)).background
        return DOUBT * corners / float(self.expected.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Faulty:
    """Masks ``(ny, nx)`` of the positions whose frames cannot be used: missing, not finite, or duplicates."""

    missing: NDArray[np.bool_]
    nonfinite: NDArray[np.bool_]
    duplicates: NDArray[np.bool_]

    @property
    def any(self) -> NDArray[np.bool_]:
        """Mask ``(ny, nx)`` of the positions with any of the faults."""
        either: NDArray[np.bool_] = self.missing | self.nonfinite | self.duplicates
        return either


@dataclass(frozen=True, slots=True, eq=False)
class Continuity:
    """Continuity of each pattern with its neighbours.

    Attributes
    ----------
    seam
        Ratio of the change of patterns across the edges of the period to that between neighbours inside; NaN if
        unknown.
    odd
        Difference of each pattern from its neighbours, relative to the typical difference around it, ``(ny, nx)``.
    """

    seam: float
    odd: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMeasures:
    """Measurements of one plane, for all metrics.

    In a plane without light, ``shares`` and all fields after it are unknown.

    Attributes
    ----------
    about
        Facts known before the patterns are read: H, index of the plane, depth-plane sum, aperture.
    patterns
        Patterns ``(ny, nx, nt, ns)``; empty after all metrics of the plane have been evaluated.
    table
        Table of the properties of the patterns, such as energy, highest value and centroid, with noise and background.
    lit, energy
        Whether there is light in the plane, and the median energy of its usable patterns in the unit of H.
    faulty
        Positions with missing, NaN or duplicate frames.
    shares, shares_split
        Energy of each pattern without background, relative to the typical energy (per cent), ``(ny, nx)``, and its
        components.
    edges
        Light at the edges of the cutout, and outside the pattern.
    spread
        Second moment of the depth-plane sum (px²); NaN if unreliable.
    positions
        Source positions measured from spots and centroids.
    continuity
        Seam and unusual frames. None if the scan did not run in the planned order, because adjacent positions of H are
        then not adjacent in space.
    sample
        Values of up to 16 patterns above the floor of dark pixels, 0 in dark pixels, as one vector; for comparison with
        other planes.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from lfcal.judge.quality import PlaneMeasures, Reading
    >>> def contrast(plane: PlaneMeasures) -> Reading:  # as `of_plane` of your own metric
    ...     return Reading(plane.energy / plane.dark.noise, detail=f"plane {plane.about.z}")
    >>> tried = contrast(SimpleNamespace(energy=600.0, dark=SimpleNamespace(noise=2.0), about=SimpleNamespace(z=1)))
    >>> print(tried.value, tried.detail)
    300.0 plane 1
    """

    about: PlaneContext
    patterns: NDArray[np.float32]
    table: PatternTable
    lit: bool
    energy: float
    faulty: Faulty
    shares: NDArray[np.float64]
    shares_split: Parts
    edges: EdgeLight
    spread: float
    positions: Positions
    continuity: Continuity | None
    sample: NDArray[np.float32]

    @property
    def dark(self) -> DarkCorners:
        """Noise and background from the dark corners of the cutouts, or from gaps in patterns that fill the corners."""
        return self.table.dark

    @property
    def background(self) -> float:
        """Background of a pixel, in the unit of H, minus the light expected from the tails of the patterns."""
        found = self.dark.background
        return found - min(max(0.0, found), self.energy * self.about.corner_tail)

    @property
    def sensor_noise(self) -> float | None:
        """Noise of an unlit pixel according to the noise model stated in H, in the unit of H. None: unknown.

        It is a standard deviation, computed from the median variance over positions.
        """
        noise = self.about.matrix.facts.noise
        if noise is None:
            return None
        # without a photon part, it comes from repeated frames and not from the sensor
        constant, slope = np.moveaxis(noise[self.about.z].astype(np.float64), -1, 0)
        known = np.isfinite(constant) & (slope > 0) & (constant > 0)
        return float(np.sqrt(np.median(constant[known]))) if known.any() else None

    @property
    def use(self) -> NDArray[np.bool_]:
        """Mask ``(ny, nx)``, True at positions whose frames can be used."""
        return ~self.faulty.any

    def released(self) -> PlaneMeasures:
        """Return the measurements without the patterns, so that their memory can be released."""
        return replace(self, patterns=np.empty((0, 0, 0, 0), np.float32))


def iter_measure(
    patterns: NDArray[np.float32], context: PlaneContext, clock: Clock, done: int, workers: int | None = None
) -> Work[PlaneMeasures]:
    """Measure the patterns ``(ny, nx, nt, ns)`` of the plane that ``context`` describes.

    ``clock`` counts `PASSES` steps for the plane, after the ``done`` steps of the planes before it.
    """
    dark = darkness(patterns)
    yield clock.at(done + 1)
    table = PatternTable.of(patterns, dark, workers)
    yield clock.at(done + 2)
    unread = (table.column("nonfinite") > 0) | (table.column("lit") == 0)
    usual = float(np.median(table.light[~unread])) if (~unread).any() else 0.0
    # lit if one pixel stands out from the noise, or if the typical sum of a pattern does
    lit = bool(table.peak > 6 * dark.noise) or usual > 3 * dark.noise * math.sqrt(table.lit.size)
    steps = _steps(patterns, dark, workers) if lit else None
    plane = _unmeasured(patterns, context, table, lit, usual, _faulty(context, table, steps, unread, usual))
    yield clock.at(done + 3)
    if steps is not None:
        plane = _with_light(plane)
        yield clock.at(done + 4)
        shown, cut_off = _diameter(plane), plane.edges.cut_off
        found = measure_positions(patterns, table, plane.use, context.waves, shown, workers, cut_off=cut_off)
        plane = replace(plane, positions=found)
        yield clock.at(done + 5)
        plane = replace(plane, continuity=_continuity(plane, steps), sample=_sample(patterns, table.floor))
    yield clock.at(done + PASSES)
    return plane


def _unmeasured(
    patterns: NDArray[np.float32],
    context: PlaneContext,
    table: PatternTable,
    lit: bool,
    energy: float,
    faulty: Faulty,
) -> PlaneMeasures:
    """Return the measurements of a plane that are known without any light in it; the others are unknown."""
    blank = np.full(faulty.missing.shape, np.nan)
    return PlaneMeasures(
        about=context,
        patterns=patterns,
        table=table,
        lit=lit,
        energy=energy,
        faulty=faulty,
        shares=blank,
        shares_split=Parts(math.nan, (0.0, 0.0), (0.0, 0.0), blank, blank),
        edges=EdgeLight(),
        spread=math.nan,
        positions=Positions(),
        continuity=None,
        sample=np.empty(0, np.float32),
    )


def _faulty(
    context: PlaneContext,
    table: PatternTable,
    steps: NDArray[np.float64] | None,
    unread: NDArray[np.bool_],
    usual: float,
) -> Faulty:
    """Return the positions of missing, NaN and duplicate frames; ``steps`` is None in a plane without light."""
    nonfinite = table.column("nonfinite") > 0
    # in a dark plane every frame is dim, which says nothing about single frames
    dim = unread | (table.light < DARK_FRAME * usual) if steps is not None else np.zeros_like(nonfinite)
    missing = ((context.matrix.recorded[context.z] == 0) | dim) & ~nonfinite
    duplicates = (
        np.zeros_like(missing)
        if steps is None
        else _duplicates(table, steps, ~(missing | nonfinite), copied_positions(context.matrix)[context.z])
    )
    return Faulty(missing, nonfinite, duplicates)


def _step_by_numpy(
    a: NDArray[np.float32], b: NDArray[np.float32], rows: int, columns: int, out: NDArray[np.float64]
) -> None:
    """Compute the sums of `step_pass` with numpy."""
    u, v = a[rows:, columns:], b[: b.shape[0] - rows, : b.shape[1] - columns]
    # products first: their sums are then alike for equal patterns, wherever these are in memory
    out[:] = [(one * other).sum(dtype=np.float64) for one, other in ((u, u), (v, v), (u, v))]


def _steps(plane: NDArray[np.float32], dark: DarkCorners, workers: int | None) -> NDArray[np.float64]:
    """Return the difference between each pattern and the next along y and x, wrapping, ``(2, ny, nx)``.

    This is 1 minus the correlation after the cutout's move, with noise removed from the norms. It is 0 only for
    identical frames, and otherwise at least the contribution of noise.
    """
    ny, nx, nt, ns = plane.shape
    products = np.empty((2, ny, nx, 3))
    add = _step_by_numpy if step_pass.spared(STEP_S * plane.size) else step_pass

    def rows(start: int, stop: int) -> None:
        for y in range(start, stop):
            for x in range(nx):
                add(plane[y, x], plane[(y + 1) % ny, x], 1, 0, products[0, y, x])
                add(plane[y, x], plane[y, (x + 1) % nx], 0, 1, products[1, y, x])

    for_each_chunk(rows, ny, workers)
    variance = dark.noise**2
    noise = variance * np.array([(nt - 1) * ns, nt * (ns - 1)])[:, None, None]
    aa, bb, ab = np.moveaxis(products, -1, 0)
    # noise adds to the sums of squares, and would make equal patterns look different
    norms = np.sqrt(np.maximum(aa - noise, 1e-150)) * np.sqrt(np.maximum(bb - noise, 1e-150))
    chance = np.sqrt(variance * (aa + bb) + variance * noise) / norms
    unlike = np.maximum(1 - ab / norms, np.maximum(chance, 1e-9))
    # patterns that are equal to the last bit are copies, because noise never repeats
    same = (aa == bb) & (aa == ab)
    return np.where(same, 0.0, unlike)


def _duplicates(
    table: PatternTable, steps: NDArray[np.float64], ok: NDArray[np.bool_], copied: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return a mask of the frames that are identical to another, or identical except for the motion of the cutout.

    Patterns that are intentionally ``copied`` from another position do not count as frames.
    """
    # checksums find copies anywhere in the plane, steps only copies of neighbours
    _, inverse = np.unique(table.digest.ravel(), return_inverse=True)
    counts = np.bincount(inverse, weights=~copied.ravel())
    same: NDArray[np.bool_] = (counts[inverse] > 1).reshape(ok.shape) & ok & ~copied
    for axis in (0, 1):
        if steps.shape[1 + axis] > 1:
            still = (steps[axis] == 0) & ok & np.roll(ok, -1, axis)
            same |= still | np.roll(still, 1, axis)
    return same


def _with_light(plane: PlaneMeasures) -> PlaneMeasures:
    """Add the energies over positions, and the measurements of the depth-plane sum."""
    light = plane.table.light
    # if patterns have no light in total, shares are undefined
    shares = 100 * light / plane.energy if plane.energy > 0 else np.full(light.shape, np.nan)
    shown = _background_free(plane)
    edges = edge_light(shown, plane.dark.noise * math.sqrt(shares.size), plane.about.expected)
    # a cut-off sum has lost its outer light, so its second moment is wrong
    spread = spread_of(shown) if edges.truncation < 2 else math.nan
    return replace(plane, shares=shares, shares_split=split(shares, plane.use), edges=edges, spread=spread)


def _background_free(plane: PlaneMeasures) -> NDArray[np.float64]:
    shown: NDArray[np.float64] = plane.about.depth_sum - plane.faulty.missing.size * plane.background
    return shown


def _diameter(plane: PlaneMeasures) -> float:
    return diameter_of(_background_free(plane))


def _continuity(plane: PlaneMeasures, steps: NDArray[np.float64]) -> Continuity | None:
    if not plane.positions.as_planned:
        return None
    # misplaced frames are reported separately; otherwise they would also be reported as unusual
    wrong = plane.positions.misplaced
    use = plane.use if wrong is None else plane.use & ~wrong
    slip = _slip(plane, use)
    return Continuity(seam_ratio(steps, use, slip), odd_frames(steps, use))


def _slip(plane: PlaneMeasures, use: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the change across the wrap along y and x ``(2, 2)`` due to rounding of the period to whole pixels.

    For each axis, two values are returned. The first is the root of 1 minus the correlation of patterns with their
    copies displaced by the difference between period and lattice. The second is the length of this displacement in
    steps.
    """
    ny, nx = plane.patterns.shape[:2]
    waves = plane.about.waves
    found = np.zeros((2, 2))
    places = np.argwhere(use)
    some = places[np.linspace(0, len(places) - 1, min(SLIPPED, len(places))).astype(int)] if len(places) else places
    frames = np.maximum(plane.patterns[tuple(some.T)] - np.float32(plane.table.floor), np.float32(0))
    for axis, period in enumerate(((0.0, ny), (nx, 0.0))):  # as (x, y)
        turn = waves @ np.array(period, np.float64)
        missed = np.linalg.pinv(waves) @ (turn - 2 * math.pi * np.rint(turn / (2 * math.pi)))
        found[axis] = unlike_displaced(frames, missed[::-1]), float(np.hypot(*missed))
    return found


def _sample(plane: NDArray[np.float32], floor: float) -> NDArray[np.float32]:
    """Return some complete patterns, without dark pixels, for comparison with other planes."""
    ny, nx = plane.shape[:2]
    # a fixed seed gives the same positions in every plane, so that planes can be compared
    rng = np.random.default_rng(1)
    chosen = rng.choice(ny * nx, min(16, ny * nx), replace=False)
    y, x = np.divmod(np.sort(chosen), nx)
    values = plane[y, x]
    # a NaN pixel would make every product with it NaN
    values[~np.isfinite(values)] = 0
    kept: NDArray[np.float32] = np.maximum(values - np.float32(floor), np.float32(0)).ravel()
    return kept
