"""Text tables from spreadsheets, stage programs and scripts, and the assignment of their columns."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from lfcal.base import FileFormatError, InputError, any_of, read_text
from lfcal.frames.formats import image_suffixes

__all__ = [
    "ROLES",
    "TABLE_SUFFIXES",
    "Column",
    "Table",
    "clear_columns",
    "columns_in_words",
    "find_columns",
    "parse_columns",
    "read_table",
]

TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt", ".dat"})
"""Suffixes of tables; of these, ``.csv`` and ``.tsv`` are searched for in a folder of frames."""

MAX_BYTES = 256 << 20
SAMPLE = 20
"""Number of lines from which the separator is found."""

_SEPARATORS = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma"}
_COMMA_NUMBER = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_POINT_NUMBER = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Table:
    """A text table, with its cells as text.

    Attributes
    ----------
    name
        The file's name, for messages.
    columns
        Names of the columns; ``"1"``, ``"2"`` … where the table has no header.
    rows
        Cells of each row, one per column, with decimal commas converted to points.
    lines
        Line number in the file of each row, from 1.
    separator
        Name of the separator: ``"tab"``, ``"semicolon"``, ``"bar"``, ``"comma"``, ``"blanks"``, or another character.
    decimal
        Decimal sign of the file, ``"."`` or ``","``.
    header
        Whether the first row of the file contains the column names.
    """

    name: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    lines: tuple[int, ...]
    separator: str
    decimal: str = "."
    header: bool = True

    def column(self, name: str) -> list[str]:
        """Return the cells of one column."""
        k = self.columns.index(name)
        return [row[k] for row in self.rows]


def read_table(path: str | Path) -> Table:
    """Read a table; separator, decimal sign and header are detected from its text.

    Empty lines, rows of empty cells, empty columns at the end, and lines that begin with ``#`` or ``%`` are skipped. A
    line such as ``sep=;``, which spreadsheets write, sets the separator. The text is UTF-8, UTF-16 or code page 1252.

    Raises
    ------
    FileFormatError
        If there are no rows, rows differ in the number of cells, or a column name occurs twice. Also if some numbers
        have a decimal comma and others a decimal point.
    StorageError
        If the file cannot be read.
    """
    path = Path(path)
    text = read_text(path, limit=MAX_BYTES, foreign=True)
    said, lines = None, []
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if number == 1 and re.fullmatch(r"sep=.", stripped):
            said = stripped[-1]
        elif stripped and not stripped.startswith(("#", "%")):
            lines.append((number, line))
    separator = said or _separator([line for _, line in lines[:SAMPLE]])
    split = ((number, _split(line, separator, path)) for number, line in lines)
    # spreadsheets leave rows of only separators where something was deleted
    cells = [(number, row) for number, row in split if any(row)]
    if not cells:
        raise FileFormatError.expected(str(path), "a table with a row for each frame", "an empty one", "check the file")
    header = not any(_NUMBER.fullmatch(cell) for cell in cells[0][1])
    count = len(cells[0][1])
    while not cells[0][1][count - 1]:  # separators at the end of every line
        count -= 1
    columns = tuple(cells[0][1][:count]) if header else tuple(str(k + 1) for k in range(count))
    _check_columns(path, columns)
    body = cells[1:] if header else cells
    decimal = "." if separator == "," else _decimal(path, [row for _, row in body])
    return Table(
        path.name,
        columns,
        tuple(_row(path, number, row, len(columns), decimal, separator) for number, row in body),
        tuple(number for number, _ in body),
        _SEPARATORS.get(separator, repr(separator)) if separator.strip() or separator == "\t" else "blanks",
        decimal,
        header,
    )


def _separator(lines: list[str]) -> str:
    """Return the separator that occurs equally often in every line outside of quotes; a blank if there is none."""
    bare = [re.sub(r'"[^"]*"', "", line) for line in lines]
    for separator in _SEPARATORS:
        counts = {line.count(separator) for line in bare}
        if len(counts) == 1 and counts != {0}:
            return separator
    # a header and rows with decimal commas differ in commas; the sign that occurs in all lines is the separator
    for separator in ("\t", ";", ","):
        if bare and all(separator in line for line in bare):
            return separator
    return " "


def _split(line: str, separator: str, path: Path) -> list[str]:
    if separator == " ":
        found = re.findall(r'"([^"]*)"|(\S+)', line)
        return [quoted or bare for quoted, bare in found]
    try:
        (row,) = csv.reader(io.StringIO(line), delimiter=separator, skipinitialspace=True)
    except (csv.Error, ValueError) as error:
        raise FileFormatError.expected(f"list {path.name}", "a text table", str(error), "save it again") from error
    return [cell.strip() for cell in row]


def _check_columns(path: Path, columns: tuple[str, ...]) -> None:
    twice = sorted({name for name in columns if name and columns.count(name) > 1})
    if twice:
        raise FileFormatError.expected(
            f"list {path.name}, header", "unique column names", f"{twice[0]!r} twice", "rename one of them"
        )


def _decimal(path: Path, rows: Iterable[list[str]]) -> str:
    """Return the decimal sign of the numbers; raise `FileFormatError` if both are used."""
    comma = point = ""
    for row in rows:
        for cell in row:
            if _COMMA_NUMBER.fullmatch(cell):
                comma = comma or cell
            elif _POINT_NUMBER.fullmatch(cell):
                point = point or cell
    if comma and point:
        raise FileFormatError.expected(
            f"list {path.name}, decimal sign",
            "a point or a comma throughout",
            f"{comma} and {point}",
            "save the list with one decimal sign",
        )
    return "," if comma else "."


def _row(path: Path, number: int, row: list[str], count: int, decimal: str, separator: str) -> tuple[str, ...]:
    while len(row) > count and not row[-1]:
        row = row[:-1]
    if len(row) != count:
        remedy = "complete the row"
        if separator == "," and len(row) > count:
            remedy = "separate the columns by semicolons, because numbers have decimal commas"
        raise FileFormatError.expected(f"{path.name} line {number}", f"{count} cells", len(row), remedy)
    if decimal == ",":
        row = [cell.replace(",", ".") if _COMMA_NUMBER.fullmatch(cell) else cell for cell in row]
    return tuple(row)


ROLES = ("file", "page", "z", "y", "x", "exposure", "dy", "dx")
"""Roles of a column; only file, y and x are required."""

LENGTHS = {"um": 1.0, "µm": 1.0, "μm": 1.0, "micron": 1.0, "microns": 1.0, "mm": 1e3, "nm": 1e-3, "m": 1e6}
"""Micrometres in each unit of length."""
TIMES = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
"""Seconds in each unit of time."""

_FILE = {"file", "filename", "filepath", "image", "img", "imagefile", "name", "path"}
_FILE_EXTRA = {"file", "name", "path", "image", "tif", "tiff", "frame"}
_STAGE = {
    *("pos", "position", "stage", "coord", "coordinate", "axis", "motor", "table", "abs", "absolute"),
    *("set", "target", "nominal", "actual", "measured", "readback", "encoder", "source", "point", "pinhole"),
}
_INDEX = {"index", "idx", "step", "number", "no", "i"}
_NAMED_INDEX = {"plane": "z", "slice": "z", "row": "y", "col": "x", "column": "x"}
_EXPOSURE = {"exp", "exposure", "exposuretime", "exptime", "integration", "shutter"}
_WORD = re.compile(r"[A-Z]+(?=[A-Z][a-zµμ])|[A-Zµμ]?[a-zµμ]+|[A-Zµμ]+|[0-9]+")


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table and its role.

    Attributes
    ----------
    role
        One of `ROLES`.
    name
        Name in the table.
    unit
        Name of the unit of length (z, y, x) or time (exposure), ``"index"`` for position numbers; empty: not stated.
    """

    role: str
    name: str
    unit: str = ""

    def __str__(self) -> str:
        """Return ``role=name (unit)``, without the unit if the name contains it."""
        named = self.unit in (word.lower() for word in _WORD.findall(self.name))
        return f"{self.role}={self.name}{f' ({self.unit})' if self.unit and not named else ''}"


