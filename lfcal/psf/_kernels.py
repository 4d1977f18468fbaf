"""Compiled kernels that transpose whole depth planes of H, on one thread each, without the GIL.

The transpose of a periodic H is a permutation (Eberhart et al. 2020, equations 4 to 6, in closed form):

    HT[z, y, x, t, s] = H[z, (y + t - ct) mod ny, (x + s - cs) mod nx, nt - 1 - t, ns - 1 - s],

with ct = (nt - 1)/2, cs = (ns - 1)/2. Values are moved unchanged, as unsigned integers of their size. Operations that
numba cannot express (shearing sixteen lanes in registers, prefetching, stores that bypass the caches) are written as
LLVM code for any processor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["LANES", "Batches", "batch_rows", "source_rows", "transpose_batches", "transpose_rows"]

Shape = tuple[int, int, int, int, int]
Words = NDArray[Any]

LANES = 16
"""Number of neighbouring values that are moved together."""

LINE_BYTES = 64
"""Bytes of a cache line; on processors with longer lines only the last step is slower."""

_I1, _I8, _I32, _I64 = (ir.IntType(bits) for bits in (1, 8, 32, 64))


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


def _constants(kind: Any, values: list[int]) -> Any:
    return ir.Constant(ir.VectorType(kind, len(values)), [ir.Constant(kind, v) for v in values])


def _shear(height: int) -> Any:
    """Make ``shear(source, base, rows, first, out, at, step)`` for blocks of ``height`` rows.

    out[at + i * step + l] = source[base + rows[first + i + l] + 15 - l] for i < height and l < 16: lane l comes from l
    rows further down, and the lanes are reversed. Four rounds of selections by the bits of l do this in registers.
    """

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _, base, _, first, _, at, step = arguments
        pointers = [_data(context, builder, signature.args[k], arguments[k]) for k in (0, 2, 4)]
        kind = context.get_data_type(signature.args[0].dtype)
        size = context.get_abi_sizeof(kind)
        vector = ir.VectorType(kind, LANES)

        def load(i: int) -> Any:
            row = builder.load(builder.gep(pointers[1], [builder.add(first, ir.Constant(_I64, i))]))
            place = builder.gep(pointers[0], [builder.add(row, base)])
            value = builder.load(builder.bitcast(place, vector.as_pointer()))
            value.align = size
            return value

        values = [load(i) for i in range(height + LANES - 1)]
        for shift in (8, 4, 2, 1):
            mask = _constants(_I1, [int(bool((LANES - 1 - lane) & shift)) for lane in range(LANES)])
            values = [builder.select(mask, values[i + shift], values[i]) for i in range(len(values) - shift)]
        order = _constants(_I32, list(range(LANES - 1, -1, -1)))
        for i, value in enumerate(values):
            turned = builder.shuffle_vector(value, ir.Constant(vector, ir.Undefined), order)
            place = builder.gep(pointers[2], [builder.add(at, builder.mul(step, ir.Constant(_I64, i)))])
            stored = builder.store(turned, builder.bitcast(place, vector.as_pointer()))
            stored.align = size
        return context.get_dummy_value()

    def typed(_: Any, source: Any, base: Any, rows: Any, first: Any, out: Any, at: Any, step: Any) -> Any:
        return types.void(source, types.int64, rows, types.int64, out, types.int64, types.int64), implement

    return intrinsic(typed)


@intrinsic  # type: ignore[untyped-decorator]
def _prefetch(_: Any, array: Any, at: Any) -> Any:
    """Ask for the cache line of ``array[at]`` ahead of its use; any position is allowed."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = builder.gep(_data(context, builder, signature.args[0], arguments[0]), [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [_I8.as_pointer(), _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch")
        read, second_level, data = (ir.Constant(_I32, k) for k in (0, 2, 1))
        builder.call(function, [builder.bitcast(place, _I8.as_pointer()), read, second_level, data])
        return context.get_dummy_value()

    return types.void(array, types.int64), implement


