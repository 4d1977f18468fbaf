"""Description of a matrix without its values, how values are stored, and single planes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, any_of, check_psf_shape
from lfcal.base.h5 import H5Data
from lfcal.psf._steps import check_store_tolerance
from lfcal.psf.facts import Facts
from lfcal.records import COMPRESSIONS

if TYPE_CHECKING:
    from lfcal.camera import Camera

__all__ = ["ROUNDED", "STORED_TYPES", "Header", "Plane", "Stored", "StoredPlane"]

ROUNDED = "rounded"
"""Stored type: float32 rounded to multiples of a power of two, at least 65535 of them in the range of a plane."""

STORED_TYPES = ("float32", ROUNDED, "float64", "uint16", "uint8")


@dataclass(frozen=True, eq=False)
class Header:
    """Description of a matrix: everything except its values.

    Attributes
    ----------
    shape
        ``(nz, ny, nx, nt, ns)``.
    depths, camera, anchor, provenance, transposed, region
        As in `lfcal.psf.PSFMatrix`.

    Raises
    ------
    InputError
        If the shape is not that of a PSF matrix, or there is not one depth for each plane.
    """

    shape: tuple[int, ...]
    depths: ArrayLike | None = None
    camera: Camera | None = None
    anchor: tuple[float, float] = (0.0, 0.0)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    transposed: bool = False
    region: str = ""

    def __post_init__(self) -> None:
        """Check shape and depths."""
        object.__setattr__(self, "shape", check_psf_shape(self.shape))
        if self.plane_depths.shape != self.shape[:1]:
            raise InputError.expected(
                "depths of the planes",
                f"{self.shape[0]} values",
                f"shape {self.plane_depths.shape}",
                "give one depth per plane",
            )

    @property
    def plane_depths(self) -> NDArray[np.float64]:
        """Object-space depth of each plane (µm), ``(nz,)``; NaN if unknown."""
        return np.asarray(np.full(self.shape[0], np.nan) if self.depths is None else self.depths, np.float64)


@dataclass(frozen=True)
class Stored:
    """Type, compression and tolerance with which the values of a matrix are stored in a file.

    Attributes
    ----------
    dtype, compression, store_tolerance
        As in `PSFWriter`.

    Raises
    ------
    InputError
        If ``dtype`` or ``compression`` is unknown, or ``store_tolerance`` is not between 0 and 1.
    """

    dtype: str = "float32"
    compression: str = "gzip"
    store_tolerance: float | None = None

    def __post_init__(self) -> None:
        """Check that these are valid settings of an H file."""
        if self.dtype not in STORED_TYPES:
            raise InputError.expected("stored type", any_of(STORED_TYPES), self.dtype, "choose one of these")
        if self.compression not in COMPRESSIONS:
            raise InputError.expected("compression", any_of(COMPRESSIONS), self.compression, "choose one of these")
        if self.store_tolerance is not None:
            check_store_tolerance(self.store_tolerance)

    @property
    def rounded(self) -> bool:
        """Whether all values of a plane are rounded to multiples of the same number."""
        return self.dtype == ROUNDED and self.store_tolerance is None

    @property
    def samples(self) -> np.dtype[Any]:
        """Data type of the values of H in the file."""
        stepped = self.store_tolerance is not None
        return np.dtype("float32" if stepped or self.dtype == ROUNDED else self.dtype)


@dataclass(frozen=True, eq=False, slots=True)
class Plane:
    """One plane of a matrix, with facts about it.

    Attributes
    ----------
    values
        Values of the plane, ``(ny, nx, nt, ns)``.
    facts
        Facts about the positions.
    uncertainty
        Standard deviation of every entry ``(ny, nx, nt, ns)``, 0 where only `Facts.noise` is known. None: not stated.
    simulated
        Description of the simulation, as plain JSON types; None if the plane was not simulated.
    """

    values: NDArray[Any]
    facts: Facts
    uncertainty: NDArray[np.floating[Any]] | None = None
    simulated: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class StoredPlane:
    """The single plane of an H file in its stored form.

    Attributes
    ----------
    data
        Values as stored, ``(1, ny, nx, nt, ns)``, in chunks of one pattern.
    sums
        Depth-plane sum ``(nt, ns)``.
    used, checksum, error
        Window of the cutout that contains light, checksum and error, as stated in the file. The window is first and
        last row, first and last column; it is empty if the last is less than the first.
    facts
        Facts about the positions, without the error.
    uncertainty
        Standard deviations of the entries; None if not stated.
    step
        Step ``(ny, nx)`` of which the values of each pattern are multiples; None if they are not rounded.
    simulated
        Description of the simulation, as plain JSON types; None if the plane was not simulated.
    """

    data: H5Data
    sums: NDArray[np.float64]
    used: NDArray[np.int32]
    checksum: int
    error: float
    facts: Facts
    uncertainty: H5Data | None = None
    step: NDArray[np.float32] | None = None
    simulated: Mapping[str, Any] | None = None
