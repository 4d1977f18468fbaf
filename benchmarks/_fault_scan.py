"""Faults of scans and stages: functions of a recording and a strength that return all patterns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_recordings import PutIn, Recording

__all__ = [
    "blank",
    "doubled",
    "drift",
    "late",
    "lines_swapped",
    "mirrored",
    "play",
    "repeated",
    "scattered",
    "screw",
    "some",
    "sources",
    "swapped",
    "unwound",
    "whole",
]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


def rows_joined(values: F4) -> F4:
    return values.reshape(values.shape[0], -1, *values.shape[3:])


def swapped(far: bool) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        values = r.clean()
        frames = rows_joined(values)
        n, rng = frames.shape[1], np.random.default_rng(4)
        for _ in range(int(s)):
            k = int(rng.integers(n // 4, n // 2))
            other = k + (n // 3 if far else 1)
            frames[0, [k, other]] = frames[0, [other, k]]
        return values

    return put_in


def lines_swapped(axis: int) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        values = r.clean()
        for k in range(int(s)):
            a = 2 + 4 * k
            pair = [a, a + 1]
            if axis == 0:
                values[:, pair] = values[:, pair[::-1]]
            else:
                values[:, :, pair] = values[:, :, pair[::-1]]
        return values

    return put_in


def order(values: F4) -> F4:
    """Return a copy of the frames in the order of a serpentine scan ``(nz, ny * nx, nt, ns)``."""
    out = values.copy()
    out[:, 1::2] = out[:, 1::2, ::-1]
    return rows_joined(out)


def in_order(frames: F4, shape: tuple[int, ...]) -> F4:
    out = frames.reshape(shape).copy()
    out[:, 1::2] = out[:, 1::2, ::-1].copy()
    return out


def late(r: Recording, s: float) -> F4:
    values = r.clean()
    return in_order(np.roll(order(values), int(s), 1), values.shape)


def repeated(r: Recording, s: float) -> F4:
    values = r.clean()
    frames = order(values)
    for k in np.random.default_rng(6).integers(1, frames.shape[1], int(s)).tolist():
        frames[0, k] = frames[0, k - 1]
    return in_order(frames, values.shape)


def blank(r: Recording, s: float) -> F4:
    values = r.light()
    frames = rows_joined(values)
    frames[0, np.random.default_rng(7).choice(frames.shape[1], int(s), replace=False)] = 0
    return r.noisy(values)


def doubled(r: Recording, s: float) -> F4:
    """Return the recording of a stage that moves during every s-th exposure, half of which shows the next position."""
    light = r.light()
    out = light.copy()
    frames, found = rows_joined(light), rows_joined(out)
    own = np.arange(int(s) - 1, frames.shape[1], int(s))
    found[:, own] = (frames[:, own] + frames[:, (own + 1) % frames.shape[1]]) / 2
    return r.noisy(out)


def unwound(r: Recording, s: float) -> F4:
    values = r.clean()
    rows = slice(1, int(s) * 2, 2)
    values[:, rows] = values[:, rows, ::-1].copy()
    return values


def mirrored(axis: int) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        values = r.clean()
        for z in range(min(int(s), len(values))):
            values[z] = np.flip(values[z], axis)
        return values

    return put_in


def sources(field: Callable[[Recording, float, F8, F8], tuple[F8, F8]]) -> PutIn:
    return lambda r, s: r.noisy(r.displaced(*field(r, s, *r.grid())))


def scattered(r: Recording, s: float, y: F8, x: F8) -> tuple[F8, F8]:
    dy, dx = np.random.default_rng(5).normal(0, s, (2, *y.shape))
    return dy, dx


def some(r: Recording, s: float, y: F8, x: F8) -> tuple[F8, F8]:
    dy, dx = np.zeros(y.shape), np.zeros(y.shape)
    own = np.random.default_rng(8).choice(y.size, max(2, y.size // 60), replace=False)
    dy.ravel()[own], dx.ravel()[own] = s, -s
    return dy, dx


def screw(r: Recording, s: float, y: F8, x: F8) -> tuple[F8, F8]:
    """Return the error of a lead screw, which repeats every 4.3 positions along each axis."""
    rows, columns = (2 * np.pi * np.arange(n) / 4.3 for n in y.shape)
    return s * np.sin(rows + 1.9)[:, None] + 0 * y, s * np.sin(columns + 0.7) + 0 * x


def drift(r: Recording, s: float, y: F8, x: F8) -> tuple[F8, F8]:
    return 0 * y, s * y / len(y)


def play(r: Recording, s: float, y: F8, x: F8) -> tuple[F8, F8]:
    rows = np.arange(len(y))[:, None] % 2
    return 0 * x, np.where(rows == 1, s / 2, -s / 2) + 0 * x


def whole(axis: int) -> PutIn:
    return lambda r, s: np.roll(r.clean(), int(s), 3 + axis)
