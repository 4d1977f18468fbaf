"""Save a matrix unchanged, transposed, within a tolerance, or together with other regions in one file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import Clock, InputError, Work, check_other_file, drained
from lfcal.psf._transpose import transpose
from lfcal.psf.layout import Plane, Stored
from lfcal.psf.make import PlaneSource, Reopening, Zeros, iter_write, iter_write_regions
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import mat_order_of, open_psf
from lfcal.psf.store import facts_of, header_of, stored_type

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = ["MatrixPlanes", "iter_save", "iter_save_regions", "iter_transpose_file", "save", "save_regions"]

TRANSPOSED = "transpose"
"""Provenance key for the method of a transpose that cannot be turned back into H."""


class MatrixPlanes(PlaneSource):
    """Source of the planes of an existing matrix, or of its transpose by a method other than ``"exact"``.

    Parameters
    ----------
    matrix
        H, or its transposed view ``H.T``.
    method
        Empty: the planes of ``matrix``; ``"paper"`` or ``"paper-padded"``: the planes of its transpose, computed as in
        `transpose`.
    title
        Verb for progress reports and messages, such as ``"write"`` or ``"transpose to"``.
    own
        Whether `close` also closes ``matrix``.
    provenance
        Entries to add to the provenance of the matrix, as plain JSON types.
    """

    def __init__(
        self,
        matrix: PSFMatrix,
        method: str = "",
        *,
        title: str = "write",
        own: bool = False,
        provenance: Mapping[str, Any] | None = None,
    ) -> None:
        self.matrix, self.method, self.title, self._own = matrix, method, title, own
        known = {**matrix.provenance, **(provenance or {})}
        self.header = replace(header_of(matrix), provenance=known)
        if method:
            # it cannot be converted back to H
            known[TRANSPOSED] = method
            self.header = replace(self.header, provenance=known, transposed=True, region="")
        self._clock = Clock(f"{title.partition(' ')[0]} planes", len(matrix))

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Return plane ``z``, or its transpose if ``method`` is not empty; `PlaneSource` describes the parameters."""
        clock = Clock(f"{self.title.partition(' ')[0]} plane {z + 1}", 1) if alone else self._clock
        if alone or z == 0:
            yield clock.at(0)
        matrix = self.matrix
        if self.method:
            made = Plane(transpose(matrix.plane(z)[None], method=self.method)[0], facts_of(matrix).plane(z))
        else:
            stated = matrix.stated_uncertainty
            uncertainty = None if stated is None else stated.plane(z)
            made = Plane(matrix.plane(z), facts_of(matrix).plane(z), uncertainty)
        yield clock.at(1 if alone else z + 1)
        return made

    def reopening(self, z: int, stored: Stored) -> Reopening:
        """Return how other processes read plane ``z`` from the matrix's file; raise `InputError` if it has none."""
        matrix = self.matrix
        if not matrix.path:
            raise InputError.expected("H", "a matrix opened from a file", repr(matrix), "save the matrix first")
        source = os.path.abspath(matrix.path)
        values = {
            "source": source,
            "region": matrix.region,
            "mat_order": mat_order_of(matrix),
            "transposed": matrix.is_transposed,
            "method": self.method,
            "title": self.title,
        }
        return Reopening(f"{__name__}:{open_planes.__name__}", values, (source,))

    def close(self) -> None:
        """Close the file of the matrix if ``own`` is true."""
        if self._own:
            self.matrix.close()


def open_planes(values: Mapping[str, Any], workers: int) -> MatrixPlanes:
    """Open the file described by ``values`` of `MatrixPlanes.reopening`, and return its planes.

    ``workers`` is not used.
    """
    matrix = open_psf(values["source"], region=values["region"], mat_order=values["mat_order"])
    if matrix.is_transposed != values["transposed"]:
        matrix = matrix.T
    return MatrixPlanes(matrix, values["method"], title=values["title"], own=True)


