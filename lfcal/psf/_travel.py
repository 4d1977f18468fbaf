"""Send an H to another process: as the call that opens its file again, or as its values if they are in memory."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from lfcal.base import InputError
from lfcal.psf._planes import ArrayPlanes, Planes, as_stored

__all__ = ["reduced"]


class _Turnable(Protocol):
    @property
    def is_transposed(self) -> bool: ...

    @property
    def T(self) -> Any: ...


M = TypeVar("M", bound=_Turnable)


def reduced(
    kind: type[M],
    state: Mapping[str, Any],
    planes: Iterable[Planes],
    again: Callable[[], M] | None,
    transposed: bool,
) -> tuple[Callable[..., M], tuple[Any, ...]]:
    """Return the function and the arguments with which pickle restores a matrix in another process.

    Parameters
    ----------
    kind, state
        Class and attributes of the matrix.
    planes
        Planes that provide its values.
    again
        Function that opens the matrix from its file; None if it was not opened in that way.
    transposed
        Whether the matrix is the view ``H.T``.

    Raises
    ------
    InputError
        For a dataset or memory map that the caller opened: its file cannot be opened again.
    """
    if again is not None:
        return _turned, (again, transposed)
    for one in planes:
        stored = as_stored(one)
        if not isinstance(stored, ArrayPlanes) or isinstance(stored.array, np.memmap):
            raise InputError.expected(
                "H for another process",
                "a file opened by open_psf, or an array",
                "a dataset or memory map that another library opened",
                "open the file with open_psf",
            )
    return _rebuilt, (kind, {key: value for key, value in state.items() if key not in _fresh()})


def _fresh() -> dict[str, Any]:
    """Return the attributes that each process has separately: lock, other view, computed sums and irises."""
    return {"_lock": threading.Lock(), "_other": None, "_sums": {}, "_apertures": {}}


def _turned(again: Callable[[], M], transposed: bool) -> M:
    matrix = again()
    if matrix.is_transposed == transposed:
        return matrix
    turned: M = matrix.T
    return turned


def _rebuilt(kind: type[M], state: dict[str, Any]) -> M:
    matrix = kind.__new__(kind)
    matrix.__dict__.update(state, **_fresh())
    return matrix
