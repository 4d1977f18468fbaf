"""H as TIFF that ImageJ opens as a hyperstack: Z is depth, T the source position, with µm and a label on each page.

ImageJ's own format can contain only uint8, uint16 and float32, and less than 4 GB. Other H become OME-TIFF, which Fiji
opens through Bio-Formats.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, any_of, require_space, write_tiff
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.voxels import pixel_um, voxel_um

__all__ = ["iter_write_tiff", "tiff_files"]

Position = tuple[int, int]

ONE_FILE_BYTES = 1 << 30
"""Size above which each depth plane is a separate file, because a hyperstack must fit into memory."""

IMAGEJ_BYTES = 0xF000_0000
IMAGEJ_TYPES = ("uint8", "uint16", "float32")
OME_TYPES = (*IMAGEJ_TYPES, "int8", "int16", "int32", "uint32", "float64")


def tiff_files(matrix: PSFMatrix, path: str | os.PathLike[str], position: Position | None = None) -> list[Path]:
    """Return the files that `iter_write_tiff` writes: ``path``, or for a large H one file for each plane."""
    target = Path(path)
    if position is not None or matrix.nbytes <= ONE_FILE_BYTES:
        return [target]
    return [target.with_name(f"{target.stem}_z{z:03d}{target.suffix}") for z in range(len(matrix))]


def iter_write_tiff(
    matrix: PSFMatrix, path: str | os.PathLike[str], *, position: Position | None = None, quality: str = ""
) -> Work[Path]:
    """Write patterns as hyperstacks; ``quality``, the quality of H as text, is stored in the file's description.

    With ``position`` (y, x), write a single stack over depth, ``ZYX``. Without it, write every position: one file
    ``TZYX`` (positions y slow, x fast), or for an H above 1 GiB one file ``TYX`` per plane, ``NAME_z000.tif`` …

    Raises
    ------
    InputError
        If there is no such position, or TIFF readers cannot show the type of H's numbers.
    """
    target = Path(path)
    if matrix.dtype.name not in OME_TYPES:
        raise InputError.expected(
            "type of the values for TIFF", any_of(OME_TYPES), matrix.dtype, "export a .npy or .h5 file"
        )
    files = tiff_files(matrix, path, position)
    share = 1 if position is None else matrix.period[0] * matrix.period[1]
    require_space(target.parent, matrix.nbytes // share, what=target.name)
    clock = Clock("write TIFF", len(matrix))
    if position is not None:
        _check_position(matrix, position)
        y, x = position
        stack = np.stack([matrix[z, y, x] for z in range(len(matrix))])
        _write(target, stack[None], matrix, range(len(matrix)), [position], quality)
        yield clock.at(len(matrix))
    elif files == [target]:
        yield from _write_one(matrix, target, clock, quality)
    else:
        for z, file in enumerate(files):
            plane = matrix.plane(z)
            _write(file, plane.reshape(-1, 1, *matrix.cutout), matrix, [z], list(np.ndindex(*matrix.period)), quality)
            yield clock.at(z + 1)
    return target


def _check_position(matrix: PSFMatrix, position: Position) -> None:
    if not all(0 <= at < n for at, n in zip(position, matrix.period, strict=True)):
        raise InputError.expected(
            "position (y, x)", f"a position inside the period {matrix.period}", position, "choose another position"
        )


def _write_one(matrix: PSFMatrix, target: Path, clock: Clock, quality: str) -> Work[None]:
    nz, ny, nx = matrix.shape[:3]
    pages = np.empty((ny * nx, nz, *matrix.cutout), matrix.dtype)
    for z in range(nz):
        pages[:, z] = matrix.plane(z).reshape(-1, *matrix.cutout)
        yield clock.at(z)
    _write(target, pages, matrix, range(nz), list(np.ndindex(ny, nx)), quality)
    yield clock.at(nz)


def _write(
    file: Path,
    pages: NDArray[Any],
    matrix: PSFMatrix,
    planes: Sequence[int],
    positions: Sequence[Position],
    quality: str,
) -> None:
    """Write patterns ``(positions, planes, nt, ns)``."""
    pixel, spacing = _pixel_um(matrix, planes), _spacing_um(matrix, planes)
    about = _description(matrix, planes) + (f"\nquality: {quality}" if quality else "")
    named = [f"z={depth:g} um" if math.isfinite(depth) else f"plane={z}" for z, depth in enumerate(matrix.known_depths)]
    labels = [f"{named[z]} y={y} x={x}" for y, x in positions for z in planes]
    if matrix.dtype.name in IMAGEJ_TYPES and pages.nbytes < IMAGEJ_BYTES:
        known: dict[str, Any] = {"unit": "um" if pixel else "pixel"}
        if not pixel and matrix.knows_depths:
            known["zunit"] = "um"
        if spacing:
            known["spacing"] = spacing
        metadata = {"axes": "TZYX", "hyperstack": True, "mode": "grayscale", "Labels": labels, "Info": about, **known}
        scale = (1 / pixel[1], 1 / pixel[0]) if pixel else None  # TIFF has x first
        write_tiff(file, pages, imagej=True, resolution=scale, metadata=metadata)
        return
    rows, columns = pixel or (None, None)
    sizes = {f"PhysicalSize{axis}": size for axis, size in (("X", columns), ("Y", rows), ("Z", spacing)) if size}
    units = {f"{name}Unit": "µm" for name in sizes}
    depths = [float(matrix.depths[z]) for _ in positions for z in planes]
    plane = {"Plane": {"PositionZ": depths, "PositionZUnit": ["µm"] * len(depths)}} if matrix.knows_depths else {}
    ome = {"axes": "TZYX", "Name": file.stem, "Description": about, **plane, **sizes, **units}
    write_tiff(file, pages, ome=True, bigtiff=pages.nbytes > 1 << 31, metadata=ome)


def _pixel_um(matrix: PSFMatrix, planes: Sequence[int]) -> tuple[float, float] | None:
    """Return the sides of a pixel of the patterns: of H on the sensor, of HT in the volume (rows, columns) (µm)."""
    middle = float(matrix.depths[planes[len(planes) // 2]])
    return voxel_um(matrix, middle) if matrix.is_transposed else pixel_um(matrix)


def _spacing_um(matrix: PSFMatrix, planes: Sequence[int]) -> float | None:
    depths = matrix.depths[list(planes)]
    return float(np.abs(np.diff(depths)).mean()) if len(depths) > 1 and matrix.knows_depths else None


def _description(matrix: PSFMatrix, planes: Sequence[int]) -> str:
    ny, nx = matrix.period
    depths = matrix.depths[list(planes)]
    steps = np.diff(depths)
    even = len(steps) < 2 or bool(np.allclose(steps, steps[0], rtol=1e-6))
    name, where = ("HT", "in the volume") if matrix.is_transposed else ("H", "on the sensor")
    return "\n".join(
        [
            f"PSF matrix {name} of lfcal; patterns of {matrix.cutout[0]} x {matrix.cutout[1]} pixels {where}",
            f"T: positions of {ny} x {nx}, y slow, x fast; Z: depth, away from the camera",
            f"depths (um): {' '.join(f'{z:g}' for z in depths)}" if matrix.knows_depths else "depths: not stated",
            *(
                []
                if even
                else [
                    "the depths are not evenly spaced: the stored spacing is their mean, and the labels state "
                    "each depth"
                ]
            ),
        ]
    )
