"""Everything that one depth plane tells of its quality, in one pass over its patterns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.progress import Clock, Work
from lfcal.psf.aperture import Aperture
from lfcal.psf.quality import sums
from lfcal.psf.quality.dark import Dark, dark_corners
from lfcal.psf.quality.field import split
from lfcal.psf.quality.frames import Frames, PlaneMeasures
from lfcal.psf.quality.kernels import step_pass
from lfcal.psf.quality.positions import measure_positions
from lfcal.psf.quality.steps import odd_frames, seam_ratio
from lfcal.threads import for_each_chunk

__all__ = ["STAGES", "PlaneContext", "iter_measure"]

DARK_FRAME = 0.2
"""A pattern with less than this share of the median energy is missing."""

CUT_OFF = 10.0
"""Truncation beyond which the corners are no measure of darkness (per cent)."""

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


def iter_measure(
    plane: NDArray[np.float32], context: PlaneContext, clock: Clock, done: int, workers: int | None = None
) -> Work[PlaneMeasures]:
    """Measure plane ``(ny, nx, nt, ns)``; yields `STAGES` records from ``done`` on."""
    dark = dark_corners(plane)
    yield clock.at(done + 1)
    frames = Frames.of(plane, dark, workers)
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
        measure_positions(measures, plane, frames, context.depth_sum, context.waves, use, workers)
        yield clock.at(done + 5)
        if measures.values.get("scan_order", 0) == 0:
            _tiling(measures, steps, use & ~measures.named.get("misplaced", np.zeros_like(use)))
        measures.sample = _sample(plane, frames.floor)
        if measures.locked:  # the lattice alone makes these vary
            for key in ("flicker", "step", "seam"):
                measures.values.pop(key, None)
                measures.named.pop(key, None)
    yield clock.at(done + STAGES)
    return measures


def _count_bad(measures: PlaneMeasures, frames: Frames, context: PlaneContext, dim: NDArray[np.bool_]) -> None:
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


def _duplicates(measures: PlaneMeasures, frames: Frames, steps: NDArray[np.float64]) -> None:
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


def _light(measures: PlaneMeasures, frames: Frames, context: PlaneContext, use: NDArray[np.bool_]) -> None:
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
    elif not frames.computed:
        top = frames.column("top")
        highest = float(top[use].max()) if use.any() else math.inf
        piled = np.where(top >= highest - frames.tolerance, frames.column("clipped") - 1, 0.0)
    else:
        return
    values["saturation"] = float(piled.sum())
    measures.maps["saturation"] = piled
    measures.named["saturation"] = piled > 0


def _sums(measures: PlaneMeasures, frames: Frames, context: PlaneContext) -> None:
    """Read the depth-plane sum and the maps of lit pixels."""
    n = measures.named["missing"].size
    shown = context.depth_sum - n * measures.dark.background
    measures.values |= sums.edges_and_leaks(shown, measures.dark.noise * math.sqrt(n))
    if measures.values.get("truncation", math.inf) < 2:
        measures.spread = sums.spread(shown)
    measures.values["centring"] = sums.off_centre(shown, measures.aperture)
    if not frames.computed:
        hot = sums.stuck_pixels(frames.lit, np.full(frames.lit.shape, n))
        hot += sums.stuck_pixels(frames.sensor, sums.coverage(frames.table.shape[:2], frames.lit.shape))
        measures.values["hot_pixels"] = float(hot)
    if measures.values.get("truncation", 0) > CUT_OFF:  # the corners are not dark: nothing follows from them
        for key in ("background", "clipped"):
            measures.values.pop(key, None)
    total = float(frames.column("energy").sum())
    measures.values["identities"] = abs(float(context.depth_sum.sum()) - total) / max(abs(total), 1e-300)


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
    values = plane[y, x]
    values[~np.isfinite(values)] = 0
    kept: NDArray[np.float32] = np.maximum(values - np.float32(floor), np.float32(0)).ravel()
    return kept
