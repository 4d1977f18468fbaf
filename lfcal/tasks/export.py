"""Export of H for other programs: one kind of task for each format."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import (
    CODE_NAMES,
    INTERPOLATIONS,
    STORED_TYPES,
    opt,
    read_position,
    record,
    required,
    rows_of,
    show_pair,
    value_at,
)
from lfcal.tasks.matrices import CopyTask, report_dark, with_task
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.psf import ExportOptions, PSFMatrix
    from lfcal.work import RunChoice

__all__ = ["EXPORT", "ExportFor", "ExportH5", "ExportMat", "ExportNpy", "ExportTiff", "ExportedFiles"]


@dataclass(frozen=True, kw_only=True)
class ExportedFiles(TaskResult):
    """Files written by an export to ``out``; a large H exported to TIFF has one file for each plane.

    ``files`` are their paths, ``shape`` is that of the exported H, and ``seconds`` the duration (s). ``dark`` lists the
    indices of planes without light. ``notes`` describe the file for its users.
    """

    out: Path
    files: tuple[Path, ...]
    shape: tuple[int, ...]
    seconds: float
    dark: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def bytes(self) -> int:
        """Total size of all files (bytes)."""
        return sum(file.stat().st_size for file in self.files)

    def _values(self) -> dict[str, Any]:
        return {
            "out": self.out,
            "files": [{"file": file, "bytes": file.stat().st_size} for file in self.files],
            "shape": self.shape,
            "file_bytes": self.bytes,
            "seconds": self.seconds,
            "dark": self.dark,
            "notes": self.notes,
        }


@record
class _Export(CopyTask):
    """Fields of all formats."""

    name: ClassVar[str] = "export"
    suffixes: ClassVar[tuple[str, ...]]

    out: Path = required(
        "File to write. Its suffix selects the format: .mat, .h5, .npy or .tif; for pyolaf .npz.",
        label="File",
        short="-o",
        file="out",
    )

    def __post_init__(self) -> None:
        """Check every value."""
        super().__post_init__()
        if self.out.suffix.lower() not in self.suffixes:
            raise InputError.expected(
                "--out", self.input_words, self.out.name, "end the name of the file with this suffix"
            )

    def options(self) -> ExportOptions:
        """Return the settings that differ from the defaults of the format."""
        from lfcal.psf import ExportOptions

        given = {row.name: value for row in rows_of(self) if (value := value_at(self, row)) != row.default}
        known = {one.name: given[one.name] for one in fields(ExportOptions) if one.name in given}
        if "uncompressed" in given:
            known["compress"] = False
        if "no_ht" in given:
            known["include_transpose"] = False
        return ExportOptions(**known)

    def exported(self, H: PSFMatrix) -> PSFMatrix:
        """Return the matrix to write: H, or a view of it."""
        return H

    def _iter_write(self, matrix: PSFMatrix, workers: int | None, run: RunChoice | None) -> Work[Path]:
        from lfcal.psf import iter_export

        return iter_export(matrix, self.out, **self.options().given(), run=run)

    def work(self, run: RunSettings | None = None) -> Work[tuple[ExportedFiles, ...]]:
        """Write H in the format of this task."""
        from lfcal.psf import export_files, export_notes, opening_notes

        start, run, options = time.perf_counter(), run or RunSettings(), self.options()
        # the notes of the result already say how the file was read
        with self.opened(quiet=True) as H:
            matrix = self.exported(H)
            # only on request, even for long exports: doing them in units needs twice the disk space
            choice = run.choice(self.out) if self.in_units else None
            work = self._iter_write(matrix, run.workers, choice)  # raises for what the format cannot hold
            dark = report_dark(matrix)
            yield from work
            made = ExportedFiles(
                out=self.out,
                files=tuple(export_files(matrix, self.out, options.position)),
                shape=matrix.shape,
                seconds=time.perf_counter() - start,
                dark=dark,
                notes=(*opening_notes(H), *export_notes(matrix, self.out, options)),
            )
        return (made,)


@record
class _ExportView(_Export):
    """Fields of formats that contain one matrix."""

    transposed: bool = opt(False, "Export HT instead of H.", label="HT instead of H")

    def exported(self, H: PSFMatrix) -> PSFMatrix:
        """Return H, or HT."""
        return H.T if self.transposed else H


def _missing() -> bool:
    """Declare the field ``allow_missing`` of formats that contain only values."""
    return opt(
        False,
        "Write zeros for missing positions, which this format cannot mark.",
        label="Zeros for missing positions",
        more=True,
    )


def _uncompressed() -> bool:
    """Declare the field ``uncompressed`` of formats that are usually compressed."""
    return opt(False, "Do not compress the file. It becomes larger, and can be read faster.", more=True)


@record
class ExportMat(_Export):
    """Export H and HT to a MATLAB file (v7.3), for a deconvolution code."""

    input_words: ClassVar[str] = "a .mat file"
    in_units: ClassVar[bool] = True
    suffixes: ClassVar[tuple[str, ...]] = (".mat",)

    no_ht: bool = opt(False, "Leave out HT, to halve the file size.", label="Without HT")
    rows_first: bool = opt(False, "Store H(t,s,y,x,z), for codes whose images have rows as the first axis.")
    lens_centred: bool = opt(
        False,
        "Place the centre of a lens on pixel ceil(Nnum/2), as expected by codes based on Prevedel et al.",
        label="Centre a lens",
    )
    interpolation: str = opt(
        "",
        "Interpolation for subpixel shifts when a lens is centred.",
        choices=INTERPOLATIONS,
        empty="nearest: whole pixels only",
        needs=("lens_centred", ""),
    )
    uncompressed: bool = _uncompressed()
    allow_missing: bool = _missing()


@record
class ExportH5(_ExportView):
    """Export H, or HT, to an lfcal H file.

    Examples
    --------
    >>> from lfcal.tasks import ExportH5, ExportMat, ExportNpy, ExportTiff
    >>> (made,) = ExportH5(source="H.h5", out="made.h5", transposed=True, uncompressed=True).run()
    >>> print([file.name for file in made.files], made.shape)
    ['made.h5'] (2, 19, 33, 55, 55)
    >>> for kind, out in ((ExportMat, "made.mat"), (ExportNpy, "made.npy"), (ExportTiff, "made.tif")):
    ...     (made,) = kind(source="H.h5", out=out, allow_missing=True).run()
    """

    input_words: ClassVar[str] = "a .h5 file"
    in_units: ClassVar[bool] = True
    suffixes: ClassVar[tuple[str, ...]] = (".h5",)

    dtype: str = opt(
        "",
        "Type of the stored values. rounded: float32 in steps of at most 1/65535 of the range of the plane; compresses "
        "better.",
        label="Stored type",
        choices=STORED_TYPES,
        empty="as in the source",
        more=True,
    )
    uncompressed: bool = _uncompressed()

    def _iter_write(self, matrix: PSFMatrix, workers: int | None, run: RunChoice | None) -> Work[Path]:
        from lfcal.psf import iter_save

        return iter_save(
            matrix,
            self.out,
            dtype=self.dtype or None,
            compression="none" if self.uncompressed else "gzip",
            workers=workers,
            provenance=with_task(self, matrix),
            run=run,
        )


@record
class ExportNpy(_ExportView):
    """Export H, or HT, to a NumPy file."""

    input_words: ClassVar[str] = "a .npy file"
    in_units: ClassVar[bool] = True
    suffixes: ClassVar[tuple[str, ...]] = (".npy",)

    allow_missing: bool = _missing()


@record
class ExportTiff(_ExportView):
    """Export H, or HT, to TIFF hyperstacks for ImageJ; a large H becomes one file for each plane."""

    input_words: ClassVar[str] = "a .tif file"
    suffixes: ClassVar[tuple[str, ...]] = (".tif", ".tiff")

    position: tuple[int, int] | None = opt(
        None,
        "Write only the position (Y,X), as a stack over depth.",
        empty="all positions",
        read=read_position,
        show=show_pair,
    )
    allow_missing: bool = _missing()

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The number of files to write depends on the size of H.
        """
        if way != "out":
            return super().files(way)
        from lfcal.psf import export_files

        with self.opened(quiet=True) as H:
            return tuple(export_files(self.exported(H), self.out, self.position))


