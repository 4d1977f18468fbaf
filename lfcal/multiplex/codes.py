"""Codes of points that are lit together: S-matrices, random ones, one point at a time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_choice, check_number

__all__ = ["CODES", "MOST_POINTS", "code_matrix", "random_code", "s_matrix", "s_matrix_orders"]

Array = NDArray[np.float64]

CODES = ("S", "random", "single")
"""S-matrix, random, and one point at a time."""

MOST_POINTS = 1023


def s_matrix_orders(most: int = MOST_POINTS) -> list[int]:
    """Return the orders up to ``most`` of which `s_matrix` knows one: primes of the form 4k - 1, and 2^n - 1."""
    return [n for n in range(3, most + 1) if _is_paley(n) or (n & (n + 1)) == 0]


def s_matrix(order: int) -> Array:
    """Return an S-matrix ``(order, order)`` of 0 and 1: the best code under additive noise (Harwit and Sloane 1979).

    Every row and column has (n + 1)/2 ones, S S^T = (n + 1)/4 (I + J), and the inverse is 2/(n + 1) (2 S^T - J). For
    primes 4k - 1 its rows are shifts of the quadratic residues and 0, for 2^n - 1 it is Sylvester's Hadamard matrix
    without its first row and column.

    Raises
    ------
    InputError
        If no S-matrix of this order is known here.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import s_matrix
    >>> S = s_matrix(7)
    >>> print(S.astype(int)[:2])
    [[1 1 1 0 1 0 0]
     [1 1 0 1 0 0 1]]
    >>> print((np.linalg.inv(S) ** 2).sum(axis=1).round(4))  # variance 4 n/(n + 1)^2 of that of single points
    [0.4375 0.4375 0.4375 0.4375 0.4375 0.4375 0.4375]
    """
    check_number("order of the S-matrix", order, at_least=3, at_most=MOST_POINTS, integer=True)
    if _is_paley(order):
        on = np.zeros(order)
        on[[k * k % order for k in range(order)]] = 1
        places = (np.arange(order)[None, :] + np.arange(order)[:, None]) % order
        return np.asarray(on[places])
    if (order & (order + 1)) == 0:
        number = np.arange(1, order + 1)
        both, odd = number[:, None] & number, np.zeros((order, order), np.intp)
        for bit in range(order.bit_length()):
            odd ^= both >> bit & 1
        return odd.astype(float)
    near = min(s_matrix_orders(), key=lambda n: abs(n - order))
    wanted = "a prime 4k - 1, or a power of two less 1"
    raise InputError.expected("order of the S-matrix", wanted, order, f"the nearest is {near}")


def _is_paley(n: int) -> bool:
    return n % 4 == 3 and all(n % k for k in range(2, math.isqrt(n) + 1))


def random_code(frames: int, points: int, density: float, rng: np.random.Generator) -> Array:
    """Return a random code ``(frames, points)`` of 0 and 1 that tells all points apart.

    Raises
    ------
    InputError
        If there are fewer frames than points, or a hundred draws tell none apart.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import random_code
    >>> code = random_code(12, 6, 0.5, np.random.default_rng(0))
    >>> print(code.shape, np.unique(code), np.linalg.matrix_rank(code))
    (12, 6) [0. 1.] 6
    """
    check_number("points", points, at_least=1, at_most=MOST_POINTS, integer=True)
    check_number("frames of a random code", frames, at_least=points, at_most=4 * MOST_POINTS, integer=True)
    check_number("share of points that are lit", density, above=0, below=1)
    for _ in range(100):
        code = np.asarray(rng.random((frames, points)) < density, float)
        if np.linalg.matrix_rank(code) == points:
            return code
    raise InputError.expected("random code", "one that tells all points apart", "none of 100", "take more frames")


def code_matrix(
    kind: str, points: int, *, frames: int | None = None, density: float = 0.5, rng: np.random.Generator | None = None
) -> Array:
    """Return a code ``(frames, points)``: which points are lit in which frame.

    Parameters
    ----------
    kind
        ``"S"``: the S-matrix of the least order that has as many columns, the others left out; ``"random"``; or
        ``"single"``: one point at a time.
    points
        Number of points whose patterns overlap.
    frames, density, rng
        Of random codes: as many frames as points by default, share that is lit, source (seeded by default).

    Examples
    --------
    >>> from lfcal.multiplex import code_matrix
    >>> code = code_matrix("S", 5)  # the S-matrix of 7 without two columns
    >>> print(code.shape, code.sum(axis=0))  # each point is lit in 4 of 7 frames
    (7, 5) [4. 4. 4. 4. 4.]
    >>> print(code_matrix("single", 3))
    [[1. 0. 0.]
     [0. 1. 0.]
     [0. 0. 1.]]
    """
    check_choice("code", kind, CODES)
    check_number("points", points, at_least=1, at_most=MOST_POINTS, integer=True)
    if frames is not None and kind != "random":
        raise InputError.expected("frames", "none but for random codes", frames, "leave them out")
    if kind == "single":
        return np.eye(points)
    if kind == "random":
        return random_code(points if frames is None else frames, points, density, rng or np.random.default_rng(0))
    order = next(n for n in s_matrix_orders(2 * MOST_POINTS) if n >= points)
    return s_matrix(order)[:, :points]
