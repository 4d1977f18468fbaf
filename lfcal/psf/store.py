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

from lfcal.axes import check_psf_shape
from lfcal.camera import Camera
from lfcal.errors import InputError
from lfcal.files import check_other_file, require_space
from lfcal.h5.writing import new_h5
from lfcal.progress import Clock, Work, drained
from lfcal.psf.chunk_codec import chunk_pipeline, parallel_write
from lfcal.psf.facts import Facts
from lfcal.psf.layout import ROUNDED, STORED_TYPES, MatrixGroup, MatrixHeader, StoredPlane
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.nexus import mark_default_plot
from lfcal.psf.steps import bits_at_most, check_store_tolerance
from lfcal.version import full_version

__all__ = [
    "CHECKED_VERSION",
    "FORMAT",
    "REGIONS",
    "STEPPED_VERSION",
    "STORED_TYPES",
    "VERSION",
    "PSFWriter",
    "facts_of",
    "iter_save",
    "save",
    "save_regions",
    "store_plane",
    "stored_bytes",
    "stored_type",
    "writer_of",
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
        self.shape = check_psf_shape(shape)
        if dtype not in STORED_TYPES:
            raise InputError.expected("stored type", " or ".join(STORED_TYPES), dtype, "choose one of these")
        if transposed and store_tolerance is not None:
            raise InputError.expected(
                "matrix within a tolerance", "H, whose patterns it bounds", "HT", "store H: HT is a view of it"
            )
        self._header = MatrixHeader(
            self.shape,
            np.asarray(np.full(self.shape[0], np.nan) if depths is None else depths, np.float64),
            camera,
            anchor,
            dict(provenance or {}),
            transposed,
            region,
            dtype if store_tolerance is None else "float32",
            compression,
            workers,
            None if store_tolerance is None else check_store_tolerance(store_tolerance),
        )
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Create the scratch file beside the target."""
        header = self._header
        nbytes = stored_bytes(self.shape, header.stored, header.compression, header.store_tolerance)
        require_space(self.path.parent, nbytes, what=self.path.name)
        try:
            self._file = self._stack.enter_context(_new_file(self.path))
            self._matrix = MatrixGroup(self._file, self._header)
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
            facts = Facts.of(self.shape[1:3], self.shape[3:], recorded=recorded, saturated=saturated)
        self._matrix.write_plane(z, plane, facts)
        if uncertainty is not None:
            self._matrix.write_uncertainty(z, uncertainty)
        if simulated is not None:
            self._matrix.note_simulated(z, simulated)

    def adopt_plane(self, z: int, stored: StoredPlane) -> None:
        """Take plane ``z`` over as another file has it, byte for byte; see `lfcal.psf.joining`."""
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
def _new_file(path: Path) -> Iterator[Any]:
    with new_h5(path) as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "creator": f"lfcal {full_version()}"})
        yield file


def stored_bytes(
    shape: tuple[int, ...], dtype: str, compression: str = "gzip", store_tolerance: float | None = None
) -> int:
    """Return the bytes that an H file takes at most, about; ``dtype`` is as in `PSFWriter`."""
    size = int(np.prod(shape, dtype=np.int64))
    if store_tolerance is None and dtype != ROUNDED:
        return size * np.dtype(dtype).itemsize
    bits = ROUNDED_BITS if store_tolerance is None else bits_at_most(store_tolerance)
    return math.ceil(size * (32 if compression == "none" else bits) / 8)


def store_plane(data: Any, z: int, plane: NDArray[Any], *, workers: int | None = None) -> None:
    """Write one plane ``(ny, nx, nt, ns)`` into an HDF5 dataset, compressing in threads where that is possible."""
    if chunk_pipeline(data) is None:
        data[z] = plane
        return
    parallel_write(data, z, plane, workers=workers)


def stored_type(matrix: PSFMatrix) -> str:
    """Return the type that the values of ``matrix`` are stored as where nobody says another."""
    return matrix.dtype.name if matrix.dtype.name in STORED_TYPES else "float32"


def writer_of(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
    transposed: bool | None = None,
    region: str | None = None,
    provenance: Mapping[str, Any] | None = None,
    store_tolerance: float | None = None,
) -> PSFWriter:
    """Return what writes ``matrix``, or what is made of it, to a file, not yet entered.

    ``transposed`` and ``region`` are the matrix's own where they are not given; ``provenance`` is kept beside its own.
    """
    return PSFWriter(
        path,
        matrix.shape,
        depths=matrix.known_depths,
        camera=matrix.camera,
        anchor=matrix.anchor,
        dtype=dtype or stored_type(matrix),
        compression=compression,
        provenance={**matrix.provenance, **(provenance or {})},
        transposed=matrix.is_transposed if transposed is None else transposed,
        region=matrix.region if region is None else region,
        workers=workers,
        store_tolerance=store_tolerance,
    )


def iter_save(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
    store_tolerance: float | None = None,
) -> Work[Path]:
    """Write ``matrix`` (H, or the view ``H.T``) to an H file, one plane in memory at a time; see `PSFWriter`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, iter_save
    >>> [step.count for step in iter_save(PSFMatrix(np.ones((2, 3, 3, 5, 5))), "new.h5")]
    ['0 of 2', '1 of 2', '2 of 2']
    """
    check_other_file(matrix.path, path)
    clock = Clock("write planes", len(matrix))
    how: dict[str, Any] = {"dtype": dtype, "compression": compression, "store_tolerance": store_tolerance}
    with writer_of(matrix, path, workers=workers, **how) as writer:
        yield clock.at(0)
        for z in range(len(matrix)):
            stated = matrix.stated_uncertainty
            uncertainty = None if stated is None else stated.plane(z)
            writer.write_plane(z, matrix.plane(z), facts=facts_of(matrix).plane(z), uncertainty=uncertainty)
            yield clock.at(z + 1)
    return Path(path)


save = drained(
    iter_save,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, open_psf, save
    >>> path = save(PSFMatrix(np.ones((1, 3, 3, 5, 5)), depths=[-500]), "new.h5", dtype="float32")
    >>> with open_psf(path) as H:
    ...     print(H, H.depths.tolist())
    <PSFMatrix (z, y, x, t, s) = (1, 3, 3, 5, 5), float32> [-500.0]
    """,
)


