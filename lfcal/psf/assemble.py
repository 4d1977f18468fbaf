"""Frames to H: cropped with the shifting cutout, stacked plane by plane.

Frames come as a source gives them; whoever wants them corrected hands over the corrected view.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.camera import Camera
from lfcal.errors import InputError
from lfcal.frames.source import FrameSource
from lfcal.progress import Clock, Work, drain
from lfcal.psf.assembly import Assembly
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.cutout import Cutout
from lfcal.psf.facts import Facts, stacked
from lfcal.psf.filling import Fill
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.store import PSFWriter

__all__ = ["assemble", "iter_assemble"]


def iter_assemble(
    source: FrameSource,
    shape: tuple[int, int, int],
    cutout: Cutout,
    out: str | os.PathLike[str] | None = None,
    *,
    depths: ArrayLike | None = None,
    camera: Camera | None = None,
    drift: ArrayLike | None = None,
    strict: bool = False,
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    fill: Fill | None = None,
    workers: int | None = None,
    store_tolerance: float | None = None,
) -> Work[AssemblyReport]:
    """Assemble H from frames, streaming: at most two planes are in memory, the file appears whole or not.

    Parameters
    ----------
    source
        The frames, in any order; their samples are taken as they are.
    shape
        ``(nz, ny, nx)`` positions of the plan.
    cutout
        The shifting cutout.
    out
        H file to write; None keeps H in memory as float32.
    depths, camera, provenance
        Stored with H.
    drift
        ``(len(source), 2)`` how far the image of each frame is off its place (rows, columns; px); None asks
        the source, whose manifest may say it.
    strict
        Missing and repeated positions are errors instead of being recorded in the file.
    fill
        Fills missing positions, which stay marked as never recorded; None leaves them 0.
    dtype, compression, workers, store_tolerance
        As in `PSFWriter`.

    Raises
    ------
    InputError
        If a frame lies outside the plan, is not finite, or its cutout leaves the sensor (with the position).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.progress import drain
    >>> from lfcal.psf import Cutout, iter_assemble
    >>> frames = ArraySource(np.ones((3, 16, 16), np.uint16), [(0, 0, 0), (0, 0, 1), (0, 1, 0)])
    >>> report = drain(iter_assemble(frames, (1, 2, 2), Cutout((5, 5), anchor=(7, 8))))
    >>> print(report.frames, "frames,", report.missing)
    3 frames, (Position(z=0, y=1, x=1),)
    """
    assembly = Assembly(source, shape, cutout, drift=drift, strict=strict)
    history = assembly.history(provenance)
    sink: _Memory | PSFWriter
    if out is None:
        meta = {"depths": depths, "camera": camera, "anchor": cutout.anchor}
        sink = _Memory(shape, cutout.shape, meta, history)
    else:
        stored: dict[str, Any] = {"dtype": dtype, "compression": compression, "store_tolerance": store_tolerance}
        sink = assembly.writer(out, history, depths=depths, camera=camera, workers=workers, **stored)
    clock = Clock("assemble frames", assembly.frames)
    with sink:
        yield clock.at(0)
        done = 0
        for z in range(shape[0]):
            made = yield from assembly.iter_plane(z, clock, before=done, fill=fill, workers=workers)
            sink.write_plane(z, made.values, facts=made.facts, uncertainty=made.uncertainty)
            done += assembly.frames_of(z)
    return assembly.report(sink.matrix() if isinstance(sink, _Memory) else open_psf(sink.path))


def assemble(
    source: FrameSource,
    shape: tuple[int, int, int],
    cutout: Cutout,
    out: str | os.PathLike[str] | None = None,
    *,
    depths: ArrayLike | None = None,
    camera: Camera | None = None,
    drift: ArrayLike | None = None,
    strict: bool = False,
    dtype: str = "float32",
    compression: str = "gzip",
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
    store_tolerance: float | None = None,
) -> AssemblyReport:
    """Assemble H at once; see `iter_assemble`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> from lfcal.psf import Cutout, assemble
    >>> frames = np.zeros((1, 2, 3, 16, 16), np.uint16)
    >>> for y, x in np.ndindex(2, 3):
    ...     frames[0, y, x, 7 + y, 8 + x] = 1000  # the image of position (y, x)
    >>> H = assemble(ArraySource(frames), (1, 2, 3), Cutout((5, 5), anchor=(7, 8))).matrix
    >>> print(H.shape, H[0, :, :, 2, 2].tolist())
    (1, 2, 3, 5, 5) [[1000.0, 1000.0, 1000.0], [1000.0, 1000.0, 1000.0]]
    """
    return drain(
        iter_assemble(
            source,
            shape,
            cutout,
            out,
            depths=depths,
            camera=camera,
            drift=drift,
            strict=strict,
            dtype=dtype,
            compression=compression,
            provenance=provenance,
            workers=workers,
            store_tolerance=store_tolerance,
        )
    )


class _Memory:
    """The same as `PSFWriter`, in memory."""

    def __init__(
        self, shape: tuple[int, int, int], cutout: tuple[int, int], meta: dict[str, Any], history: dict[str, Any]
    ) -> None:
        self.values = np.zeros((*shape, *cutout), np.float32)
        self.facts: list[Facts] = []
        self.uncertainty: NDArray[np.float32] | None = None
        self.meta, self.history = meta, history

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        pass

    def write_plane(
        self, z: int, plane: NDArray[Any], *, facts: Facts, uncertainty: NDArray[np.float32] | None = None
    ) -> None:
        if not np.isfinite(plane.sum(dtype=np.float64)):
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame and record it again"
            )
        self.values[z] = plane
        self.facts.append(facts)
        if uncertainty is not None:
            if self.uncertainty is None:
                self.uncertainty = np.zeros_like(self.values)
            self.uncertainty[z] = uncertainty

    def matrix(self) -> PSFMatrix:
        facts = stacked(self.facts)
        return PSFMatrix(self.values, facts=facts, uncertainty=self.uncertainty, provenance=self.history, **self.meta)
