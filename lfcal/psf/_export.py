"""Export H to other programs: ``.h5``, MATLAB ``.mat``, ``.npy``, ``.npz``, TIFF stacks."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    InputError,
    Work,
    any_of,
    check_other_file,
    drained,
    npy_header,
    replace_whole,
    require_space,
    storage_errors,
)
from lfcal.base.h5 import H5File, new_h5
from lfcal.psf._chunk_codec import copy_plane
from lfcal.psf._matlab import MatOptions, create_mat_data, iter_write_mat, mat_notes, mat_plane, mat_written
from lfcal.psf._tiff_export import iter_write_tiff, tiff_files
from lfcal.psf.codes import Code, code_of, iter_write_npz, refused_by
from lfcal.psf.layout import Stored
from lfcal.psf.lens_centre import lens_centre_of
from lfcal.psf.light import empty_positions, empty_words
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.saving import MatrixPlanes, iter_save, open_planes
from lfcal.psf.store import store_plane

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = [
    "WRITERS",
    "ExportOptions",
    "check_export",
    "check_missing",
    "do_plane",
    "export",
    "export_files",
    "export_notes",
    "iter_export",
    "iter_write_npy",
]


def iter_write_npy(
    matrix: PSFMatrix, path: str | os.PathLike[str], read: Callable[[int], NDArray[Any]] | None = None
) -> Work[Path]:
    """Write an ``.npy`` file, one plane at a time; ``read`` (None: ``matrix``) is a function that returns plane z.

    numpy can memory-map the file. It is not written through a map, because a full disk would then end the process
    instead of raising an error.
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
    """Options of an export. None: the default of the format.

    Attributes
    ----------
    compress
        ``.h5``, ``.mat``: whether the file is compressed.
    dtype
        ``.h5``: stored type.
    include_transpose, rows_first, lens_centred, interpolation
        ``.mat``: as in `lfcal.psf._matlab.MatOptions`.
    position
        TIFF: write only the stack over depth of position (y, x), instead of all positions.
    allow_missing
        ``.mat``, ``.npy``, ``.npz``, TIFF: write zeros for positions that were never recorded, which these formats
        cannot mark.
    code
        Code that reads the file, one of `lfcal.psf.codes.CODES`; it determines axis order, centring and variable names.
    sparse
        oLaF: whether each pattern is a sparse matrix of double values.
    quality
        ``.mat``, ``.npz``, TIFF: quality of H, such as ``"good"``, which is written to the file.
    """

    compress: bool | None = None
    dtype: str | None = None
    include_transpose: bool | None = None
    rows_first: bool | None = None
    lens_centred: bool | None = None
    interpolation: str | None = None
    position: tuple[int, int] | None = None
    allow_missing: bool | None = None
    code: str | None = None
    sparse: bool | None = None
    quality: str | None = None

    def given(self) -> dict[str, Any]:
        """Return the options that are not None, by name."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def mat(self) -> MatOptions:
        """The options for a ``.mat`` file."""
        names = {entry.name for entry in fields(MatOptions)}
        known = {name: value for name, value in self.given().items() if name in names}
        return MatOptions(**known, cells=self.code == "olaf")

    @property
    def reader(self) -> Code | None:
        """The code that reads the file; None if none is stated."""
        return None if self.code is None else code_of(self.code)

    def for_code(self, matrix: PSFMatrix) -> ExportOptions:
        """Return the options, completed with those that the reading code needs."""
        code = self.reader
        if code is None:
            return self
        if code.suffix == ".mat":
            centred = lens_centre_of(matrix) is not None
            return replace(self, rows_first=True, lens_centred=centred)
        return replace(self, position=self.position or (0, 0)) if not code.one_lens else self


def _write_h5(
    matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions, run: RunChoice | None
) -> Work[Path]:
    compression = "none" if options.compress is False else "gzip"
    return iter_save(matrix, path, dtype=options.dtype, compression=compression, run=run)


def _write_mat(
    matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions, run: RunChoice | None
) -> Work[Path]:
    if run is None or options.mat.cells:  # there are too many cells to make each in a separate file
        return iter_write_mat(matrix, path, options.mat)
    return _iter_units(matrix, Path(path), options, run)


def _write_npz(
    matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions, run: RunChoice | None
) -> Work[Path]:
    return iter_write_npz(
        matrix,
        Path(path),
        include_transpose=options.include_transpose is not False,
        compress=options.compress is not False,
        quality=options.quality or "",
    )


def _write_npy(
    matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions, run: RunChoice | None
) -> Work[Path]:
    return iter_write_npy(matrix, path) if run is None else _iter_units(matrix, Path(path), options, run)


def _write_tiff(
    matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions, run: RunChoice | None
) -> Work[Path]:
    # without units: a TIFF of several planes already has one file for each, or is small
    return iter_write_tiff(matrix, path, position=options.position, quality=options.quality or "")


class _Writer(NamedTuple):
    """Function that writes a format, and names of the options that the format uses."""

    write: Callable[[PSFMatrix, str | os.PathLike[str], ExportOptions, RunChoice | None], Work[Path]]
    uses: frozenset[str]


_UNMARKED = frozenset({"allow_missing"})
"""Options of formats that contain only values."""

_CODED = _UNMARKED | {"code", "quality"}
"""Options of formats that other codes read."""

_TIFF = _Writer(_write_tiff, frozenset({"position"}) | _CODED)
WRITERS = {
    ".h5": _Writer(_write_h5, frozenset({"compress", "dtype"})),
    ".mat": _Writer(_write_mat, frozenset(entry.name for entry in fields(MatOptions)) - {"cells"} | _CODED),
    ".npy": _Writer(_write_npy, _UNMARKED),
    ".npz": _Writer(_write_npz, frozenset({"include_transpose", "compress"}) | _CODED),
    ".tif": _TIFF,
    ".tiff": _TIFF,
}
"""Formats by suffix."""


def export_files(
    matrix: PSFMatrix, path: str | os.PathLike[str], position: tuple[int, int] | None = None
) -> list[Path]:
    """Return the paths of the files that an export to ``path`` writes; a large H as TIFF has one file per plane."""
    is_tiff = WRITERS.get(Path(path).suffix.lower()) is _TIFF
    return tiff_files(matrix, path, position) if is_tiff else [Path(path)]


def export_notes(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> tuple[str, ...]:
    """Return notes and instructions for users of the file, one line each.

    The notes concern missing positions, and conventions of the codes that read ``.mat`` files.
    """
    suffix, code = Path(path).suffix.lower(), options.reader
    notes = mat_notes(matrix, options.for_code(matrix).mat) if suffix in (".mat", ".npz") else ()
    if code is not None and code.use:
        notes = (*notes, code.use)
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
    code: str | None = None,
    sparse: bool | None = None,
    quality: str | None = None,
    run: RunChoice | None = None,
) -> Work[Path]:
    """Write ``matrix`` to ``path`` in the format that the suffix indicates, and return the path.

    The suffixes are ``.h5`` (H file), ``.mat`` (MATLAB v7.3 with H, Ht, Nnum, CAindex, x3objspace, anchor, lensCentre),
    ``.npy``, ``.npz`` (H, Ht), and ``.tif`` (hyperstacks). With ``code``, the file is written in the form that this
    code reads. `ExportOptions` describes the options, and `export_notes` the conventions that differ in other
    programs. With ``run``, the planes of a matrix opened from a file are written as units of a run; finished planes are
    kept if it is stopped. TIFF and ``.npz`` files, and ``.mat`` files for oLaF, are always written without units.

    Raises
    ------
    InputError
        If the suffix is unknown, or its format does not use an option. Also if positions are missing that the format
        cannot mark, without ``allow_missing``. Also if ``code`` cannot use this H, or a ``run`` is given for a matrix
        without a file.
    StorageError
        If the file cannot be written; with a ``run``, as in `lfcal.work.iter_made`.

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
        compress,
        dtype,
        include_transpose,
        rows_first,
        lens_centred,
        interpolation,
        position,
        allow_missing,
        code,
        sparse,
        quality,
    )
    suffix = check_export(matrix, path, options)
    return WRITERS[suffix].write(matrix, path, options.for_code(matrix), run)


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
    """Return the suffix of the format; raise the same `InputError` as `iter_export`."""
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise InputError.expected(
            "export format",
            any_of(WRITERS),
            suffix or "no suffix",
            "end the name of the file with one of these suffixes",
        )
    for name in options.given():
        if name not in WRITERS[suffix].uses:
            used = ", ".join(sorted(WRITERS[suffix].uses)) or "none"
            raise InputError.expected(f"options of {suffix} files", used, name, "leave this option out")
    code = options.reader
    if options.sparse and options.code != "olaf":
        raise InputError.expected(
            "code for sparse patterns", "olaf", options.code or "none", "choose olaf (--for), or leave sparse out"
        )
    if suffix == ".npz" and code is None:
        raise InputError.expected(
            "code of an .npz file", "pyolaf", "none", "choose pyolaf (--for), or write a .npy file"
        )
    if code is not None:
        if suffix != code.suffix:
            raise InputError.expected(
                f"file for {code.title}", code.suffix, suffix, "end the name of the file with this suffix"
            )
        problem = refused_by(code, matrix, options.position)
        if problem is not None:
            raise problem
    check_missing(matrix, suffix, options)
    check_other_file(matrix.path, path)
    return suffix


