"""Projector pair for an H that varies over the field: H of several regions, blended linearly.

Patterns change slowly over the field. Between positions with a known H, the pattern of a voxel is the weighted mean of
the surrounding patterns. The weights are linear between positions (the spatial variation of Nagy & O'Leary 1998, SIAM
J. Sci. Comput. 19, 1063). The weights belong to the emitting voxel, not to the pixel. The light of a voxel is thus the
weighted mean over the regions, and a pattern is unchanged if only one region has a weight there. The operator
``sum_r H_r W_r`` has the exact adjoint ``sum_r W_r HT_r``.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfcal.base import Clock, InputError, Work, format_bytes, free_memory, worker_count
from lfcal.psf import PSFMatrix
from lfcal.reconstruct.projectors._engine import Cost, DeviceUse
from lfcal.reconstruct.projectors._planes import PlaneReader
from lfcal.reconstruct.projectors._recipe import SEPARATOR
from lfcal.reconstruct.projectors.device import ArrayDevice, find_device
from lfcal.reconstruct.projectors.forecast import ProjectionForecast
from lfcal.reconstruct.projectors.grid import Grid, anchor_pixel
from lfcal.reconstruct.projectors.projector import Projector, _remade

__all__ = ["FieldProjector", "field_weights", "place_weights"]

F8 = NDArray[np.float64]
Pair = tuple[float, float]

NODES = 257
"""Number of places per axis at which weights are computed; between them, weights are linear."""

APART_PX = 1.0
"""Smallest distance between two regions (pixels)."""


def place_weights(middles: Sequence[Pair], points: F8) -> F8:
    """Return the weights ``(regions, n)`` of the regions at ``points``; they are at least 0 and sum to 1 at each point.

    Weights are linear within each triangle of neighbouring regions (Delaunay), or along the line if all regions are on
    one line. Outside the triangles, a point has the weights of the nearest point inside.

    Parameters
    ----------
    middles
        Positions (row, column) at which the H of the regions were recorded, ``(regions, 2)``.
    points
        Positions (row, column) at which to compute the weights, ``(n, 2)``.

    Raises
    ------
    InputError
        If two regions are less than `APART_PX` pixels apart.
    """
    # slow to import
    from scipy.spatial import ConvexHull, Delaunay

    places = np.asarray(middles, np.float64)
    _check_apart(places)
    if len(places) == 1:
        return np.ones((1, len(points)))
    centred = places - places.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    if len(places) == 2 or sizes[1] < APART_PX:
        return _along_line(centred @ axes[0], (points - places.mean(axis=0)) @ axes[0])
    mesh = Delaunay(places)
    found = mesh.find_simplex(points)
    weights = np.zeros((len(places), len(points)))
    inside = np.flatnonzero(found >= 0)
    corners, maps = mesh.simplices[found[inside]], mesh.transform[found[inside]]
    first = np.einsum("nij,nj->ni", maps[:, :2], points[inside] - maps[:, 2])
    share = np.column_stack([first, 1 - first.sum(axis=1)]).clip(0, 1)
    weights[corners, inside[:, None]] = share / share.sum(axis=1, keepdims=True)
    outside = np.flatnonzero(found < 0)
    weights[:, outside] = _on_hull(places, ConvexHull(places).simplices, points[outside])
    return weights


def _check_apart(places: F8) -> None:
    for k, place in enumerate(places):
        near = np.flatnonzero(np.hypot(*(places[:k] - place).T) < APART_PX)
        if near.size:
            raise InputError.expected(
                "regions of the field",
                "a different position for each",
                f"regions {near[0] + 1} and {k + 1} at the same position",
                "leave one out",
            )


def _along_line(at: F8, points: F8) -> F8:
    order = np.argsort(at)
    return np.array([np.interp(points, at[order], (order == k).astype(float)) for k in range(len(at))])


def _on_hull(places: F8, edges: NDArray[Any], points: F8) -> F8:
    """Return the weights at the nearest point of the outline."""
    weights = np.zeros((len(places), len(points)))
    best, every = np.full(len(points), np.inf), np.arange(len(points))
    chosen, along = np.zeros(len(points), np.intp), np.zeros(len(points))
    for k, (a, b) in enumerate(edges):
        side = places[b] - places[a]
        t = ((points - places[a]) @ side / (side @ side)).clip(0, 1)
        away = np.hypot(*(points - places[a] - t[:, None] * side).T)
        nearer = away < best
        best, chosen, along = np.where(nearer, away, best), np.where(nearer, k, chosen), np.where(nearer, t, along)
    weights[edges[chosen, 0], every] = 1 - along
    weights[edges[chosen, 1], every] = along
    return weights


def field_weights(middles: Sequence[Pair], shape: tuple[int, int]) -> list[F8]:
    """Return the weights of each region as an image of ``shape``; they sum to 1 at every pixel.

    ``middles`` are the centres of the regions as pixels (row, column) of the image. They may be outside the image.
    """
    nodes = [np.linspace(0, n - 1, min(n, NODES)) for n in shape]
    points = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    coarse = place_weights(middles, points).reshape(len(middles), len(nodes[0]), len(nodes[1]))
    down, across = (_between(n, len(at)) for n, at in zip(shape, nodes, strict=True))
    found = []
    for one in coarse:
        rows = one[down[0]] * (1 - down[1])[:, None] + one[down[0] + down[2]] * down[1][:, None]
        left, right = rows[:, across[0]], rows[:, across[0] + across[2]]
        found.append(left * (1 - across[1]) + right * across[1])
    return found


def _between(pixels: int, nodes: int) -> tuple[NDArray[np.intp], F8, int]:
    """Return for each pixel the node before it and the weight of the next node, and the step to that node (0 or 1)."""
    if nodes == 1:
        return np.zeros(pixels, np.intp), np.zeros(pixels), 0
    at: F8 = np.arange(pixels, dtype=np.float64) * ((nodes - 1) / max(1, pixels - 1))
    before: NDArray[np.intp] = np.minimum(at.astype(np.intp), nodes - 2)
    return before, at - before, 1


_Place = tuple[int, Any, tuple[int, ...], tuple[slice, slice], NDArray[Any] | None]
"""A region's number, its H, its anchor, its window, and the weights there."""


