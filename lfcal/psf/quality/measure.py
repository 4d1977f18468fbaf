"""Everything that one depth plane tells of its quality, in one pass over its patterns."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfcal.progress import Clock, Work
from lfcal.psf.aperture import Aperture
from lfcal.psf.quality import sums
from lfcal.psf.quality.dark import Dark, dark_corners
from lfcal.psf.quality.field import Parts, split
from lfcal.psf.quality.kernels import FRAME_COLUMNS, frame_pass, step_pass
from lfcal.psf.quality.lattice import ORDERS, SpotLattice, displacements, find_spots
from lfcal.psf.quality.steps import odd_frames, seam_ratio
from lfcal.threads import for_each_chunk

__all__ = ["PlaneContext", "PlaneMeasures", "iter_measure"]

DARK_FRAME = 0.2
"""A pattern with less than this share of the median energy is missing."""

MISPLACED = 0.5
"""Displacement of a frame's pattern that is too much (pixels)."""

CUT_OFF = 10.0
"""Truncation beyond which the corners are no measure of darkness (per cent)."""

NOISELESS = 3000.0
"""Peak over noise beyond which a matrix was computed, not recorded: equal peaks are no sign of saturation."""

STAGES = 6


@dataclass(frozen=True, slots=True)
class PlaneContext:
    """What is known of a plane before its patterns are read.

    Attributes
    ----------
    depth_sum
        Sum of its patterns ``(nt, ns)``.
    aperture
        The iris fitted to it.
    waves
        Wave vectors of the lenslet lattice, see `lfcal.psf.quality.lattice.wave_vectors`.
    recorded
        How often each position was recorded ``(ny, nx)``.
    saturated
        Saturated pixels of each frame ``(ny, nx)``, where counted.
    """

    depth_sum: NDArray[np.float64]
    aperture: Aperture
    waves: NDArray[np.float64]
    recorded: NDArray[np.uint16]
    saturated: NDArray[np.uint32] | None = None


@dataclass(slots=True)
class PlaneMeasures:
    """What was measured of a plane.

    Attributes
    ----------
    values
        Value by metric key; a metric that could not be measured is absent.
    maps
        Value per position ``(ny, nx)`` by metric key.
    named
        Positions a metric names, ``(ny, nx)`` flags by metric key.
    details
        Words by metric key.
    lit
        Whether there is light in the plane.
    energy
        Mean energy of a good pattern.
    spread
        Second moment of the depth-plane sum (pixels squared); NaN where it cannot be relied on.
    spots
        The spots' lattice, where there is one.
    sample
        Some of the patterns, weighted for comparison with other planes.
    """

    lit: bool
    energy: float
    peak: float
    dark: Dark
    aperture: Aperture
    spread: float = math.nan
    spots: SpotLattice | None = None
    sample: NDArray[np.float32] = field(default_factory=lambda: np.empty(0, np.float32))
    values: dict[str, float] = field(default_factory=dict)
    maps: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    named: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    details: dict[str, str] = field(default_factory=dict)


def iter_measure(
    plane: NDArray[np.float32], context: PlaneContext, clock: Clock, done: int, workers: int | None = None
) -> Work[PlaneMeasures]:
    """Measure plane ``(ny, nx, nt, ns)``; yields `STAGES` records from ``done`` on."""
    dark = dark_corners(plane)
    yield clock.at(done + 1)
    frames = _Frames.of(plane, dark, workers)
    yield clock.at(done + 2)
    energies = frames.column("energy")
    bad = (frames.column("nonfinite") > 0) | (frames.column("lit") == 0)
    energies = energies - dark.background * frames.lit.size
    usual = float(np.median(energies[~bad])) if (~bad).any() else 0.0
    lit = bool(frames.peak > 6 * dark.noise) or usual > 3 * dark.noise * math.sqrt(frames.lit.size)
    measures = PlaneMeasures(lit, usual, frames.peak, dark, context.aperture)
    _count_bad(measures, frames, context, bad | (energies < DARK_FRAME * usual) if lit else np.zeros_like(bad))
    if lit:
        steps = _steps(plane, dark, workers)
        _duplicates(measures, frames, steps)
        use = ~np.logical_or.reduce([measures.named[k] for k in ("missing", "nonfinite", "duplicates")])
        yield clock.at(done + 3)
        _light(measures, frames, context, use)
        _sums(measures, frames, context)
        yield clock.at(done + 4)
        _positions(measures, plane, frames, context, use, workers)
        yield clock.at(done + 5)
        if measures.values.get("scan_order", 0) == 0:
            _tiling(measures, steps, use & ~measures.named.get("misplaced", np.zeros_like(use)))
        measures.sample = _sample(plane, frames.floor)
    yield clock.at(done + STAGES)
    return measures


