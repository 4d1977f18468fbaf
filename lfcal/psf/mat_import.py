"""Import H from MATLAB v7.3 files: those of lfcal, and those of the codes based on Prevedel et al. 2014.

The images of those codes have rows first, as in MATLAB, and so has their ``H(t, s, y, x, z)``. They use only the
window ``CAindex`` of each plane. Files of fast-light-field contain a quarter of the positions (``ReducedMatrix``). If
neither a file nor its variables show the order of the axes, columns first is assumed, ``H(s, t, x, y, z)``. The order
used is always noted. oLaF's cell array ``H{y, x, z}`` contains a pattern ``(t, s)`` in each cell, which may be sparse.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, UnsafeFileError, any_of, format_bytes, storage_errors
from lfcal.base.h5 import H5File
from lfcal.psf._matlab import COLUMNS_FIRST, ROWS_FIRST
from lfcal.psf._planes import DatasetPlanes, FilePlanes, Planes
from lfcal.psf._rearranged import ONE_PER_PLANE, MirroredPlanes, PlacedPlanes, Window, padding_note
from lfcal.psf.matrix import PSFMatrix

__all__ = ["MAT_ORDERS", "check_mat_order", "open_mat"]

THEIRS = ("ReducedMatrix", "settingPSF", "MLARRAY", "OSR", "x1objspace", "fml", "MLPitch", "Nnum", "CAindex")
"""Variables by which a file of Prevedel's code, or of a code based on it, is recognised."""

MAT_ORDERS = {"rows-first": ROWS_FIRST, "columns-first": COLUMNS_FIRST}
"""Orders of the axes of H that the caller may state, as written in the variable ``axisOrder``."""

MAX_BYTES = 1 << 36
"""Largest size (bytes) of the patterns of a cell array, which are read into memory."""

MAX_SIDE = 1 << 15
"""Largest number of rows or columns of a sparse pattern."""

_WORDS = {
    ROWS_FIRST: ("rows-first", "H(t, s, y, x, z), rows first"),
    COLUMNS_FIRST: ("columns-first", "H(s, t, x, y, z), columns first"),
}
"""Name and description of each order."""


def check_mat_order(mat_order: str) -> str:
    """Return ``mat_order`` unchanged; raise `InputError` unless it is empty or one of `MAT_ORDERS`."""
    if mat_order and mat_order not in MAT_ORDERS:
        raise InputError.expected(
            "order of the axes in a .mat file", any_of(MAT_ORDERS), mat_order, "choose one of these"
        )
    return mat_order


def open_mat(path: Path, *, mat_order: str = "") -> PSFMatrix:
    """Open the ``H`` of a MATLAB v7.3 file as a lazy `PSFMatrix`; depths are read from the variable ``x3objspace``.

    A 4-D H is a single plane, because MATLAB drops trailing axes of length one. A 3-D ``H`` or ``PSF`` (rows, columns,
    planes) contains one pattern for each plane, as for a Fourier light-field microscope; its period is 1 x 1. The
    provenance states how the file was read. Its ``notes`` are for the user, and ``lens_centre`` is set if the file or
    the convention of the software that wrote it determines it.

    Parameters
    ----------
    path
        The file.
    mat_order
        Order of the axes of H, one of `MAT_ORDERS`; empty: as stated by the file, or else inferred from its variables.

    Raises
    ------
    FileFormatError
        If the file is of MATLAB version 5 to 7, or contains no H that can be read; the message states the reason.
    InputError
        If ``mat_order`` is unknown or contradicts the file.
    """
    check_mat_order(mat_order)
    _check_version(path)
    file = H5File(path)
    try:
        return _Reader(file, MAT_ORDERS.get(mat_order, "")).matrix()
    except BaseException:
        file.close()
        raise


def _check_version(path: Path) -> None:
    head = b""
    if path.is_file():
        with storage_errors(path), path.open("rb") as raw:
            head = raw.read(128)
    # MATLAB 5.0 files are not HDF5, and h5py would only report a missing signature
    if head.startswith(b"MATLAB 5.0"):
        raise FileFormatError.expected(
            str(path),
            "a MATLAB v7.3 file",
            "one of version 5 to 7",
            "save it in MATLAB with save(..., '-v7.3'), or as a 5-D .npy array (z, y, x, t, s) with scipy and numpy",
        )


