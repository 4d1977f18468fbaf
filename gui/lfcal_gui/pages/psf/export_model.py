"""What the export of H asks for: a kind of file, and the options that concern it, a line about each. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from lfcal.base import InputError, Work
from lfcal.psf import (
    ExportOptions,
    PSFMatrix,
    check_missing,
    empty_positions,
    export_files,
    export_notes,
    lens_centre_of,
)
from lfcal_gui.models import PageSettings, said_in_window

if TYPE_CHECKING:
    from lfcal.tasks import Task

__all__ = ["KINDS", "Choice", "ExportIntent", "ExportSettings", "export_task", "iter_exported"]

KINDS = (
    (".mat", "MATLAB v7.3, for deconvolution codes"),
    (".h5", "H file, with all that is known of it"),
    (".npy", "numpy array"),
    (".tif", "ImageJ hyperstack, to look at"),
)
"""Suffixes and what they are for."""


class Choice(NamedTuple):
    """An entry of `ExportIntent` that is on or off, the suffixes it concerns, and its words."""

    name: str
    suffixes: tuple[str, ...]
    text: str
    hint: str


CHOICES = (
    Choice(
        "lens_centred", (".mat",), "Lens-centred", "A lens on pixel ⌈Nnum/2⌉ of the period, as oLaF and LFDM take it."
    ),
    Choice(
        "moved",
        (".mat",),
        "Move patterns by the residual",
        "Cubic, by what whole pixels leave: as rectifying does.",
    ),
    Choice("rows_first", (".mat",), "Rows first", "H(t,s,y,x,z): for codes that use images as imread gives them."),
    Choice("include_transpose", (".mat",), "With Ht", "The back projection, ready made; doubles the file."),
    Choice("transposed", (".h5", ".npy", ".tif"), "HT in place of H", "The transposed matrix; lfcal needs no file."),
    Choice("here", (".tif",), "This position only", "A stack over depth of the position shown, in place of all."),
    Choice(
        "sixteen", (".h5",), "16-bit", "Rounded to 16 bits for each plane: a third of the bytes, at most 0.1 % error."
    ),
    Choice(
        "allow_missing",
        (".mat", ".npy", ".tif"),
        "Zeros for missing positions",
        "These files cannot mark a position that was never recorded; an H file can.",
    ),
    Choice("compress", (".mat", ".h5"), "Compressed", "Smaller; without it faster to read."),
)


@dataclass(frozen=True)
class ExportIntent:
    """What was asked for.

    Attributes
    ----------
    suffix
        Kind of file.
    position
        Position (y, x) shown.
    lens_centred, moved, rows_first, include_transpose, transposed, here, sixteen, allow_missing, compress
        See `CHOICES`.
    """

    suffix: str = ".mat"
    position: tuple[int, int] = (0, 0)
    lens_centred: bool = False
    moved: bool = False
    rows_first: bool = False
    include_transpose: bool = True
    transposed: bool = False
    here: bool = False
    sixteen: bool = False
    allow_missing: bool = False
    compress: bool = True

    def with_choice(self, name: str, on: bool) -> ExportIntent:
        """Return the intent with one choice made; patterns are moved only where the lens is centred."""
        choice: dict[str, Any] = {name: on}
        changed = replace(self, **choice)
        return replace(changed, lens_centred=True) if name == "moved" and on else _settled(changed)

    def choices(self) -> list[Choice]:
        """Return the choices that concern the kind of file."""
        return [choice for choice in CHOICES if self.suffix in choice.suffixes]

    @property
    def options(self) -> ExportOptions:
        """What the library is told: what differs from what it does by itself."""
        mat = self.suffix == ".mat"
        return ExportOptions(
            compress=False if not self.compress and self.suffix in (".mat", ".h5") else None,
            dtype="rounded" if self.suffix == ".h5" and self.sixteen else None,
            include_transpose=False if mat and not self.include_transpose else None,
            rows_first=True if mat and self.rows_first else None,
            lens_centred=True if mat and self.lens_centred else None,
            interpolation="cubic" if mat and self.moved else None,
            position=self.position if self.suffix == ".tif" and self.here else None,
            allow_missing=True if self.allow_missing and self.suffix != ".h5" else None,
        )

    def matrix(self, H: PSFMatrix) -> PSFMatrix:
        """Return what is written: H, or HT."""
        return H.T if self.transposed and self.suffix != ".mat" else H

    def open_to(self, H: PSFMatrix) -> set[str]:
        """Return the names of the choices that can be made for H: a lens is centred where it is known."""
        unknown = {"lens_centred", "moved"} if lens_centre_of(H) is None else set()
        complete = set() if len(empty_positions(H)) else {"allow_missing"}
        return {choice.name for choice in self.choices()} - unknown - complete

    def refusal(self, H: PSFMatrix) -> str:
        """Return why H cannot be written so, for missing positions that must be allowed; empty where it can."""
        try:
            check_missing(self.matrix(H), self.suffix, self.options)
        except InputError as error:
            return said_in_window(str(error))
        return ""

    def files(self, H: PSFMatrix, path: Path) -> list[Path]:
        """Return the files that an export to ``path`` writes."""
        return export_files(self.matrix(H), path, self.options.position)

    def notes(self, H: PSFMatrix) -> tuple[str, ...]:
        """Return what readers of the file should know, a line each; why it cannot be written comes first."""
        refusal, notes = self.refusal(H), export_notes(self.matrix(H), f"H{self.suffix}", self.options)
        return (refusal, *notes[1:]) if refusal else notes

    @classmethod
    def of_path(cls, path: str) -> ExportIntent:
        """Return what a file's name asks for by itself."""
        return cls(suffix=Path(path).suffix.lower())


