"""Fixed speeds of a machine, in place of measured ones, for choices that depend on them.

Under load, measured speeds may select another method of projection, which changes the last bits of a volume. Measuring
also takes longer than most projections in tests. The values are about those of one core of a server.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from lfcal.reconstruct.projectors import _rates as rates

__all__ = ["measured_speeds", "same_speeds"]

MEASURED = {name: getattr(rates, name) for name in rates.__all__}

PRODUCTS, VALUES, BYTES = 2e10, 7e8, 3e9
"""Operations of matrix products, values copied and bytes read, per second."""


def _half(dtype: str) -> float:
    """Return the factor by which numbers of this type take longer than those of single precision."""
    return np.dtype(dtype).itemsize / (8 if np.dtype(dtype).kind == "c" else 4)


def gemm_seconds(m: int, k: int, n: int, dtype: str, workers: int, *, turned: bool = False) -> float:
    return (1e-6 + 2 * m * k * n / PRODUCTS * (1.5 if turned else 1.0) * _half(dtype)) / workers


def product_seconds(phases: int, pixels: int, dtype: str, workers: int, *, turned: bool = False) -> tuple[float, float]:
    values = phases * pixels * _half(dtype) * (1.5 if turned else 1.0) / workers
    return 8 * values / BYTES, 16 * values / PRODUCTS


def copy_rate(dtype: str, workers: int) -> float:
    return VALUES * workers / _half(dtype)


def window_seconds(rows: int, columns: int, dtype: str, workers: int) -> tuple[float, float]:
    return 4e-10 * _half(dtype) / workers, 5e-10 * _half(dtype) / workers


def fft_seconds(rows: int, columns: int, dtype: str, workers: int) -> float:
    count = rows * columns
    return (1e-5 + 1.4e-10 * count * math.log2(max(count, 2)) * _half(dtype)) / workers


def gather_rate(phases: int, positions: int, dtype: str, workers: int) -> float:
    return 4e9 * workers / _half(dtype)


@contextmanager
def same_speeds() -> Iterator[None]:
    """Choose methods of projection by these speeds."""
    with pytest.MonkeyPatch.context() as patch:
        for speed in (gemm_seconds, product_seconds, copy_rate, window_seconds, fft_seconds, gather_rate):
            patch.setattr(rates, speed.__name__, speed)
        yield


@contextmanager
def measured_speeds() -> Iterator[None]:
    """Choose methods of projection by the speed of this machine, as outside of tests."""
    with pytest.MonkeyPatch.context() as patch:
        for name, speed in MEASURED.items():
            patch.setattr(rates, name, speed)
        yield