@intrinsic  # type: ignore[untyped-decorator]
def _stream(_: Any, source: Any, start: Any, out: Any, at: Any, count: Any) -> Any:
    """Copy ``count`` cache lines past the caches; ``out[at]`` must begin one."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = context.get_data_type(signature.args[0].dtype)
        size = context.get_abi_sizeof(kind)
        vector = ir.VectorType(kind, LINE_BYTES // size).as_pointer()
        starts = (_data(context, builder, signature.args[k], arguments[k]) for k in (0, 2))
        here, there = (
            builder.bitcast(builder.gep(start, [arguments[k]]), vector) for start, k in zip(starts, (1, 3), strict=True)
        )
        hint = builder.module.add_metadata([ir.Constant(_I32, 1)])
        with cgutils.for_range(builder, arguments[4]) as loop:
            value = builder.load(builder.gep(here, [loop.index]))
            value.align = size
            stored = builder.store(value, builder.gep(there, [loop.index]))
            stored.align = LINE_BYTES
            stored.set_metadata("nontemporal", hint)
        return context.get_dummy_value()

    return types.void(source, types.int64, out, types.int64, types.int64), implement


@intrinsic  # type: ignore[untyped-decorator]
def _fence(_: Any) -> Any:
    """Make what `_stream` wrote visible to other threads."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), implement


