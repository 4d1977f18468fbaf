"""H for other programs: ``.h5``, MATLAB ``.mat``, ``.npy``, TIFF stacks."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    InputError,
    Work,
    check_other_file,
    drained,
    npy_header,
    replace_whole,
    require_space,
    storage_errors,
)
from lfcal.psf._matlab import MatOptions, iter_write_mat, mat_notes
from lfcal.psf._tiff_export import iter_write_tiff, tiff_files
from lfcal.psf.light import empty_positions, empty_words
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.saving import iter_save

__all__ = [
    "WRITERS",
    "ExportOptions",
    "check_export",
    "check_missing",
    "export",
    "export_files",
    "export_notes",
    "iter_export",
    "iter_write_npy",
]


def iter_write_npy(
    matrix: PSFMatrix, path: str | os.PathLike[str], read: Callable[[int], NDArray[Any]] | None = None
) -> Work[Path]:
    """Write an ``.npy`` file that numpy can memory-map, one plane at a time; ``read`` gives planes made elsewhere.

    It is written, not mapped: a map onto a disk that fills up ends the process instead of raising an error.
    """
    target = Path(path)
    require_space(target.parent, matrix.nbytes, what=target.name)
    clock = Clock("write npy file", len(matrix))
    with storage_errors(target), replace_whole(target) as part, part.open("wb") as file:
        file.write(npy_header(matrix.shape, matrix.dtype))
        for z in range(len(matrix)):
            file.write(np.ascontiguousarray((read or matrix.plane)(z), matrix.dtype).data)
            yield clock.at(z + 1)
    return target


@dataclass(frozen=True)
class ExportOptions:
    """What may be said of an export; None leaves it to the format.

    Attributes
    ----------
    compress
        ``.h5``, ``.mat``: compressed, or not.
    dtype
        ``.h5``: stored type.
    include_transpose, rows_first, lens_centred, interpolation
        ``.mat``: as in `lfcal.psf._matlab.MatOptions`.
    position
        TIFF: position (y, x) of which a stack over depth is written, instead of every position.
    allow_missing
        ``.mat``, ``.npy``, TIFF: write zeros where a position was never recorded, which these formats cannot mark.
    """

    compress: bool | None = None
    dtype: str | None = None
    include_transpose: bool | None = None
    rows_first: bool | None = None
    lens_centred: bool | None = None
    interpolation: str | None = None
    position: tuple[int, int] | None = None
    allow_missing: bool | None = None

    def given(self) -> dict[str, Any]:
        """Return what was said, by name."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def mat(self) -> MatOptions:
        """What of it concerns a ``.mat`` file."""
        names = {entry.name for entry in fields(MatOptions)}
        return MatOptions(**{name: value for name, value in self.given().items() if name in names})


