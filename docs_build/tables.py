"""Tables of the site, made from registries, records and commands: ``<!-- table: NAME -->`` in a page.

`TABLES` lists them. `options_table` contains all options of all commands.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

__all__ = ["TABLES", "commands", "options_table", "table"]


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(_cell(value) for value in line)} |" for line in lines)


def _cell(value: object) -> str:
    return " ".join(str(value).split()).replace("|", "\\|")


def _first_line(part: Any) -> str:
    return (part.__doc__ or "").strip().split("\n")[0]


def _code(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


# -- tables of registries ----------------------------------------------------------------------------------
def _metrics() -> str:
    from lfcal.judge.quality import METRICS

    rows = []
    for spec in METRICS:
        better, worse = ("≥", "<") if spec.limits.higher_is_better else ("≤", ">")
        title = f"{spec.title} ({spec.unit})" if spec.unit else spec.title
        limits = (f"{better} {spec.limits.good:g}", f"{worse} {spec.limits.bad:g}")
        rows.append((title, *limits, f"{spec.cost.at_bad:g}", f"{spec.meaning} {spec.advice}"))
    return table(("check (unit)", "good", "bad", "cost", "meaning and advice"), rows)


def _faults() -> str:
    from lfcal.judge import FAULTS

    return table(("fault", "name", "advice"), [(fault.title, f"`{fault.name}`", fault.advice) for fault in FAULTS])


def _solvers() -> str:
    from lfcal.reconstruct import SOLVERS

    usual = frozenset.intersection(*(solver.honours for solver in SOLVERS))
    rows = [(f"`{one.name}`", one.title, _code(sorted(one.honours - usual))) for one in SOLVERS]
    return table(("`--solver`", "method", "further options"), rows)


ACTS_ON = {
    "SceneEffect": "optics",
    "LightEffect": "light",
    "PsfEffect": "responses",
    "MotionEffect": "motion of the source",
    "FrameEffect": "sensor frame",
}
"""What effects act on, by their base class."""


def _effects() -> str:
    from lfcal.simulate.effects import CATALOGUE

    rows = []
    for effect in CATALOGUE:
        where = next(ACTS_ON[kind.__name__] for kind in effect.__mro__ if kind.__name__ in ACTS_ON)
        magnitudes = _code([field.name for field in dataclasses.fields(effect)])
        rows.append((effect.title, f"`{effect.name}`", where, magnitudes, _first_line(effect)))
    return table(("effect", "name", "acts on", "magnitudes", "meaning"), rows)


def _unknowns() -> str:
    from lfcal.fit import GROUPS

    return table(("group", "unknowns"), [(f"`{group.name}`", group.title) for group in GROUPS])


def _devices() -> str:
    from lfcal.devices.registry import BACKENDS

    rows = []
    for one in BACKENDS:
        options = "<br>".join(f"`{name}`: {meaning}" for name, meaning in one.options.items())
        rows.append((f"`{one.name}`", one.title, options))
    return table(("backend", "devices", "options"), rows)


def _parts() -> str:
    from lfcal.accuracy import PARTS

    return table(("part", "error", "cost"), [(f"`{part.name}`", part.error, part.cost) for part in PARTS])


def _commands() -> str:
    rows = [(f"[`{name}`](#{_anchor(name)})", _summary(command)) for name, command in commands()]
    return table(("command", "use"), rows)


TABLES: Mapping[str, Callable[[], str]] = {
    "metrics": _metrics,
    "faults": _faults,
    "solvers": _solvers,
    "effects": _effects,
    "unknowns": _unknowns,
    "devices": _devices,
    "parts": _parts,
    "commands": _commands,
    "options": lambda: options_table(),
}
"""Tables by the names that pages use."""


# -- commands ----------------------------------------------------------------------------------------------
def commands() -> list[tuple[str, Any]]:
    """Return every command with its name, in the order of the help."""
    from typer.main import get_command

    from lfcal.cli._app import build_app

    return list(_walk(get_command(build_app()), "lfcal"))


def _walk(group: Any, name: str) -> Iterator[tuple[str, Any]]:
    for word, command in group.commands.items():
        if getattr(command, "hidden", False):
            continue
        if getattr(command, "commands", None):
            yield from _walk(command, f"{name} {word}")
            continue
        yield f"{name} {word}", command
        for part, mode in (getattr(command, "parts", None) or {}).items():
            yield f"{name} {word} {part}", mode


def _anchor(name: str) -> str:
    return name.replace(" ", "-")


def _summary(command: Any) -> str:
    return (command.help or "").split("\n\n")[0]


def options_table() -> str:
    """Return a section for each command with its help and a table of its options."""
    parts = []
    for name, command in commands():
        rows = [_option(one) for one in command.params if not one.hidden]
        head = ("option", "value", "meaning")
        parts.append(f"### {name} {{ #{_anchor(name)} }}\n\n{command.help}\n\n{table(head, rows) if rows else ''}")
    return "\n\n".join(parts)


def _option(option: Any) -> tuple[str, str, str]:
    named = [one for one in option.opts if one.startswith("-")]
    names = _code(named) if named else f"`{option.name.upper()}`"
    value = "" if getattr(option, "is_flag", False) else (option.metavar or "")
    needed = " Required." if option.required else ""
    return names, value if named else "", f"{option.help or ''}{needed}"
