"""Commands that are loaded when they are called: the list of all of them needs none of their libraries."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, MutableMapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import CodeType, ModuleType
from typing import Any

import typer.core
import typer.main

__all__ = ["CommandWithParts", "LazyCommands", "LazyGroup", "Listed", "command_with_parts", "listed_commands"]


@dataclass(frozen=True)
class Listed:
    """A command as the list of commands has it: the module of its name registers it."""

    name: str
    module: str
    summary: str


def listed_commands(package: str, order: tuple[str, ...] = ()) -> tuple[Listed, ...]:
    """Return the commands of a package, in ``order`` and then by name, without importing their modules.

    A public module that defines ``register`` has the command of its own name, with a hyphen for an underscore; modules
    ``camera_*`` are parts of ``camera``, which registers them. The summary is the first paragraph of the function
    ``command``, or, for a group, what the first line of the module says behind the colon.
    """
    path = importlib.import_module(package).__path__
    names = [m.name for m in pkgutil.iter_modules(path) if not m.name.startswith("_")]
    # a stable sort: what is not named in the order stays sorted by name behind it.
    names = sorted(name for name in names if name.partition("_")[0] == name or name.partition("_")[0] not in names)
    called = {name: name.replace("_", "-") for name in names}
    names.sort(key=lambda name: order.index(called[name]) if called[name] in order else len(order))
    called = {name: called[name] for name in names}
    return _listed(package, called)


def _listed(package: str, called: dict[str, str]) -> tuple[Listed, ...]:
    """Return the commands of modules, by what each is called, in order."""
    found = ((name, _code_of(f"{package}.{name}")) for name in called)
    return tuple(
        Listed(called[name], f"{package}.{name}", _summary(code))
        for name, code in found
        if code is not None and "register" in code.co_names
    )


def command_with_parts(package: str, name: str) -> type[CommandWithParts]:
    """Return the class of a command ``name`` whose modules ``name_*`` register further commands behind its name.

    ``lfcal fit SOURCE`` is a command, and so is ``lfcal fit check``, which is loaded when it is called.
    """
    path = importlib.import_module(package).__path__
    modules = sorted(m.name for m in pkgutil.iter_modules(path) if m.name.startswith(f"{name}_"))
    called = {module: module.removeprefix(f"{name}_").replace("_", "-") for module in modules}
    return type(CommandWithParts.__name__, (CommandWithParts,), {"parts": LazyCommands(_listed(package, called))})


def _code_of(module: str) -> CodeType | None:
    """Return the compiled code of a module, which its loader has on disk; a frozen program has no other."""
    spec = find_spec(module)
    code: CodeType | None = spec.loader.get_code(module) if spec and hasattr(spec.loader, "get_code") else None  # type: ignore[union-attr]
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


class LazyCommands(MutableMapping[str, Any]):
    """Commands by name, each loaded when it is looked up."""

    def __init__(self, listed: tuple[Listed, ...]) -> None:
        self.listed = {one.name: one for one in listed}
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        """Return the command, its module imported and its signature read."""
        if name not in self._loaded:
            self._loaded[name] = _load(self.listed[name])
        return self._loaded[name]

    def __setitem__(self, name: str, command: Any) -> None:
        """Add a command that is there already."""
        self._loaded[name] = command

    def __delitem__(self, name: str) -> None:
        """Forget a command."""
        self.listed.pop(name, None)
        self._loaded.pop(name, None)

    def __contains__(self, name: object) -> bool:
        """Return whether there is such a command, which is not loaded for it."""
        return name in self.listed or name in self._loaded

    def __iter__(self) -> Iterator[str]:
        """Go through the names in order."""
        yield from self.listed
        yield from (name for name in self._loaded if name not in self.listed)

    def __len__(self) -> int:
        """Count the commands."""
        return len(self.listed.keys() | self._loaded.keys())


def _load(listed: Listed) -> Any:
    module: ModuleType = importlib.import_module(listed.module)
    app = typer.Typer(add_completion=False, rich_markup_mode="markdown")
    # with a callback it stays a group, whose command has its own name
    app.callback()(lambda: None)
    module.register(app)
    group: Any = typer.main.get_command(app)
    return group.commands[listed.name]


class CommandWithParts(typer.core.TyperCommand):
    """A command whose first word may be the name of another one."""

    parts: LazyCommands

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        """Return the context of this command, or of the one that the first word names."""
        if args and args[0] in self.parts:
            return self.parts[args[0]].make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


class LazyGroup(typer.core.TyperGroup):
    """A group whose help lists commands by their summaries and loads none of them."""

    _listing = False

    def headings(self, names: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Yield a heading and the commands under it; all under one unless a group has more."""
        yield "Commands", names

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in order."""
        return list(self.commands)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command of this name; while help or completion is made, one that has its summary only."""
        commands: Any = self.commands
        if self._listing and isinstance(commands, LazyCommands) and cmd_name in commands.listed:
            summary = commands.listed[cmd_name].summary
            return typer.core.TyperCommand(cmd_name, help=summary, rich_markup_mode="markdown")
        return self.commands.get(cmd_name)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help; Typer's own printer takes longer to load than all else."""
        self._listing = True
        try:
            print_overview(self, ctx)
        finally:
            self._listing = False

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return what may follow ``incomplete``: names of commands with their summaries."""
        self._listing = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._listing = False


def print_overview(group: LazyGroup, ctx: Any) -> None:
    """Print usage, options, and the commands under the headings of the group."""
    from rich.console import Console
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    def table(rows: list[tuple[str, str]]) -> Padding:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(style="bold cyan", no_wrap=True, min_width=14)
        grid.add_column(overflow="fold")
        for name, said in rows:
            grid.add_row(name, Text(said))
        return Padding(grid, (0, 0, 1, 2))

    console = Console()
    console.print(Text(f"\nUsage: {ctx.command_path} {' '.join(group.collect_usage_pieces(ctx))}\n", style="bold"))
    console.print(Text(f"{group.help}\n"))
    shown = {name: str(group.get_command(ctx, name).help) for name in group.list_commands(ctx)}
    for heading, names in group.headings(tuple(shown)):
        console.print(Text(heading, style="yellow"))
        console.print(table([(name, shown[name]) for name in names]))
    console.print(Text("Options", style="yellow"))
    records = (parameter.get_help_record(ctx) for parameter in group.get_params(ctx))
    console.print(table([record for record in records if record is not None]))
    console.print(Text(f"Each has its own help with an example: {ctx.command_path} COMMAND --help\n"))