def _write_h5(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_save(matrix, path, dtype=options.dtype, compression="none" if options.compress is False else "gzip")


def _write_mat(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_mat(matrix, path, options.mat)


def _write_npy(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_npy(matrix, path)


def _write_tiff(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_tiff(matrix, path, position=options.position)


class _Writer(NamedTuple):
    """How a format is written, and the options it uses."""

    write: Callable[[PSFMatrix, str | os.PathLike[str], ExportOptions], Work[Path]]
    uses: frozenset[str]


_UNMARKED = frozenset({"allow_missing"})
"""Of formats that hold nothing but values."""

_TIFF = _Writer(_write_tiff, frozenset({"position"}) | _UNMARKED)
WRITERS = {
    ".h5": _Writer(_write_h5, frozenset({"compress", "dtype"})),
    ".mat": _Writer(_write_mat, frozenset(entry.name for entry in fields(MatOptions)) | _UNMARKED),
    ".npy": _Writer(_write_npy, _UNMARKED),
    ".tif": _TIFF,
    ".tiff": _TIFF,
}
"""Formats by suffix."""


def export_files(
    matrix: PSFMatrix, path: str | os.PathLike[str], position: tuple[int, int] | None = None
) -> list[Path]:
    """Return the files that an export of ``matrix`` to ``path`` writes: of a large H as TIFF, one a plane."""
    is_tiff = WRITERS.get(Path(path).suffix.lower()) is _TIFF
    return tiff_files(matrix, path, position) if is_tiff else [Path(path)]


def export_notes(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> tuple[str, ...]:
    """Return what readers of the file should know, a line each, with what to do.

    Missing positions, and conventions of the codes that read ``.mat`` files.
    """
    suffix = Path(path).suffix.lower()
    notes = mat_notes(matrix, options.mat) if suffix == ".mat" else ()
    words = empty_words(matrix) if _exports_empty(matrix, options) else ""
    if not words:
        return notes
    marked = "the file marks them" if suffix == ".h5" else "they are zeros, which the file cannot mark"
    return (f"{words}: {marked}", *notes)


def _exports_empty(matrix: PSFMatrix, options: ExportOptions) -> bool:
    """Return whether missing positions are among what is exported."""
    empty = empty_positions(matrix)
    if options.position is not None and not matrix.is_transposed:
        empty = empty[(empty[:, 1:] == options.position).all(axis=1)]
    return len(empty) > 0


def iter_export(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    compress: bool | None = None,
    dtype: str | None = None,
    include_transpose: bool | None = None,
    rows_first: bool | None = None,
    lens_centred: bool | None = None,
    interpolation: str | None = None,
    position: tuple[int, int] | None = None,
    allow_missing: bool | None = None,
) -> Work[Path]:
    """Write ``matrix`` in the format of the suffix.

    ``.h5`` H file, ``.mat`` MATLAB v7.3 (H, Ht, Nnum, CAindex, x3objspace, anchor, lensCentre), ``.npy``, ``.tif``
    hyperstacks. For the options see `ExportOptions`; what readers of the file take otherwise, `export_notes` says.

    Raises
    ------
    InputError
        For an unknown suffix, or an option that its format does not use; or for missing positions that its format
        cannot mark, without ``allow_missing``.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, iter_export
    >>> for step in iter_export(PSFMatrix(np.ones((2, 3, 3, 5, 5))), "H.npy"):
    ...     print(step.stage, step.count)
    write npy file 1 of 2
    write npy file 2 of 2
    """
    options = ExportOptions(
        compress, dtype, include_transpose, rows_first, lens_centred, interpolation, position, allow_missing
    )
    suffix = check_export(matrix, path, options)
    return WRITERS[suffix].write(matrix, path, options)


export = drained(
    iter_export,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import export, open_psf
    >>> with open_psf("H.h5") as H:
    ...     path = export(H, "H.npy")
    >>> print(path.name, np.load(path).shape)
    H.npy (2, 19, 33, 55, 55)
    """,
)


def check_export(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> str:
    """Return the format's suffix; raises `InputError` as `iter_export`."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise InputError.expected("export format", " ".join(WRITERS), suffix or "no suffix", "name the file so")
    for name in options.given():
        if name not in WRITERS[suffix].uses:
            used = ", ".join(sorted(WRITERS[suffix].uses)) or "none"
            raise InputError.expected(f"options of {suffix} files", used, name, "leave it out")
    check_missing(matrix, suffix, options)
    check_other_file(matrix.path, path)
    return suffix


def check_missing(matrix: PSFMatrix, suffix: str, options: ExportOptions) -> None:
    """Raise `InputError` for missing positions that files of ``suffix`` cannot mark, unless they are allowed."""
    if "allow_missing" in WRITERS[suffix].uses and not options.allow_missing and _exports_empty(matrix, options):
        raise InputError.expected(
            f"H for a {suffix} file, which cannot mark missing positions",
            "all recorded or filled",
            empty_words(matrix),
            "fill them (lfcal assemble --fill), write an H file (.h5), or allow zeros in their place (--allow-missing)",
        )