def iter_save(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
    store_tolerance: float | None = None,
    provenance: Mapping[str, Any] | None = None,
    run: RunChoice | None = None,
) -> Work[Path]:
    """Write ``matrix`` to an H file with one plane in memory at a time, and return the path of the file.

    Parameters
    ----------
    matrix
        Matrix to write: H, or its transposed view ``H.T``.
    path
        Path of the file to write.
    dtype
        As in `PSFWriter`. None: the dtype of ``matrix`` if an H file can store it, otherwise ``"float32"``.
    compression, workers, store_tolerance
        As in `PSFWriter`.
    provenance
        Entries to add to the provenance of the matrix, as plain JSON types.
    run
        Settings for processing the planes as separate work units: the executor, and what to do with units left by an
        earlier run. The matrix must have been opened from a file. None: this process writes the planes one by one.

    Raises
    ------
    InputError, StorageError
        As in `PSFWriter`, and if ``path`` is the file of ``matrix``; with a ``run``, also as in `lfcal.work.iter_made`,
        and if the matrix has no file.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, iter_save
    >>> [step.count for step in iter_save(PSFMatrix(np.ones((2, 3, 3, 5, 5))), "new.h5")]
    ['0 of 2', '1 of 2', '2 of 2']
    """
    check_other_file(matrix.path, path)
    title = "write" if store_tolerance is None else "reduce to"
    stored = Stored(dtype or stored_type(matrix), compression, store_tolerance)
    planes = MatrixPlanes(matrix, title=title, provenance=provenance)
    return (yield from iter_write(planes, path, stored, run=run, workers=workers))


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


def iter_transpose_file(
    matrix: PSFMatrix,
    out: str | os.PathLike[str],
    *,
    method: str = "exact",
    compression: str = "gzip",
    workers: int | None = None,
    provenance: Mapping[str, Any] | None = None,
    run: RunChoice | None = None,
) -> Work[Path]:
    """Write the transpose of ``matrix`` to the H file ``out``, and return its path.

    One plane of H and one of HT are in memory at a time. ``method`` is as in `lfcal.psf.transpose`; the other arguments
    are as in `iter_save`.
    """
    check_other_file(matrix.path, out)
    exact = method == "exact"
    method = "" if exact else method
    planes = MatrixPlanes(matrix.T if exact else matrix, method, title="transpose to", provenance=provenance)
    return (yield from iter_write(planes, out, Stored(stored_type(matrix), compression), run=run, workers=workers))


def iter_save_regions(
    matrices: Mapping[str, PSFMatrix],
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
) -> Work[Path]:
    """Write the matrices of several regions of the field to one H file, and return the path of the file.

    ``matrices`` maps names of regions to their H; the first region becomes the default of the file. ``dtype`` is as in
    `iter_save`; ``compression`` and ``workers`` are as in `PSFWriter`.

    Yields
    ------
    Progress
        Progress, counted in planes of all regions. If the generator is closed before the end, no incomplete file
        remains.

    Raises
    ------
    InputError
        If ``matrices`` is empty, or a name is empty, a single dot, or contains a slash.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, iter_save_regions
    >>> H = PSFMatrix(np.ones((1, 2, 2, 3, 3)))
    >>> [step.count for step in iter_save_regions({"centre": H, "edge": H}, "field.h5")]
    ['0 of 2', '1 of 2', '2 of 2']
    """
    if not matrices:
        raise InputError.expected("regions of the field", "at least one region", "none", "give the H of each region")
    for name in matrices:
        if name in ("", ".") or "/" in name:
            wanted = "a name that is not empty or a single dot, and contains no /"
            raise InputError.expected("region of the field", wanted, repr(name), "rename the region")
    sources: dict[str, tuple[PlaneSource, Stored]] = {}
    for name, matrix in matrices.items():
        planes = MatrixPlanes(matrix)
        planes.header = replace(planes.header, region=name)
        sources[name] = planes, Stored(dtype or stored_type(matrix), compression)
    return (yield from iter_write_regions(sources, path, workers=workers))


save_regions = drained(
    iter_save_regions,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, open_psf, save_regions
    >>> H = np.ones((1, 2, 2, 3, 3))
    >>> path = save_regions({"centre": PSFMatrix(H), "edge": PSFMatrix(0.5 * H)}, "field.h5")
    >>> with open_psf(path, region="edge") as edge:
    ...     print(edge.region, edge.depth_sum(0)[1, 1])  # four positions of a half each
    edge 2.0
    """,
)