@dataclass(frozen=True, slots=True)
class _Frames:
    """The table of `frame_pass` over a plane, with its maps of lit pixels."""

    table: NDArray[np.float64]
    digest: NDArray[np.uint64]
    lit: NDArray[np.int32]
    sensor: NDArray[np.int32]
    floor: float
    peak: float
    tolerance: float

    @staticmethod
    def of(plane: NDArray[np.float32], dark: Dark, workers: int | None) -> _Frames:
        ny, nx, nt, ns = plane.shape
        every = max(1, ny * nx // 64)
        tops = np.nanmax(np.where(np.isfinite(plane.reshape(ny * nx, -1)[::every]), plane.reshape(ny * nx, -1)[::every],
                                  -np.inf), axis=1)  # fmt: skip
        peak = float(np.median(tops)) - dark.background
        floor = dark.background + max(4 * dark.noise, 0.003 * peak)
        tolerance = 0.25 * dark.noise
        table = np.zeros((ny, nx, len(FRAME_COLUMNS)))
        digest = np.zeros((ny, nx), np.uint64)

        def rows(start: int, stop: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
            lit = np.zeros((nt, ns), np.int32)
            sensor = np.zeros((nt + ny - 1, ns + nx - 1), np.int32)
            for y in range(start, stop):
                bits = plane[y].view(np.uint32)
                frame_pass(plane[y], bits, floor, tolerance, table[y], digest[y], lit, sensor[y : y + nt])
            return lit, sensor

        parts = for_each_chunk(rows, ny, workers, parts_per_worker=2)
        lit = np.stack([p[0] for p in parts]).sum(0, dtype=np.int32)
        sensor = np.stack([p[1] for p in parts]).sum(0, dtype=np.int32)
        return _Frames(table, digest, lit, sensor, floor, peak, tolerance)

    def column(self, name: str) -> NDArray[np.float64]:
        return self.table[..., FRAME_COLUMNS.index(name)]


def _count_bad(measures: PlaneMeasures, frames: _Frames, context: PlaneContext, dim: NDArray[np.bool_]) -> None:
    """Missing frames and pixels that are no number."""
    nonfinite = frames.column("nonfinite")
    measures.values["nonfinite"] = float(nonfinite.sum())
    measures.named["nonfinite"] = nonfinite > 0
    measures.maps["nonfinite"] = nonfinite
    missing = ((context.recorded == 0) | dim) & (nonfinite == 0)
    measures.values["missing"] = float(missing.sum())
    measures.named["missing"] = missing
    measures.maps["missing"] = missing.astype(float)


def _steps(plane: NDArray[np.float32], dark: Dark, workers: int | None) -> NDArray[np.float64]:
    """Return how unlike each pattern and the next along y and x are, wrapping, ``(2, ny, nx)``.

    One less the correlation after the cutout's move, the noise taken out of the norms; 0 for the very same frame
    alone, else at least what noise makes of it.
    """
    ny, nx, nt, ns = plane.shape
    sums = np.empty((2, ny, nx, 3))

    def rows(start: int, stop: int) -> None:
        for y in range(start, stop):
            for x in range(nx):
                step_pass(plane[y, x], plane[(y + 1) % ny, x], 1, 0, sums[0, y, x])
                step_pass(plane[y, x], plane[y, (x + 1) % nx], 0, 1, sums[1, y, x])

    for_each_chunk(rows, ny, workers)
    variance = dark.noise**2
    noise = variance * np.array([(nt - 1) * ns, nt * (ns - 1)])[:, None, None]
    aa, bb, ab = np.moveaxis(sums, -1, 0)
    norms = np.sqrt(np.maximum(aa - noise, 1e-150)) * np.sqrt(np.maximum(bb - noise, 1e-150))
    chance = np.sqrt(variance * (aa + bb) + variance * noise) / norms
    unlike = np.maximum(1 - ab / norms, np.maximum(chance, 1e-9))
    same = (aa == bb) & (aa == ab)
    return np.where(same, 0.0, unlike)


def _duplicates(measures: PlaneMeasures, frames: _Frames, steps: NDArray[np.float64]) -> None:
    """Frames that are the same, or the same but for the cutout's move."""
    ok = ~(measures.named["missing"] | measures.named["nonfinite"])
    _, inverse, counts = np.unique(frames.digest.ravel(), return_inverse=True, return_counts=True)
    same = (counts[inverse] > 1).reshape(ok.shape) & ok
    for axis in (0, 1):
        if steps.shape[1 + axis] > 1:
            still = (steps[axis] == 0) & ok & np.roll(ok, -1, axis)
            same |= still | np.roll(still, 1, axis)
    measures.values["duplicates"] = float(same.sum())
    measures.named["duplicates"] = same
    measures.maps["duplicates"] = same.astype(float)


def _light(measures: PlaneMeasures, frames: _Frames, context: PlaneContext, use: NDArray[np.bool_]) -> None:
    """Noise, background, saturation, and the energy over positions."""
    dark, values = measures.dark, measures.values
    values["snr"] = frames.peak / dark.noise if dark.noise > 0 else math.inf
    pixels = frames.lit.size
    sure = math.sqrt(max(0.0, dark.background**2 - (2 * dark.chance) ** 2))
    values["background"] = 100 * sure * pixels / max(measures.energy, 1e-300)
    values["clipped"] = 100 * dark.clipped
    energy = (frames.column("energy") - dark.background * pixels) / max(measures.energy, 1e-300)
    parts = split(100 * energy, use)
    values["lamp"] = max(parts.sure_ramp(0), parts.sure_ramp(1))
    values["flicker"] = parts.rms
    measures.maps["flicker"] = parts.residual
    measures.maps["lamp"] = 100 * energy
    if context.saturated is not None:
        piled = context.saturated.astype(float)
    elif frames.peak < NOISELESS * dark.noise:
        top = frames.column("top")
        highest = float(top[use].max()) if use.any() else math.inf
        piled = np.where(top >= highest - frames.tolerance, frames.column("clipped") - 1, 0.0)
    else:
        return
    values["saturation"] = float(piled.sum())
    measures.maps["saturation"] = piled
    measures.named["saturation"] = piled > 0


def _sums(measures: PlaneMeasures, frames: _Frames, context: PlaneContext) -> None:
    """Read the depth-plane sum and the maps of lit pixels."""
    n = measures.named["missing"].size
    shown = context.depth_sum - n * measures.dark.background
    measures.values |= sums.edges_and_leaks(shown, measures.dark.noise * math.sqrt(n))
    if measures.values.get("truncation", math.inf) < 2:
        measures.spread = sums.spread(shown)
    measures.values["centring"] = sums.off_centre(shown, measures.aperture)
    hot = sums.stuck_pixels(frames.lit, np.full(frames.lit.shape, n))
    hot += sums.stuck_pixels(frames.sensor, sums.coverage(frames.table.shape[:2], frames.lit.shape))
    measures.values["hot_pixels"] = float(hot)
    if measures.values.get("truncation", 0) > CUT_OFF:  # the corners are not dark: nothing follows from them
        for key in ("background", "clipped"):
            measures.values.pop(key, None)
    total = float(frames.column("energy").sum())
    measures.values["identities"] = abs(float(context.depth_sum.sum()) - total) / max(abs(total), 1e-300)


def _positions(
    measures: PlaneMeasures,
    plane: NDArray[np.float32],
    frames: _Frames,
    context: PlaneContext,
    use: NDArray[np.bool_],
    workers: int | None,
) -> None:
    """Where the patterns are: by the phase of the lenslet lattice, and by their centroids."""
    diameter = sums.diameter(context.depth_sum - use.size * measures.dark.background)
    spots = find_spots(plane, use, frames.floor, context.waves, diameter, workers)
    if spots is None or not spots.usable:
        return
    measures.spots = spots
    values, maps = measures.values, measures.maps
    values["scan_order"] = float(spots.order != "as planned")
    measures.details["scan_order"] = ORDERS[spots.order]
    move = [split(frames.column(name), use) for name in ("row", "column")]
    noise = measures.dark.noise * np.sqrt(frames.column("spread")[use]) / frames.column("weight")[use]
    known = float(np.mean(noise**2))
    away = np.hypot(move[0].residual, move[1].residual)
    swing = max(part.alternation for part in move)
    values["backlash"] = swing
    values["stage_gain"] = max(move[0].sure_ramp(0), move[1].sure_ramp(1))
    values["drift"] = max(move[0].sure_ramp(1), move[1].sure_ramp(0))
    maps["jitter"] = maps["backlash"] = away
    path = np.hypot(*(frames.column(name) - np.median(frames.column(name)[use]) for name in ("row", "column")))
    maps["stage_gain"] = maps["drift"] = path
    wrong = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in move)))
    if spots.order == "as planned":
        wrong |= _phases(measures, displacements(plane, spots, frames.floor, workers), use)
    measures.named["misplaced"] = wrong & use
    values["misplaced"] = float(measures.named["misplaced"].sum())
    placed = use & ~wrong
    if placed.any():
        rms = math.hypot(*(float(np.sqrt(np.mean(p.residual[placed] ** 2))) for p in move))
        values["jitter"] = math.sqrt(max(0.0, rms**2 - known - swing**2))