@record
class ExportFor(_Export):
    """Export H and HT to a file for one deconvolution code."""

    input_words: ClassVar[str] = "a file for one code (--for)"
    suffixes: ClassVar[tuple[str, ...]] = (".mat", ".npz", ".tif")

    code: str = required(
        "Code that will read the file. It determines the order of axes, the centring and the names of variables.",
        flag="--for",
        choices=CODE_NAMES,
        chooses=True,
    )
    quality: str = opt("", "Verdict on the quality of H, such as good, to write into the file.", empty="none")
    no_ht: bool = opt(False, "Leave out HT, to halve the file size.", label="Without HT")
    position: tuple[int, int] | None = opt(
        None,
        "For a Fourier light-field microscope: the position (Y,X) whose patterns are written, if H has several.",
        empty="the only one",
        read=read_position,
        show=show_pair,
    )
    sparse: bool = opt(
        False,
        "For oLaF: store each pattern as a sparse matrix, which is smaller if most of its pixels are zero.",
        label="Sparse patterns",
        needs=("code", "olaf"),
    )
    uncompressed: bool = _uncompressed()
    allow_missing: bool = _missing()

    def __post_init__(self) -> None:
        """Check every value, and the suffix of the file."""
        super().__post_init__()
        from lfcal.psf import CODES

        code = CODES[self.code]
        if self.out.suffix.lower() != code.suffix:
            raise InputError.expected(
                "--out",
                f"a {code.suffix} file for {code.title}",
                self.out.name,
                "end the name of the file with this suffix",
            )


KINDS: tuple[type[_Export], ...] = (ExportMat, ExportH5, ExportNpy, ExportTiff, ExportFor)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the export, by the name of a code if one is given, or else by the suffix of the file."""
    suffix = Path(given["out"]).suffix.lower()
    if given.get("code"):
        return ExportFor
    for kind in KINDS[:-1]:
        if suffix in kind.suffixes:
            return kind
    known = " ".join(suffix for kind in KINDS[:-1] for suffix in kind.suffixes)
    raise InputError.expected(
        "suffix of the output file", known, suffix or "no suffix", "end the name with one of these suffixes"
    )


EXPORT = TaskSet(
    "export",
    KINDS,
    kind_of,
    "lfcal export H.h5 --for olaf -o H.mat",
    "Export H (and Ht) for a deconvolution code or another program.\n\nThe suffix of the file selects the "
    "format. --for writes the file for one code.",
)
