"""Predict the cost of each projection method on a device, and create the engine of the chosen one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, any_of, format_bytes
from lfcal.reconstruct.projectors._device_direct import DeviceDirect, direct_bytes
from lfcal.reconstruct.projectors._device_engine import DeviceEngine, Placement
from lfcal.reconstruct.projectors._device_polyphase import DevicePolyphase, band_bytes
from lfcal.reconstruct.projectors._device_reduced import DeviceReduced
from lfcal.reconstruct.projectors._device_sparse import DeviceSparse, sparse_bytes
from lfcal.reconstruct.projectors._engine import Cost, DeviceUse
from lfcal.reconstruct.projectors._reduced import Reduced
from lfcal.reconstruct.projectors._reduction import Nodes, quickest_spacing
from lfcal.reconstruct.projectors._tiles import TilePlan
from lfcal.reconstruct.projectors.device import ArrayDevice, find_device
from lfcal.reconstruct.projectors.forecast import PAIRS, REDUCED, ProjectionForecast, ProjectionProblem, forecast
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["ON_DEVICES", "DeviceRates", "device_rates", "engine_on", "forecast_on"]

ON_DEVICES = ("polyphase", "direct", "sparse", REDUCED)
"""Projection methods available on a device."""

MOST_ROOM = 1 << 31
"""Working memory above which steps do not become faster (bytes)."""


@dataclass(frozen=True, slots=True)
class DeviceRates:
    """Measured speed of a device, per second.

    Attributes
    ----------
    products
        Real operations in matrix products.
    bytes
        Bytes read and written in sums of arrays.
    moved
        Bytes transferred from host memory to the device.
    """

    products: float
    bytes: float
    moved: float


@lru_cache(maxsize=16)
def device_rates(device: ArrayDevice, dtype: str) -> DeviceRates:
    """Return the rates of a device; they are measured once, in a few milliseconds."""
    xp, item = device.xp, np.dtype(dtype).itemsize
    with device.active():

        def product(side: int) -> Callable[[], Any]:
            one = xp.ones((side, side), dtype=device.dtype(dtype), device=device.place)
            return lambda: xp.matmul(one, one)

        def summed(side: int) -> Callable[[], Any]:
            one = xp.ones((side, side), dtype=device.dtype(dtype), device=device.place)
            return lambda: one + one

        def move(side: int) -> Callable[[], Any]:
            one = np.ones((side, side), dtype)
            return lambda: device.moved(one) + 0

        # shared memory is read and written once instead of transferred
        return DeviceRates(
            _rate(device, product, lambda side: 2 * side**3),
            _rate(device, summed, lambda side: 3 * item * side**2),
            _rate(device, move, lambda side: item * side**2),
        )


def _rate(device: ArrayDevice, make: Callable[[int], Callable[[], Any]], amount: Callable[[int], int]) -> float:
    """Return ``amount`` per second, at a size that is doubled from 128 until a run takes more than 2 ms."""
    side = 128
    while True:
        run = make(side)
        _wait(device, run())  # the first run loads parts of the library
        start = time.perf_counter()
        _wait(device, run())
        took = max(time.perf_counter() - start, 1e-9)
        if took > 2e-3 or side >= 4096:
            return amount(side) / took
        side *= 2


def _wait(device: ArrayDevice, array: Any) -> None:
    """Wait until an array is computed, by copying its last value to the host."""
    device.fetched(array[-1:, -1:])


@dataclass(frozen=True, slots=True)
class _Option:
    """Cost of one method: seconds to prepare and to project in both directions; operand and work memory (bytes)."""

    method: str
    prepare_s: float
    forward_s: float
    adjoint_s: float
    operand_bytes: int
    least_bytes: int
    plan: TilePlan | None = None


def device_forecast(
    problem: ProjectionProblem, method: str, memory_limit: int, device: ArrayDevice
) -> ProjectionForecast:
    """Return the fastest method on ``device``, with prepared planes stored there or moved for each projection.

    ``memory_limit`` is the limit for the memory of the processor (bytes), which stores planes that do not fit on the
    device. If they do not fit there either, they are prepared again in each projection.

    Raises
    ------
    InputError
        If devices do not support the method, the device has too little memory for one plane and the work arrays, or
        ``memory_limit`` is too small.
    """
    known = ("auto", *ON_DEVICES)
    if method not in known:
        what = f"projection method on {device.name}"
        raise InputError.expected(
            what, any_of(known), repr(method), "choose one of these, or the device cpu (--device cpu)"
        )
    rates, free = device_rates(device, problem.dtype.str), device.free_bytes()
    options = [o for name in ON_DEVICES if method in ("auto", name) for o in _options(problem, name, rates, method)]
    # two planes are on the device while one is used and the next is moved
    fitting = [o for o in options if 2 * o.operand_bytes // problem.planes + o.least_bytes <= free]
    if not fitting:
        least = min((2 * o.operand_bytes // problem.planes + o.least_bytes for o in options), default=0)
        raise InputError.expected(
            f"memory of {device.name}",
            f"at least {format_bytes(least)} free for one plane",
            format_bytes(free),
            "reconstruct a smaller region of the image, allow an error of the projection (--within 0.005), "
            "or choose the device cpu (--device cpu)",
        )
    placed = [(_placed(o, problem, rates, free, memory_limit), o) for o in fitting]
    found = [one for one in placed if one[0][0].memory_bytes <= memory_limit]
    if not found:
        least = min(cost.memory_bytes for (cost, _), _ in placed)
        raise InputError.expected(
            "memory limit for the projection",
            f"at least {format_bytes(least)}",
            format_bytes(memory_limit),
            "increase the limit, or reconstruct a smaller region of the image",
        )
    (cost, use), chosen = min(found, key=lambda f: f[0][0].prepare_s + PAIRS * f[0][0].pair_s)
    by_method = {f[0][0].method: f[0][0] for f in sorted(found, key=lambda f: -f[0][0].pair_s)}
    return ProjectionForecast(cost, chosen.plan, None, tuple(by_method.values()), memory_limit, use)


def _placed(
    option: _Option, problem: ProjectionProblem, rates: DeviceRates, free: int, memory_limit: int
) -> tuple[Cost, DeviceUse]:
    """Return the cost of an option with its memory on the processor, and its memory on the device.

    The device stores the planes if they fit.
    """
    once = option.operand_bytes // problem.planes
    kept = option.operand_bytes + option.least_bytes <= free
    there = option.operand_bytes if kept else 2 * once
    room = max(option.least_bytes, min(MOST_ROOM, (free - there) // 2))
    scratch, prepare = 3 * problem.image_bytes, problem.read_bytes + once
    images = 2 * problem.planes * problem.image_bytes / rates.moved
    moving = 0.0 if kept else option.operand_bytes / rates.moved
    here = 0 if kept else option.operand_bytes
    cost = Cost(
        option.method,
        option.prepare_s + option.operand_bytes / rates.moved,
        option.forward_s + images + moving,
        option.adjoint_s + images + moving,
        here,
        scratch,
        prepare,
    )
    if here and cost.memory_bytes > memory_limit:  # too large for both memories: planes are prepared again each time
        anew = option.prepare_s
        ahead, back = cost.forward_s + anew, cost.adjoint_s + anew
        cost = replace(
            cost, prepare_s=0.0, forward_s=ahead, adjoint_s=back, prepare_bytes=prepare + once, resident=False
        )
    return cost, DeviceUse(there, room, free, kept)


def _options(problem: ProjectionProblem, name: str, rates: DeviceRates, method: str) -> Iterator[_Option]:
    grid, planes, item = problem.grid, problem.planes, problem.dtype.itemsize
    entries = problem.plane_bytes // item
    cells = grid.cells[0] * grid.cells[1]
    share = problem.pixels / grid.phases
    if name == "polyphase":
        yield from _polyphase(problem, rates)
    elif name == "direct":
        seconds = planes * _windows_s(problem, grid.period, rates) * share
        least = direct_bytes(grid, grid.period, item)
        yield _Option(name, planes * problem.read_s, seconds, seconds, planes * problem.plane_bytes, least)
    elif name == "sparse" and (method != "auto" or problem.density < 0.5):
        kept = problem.density * entries * share
        # each value is gathered, written, read again, and multiplied
        seconds = planes * kept * cells * 3 * item / rates.bytes
        prepare = planes * (problem.read_s + entries * 3e-9 + kept * 70e-9)
        operand = int(planes * 2 * kept * (4 + item))
        yield _Option(name, prepare, seconds, seconds, operand, sparse_bytes(grid, item))
    elif name == REDUCED and problem.kept:
        spacing = quickest_spacing(problem.kept)
        nodes, kept = Nodes.of(grid.period, spacing), problem.kept.get(spacing, 0.0)
        wide = replace(grid, image_shape=(grid.image_shape[0] + grid.period[0], grid.image_shape[1] + grid.period[1]))
        beside = replace(grid, cutout=nodes.widened(grid.cutout))
        seconds = planes * (
            _windows_s(problem, nodes.shape, rates) + kept * entries * share * cells * 3 * item / rates.bytes
        )
        prepare = planes * (problem.read_s + entries * (11e-9 + kept * 70e-9))
        patterns = nodes.shape[0] * nodes.shape[1] / grid.phases * problem.plane_bytes
        operand = int(planes * (patterns + 2 * kept * entries * share * (4 + item)))
        # a plane may use another spacing than the sample; its entries extend as far as with the widest
        least = direct_bytes(wide, nodes.shape, item) + sparse_bytes(beside, item)
        yield _Option(name, prepare, seconds, seconds, operand, least)


def _windows_s(problem: ProjectionProblem, sources: tuple[int, int], rates: DeviceRates) -> float:
    """Return the seconds of one projection of a plane with patterns at ``sources`` (rows, columns) of a period."""
    grid, item = problem.grid, problem.dtype.itemsize
    (ny, nx), (nt, ns), cells = grid.period, grid.cutout, grid.cells[0] * grid.cells[1]
    together = min(sources[0], math.ceil(128 / sources[1]))
    groups = math.ceil(sources[0] / together)
    window = (nt + (together - 1) * ny / sources[0]) * (nx + ns - 1)
    band = together * sources[1] * window
    flops = 2 * cells * band
    # patterns are placed in three steps; windows are written, and added along both axes
    moved = (6 * band + 9 * cells * window) * item
    return groups * (flops / rates.products + moved / rates.bytes)


def _polyphase(problem: ProjectionProblem, rates: DeviceRates) -> Iterator[_Option]:
    grid, item = problem.grid, problem.dtype.itemsize
    for plan in problem.tile_plans():
        operand = plan.spectrum_bytes(2 * item, problem.pixels)
        image = band_bytes(plan, plan.counts[0], item)
        # spectra of H are read once for each projection; windows and their spectra several times
        seconds = plan.product_flops(problem.pixels) / rates.products + (operand + 2 * image) / rates.bytes
        taps = (2 * grid.reach[0] + 1) * (2 * grid.reach[1] + 1) * grid.phases * problem.pixels
        prepare = problem.read_s + (4 * operand + 2 * taps * item) / 1e9
        totals = plan.frequencies * plan.tiles * problem.pixels * 2 * item
        least = band_bytes(plan, 1, item) + 2 * totals + 4 * grid.pixels * item
        planes = problem.planes
        yield _Option("polyphase", planes * prepare, planes * seconds, planes * seconds, planes * operand, least, plan)


def forecast_on(
    device: str | ArrayDevice, problem: ProjectionProblem, method: str, memory_limit: int
) -> tuple[ArrayDevice | None, ProjectionForecast]:
    """Return the device named ``device`` (None: the processor) and the fastest method on it.

    ``auto`` falls back to the processor if the device does not support the method, or has too little memory.
    """
    found = find_device(device) if isinstance(device, str) else device
    if found is None or (device == "auto" and method not in ("auto", *ON_DEVICES)):
        return None, forecast(problem, method, memory_limit)
    try:
        return found, device_forecast(problem, method, memory_limit, found)
    except InputError:
        if device != "auto":
            raise
        return None, forecast(problem, method, memory_limit)


def engine_on(
    device: ArrayDevice,
    chosen: ProjectionForecast,
    grid: Grid,
    common: tuple[np.dtype[Any], int, NDArray[np.bool_] | None],
    tolerance: float,
) -> DeviceEngine:
    """Return the engine of a forecast for ``device``.

    ``common`` contains the data type, the number of threads, and the image phases in use.
    """
    assert chosen.device is not None
    placement = Placement(device, chosen.device.kept, chosen.device.room)
    (dtype, workers, phases), name = common, chosen.chosen.method
    if chosen.plan is not None:
        return DevicePolyphase(chosen.plan, dtype, placement, workers, phases)
    if name == REDUCED:
        return DeviceReduced(Reduced(grid, dtype, workers, phases, tolerance=tolerance), placement)
    if name == "sparse":
        return DeviceSparse(grid, dtype, placement, workers, phases)
    return DeviceDirect(grid, dtype, placement, phases)
