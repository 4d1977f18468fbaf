"""Predict the cost of each projection method on this computer, and choose one."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lfcal.base import InputError, any_of, format_bytes, format_seconds
from lfcal.reconstruct.projectors import _rates as rates
from lfcal.reconstruct.projectors._direct import (
    PARTS,
    WINDOW_BYTES,
    cells_at_once,
    rows_at_once,
    rows_together,
    strips_of,
    strips_together,
)
from lfcal.reconstruct.projectors._engine import Cost, DeviceUse
from lfcal.reconstruct.projectors._planes import PlaneReader
from lfcal.reconstruct.projectors._recipe import Tiles
from lfcal.reconstruct.projectors._reduction import Nodes, quickest_spacing
from lfcal.reconstruct.projectors._tiles import TilePlan
from lfcal.reconstruct.projectors.grid import Grid

__all__ = [
    "METHODS",
    "PAIRS",
    "REDUCED",
    "ProjectionForecast",
    "ProjectionProblem",
    "forecast",
    "reading_seconds",
    "tile_counts",
]

METHODS = ("polyphase", "direct", "sparse", "fft")
"""Exact projection methods."""

REDUCED = "reduced"
"""Projection method with a tolerance."""

PAIRS = 20
"""Number of projection pairs over which the set-up time is distributed when methods are compared."""


@dataclass(frozen=True, slots=True)
class ProjectionProblem:
    """Properties of a projection problem that determine its time and memory.

    Attributes
    ----------
    grid
        Mapping of pixels to periods, with the sizes of image, period and cutout.
    planes
        Number of depth planes.
    pixels
        Number of image phases (pixels of one period) in use.
    dtype
        float32 or float64.
    workers
        Number of threads.
    density
        Fraction of non-zero entries of H.
    read_s
        Time to read one plane of H (s).
    kept
        Fraction of the entries of H that the method ``"reduced"`` stores in addition to its nodes, for each possible
        spacing of the nodes. It is empty without a tolerance.
    tiles
        Requested tiles. None: the forecast chooses them.
    noisy
        Whether the noise of H is known; planes are then also stored with reduced noise while they are read.
    """

    grid: Grid
    planes: int
    pixels: int
    dtype: np.dtype[Any]
    workers: int
    density: float = 1.0
    read_s: float = 0.0
    kept: Mapping[float, float] = field(default_factory=dict)
    tiles: Tiles | None = None
    noisy: bool = False

    def tile_plans(self) -> list[TilePlan]:
        """Return the requested division of the image into tiles, or all divisions to compare."""
        counts = [tile_counts(c, r) for c, r in zip(self.grid.cells, self.grid.reach, strict=True)]
        given = None if self.tiles is None else [(self.tiles.down, self.tiles.across)]
        return [TilePlan(self.grid, (y, x)) for y, x in given or itertools.product(*counts)]

    @property
    def plane_bytes(self) -> int:
        """Size of one plane of H in the projector's sample type (bytes)."""
        return self.grid.phases * self.grid.cutout[0] * self.grid.cutout[1] * self.dtype.itemsize

    @property
    def read_bytes(self) -> int:
        """Peak memory while reading a plane: the plane and, if the noise is known, its noise-reduced copy (bytes)."""
        return (1 + self.noisy) * self.plane_bytes

    @property
    def image_bytes(self) -> int:
        """Size of an image (bytes)."""
        return self.grid.pixels * self.dtype.itemsize


@dataclass(frozen=True, slots=True)
class ProjectionForecast:
    """Chosen projection method with its predicted cost, and the costs of the other methods.

    Attributes
    ----------
    chosen
        Cost of the chosen method.
    plan
        Division of the image into tiles by the chosen method; None for methods without tiles.
    band
        Number of rows of tiles that are processed together; None for methods without tiles.
    options
        Cost of each examined method, with its fastest division into tiles.
    memory_limit
        Largest amount of memory that a projection may use (bytes).
    device
        Memory used on the accelerator; None if the CPU computes projections.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.reconstruct import ProjectionForecast, Projector
    >>> with open_psf("H.h5") as H:
    ...     forecast: ProjectionForecast = Projector(H, (80, 96), method="direct").forecast()
    >>> print(f"{forecast.chosen.method}: {forecast.chosen.operand_bytes / 1e6:.1f} MB of H are kept")
    direct: 15.2 MB of H are kept
    """

    chosen: Cost
    plan: TilePlan | None
    band: int | None
    options: tuple[Cost, ...]
    memory_limit: int
    device: DeviceUse | None = None

    def __str__(self) -> str:
        """Return the forecast as a one-line text."""
        cost = self.chosen
        kept = "" if cost.resident else ", planes prepared again for each projection"
        return (
            f"{cost.method}: set-up {format_seconds(cost.prepare_s)}, forward {format_seconds(cost.forward_s)}, "
            f"adjoint {format_seconds(cost.adjoint_s)}, memory {format_bytes(cost.memory_bytes)} "
            f"of {format_bytes(self.memory_limit)}{kept}" + ("" if self.device is None else f"; {self.device}")
        )


