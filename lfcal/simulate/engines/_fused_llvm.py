"""Compiled passes of a response on a grid: fast Fourier transforms on lanes, with all steps between them.

Each lane holds one complex number of a separate transform. `LANES` columns or rows of the grid are thus transformed
together in the caches (Van Loan, Computational Frameworks for the Fast Fourier Transform, 1992). The forward transform
decimates in frequency (Gentleman and Sande 1966), which leaves the frequencies in digit-reversed order. The inverse
decimates in time (Cooley and Tukey 1965), which accepts this order, so that no reordering is needed. Butterflies of
composite size consist of smaller ones (those of Good 1958 if their sizes have no common factor). numba cannot express
lanes, so they are written as LLVM code for any processor. The order of sums is fixed, and results are identical in
every run.

A buffer of ``n`` numbers on lanes is an array (n, 2, LANES) of reals, real parts before imaginary ones; addresses are
counted in reals. The inverse is the forward transform with real and imaginary parts exchanged at its start and end.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["LANES", "RADICES", "STEP", "Pixels", "ResponseGrid", "Stages", "Way", "Work", "respond"]

Reals = NDArray[np.float32]

LANES = 16
"""Number of transforms done together, such that each part fills a cache line."""

STEP = 2 * LANES
"""Reals from one number on lanes to the next."""

RADICES = (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12)
"""Sizes of butterflies."""

_I32, _I64, _REAL = ir.IntType(32), ir.IntType(64), ir.FloatType()
_LANES = ir.VectorType(_REAL, LANES)


class Stages(NamedTuple):
    """Stages of butterflies of a transform; the last stage has no twiddle factors."""

    radices: NDArray[np.int64]
    starts: NDArray[np.int64]  # start of the factors of each stage
    twiddles: Reals  # exp(-2 pi i j k / block) as (re, im): for each j, k = 1 ... radix - 1


class Way(NamedTuple):
    """A transform: its first stage, and the further stages for each block that it leaves, in the nearest cache."""

    first: Stages
    then: Stages


class ResponseGrid(NamedTuple):
    """Inputs of responses; arrays of complex numbers are flat arrays of reals (re, im)."""

    lit: Reals  # field incident on the array (n, n)
    seen: Reals  # transmission of the array, a table of which each position's grid is a part
    width: int  # of that table
    corners: NDArray[np.int64]  # index in the table of the first sample of each position's grid
    side: int  # n
    transfer: Reals  # to the sensor: a buffer for each LANES rows of frequencies, over n^2


class Pixels(NamedTuple):
    """The pixels of a cutout: each uses samples ``per`` apart from its neighbour's, one for each weight."""

    weights: Reals
    per: int
    top: int  # first samples of the first pixel
    left: int
    rows: int
    columns: int


class Work(NamedTuple):
    """Scratch memory of a thread, aligned to the lanes and filled with zeros."""

    columns: Reals  # a buffer for each LANES columns, with LANES * ceil(n / LANES) numbers each
    rows: Reals  # one buffer
    lines: Reals  # (rows of pixels, n): light on the samples of a row
    sums: Reals  # (LANES,): power on each lane


# -- code on lanes ----------------------------------------------------------------------------------------
class _Wave:
    """A complex number on each lane, as LLVM values."""

    def __init__(self, b: Any, re: Any, im: Any) -> None:
        self.b, self.re, self.im = b, re, im

    def __add__(self, other: _Wave) -> _Wave:
        return _Wave(self.b, self.b.fadd(self.re, other.re), self.b.fadd(self.im, other.im))

    def __sub__(self, other: _Wave) -> _Wave:
        return _Wave(self.b, self.b.fsub(self.re, other.re), self.b.fsub(self.im, other.im))

    def turned(self) -> _Wave:
        """Return -i times this number."""
        return _Wave(self.b, self.im, self.b.fneg(self.re))

    def scaled(self, by: float, plus: _Wave | None = None) -> _Wave:
        """Return a real number times this number, plus another."""
        c = ir.Constant(_LANES, [by] * LANES)
        if plus is None:
            return _Wave(self.b, self.b.fmul(c, self.re), self.b.fmul(c, self.im))
        return _Wave(self.b, _fused(self.b, c, self.re, plus.re), _fused(self.b, c, self.im, plus.im))

    def times(self, re: Any, im: Any) -> _Wave:
        b = self.b
        real = _fused(b, self.re, re, b.fneg(b.fmul(self.im, im)))
        return _Wave(b, real, _fused(b, self.re, im, b.fmul(self.im, re)))

    def rotated(self, part: int, whole: int) -> _Wave:
        """Return exp(-2 pi i part / whole) times this number."""
        quarters, rest = divmod(4 * part, whole)
        found = self
        for _ in range(quarters % 4):
            found = found.turned()
        if rest:
            w = cmath.exp(-0.5j * math.pi * rest / whole)
            found = found.times(*(ir.Constant(_LANES, [x] * LANES) for x in (w.real, w.imag)))
        return found


