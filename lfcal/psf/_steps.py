"""Patterns in whole steps, with a separate step for each, as they are stored in an H file with a tolerance.

Two errors arise in a pattern: the light outside its plane's window is dropped, and values are rounded to whole steps.
Both are measured on the values as read back, as fractions (L1) of the pattern. An image is a sum of patterns.
Therefore, for any non-negative g, |(H - Hs) g|_1 is at most the largest fraction times the sum of g_v |H_v|_1 over all
voxels v.
`lfcal.reconstruct.Projector` defines its tolerance in the same way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, for_each_chunk
from lfcal.psf._planes import Planes, TransposedPlanes
from lfcal.psf._step_kernels import error_of_step, light_by_line, values_of_steps, write_steps

__all__ = [
    "SteppedPlane",
    "SteppedPlanes",
    "bits_at_most",
    "bound_after",
    "check_store_tolerance",
    "plane_of_steps",
    "step_of_range",
    "stepped_plane",
]

MOST = 65535
"""Largest number of steps over the values of a pattern; rounding the step to few digits may double their number."""

CUT = 0.1
"""Fraction of the tolerance spent on light outside the window, if that saves rows or columns."""

CLOSE = 0.97
"""Fraction of the allowed rounding error above which no larger step is searched for."""

TRIALS = 24
"""Number of steps that are tried at most; five are nearly always enough."""

DIGITS = 2
"""Binary digits of a step: multiples of a step of 24 digits would fill the mantissa of a float32 with noise."""

LEAST_STEP = 2.0**-126
"""Smallest step: the smallest normal float32."""


@dataclass(frozen=True, eq=False)
class SteppedPlane:
    """A plane of H rounded to whole steps.

    Attributes
    ----------
    values
        Values ``(ny, nx, nt, ns)``, float32, each a whole multiple of its pattern's step.
    step
        ``(ny, nx)``, float32, with at most `DIGITS` binary digits, so that multiples have few digits and compress well.
    cut, rounding
        ``(ny, nx)``: error of each pattern outside and inside the window, as a fraction (L1) of the pattern.
    error
        Error of all patterns together, as a fraction of the plane.
    """

    values: NDArray[np.float32]
    step: NDArray[np.float32]
    cut: NDArray[np.float64]
    rounding: NDArray[np.float64]
    error: float

    @property
    def bound(self) -> NDArray[np.float64]:
        """Largest fraction that a pattern loses, ``(3,)``: by cutting, by rounding, and by both together."""
        return np.array([self.cut.max(), self.rounding.max(), (self.cut + self.rounding).max()])


def check_store_tolerance(tolerance: float) -> float:
    """Return a storage tolerance; raise `InputError` unless it is between 0 and 1."""
    if not 0 < tolerance < 1:
        raise InputError.expected(
            "storage tolerance",
            "a fraction above 0 and below 1",
            tolerance,
            "give the tolerance as a fraction, 0.005 for 0.5 %",
        )
    return float(tolerance)


def bits_at_most(tolerance: float) -> float:
    """Return the largest number of bits of an entry for any H: the entropy of a Laplacian, and two bits to spare.

    Of all distributions with mean magnitude b, the Laplacian has the most entropy, log2(2 e b) bits. Steps with a
    mean error of tolerance * b are 4 * tolerance * b wide. Exponents and mantissas are compressed separately, which
    costs about five bits.
    """
    return min(24.0, math.log2(math.e / 2 / tolerance) + 7)


def bound_after(before: NDArray[np.float64] | None, bound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the bound (cut, rounding, both) of values within ``bound`` of values that were within ``before`` of H.

    The patterns after the first loss have at most ``1 + before`` times the light of H's patterns.
    """
    if before is None or not np.isfinite(before).all():
        return bound
    found: NDArray[np.float64] = before + bound * (1 + before[2])
    return found


