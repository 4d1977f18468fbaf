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

__all__ = [
    "LANES",
    "BatchMemory",
    "Batches",
    "batch_memory",
    "batch_rows",
    "source_rows",
    "transpose_batches",
    "transpose_rows",
]

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


def _fetcher(*, write: bool) -> Any:
    """Make ``fetch(array, at)``: ask for the cache line of ``array[at]`` before its use; any position is allowed."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = builder.gep(_data(context, builder, signature.args[0], arguments[0]), [arguments[1]])
        kind = ir.FunctionType(ir.VoidType(), [_I8.as_pointer(), _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch")
        use, level, data = (ir.Constant(_I32, k) for k in (int(write), 3 if write else 2, 1))
        builder.call(function, [builder.bitcast(place, _I8.as_pointer()), use, level, data])
        return context.get_dummy_value()

    def typed(_: Any, array: Any, at: Any) -> Any:
        return types.void(array, types.int64), implement

    return intrinsic(typed)


_fetch, _fetch_to_write = _fetcher(write=False), _fetcher(write=True)


def _place(context: Any, builder: Any, signature: Any, arguments: Any, k: int) -> Any:
    """Return a pointer to the value of array argument ``k`` at the index that follows it."""
    return builder.gep(_data(context, builder, signature.args[k], arguments[k]), [arguments[k + 1]])


def _copy_vector(builder: Any, here: Any, there: Any, lanes: int, size: int) -> Any:
    """Copy ``lanes`` values and return the store."""
    vector = ir.VectorType(here.type.pointee, lanes).as_pointer()
    value = builder.load(builder.bitcast(here, vector))
    value.align = size
    stored = builder.store(value, builder.bitcast(there, vector))
    stored.align = size
    return stored


@intrinsic  # type: ignore[untyped-decorator]
def _stream(_: Any, source: Any, start: Any, out: Any, at: Any, count: Any) -> Any:
    """Copy the whole cache lines in ``count`` values past the caches; ``out[at]`` must begin a cache line."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        here, there = (_place(context, builder, signature, arguments, k) for k in (0, 2))
        size = context.get_abi_sizeof(here.type.pointee)
        lanes = LINE_BYTES // size
        line = ir.Constant(_I64, lanes)
        hint = builder.module.add_metadata([ir.Constant(_I32, 1)])
        with cgutils.for_range(builder, builder.udiv(arguments[4], line)) as loop:
            step = builder.mul(loop.index, line)
            stored = _copy_vector(builder, builder.gep(here, [step]), builder.gep(there, [step]), lanes, size)
            stored.align = LINE_BYTES
            stored.set_metadata("nontemporal", hint)
        return context.get_dummy_value()

    return types.void(source, types.int64, out, types.int64, types.int64), implement