Option = tuple[Cost, TilePlan | None, int | None]


def forecast(problem: ProjectionProblem, method: str, memory_limit: int) -> ProjectionForecast:
    """Return the fastest method for ``problem`` within ``memory_limit`` bytes, with the costs of all examined methods.

    The time of `PAIRS` forward and adjoint projections is compared, including set-up. If ``method`` is ``"auto"``, all
    methods that may be the fastest are examined, otherwise only ``method`` (see `Projector`).

    Raises
    ------
    InputError
        If the method is unknown or no examined method fits into the memory.
    """
    known = ("auto", *METHODS, REDUCED)
    if method not in known:
        raise InputError.expected("projection method", any_of(known), repr(method), "choose one of these")
    options: list[Option] = []
    for name in (*METHODS, REDUCED) if method == "auto" else (method,):
        if name == "polyphase":
            options += _polyphase(problem, memory_limit)
        elif name == "direct":
            options.append((_resident(_direct(problem), problem, memory_limit), None, None))
        # below half density, the indices of a sparse matrix need less memory than its zeros
        elif name == "sparse" and (method != "auto" or problem.density < 0.5):
            options.append((_resident(_sparse(problem), problem, memory_limit), None, None))
        elif name == REDUCED and (problem.kept or method != "auto"):
            options.append((_resident(_reduced(problem), problem, memory_limit), None, None))
        # one transform per phase: never the fastest for more than 16 phases
        elif name == "fft" and (method != "auto" or problem.grid.phases <= 16):
            options.append((_resident(_fft(problem), problem, memory_limit), None, None))
    fitting = [o for o in options if o[0].memory_bytes <= memory_limit]
    if not fitting:
        if not options:
            raise InputError.expected(
                f"period for the method {method}",
                "a shorter period, whose spectra fit into memory",
                f"{problem.grid.period[1]} x {problem.grid.period[0]} positions",
                "choose the method direct, sparse or auto",
            )
        least = min(o[0].memory_bytes for o in options)
        raise InputError.expected(
            "memory limit for the projection",
            f"at least {format_bytes(least)}",
            format_bytes(memory_limit),
            "increase the limit, or reconstruct a smaller region of the image",
        )
    # the set-up time is included, distributed over the projections of a typical reconstruction
    cost, plan, band = min(fitting, key=lambda o: o[0].prepare_s + PAIRS * o[0].pair_s)
    # the slowest first, so that the fastest option of each method remains in the dict
    by_method = {o[0].method: o[0] for o in sorted(options, key=lambda o: -o[0].pair_s)}
    return ProjectionForecast(cost, plan, band, tuple(by_method.values()), memory_limit)


def reading_seconds(reader: PlaneReader) -> float:
    """Return the time to read one plane of H (s), extrapolated from the first row of source positions."""
    # one row of source positions is enough to time the disk and the decoding
    start = time.perf_counter()
    np.asarray(reader.H[0, 0], reader.dtype)
    return (time.perf_counter() - start) * reader.shape[1]


def _resident(cost: Cost, problem: ProjectionProblem, limit: int) -> Cost:
    """Return ``cost`` with planes prepared again in each projection if they cannot be kept."""
    if cost.memory_bytes <= limit:
        return cost
    return Cost(
        cost.method,
        0.0,
        cost.forward_s + cost.prepare_s,
        cost.adjoint_s + cost.prepare_s,
        cost.operand_bytes,
        cost.scratch_bytes,
        # two planes at a time are in memory instead of all
        cost.prepare_bytes + 2 * cost.operand_bytes // problem.planes,
        False,
    )


def _fft(problem: ProjectionProblem) -> Cost:
    grid = problem.grid
    rows, columns = (n + c for n, c in zip(grid.image_shape, grid.centre, strict=True))
    one = rates.fft_seconds(rows, columns, problem.dtype.str, problem.workers)
    copies = 2 * rows * columns / rates.copy_rate(problem.dtype.str, 1)
    alone, scratch = grid.period == (1, 1), 8 * rows * columns * problem.dtype.itemsize
    # the transform of a single position is kept
    pair = problem.planes * grid.phases * ((1 if alone else 2) * one + copies)
    prepare = problem.planes * (problem.read_s + (one if alone else 0.0))
    operand = problem.planes * ((rows * (columns + 2) * problem.dtype.itemsize) if alone else problem.plane_bytes)
    return Cost("fft", prepare, pair, pair, operand, scratch, problem.read_bytes)