def stepped_plane(
    plane: NDArray[Any], tolerance: float, *, what: str = "plane", workers: int | None = None
) -> SteppedPlane:
    """Return ``plane`` ``(ny, nx, nt, ns)`` in the largest steps that keep every pattern within ``tolerance`` (L1).

    Raises
    ------
    InputError
        If the plane contains NaN or infinity, or 65535 steps of a pattern are not fine enough.
    """
    limit = check_store_tolerance(tolerance)
    ny, nx, nt, ns = plane.shape
    rows, columns = np.zeros((ny, nx, nt)), np.zeros((ny, nx, ns))
    total, low, high = np.zeros((ny, nx)), np.zeros((ny, nx)), np.zeros((ny, nx))

    def look(start: int, stop: int) -> None:
        for y in range(start, stop):
            for x in range(nx):
                pattern = np.ascontiguousarray(plane[y, x], np.float64)
                total[y, x], low[y, x], high[y, x] = light_by_line(pattern, rows[y, x], columns[y, x])

    for_each_chunk(look, ny, workers)
    if not np.isfinite(total).all():
        y, x = np.argwhere(~np.isfinite(total))[0].tolist()
        raise InputError.expected(
            f"{what}, position ({y}, {x})",
            "finite values",
            "NaN or infinity",
            "find the frame of this position and record it again",
        )
    window = (*_used(rows, total, CUT * limit / 4), *_used(columns, total, CUT * limit / 4))
    values, step = np.empty(plane.shape, np.float32), np.ones((ny, nx), np.float32)
    cut, rounding = np.zeros((ny, nx)), np.zeros((ny, nx))

    def write(start: int, stop: int) -> None:
        for y in range(start, stop):
            for x in range(nx):
                pattern = np.ascontiguousarray(plane[y, x], np.float64)
                ends = float(low[y, x]), float(high[y, x])
                step[y, x] = width = _step(pattern, window, ends, float(total[y, x]), limit)
                outside, lacking, light, lost = write_steps(pattern, window, width, 2 * MOST, values[y, x])
                if light > 0:
                    cut[y, x], rounding[y, x] = outside / light, lacking / light
                if lost or cut[y, x] + rounding[y, x] > limit:
                    raise InputError.expected(
                        f"{what}, position ({y}, {x}), storage tolerance",
                        f"a tolerance that at most {MOST} steps per pattern can meet",
                        f"{100 * limit:.3g} %",
                        "choose a larger tolerance, or store H as float32",
                    )

    for_each_chunk(write, ny, workers)
    light = float(total.sum())
    error = float(((cut + rounding) * total).sum()) / light if light > 0 else 0.0
    return SteppedPlane(values, step, cut, rounding, error)


def _used(lines: NDArray[np.float64], total: NDArray[np.float64], share: float) -> tuple[int, int]:
    """Return the first and last of ``lines`` ``(ny, nx, n)`` outside of which no pattern has more than ``share``.

    The limit applies to each side separately. Nothing is cut from a pattern without light.
    """
    allowed = (share * total)[..., None]
    inside = ((np.cumsum(lines, axis=-1) > allowed) & (total > 0)[..., None]).any(axis=(0, 1))
    back = ((np.cumsum(lines[..., ::-1], axis=-1) > allowed) & (total > 0)[..., None]).any(axis=(0, 1))
    return (int(inside.argmax()), lines.shape[-1] - 1 - int(back.argmax())) if inside.any() else (0, -1)


