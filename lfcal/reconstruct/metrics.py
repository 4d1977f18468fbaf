"""How close a reconstruction is to the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError

__all__ = ["nrmse"]


def nrmse(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Return the norm of ``estimate - truth`` over that of ``truth`` (0: equal).

    Raises
    ------
    InputError
        If shapes differ or the truth is zero everywhere.
    """
    a, b = _pair(estimate, truth)
    size = float(np.linalg.norm(b))
    if size == 0:
        raise InputError.expected("truth", "something that is not zero", "zeros", "use another measure")
    return float(np.linalg.norm(a - b)) / size


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if x.shape != y.shape or x.size == 0:
        raise InputError.expected("arrays to compare", f"one shape, {y.shape}", x.shape, "crop them alike")
    return x, y
