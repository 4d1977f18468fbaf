"""H files that tasks are given, with notes on the file for the user."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.tasks.notes import note

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

__all__ = ["check_mat_files", "open_matrix", "report_missing", "report_regions"]


def open_matrix(path: Path, *, region: str = "", mat_order: str = "", quiet: bool = False) -> PSFMatrix:
    """Open an H file, and say how a file of another code was read.

    Parameters
    ----------
    path, region
        As in `lfcal.psf.open_psf`.
    mat_order
        As there, but for ``.mat`` files alone: a command with several files gives it for all; see `check_mat_files`.
    quiet
        Say nothing: in a worker, where the task has said it.
    """
    from lfcal.psf import open_psf, opening_notes

    matrix = open_psf(path, region=region, mat_order=mat_order if _is_mat(path) else "")
    for one in () if quiet else opening_notes(matrix):
        note(f"{path.name}: {one}")
    return matrix


def report_regions(path: Path, matrix: PSFMatrix, done: str) -> None:
    """Say that of an H file with several regions of the field one alone is ``done`` (used, written)."""
    from lfcal.psf import regions_of

    if len(names := regions_of(path)) > 1:
        note(f"of {len(names)} regions of the field {matrix.region or 'the first'} alone is {done}")


def report_missing(matrix: PSFMatrix) -> int:
    """Return how many positions of H were neither recorded nor filled, and say so where there are any."""
    from lfcal.psf import empty_positions, empty_words

    if words := empty_words(matrix):
        note(f"{words}: their entries are zero; lfcal assemble --fill fills them from a fit")
    return len(empty_positions(matrix))


def check_mat_files(mat_order: str, *paths: Path | None) -> None:
    """Raise `InputError` where ``--mat-order`` is unknown, or none of the files is a ``.mat`` file."""
    from lfcal.base import InputError
    from lfcal.psf import check_mat_order

    check_mat_order(mat_order)
    given = [path for path in paths if path is not None]
    if mat_order and not any(_is_mat(path) for path in given):
        names = ", ".join(path.name for path in given)
        raise InputError.expected("--mat-order", "a .mat file", names, "leave it out")


def _is_mat(path: Path) -> bool:
    return path.suffix.lower() == ".mat"
