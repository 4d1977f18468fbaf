"""Light of a response on the microscope's separable path, from the field's factors on rows and columns of nodes.

numba cannot express registers that hold sums over a whole loop. It is therefore written as LLVM code for any processor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["ACROSS", "DOWN", "row_light"]

Reals = NDArray[np.float32]
DOWN, ACROSS = 8, 16
"""Nodes along y and along x whose light is computed together."""
_I32, _I64, _REAL = ir.IntType(32), ir.IntType(64), ir.FloatType()


def _blocks(context: Any) -> tuple[int, int]:
    """Return the rows and columns whose sums fit into the registers of the processor that code is made for."""
    return (DOWN, ACROSS) if "+avx512f" in context.codegen().magic_tuple()[2] else (DOWN // 2, ACROSS // 2)


def _sums(b: Any, lanes: int, rows: list[Any], column: Any, strides: tuple[Any, Any], count: Any) -> list[list[Any]]:
    """Return, for each row, the sums of the products of its three parts with those of the columns."""
    kind = ir.VectorType(_REAL, lanes)
    none, first = ir.Constant(kind, ir.Undefined), ir.Constant(ir.VectorType(_I32, lanes), [0] * lanes)
    fused = cgutils.get_or_insert_function(b.module, ir.FunctionType(kind, [kind] * 3), f"llvm.fmuladd.v{lanes}f32")
    zero = ir.Constant(kind, [0.0] * lanes)
    sums = [[cgutils.alloca_once_value(b, zero) for _ in range(3)] for _ in rows]
    for each in sums:
        for one in each:
            b.store(zero, one)
    with cgutils.for_range(b, count) as loop:
        here = b.gep(column, [b.mul(loop.index, ir.Constant(_I64, ACROSS))])
        for part in range(3):
            beyond = b.gep(here, [b.mul(strides[1], ir.Constant(_I64, part))])
            right = b.load(b.bitcast(beyond, kind.as_pointer()), align=4)
            for row, each in zip(rows, sums, strict=True):
                place = b.add(loop.index, b.mul(strides[0], ir.Constant(_I64, part)))
                one = b.insert_element(none, b.load(b.gep(row, [place])), ir.Constant(_I32, 0))
                left = b.shuffle_vector(one, none, first)
                b.store(b.call(fused, [left, right, b.load(each[part])]), each[part])
    return [[b.load(one) for one in each] for each in sums]


@intrinsic  # type: ignore[untyped-decorator]
def _tile(
    _: Any, left: Any, i: Any, apart: Any, right: Any, j: Any, beyond: Any, count: Any, light: Any, at: Any, row: Any
) -> Any:
    """Fill `DOWN` rows of ``light``, ``row`` apart, from ``at`` on, with the light of `ACROSS` nodes each.

    ``apart`` and ``beyond`` are the distances between the parts of the factors, of which ``count`` numbers are summed.
    """

    def implement(context: Any, b: Any, signature: Any, arguments: Any) -> Any:
        a, c, out = (context.make_array(signature.args[n])(context, b, arguments[n]).data for n in (0, 3, 7))
        _, i, apart, _, j, beyond, count, _, at, row = arguments
        high, lanes = _blocks(context)
        for first in range(0, DOWN, high):
            numbers = [ir.Constant(_I64, n) for n in range(first, first + high)]
            rows = [b.gep(a, [b.add(i, b.mul(n, count))]) for n in numbers]
            for lane in range(0, ACROSS, lanes):
                aside = ir.Constant(_I64, lane)
                found = _sums(b, lanes, rows, b.gep(c, [b.add(j, aside)]), (apart, beyond), count)
                for n, (p, q, s) in zip(numbers, found, strict=True):
                    re, im = b.fsub(p, q), b.fsub(b.fsub(s, p), q)
                    place = b.gep(out, [b.add(b.add(at, aside), b.mul(n, row))])
                    power = b.fadd(b.fmul(re, re), b.fmul(im, im))
                    b.store(power, b.bitcast(place, power.type.as_pointer()), align=4)
        return context.get_dummy_value()

    n = types.int64
    return types.void(left, n, n, right, n, n, n, light, n, n), implement


@njit(fastmath=True)
def row_light(left: Reals, right: Reals, pixels: NDArray[np.int64], weights: Reals, lines: Reals) -> None:
    """Add |sum_n left[y, n] right[n, x]|^2 at all nodes to the pixels along y, ``lines`` (pixels, nodes along x).

    Parameters
    ----------
    left
        Factor along y ``(3, nodes, n)``: real part, imaginary part and their sum; nodes are a multiple of `DOWN`.
    right
        Factor along x ``(3, blocks, n, ACROSS)``, from `in_blocks`.
    pixels, weights
        Pixels that a node along y belongs to, and its weights there ``(nodes, most)``; pixel -1 means none.
    """
    count, blocks = left.shape[2], right.shape[1]
    apart, beyond, width = left.shape[1] * count, blocks * count * ACROSS, blocks * ACROSS
    light = np.empty((DOWN, width), lines.dtype)
    for first in range(0, left.shape[1], DOWN):
        for block in range(blocks):
            at = block * ACROSS
            _tile(left, first * count, apart, right, at * count, beyond, count, light, at, width)
        for i in range(min(DOWN, pixels.shape[0] - first)):
            for j in range(pixels.shape[1]):
                pixel = pixels[first + i, j]
                if pixel >= 0:
                    weight = weights[first + i, j]
                    for x in range(lines.shape[1]):
                        lines[pixel, x] += weight * light[i, x]
