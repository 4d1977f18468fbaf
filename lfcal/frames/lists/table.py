"""Text tables as spreadsheets, stage programs and scripts write them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lfcal.base import FileFormatError, read_text

__all__ = ["TABLE_SUFFIXES", "Table", "read_table"]

TABLE_SUFFIXES = frozenset({".csv", ".tsv", ".txt", ".dat"})
"""Endings of tables; of these, ``.csv`` and ``.tsv`` are looked for in a folder of frames."""

MAX_BYTES = 256 << 20
SAMPLE = 20
"""Lines that the separator is judged by."""

_SEPARATORS = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma"}
_COMMA_NUMBER = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_POINT_NUMBER = re.compile(r"[-+]?\d*\.\d+(?:[eE][-+]?\d+)?")
_NUMBER = re.compile(r"[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Table:
    """Cells of a text table.

    Attributes
    ----------
    name
        The file's name, for messages.
    columns
        Names of the columns; ``"1"``, ``"2"`` … where the table has no header.
    rows
        Cells of each row, as many as columns, decimal commas turned into points.
    lines
        Line of the file of each row, from 1.
    separator
        In words: tab, semicolon, bar, comma or blanks.
    decimal
        ``"."`` or ``","`` as the file has it.
    header
        Whether the file names its columns.
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
    """Read a table whose separator, decimal sign and header are found from its text.

    Empty lines, rows of empty cells, empty columns at the end, and lines that begin with ``#`` or ``%`` are left out;
    the line ``sep=;`` of spreadsheets is heeded. The text is UTF-8, UTF-16 or code page 1252.

    Raises
    ------
    FileFormatError
        If the rows do not have one number of cells, a column is named twice, or numbers are written in two ways.
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
    # spreadsheets leave rows of separators alone where something was deleted
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
    """Return the separator that every line has equally often outside of quotes; a blank where none has."""
    bare = [re.sub(r'"[^"]*"', "", line) for line in lines]
    for separator in _SEPARATORS:
        counts = {line.count(separator) for line in bare}
        if len(counts) == 1 and counts != {0}:
            return separator
    # a header of words and rows with decimal commas differ in commas; whatever stands in all lines is the separator
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
            f"list {path.name}, header", "every column named once", f"{twice[0]!r} twice", "rename one of them"
        )


def _decimal(path: Path, rows: Iterable[list[str]]) -> str:
    """Return the decimal sign of the numbers; raises where both are used."""
    comma = point = ""
    for row in rows:
        for cell in row:
            if _COMMA_NUMBER.fullmatch(cell):
                comma = comma or cell
            elif _POINT_NUMBER.fullmatch(cell):
                point = point or cell
    if comma and point:
        raise FileFormatError.expected(
            f"list {path.name}, decimal sign", "a point or a comma throughout", f"{comma} and {point}", "save it again"
        )
    return "," if comma else "."


def _row(path: Path, number: int, row: list[str], count: int, decimal: str, separator: str) -> tuple[str, ...]:
    while len(row) > count and not row[-1]:
        row = row[:-1]
    if len(row) != count:
        remedy = "complete the row"
        if separator == "," and len(row) > count:
            remedy = "numbers with decimal commas need semicolons between columns"
        raise FileFormatError.expected(f"{path.name} line {number}", f"{count} cells", len(row), remedy)
    if decimal == ",":
        row = [cell.replace(",", ".") if _COMMA_NUMBER.fullmatch(cell) else cell for cell in row]
    return tuple(row)
