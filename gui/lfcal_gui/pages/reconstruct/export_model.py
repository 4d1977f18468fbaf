"""Settings of the export of H: a reconstruction code, or a file format with its options. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from lfcal.base import InputError, Work, any_of, format_bytes
from lfcal.psf import (
    CODES,
    PSFMatrix,
    check_missing,
    code_of,
    codes_for,
    empty_positions,
    export_files,
    export_notes,
    lens_centre_of,
    refused_by,
)
from lfcal.records import CODE_NAMES, rows
from lfcal.tasks import ExportH5, ExportMat, ExportNpy, ExportTiff
from lfcal_gui.models import Field, PageSettings, ProjectState, fields_of, said_in_window, shown_of, value_in

if TYPE_CHECKING:
    from lfcal.tasks import Task

KINDS = {
    ".mat": (ExportMat, "MATLAB v7.3, H and HT"),
    ".h5": (ExportH5, "H file, with all metadata"),
    ".npy": (ExportNpy, "NumPy array"),
    ".tif": (ExportTiff, "ImageJ hyperstack, to view"),
}
"""Export tasks by file suffix, with the purpose of each format."""

ELSEWHERE = ("source", "out", "region", "mat_order")
"""Fields of the tasks that no form shows: the H, its axis order and the output file."""

OPTIONS: dict[str, Field] = {
    field.key: field for task, _ in KINDS.values() for field in fields_of(task, without=ELSEWHERE)
}
"""All options of these tasks, by name."""

OF_LENS = ("lens_centred", "interpolation")


class ExportFacts(NamedTuple):
    """Size, order of the axes and quality, each as a value and a remark."""

    size: tuple[str, str]
    order: tuple[str, str]
    quality: tuple[str, str]


@dataclass(frozen=True)
class ExportSettings(PageSettings):
    """Settings of the export in the project.

    Attributes
    ----------
    code
        One of `CODE_NAMES`; empty: the first that can use H.
    suffix
        Other file format, one of `KINDS`.
    no_ht, rows_first, lens_centred, interpolation, uncompressed, allow_missing, transposed, dtype, position
        As in the tasks of `KINDS`.
    """

    page: ClassVar[str] = "export"

    code: str = ""
    suffix: str = ".mat"
    no_ht: bool = False
    rows_first: bool = False
    lens_centred: bool = False
    interpolation: str = ""
    uncompressed: bool = False
    allow_missing: bool = False
    transposed: bool = False
    dtype: str = ""
    position: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check every value."""
        if self.code not in ("", *CODE_NAMES):
            code_of(self.code)
        if self.suffix not in KINDS:
            raise InputError.expected("file format", any_of(KINDS), repr(self.suffix), "choose one of these")
        for name in ("interpolation", "dtype"):
            allowed = dict(OPTIONS[name].choices)
            if getattr(self, name) not in allowed:
                raise InputError.expected(name, any_of(map(str, allowed)), getattr(self, name), "choose one of these")
        if len(self.position) not in (0, 2):
            raise InputError.expected("position", "y,x", self.position, "enter two whole numbers: 2,1")

    @classmethod
    def of_path(cls, path: str) -> Self:
        """Return the settings for a file name."""
        return cls(suffix=Path(path).suffix.lower())

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one value changed.

        Choosing an interpolation also centres a lens; switching the centring off clears the interpolation.
        """
        if key == "position":
            value = value_in(ExportTiff, key, value) or ()
        changes: dict[str, Any] = {key: value}
        if key == "interpolation" and value:
            changes["lens_centred"] = True
        if key == "lens_centred" and not value:
            changes["interpolation"] = ""
        return replace(self, **changes)

    @property
    def names(self) -> tuple[str, ...]:
        """Options of the chosen file format."""
        return tuple(row.name for row in rows(KINDS[self.suffix][0]) if row.name not in ELSEWHERE)

    def shown(self) -> dict[str, Any]:
        """Return the values shown in a form of `OPTIONS`."""
        values = {one.name: getattr(self, one.name) for one in fields(self) if one.name in OPTIONS}
        values["position"] = self.position or None
        return {
            key: value for task, _ in KINDS.values() for key, value in shown_of(task, values).items() if key in values
        }

    def open_to(self, H: PSFMatrix) -> set[str]:
        """Return the options that can be chosen for H; a lens can be centred only if its centre is known."""
        unknown = set(OF_LENS) if lens_centre_of(H) is None else set()
        complete = set() if len(empty_positions(H)) else {"allow_missing"}
        return set(self.names) - unknown - complete

    def task(self, psf: str, out: str, mat_order: str = "", code: str = "", quality: str = "") -> Task:
        """Return the task that exports the H of a file; of several regions, the one that is shown.

        Parameters
        ----------
        psf, out, mat_order
            H, the file to write, and the order of axes that was stated for H.
        code, quality
            Code for which the file is written, and a word for the quality of H. An empty code: as the options say.
        """
        from lfcal.psf import regions_of
        from lfcal.tasks import task_set

        shown, *others = regions_of(psf) if psf and Path(psf).is_file() else ("",)
        given: Mapping[str, Any] = {name: getattr(self, name) for name in self.names}
        if code:
            given = {"code": code, "quality": quality, "allow_missing": self.allow_missing}
        where = {"source": psf or "H.h5", "out": out, "region": shown if others else "", "mat_order": mat_order}
        known, tasks = {name: value for name, value in {**where, **given}.items() if value}, task_set("export")
        labels = {row.name: row.label for kind in tasks.kinds for row in rows(kind)}
        return tasks.make(known, labels.__getitem__)

    def suffix_for(self, code: str) -> str:
        """Return the file suffix for a code; without a code, that of the chosen format."""
        return CODES[code].suffix if code else self.suffix

    def refusal(self, H: PSFMatrix, code: str = "") -> str:
        """Return why H cannot be written with these settings; empty if it can."""
        problem = refused_by(CODES[code], H) if code else None
        if problem is None:
            task: Any = self.task("", f"H{self.suffix_for(code)}", code=code)
            try:
                check_missing(task.exported(H), self.suffix_for(code), task.options())
            except InputError as error:
                problem = error
        return "" if problem is None else said_in_window(str(problem))

    def notes(self, H: PSFMatrix, code: str = "") -> tuple[str, ...]:
        """Return remarks for users of the file, one line each; a reason why it cannot be written is first."""
        refusal = self.refusal(H, code)
        if code and refusal:
            return (refusal,)
        task: Any = self.task("", f"H{self.suffix_for(code)}", code=code)
        notes = export_notes(task.exported(H), task.out, task.options())
        return (refusal, *notes[1:]) if refusal else notes

    def files(self, H: PSFMatrix, path: Path, code: str = "") -> list[Path]:
        """Return the files that an export to ``path`` writes."""
        task: Any = self.task("", str(path), code=code)
        return export_files(task.exported(H), path, task.options().position)

    def offered(self, H: PSFMatrix) -> tuple[Self, str]:
        """Return the export of H that is offered first, as settings and code: as chosen, else a plain file."""
        code = self.code_for(H)
        if not self.refusal(H, code):
            return self, code
        plain = (self, *(replace(self, suffix=suffix) for suffix in KINDS))
        return next(one for one in plain if not one.refusal(H)), ""

    def title(self, code: str) -> str:
        """Return the name of an export for its button."""
        return f"Export for {CODES[code].title}" if code else f"Export as {self.suffix}"

    def holds_ht(self, code: str) -> bool:
        """Return whether the file also contains HT."""
        return CODES[code].one_lens if code else self.suffix == ".mat" and not self.no_ht

    def nbytes(self, H: PSFMatrix, code: str) -> int:
        """Return the size of the exported values without compression, in bytes."""
        return H.nbytes * (2 if self.holds_ht(code) else 1)

    def code_for(self, H: PSFMatrix) -> str:
        """Return the chosen code, else the first one that can use H, else the first one."""
        usable = codes_for(H)
        return self.code or (usable[0].name if usable else CODE_NAMES[0])


def next_facts(project: ProjectState, H: PSFMatrix) -> dict[str, Any]:
    """Return fields of `lfcal_gui.models.Sitting` on the export of H."""
    settings, code = ExportSettings.of(project).offered(H)
    return {
        "export_title": settings.title(code),
        "export_ht": settings.holds_ht(code),
        "export_bytes": float(settings.nbytes(H, code)),
    }


def facts_of(H: PSFMatrix, code: str, quality: str) -> ExportFacts:
    """Return size, axis order and quality of the file for a code."""
    reader = CODES[code]
    return ExportFacts(
        (format_bytes(ExportSettings().nbytes(H, code)), "uncompressed"),
        (reader.order, f"as {reader.title} reads"),
        (quality or "not judged", "stored in the file" if quality else ""),
    )


def iter_exported(task: Task, path: str) -> Work[Path]:
    """Export H with the task, which opens the file of H again because the window may close it in the meantime.

    An export of planes continues after the completed ones; an export for a code starts again.
    """
    from lfcal.tasks import RunSettings

    yield from task.work(RunSettings(resume=True))
    return Path(path)