def parse_columns(text: str) -> dict[str, tuple[str, str]]:
    """Return (column name, unit) by role, from an assignment such as ``"file=Name,y=PosY,exposure_ms=Exp"``.

    A unit follows the role, as in ``y_mm=PosY``; without it, the unit is empty. ``y_index=Row`` states that a column
    contains position numbers. ``exposure=`` states that no column contains the exposure, even if a name suggests one.

    Raises
    ------
    InputError
        If ``text`` does not have this form, contains an unknown role or unit, or assigns a role twice.
    """
    found: dict[str, tuple[str, str]] = {}
    for part in text.split(","):
        key, equals, name = (piece.strip() for piece in part.partition("="))
        role, _, unit = key.partition("_")
        units = {"index": 1.0} | LENGTHS if role in ("z", "y", "x") else TIMES if role == "exposure" else {}
        if not equals or role not in ROLES or (unit and unit not in units) or role in found:
            raise InputError.expected(
                "--columns",
                f"ROLE=COLUMN,… with each of {', '.join(ROLES)} at most once",
                repr(part),
                "write it in this form: file=Name,y_um=PosY,x_um=PosX,exposure_ms=Exp",
            )
        found[role] = (name, unit)
    return found


def find_columns(table: Table, stated: Mapping[str, tuple[str, str]] | None = None) -> tuple[Column, ...]:
    """Return the columns that have a role, in the order of `ROLES`.

    Roles are guessed from the names of columns, unless they are assigned in ``stated``, from `parse_columns`.

    Raises
    ------
    InputError
        If several columns could have the same role, no column is found for file, y or x, or ``stated`` names a column
        that does not exist.
    """
    chosen, doubtful = _sorted_out(table, stated or {})
    for role, found in doubtful.items():
        names = any_of(repr(column.name) for column in found)
        raise InputError.expected(
            f"{table.name}, column of {role}",
            "one",
            names,
            f"state which one in the contents of the columns (--columns '{role}={found[-1].name}')",
        )
    missing = [role for role in ("file", "y", "x") if role not in chosen]
    if missing:
        raise InputError.expected(
            f"{table.name}, column of {missing[0]}",
            "a name such as " + {"file": "file, image or name", "y": "y, PosY or stage_y"}.get(missing[0], "x or PosX"),
            f"columns {', '.join(table.columns)}",
            f"state the column (--columns {','.join(f'{role}=COLUMN' for role in missing)})",
        )
    return tuple(chosen[role] for role in ROLES if role in chosen)