@intrinsic  # type: ignore[untyped-decorator]
def _address(_: Any, array: Any) -> Any:
    """Return the address of ``array[0]`` in elements, within its cache line."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = builder.ptrtoint(_data(context, builder, signature.args[0], arguments[0]), _I64)
        size = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
        return builder.udiv(builder.urem(place, ir.Constant(_I64, LINE_BYTES)), ir.Constant(_I64, size))

    return types.int64(array), implement


_shear_4, _shear_8, _shear_12, _shear_16 = (_shear(height) for height in (4, 8, 12, 16))


class Batches(NamedTuple):
    """How a transposition is cut into batches of cutout rows t."""

    shape: Shape  # (nz, ny, nx, nt, ns)
    rows: NDArray[np.int64]  # where the columns x of a source row start; see `source_rows`
    batch: int  # rows t to a batch


class _Tiles(NamedTuple):
    """The tile of all (x, s) for one y and t, and the scratch memory it is turned into."""

    rows: NDArray[np.int64]  # see `Batches`
    nx: int
    ns: int
    step: int  # values from one x to the next in scratch memory


class _Runs(NamedTuple):
    """Where the runs of a batch lie: one per x, in scratch memory and in the result (flat, in values)."""

    at: int  # first run in scratch memory
    step: int  # from run to run there
    to: int  # first run in the result
    pattern: int  # from run to run there: nt * ns
    columns: int  # nx
    length: int  # values to a run


_SCRATCH_BYTES = 1 << 19  # stays in the second-level cache
_RUN_BYTES = 3072  # a run this long consists of whole cache lines for the most part
_LEAST_ROWS = 4


@njit()
def transpose_rows(plane: Words, out: Words, start: int, stop: int) -> None:
    """Write rows ``start`` to ``stop`` of one transposed plane, value by value: any shape, any item size.

    ``plane`` and ``out`` are ``(ny, nx, nt, ns)``.
    """
    ny, nx, nt, ns = plane.shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    for y in range(start, stop):
        for t in range(nt):
            row = (y + t - ct) % ny
            for x in range(nx):
                column = (x - cs) % nx
                for s in range(ns):
                    out[y, x, t, s] = plane[row, column, nt - 1 - t, ns - 1 - s]
                    column += 1  # counted on, as a division per value would cost more than the copy
                    if column == nx:
                        column = 0


def batch_rows(shape: Shape, itemsize: int) -> int:
    """Return the number of cutout rows t that `transpose_batches` processes together."""
    nx, nt, ns = shape[2:]
    most = _SCRATCH_BYTES // ((nx + 3) * ns * itemsize)
    return max(1, min(max(_LEAST_ROWS, -(-_RUN_BYTES // (ns * itemsize))), nt, most))


def source_rows(shape: Shape) -> NDArray[np.int64]:
    """Return where the columns x of a source row start, repeated periodically as far as a block reaches."""
    _, _, nx, nt, ns = shape
    return np.arange(nx + 2 * LANES, dtype=np.int64) % nx * (nt * ns)


@njit()
def transpose_batches(source: Words, out: Words, batches: Batches, start: int, stop: int) -> None:
    """Write batches ``start`` to ``stop`` of ``nz * ceil(nt / batch)`` of the transposed matrix.

    ``source`` and ``out`` are flat. For one y and t, the tile of all (x, s) maps to a tile: each column s is shifted
    cyclically along x by s - cs. A tile goes through registers into scratch memory, 16 x 16 values at a time, while
    the next one is fetched. A batch of cutout rows is then written as one run per x, in whole cache lines that bypass
    the caches. Needs ns >= 16.
    """
    ny, nx, nt, ns = batches.shape[1:]
    batch = batches.batch
    ct = (nt - 1) // 2
    pattern = nt * ns
    row = nx * pattern
    line = LINE_BYTES // source.itemsize
    step = batch * ns + line + (pattern - batch * ns) % line  # aligned with the rows of out
    # three rows more than nx: the last block of a tile is written in whole steps of four
    scratch = np.empty(step * (nx + 3) + 2 * line, source.dtype)
    tiles = _Tiles(batches.rows, nx, ns, step)
    per_plane = -(-nt // batch)
    for k in range(start, stop):
        z = k // per_plane
        t0 = (k - z * per_plane) * batch
        t1 = min(nt, t0 + batch)
        for y in range(ny):
            to = (z * ny + y) * row + t0 * ns
            # scratch is as far into a cache line as its target is: lines are then copied whole
            at = (_address(out) + to - _address(scratch)) % line
            for t in range(t0, t1):
                here = (z * ny + (y + t - ct) % ny) * row + (nt - 1 - t) * ns
                if t + 1 < t1:
                    ahead = (z * ny + (y + t + 1 - ct) % ny) * row + (nt - 2 - t) * ns
                else:
                    ahead = (z * ny + (y + 1 + t0 - ct) % ny) * row + (nt - 1 - t0) * ns
                _turn_tile(source, here, ahead, tiles, scratch, at + (t - t0) * ns)
            _write_runs(scratch, out, _Runs(at, step, to, pattern, nx, (t1 - t0) * ns))
    # stores past the caches are ordered with nothing else until a fence
    _fence()


@njit(inline="always")
def _turn_tile(source: Words, here: int, ahead: int, tiles: _Tiles, out: Words, at: int) -> None:
    """Turn the tile at ``here`` into ``out``; fetch the one at ``ahead``. Rows beyond nx are scratch."""
    rows, nx, ns, step = tiles.rows, tiles.nx, tiles.ns, tiles.step
    cs = (ns - 1) // 2
    for x in range(0, nx, LANES):
        height = min(LANES, nx - x)
        for block in range(0, ns, LANES):
            c = min(block, ns - LANES)  # the last block overlaps the one before it
            for i in range(x, x + height):
                _prefetch(source, ahead + rows[i] + c)
            first = (x + cs - c - LANES + 1) % nx
            to = at + x * step + ns - LANES - c
            # a block's height is part of its code: four sizes waste three rows at most
            if height > 12:
                _shear_16(source, here + c, rows, first, out, to, step)
            elif height > 8:
                _shear_12(source, here + c, rows, first, out, to, step)
            elif height > 4:
                _shear_8(source, here + c, rows, first, out, to, step)
            else:
                _shear_4(source, here + c, rows, first, out, to, step)


@njit(inline="always")
def _write_runs(scratch: Words, out: Words, runs: _Runs) -> None:
    """Copy the runs from scratch to ``out``: whole cache lines past the caches, then the ends."""
    line = LINE_BYTES // out.itemsize
    for x in range(runs.columns):
        a = runs.at + x * runs.step
        b = runs.to + x * runs.pattern
        head = min(runs.length, -(_address(out) + b) % line)
        count = (runs.length - head) // line
        _stream(scratch, a + head, out, b + head, count)
        for i in range(head):
            out[b + i] = scratch[a + i]
        for i in range(head + count * line, runs.length):
            out[b + i] = scratch[a + i]