def _step(
    pattern: NDArray[np.float64],
    window: tuple[int, int, int, int],
    ends: tuple[float, float],
    total: float,
    tolerance: float,
) -> float:
    """Return approximately the largest step of few binary digits that keeps a pattern within ``tolerance``.

    A few steps are tried. Each is extrapolated from the errors of the last two, as a power of the step.
    """
    low, high = min(ends[0], 0.0), max(ends[1], 0.0)
    if total == 0 or window[1] < window[0]:
        return 1.0
    inner = pattern[window[0] : window[1] + 1, window[2] : window[3] + 1]
    # values are read back as float32, so that this rounding is part of the measured error
    room = max(0.0, (tolerance - 2e-7) * total - max(0.0, total - float(np.abs(inner).sum())))
    # rounding errors are at most half a step, and a quarter on average
    finest = (high - low) / (MOST - 1)
    step = max(finest, 4 * room / inner.size)
    good, bad, last = finest, math.inf, (0.0, 0.0)
    for _ in range(TRIALS):
        step = float(np.float32(step))
        if not 0 < step < math.inf:
            break
        found = error_of_step(pattern, window, step)
        good, bad = (max(good, step), bad) if found <= room else (good, min(bad, step))
        if CLOSE * room <= found <= room or bad <= finest:
            break
        power = 1.0
        if last[1] > 0 < found and last[1] != found and last[0] != step:
            power = float(np.clip(math.log(found / last[1]) / math.log(step / last[0]), 0.3, 3))
        last = (step, found)
        guess = step * (0.985 * room / found) ** (1 / power) if found > 0 else 16 * step
        # bisect between a good and a bad step once both are known
        step = guess if good < guess < bad else math.sqrt(good * bad) if math.isfinite(bad) else 4 * good
        if (math.isfinite(bad) and bad < 1.001 * good) or step > 4 * (high - low):
            break
    return _of_few_digits(pattern, window, float(np.float32(good)), room) if good >= LEAST_STEP else 1.0


def _of_few_digits(pattern: NDArray[np.float64], window: tuple[int, int, int, int], step: float, room: float) -> float:
    """Return the largest step of few binary digits up to ``step`` whose error is at most ``room``; else ``step``.

    The error need not grow with the step: a pattern of multiples of one step fits it better than a finer one.
    """
    mantissa, exponent = math.frexp(step)
    digits = math.floor(mantissa * 2**DIGITS)
    for _ in range(3 * 2 ** (DIGITS - 1)):
        found = math.ldexp(digits, exponent - DIGITS)
        if found < LEAST_STEP:
            break
        if error_of_step(pattern, window, found) <= room:
            return found
        digits, exponent = (digits - 1, exponent) if digits > 2 ** (DIGITS - 1) else (2**DIGITS - 1, exponent - 1)
    return step


def step_of_range(low: float, high: float) -> float:
    """Return the largest power of two of which the range from ``low`` to ``high``, extended to 0, holds 65535 steps.

    Return 0 if that step would be too small. The mean rounding error is a quarter of the step; whole numbers up to
    65535 are not rounded at all.
    """
    spread = max(high, 0.0) - min(low, 0.0)
    return 2.0 ** math.floor(math.log2(spread / MOST)) if spread / MOST >= LEAST_STEP else 0.0


def plane_of_steps(
    stored: NDArray[np.uint16], step: NDArray[np.float32], zero: NDArray[np.uint16], workers: int | None = None
) -> NDArray[np.float32]:
    """Return the values of a plane ``(ny, nx, nt, ns)`` of a file of version 3."""
    ny, nx = stored.shape[:2]
    out = np.empty(stored.shape, np.float32)
    counts, values = stored.reshape(ny, nx, -1), out.reshape(ny, nx, -1)

    def rows(start: int, stop: int) -> None:
        for y in range(start, stop):
            values_of_steps(counts[y], step[y], zero[y], values[y])

    for_each_chunk(rows, ny, workers)
    return out


class SteppedPlanes:
    """Planes of a file of version 3: value = (stored - zero[z, y, x]) * step[z, y, x], as float32."""

    def __init__(self, base: Planes, step: NDArray[np.float32], zero: NDArray[np.uint16]) -> None:
        self.base, self.step, self.zero = base, step, zero
        self.shape = base.shape
        self.dtype: np.dtype[Any] = np.dtype(np.float32)

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as float32."""
        return plane_of_steps(self.base.plane(z), self.step[z], self.zero[z])

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern as float32."""
        pattern, at = self.base.cutout(z, y, x)[None, None], (z, slice(y, y + 1), slice(x, x + 1))
        found: NDArray[Any] = plane_of_steps(pattern, self.step[at], self.zero[at], 1)[0, 0]
        return found

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix, whose patterns each contain values of many steps."""
        return TransposedPlanes(self)
