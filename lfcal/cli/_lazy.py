"""Commands that are imported when they are called: listing them loads none of their libraries."""

from __future__ import annotations

import importlib
import pkgutil
import shutil
import sys
import textwrap
from collections import UserDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from types import CodeType
from typing import Any

import typer.core
import typer.main

from lfcal.cli._docstrings import WITHOUT_DOCSTRINGS, docstring

__all__ = [
    "CommandWithParts",
    "LazyCommands",
    "LazyGroup",
    "Listed",
    "add_command",
    "command_with_parts",
    "listed_commands",
]

MARKS = ("register", "command", "show")
"""Names of functions that make a module a command; see `add_command`."""


@dataclass(frozen=True)
class Listed:
    """Entry in the list of commands: name, module that defines the command, and summary."""

    name: str
    module: str
    summary: str


def listed_commands(package: str, order: tuple[str, ...] = ()) -> tuple[Listed, ...]:
    """Return the commands of a package, in ``order`` and then by name, without importing their modules.

    A public module that defines one of `MARKS` is a command of the same name, with hyphens for underscores. Modules
    ``camera_*`` are subcommands of ``camera``, which registers them. The summary is the first paragraph of the
    docstring of ``command``; without one, it is the part of the module's first line after the colon.
    """
    names = [name for name in _modules(package) if not name.startswith("_")]
    called = {name: name.replace("_", "-") for name in names if not {name.partition("_")[0]} & {*names} - {name}}
    ranks = {name: rank for rank, name in enumerate(order)}
    # a stable sort: commands that the order does not name follow, sorted by name
    return _listed(package, {name: called[name] for name in sorted(called, key=lambda n: ranks.get(called[n], 99))})


def command_with_parts(package: str, name: str) -> type[CommandWithParts] | None:
    """Return the class of a command ``name`` if modules ``name_*`` define subcommands of it; None otherwise.

    For example, ``lfcal fit SOURCE`` is a command, and ``lfcal fit check`` is a subcommand that is imported when it is
    called.
    """
    modules = [module for module in _modules(package) if module.startswith(f"{name}_")]
    called = {module: module.removeprefix(f"{name}_").replace("_", "-") for module in modules}
    if not called:
        return None
    return type(CommandWithParts.__name__, (CommandWithParts,), {"parts": LazyCommands(_listed(package, called))})


def _modules(package: str) -> list[str]:
    return sorted(m.name for m in pkgutil.iter_modules(importlib.import_module(package).__path__))


def _listed(package: str, called: dict[str, str]) -> tuple[Listed, ...]:
    """Return the commands of modules by name, in order."""
    found = ((name, _code_of(f"{package}.{name}")) for name in called)
    return tuple(
        Listed(called[name], f"{package}.{name}", _summary(code))
        for name, code in found
        if code is not None and not set(MARKS).isdisjoint(code.co_names)
    )


def _code_of(module: str) -> CodeType | None:
    """Return the compiled code of a module from its loader's cache; a frozen program has no source."""
    spec = find_spec(module)
    loader: Any = spec.loader if spec else None
    if sys.flags.optimize >= WITHOUT_DOCSTRINGS and hasattr(loader, "get_source"):
        found: CodeType = compile(loader.get_source(module), module, "exec", dont_inherit=True, optimize=0)
        return found
    code: CodeType | None = loader.get_code(module) if hasattr(loader, "get_code") else None
    return code


def _summary(code: CodeType) -> str:
    functions = {c.co_name: c for c in code.co_consts if isinstance(c, CodeType)}
    if "command" in functions:
        return " ".join(_first_constant(functions["command"]).split("\n\n")[0].split())
    said = _first_constant(code).split("\n")[0].partition(": ")[2]
    return said[:1].upper() + said[1:]


def _first_constant(code: CodeType) -> str:
    """Return the docstring of a module or function."""
    first = code.co_consts[0] if code.co_consts else ""
    return first if isinstance(first, str) else ""


class LazyCommands(UserDict[str, Any]):
    """Commands by name, each imported when it is looked up."""

    def __init__(self, listed: tuple[Listed, ...]) -> None:
        self.listed = {one.name: one for one in listed}
        super().__init__(self.listed)

    def __getitem__(self, name: str) -> Any:
        """Return a command; its module is imported, and its signature read."""
        if isinstance(self.data[name], Listed):
            self.data[name] = _load(self.data[name])
        return self.data[name]


def _load(listed: Listed) -> Any:
    app = typer.Typer(add_completion=False, rich_markup_mode="markdown")
    # with a callback it stays a group whose command keeps its own name
    app.callback()(lambda: None)
    add_command(app, listed.module, listed.name)
    group: Any = typer.main.get_command(app)
    return group.commands[listed.name]


def add_command(app: typer.Typer, module: str, name: str) -> None:
    """Add the command of a module to the app under ``name``.

    The module defines one of three functions. ``register`` adds the command itself. ``command`` does the work.
    ``show`` prints the result of the task with the module's name, with a blank for an underscore.
    """
    found: Any = importlib.import_module(module)
    if hasattr(found, "register"):
        found.register(app)
    elif hasattr(found, "command"):
        app.command(name, help=docstring(found.command))(found.command)
    else:
        from lfcal.cli._task_command import add_task
        from lfcal.tasks import task_set

        package, _, task = module.rpartition(".")
        add_task(app, task_set(task.replace("_", " ")), found.show, command_with_parts(package, task))


class CommandWithParts(typer.core.TyperCommand):
    """A command whose first argument may be the name of a subcommand."""

    parts: LazyCommands

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Return the context of this command, or of the subcommand that the first argument names."""
        if args and args[0] in self.parts:
            return self.parts[args[0]].make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


class LazyGroup(typer.core.TyperGroup):
    """A group whose help lists commands by their summaries without importing them."""

    _listing = False

    def headings(self, names: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield each heading with its commands; by default there is a single heading."""
        yield "Commands", names

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in order."""
        return list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of this name; during shell completion, one with only a summary."""
        commands: Any = self.commands
        if self._listing and cmd_name in commands.listed:
            return typer.core.TyperCommand(cmd_name, help=commands.listed[cmd_name].summary)
        return commands.get(cmd_name)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return completions of ``incomplete``: names of commands with their summaries."""
        self._listing = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._listing = False

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print usage, options, and commands under their headings; Typer's own printer is slow to load."""
        commands: Any = self.commands
        typer.secho(f"\nUsage: {ctx.command_path} {' '.join(self.collect_usage_pieces(ctx))}\n", bold=True)
        typer.echo(f"{self.help}\n")
        for heading, names in self.headings(tuple(commands)):
            _print_rows(heading, ((name, commands.listed[name].summary) for name in names))
        records = (parameter.get_help_record(ctx) for parameter in self.get_params(ctx))
        _print_rows("Options", (record for record in records if record is not None))
        typer.echo(f"Each has its own help with an example: {ctx.command_path} COMMAND --help\n")


def _print_rows(heading: str, rows: Iterable[tuple[str, str]]) -> None:
    """Print a heading, and names with their descriptions."""
    typer.secho(heading, fg=typer.colors.YELLOW)
    known = dict(rows)
    left = max(14, *map(len, known))
    width = max(20, shutil.get_terminal_size().columns - left - 4)
    for name, said in known.items():
        lines = textwrap.wrap(said, width, break_on_hyphens=False) or [""]
        typer.echo(f"  {typer.style(name.ljust(left), fg=typer.colors.CYAN, bold=True)}  {lines[0]}")
        for line in lines[1:]:
            typer.echo(f"{'':{left + 4}}{line}")
    typer.echo()
