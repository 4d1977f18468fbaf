"""Frames named in a list, with their position numbers or stage coordinates."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError
from lfcal.frames.lists.table import (
    LENGTHS,
    TIMES,
    Column,
    Table,
    columns_in_words,
    find_columns,
    parse_columns,
    read_table,
)

__all__ = ["MAX_EXPOSURE_S", "Listing", "read_listing"]

MAX_EXPOSURE_S = 1000.0
"""Longest plausible exposure (s): a longer one has another unit, as no frame of a scan takes a quarter of an hour."""


@dataclass(frozen=True, eq=False)
class Listing:
    """The frames named in a list, and the facts that the list states about them.

    Attributes
    ----------
    name
        Name of the list, for messages.
    files, pages
        File as written in the list, and page from 0, of each frame.
    places
        ``(N, 3)`` as (x, y, z): stage coordinates, or position numbers if ``unit`` is ``"index"``. NaN where the list
        states no z.
    unit
        Unit of length of the stage coordinates; ``"index"`` for position numbers; empty if the list states no unit.
    exposures
        Exposure time of each frame (s). None: unknown.
    drift
        ``(N, 2)`` as (dy, dx): displacement of images from their planned positions (px). None: not stated.
    notes
        Notes on what was guessed, one line each.
    counted
        Whether z is a plane number, although x and y are stage coordinates.
    roi
        Region of the camera's sensor that the frames show (column, row, width, height), if the list states it.
    """

    name: str
    files: tuple[str, ...]
    pages: tuple[int, ...]
    places: NDArray[np.float64]
    unit: str
    exposures: tuple[float, ...] | None = None
    drift: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    counted: bool = False
    roi: tuple[int, int, int, int] | None = None

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.files)

    @property
    def has_depth(self) -> bool:
        """Whether the list states z for every frame."""
        return bool(np.isfinite(self.places[:, 2]).all())

    def label(self, k: int) -> str:
        """Return the name of frame ``k`` for messages."""
        return f"{self.files[k]} page {self.pages[k]}" if self.pages[k] else self.files[k]


def read_listing(path: str | os.PathLike[str], columns: str = "") -> Listing:
    """Read a list of frames from a table with any separator and any column names.

    Parameters
    ----------
    path
        A text table with a row for each frame.
    columns
        Assignment of columns, in the form of `lfcal.frames.lists.table.parse_columns`. The roles of other columns are
        guessed from their names.

    Raises
    ------
    LfcalError
        If the table cannot be read. The message states the line, or the existing columns and what to enter.
    """
    table = read_table(Path(path))
    stated = parse_columns(columns) if columns else None
    if not table.rows:
        raise FileFormatError.expected(f"list {table.name}", "a row for each frame", "only a header", "check the file")
    found = find_columns(table, stated)
    by_role = {column.role: column for column in found}
    places = np.full((len(table.rows), 3), np.nan)
    for k, axis in enumerate("xyz"):
        if axis in by_role:
            places[:, k] = _numbers(table, by_role[axis])
    unit, scales, counted = _unit(table, by_role, places)
    places *= scales
    exposures, said = _exposures(table, by_role.get("exposure"))
    shown = [said if column.role == "exposure" and said is not None else column for column in found]
    words = f"columns: {columns_in_words(tuple(shown))}; separated by {table.separator}"
    return Listing(
        table.name,
        tuple(_file(table, by_role["file"])),
        _pages(table, by_role.get("page")),
        places,
        unit,
        exposures,
        _drift(table, by_role),
        (words + (", decimal commas" if table.decimal == "," else ""),),
        counted,
    )


def _numbers(table: Table, column: Column) -> NDArray[np.float64]:
    values = np.empty(len(table.rows))
    for k, cell in enumerate(table.column(column.name)):
        try:
            values[k] = float(cell)
        except ValueError:
            values[k] = math.nan
        if not math.isfinite(values[k]):
            where = f"{table.name} line {table.lines[k]}, {column.name}"
            raise FileFormatError.expected(where, "a number", repr(cell), "write a number")
    return values


def _unit(
    table: Table, by_role: dict[str, Column], places: NDArray[np.float64]
) -> tuple[str, NDArray[np.float64] | float, bool]:
    """Return the unit of the positions, factors that convert all axes to it, and whether only planes are counted."""
    used = [by_role[axis] if axis in by_role else None for axis in "xyz"]
    units = [column.unit if column is not None else None for column in used]
    stated = {unit for unit in units if unit is not None}
    unsaid = [unit == "" for unit in units]
    if stated <= {"index", ""} and _counts(places[:, unsaid]):
        return "index", 1.0, False
    counted = units[2] == "index"
    if counted:
        _check_planes(table, by_role["z"], places[:, 2])
        stated = {unit for unit in units[:2] if unit is not None}
    if "index" in stated:
        names = ", ".join(str(column) for column in used if column is not None)
        raise InputError.expected(
            f"{table.name}, positions",
            "position numbers throughout, or lengths along x and y",
            names,
            "state which in the contents of the columns (--columns y_index=…,x_index=…,z_index=… or y_um=…,x_um=…)",
        )
    if "" in stated:
        if len(stated) == 1:
            return "", 1.0, counted
        names = ", ".join(column.name for column in used if column is not None and not column.unit)
        raise InputError.expected(
            f"{table.name}, unit of {names}", "that of the other axes", "none", "give --columns y_um=…,x_um=…"
        )
    return "um", np.array([LENGTHS.get(unit or "", 1.0) for unit in units]), counted


def _check_planes(table: Table, column: Column, numbers: NDArray[np.float64]) -> None:
    """Raise `FileFormatError` unless planes are counted from 0 or 1."""
    odd = np.flatnonzero((numbers != np.round(numbers)) | (numbers < 0))
    if odd.size or numbers.min() > 1:
        k = int(odd[0]) if odd.size else int(numbers.argmin())
        raise FileFormatError.expected(
            f"{table.name} line {table.lines[k]}, {column.name}",
            "a plane number, counted from 0 or 1",
            f"{numbers[k]:g}",
            "correct it, or state that it is a length (--columns z_um=COLUMN)",
        )


def _counts(places: NDArray[np.float64]) -> bool:
    """Return whether all positions are small whole numbers that count from 0 or 1 with few gaps."""
    for values in places[:, np.isfinite(places).all(axis=0)].T:
        if (values != np.round(values)).any() or values.min() not in (0, 1) or values.max() > 10 * len(values):
            return False
        distinct = np.unique(values)
        if len(distinct) > 2 and distinct[-1] - distinct[0] > 2 * len(distinct):
            return False
    return True


def _exposures(table: Table, column: Column | None) -> tuple[tuple[float, ...] | None, Column | None]:
    """Return exposures in seconds, and the column with the assumed unit."""
    if column is None:
        return None, None
    values = _numbers(table, column)
    name = f"{table.name}, {column.name}"
    # exposures of a point source are rarely below a millisecond: 0.02 means seconds, 20 means milliseconds
    unit = column.unit or ("ms" if np.median(values) >= 1 else "s")
    if values.min() <= 0:
        line = table.lines[int(values.argmin())]
        raise FileFormatError.expected(
            f"{table.name} line {line}, {column.name}",
            "a time above 0",
            values.min(),
            "write the exposure of this frame",
        )
    if not column.unit and np.median(values) >= 1000:
        # microseconds, as written by machine-vision cameras, or milliseconds for a faint source
        remedy = (
            f"state the unit in the contents of the columns (--columns exposure_us={column.name} or "
            f"exposure_ms={column.name})"
        )
        raise InputError.expected(
            name, "a unit, because the times are large", f"{np.median(values):g} without a unit", remedy
        )
    if (longest := float(values.max() * TIMES[unit])) > MAX_EXPOSURE_S:
        remedy = f"correct its unit (for example --columns exposure_us={column.name})"
        raise InputError.expected(name, f"exposures of at most {MAX_EXPOSURE_S:g} s", f"{longest:g} s", remedy)
    shown = Column("exposure", column.name, unit if column.unit else f"taken as {unit}")
    return tuple(float(v) for v in values * TIMES[unit]), shown


def _drift(table: Table, by_role: dict[str, Column]) -> NDArray[np.float64] | None:
    if "dy" not in by_role and "dx" not in by_role:
        return None
    zero = np.zeros(len(table.rows))
    return np.stack([_numbers(table, by_role[r]) if r in by_role else zero for r in ("dy", "dx")], axis=1)


def _pages(table: Table, column: Column | None) -> tuple[int, ...]:
    if column is None:
        return (0,) * len(table.rows)
    values = _numbers(table, column)
    if (values != np.round(values)).any() or values.min() < 0:
        raise FileFormatError.expected(
            f"{table.name}, {column.name}",
            "page numbers from 0",
            "negative numbers or fractions",
            "number the pages 0, 1, 2 …",
        )
    return tuple(int(v) for v in values)


def _file(table: Table, column: Column) -> list[str]:
    names = table.column(column.name)
    for name, line in zip(names, table.lines, strict=True):
        if not name or "\0" in name:
            raise FileFormatError.expected(
                f"{table.name} line {line}, {column.name}", "the name of a file", repr(name), "fill it in"
            )
    return names
