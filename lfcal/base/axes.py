"""Array conventions of lfcal: the one home of axis order, centre rule and index algebra.

A PSF matrix is the C-ordered array ``H[z, y, x, t, s]``:

======  ==================================================================
``z``   depth plane, z > 0 away from the camera
``y``   source row within the period ``ny`` (sensor pixels)
``x``   source column within the period ``nx``
``t``   pixel row of the cutout, ``nt`` odd, centre ``(nt - 1) // 2``
``s``   pixel column of the cutout, ``ns`` odd, centre ``(ns - 1) // 2``
======  ==================================================================

The bytes are those of MATLAB's column-major ``H(s, t, x, y, z)``. One step of the source moves its
paraxial image, and the cutout with it, by exactly one sensor pixel. Image rows count downwards.

Projection of a volume ``g[z, Y, X]`` with zero borders::

    f[p] = sum_v g[v] * H[(v - a) mod n][p - v + c]

where ``a`` is the anchor, the pixel that position (0, 0) is imaged to, rounded down.

The transposed matrix is the index permutation ::

    HT[z, y, x, t, s] = H[z, (y + t - ct) mod ny, (x + s - cs) mod nx, nt-1-t, ns-1-s]

which is its own inverse and satisfies ``<H g, f> = <g, HT f>``.
"""

from __future__ import annotations

from typing import NamedTuple

from lfcal.base.errors import InputError

__all__ = ["AXES", "MATLAB_AXES", "Position", "centre", "check_cutout", "check_psf_shape", "position_at"]

AXES = ("z", "y", "x", "t", "s")
"""Axis names of H in storage order."""

MATLAB_AXES = AXES[::-1]
"""The same bytes as MATLAB names them."""


class Position(NamedTuple):
    """Where the source stood: indices into the scan plan, ``H[z, y, x]``.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.frames import Position
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3], cutout=63)
    >>> places: list[Position] = list(plan.positions())
    >>> print(places[0], places[33])
    Position(z=0, y=0, x=0) Position(z=0, y=1, x=32)
    """

    z: int
    y: int
    x: int


def position_at(flat: int, period: tuple[int, int]) -> Position:
    """Return the position whose place in storage order is ``flat``; ``period`` is ``(ny, nx)``."""
    ny, nx = period
    rows, x = divmod(flat, nx)
    return Position(*divmod(rows, ny), x)


def centre(n: int) -> int:
    """Return the index of the centre pixel of an axis with ``n`` pixels: ``(n - 1) // 2``."""
    return (n - 1) // 2


def check_cutout(nt: int, ns: int) -> None:
    """Raise `InputError` unless the cutout ``nt`` x ``ns`` is odd x odd and positive."""
    if nt < 1 or ns < 1 or nt % 2 == 0 or ns % 2 == 0:
        raise InputError.expected(
            "cutout",
            "odd numbers of pixels in both directions",
            f"{nt} x {ns}",
            # n | 1 is the next odd number
            f"use {nt | 1} x {ns | 1}",
        )


def check_psf_shape(shape: tuple[int, ...]) -> tuple[int, int, int, int, int]:
    """Return ``shape`` as ``(nz, ny, nx, nt, ns)`` or raise `InputError` if it cannot be a PSF matrix."""
    if len(shape) != 5:
        raise InputError.expected(
            "PSF matrix",
            "5 axes (z, y, x, t, s)",
            f"{len(shape)} axes {tuple(shape)}",
            "add the missing axes, for example array[None] for a single depth plane",
        )
    if min(shape) < 1:
        raise InputError.expected("PSF matrix", "at least one entry along every axis", tuple(shape), "check the file")
    nz, ny, nx, nt, ns = (int(n) for n in shape)
    check_cutout(nt, ns)
    return nz, ny, nx, nt, ns
