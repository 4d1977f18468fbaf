"""``lfcal verify``: whether a session or an H file still is what was written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError, StorageError, format_count
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption
from lfcal.tasks import check_output

if TYPE_CHECKING:
    from lfcal.acquire import SessionReport
    from lfcal.psf import MatrixCheck

LISTED = 20
"""Damaged frames that are listed; all of them are in the JSON output."""


def register(app: typer.Typer) -> None:
    """Add ``verify`` to the app."""
    app.command("verify")(command)


def command(
    path: Path = typer.Argument(help="Folder of a recorded session, or H file (.h5)."),
    *,
    redo: Path | None = typer.Option(
        None, "--redo", help="Write the damaged positions of a session into this list, for lfcal acquire --redo."
    ),
    force: ForceOption = False,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Check every frame of a session, or every plane of an H file, against its checksum; an H file's format, too.

    Exit code 0: all is what was written; 1: something is damaged; 2: it cannot be checked.

    Example: `lfcal verify session/ --redo redo.json`
    """
    from lfcal.campaign import is_regions, region_sessions

    if not path.exists():
        raise StorageError(f"{path}: no such file or folder; check the path")
    if redo is not None:
        check_output(redo, path, force=force)
    if is_regions(path):
        if redo is not None:
            raise InputError("--redo: is of one region; verify its folder below this one")
        checks = [_session(folder, None, workers, json) for _, folder in region_sessions(path)]
        if not all(checks):
            raise typer.Exit(1)
        return
    whole = _session(path, redo, workers, json) if path.is_dir() else _matrix(path, redo, workers, json)
    if not whole:
        raise typer.Exit(1)


def _session(path: Path, redo: Path | None, workers: int | None, json: bool) -> bool:
    from lfcal.acquire import RedoList, iter_verify
    from lfcal.base import plain
    from lfcal.cli._console import print_json, run_work
    from lfcal.judge import judgement_of

    report = run_work(iter_verify(path, workers=workers), quiet=json)
    if redo is not None and report.to_redo:
        RedoList.of(report.to_redo, ["damaged"] * len(report.to_redo)).write(redo)
    if json:
        told = {"ok": report.ok, "to_redo": report.to_redo}
        print_json(plain(report) | told | judgement_of(report).to_dict())
    else:
        _show_session(report, redo)
    return report.ok


def session_lines(report: SessionReport) -> Iterator[str]:
    """Yield every frame of a session that is damaged, in words."""
    for found in report.damaged[:LISTED]:
        where = f"{found.kind} (z, y, x) = {tuple(found.position)}"
        said = f"{found.what}; recorded again since" if found.replaced else found.what
        yield f"  {where}, {found.file}[{found.slot}]: {said}"
    if len(report.damaged) > LISTED:
        yield f"  and {len(report.damaged) - LISTED} more; --json lists all"


def _show_session(report: SessionReport, redo: Path | None) -> None:
    from lfcal.cli._findings import show_judgement
    from lfcal.judge import judgement_of

    show_judgement(judgement_of(report), str(report.path))
    for line in session_lines(report):
        typer.echo(line)
    if redo is not None:
        count = format_count(len(report.to_redo), "position", "positions")
        typer.echo(f"  {redo}: {count} to record again" if report.to_redo else f"  {redo}: not written, no position")


def _matrix(path: Path, redo: Path | None, workers: int | None, json: bool) -> bool:
    from lfcal.base import FileFormatError, plain
    from lfcal.cli._console import print_json, run_work
    from lfcal.judge import judgement_of
    from lfcal.psf import iter_verify

    if redo is not None:
        raise InputError.expected("--redo", "a session folder to list positions of", path, "leave it out")
    if path.name == "recording.h5" or path.name.startswith("recording-"):
        raise FileFormatError.expected(str(path), "a session folder or an H file", "a recording", "name its folder")
    check = run_work(iter_verify(path, workers=workers), quiet=json)
    if json:
        result: dict[str, Any] = plain(check)
        print_json(result | {"ok": check.ok} | judgement_of(check).to_dict())
    else:
        _show_matrix(check)
    return check.ok


def matrix_lines(check: MatrixCheck) -> Iterator[str]:
    """Yield every plane of an H file that is damaged, and where the file is not as its format says, in words."""
    for found in check.damaged:
        name = f"{found.region}, plane {found.z}" if found.region else f"plane {found.z}"
        listed = ", ".join(str(tuple(p)) for p in found.positions[:LISTED])
        more = f" and {len(found.positions) - LISTED} more" if len(found.positions) > LISTED else ""
        yield f"  {name}: {found.what}" + (f" at (z, y, x) = {listed}{more}" if listed else "")
    for line in check.deviations:
        yield f"  not as the format says: {line}"


def _show_matrix(check: MatrixCheck) -> None:
    from lfcal.cli._findings import show_judgement
    from lfcal.judge import judgement_of

    show_judgement(judgement_of(check), str(check.path))
    for line in matrix_lines(check):
        typer.echo(line)