@intrinsic  # type: ignore[untyped-decorator]
def _copy_part(_: Any, source: Any, start: Any, out: Any, at: Any, count: Any) -> Any:
    """Copy ``count`` values, at most one cache line, in powers of two: a loop is slow for so few values."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        here, there = (_place(context, builder, signature, arguments, k) for k in (0, 2))
        count, done = arguments[4], ir.Constant(_I64, 0)
        size = context.get_abi_sizeof(here.type.pointee)
        lanes = LINE_BYTES // size
        while lanes:
            part = builder.and_(count, ir.Constant(_I64, lanes))
            with builder.if_then(builder.icmp_unsigned("!=", part, ir.Constant(_I64, 0))):
                _copy_vector(builder, builder.gep(here, [done]), builder.gep(there, [done]), lanes, size)
            done = builder.add(done, part)
            lanes //= 2
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
    """Return the offset of ``array[0]`` in its cache line, in elements."""

    def implement(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = builder.ptrtoint(_data(context, builder, signature.args[0], arguments[0]), _I64)
        size = context.get_abi_sizeof(context.get_data_type(signature.args[0].dtype))
        return builder.udiv(builder.urem(place, ir.Constant(_I64, LINE_BYTES)), ir.Constant(_I64, size))

    return types.int64(array), implement


_shear_4, _shear_8, _shear_12, _shear_16 = (_shear(height) for height in (4, 8, 12, 16))


class Batches(NamedTuple):
    """Division of a transposition into batches of cutout rows t."""

    shape: Shape  # (nz, ny, nx, nt, ns)
    rows: NDArray[np.int64]  # where the columns x of a source row start; see `source_rows`
    batch: int  # rows t to a batch


class BatchMemory(NamedTuple):
    """Scratch memory of a thread, made by Python: without allocations, code compiles faster."""

    scratch: Words  # a tile, in rows that are aligned with those of the result
    step: int  # values from one column x to the next in it
    ends: Words  # a cache line for each column of each row t


class _Part(NamedTuple):
    """Columns of the tile of all (x, s) of one y and t, and where they begin, in values."""

    x: int  # first column
    columns: int
    here: int  # tile in the source
    ahead: int  # tile in the source that is fetched meanwhile
    to: int  # first column in the result
    at: int  # first column in scratch memory
    before: int  # first column in ``ends``: lines begun by the rows t - 1; -1: none
    after: int  # first column in ``ends``: lines that the rows t + 1 complete; -1: none


class _Sizes(NamedTuple):
    """Sizes that are the same for all tiles."""

    nx: int
    ns: int
    pattern: int  # nt * ns
    step: int  # values from one x to the next in scratch memory
    line: int  # values to a cache line


_BATCH_BYTES = 1 << 19  # the batch being fetched stays in the second-level cache
_RUN_BYTES = 3072  # runs this long are read nearly as fast as all of memory in order
_LEAST_ROWS = 4
_COLUMNS = 32  # positions x turned together; their scratch memory stays in the first-level cache


@njit(_nrt=False)
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
    most = _BATCH_BYTES // (nx * ns * itemsize)
    return max(1, min(max(_LEAST_ROWS, -(-_RUN_BYTES // (ns * itemsize))), nt, most))


def source_rows(shape: Shape) -> NDArray[np.int64]:
    """Return where the columns x of a source row start, repeated periodically as far as a block reaches."""
    _, _, nx, nt, ns = shape
    return np.arange(nx + 2 * LANES, dtype=np.int64) % nx * (nt * ns)


def batch_memory(batches: Batches, dtype: np.dtype[Any]) -> BatchMemory:
    """Return scratch memory for `transpose_batches`."""
    _, _, nx, nt, ns = batches.shape
    line = LINE_BYTES // dtype.itemsize
    # aligned with the rows of the result, with a free line before and after each run
    step = ns + 2 * line + (nt * ns - ns) % line
    # three rows more: the last block of a tile is written in whole steps of four
    scratch = np.empty(step * (_COLUMNS + 3) + 3 * line, dtype)
    return BatchMemory(scratch, step, np.empty(batches.batch * nx * line, dtype))


@njit(_nrt=False)
def transpose_batches(source: Words, out: Words, batches: Batches, memory: BatchMemory, start: int, stop: int) -> None:
    """Write batches ``start`` to ``stop`` of ``nz * ceil(nt / batch)`` of the transposed matrix.

    ``source`` and ``out`` are flat. For one y and t, the tile of all (x, s) maps to a tile: each column s is shifted
    cyclically along x by s - cs. The rows t of a batch are one run of memory for each (y, x) of the source. All runs
    of one y are turned before those of the next, which are fetched meanwhile. A tile goes through registers into
    scratch memory, 16 x 16 values at a time, and from there in whole cache lines past the caches. Rows t and t + 1 of
    the result share a cache line. It is kept in ``ends`` until the next y completes it. Needs ns >= 16.
    """
    ny, nx, nt, ns = batches.shape[1:]
    batch, rows, scratch, ends = batches.batch, batches.rows, memory.scratch, memory.ends
    ct = (nt - 1) // 2
    pattern = nt * ns
    row = nx * pattern
    line = LINE_BYTES // source.itemsize
    sizes = _Sizes(nx, ns, pattern, memory.step, line)
    per_plane = -(-nt // batch)
    for k in range(start, stop):
        z = k // per_plane
        t0 = (k - z * per_plane) * batch
        t1 = min(nt, t0 + batch)
        for y in range(ny):
            # backwards, so that the source is read forwards
            for t in range(t1 - 1, t0 - 1, -1):
                here = (z * ny + y) * row + (nt - 1 - t) * ns
                ahead = here + row if y + 1 < ny else here - y * row - batch * ns
                to = (z * ny + (y - t + ct) % ny) * row + t * ns
                # the rows t - 1 of the same patterns came with y - 1, and the rows t + 1 come with y + 1
                joined = ns >= line and y > 0 and t > t0
                kept = ns >= line and y + 1 < ny and t + 1 < t1
                for x in range(0, nx, _COLUMNS):
                    # scratch is as far into a cache line as its target is: lines are then copied whole
                    at = line + (_address(out) + to + x * pattern - _address(scratch)) % line
                    before = ((t - 1 - t0) * nx + x) * line if joined else -1
                    after = ((t - t0) * nx + x) * line if kept else -1
                    part = _Part(x, min(_COLUMNS, nx - x), here, ahead, to + x * pattern, at, before, after)
                    _begin_runs(ends, out, part, sizes, scratch)
                    _turn_columns(source, rows, part, sizes, scratch)
                    _write_runs(scratch, part, sizes, ends, out)
    # stores past the caches are ordered with nothing else until a fence
    _fence()


@njit(inline="always")
def _begin_runs(ends: Words, out: Words, part: _Part, sizes: _Sizes, scratch: Words) -> None:
    """Copy the beginning of each run's first line to scratch; fetch lines that are written only in part."""
    for i in range(part.columns):
        b = part.to + i * sizes.pattern
        if part.before >= 0:
            past = (_address(out) + b) & (sizes.line - 1)
            _copy_part(ends, part.before + i * sizes.line, scratch, part.at + i * sizes.step - past, sizes.line)
        else:
            _fetch_to_write(out, b)
        if part.after < 0:
            _fetch_to_write(out, b + sizes.ns - 1)


