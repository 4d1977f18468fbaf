"""Labelled arrays of xarray, which read only the values that are used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import InputError

if TYPE_CHECKING:
    import xarray

__all__ = ["labelled"]


def labelled(
    read: Callable[[Any], Any],
    dtype: np.dtype[Any],
    coordinates: Mapping[str, tuple[Any, Mapping[str, str]]],
    **named: Any,
) -> xarray.DataArray:
    """Return an array whose values ``read`` selects by a tuple of integers and slices.

    ``coordinates`` contains the values and attributes of each axis, in order; ``named`` is the name and the attributes
    of the array.

    Raises
    ------
    InputError
        If xarray is not installed.
    """
    try:
        import xarray
        from xarray.backends import BackendArray
        from xarray.core import indexing
    except ImportError:
        raise InputError('xarray is not installed; run: pip install "lfcal[xarray]"') from None

    class Lazy(BackendArray):  # type: ignore[misc]
        """Values that are read when they are selected."""

        def __init__(self) -> None:
            self.shape = tuple(len(values) for values, _ in coordinates.values())
            self.dtype = dtype

        def __getitem__(self, key: Any) -> Any:
            """Return the selected values in memory."""
            return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, read)

    axes = {axis: (axis, values, dict(attributes)) for axis, (values, attributes) in coordinates.items()}
    variable = xarray.Variable(tuple(coordinates), indexing.LazilyIndexedArray(Lazy()))
    return xarray.DataArray(variable, coords=axes, **named)