class _Reader:
    """Reader of the H of one MATLAB file, according to the program that wrote the file."""

    def __init__(self, file: H5File, stated: str = "") -> None:
        self._file = file
        self._order = self._text("axisOrder")
        if stated and self._order not in ("", stated):
            wanted = f"{_WORDS[self._order][0]}, as its axisOrder states"
            raise InputError.expected(f"{file.path}, order of its axes", wanted, _WORDS[stated][0], "omit the order")
        known = [name for name in THEIRS if name in file]
        self._name = "PSF" if "H" not in file and len(file.dataset_shape("PSF")) == 3 else "H"
        self._cells = self._class(self._name) == "cell"
        self._theirs = not self._order and (bool(known) or self._cells)
        self._stack = not self._cells and len(file.dataset_shape(self._name)) == 3
        taken = self._order or stated or (ROWS_FIRST if self._theirs or self._stack else COLUMNS_FIRST)
        # a cell contains a pattern (t, s), whatever the order of a full array would be
        self._swapped = self._cells or taken == ROWS_FIRST
        if self._cells:
            self._notes = ["read as oLaF's cell array H{y, x, z} of patterns (t, s)"]
        else:
            self._notes = [ONE_PER_PLANE if self._stack else self._order_note(taken, stated, known)]

    def _order_note(self, taken: str, stated: str, known: list[str]) -> str:
        """Return the order in which the axes were read and the reason; if inferred, also how to state the other."""
        read = f"read as {_WORDS[taken][1]}"
        if self._order or stated:
            return f"{read}, as {'its axisOrder states' if self._order else 'requested'}"
        other, axes = _WORDS[COLUMNS_FIRST if taken == ROWS_FIRST else ROWS_FIRST]
        why = f"as in codes that write {known[0]}" if known else "because nothing in the file states the order"
        return f"{read}, {why}; if it is {axes}, import it with `lfcal export --mat-order {other}`"

    def matrix(self) -> PSFMatrix:
        """Return H."""
        base = stored = self._stored()
        nz, _, _, nt, ns = base.shape
        if self._flag("ReducedMatrix"):
            base = MirroredPlanes(base)
            self._notes.append(
                "the file contains a quarter of the positions (ReducedMatrix); the others were mirrored, as "
                "in the code that wrote it"
            )
        windows = self._windows(nz, nt, ns)
        if self._swapped or windows or not (nt % 2 and ns % 2):
            base = self._placed(base, windows)
        if padded := padding_note((ns, nt) if self._swapped else (nt, ns)):
            self._notes.append(padded)
        depths, anchor = self._depths(nz), self._anchor()
        provenance: dict[str, Any] = {"imported": self._file.path.name, **self._lens(base.shape)}
        provenance["mat_order"] = _WORDS[ROWS_FIRST if self._swapped else COLUMNS_FIRST][0]
        provenance["mat_order_open"] = not self._order
        provenance["notes"] = self._notes
        if isinstance(stored, FilePlanes):  # the whole matrix is read
            self._file.close()
        return PSFMatrix(base, depths=depths, anchor=anchor, provenance=provenance)

    def _stored(self) -> Planes:
        where = f"{self._file.path}: {self._name}"
        if self._name not in self._file:
            axes = {name: len(shape) for name, shape in self._file.datasets().items() if len(shape) in (3, 4, 5)}
            found = [f"{name} with {count} axes" for name, count in axes.items()]
            remedy = (
                f"in MATLAB: H = {next(iter(axes)).replace('/', '.')};"
                if axes
                else "in MATLAB, with the patterns as H:"
            )
            raise FileFormatError.expected(
                str(self._file.path),
                "a variable H, or PSF with one pattern per plane",
                ", ".join(found[:8]) or "no array of 3 to 5 axes",
                f"{remedy} save('H.mat', 'H', '-v7.3')",
            )
        if self._cells:
            return FilePlanes(self._patterns(), self._file.path)
        if self._class(self._name) == "struct":
            raise FileFormatError.expected(
                where, "an array of numbers", "a struct array", "save the field with H as a variable"
            )
        if self._name in self._file and self._file.attributes(self._name).integer("MATLAB_sparse") is not None:
            raise FileFormatError.expected(
                where,
                "a full numeric array",
                "a sparse matrix",
                "convert it in MATLAB: H = reshape(full(H), [nt ns ny nx nz])",
            )
        data = self._file.dataset(self._name)
        if self._stack:
            return FilePlanes(data.read()[:, None, None], self._file.path)
        if data.ndim == 4:
            return FilePlanes(data.read()[None], self._file.path)
        if data.ndim != 5:
            raise FileFormatError.expected(
                where, "5 axes (s, t, x, y, z)", f"{data.ndim} axes", "check the variable in the file"
            )
        return DatasetPlanes(data)

    def _patterns(self) -> NDArray[np.float32]:
        """Return the patterns of a cell array, ``(z, x, y, s, t)`` as HDF5 has them."""
        where = f"{self._file.path}: {self._name}"
        names = self._file.references(self._name)
        names = names[None] if names.ndim == 2 else names  # MATLAB drops a last axis of length one
        if names.ndim != 3:
            raise FileFormatError.expected(where, "cells H{y, x, z}", f"{names.ndim} axes", "check the variable")
        values: NDArray[np.float32] | None = None
        for at in np.ndindex(names.shape):
            pattern = self._pattern(str(names[at]))
            if values is None:
                if names.size * pattern.size * 4 > MAX_BYTES:
                    raise UnsafeFileError.expected(
                        where,
                        f"patterns of up to {format_bytes(MAX_BYTES)}",
                        format_bytes(names.size * pattern.size * 4),
                        "crop them",
                    )
                values = np.empty((*names.shape, *pattern.shape), np.float32)
            if pattern.shape != values.shape[3:]:
                sizes = f"{values.shape[:2:-1]} and {pattern.shape[::-1]}"
                raise FileFormatError.expected(where, "patterns of one size", sizes, "pad the smaller ones with zeros")
            values[at] = pattern
        assert values is not None  # an array of references has entries
        return values

    def _pattern(self, name: str) -> NDArray[Any]:
        """Return a full or sparse pattern ``(s, t)``."""
        rows = self._file.attributes(name).integer("MATLAB_sparse")
        if rows is None:
            pattern = self._file.values(name, finite=True)
            if pattern.ndim == 2:
                return pattern
            raise FileFormatError.expected(
                f"{self._file.path}:{name}", "a matrix in every cell", f"{pattern.ndim} axes", "check the variable"
            )
        there = self._file.names(name)
        starts = self._file.values(f"{name}/jc", kinds="iu").ravel().astype(np.int64)
        held = [self._file.values(f"{name}/{key}").ravel() if key in there else np.zeros(0) for key in ("ir", "data")]
        at, values = held[0].astype(np.int64), held[1]
        counts = np.diff(starts)
        sound = starts.size and starts[0] == 0 and (counts >= 0).all() and starts[-1] == at.size == values.size
        if (
            not sound
            or not 0 < rows <= MAX_SIDE
            or starts.size - 1 > MAX_SIDE
            or (at.size and not 0 <= at.min() <= at.max() < rows)
        ):
            raise FileFormatError.expected(
                f"{self._file.path}:{name}", "a sparse matrix", "rows and columns that do not fit", "save it again"
            )
        pattern = np.zeros((starts.size - 1, rows), np.float32)
        pattern[np.repeat(np.arange(starts.size - 1), counts), at] = values
        return pattern

    def _placed(self, base: Planes, windows: list[Window] | None) -> Planes:
        """Return the planes in lfcal's order, each in the middle of an odd cutout."""
        shape = base.shape[:2:-1] if self._swapped else base.shape[3:]
        nt, ns = self._cutout(shape) or (n + 1 - n % 2 for n in shape)
        return PlacedPlanes(base, (nt, ns), windows, swapped=self._swapped)

    def _cutout(self, shape: tuple[int, ...]) -> tuple[int, int] | None:
        """Return the cutout before it was padded to the file's square of ``shape``, None if it is not stated."""
        stated = self._pair("cutout")
        if stated is None:
            return None
        if not all(v == int(v) and 1 <= v <= n for v, n in zip(stated, shape, strict=True)):
            raise FileFormatError.expected(
                f"{self._file.path}: cutout", f"a size of up to {shape}", stated, "export the file again"
            )
        return int(stated[0]), int(stated[1])

    def _windows(self, nz: int, nt: int, ns: int) -> list[Window] | None:
        """Return the window of pixels that is used in each plane; None if all pixels are used."""
        if self._order:  # lfcal files state the cutout; CAindex excludes only zeros
            whole: Window = (slice(0, nt), slice(0, ns))
            return [whole] * nz if self._cutout((nt, ns)) not in (None, (nt, ns)) else None
        if "CAindex" not in self._file or nt != ns:
            return None
        first, last = self._crops(nz, nt)
        if (first == 1).all() and (last == nt).all():
            return None
        self._notes.append("only the window CAindex of each plane was read, as in the code that wrote it")
        return [(slice(a - 1, b), slice(a - 1, b)) for a, b in zip(first.tolist(), last.tolist(), strict=True)]

    def _crops(self, nz: int, n: int) -> NDArray[np.int64]:
        """Return the first and last pixel of each plane's window, counted from 1, ``(2, nz)``."""
        found = self._file.values("CAindex", finite=True)
        # MATLAB's (nz, 2) is (2, nz) here; fast-light-field has written both orders
        table = found.T if found.shape == (nz, 2) and nz != 2 else found
        whole = table.astype(np.int64) if table.shape == (2, nz) else np.zeros((2, nz), np.int64)
        if (whole != table).any() or (whole[0] < 1).any() or (whole[1] > n).any() or (whole[0] > whole[1]).any():
            wanted = f"first and last pixel (1 to {n}) of each of {nz} planes"
            raise FileFormatError.expected(
                f"{self._file.path}: CAindex",
                wanted,
                f"other numbers, or shape {found.shape[::-1]}",
                "check this variable in the file",
            )
        return whole

    # -- other variables of the file -------------------------------------------------------------------
    def _depths(self, nz: int) -> NDArray[np.float64] | None:
        """Return the depths (µm); None if the file has none, or another number than planes."""
        if "x3objspace" not in self._file:
            return None
        # beyond a million kilometres a value is not a depth of optics, and could overflow
        values = self._file.values("x3objspace", finite=True, at_most=1e9).astype(np.float64).ravel() * 1e6  # m to µm
        if values.size != nz:
            return None
        if np.unique(values).size < nz:
            raise FileFormatError.expected(
                f"{self._file.path}: x3objspace",
                "different depths for all planes",
                "a repeated depth",
                "check this variable in the file",
            )
        return values

    def _lens(self, shape: tuple[int, ...]) -> dict[str, Any]:
        """Return the entry ``lens_centre`` of the provenance, ``[row, column]`` from 0; no entry if it is unknown."""
        stated = self._pair("lensCentre")
        if stated is not None:
            return {"lens_centre": [v - 1 for v in stated]}
        return {"lens_centre": [(n + 1) // 2 - 1 for n in shape[1:3]]} if self._theirs else {}

    def _anchor(self) -> tuple[float, float]:
        stated = self._pair("anchor") if self._order else None
        return (0.0, 0.0) if stated is None else (stated[0] - 1, stated[1] - 1)

    def _pair(self, name: str) -> tuple[float, float] | None:
        """Return a pair of numbers from a variable that only lfcal writes, as (rows, columns)."""
        if not self._order or name not in self._file:
            return None
        values = self._file.values(name, finite=True).ravel()
        if values.size != 2:
            raise FileFormatError.expected(
                f"{self._file.path}: {name}", "two numbers", f"{values.size}", "check this variable in the file"
            )
        pair = values.tolist() if self._swapped else values[::-1].tolist()
        return float(pair[0]), float(pair[1])

    def _text(self, name: str) -> str:
        """Return the order of the axes; empty if the file does not state it."""
        if name not in self._file:
            return ""
        letters = self._file.values(name, kinds="u").ravel().tolist()
        order = "".join(chr(letter) if letter < 128 else "?" for letter in letters[:16])
        if order not in (ROWS_FIRST, COLUMNS_FIRST):
            known = f"{COLUMNS_FIRST} or {ROWS_FIRST}"
            raise FileFormatError.expected(f"{self._file.path}: {name}", known, repr(order), "export the file again")
        return order

    def _flag(self, name: str) -> bool:
        return name in self._file and bool(self._file.values(name, kinds="biuf").any())

    def _class(self, name: str) -> str:
        return self._file.attributes(name).text("MATLAB_class", "") if name in self._file else ""
