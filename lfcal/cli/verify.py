"""``lfcal verify``: check that a session or an H file has not changed since it was written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from lfcal.base import FileFormatError, InputError, StorageError, Work, format_count, plain
from lfcal.cli._console import print_json, run_work, show_judgement
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption
from lfcal.tasks import check_output


def command(
    path: Path = typer.Argument(help="Folder of a recorded session, or H file (.h5)."),
    *,
    redo: Path | None = typer.Option(
        None, "--redo", help="File for the list of damaged positions of a session, for `lfcal acquire --redo`."
    ),
    force: ForceOption = False,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Compare every frame of a session, or every plane of an H file, with its checksum, and check the file format.

    Exit code 0: everything is intact; 1: something is damaged; 2: it cannot be checked.

    Example: `lfcal verify session/ --redo redo.json`
    """
    from lfcal.campaign import is_regions, region_sessions

    if not path.exists():
        raise StorageError(f"{path}: no such file or folder; check the path")
    if redo is not None:
        check_output(redo, path, force=force)
    if is_regions(path):
        if redo is not None:
            raise InputError("--redo: applies to a session of one region; verify the folder of each region")
        checks = [_is_whole(folder, None, workers, json) for _, folder in region_sessions(path)]  # all are shown
        whole = all(checks)
    else:
        whole = _is_whole(path, redo, workers, json)
    if not whole:
        raise typer.Exit(1)


def _is_whole(path: Path, redo: Path | None, workers: int | None, json: bool) -> bool:
    """Check a session or an H file, print the result, and return whether it is intact."""
    from lfcal.acquire import RedoList, iter_verify
    from lfcal.judge import judgement_of
    from lfcal.psf import iter_verify as iter_verify_matrix

    if not path.is_dir():
        if redo is not None:
            raise InputError.expected("--redo", "a session folder", path, "leave --redo out")
        if path.name == "recording.h5" or path.name.startswith("recording-"):
            raise FileFormatError.expected(str(path), "a session folder or an H file", "a recording", "give its folder")
    work: Work[Any] = (iter_verify if path.is_dir() else iter_verify_matrix)(path, workers=workers)
    report = run_work(work, quiet=json)
    judgement, again = judgement_of(report), report.to_redo if path.is_dir() else ()
    if redo is not None and again:
        RedoList.of(again, ["damaged"] * len(again)).write(redo)
    if json:
        listed = {"to_redo": again} if path.is_dir() else {}
        print_json(plain(report) | {"ok": report.ok} | listed | judgement.to_dict())
        return bool(report.ok)
    show_judgement(judgement, str(report.path))
    for line in report.lines():
        typer.echo(f"  {line}")
    if redo is not None:
        count = format_count(len(again), "position", "positions")
        typer.echo(
            f"  {redo}: {count} to record again"
            if again
            else (f"  {redo}: not written, because there are no positions to record again")
        )
    return bool(report.ok)
