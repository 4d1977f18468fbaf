"""Open H for tasks, and report facts about it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, any_of, note
from lfcal.records import opt, record, required
from lfcal.tasks.task import Task

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

__all__ = [
    "CopyTask",
    "MatrixTask",
    "check_mat_files",
    "mat_order_field",
    "note_opened",
    "open_matrix",
    "report_dark",
    "report_missing",
    "with_task",
]

EARLIER = "earlier_tasks"
"""Provenance key for the earlier tasks, which made the inputs of the last one, earliest first."""


def mat_order_field(**more: Any) -> str:
    """Declare the field ``mat_order`` of a task that reads H; ``more`` are further arguments of `lfcal.records.opt`."""
    return opt(
        "",
        "Order of the axes of H in a .mat file that does not state the order. rows-first: H(t,s,y,x,z). "
        "columns-first: H(s,t,x,y,z).",
        label="Axis order of a .mat file",
        choices=("rows-first", "columns-first"),
        empty="inferred from its variables",
        more=True,
        **more,
    )


@record
class MatrixTask(Task):
    """Base class of tasks that read one H."""

    source: Path = required(
        "H file (.h5), file of another code (.mat v7.3, .lfc of napari-LF, .tif stack), or .npy array.",
        label="H",
        argument=True,
        file="in",
    )
    mat_order: str = mat_order_field(needs=("", ".mat"))

    def opened(self) -> PSFMatrix:
        """Open H, and report how a file written by other software was read."""
        return open_matrix(self.source, mat_order=self.mat_order)


@record
class CopyTask(MatrixTask):
    """Base class of tasks that rewrite one H in another form."""

    region: str = opt(
        "", "Name of the region of the field, for an H file with several regions.", empty="the only region", more=True
    )

    def opened(self, *, quiet: bool = False) -> PSFMatrix:
        """Open H of the chosen region; raise `InputError` if the file has several regions and none is chosen.

        With ``quiet``, the way in which the file was read is not reported.
        """
        from lfcal.psf import regions_of

        if not self.region and len(names := regions_of(self.source)) > 1:
            raise InputError.expected(f"{self.source.name}, region", any_of(names), "none", "choose one (--region)")
        return open_matrix(self.source, region=self.region, mat_order=self.mat_order, quiet=quiet)


def with_task(task: Task, *matrices: PSFMatrix) -> dict[str, Any]:
    """Return the provenance of the output of ``task``: the task, and all earlier tasks that led to ``matrices``.

    The paths of the output of ``task`` are left out. The tasks of each matrix are in the order in which they were run.
    """
    earlier: list[Any] = []
    for matrix in matrices:
        known = matrix.provenance
        listed = known.get(EARLIER)
        earlier += listed if isinstance(listed, list) else []
        earlier += [known["task"]] if "task" in known else []
    found: dict[str, Any] = {"task": task.to_dict(absolute=True, outputs=False)}
    return found | ({EARLIER: earlier} if earlier else {})


def open_matrix(path: Path, *, region: str = "", mat_order: str = "", quiet: bool = False) -> PSFMatrix:
    """Open an H file, and report how a file written by other software was read.

    Parameters
    ----------
    path, region
        As in `lfcal.psf.open_psf`.
    mat_order
        As in `lfcal.psf.open_psf`, but ignored unless the file is a ``.mat`` file, because a command passes it for all
        of its files; see `check_mat_files`.
    quiet
        Whether to report nothing, as in worker processes, because the command has already reported it.
    """
    from lfcal.psf import open_psf

    matrix = open_psf(path, region=region, mat_order=mat_order if _is_mat(path) else "")
    if not quiet:
        note_opened(matrix)
    return matrix


def note_opened(matrix: PSFMatrix) -> None:
    """Report how the file of H was read, if other software wrote it."""
    from lfcal.psf import opening_notes

    for one in opening_notes(matrix):
        note(f"{Path(matrix.path).name}: {one}")


def report_missing(matrix: PSFMatrix) -> int:
    """Return the number of positions of H that were neither recorded nor filled, and report it if it is not 0."""
    from lfcal.psf import empty_positions, empty_words

    if words := empty_words(matrix):
        note(f"{words}; their entries are zero; fill them from a fit (lfcal assemble --fill)")
    return len(empty_positions(matrix))


def report_dark(matrix: PSFMatrix) -> tuple[int, ...]:
    """Return the indices of the planes of ``matrix`` without light, and report them if there are any."""
    from lfcal.psf import dark_planes

    dark = dark_planes(matrix)
    if dark:
        named = ", ".join(str(z) for z in dark[:8]) + (" …" if len(dark) > 8 else "")
        note(f"no light in {len(dark)} of {len(matrix)} planes ({named}): their entries are zero or negative")
    return dark


def check_mat_files(mat_order: str, *paths: Path | None) -> None:
    """Raise `InputError` if ``mat_order`` is unknown, or is given although none of the files is a ``.mat`` file."""
    from lfcal.psf import check_mat_order

    check_mat_order(mat_order)
    given = [path for path in paths if path is not None]
    if mat_order and not any(_is_mat(path) for path in given):
        names = ", ".join(path.name for path in given)
        raise InputError.expected("order of the axes", "a .mat file", names, "leave the order out (--mat-order)")


def _is_mat(path: Path) -> bool:
    return path.suffix.lower() == ".mat"
