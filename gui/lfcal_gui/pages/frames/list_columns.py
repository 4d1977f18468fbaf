"""Meaning of the columns of a list, as chosen by the user: the stored text and the shown one. No Qt."""

from __future__ import annotations

from collections.abc import Collection

from lfcal.base import InputError
from lfcal.frames.lists import LENGTHS, TIMES, Column, Table, clear_columns, find_columns, parse_columns

HOLDS = (
    ("", "not used"),
    *((role, role) for role in ("file", "x", "y", "z", "page", "exposure")),
    ("dy", "dy (px)"),
    ("dx", "dx (px)"),
)
"""What a column of a list can hold, with the words shown."""
LENGTH_UNITS = ("um", "mm", "nm", "m", "index")
TIME_UNITS = ("s", "ms", "us")


def units_of(role: str) -> tuple[str, ...]:
    """Return the units that a column of ``role`` may have; empty: found."""
    own = {"exposure": TIME_UNITS, **dict.fromkeys("xyz", LENGTH_UNITS)}
    return ("", *own.get(role, ()))


def unit_shown(unit: str) -> str:
    """Return the name of `units_of` of a unit as headers write it: um of microns."""
    for known, units in ((LENGTHS, LENGTH_UNITS), (TIMES, TIME_UNITS)):
        if unit in known:
            return next(name for name in units if known[name] == known[unit])
    return unit


def columns_text(holds: dict[str, tuple[str, str]], without: Collection[str] = ()) -> str:
    """Return ``--columns`` for what each column (by its number from 1) holds, with its unit.

    Parameters
    ----------
    holds
        Role and unit of each; empty: not used, and found.
    without
        Roles that no column is to hold.
    """
    parts = []
    for number, (role, unit) in holds.items():
        if role:
            parts.append(f"{role}{f'_{unit}' if unit and unit in units_of(role) else ''}={number}")
    return ",".join([*parts, *(f"{role}=" for role in sorted(without))])


def not_held(columns: str) -> set[str]:
    """Return the roles that the user excluded for all columns."""
    return {part.rstrip("=") for part in columns.split(",") if part.endswith("=")}


def columns_used(table: Table, columns: str) -> tuple[tuple[Column, ...], str]:
    """Return the use of the columns, and the problem with it; empty: none."""
    said = [part.partition("=")[::2] for part in columns.split(",") if part]
    roles = [key.partition("_")[0] for key, _ in said]
    if twice := [role for role in roles if roles.count(role) > 1]:
        held = [
            Column(role, table.columns[int(number) - 1], key.partition("_")[2])
            for role, (key, number) in zip(roles, said, strict=True)
            if number
        ]
        names = " and ".join(column.name for column in held if column.role == twice[0])
        problem = (
            f"{table.name}, column of {twice[0]}: expected one, got {names}; choose something else above the other"
        )
        return tuple(held), problem
    told = parse_columns(columns) if columns else None
    try:
        return find_columns(table, told), ""
    except InputError as error:
        return clear_columns(table, told), str(error)
