"""Array conventions of lfcal: the single definition of axis order, centre rule and index algebra.

A PSF matrix is the C-ordered array ``H[z, y, x, t, s]``:

======  ==================================================================
``z``   depth plane, z > 0 away from the camera
``y``   source row within the period ``ny`` (sensor pixels)
``x``   source column within the period ``nx``
``t``   pixel row of the cutout, ``nt`` odd, centre ``(nt - 1) // 2``
``s``   pixel column of the cutout, ``ns`` odd, centre ``(ns - 1) // 2``
======  ==================================================================

The bytes are those of MATLAB's column-major ``H(s, t, x, y, z)``. One step of the source moves its paraxial image, and
the cutout with it, by exactly one sensor pixel. Image rows count downwards.

Projection of a volume ``g[z, Y, X]`` with zero borders::

    f[p] = sum_v g[v] * H[(v - a) mod n][p - v + c]

where ``a`` is the anchor, the pixel on which position (0, 0) is imaged, rounded down.

The transposed matrix is the index permutation ::

    HT[z, y, x, t, s] = H[z, (y + t - ct) mod ny, (x + s - cs) mod nx, nt-1-t, ns-1-s]

which is its own inverse and satisfies ``<H g, f> = <g, HT f>``.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from lfcal.base.errors import InputError

__all__ = [
    "AXES",
    "Position",
    "Region",
    "centre",
    "check_cutout",
    "check_psf_shape",
    "check_region",
    "clipped",
    "grow_region",
    "moved",
    "part_of",
    "position_at",
    "region_shape",
    "whole",
]

AXES = ("z", "y", "x", "t", "s")
"""Axis names of H in storage order."""

Region: TypeAlias = tuple[slice, slice]
"""Rows and columns of a frame, each ``slice(start, stop)`` with step 1, in sensor pixels."""


class Position(NamedTuple):
    """Position of the point source as indices (z, y, x) into the scan plan, as in ``H[z, y, x]``.

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
    """Return the position with the flat index ``flat`` in storage order; ``period`` is ``(ny, nx)``."""
    ny, nx = period
    rows, x = divmod(flat, nx)
    return Position(*divmod(rows, ny), x)


def centre(n: int) -> int:
    """Return the index of the centre pixel of an axis with ``n`` pixels: ``(n - 1) // 2``."""
    return (n - 1) // 2


def check_cutout(nt: int, ns: int) -> None:
    """Raise `InputError` unless the cutout has odd, positive numbers of rows ``nt`` and columns ``ns``."""
    if nt < 1 or ns < 1 or nt % 2 == 0 or ns % 2 == 0:
        raise InputError.expected(
            "cutout",
            "odd numbers of pixels in both directions",
            f"{nt} x {ns}",
            # n | 1 is the next odd number
            f"use {nt | 1} x {ns | 1}",
        )


def check_psf_shape(shape: tuple[int, ...]) -> tuple[int, int, int, int, int]:
    """Return ``shape`` as ``(nz, ny, nx, nt, ns)``; raise `InputError` if it cannot be that of a PSF matrix.

    There must be five axes, none of them empty, and nt and ns must be odd.
    """
    if len(shape) != 5:
        raise InputError.expected(
            "PSF matrix",
            "5 axes (z, y, x, t, s)",
            f"{len(shape)} axes, of shape {tuple(shape)}",
            "add the missing axes, for example array[None] for a single depth plane",
        )
    if min(shape) < 1:
        raise InputError.expected("PSF matrix", "at least one entry along every axis", tuple(shape), "check the file")
    nz, ny, nx, nt, ns = (int(n) for n in shape)
    check_cutout(nt, ns)
    return nz, ny, nx, nt, ns


def whole(shape: tuple[int, int]) -> Region:
    """Return the region that covers a frame of ``shape`` ``(rows, columns)``."""
    return slice(0, shape[0]), slice(0, shape[1])


def region_shape(region: Region) -> tuple[int, int]:
    """Return the numbers of rows and columns of a ``region`` with explicit start and stop, as from `check_region`."""
    return region[0].stop - region[0].start, region[1].stop - region[1].start


def check_region(region: Region, shape: tuple[int, int]) -> Region:
    """Return ``region`` with explicit start and stop; raise `InputError` unless it is in a frame of ``shape``.

    An empty region, or one with a step other than 1, is also refused.
    """
    checked = []
    for part, n, what in zip(region, shape, ("rows", "columns"), strict=True):
        start = 0 if part.start is None else int(part.start)
        stop = n if part.stop is None else int(part.stop)
        if part.step not in (None, 1) or not 0 <= start < stop <= n:
            step = "" if part.step in (None, 1) else f" in steps of {part.step}"
            raise InputError.expected(
                f"region {what}",
                f"start < stop within 0 … {n}, step 1",
                f"{start} … {stop}{step}",
                "keep the region on the sensor",
            )
        checked.append(slice(start, stop))
    return checked[0], checked[1]


def grow_region(region: Region, margin: int, shape: tuple[int, int]) -> Region:
    """Return ``region`` extended by ``margin`` pixels on every side, clipped at the border of a frame of ``shape``.

    Raise `InputError` if ``region`` itself is not in the frame.
    """
    rows, columns = check_region(region, shape)
    return (
        slice(max(0, rows.start - margin), min(shape[0], rows.stop + margin)),
        slice(max(0, columns.start - margin), min(shape[1], columns.stop + margin)),
    )


def moved(region: Region, origin: tuple[int, int]) -> Region:
    """Return ``region`` shifted by ``origin`` (rows, columns), for example from frame to sensor coordinates."""
    rows, columns = region
    return (
        slice(rows.start + origin[0], rows.stop + origin[0]),
        slice(columns.start + origin[1], columns.stop + origin[1]),
    )


def clipped(region: Region, shape: tuple[int, int]) -> Region:
    """Return the part of ``region`` that is inside a frame of ``shape``; it may be empty."""
    rows, columns = (
        slice(min(max(part.start, 0), n), min(max(part.stop, 0), n)) for part, n in zip(region, shape, strict=True)
    )
    return rows, columns


def part_of(region: Region, outer: Region) -> Region:
    """Return ``region`` relative to the first pixel of ``outer``, which contains it."""
    return moved(region, (-outer[0].start, -outer[1].start))