def _phases(measures: PlaneMeasures, shift: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Measure the lattice's phases; return which positions are misplaced by them."""
    parts: list[Parts] = [split(s, use) for s in shift]
    away = np.hypot(parts[0].residual, parts[1].residual)
    wrong: NDArray[np.bool_] = away > max(MISPLACED, 8 * math.hypot(*(p.spread for p in parts)))
    placed = use & ~wrong
    if placed.any():
        measures.values["position"] = float(np.sqrt(np.mean(away[placed] ** 2)))
    measures.values["pitch"] = max(p.sure_ramp(axis) for p in parts for axis in (0, 1))
    measures.maps["position"] = measures.maps["misplaced"] = away
    measures.maps["pitch"] = np.hypot(*shift)
    return wrong


def _tiling(measures: PlaneMeasures, steps: NDArray[np.float64], use: NDArray[np.bool_]) -> None:
    """Measure whether the cell tiles and each frame fits between its neighbours."""
    measures.values["seam"] = seam_ratio(steps, use)
    odd = odd_frames(steps, use)
    measures.values["step"] = float(np.nanmax(odd)) if np.isfinite(odd).any() else math.nan
    measures.maps["step"] = measures.maps["seam"] = odd
    measures.named["step"] = odd > 4.0


def _sample(plane: NDArray[np.float32], floor: float) -> NDArray[np.float32]:
    """Return some whole patterns, dark pixels removed, to hold against other planes."""
    ny, nx = plane.shape[:2]
    rng = np.random.default_rng(1)
    chosen = rng.choice(ny * nx, min(16, ny * nx), replace=False)
    y, x = np.divmod(np.sort(chosen), nx)
    values = np.nan_to_num(plane[y, x], nan=0.0, posinf=0.0, neginf=0.0)
    kept: NDArray[np.float32] = np.maximum(values - np.float32(floor), np.float32(0)).ravel()
    return kept