def clear_columns(table: Table, stated: Mapping[str, tuple[str, str]] | None = None) -> tuple[Column, ...]:
    """Return the columns in ``stated`` and those with unambiguous names, even if required columns are missing."""
    chosen, _ = _sorted_out(table, stated or {})
    return tuple(chosen[role] for role in ROLES if role in chosen)


def _sorted_out(
    table: Table, stated: Mapping[str, tuple[str, str]]
) -> tuple[dict[str, Column], dict[str, list[Column]]]:
    """Return the column of each role, and the columns that could have the same role."""
    chosen = {role: _stated_column(table, role, *value) for role, value in stated.items() if value[0]}
    used = {column.name for column in chosen.values()}
    guesses: dict[str, list[Column]] = {}
    for name in table.columns if table.header else ():
        guess = _guess(name)
        if guess is not None and name not in used and guess.role not in stated:
            guesses.setdefault(guess.role, []).append(guess)
    doubtful = {}
    for role, found in guesses.items():
        exact = [column for column in found if column.name.strip().lower() == role]
        if len(found) > 1 and len(exact) != 1:
            doubtful[role] = found
        else:
            chosen[role] = exact[0] if exact else found[0]
    if "file" not in {*chosen, *doubtful, *stated}:
        chosen |= _by_endings(table, used)
    return chosen, doubtful


def columns_in_words(columns: tuple[Column, ...]) -> str:
    """Return the assignment of columns for messages, such as ``"file=Name, y=PosY (mm)"``."""
    return ", ".join(map(str, columns))


def _by_endings(table: Table, used: set[str]) -> dict[str, Column]:
    """Return the only column whose cells all have image suffixes, whatever its name."""
    endings = tuple(image_suffixes())
    found = [
        name
        for name in table.columns
        if name not in used and table.rows and all(cell.lower().endswith(endings) for cell in table.column(name))
    ]
    return {"file": Column("file", found[0])} if len(found) == 1 else {}


def _stated_column(table: Table, role: str, name: str, unit: str) -> Column:
    if name not in table.columns and name.isdigit() and 1 <= int(name) <= len(table.columns):
        name = table.columns[int(name) - 1]  # a name that cannot be typed is replaced by its number
    if name not in table.columns:
        near = [column for column in table.columns if column.lower() == name.lower()]
        if len(near) != 1:
            raise InputError.expected(
                f"{table.name}, column of {role}", f"one of {', '.join(table.columns)}", repr(name), "correct --columns"
            )
        name = near[0]
    guess = _guess(name)
    return Column(role, name, unit or (guess.unit if guess is not None and guess.role == role else ""))


def _guess(name: str) -> Column | None:
    """Return the role of a column of this name; None if it has none."""
    words = [word.lower() for word in _WORD.findall(name)]
    if words in (["dy"], ["dx"]):
        return Column(words[0], name)
    if words == ["page"]:
        return Column("page", name)
    units = [word for word in words if word in LENGTHS or word in TIMES]
    unit, rest = (units[-1] if units else ""), set(words) - set(units)
    if rest & _EXPOSURE and rest <= _EXPOSURE | {"time", "t"}:
        return Column("exposure", name, unit if unit in TIMES else "")
    if rest & _FILE and rest <= _FILE | _FILE_EXTRA:
        return Column("file", name)
    return _place(name, rest, unit)


def _place(name: str, words: set[str], unit: str) -> Column | None:
    axes = words & {"x", "y", "z"}
    extra = words - axes
    if len(axes) == 1 and extra <= _STAGE | _INDEX:
        return Column(axes.pop(), name, "index" if extra & _INDEX else unit if unit in LENGTHS else "")
    if not axes and len(words) >= 1 and len(set(words) & set(_NAMED_INDEX)) == 1 and extra <= {*_NAMED_INDEX, *_INDEX}:
        return Column(next(_NAMED_INDEX[word] for word in words if word in _NAMED_INDEX), name, "index")
    if words == {"depth"}:
        return Column("z", name, unit if unit in LENGTHS else "")
    return None