def _direct(problem: ProjectionProblem) -> Cost:
    forward, adjoint = _direct_seconds(problem, problem.grid.period)
    each, planes, once = problem.planes * problem.read_s, problem.planes, problem.plane_bytes
    scratch = _direct_scratch(problem, problem.grid, problem.grid.period)
    return Cost("direct", each, planes * forward, planes * adjoint, planes * once, scratch, problem.read_bytes)


def _direct_scratch(problem: ProjectionProblem, grid: Grid, sources: tuple[int, int]) -> int:
    """Return the working memory of a projection with patterns at ``sources`` (rows, columns) of a period."""
    (ny, nx), (nt, ns), item = grid.period, grid.cutout, problem.dtype.itemsize
    height, width = grid.cells[0] * ny, grid.cells[1] * nx
    strips = strips_of(grid.cells)
    rows, lines = rows_at_once(nt, nx + ns - 1, item), -(-grid.cells[0] // len(strips))
    window = rows * (nx + ns - 1) * item
    at_once, columns = strips_together(grid, problem.workers), rows_together(*sources, len(strips)) * sources[1]
    # each worker has windows and bands of up to four heights, with a cell's sources side by side
    own = 2 * min(WINDOW_BYTES, lines * grid.cells[1] * window) + 2 * columns * window
    own += at_once * lines * grid.cells[1] * columns * item
    # in separate strips; those of one more worker may wait for their addition
    strip = (lines * ny + nt - 1) * (width + ns - 1) * item
    waiting = min((problem.workers + 1) * at_once, len(strips) * -(-PARTS // len(strips)))
    image = (height + nt - 1) * (width + ns - 1) * item
    return 2 * height * width * item + image + waiting * strip + problem.workers * own


def _direct_seconds(problem: ProjectionProblem, sources: tuple[int, int]) -> tuple[float, float]:
    """Return the times (s) to project a plane forward and back, with patterns at ``sources`` of a period."""
    grid, workers, dtype = problem.grid, problem.workers, problem.dtype.str
    nx, (nt, ns), cells = grid.period[1], grid.cutout, grid.cells[0] * grid.cells[1]
    (down, across), width = sources, nx + ns - 1
    rows = rows_at_once(nt, width, problem.dtype.itemsize)
    strips = strips_of(grid.cells)
    block = min(cells // len(strips), cells_at_once(rows, width, problem.dtype.itemsize))
    share = problem.pixels / grid.phases
    together = rows_together(down, across, len(strips))
    height = nt + (together - 1) * grid.period[0] / down  # of the windows that rows of sources share
    runs = down / together * height / rows * cells / block * share
    add, gather = rates.window_seconds(rows, width, dtype, workers)
    values = block * rows * width
    # patterns that reach a few rows of a window
    reaching = round(across * max(1.0, together * (nt + rows) / (height + rows)))
    ahead = rates.gemm_seconds(block, reaching, rows * width, dtype, workers)
    back = rates.gemm_seconds(block, rows * width, reaching, dtype, workers, turned=True)
    laid = -(-len(strips) // strips_together(grid, workers))
    bands = laid * down * across * nt * 2 * ns / rates.copy_rate(dtype, workers) / 2
    return runs * (ahead + add * values) + bands, runs * (back + gather * values) + bands


def _reduced(problem: ProjectionProblem) -> Cost:
    planes, once = problem.planes, problem.plane_bytes
    spacing = quickest_spacing(problem.kept)
    nodes, kept = Nodes.of(problem.grid.period, spacing).shape, problem.kept.get(spacing, 0.0)
    forward, back = _direct_seconds(problem, nodes)
    beside = _sparse_seconds(problem, kept)
    entries = once / problem.dtype.itemsize
    share = nodes[0] * nodes[1] / problem.grid.phases
    operand = int(planes * (share * once + kept * entries * 2 * (4 + problem.dtype.itemsize)))
    prepare = problem.read_s + entries * (8e-9 / problem.workers + 3e-9 + kept * 35e-9)
    (ny, nx), (height, width) = problem.grid.period, problem.grid.image_shape
    wide = replace(problem.grid, image_shape=(height + ny, width + nx))
    scratch = max(_direct_scratch(problem, wide, nodes) + problem.image_bytes, _sparse_scratch(problem))
    back, forward = planes * (back + beside), planes * (forward + beside)
    # the residual, in addition to the plane
    return Cost(REDUCED, planes * prepare, forward, back, operand, scratch, once + problem.read_bytes)


def _sparse(problem: ProjectionProblem) -> Cost:
    grid = problem.grid
    entries = problem.density * grid.phases * grid.cutout[0] * grid.cutout[1] * problem.pixels / grid.phases
    once = problem.planes * _sparse_seconds(problem, problem.density)
    sorting = grid.phases * grid.cutout[0] * grid.cutout[1] * (3e-9 + problem.density * 35e-9)
    operand = int(problem.planes * entries * 2 * (4 + problem.dtype.itemsize))
    prepare = problem.planes * (problem.read_s + sorting)
    return Cost("sparse", prepare, once, once, operand, _sparse_scratch(problem), problem.read_bytes)


def _sparse_scratch(problem: ProjectionProblem) -> int:
    """Return the working memory of a projection: values by phase with margins, sums, and both sides packed."""
    grid = problem.grid
    (ny, nx), (cells_y, cells_x), (ry, rx) = grid.period, grid.cells, grid.reach
    block = (cells_y + 2 * ry) * (cells_x + rx) + 2 * rx
    return (block * grid.phases + 3 * cells_y * ny * cells_x * nx) * problem.dtype.itemsize


def _sparse_seconds(problem: ProjectionProblem, density: float) -> float:
    """Return the time (s) of one projection of a plane in which a fraction ``density`` of the entries is not zero."""
    grid = problem.grid
    entries = density * grid.cutout[0] * grid.cutout[1] * problem.pixels
    positions = grid.cells[0] * (grid.cells[1] + grid.reach[1])
    return entries * positions / rates.gather_rate(grid.phases, positions, problem.dtype.str, problem.workers)


def _polyphase(problem: ProjectionProblem, limit: int) -> list[Option]:
    """Return an option for each division into tiles; none if the spectra of a single frequency are too large."""
    complex_type = np.result_type(problem.dtype, np.complex64)
    grid, workers = problem.grid, problem.workers
    smallest = grid.phases * problem.pixels * complex_type.itemsize
    if smallest > limit or grid.phases * problem.pixels > rates.LIMIT:
        return []
    ahead = rates.product_seconds(grid.phases, problem.pixels, complex_type.str, workers)
    back = rates.product_seconds(grid.phases, problem.pixels, complex_type.str, workers, turned=True)
    copies = rates.copy_rate(problem.dtype.str, workers)
    length = 8 * max(1, grid.reach[0])
    dft = rates.gemm_seconds(2 * length, 2 * length, 2 * grid.phases, problem.dtype.str, workers)
    flops_s = 8 * length * length * 2 * grid.phases / dft
    options: list[Option] = []
    for plan in problem.tile_plans():
        transform = plan.transform_flops(grid.phases) / flops_s + 2.5 * plan.scratch_bytes(1) / copies
        image_share = problem.pixels / grid.phases
        forward, adjoint = (
            problem.planes * (transform + plan.frequencies * (fixed + slope * plan.tiles)) + image_share * transform
            for fixed, slope in (ahead, back)
        )
        taps = (2 * grid.reach[0] + 1) * (2 * grid.reach[1] + 1)
        spectra = plan.frequencies * grid.phases * problem.pixels
        prepare = problem.read_s + (12 * spectra + taps * grid.phases * problem.pixels) / copies
        prepare += 8 * spectra * (2 * grid.reach[0] + 1) / flops_s
        whole = plan.scratch_bytes(complex_type.itemsize)
        tall = plan.counts[0]
        band = max(1, min(tall, int(tall * 0.25 * limit / max(1, whole))))
        if problem.tiles is not None:
            band = min(tall, problem.tiles.band)
        # bands are cut from the whole lattice, packed, and reassembled
        scratch = whole * band // tall + (0 if band == tall else 2 * problem.image_bytes)
        operand = problem.planes * plan.spectrum_bytes(complex_type.itemsize, problem.pixels)
        taps_bytes = taps * grid.phases * problem.pixels // max(1, grid.phases // 64) * complex_type.itemsize
        cost = Cost(
            "polyphase", problem.planes * prepare, forward, adjoint, operand, scratch, problem.read_bytes + taps_bytes
        )
        options.append((_resident(cost, problem, limit), plan, band))
    return options


def tile_counts(cells: int, reach: int) -> list[int]:
    """Return the numbers of tiles to compare along an axis with ``cells`` lattice cells.

    ``reach`` is the entry of `Grid.reach` for this axis.
    """
    # sizes grow by sqrt(2): finer steps change the estimate by less than its error
    sizes = {max(1, round(max(1, reach) * 2 ** (k / 2))) for k in range(-2, 16)}
    return sorted({1, *(-(-cells // v) for v in sizes if v < cells and v + 2 * reach <= 512)})