def _fused(b: Any, x: Any, y: Any, plus: Any) -> Any:
    """Return x y + plus, rounded once where the processor is quick at it."""
    kind = ir.FunctionType(_LANES, [_LANES] * 3)
    return b.call(cgutils.get_or_insert_function(b.module, kind, f"llvm.fmuladd.v{LANES}f32"), [x, y, plus])


def _butterfly(a: list[_Wave]) -> list[_Wave]:
    """Return the transform of a few numbers, in order."""
    n = len(a)
    if n == 2:
        return [a[0] + a[1], a[0] - a[1]]
    first = next((f for f in (4, 3, 2, 5) if n % f == 0 and n > f), n)
    if n == 4:
        s, t, u, v = a[0] + a[2], a[0] - a[2], a[1] + a[3], (a[1] - a[3]).turned()
        return [s + u, t + v, s - u, t - v]
    if first == n:
        return _prime_butterfly(a)
    other, out = n // first, list(a)
    if math.gcd(first, other) == 1:
        # time is other i + first j; the frequency follows from the remainders (Good 1958)
        inner = [_butterfly([a[(other * i + first * j) % n] for i in range(first)]) for j in range(other)]
        for k in range(first):
            for m, wave in enumerate(_butterfly([row[k] for row in inner])):
                out[next(q for q in range(n) if q % first == k and q % other == m)] = wave
        return out
    inner = [_butterfly(a[j::other]) for j in range(other)]
    for k in range(first):
        out[k::first] = _butterfly([row[k].rotated(j * k, n) for j, row in enumerate(inner)])
    return out


