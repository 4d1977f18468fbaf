"""``lfcal run``: do what a job file says, or make an H or a volume again as it was made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption


def command(
    job: Path = typer.Argument(help="Job file (.toml, .json), or an H or volume file (.h5), which is made again."),
    *,
    out: Path | None = typer.Option(None, "--out", "-o", help="File to write instead of the one that the job names."),
    workers: WorkersOption = None,
    resume: bool = typer.Option(
        False, "--resume", help="Continue what an earlier run left after it was stopped or killed."
    ),
    force: ForceOption = False,
    show: bool = typer.Option(False, "--show", help="Only print the job, the files that it reads, and its command."),
    json: JsonOption = False,
) -> None:
    """Do what a job file says: any task, with the fields of its form and command.

    Example: `lfcal run job.toml -o H.h5`
    """
    from importlib import import_module

    from lfcal.cli._task_command import do_task
    from lfcal.tasks import command_of, load_job

    made = job.suffix.lower() in (".h5", ".hdf5")
    if made and out is None and not show:
        raise InputError.expected("--out", "a file to write", "none", "name one: an H is never replaced by itself")
    named = "again.h5" if made and out is None else out
    task, told = load_job(job, {} if named is None else {"out": str(named if show else Path(named).absolute())})
    reads = [str(path) for path in task.files("in")]
    if show:
        if json:
            print_json({"job": task.to_dict(), "reads": reads, "command": command_of(task)})
            return
        typer.echo(f"reads: {', '.join(reads) or 'no file'}")
        typer.echo(command_of(task))
        return
    if not json:
        typer.echo(f"reads: {', '.join(reads) or 'no file'}", err=True)
    run = replace(told, workers=workers or told.workers, resume=resume or told.resume, force=force or told.force)
    shown: Any = import_module(f"lfcal.cli.{task.name.replace(' ', '_')}").show
    do_task(task, run, shown, json)