def facts_of(matrix: PSFMatrix) -> Facts:
    """Return the facts of the positions of H, whether ``matrix`` is H or HT; a file of HT keeps them for H."""
    return matrix.T.facts if matrix.is_transposed else matrix.facts


def save_regions(
    matrices: Mapping[str, PSFMatrix],
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
) -> Path:
    """Write the matrices of several regions of the field, by name, to one H file; the first is what it opens with.

    ``dtype``, ``compression`` and ``workers`` are those of `PSFWriter`, by default each matrix's own type.

    Raises
    ------
    InputError
        If there is none, or a name cannot be that of a group.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, open_psf, save_regions
    >>> H = np.ones((1, 2, 2, 3, 3))
    >>> path = save_regions({"centre": PSFMatrix(H), "edge": PSFMatrix(0.5 * H)}, "field.h5")
    >>> with open_psf(path, region="edge") as edge:
    ...     print(edge.region, edge.depth_sum(0)[1, 1])  # four positions of a half each
    edge 2.0
    """
    target = Path(path)
    if not matrices or any(not name or "/" in name or name == "." for name in matrices):
        raise InputError.expected("regions of the field", "one or more names without /", list(matrices), "rename them")
    require_space(target.parent, sum(m.nbytes for m in matrices.values()), what=target.name)
    with _new_file(target) as file:
        for number, (name, matrix) in enumerate(matrices.items()):
            group = file if number == 0 else file.require_group(REGIONS).create_group(name)
            header = MatrixHeader(
                matrix.shape,
                matrix.known_depths,
                matrix.camera,
                matrix.anchor,
                matrix.provenance,
                matrix.is_transposed,
                name,
                dtype or stored_type(matrix),
                compression,
                workers,
            )
            part = MatrixGroup(group, header)
            for z in range(len(matrix)):
                part.write_plane(z, matrix.plane(z), facts_of(matrix).plane(z))
                if matrix.stated_uncertainty is not None:
                    part.write_uncertainty(z, matrix.stated_uncertainty.plane(z))
            part.complete()
        mark_default_plot(file)
    return target