@njit(inline="always")
def _turn_columns(source: Words, rows: Words, part: _Part, sizes: _Sizes, scratch: Words) -> None:
    """Turn the columns of a tile into scratch; fetch those of the tile ahead."""
    nx, ns, step = sizes.nx, sizes.ns, sizes.step
    cs = (ns - 1) // 2
    for block in range(0, ns, LANES):
        c = min(block, ns - LANES)  # the last block overlaps the one before it
        for i in range(0, part.columns, LANES):
            height = min(LANES, part.columns - i)
            for k in range(part.x + i, part.x + i + height):
                _fetch(source, part.ahead + rows[k] + c)
            first = (part.x + i + cs - c - LANES + 1) % nx
            to = part.at + i * step + ns - LANES - c
            # a block's height is part of its code: four sizes waste three rows at most
            if height > 12:
                _shear_16(source, part.here + c, rows, first, scratch, to, step)
            elif height > 8:
                _shear_12(source, part.here + c, rows, first, scratch, to, step)
            elif height > 4:
                _shear_8(source, part.here + c, rows, first, scratch, to, step)
            else:
                _shear_4(source, part.here + c, rows, first, scratch, to, step)


@njit(inline="always")
def _write_runs(scratch: Words, part: _Part, sizes: _Sizes, ends: Words, out: Words) -> None:
    """Copy the runs from scratch to ``out``: whole cache lines past the caches; keep or write the others."""
    ns, line = sizes.ns, sizes.line
    for i in range(part.columns):
        a = part.at + i * sizes.step
        b = part.to + i * sizes.pattern
        past = (_address(out) + b) & (line - 1)
        head = -past if part.before >= 0 else min(ns, -past & (line - 1))
        rest = head + ((ns - head) & -line)
        _stream(scratch, a + head, out, b + head, rest - head)
        if head > 0:
            _copy_part(scratch, a, out, b, head)
        if part.after >= 0:
            _copy_part(scratch, a + rest, ends, part.after + i * line, line)
        else:
            _copy_part(scratch, a + rest, out, b + rest, ns - rest)
