"""Commands generated from tasks: an option for each field, a panel for each nested record, and refusals."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import MISSING
from pathlib import Path
from typing import Any, TypeVar

import typer

from lfcal.base import InputError, LfcalError, Work, bounded_threads
from lfcal.cli._console import KEPT, print_json, report, run_work
from lfcal.cli._docstrings import docstring
from lfcal.records import FieldRow, from_flat, rows, value_at
from lfcal.tasks import RunSettings, Task, TaskSet

__all__ = ["add_task", "do_task"]

R = TypeVar("R")

Show = Callable[[Any], object]
"""Function that prints the result of a task."""

RUN = "Execution"


def add_task(app: typer.Typer, tasks: TaskSet, show: Show, cls: Any = None) -> None:
    """Add the command of a task to the app; ``show`` prints the result, and ``cls`` is a class with subcommands."""
    name = tasks.name.split()[-1]
    # for a field that several kinds have, the first kind gives the help
    own = {row.name: row for kind in reversed(tasks.kinds) for row in rows(kind)}
    run = {row.name: row for row in rows(RunSettings) if any(kind.takes(row.name) for kind in tasks.kinds)}

    def command(json: bool, **values: Any) -> None:
        given = {key: value for key, value in values.items() if value is not None and value != []}
        found = {key: own[key].value(value, own[key].called) for key, value in given.items() if key in own}
        choice = from_flat(
            RunSettings, {key: run[key].value(value, run[key].flag) for key, value in given.items() if key in run}
        )
        do_task(tasks.make(found, lambda key: own[key].called), choice, show, json)

    ordered = sorted(own.values(), key=lambda row: row.opt.more)
    panels = list(dict.fromkeys(row.panel for row in own.values()))
    ordered.sort(key=lambda row: (not row.opt.argument, panels.index(row.panel)))
    parameters = [_parameter(row, row.panel or "Options", _only(tasks, row)) for row in ordered]
    parameters += [_parameter(row, RUN) for row in run.values()]
    option = typer.Option(False, "--json", help="Print the result as JSON.", rich_help_panel=RUN)
    parameters.append(inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=option, annotation=bool))
    command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    app.command(name, cls=cls, help=_help(tasks, cls))(command)


def do_task(task: Task, run: RunSettings, show: Show, json: bool) -> None:
    """Check the outputs of a task, run it with a progress bar, and show the result."""
    from lfcal.tasks import check_outputs, may_replace

    refused = next((row for row in rows(RunSettings) if value_at(run, row) and not task.takes(row.name)), None)
    if refused is not None:
        raise InputError.expected(
            refused.flag, "work that is done in units", task.input_words, f"leave {refused.flag} out"
        )
    begun = task.unit_outputs()
    force = run.force or (bool(begun) and all(may_replace(out, run) for out in begun))
    check_outputs(task.files("out"), *task.files("in"), force=force)
    with bounded_threads(run.workers):
        made = _run_kept(task.work(run), *begun, quiet=json)
    with ExitStack() as stack:
        for one in made:
            stack.callback(one.close)
        if json:
            print_json(made[0].to_dict() if len(made) == 1 else [one.to_dict() for one in made])
        else:
            show(made)
    if code := max((one.exit_code() for one in made), default=0):
        raise typer.Exit(code)


def _run_kept(work: Work[R], *outs: Path, quiet: bool) -> R:
    """Run work in units with a progress bar; if it ends early, report the stored units, or remove an empty folder."""
    try:
        return run_work(work, quiet=quiet)
    except BaseException as error:
        with suppress(LfcalError):  # it may have ended before the journal began
            for out in outs:
                _say_kept(error, out)
        raise


def _say_kept(error: BaseException, out: Path) -> None:
    """Report the stored units of work that ``error`` ended; remove the folder of a run without any."""
    from lfcal.work import PASS, discard, parts_folder, read_events, read_run, unit_files

    folder = parts_folder(out)
    state = read_run(folder)
    if state.running:  # another program is working in the folder
        return
    kept = len(unit_files(folder))
    if not kept and PASS not in read_events(folder):  # a complete pass has been written to ``out``
        discard(folder)
        return
    report(f"kept: {kept} of {len(state.units)} units in {folder}; --resume continues with them")
    error.add_note(KEPT)


def _help(tasks: TaskSet, cls: Any) -> str:
    said = inspect.cleandoc(tasks.help) or re.split(r"\n(?:Attributes|Examples)\n-", docstring(tasks.kinds[0]))[0]
    for part in cls.parts.listed.values() if cls else ():
        said += f"\n\n`lfcal {tasks.name} {part.name}`: {part.summary}"
    return f"{said}\n\nExample: `{tasks.example}`"


def _only(tasks: TaskSet, row: FieldRow) -> str:
    """Return the kinds of input, or of a nested record, to which a field applies; empty if it applies to all."""
    if row.only and row.variants is not None:
        every = [row.variants.name_of(kind) for kind in row.variants.kinds]
        return _except([name for name in every if name in row.only], [name for name in every if name not in row.only])
    if row.opt.chooses:
        return ""
    having = [kind for kind in tasks.kinds if row.name in {one.name for one in rows(kind)}]
    lacking = [kind for kind in tasks.kinds if kind not in having]
    return _except([kind.input_words for kind in having], [kind.input_words for kind in lacking])


def _except(having: list[str], lacking: list[str]) -> str:
    if not lacking:
        return ""
    word, names = ("Not for", lacking) if len(lacking) < len(having) else ("Only for", having)
    return f" {word} {' and '.join(names)}."


def _parameter(row: FieldRow, heading: str, only: str = "") -> inspect.Parameter:
    opt, kind = row.opt, inspect.Parameter.KEYWORD_ONLY
    how: dict[str, Any] = {"help": row.option_help + only, "rich_help_panel": heading, "show_default": False}
    if opt.examples or opt.choices:
        how["autocompletion"] = _completing(row)
    if row.kind is bool:
        said = {key: how[key] for key in ("help", "rich_help_panel")}
        default: Any = typer.Option(None, f"{row.flag}/{row.off}".strip("/"), **said)
        if row.turns_off:
            default.callback = lambda value: None if value is None else not value
        return inspect.Parameter(row.name, kind, default=default, annotation=bool | None)
    annotation: Any = list[str] if row.many else str
    # the kind itself checks fields that only some kinds require
    needed = row.default is MISSING and not only and not opt.chooses
    start = ... if needed else None
    if not needed:
        annotation = annotation | None
    if opt.argument:
        how["metavar"] = row.called
        how["rich_help_panel"] = "Input"
        return inspect.Parameter(row.name, kind, default=typer.Argument(start, **how), annotation=annotation)
    how["metavar"] = _metavar(row)
    names = (row.flag, *((opt.short,) if opt.short else ()))
    return inspect.Parameter(row.name, kind, default=typer.Option(start, *names, **how), annotation=annotation)


METAVARS = {int: "N", float: "NUMBER", str: "TEXT"}


def _metavar(row: FieldRow) -> str:
    if row.opt.show or (row.many and row.opt.read):
        return "TEXT"
    return (row.opt.file and "PATH") or ("NAME" if row.opt.choices else METAVARS.get(row.kind, "TEXT"))


def _completing(row: FieldRow) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        return [name for name in row.offered if name.startswith(incomplete)]

    return complete
