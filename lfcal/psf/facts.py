"""Facts about the positions and patterns of H."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfcal.base import InputError

__all__ = ["Facts", "Origin", "fitting", "pack_valid", "packed_bytes", "stacked", "unpack_valid"]


class Origin(IntEnum):
    """How the pattern of a position was obtained."""

    MEASURED = 0
    """Only recorded frames; zeros if there are none."""
    HYBRID = 1
    """A model plus the measured deviation from it."""
    MODEL = 2
    """Only a model."""
    OUTLIER = 3
    """Only a model, because the recorded pattern differs from the others."""


@dataclass(frozen=True, eq=False)
class Facts:
    """Measurement facts about every position of a matrix ``(nz, ny, nx)``, or of a single plane ``(ny, nx)``.

    Attributes
    ----------
    recorded
        Number of frames averaged for each position; 0: the position is missing. As for all attributes except
        ``origin``, None means unknown.
    saturated
        Number of saturated pixels in the pattern of each position; -1: unknown.
    noise
        Coefficients of the noise of each position, ``(…, 2)``: the variance of a value v is ``noise[..., 0] +
        noise[..., 1] * max(v, 0)``; NaN if unknown.
    spread
        Relative rms difference between the repeated frames of each position; NaN for a single frame.
    valid
        Packed bits, ``(…, bytes)``, one for each pixel of the cutout in C order; 0 for a pixel without a measurement.
    error
        Relative L1 error of the stored values of each plane, ``(nz,)``, or a number for a single plane. It is the sum
        of absolute errors divided by the sum of absolute values. NaN if none is stated.
    origin
        Value of `Origin` for the pattern of each position. None: all patterns are measured.
    bound
        Largest relative L1 errors of any pattern of a plane due to storing H with a tolerance: by cropping, by
        rounding, and in total. The shape is ``(nz, 3)``, or ``(3,)`` for a single plane. NaN without such a loss.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import Facts, PSFMatrix
    >>> facts = Facts.of((1, 2, 2), (5, 5), recorded=[[[1, 1], [0, 1]]])
    >>> PSFMatrix(np.ones((1, 2, 2, 5, 5)), facts=facts).missing.tolist()
    [[0, 1, 0]]
    """

    recorded: NDArray[np.uint16] | None = None
    saturated: NDArray[np.int32] | None = None
    noise: NDArray[np.float32] | None = None
    spread: NDArray[np.float32] | None = None
    valid: NDArray[np.uint8] | None = None
    error: NDArray[np.float64] | None = None
    origin: NDArray[np.uint8] | None = None
    bound: NDArray[np.float64] | None = None

    @classmethod
    def of(cls, positions: tuple[int, ...], cutout: tuple[int, int], **values: ArrayLike | None) -> Facts:
        """Return facts with read-only copies of ``values``, which are attributes of `Facts`, after checking them.

        ``positions`` is the shape ``(nz, ny, nx)`` or ``(ny, nx)``, and ``cutout`` is ``(nt, ns)``.

        Raises
        ------
        InputError
            If an array does not have the shape that ``positions`` and ``cutout`` require.
        """
        lead = positions[:-2]
        form: dict[str, tuple[tuple[int, ...], DTypeLike]] = {
            "recorded": (positions, np.uint16),
            "saturated": (positions, np.int32),
            "noise": ((*positions, 2), np.float32),
            "spread": (positions, np.float32),
            "valid": ((*positions, packed_bytes(cutout)), np.uint8),
            "error": (lead, np.float64),
            "origin": (positions, np.uint8),
            "bound": ((*lead, 3), np.float64),
        }
        checked = {name: fitting(name, value, *form[name]) for name, value in values.items() if value is not None}
        return cls(**checked)

    def plane(self, z: int) -> Facts:
        """Return the facts about the plane with index ``z``."""
        return Facts(**{name: value[z] for name, value in self.known().items()})

    def known(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of the known facts, with the names of the attributes as keys."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in found.items() if value is not None}


def fitting(what: str, value: ArrayLike, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return ``value`` as a read-only array of ``dtype``; raise `InputError` about ``what`` unless it has ``shape``."""
    array = np.array(value, dtype)
    if array.shape != shape:
        raise InputError.expected(what, f"shape {shape}", array.shape, "give one value for each entry")
    array.setflags(write=False)
    return array


def packed_bytes(cutout: tuple[int, int]) -> int:
    """Return the number of bytes for one bit per pixel of a cutout ``(nt, ns)``."""
    return -(-cutout[0] * cutout[1] // 8)


def pack_valid(valid: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return masks ``(…, nt, ns)`` as packed bits ``(…, bytes)``."""
    return np.packbits(valid.reshape(*valid.shape[:-2], -1), axis=-1)


def unpack_valid(packed: NDArray[np.uint8], cutout: tuple[int, int]) -> NDArray[np.bool_]:
    """Return packed bits ``(…, bytes)`` as masks ``(…, nt, ns)``."""
    bits = np.unpackbits(packed, axis=-1, count=cutout[0] * cutout[1])
    return bits.reshape(*packed.shape[:-1], *cutout).astype(np.bool_)


_UNKNOWN: dict[str, float] = {
    "recorded": 0,
    "saturated": -1,
    "noise": np.nan,
    "spread": np.nan,
    "valid": 255,
    "origin": 0,
}
"""Placeholder for a plane with an unknown fact that is known for other planes."""


def stacked(planes: Sequence[Facts]) -> Facts:
    """Return the facts of a matrix, combined from those of its planes in order.

    If only some planes state a fact, the others get a default. Defaults are 0 recorded frames, unknown saturation (-1),
    all pixels valid, a measured origin, and NaN for all other facts.
    """
    names = {name for plane in planes for name in plane.known()}
    found: dict[str, NDArray[Any]] = {}
    for name in names:
        some = next(value for plane in planes if (value := getattr(plane, name)) is not None)
        missing = np.full(some.shape, _UNKNOWN.get(name, np.nan), some.dtype)
        found[name] = np.stack([missing if (value := getattr(p, name)) is None else value for p in planes])
    return Facts(**found)