@dataclass(frozen=True, eq=False)
class _Part:
    """Contribution of a region: its projector on a window of the image, and the weight of each voxel there.

    ``region`` is the number of the region, from 0. ``weight`` is None if there is only one region.
    """

    region: int
    projector: Projector
    window: tuple[slice, slice]
    weight: NDArray[Any] | None

    def seen(self, planes: Iterator[tuple[int, NDArray[Any]]]) -> Iterator[tuple[int, NDArray[Any]]]:
        """Yield the indices of volume planes, and the planes in the window times the weights of this region."""
        for z, plane in planes:
            own = plane[self.window]
            yield z, own if self.weight is None else own * self.weight

    def reading(self, changes: Mapping[str, Any]) -> _Part:
        """Return the part that reads its H with other settings of `PlaneReader`; each region has different noise."""
        own, seed = dict(changes), changes.get("noise_seed")
        if seed is not None and self.region > 0:
            own["noise_seed"] = int(np.random.SeedSequence([seed, self.region]).generate_state(1)[0])
        return replace(self, projector=self.projector._reading(**own))


class FieldProjector(Projector):
    """Operator ``sum_r H_r W_r`` of several regions r of the field, and its exact adjoint ``sum_r W_r HT_r``.

    ``H_r`` is the H of region r. ``W_r`` weights voxels by their position relative to the centres of the regions
    (`field_weights`); the weights of a voxel sum to one. For one region, the operator equals that region's `Projector`
    exactly. Each region is projected only on the rectangle in which its weights are not zero. As these rectangles
    overlap, a projection with many regions takes several times as long as with one H (about six times in a test).

    Parameters
    ----------
    matrices
        H of each region; periods and planes must be the same, but cutouts may differ. The ``anchor`` of each H states
        the position of its region. As in the scan, the centre of the region is half a period below and to the right of
        the anchor. Patterns of neighbouring regions must not be displaced relative to each other. Over the distance of
        the regions, the difference between the array's pitch and the period must add up to less than a pixel.
    image_shape, method, dtype, threshold, tolerance, memory_limit, workers, phases, device
        As in `Projector`. The ``phases`` refer to the first H, and the regions share the memory of a device.
    anchor
        Pixel (row, column) of the image onto which position (0, 0) of the first H is imaged. None: the anchor of that
        H. The anchors of the other regions keep their distances from it.

    Raises
    ------
    InputError
        If there are no matrices, one is not a `PSFMatrix`, their periods or planes differ, or two have the same
        position; also as in `Projector`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.reconstruct import FieldProjector
    >>> left = PSFMatrix(np.full((1, 5, 5, 3, 3), 1 / 9), anchor=(8, 0))
    >>> right = PSFMatrix(np.full((1, 5, 5, 3, 3), 2 / 9), anchor=(8, 20))
    >>> light = FieldProjector([left, right], (20, 25)).adjoint(np.ones((20, 25)))
    >>> light[0, 10, [2, 12, 22]].round(3).tolist()  # middle of the left region, between, middle of the right one
    [1.0, 1.5, 2.0]
    """

    def __init__(
        self,
        matrices: Sequence[Any],
        image_shape: tuple[int, int],
        anchor: Pair | None = None,
        method: str = "auto",
        *,
        dtype: DTypeLike = np.float32,
        threshold: float = 0.0,
        tolerance: float = 0.0,
        memory_limit: int | None = None,
        workers: int | None = None,
        phases: ArrayLike | None = None,
        device: str | ArrayDevice = "cpu",
    ) -> None:
        self._matrices = tuple(matrices)
        _check_together(self._matrices)
        first = self._matrices[0]
        shape = (int(image_shape[0]), int(image_shape[1]))
        self._moved = (0.0, 0.0) if anchor is None else (anchor[0] - first.anchor[0], anchor[1] - first.anchor[1])
        # slightly more, so that rounding does not lose a pixel
        anchors = [
            anchor_pixel((H.anchor[0] + self._moved[0], H.anchor[1] + self._moved[1]), hair=1e-9)
            for H in self._matrices
        ]
        period = (int(first.shape[1]), int(first.shape[2]))
        self._settings: dict[str, Any] = {"dtype": dtype, "threshold": threshold, "tolerance": tolerance}
        self._tolerance = float(tolerance)
        self._reader = PlaneReader(first, np.dtype(dtype), threshold)
        self._grid = Grid(shape, period, (int(first.shape[3]), int(first.shape[4])), anchors[0])
        self._phases = None if phases is None else np.array(phases, np.bool_)
        self._workers = worker_count(workers)
        self._limit = free_memory() // 2 if memory_limit is None else int(memory_limit)
        middles = [(a[0] + (period[0] - 1) / 2, a[1] + (period[1] - 1) / 2) for a in anchors]
        self._parts = self._placed(device, anchors, field_weights(middles, shape), method)
        self._device = self._parts[0].projector.device
        self._engine = self._parts[0].projector._engine
        self._forecast = self._total()
        self._operands, self._subsets, self._lock = {}, {}, threading.RLock()
        self._quiet = None

    def _placed(
        self,
        device: str | ArrayDevice,
        anchors: Sequence[tuple[int, ...]],
        weights: Sequence[NDArray[Any]],
        method: str,
    ) -> list[_Part]:
        """Return the parts on a device; with ``auto``, on the processor if the device has too little memory."""
        found = find_device(device) if isinstance(device, str) else device
        if found is None:
            return self._made(anchors, weights, method)
        several = sum(bool(weight.any()) for weight in weights)
        shared = found if several == 1 else replace(found, room=found.free_bytes() // several)
        try:
            self._settings["device"] = shared
            return self._made(anchors, weights, method)
        except InputError:
            if device != "auto":
                raise
            self._settings["device"] = "cpu"
            return self._made(anchors, weights, method)

    def _made(self, anchors: Sequence[tuple[int, ...]], weights: Sequence[NDArray[Any]], method: str) -> list[_Part]:
        """Return the parts of regions that have a weight in the image, the largest first."""
        places: list[_Place] = []
        for k, (H, at, weight) in enumerate(zip(self._matrices, anchors, weights, strict=True)):
            if weight.any():
                window = _window(weight, (int(H.shape[3]), int(H.shape[4])))
                own = None if len(self._matrices) == 1 else np.ascontiguousarray(weight[window], self.dtype)
                places.append((k, H, at, window, own))
        places.sort(key=lambda place: -_pixels(place[3]))
        kept = sum(0 if weight is None else weight.nbytes for *_, weight in places)
        room = max(0, self._limit - kept - self._blending_bytes(len(places)))
        try:
            return self._built(places, anchors[0], method, room // len(places))
        except InputError:
            if len(places) == 1:
                raise
        # each region uses all the memory in turn, so planes cannot be kept
        parts = self._built(places, anchors[0], method, room)
        least = _together(
            [p.projector.forecast().chosen for p in parts], kept, self._blending_bytes(len(parts))
        ).memory_bytes
        if least > self._limit:
            raise InputError.expected(
                f"memory limit for the projection of {len(parts)} regions of the field",
                f"at least {format_bytes(least)}",
                format_bytes(self._limit),
                "increase the limit, or reconstruct a smaller part of the image",
            )
        return parts

    def _built(self, places: Sequence[_Place], first: tuple[int, ...], method: str, share: int) -> list[_Part]:
        """Return the projectors of regions, each within ``share`` bytes."""
        parts: list[_Part] = []
        recipes = method.split(SEPARATOR)
        if len(recipes) not in (1, len(places)):
            wanted = f"one method, or one for each of {len(places)} regions"
            raise InputError.expected("projection method", wanted, len(recipes), "give one method")
        for k, H, at, window, weight in places:
            top, left = window[0].start, window[1].start
            size = (window[0].stop - top, window[1].stop - left)
            own = Projector(
                H,
                size,
                (at[0] - top, at[1] - left),
                # the fastest method for the largest region, because one name applies to all
                recipes[len(parts)] if len(recipes) > 1 else parts[0].projector.method if parts else method,
                memory_limit=share,
                workers=self._workers,
                phases=self._phases_of(at, first),
                **self._settings,
            )
            parts.append(_Part(k, own, window, weight))
        return parts

    def _blending_bytes(self, parts: int) -> int:
        """Return the bytes of a projection that one region alone does not need: a weighted plane, and a sum."""
        return 0 if parts == 1 else 3 * self._grid.pixels * self.dtype.itemsize

    def _phases_of(self, anchor: tuple[int, ...], first: tuple[int, ...]) -> NDArray[np.bool_] | None:
        """Return the mask of phases relative to the anchor of another H instead of the first one."""
        if self._phases is None:
            return None
        return np.roll(self._phases, (first[0] - anchor[0], first[1] - anchor[1]), axis=(0, 1))

    def _total(self) -> ProjectionForecast:
        """Return the total cost of all regions, which are projected one after another."""
        each = [part.projector.forecast() for part in self._parts]
        if len(each) == 1:
            return each[0]
        weights = sum(0 if part.weight is None else part.weight.nbytes for part in self._parts)
        blending = self._blending_bytes(len(each))
        chosen = _together([one.chosen for one in each], weights, blending)
        names = [{option.method: option for option in one.options} for one in each]
        common = [name for name in names[0] if all(name in own for own in names)]
        options = [_together([own[name] for own in names], weights, blending) for name in common]
        options = [chosen if option.method == chosen.method else option for option in options]
        there = [one.device for one in each if one.device is not None]
        device = None
        if there:
            device = DeviceUse(
                sum(use.operand_bytes for use in there),
                max(use.room for use in there),
                sum(use.free for use in there),
                all(use.kept for use in there),
            )
        return ProjectionForecast(chosen, None, None, tuple(options), self._limit, device)

    # -- what it is ------------------------------------------------------------------------------------
    @property
    def regions(self) -> int:
        """Number of regions that contribute to the image."""
        return len(self._parts)

    @property
    def recipe(self) -> str:
        """Methods and tiles of the regions; a projector with this ``method`` computes identical values."""
        return SEPARATOR.join(part.projector.recipe for part in self._parts)

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """Mean noise of each plane as in `Projector`, averaged over the regions in which it is known."""
        known = [noise for part in self._parts if (noise := part.projector.noise) is not None]
        return np.mean(known, axis=0) if known else None

    @property
    def rounding(self) -> float:
        """Rounding error of projected values as a fraction of the largest value; do not divide by smaller values."""
        return max(part.projector.rounding for part in self._parts)

    def operand_bytes(self) -> int:
        """Return the size of the prepared planes of all H, and of the weights, in memory (bytes)."""
        weights = sum(0 if part.weight is None else part.weight.nbytes for part in self._parts)
        return weights + sum(part.projector.operand_bytes() for part in self._parts)

    # -- the pair --------------------------------------------------------------------------------------
    def forward(self, volume: ArrayLike) -> NDArray[Any]:
        """Return the image ``(Y, X)`` of ``volume`` ``(nz, Y, X)``, as a new array."""
        data = self._checked(volume, "volume (z, y, x)", self.volume_shape)
        if len(self._parts) == 1 and self._parts[0].weight is None:
            return self._parts[0].projector.forward(data)
        image = np.zeros(self.image_shape, self.dtype)
        for part in self._parts:
            image[part.window] += part.projector.forward_planes(part.seen(iter(enumerate(data))))
        return image

    def adjoint(self, image: ArrayLike) -> NDArray[Any]:
        """Return the back projection ``(nz, Y, X)`` of ``image`` ``(Y, X)``, as a new array."""
        data = self._checked(image, "image (y, x)", self.image_shape)
        if len(self._parts) == 1 and self._parts[0].weight is None:
            return self._parts[0].projector.adjoint(data)
        out = np.zeros(self.volume_shape, self.dtype)
        for part in self._parts:
            for z, plane in enumerate(part.projector.adjoint_planes(np.ascontiguousarray(data[part.window]))):
                out[z][part.window] += plane if part.weight is None else plane * part.weight
        return out

    def _reading(self, **changes: Any) -> Self:
        part = super()._reading(**changes)
        part._parts = [own.reading(changes) for own in self._parts]
        part._engine = part._parts[0].projector._engine
        part._subsets = {}
        return part

    def _subset(self, phases: NDArray[np.bool_]) -> FieldProjector:
        part = object.__new__(FieldProjector)
        part.__dict__.update(self.__dict__)
        part._phases, part._subsets, part._quiet = phases, {}, None
        first = self._grid.anchor
        part._parts = []
        for own in self._parts:
            at = tuple(a + s.start for a, s in zip(own.projector.grid.anchor, own.window, strict=True))
            mask = part._phases_of(at, first)
            assert mask is not None
            part._parts.append(replace(own, projector=own.projector.subset(mask)))
        return part

    def _iter_planes(self) -> Work[None]:
        clock = Clock("preparing planes of H", len(self._parts) * self.volume_shape[0])
        done = 0
        for part in self._parts:
            for _ in part.projector.iter_prepare():
                done += 1
                yield clock.at(done)

    def __reduce__(self) -> Any:
        """Pickle the projector as its arguments: H of each region, and the settings."""
        own = {"memory_limit": self._limit, "workers": self._workers, "phases": self._phases}
        device = "cpu" if self._device is None else replace(self._device, room=None)
        settings = self._settings | own | {"device": device}
        at = tuple(a + d for a, d in zip(self._matrices[0].anchor, self._moved, strict=True))
        made = partial(FieldProjector, self._matrices, self.image_shape, at, self.recipe, **settings)
        return _remade, (made, self._reader.changes)

    def __repr__(self) -> str:
        """Return size, regions and method as a one-line text."""
        return f"<FieldProjector {self.volume_shape} -> {self.image_shape}, {self.regions} regions, {self.method}>"


def _depths(H: PSFMatrix) -> str:
    return ", ".join(f"{z:.6g}" for z in H.depths)


def _check_together(matrices: Sequence[Any]) -> None:
    """Raise `InputError` unless there are matrices with the same period and planes, each with a position."""
    if not matrices:
        raise InputError.expected("regions of the field", "at least one H", "none", "give the H of one or more regions")
    first = matrices[0]
    for k, H in enumerate(matrices):
        if not isinstance(H, PSFMatrix):
            got = type(H).__name__
            wanted = "a PSFMatrix, which states its position in the field"
            raise InputError.expected(f"H of region {k + 1}", wanted, got, "convert it to a PSFMatrix")
        what = f"H of region {H.region or k + 1}"
        if tuple(H.shape[:3]) != tuple(first.shape[:3]):
            wanted = f"{first.shape[0]} planes of {first.shape[1]} x {first.shape[2]} positions, as in the first"
            got = f"{H.shape[0]} planes of {H.shape[1]} x {H.shape[2]} positions"
            raise InputError.expected(what, wanted, got, "measure all regions by the same plan")
        if not np.allclose(H.depths, first.depths, rtol=1e-3, atol=1e-6):
            raise InputError.expected(
                what,
                f"the depths {_depths(first)} µm, as in the first",
                f"{_depths(H)} µm",
                "use H with the same planes",
            )


def _window(weight: NDArray[Any], cutout: tuple[int, int]) -> tuple[slice, slice]:
    """Return the part of the image that the patterns of voxels with a weight can reach."""
    found = []
    for axis, size in enumerate(cutout):
        used = np.flatnonzero(weight.any(axis=1 - axis))
        reach = (size - 1) // 2
        found.append(slice(max(0, int(used[0]) - reach), min(weight.shape[axis], int(used[-1]) + reach + 1)))
    return found[0], found[1]


def _pixels(window: tuple[slice, slice]) -> int:
    return int(np.prod([s.stop - s.start for s in window]))


def _together(costs: Sequence[Cost], weights: int, blending: int) -> Cost:
    """Return the total cost of consecutive projections; ``weights`` are stored, ``blending`` is needed during each."""
    resident = all(cost.resident for cost in costs)
    kept = [cost.operand_bytes for cost in costs if cost.resident]
    # even if some planes are prepared each time, the kept ones use memory
    more = 0 if resident else sum(kept) + weights
    return Cost(
        costs[0].method,
        sum(cost.prepare_s for cost in costs),
        sum(cost.forward_s for cost in costs),
        sum(cost.adjoint_s for cost in costs),
        sum(cost.operand_bytes for cost in costs) + weights,
        max(cost.scratch_bytes for cost in costs) + blending + more,
        max(cost.prepare_bytes for cost in costs),
        resident,
    )
