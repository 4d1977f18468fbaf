"""Patterns expected from the camera, computed for the apparent sources, cutouts and planes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft as sf
from scipy.ndimage import shift

from lfcal.base import InputError
from lfcal.fit import Fineness, PlaneModel, Setup
from lfcal.judge.expected import Behind
from lfcal.simulate.engines import EnergyError

__all__ = [
    "NEAR_ARRAY",
    "REACH_PX",
    "Starts",
    "best_alike",
    "correlation",
    "cut",
    "depths_seen",
    "modelled",
    "parts",
    "plane_of",
    "windows_seen",
]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Flags = NDArray[np.bool_]

SOME = 5
"""Number of patterns, spread over a plane, with which its depth is searched for."""

STEP_PX = 0.2
"""Displacement of the source with which derivatives with respect to its position are computed (pixels)."""

STEP_DEPTH = 0.01
"""Relative change of the virtual depth with which derivatives with respect to it are computed."""

FAR_PX, FAR_DEPTH = 0.2, 0.005
"""Displacement (pixels) and relative change of depth above which derivatives are computed again."""

REACH_PX = 0.95
"""Largest displacement of sources that models follow (pixels)."""

POOR, CLEARLY = 0.9, 0.05
"""Correlation below which another depth or position is searched for, and the required improvement."""

DEPTHS = (0.75, 0.8, 0.85, 0.9, 0.94, 0.97, 1.03, 1.06, 1.1, 1.15, 1.2, 1.3, 1.4)
"""Virtual depths that are tried, relative to the stated one."""

NEAR_ARRAY = 0.1
"""Virtual depth below which changes are absolute instead of relative."""

MOST_OF = 0.3
"""Fraction of the patterns of a plane that must show a displacement for all of them to be moved."""

WINDOW_PX = 6
"""Largest displacement of cutouts that is searched for (pixels)."""


@dataclass(frozen=True, eq=False)
class Starts:
    """Parameters of the models.

    These are the displacements of sources and cutouts ``(n, 2)`` (px), and the relative changes of the virtual depths
    of the planes ``(nz,)`` (absolute near 0).
    """

    source: F8
    window: F8
    depth: F8

    @classmethod
    def none(cls, count: int, planes: int) -> Starts:
        """Return the parameters without displacements or changes of depth."""
        return cls(np.zeros((count, 2)), np.zeros((count, 2)), np.zeros(planes))

    def of(self, part: NDArray[np.intp]) -> Starts:
        """Return the parameters of a subset of the patterns."""
        return Starts(self.source[part], self.window[part], self.depth)

    def column(self, name: str, planes: NDArray[np.intp]) -> F8:
        """Return the start ``(n,)`` of the parameter ``name`` of `COLUMNS`; 0 for parameters without a start."""
        if name == "depth":
            found: F8 = self.depth[planes]
            return found
        kind, _, axis = name.partition("_")
        if kind not in ("source", "window"):
            return np.zeros(len(planes))
        both: F8 = getattr(self, kind)
        return both[:, "yx".index(axis)]

    def nearer(self, values: F8, planes: NDArray[np.intp]) -> Starts:
        """Return the starts moved to fitted values ``(n, 7)``, by pattern for positions and by plane for depths."""
        source = np.clip(self.source + np.clip(values[:, 2:4], -1, 1), -REACH_PX, REACH_PX)
        window = self.window + np.clip(values[:, 4:6], -1, 1)
        depth = self.depth.copy()
        for z in np.unique(planes):
            depth[z] += float(np.clip(np.median(values[planes == z, 6]), -0.05, 0.05))
        return Starts(source, window, depth)

    def only(self, moved: Starts, again: Flags) -> Starts:
        """Return these starts, with the starts of ``moved`` for the patterns ``again`` and for planes far off.

        All other patterns keep their model, and the parameters with which it was computed.
        """
        far = np.abs(moved.depth - self.depth) > FAR_DEPTH
        return Starts(
            np.where(again[:, None], moved.source, self.source),
            np.where(again[:, None], moved.window, self.window),
            np.where(far, moved.depth, self.depth),
        )

    def apart_from(self, other: Starts, planes: NDArray[np.intp]) -> Flags:
        """Return a mask ``(n,)`` of the patterns that are too far from their model, which must be computed again."""
        moved = np.maximum(np.abs(self.source - other.source), np.abs(self.window - other.window)).max(1)
        found: Flags = (moved > FAR_PX) | (np.abs(self.depth - other.depth)[planes] > FAR_DEPTH)
        return found


def parts(index: NDArray[np.intp], which: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Return the patterns ``which`` plane by plane, in batches."""
    found = []
    for z in np.unique(index[which, 0]).tolist():
        own = which[index[which, 0] == z]
        found += np.array_split(own, max(1, len(own) // 32))
    return found


def modelled(known: Behind, index: NDArray[np.intp], starts: Starts | None = None) -> tuple[F4, F4]:
    """Return predicted patterns ``(n, nt, ns)`` of positions ``(n, 3)`` and their derivatives ``(n, 5, nt, ns)``.

    The derivatives are, in this order, with respect to the source (y, x) and the cutout (y, x) in pixels, and to the
    relative virtual depth (absolute near 0). They are 0 for the depth if the model has no deeper plane.
    """
    starts = starts or Starts.none(len(index), known.plan.shape[0])
    model = np.empty((len(index), *known.plan.cutout), np.float32)
    columns = np.zeros((len(index), 5, *known.plan.cutout), np.float32)
    for z in np.unique(index[:, 0]).tolist():
        own = np.flatnonzero(index[:, 0] == z)
        places, source, window = index[own, 1:], starts.source[own], starts.window[own]
        plane = plane_of(known, z, float(starts.depth[z]))

        def seen(at: F8, plane: PlaneModel = plane, places: NDArray[np.intp] = places, by: F8 = window) -> F4:
            return cut(plane.patterns(places, at), by)

        model[own] = seen(source)
        for k in (0, 1):
            aside = np.zeros((len(own), 2))
            aside[:, k] = STEP_PX
            columns[own, k] = (seen(source + aside) - seen(source - aside)) / (2 * STEP_PX)
            # in a cutout that is too far down, the light appears too far up
            columns[own, 2 + k] = np.gradient(model[own], axis=1 + k)
        try:
            further = plane_of(known, z, float(starts.depth[z]) + STEP_DEPTH)
        except (InputError, EnergyError):
            continue
        columns[own, 4] = (cut(further.patterns(places, source), window) - model[own]) / np.float32(STEP_DEPTH)
    return model, columns


def plane_of(known: Behind, z: int, share: float) -> PlaneModel:
    """Return the model of a plane with its virtual depth increased by ``share``: relative, or absolute near 0."""
    if share == 0.0:
        return PlaneModel(known.setup, known.plan, z, Fineness.coarse)
    camera, planned = known.plan.camera, float(known.plan.depths_um[z])
    v = camera.virtual_depth(planned)
    errors = list(known.setup.depth_errors_um)
    errors[z] += camera.depth_of(v + share * (v if abs(v) > NEAR_ARRAY else 1.0)) - planned
    setup: Setup = replace(known.setup, depth_errors_um=tuple(errors))
    return PlaneModel(setup, known.plan, z, Fineness.coarse)


def cut(patterns: F4, windows: F8) -> F4:
    """Return patterns as they appear in cutouts displaced by ``(n, 2)`` pixels down and across."""
    if not windows.any():
        return patterns
    return np.stack(
        [shift(p, -w, order=3, mode="constant") if w.any() else p for p, w in zip(patterns, windows, strict=True)]
    )


def correlation(a: F4, b: F4) -> F8:
    """Return the correlation of each pair of patterns ``(n, nt, ns)``, in the shape ``(n,)``."""
    both = (a * b).sum((1, 2), dtype=np.float64)
    sizes = np.square(a).sum((1, 2), dtype=np.float64) * np.square(b).sum((1, 2), dtype=np.float64)
    found: F8 = both / np.sqrt(np.maximum(sizes, 1e-300))
    return found


def depths_seen(known: Behind, index: NDArray[np.intp], data: F4) -> F8:
    """Return the apparent errors of the virtual depths of the planes, as fractions of the depths; usually 0."""
    found = np.zeros(known.plan.shape[0])
    for z in np.unique(index[:, 0]).tolist():
        own = np.flatnonzero(index[:, 0] == z)
        some = own[np.linspace(0, len(own) - 1, min(SOME, len(own))).astype(int)]
        places, still = index[some, 1:], np.zeros((len(some), 2))
        best = best_alike(data[some], plane_of(known, z, 0.0).patterns(places, still))
        if best > POOR:
            continue
        best += CLEARLY
        for share in (*(ratio - 1.0 for ratio in DEPTHS), *_of_other_planes(known, z)):
            try:
                alike = best_alike(data[some], plane_of(known, z, share).patterns(places, still))
            except (InputError, EnergyError):
                continue
            if alike > best:
                best, found[z] = alike, share
    return found


def _of_other_planes(known: Behind, z: int) -> list[float]:
    """Return the depths of neighbouring planes, and of the plane with the mirrored index, as relative changes."""
    depths = known.plan.depths_um
    own = known.plan.camera.virtual_depth(float(depths[z]))
    others = sorted({z - 2, z - 1, z + 1, z + 2, len(depths) - 1 - z} & set(range(len(depths))) - {z})
    there = (known.plan.camera.virtual_depth(float(depths[k])) for k in others)
    return [(v - own) / (own if abs(own) > NEAR_ARRAY else 1.0) for v in there]


def best_alike(data: F4, models: F4) -> float:
    """Return the median correlation of patterns with their models, each at the best displacement of its cutout."""
    return float(np.median([_displaced(a, b).max() for a, b in zip(data, models, strict=True)]))


def windows_seen(index: NDArray[np.intp], data: F4, model: F4) -> F8:
    """Return the apparent displacements of cutouts in whole pixels ``(n, 2)``; usually 0."""
    found = np.zeros((len(data), 2))
    poor = np.flatnonzero(correlation(data, model) < POOR)
    tops = {k: _displaced(data[k], model[k]) for k in poor.tolist()}
    for k, top in tops.items():
        at = np.unravel_index(int(np.argmax(top)), top.shape)
        if top[at] - top[WINDOW_PX, WINDOW_PX] > CLEARLY:
            found[k] = np.array(at) - WINDOW_PX
    # a displaced plane moves as a whole, and patterns with little information follow the others
    for z in np.unique(index[poor, 0]).tolist():
        own = np.flatnonzero(index[:, 0] == z)
        moves, counts = np.unique(found[own], axis=0, return_counts=True)
        best = moves[int(np.argmax(counts * moves.any(1)))]
        if not best.any() or (found[own] == best).all(1).mean() < MOST_OF:
            continue
        at = tuple(best.astype(int) + WINDOW_PX)
        for k in own.tolist():
            top = tops[k] if k in tops else _displaced(data[k], model[k])
            if top[at] > top[WINDOW_PX, WINDOW_PX]:
                found[k] = best
    return found


def _displaced(data: F4, model: F4) -> F8:
    """Return the correlation of a pattern with its model for displacements of up to `WINDOW_PX` in each direction."""
    shape = tuple(sf.next_fast_len(n + WINDOW_PX, real=True) for n in data.shape)
    top = sf.irfft2(sf.rfft2(model, shape) * np.conj(sf.rfft2(data, shape)), shape)
    near = np.roll(top, (WINDOW_PX, WINDOW_PX), (0, 1))[: 2 * WINDOW_PX + 1, : 2 * WINDOW_PX + 1]
    norm = math.sqrt(float(np.square(model).sum()) * float(np.square(data).sum())) or 1.0
    found: F8 = near.astype(np.float64) / norm
    return found
