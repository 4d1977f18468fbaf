"""The H file: written plane by plane, whole or not at all."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, full_version, require_space
from lfcal.base.h5 import new_h5
from lfcal.camera import Camera
from lfcal.psf._chunk_codec import chunk_pipeline, parallel_write
from lfcal.psf._nexus import mark_default_plot
from lfcal.psf.facts import Facts
from lfcal.psf.layout import STORED_TYPES, Header, MatrixGroup, Plane, Stored, StoredPlane
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.steps import bits_at_most

__all__ = [
    "CHECKED_VERSION",
    "FORMAT",
    "REGIONS",
    "STEPPED_VERSION",
    "STORED_TYPES",
    "VERSION",
    "PSFWriter",
    "check_storable",
    "facts_of",
    "header_of",
    "new_file",
    "store_plane",
    "stored_bytes",
    "stored_type",
]

FORMAT = "lfcal-psf"
VERSION = 4
STEPPED_VERSION = 3
"""Version whose patterns were stored as numbers of steps, each pattern with its own step and zero."""
CHECKED_VERSION = 2
"""First version with checksums and a specification."""
ROUNDED_BITS = 21
"""Bits that an entry of a rounded H takes at most: 17 of the number of steps, and of sign and exponent what is left."""
REGIONS = "regions"
"""Group of the matrices of further regions of the field, by name."""


class PSFWriter:
    """Write an H file plane by plane; the file takes its name only when every plane is in it.

    Used as a context manager. Chunks are one pattern each, ``(1, 1, 1, nt, ns)``, compressed by all
    processors, with checksums.

    Parameters
    ----------
    path
        The file to write; an existing one is replaced at the end.
    shape
        ``(nz, ny, nx, nt, ns)``.
    depths, camera, anchor, provenance, region
        As in `PSFMatrix`.
    dtype
        Stored type: ``"float32"`` (default); ``"rounded"``, float32 in steps of a power of two, at most 1/65535 of
        the plane's range, which takes about a third of the bytes of float32, keeps whole numbers and states its error;
        or ``"float64"``, ``"uint16"`` or ``"uint8"``, the latter for whole numbers that fit.
    compression
        ``"gzip"`` (level 1 with shuffle), ``"zstd"`` or ``"none"``.
    transposed
        The planes are those of HT.
    workers
        Threads that compress; None takes every processor.
    store_tolerance
        In place of ``dtype``: the share (L1) that every pattern may lack; see `lfcal.psf.steps`. What each plane lacks
        at most is stated as its ``bound``.

    Raises
    ------
    InputError
        If a plane does not fit, is not finite, or is written twice; at the end if one is missing.
    StorageError
        If the disk is too small or may not be written to.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFWriter, open_psf
    >>> with PSFWriter("new.h5", (2, 3, 3, 5, 5), depths=[-50, 50]) as writer:
    ...     for z in range(2):
    ...         writer.write_plane(z, np.full((3, 3, 5, 5), 10 * z + 1, np.float32))
    >>> with open_psf("new.h5") as H:
    ...     print(H.depths.tolist(), H[:, 0, 0, 2, 2].tolist())
    [-50.0, 50.0] [1.0, 11.0]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        shape: tuple[int, ...],
        *,
        depths: ArrayLike | None = None,
        camera: Camera | None = None,
        anchor: tuple[float, float] = (0.0, 0.0),
        dtype: str = "float32",
        compression: str = "gzip",
        provenance: Mapping[str, Any] | None = None,
        transposed: bool = False,
        region: str = "",
        workers: int | None = None,
        store_tolerance: float | None = None,
    ) -> None:
        self.path = Path(path)
        self._header = Header(shape, depths, camera, anchor, dict(provenance or {}), transposed, region)
        self._stored, self._workers = Stored(dtype, compression, store_tolerance), workers
        check_storable(self._header, self._stored)
        self._stack = ExitStack()

    @classmethod
    def of(
        cls, path: str | os.PathLike[str], header: Header, stored: Stored | None = None, workers: int | None = None
    ) -> Self:
        """Return what writes a matrix of this header, stored that way; None: as by default."""
        return cls(path, **vars(header), **vars(stored or Stored()), workers=workers)

    @property
    def shape(self) -> tuple[int, ...]:
        """``(nz, ny, nx, nt, ns)``."""
        return self._header.shape

    def __enter__(self) -> Self:
        """Create the scratch file beside the target."""
        require_space(self.path.parent, stored_bytes(self.shape, self._stored), what=self.path.name)
        try:
            self._file = self._stack.enter_context(new_file(self.path))
            self._matrix = MatrixGroup(self._file, self._header, self._stored, self._workers)
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def write_plane(
        self,
        z: int,
        plane: NDArray[Any],
        *,
        recorded: ArrayLike | None = None,
        saturated: ArrayLike | None = None,
        facts: Facts | None = None,
        uncertainty: NDArray[np.floating[Any]] | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> None:
        """Write plane ``z``, ``(ny, nx, nt, ns)``.

        ``recorded`` and ``saturated`` are ``(ny, nx)`` counts per position (by default 1 and unknown); ``facts``
        stands for both and all else that is known. ``uncertainty`` is the standard deviation of every entry, 0 where
        none is stated besides the noise. ``simulated`` says how a plane was simulated, as plain JSON types.
        """
        if facts is None:
            _, ny, nx, nt, ns = self.shape
            facts = Facts.of((ny, nx), (nt, ns), recorded=recorded, saturated=saturated)
        self.write(z, Plane(plane, facts, uncertainty, simulated))

    def write(self, z: int, plane: Plane) -> None:
        """Write plane ``z`` and what is known of it."""
        self._matrix.write_plane(z, plane)

    def adopt_plane(self, z: int, stored: StoredPlane) -> None:
        """Take plane ``z`` over as another file has it, byte for byte; see `lfcal.psf._joining`."""
        self._matrix.adopt_plane(z, stored)

    def note(self, provenance: Mapping[str, Any]) -> None:
        """Keep more provenance, known only after the planes were."""
        self._matrix.note(provenance)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file and give it its name, or remove it after an error."""
        if error is None and self._matrix.lacking:
            lacking = self._matrix.lacking[:5]
            error = InputError.expected(str(self.path), "every plane written", f"planes {lacking} missing", "write")
            self._stack.__exit__(type(error), error, None)
            raise error
        try:
            if error is None:
                self._matrix.complete()
                mark_default_plot(self._file)
        except BaseException as failure:
            self._stack.__exit__(type(failure), failure, failure.__traceback__)
            raise
        self._stack.__exit__(kind, error, trace)


@contextmanager
def new_file(path: Path) -> Iterator[Any]:
    """Give an H file to write, open, which takes its name at the end of the block or not at all."""
    with new_h5(path) as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "creator": f"lfcal {full_version()}"})
        yield file


def check_storable(header: Header, stored: Stored) -> None:
    """Raise `InputError` where a matrix cannot be stored that way."""
    if header.transposed and stored.store_tolerance is not None:
        raise InputError.expected(
            "matrix within a tolerance", "H, whose patterns it bounds", "HT", "store H: HT is a view of it"
        )


def stored_bytes(shape: tuple[int, ...], stored: Stored) -> int:
    """Return the bytes that an H file takes at most, about."""
    size = int(np.prod(shape, dtype=np.int64))
    if stored.store_tolerance is None and not stored.rounded:
        return size * stored.samples.itemsize
    bits = ROUNDED_BITS if stored.store_tolerance is None else bits_at_most(stored.store_tolerance)
    return math.ceil(size * (32 if stored.compression == "none" else bits) / 8)


def store_plane(data: Any, z: int, plane: NDArray[Any], *, workers: int | None = None) -> None:
    """Write one plane ``(ny, nx, nt, ns)`` into an HDF5 dataset, compressing in threads where that is possible."""
    if chunk_pipeline(data) is None:
        data[z] = plane
        return
    parallel_write(data, z, plane, workers=workers)


def stored_type(matrix: PSFMatrix) -> str:
    """Return the type that the values of ``matrix`` are stored as where nobody says another."""
    return matrix.dtype.name if matrix.dtype.name in STORED_TYPES else "float32"


def header_of(matrix: PSFMatrix) -> Header:
    """Return what ``matrix`` is besides its values."""
    return Header(
        matrix.shape,
        matrix.known_depths,
        matrix.camera,
        matrix.anchor,
        matrix.provenance,
        matrix.is_transposed,
        matrix.region,
    )


def facts_of(matrix: PSFMatrix) -> Facts:
    """Return the facts of the positions of H, whether ``matrix`` is H or HT; a file of HT keeps them for H."""
    return matrix.T.facts if matrix.is_transposed else matrix.facts