def check_missing(matrix: PSFMatrix, suffix: str, options: ExportOptions) -> None:
    """Raise `InputError` for missing positions that files of ``suffix`` cannot mark, unless they are allowed."""
    if "allow_missing" in WRITERS[suffix].uses and not options.allow_missing and _exports_empty(matrix, options):
        raise InputError.expected(
            f"H for a {suffix} file, which cannot mark missing positions",
            "every position recorded or filled",
            f"an H in which {empty_words(matrix)}",
            "fill the missing ones (lfcal assemble --fill), write an H file (.h5), or write zeros in their "
            "place (--allow-missing)",
        )


# -- units: other threads, processes, machines -------------------------------------------------------------------------
PLANE, CROP = "plane", "crop"


def _iter_units(matrix: PSFMatrix, target: Path, options: ExportOptions, run: RunChoice) -> Work[Path]:
    """Write a ``.mat`` or ``.npy`` file as units of a run, each of which writes one plane to a separate file."""
    from lfcal.work import Unit, iter_made

    suffix = target.suffix.lower()
    names = ("H", "Ht") if suffix == ".mat" and options.mat.include_transpose else ("H",)
    # before any plane is made
    require_space(target.parent, len(names) * matrix.nbytes, what=target.name)
    reopening = MatrixPlanes(matrix).reopening(0, Stored())
    shared = {"matrix": reopening.values, "suffix": suffix, "options": asdict(options.mat) if suffix == ".mat" else {}}
    units = [
        Unit(
            f"plane {z:04d}" if name == "H" else f"{name} plane {z:04d}",
            f"{__name__}:{do_plane.__name__}",
            shared | {"name": name, "z": z},
            reopening.inputs,
        )
        for name in names
        for z in range(len(matrix))
    ]
    join = partial(_iter_joined, matrix=matrix, target=target, options=options)
    yield from iter_made(units, target, run, join, title=f"export {target.name}")
    return target


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write one plane to a separate file, in the form of the final file; this is the task of a unit."""
    z, suffix = int(arguments["z"]), arguments["suffix"]
    clock = Clock(f"export plane {z}", 1)
    yield clock.at(0)
    with closing(open_planes(arguments["matrix"], workers)) as planes:
        options = MatOptions(**arguments["options"]) if suffix == ".mat" else MatOptions(compress=False)
        written = mat_written(planes.matrix, options) if suffix == ".mat" else planes.matrix
        plane, crop = mat_plane(written, options, arguments["name"], z)
        with new_h5(out) as file:
            data = create_mat_data(file, PLANE, written, options, planes=1)
            store_plane(data, 0, plane, workers=workers)
            data.attrs[CROP] = crop
    yield clock.at(1)


def _iter_joined(parts: Sequence[Path], *, matrix: PSFMatrix, target: Path, options: ExportOptions) -> Work[None]:
    """Write the final file from the files of its planes."""
    if target.suffix.lower() == ".npy":
        yield from iter_write_npy(matrix, target, lambda z: _read(parts[z]))
    else:

        def store(name: str, z: int, data: Any) -> tuple[int, int]:
            return _take(parts[z if name == "H" else len(matrix) + z], data, z)

        yield from iter_write_mat(matrix, target, options.mat, store)


def _read(part: Path) -> NDArray[Any]:
    """Return the plane in the file ``part`` that a unit wrote."""
    with H5File(part) as file:
        plane: NDArray[Any] = file.dataset(PLANE).read()[0]
        return plane


def _take(part: Path, data: Any, z: int) -> tuple[int, int]:
    """Copy the plane in a unit's file ``part`` to plane ``z`` of an open dataset, as it is stored; return its crop."""
    with H5File(part) as file:
        stored = file.dataset(PLANE)
        if data.chunks:
            copy_plane(stored, data, z)
        else:
            data[z] = stored.read()[0]
        crop = file.attributes(PLANE).numbers(CROP, (2,))
        assert crop is not None, "do_plane writes it"
        return int(crop[0]), int(crop[1])