def _prime_butterfly(a: list[_Wave]) -> list[_Wave]:
    n, out = len(a), list(a)
    pairs = range(1, n // 2 + 1)
    sums, differences = [a[j] + a[n - j] for j in pairs], [a[j] - a[n - j] for j in pairs]
    for s in sums:
        out[0] = out[0] + s
    for k in pairs:
        even, odd = a[0], None
        for j in pairs:
            angle = 2 * math.pi * (j * k % n) / n
            even = sums[j - 1].scaled(math.cos(angle), even)
            odd = differences[j - 1].scaled(math.sin(angle), odd)
        assert odd is not None
        turned = odd.turned()
        out[k], out[n - k] = even + turned, even - turned
    return out


def _reals(context: Any, b: Any, signature: Any, arguments: Any, which: int) -> Any:
    """Return the pointer to the first number of an array of reals."""
    return context.make_array(signature.args[which])(context, b, arguments[which]).data


def _lanes_at(b: Any, data: Any, at: Any, beyond: int = 0) -> Any:
    place = b.gep(data, [b.add(at, ir.Constant(_I64, beyond))])
    return b.bitcast(place, _LANES.as_pointer())


def _load(b: Any, data: Any, at: Any) -> _Wave:
    return _Wave(b, *(b.load(_lanes_at(b, data, at, part), align=4) for part in (0, LANES)))


def _store(b: Any, data: Any, at: Any, wave: _Wave) -> None:
    for part, lanes in ((0, wave.re), (LANES, wave.im)):
        b.store(lanes, _lanes_at(b, data, at, part), align=4)


def _same(b: Any, value: Any) -> Any:
    """Return a real number on all lanes."""
    none = ir.Constant(_LANES, ir.Undefined)
    one = b.insert_element(none, value, ir.Constant(_I32, 0))
    return b.shuffle_vector(one, none, ir.Constant(ir.VectorType(_I32, LANES), [0] * LANES))


def _picked(b: Any, pair: tuple[Any, ...], places: list[int]) -> Any:
    """Return the lanes ``places`` of two vectors; the lanes of the second are numbered after those of the first."""
    return b.shuffle_vector(*pair, ir.Constant(ir.VectorType(_I32, LANES), places))


def _define_step(function: Any, before: bool, after: bool) -> None:
    """Write the code of a stage (see `_stage`): a loop over the butterflies of each size."""
    data, at, apart, factors, first, radix = function.args
    b = ir.IRBuilder(function.append_basic_block())
    end = b.append_basic_block("end")
    chosen = b.switch(radix, end)

    def twiddled(wave: _Wave, own: Any, k: int) -> _Wave:
        if not k:
            return wave
        places = (b.gep(own, [ir.Constant(_I64, 2 * k - part)]) for part in (2, 1))
        return wave.times(*(_same(b, b.load(place)) for place in places))

    for n in RADICES:
        block = b.append_basic_block(f"radix{n}")
        chosen.add_case(ir.Constant(_I64, n), block)
        b.position_at_end(block)
        starts = [b.gep(data, [b.add(at, b.mul(apart, ir.Constant(_I64, k * STEP)))]) for k in range(n)]
        with cgutils.for_range(b, apart) as loop:
            here = b.mul(loop.index, ir.Constant(_I64, STEP))
            own = b.gep(factors, [b.add(first, b.mul(loop.index, ir.Constant(_I64, 2 * n - 2)))])
            waves = [_load(b, start, here) for start in starts]
            if before:
                waves = [twiddled(wave, own, k) for k, wave in enumerate(waves)]
            waves = _butterfly(waves)
            if after:
                waves = [twiddled(wave, own, k) for k, wave in enumerate(waves)]
            for start, wave in zip(starts, waves, strict=True):
                _store(b, start, here, wave)
        b.branch(end)
    b.position_at_end(end)
    b.ret_void()


def _step(module: Any, before: bool, after: bool) -> Any:
    """Return ``step(x, at, apart, twiddles, first, radix)``, which computes ``apart`` butterflies in place.

    The first begins at ``at``, and the numbers of a butterfly are ``apart`` from one another. Twiddle factors, from
    ``first`` on, are applied before or after the butterflies.
    """
    pointer = _REAL.as_pointer()
    return _function(
        module,
        f"lfcal_step_{before:d}_{after:d}",
        [pointer, _I64, _I64, pointer, _I64, _I64],
        lambda function: _define_step(function, before, after),
    )


def _function(module: Any, name: str, kinds: list[Any], define: Callable[[Any], None]) -> Any:
    """Return a function of LLVM code that is defined once, because code at each call would take long to compile."""
    function = cgutils.get_or_insert_function(module, ir.FunctionType(ir.VoidType(), kinds), name)
    if not function.blocks:
        function.linkage = "internal"
        function.attributes.add("noinline")
        define(function)
    return function


def _define_stages(function: Any, back: bool) -> None:
    """Write the code of the stages of a transform (see `_transform`)."""
    data, at, count, radices, starts, stages, twiddles = function.args
    b = ir.IRBuilder(function.append_basic_block())
    last, step = _step(b.module, False, False), _step(b.module, back, not back)
    one, lane_step = ir.Constant(_I64, 1), ir.Constant(_I64, STEP)
    apart_at = cgutils.alloca_once_value(b, count)

    def radix_of(s: Any) -> Any:
        return b.load(b.gep(radices, [s]))

    if back:  # from the last stage to the first
        with cgutils.for_range(b, stages) as loop:
            b.store(b.udiv(b.load(apart_at), radix_of(loop.index)), apart_at)
    end = b.add(at, b.mul(count, lane_step))
    with cgutils.for_range(b, stages) as loop:
        s = b.sub(b.sub(stages, loop.index), one) if back else loop.index
        radix, found = radix_of(s), b.load(apart_at)
        block, apart = (b.mul(found, radix), found) if back else (found, b.udiv(found, radix))
        b.store(block if back else apart, apart_at)
        with cgutils.for_range_slice(b, at, end, b.mul(block, lane_step), _I64) as (start, _):
            with b.if_else(b.icmp_unsigned("==", apart, one)) as (then, otherwise):
                with then:
                    b.call(last, [data, start, one, twiddles, ir.Constant(_I64, 0), radix])
                with otherwise:
                    b.call(step, [data, start, apart, twiddles, b.load(b.gep(starts, [s])), radix])
    b.ret_void()


def _transform(back: bool) -> Any:
    """Make ``transform(x, at, count, stages)``: some stages of a transform of ``count`` numbers at ``at``, in place.

    The inverse undoes the same stages, for numbers whose real and imaginary parts are exchanged.
    """

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        parts = cgutils.unpack_tuple(b, arguments[3], 3)
        radices, starts, twiddles = (
            context.make_array(kind)(context, b, part) for kind, part in zip(signature.args[3], parts, strict=True)
        )
        reals, whole = _REAL.as_pointer(), _I64.as_pointer()
        kinds = [reals, _I64, _I64, whole, whole, _I64, reals]
        name = f"lfcal_stages_{back:d}"
        function = _function(b.module, name, kinds, lambda made: _define_stages(made, back))
        data = _reals(context, b, signature, arguments, 0)
        b.call(function, [data, *arguments[1:3], radices.data, starts.data, radices.nitems, twiddles.data])
        return context.get_dummy_value()

    def typed(_: Any, x: Any, at: Any, count: Any, stages: Any) -> Any:
        return types.void(x, types.int64, types.int64, stages), implement

    return intrinsic(typed)


_forth, _back = _transform(back=False), _transform(back=True)


@intrinsic  # type: ignore[untyped-decorator]
def _multiply(_: Any, lit: Any, i: Any, seen: Any, j: Any, x: Any, at: Any, rows: Any, sums: Any) -> Any:
    """Fill x from ``at`` on with products of ``LANES`` numbers (re, im) of two arrays on each of several rows.

    ``rows`` are their number, and the distance (reals) between them in either array; ``sums`` receive the power of the
    products.
    """

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        lit, seen, x, sums = (_reals(context, b, signature, arguments, which) for which in (0, 2, 4, 7))
        count, *apart = cgutils.unpack_tuple(b, arguments[6], 3)
        powers = [cgutils.alloca_once_value(b, ir.Constant(_LANES, [0.0] * LANES)) for _ in range(2)]
        with cgutils.for_range(b, count) as loop:
            waves = []
            for data, start, step in ((lit, arguments[1], apart[0]), (seen, arguments[3], apart[1])):
                first = b.add(start, b.mul(loop.index, step))
                pair = tuple(b.load(_lanes_at(b, data, first, part), align=4) for part in (0, LANES))
                waves.append(_Wave(b, *(_picked(b, pair, list(range(part, STEP, 2))) for part in (0, 1))))
            found = waves[0].times(waves[1].re, waves[1].im)
            _store(b, x, b.add(arguments[5], b.mul(loop.index, ir.Constant(_I64, STEP))), found)
            for power, part in zip(powers, (found.re, found.im), strict=True):
                b.store(_fused(b, part, part, b.load(power)), power)
        total = b.fadd(*(b.load(power) for power in powers))
        b.store(total, b.bitcast(sums, _LANES.as_pointer()), align=4)
        return context.get_dummy_value()

    whole = types.int64
    return types.void(lit, whole, seen, whole, x, whole, rows, sums), implement


@intrinsic  # type: ignore[untyped-decorator]
def _transfer(_: Any, x: Any, at: Any, factors: Any, first: Any) -> Any:
    """Multiply the numbers at ``at`` by those of a buffer at ``first``, and exchange real and imaginary part."""

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        x, factors = (_reals(context, b, signature, arguments, which) for which in (0, 2))
        by = _load(b, factors, arguments[3])
        found = _load(b, x, arguments[1]).times(by.re, by.im)
        _store(b, x, arguments[1], _Wave(b, found.im, found.re))
        return context.get_dummy_value()

    return types.void(x, types.int64, factors, types.int64), implement


@intrinsic  # type: ignore[untyped-decorator]
def _collect(_: Any, x: Any, at: Any, weights: Any, count: Any, line: Any, j: Any) -> Any:
    """Set line[j ...] to the power of the ``count`` numbers from ``at`` on, summed with their weights."""

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        x, weights, line = (_reals(context, b, signature, arguments, which) for which in (0, 2, 4))
        total = cgutils.alloca_once_value(b, ir.Constant(_LANES, [0.0] * LANES))
        with cgutils.for_range(b, arguments[3]) as loop:
            wave = _load(b, x, b.add(arguments[1], b.mul(loop.index, ir.Constant(_I64, STEP))))
            weight = _same(b, b.load(b.gep(weights, [loop.index])))
            power = _fused(b, wave.im, wave.im, b.fmul(wave.re, wave.re))
            b.store(_fused(b, weight, power, b.load(total)), total)
        b.store(b.load(total), _lanes_at(b, line, arguments[5]), align=4)
        return context.get_dummy_value()

    return types.void(x, types.int64, weights, types.int64, line, types.int64), implement


@intrinsic  # type: ignore[untyped-decorator]
def _turn(_: Any, x: Any, at: Any, y: Any, to: Any) -> Any:
    """Copy ``LANES`` numbers on lanes from ``at`` to ``to``; lanes and numbers are exchanged (Eklundh 1972)."""

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        x, y = (_reals(context, b, signature, arguments, which) for which in (0, 2))
        for part in (0, LANES):
            rows = [b.load(_lanes_at(b, x, arguments[1], part + k * STEP), align=4) for k in range(LANES)]
            half = LANES // 2
            while half:
                lower = [lane + (LANES - half if lane & half else 0) for lane in range(LANES)]
                upper = [lane + (LANES if lane & half else half) for lane in range(LANES)]
                for k in (k for k in range(LANES) if not k & half):
                    pair = rows[k], rows[k + half]
                    rows[k], rows[k + half] = _picked(b, pair, lower), _picked(b, pair, upper)
                half //= 2
            for k, lanes in enumerate(rows):
                b.store(lanes, _lanes_at(b, y, arguments[3], part + k * STEP), align=4)
        return context.get_dummy_value()

    return types.void(x, types.int64, y, types.int64), implement


# -- transforms -------------------------------------------------------------------------------------------
@njit(inline="always")
def _light_on_rows(grid: ResponseGrid, corner: int, way: Way, pixels: Pixels, work: Work) -> float:
    """Fill ``work.lines`` with the light on rows of pixels, at the samples of columns that pixels see.

    Returns the power just behind the array, summed over its samples.
    """
    n, size = grid.side, work.rows.size
    groups, part = work.columns.size // size, n // way.first.radices[0]
    # behind the array, transformed along y; the last group of columns overlaps the previous one
    energy, sums, rows = 0.0, work.sums, (n, 2 * n, 2 * grid.width)
    for g in range(groups):
        left, at = min(g * LANES, n - LANES), g * size
        _multiply(grid.lit, 2 * left, grid.seen, 2 * (corner + left), work.columns, at, rows, sums)
        for k in range(g * LANES - left, LANES):
            energy += sums[k]
        _forth(work.columns, at, n, way.first)
        for start in range(at, at + n * STEP, part * STEP):
            _forth(work.columns, start, part, way.then)

    # along x, over the gap, and back, for the samples that pixels use
    beyond = pixels.left + (pixels.columns - 1) * pixels.per + pixels.weights.size
    seen = range(pixels.left // LANES, min((beyond + LANES - 1) // LANES, groups))
    whole = n * STEP
    for at in range(0, size, LANES * STEP):
        for g in range(groups):
            _turn(work.columns, g * size + at, work.rows, min(g * LANES, n - LANES) * STEP)
        own = at // STEP * n * 2
        _forth(work.rows, 0, n, way.first)
        for start in range(0, whole, part * STEP):
            _forth(work.rows, start, part, way.then)
            for k in range(start, start + part * STEP, STEP):
                _transfer(work.rows, k, grid.transfer, own + k)
            _back(work.rows, start, part, way.then)
        _back(work.rows, 0, n, way.first)
        for g in seen:
            _turn(work.rows, min(g * LANES, n - LANES) * STEP, work.columns, g * size + at)

    # back along y, to rows of pixels
    for g in seen:
        left, at = min(g * LANES, n - LANES), g * size
        for start in range(at, at + n * STEP, part * STEP):
            _back(work.columns, start, part, way.then)
        _back(work.columns, at, n, way.first)
        for t in range(pixels.rows):
            row = at + (pixels.top + t * pixels.per) * STEP
            _collect(work.columns, row, pixels.weights, pixels.weights.size, work.lines, t * n + left)
    return energy


@njit(inline="always")
def _add_up(lines: Reals, side: int, pixels: Pixels, out: NDArray[Any]) -> None:
    """Fill ``out`` (rows, columns) with the light on pixels, from that on the samples of their rows."""
    for t in range(pixels.rows):
        for s in range(pixels.columns):
            first, total = t * side + pixels.left + s * pixels.per, np.float32(0)
            for i in range(pixels.weights.size):
                total += pixels.weights[i] * lines[first + i]
            out[t, s] = total


@njit(_nrt=False)
def respond(grid: ResponseGrid, way: Way, pixels: Pixels, work: Work, out: Reals, powers: NDArray[np.float64]) -> None:
    """Fill ``out`` (positions, rows, columns) with the light on pixels, and the powers just behind the array."""
    for k in range(grid.corners.size):
        powers[k] = _light_on_rows(grid, grid.corners[k], way, pixels, work)
        _add_up(work.lines, grid.side, pixels, out[k])
