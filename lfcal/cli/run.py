"""``lfcal run``: run a job file, or make an H or a volume again from its provenance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption


def command(
    job: Path = typer.Argument(help="Job file (.toml, .json), or an H or volume file (.h5) to make again."),
    *,
    out: Path | None = typer.Option(
        None,
        "--out",
        "-o",
        help="File to write instead of the one that the job names; required if JOB is an H or volume file.",
    ),
    workers: WorkersOption = None,
    resume: bool = typer.Option(False, "--resume", help="Continue an earlier run that was stopped or killed."),
    force: ForceOption = False,
    show: bool = typer.Option(False, "--show", help="Print the input files and the command of the job; do not run it."),
    json: JsonOption = False,
) -> None:
    """Run the task in a job file, or the task that made an H or volume file.

    Example: `lfcal run job.toml -o H.h5`
    """
    from importlib import import_module

    from lfcal.cli._task_command import do_task
    from lfcal.tasks import command_of, load_job

    made = job.suffix.lower() in (".h5", ".hdf5")
    if made and out is None and not show:
        raise InputError.expected(
            "--out", "a file to write", "none", "give one, because the file that is used as the job cannot be replaced"
        )
    named = "again.h5" if made and out is None else out
    task, given = load_job(job, {} if named is None else {"out": str(named if show else Path(named).absolute())})
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
    run = replace(given, workers=workers or given.workers, resume=resume or given.resume, force=force or given.force)
    shown: Any = import_module(f"lfcal.cli.{task.name.replace(' ', '_')}").show
    do_task(task, run, shown, json)