@dataclass(frozen=True)
class ExportSettings(PageSettings):
    """How an H file is to be exported next, as the project says; whoever is asked then may change it.

    Attributes
    ----------
    suffix
        ``".h5"`` where the project says something, else empty.
    sixteen, compress
        As in `ExportIntent`.
    """

    page: ClassVar[str] = "psf"

    suffix: str = ""
    sixteen: bool = False
    compress: bool = True

    def on(self, intent: ExportIntent) -> ExportIntent:
        """Return an intent with these choices made; the same one where the project says nothing."""
        if self.suffix != ".h5":
            return intent
        return replace(intent, suffix=self.suffix, sixteen=self.sixteen, compress=self.compress)


def export_task(psf: str, out: str, intent: ExportIntent, mat_order: str = "") -> Task:
    """Return the task that exports the H of a file as it was asked for: of several regions the one that is shown."""
    from lfcal.psf import regions_of
    from lfcal.tasks import task_set

    shown, *others = regions_of(psf) if Path(psf).is_file() else ("",)
    chosen = intent.options
    given = {
        "source": psf,
        "out": out,
        "region": shown if others else "",
        "mat_order": mat_order,
        "transposed": intent.transposed and intent.suffix != ".mat",
        "no_ht": chosen.include_transpose is False,
        "rows_first": chosen.rows_first,
        "lens_centred": chosen.lens_centred,
        "interpolation": chosen.interpolation,
        "dtype": chosen.dtype,
        "uncompressed": chosen.compress is False,
        "position": chosen.position,
        "allow_missing": chosen.allow_missing,
    }
    return task_set("export").make({name: value for name, value in given.items() if value}, str)


def iter_exported(psf: str, intent: ExportIntent, path: str, mat_order: str = "") -> Work[Path]:
    """Write the H of a file as it was asked for; opened for itself, as the window may close its own meanwhile.

    Planes that are done stay where it is stopped; called again it continues from them.
    """
    from lfcal.tasks import RunSettings

    yield from export_task(psf, path, intent, mat_order).work(RunSettings(resume=True))
    return Path(path)


def _settled(intent: ExportIntent) -> ExportIntent:
    return intent if intent.lens_centred else replace(intent, moved=False)
