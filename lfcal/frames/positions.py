"""The position of each frame, from the scan order or from the file names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_choice, check_number
from lfcal.frames.source import Position

__all__ = [
    "NameGuess",
    "NamePattern",
    "first_number",
    "guess_pattern",
    "missing_numbers",
    "natural_key",
    "scan_positions",
]

MAX_POSITIONS = 100_000_000
_FIELDS = ("z", "y", "x", "page")
_FIELD = re.compile(r"\{([^{}]*)\}|\*")


def scan_positions(plan_shape: Sequence[int], order: str = "serpentine") -> list[Position]:
    """Return all positions (z, y, x) of a scan of shape ``plan_shape`` (nz, ny, nx) in the order of recording.

    In ``"raster"`` order, x varies fastest, then y, then z, always in the same direction. ``"serpentine"`` order
    reverses the direction after each row and each plane, as in `lfcal.camera.ScanPlan`. Every move is then a single
    step.

    Raises
    ------
    InputError
        If the shape is refused by `check_plan_shape`, or the order is unknown.

    Examples
    --------
    >>> from lfcal.frames import scan_positions
    >>> [(y, x) for z, y, x in scan_positions((1, 2, 3))]
    [(0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0)]
    """
    check_choice("scan order", order, ("serpentine", "raster"))
    nz, ny, nx = check_plan_shape(plan_shape)
    index = np.indices((nz, ny, nx), dtype=np.intp)
    if order == "serpentine":
        # odd planes run in reverse, so that each plane starts where the last one ended
        index[1, 1::2] = ny - 1 - index[1, 1::2]
        # alternating over all planes' rows, across the change of plane too
        rows = index[2].reshape(nz * ny, nx)
        rows[1::2] = nx - 1 - rows[1::2]
    return [Position(*p) for p in index.reshape(3, -1).T.tolist()]


def check_plan_shape(plan_shape: Sequence[int]) -> tuple[int, int, int]:
    """Return ``plan_shape`` as a tuple ``(nz, ny, nx)``, after checking it.

    Raises
    ------
    InputError
        If it does not consist of three positive whole numbers, or their product exceeds `MAX_POSITIONS`.
    """
    if not isinstance(plan_shape, Sequence) or len(plan_shape) != 3:
        raise InputError.expected("scan shape", "three numbers nz, ny, nx", plan_shape, "give planes, rows and columns")
    for n, what in zip(plan_shape, ("planes nz", "rows ny", "columns nx"), strict=True):
        check_number(f"scan {what}", n, at_least=1, at_most=MAX_POSITIONS, integer=True)
    nz, ny, nx = (int(n) for n in plan_shape)
    check_number("positions of the scan", nz * ny * nx, at_most=MAX_POSITIONS, integer=True)
    return nz, ny, nx


def natural_key(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that puts ``img2`` before ``img10``."""
    # digits compare as numbers and sort before text; the tuples keep int and str apart
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"([0-9]+)", name) if part]


def missing_numbers(names: Sequence[str]) -> list[int]:
    """Return the numbers that are missing in a series of numbered file names.

    The result is empty if the names differ in more than their last number, or if more numbers are missing than present.
    """
    parts = [re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", Path(name).stem) for name in names]
    found = [part for part in parts if part is not None]
    if len(found) < len(names) or len({(part[1], part[3]) for part in found}) != 1:
        return []
    numbers = {int(part[2]) for part in found}
    if max(numbers) - min(numbers) >= 2 * len(numbers):
        return []
    return sorted(set(range(min(numbers), max(numbers) + 1)) - numbers)


def first_number(numbers: NDArray[np.intp], counts: Sequence[int] | NDArray[np.intp] | None = None) -> int:
    """Return the number from which positions are counted, 0 or 1.

    It is 1 if no number is 0, no axis exceeds its number of positions, and at least one axis reaches it.

    Parameters
    ----------
    numbers
        Position numbers ``(N, axes)`` found in names or lists.
    counts
        Number of positions along each axis. None: the number of different values.
    """
    if not numbers.size or numbers.min() < 1:
        return 0
    several = [len(np.unique(axis)) for axis in numbers.T]
    # without the scan's shape, a single frame shows nothing
    if counts is None and max(several) < 2:
        return 0
    ends = numbers.max(axis=0)
    wanted = several if counts is None else list(counts)
    reached = [bool(end == n) for end, n in zip(ends, wanted, strict=True)]
    # an axis may end earlier, if its last position is missing, but not later
    return int(any(reached) and all(end <= n for end, n in zip(ends, wanted, strict=True)))


@dataclass(frozen=True)
class NamePattern:
    """Pattern of file names that contain the scan position, such as ``"plane{z:02d}/y{y}_x{x}.tif"``.

    Attributes
    ----------
    template
        Path relative to the session folder. ``{z}``, ``{y}`` and ``{x}`` match the indices of the position, and
        ``{page}`` that of the page. All are whole numbers, possibly with leading zeros. A width such as ``{z:03d}`` is
        used only when names are created. ``*`` matches any text without a slash. ``z`` may be omitted for a single
        plane.
    first
        Number of the first position along each axis in the names, 0 or 1.
    expression
        Regular expression that matches the names; computed from ``template``.

    Raises
    ------
    InputError
        If the template is not a path within the folder, has an unknown field, or lacks ``{y}`` or ``{x}``, or if
        ``first`` is neither 0 nor 1.

    Examples
    --------
    >>> from lfcal.frames import NamePattern
    >>> pattern = NamePattern("z{z}_y{y:02d}_x{x:02d}.png")
    >>> print(pattern.name((0, 3, 7)), pattern.parse("z1_y03_x07.png")[0])
    z0_y03_x07.png Position(z=1, y=3, x=7)
    """

    template: str
    first: int = 0
    expression: re.Pattern[str] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the template."""
        check_number("first number in file names", self.first, at_least=0, at_most=1, integer=True)
        # a template comes from a file or a user, and must not lead out of the session's folder
        path = PurePosixPath(self.template)
        if not self.template or path.is_absolute() or ".." in path.parts or "\\" in self.template:
            raise InputError.expected(
                "name pattern",
                "a relative path with / between folders",
                repr(self.template),
                'use for example "z{z}_y{y}_x{x}.png"',
            )
        names = [name for name, _ in self._fields()]
        unknown = sorted({name for name in names if name not in _FIELDS})
        if unknown or "y" not in names or "x" not in names:
            got = f"field {unknown[0]!r}" if unknown else repr(self.template)
            raise InputError.expected(
                "name pattern",
                "{y} and {x}, and {z} and {page} where needed",
                got,
                'use for example "z{z}_y{y}_x{x}.png"',
            )
        object.__setattr__(self, "expression", self._expression())

    def _fields(self) -> list[tuple[str, str]]:
        found = (m.group(1) for m in _FIELD.finditer(self.template) if m.group(1) is not None)
        return [(text.partition(":")[0], text.partition(":")[2]) for text in found]

    def _expression(self) -> re.Pattern[str]:
        """Return the regular expression of the names."""
        parts, seen, end = [], set(), 0
        for match in _FIELD.finditer(self.template):
            parts.append(re.escape(self.template[end : match.start()]))
            end = match.end()
            if match.group(1) is None:
                parts.append("[^/]*")
                continue
            name = match.group(1).partition(":")[0]
            # a repeated field must have the same value, as in z{z}/z{z}_y{y}.png; nine digits limit the
            # number
            parts.append(f"(?P={name})" if name in seen else f"(?P<{name}>[0-9]{{1,9}})")
            seen.add(name)
        parts.append(re.escape(self.template[end:]))
        return re.compile("".join(parts))

    def parse(self, name: str) -> tuple[Position, int] | None:
        """Return the position (z, y, x) and the page from the relative path ``name``; None if it does not match.

        Raises
        ------
        InputError
            If a number of the position is less than ``first``.
        """
        match = self.expression.fullmatch(name)
        if match is None:
            return None
        found = {key: int(value) for key, value in match.groupdict().items()}
        z, y, x = (found.get(key, self.first) - self.first for key in "zyx")
        if min(z, y, x) < 0:
            raise InputError.expected(
                f"position in {name}", f"numbers from {self.first}", "0", "count from 0 (--first 0)"
            )
        return Position(z, y, x), found.get("page", 0)

    def name(self, position: Position, page: int = 0) -> str:
        """Return the relative path of the frame at ``position`` (z, y, x); ``page`` is the index of its page.

        Raises
        ------
        InputError
            If the template contains ``*``, which cannot be filled in.
        """
        if "*" in self.template:
            raise InputError.expected(
                "name pattern to write", "a pattern without *", repr(self.template), "replace * by fixed text"
            )
        values = {k: v + self.first for k, v in zip("zyx", position, strict=True)} | {"page": page}

        def fill(match: re.Match[str]) -> str:
            field, _, form = match.group(1).partition(":")
            digits = form.rstrip("d").lstrip("0")
            return str(values[field]).zfill(int(digits) if digits.isdigit() else 0)

        return _FIELD.sub(fill, self.template)


_LABELS = {
    **dict.fromkeys(("x", "col", "column", "ix", "posx"), "x"),
    **dict.fromkeys(("y", "row", "iy", "posy"), "y"),
    **dict.fromkeys(("z", "plane", "slice", "depth", "iz", "posz"), "z"),
}
_PAIR = {"r": "y", "c": "x"}
"""Short forms of row and column, if both occur."""

_DIGITS = re.compile(r"[0-9]+")


@dataclass(frozen=True)
class NameGuess:
    """Patterns that the names of files may follow.

    Attributes
    ----------
    templates
        Matching patterns, as templates of `lfcal.frames.NamePattern`. There is one if the names are unambiguous, and
        none if they contain no position. There are several if no words precede the numbers, and the scan shape does not
        determine which number belongs to which axis.
    numbered
        Number of names of the most frequent form if they differ in only one number. The files may then be numbered in
        scan order. Otherwise 0.
    fitting, names
        Number of names of the most frequent form (names that differ only in their numbers), and number of all names.
    """

    templates: tuple[str, ...]
    numbered: int
    fitting: int
    names: int

    @property
    def certain(self) -> bool:
        """Whether one pattern matches every name."""
        return len(self.templates) == 1 and self.fitting == self.names


def guess_pattern(names: Sequence[str], plan_shape: Sequence[int] | None = None) -> NameGuess:
    """Return the patterns that ``names`` may follow.

    Numbers are identified by the preceding word (``x012``, ``row-3``, ``plane1``). Without such words, numbers are
    identified by how many different values they have, which must equal the scan's number of planes, rows or columns. If
    some of these are equal or unknown, several patterns are possible.

    Parameters
    ----------
    names
        Relative paths of image files.
    plan_shape
        Number of positions of the scan ``(nz, ny, nx)``, if known.
    """
    kinds = Counter(_DIGITS.sub("#", name) for name in names)
    if not kinds:
        return NameGuess((), 0, 0, 0)
    kind, fitting = kinds.most_common(1)[0]
    alike = [name for name in names if _DIGITS.sub("#", name) == kind]
    values = list(zip(*(_DIGITS.findall(name) for name in alike), strict=True))
    varying = [k for k, numbers in enumerate(values) if len({int(n) for n in numbers}) > 1]
    literals = _DIGITS.split(alike[0])
    # braces and stars have a meaning in patterns and cannot be used literally
    if re.search(r"[{}*\\]", kind) or len(varying) < 1:
        return NameGuess((), 0, fitting, len(names))
    labels = _labels(literals)
    fields = {
        k: axis for k, axis in labels.items() if k in varying or (axis == "z" and plan_shape and plan_shape[0] > 1)
    }
    if {"y", "x"} <= set(fields.values()) and set(varying) <= set(fields):
        return NameGuess((_template(literals, values, fields),), 0, fitting, len(names))
    if len(varying) == 1:
        return NameGuess((), fitting, fitting, len(names))
    counts = [len({int(n) for n in values[k]}) for k in varying]
    choices = _by_count(varying, counts, plan_shape)
    return NameGuess(tuple(_template(literals, values, found) for found in choices), 0, fitting, len(names))


def _labels(literals: Sequence[str]) -> dict[int, str]:
    """Return the axis of each number, by the word before it; numbers whose axis occurs twice are omitted."""
    words = [match[1].lower() if (match := re.search(r"([A-Za-z]+)[-_= .]?$", text)) else "" for text in literals[:-1]]
    short = _PAIR if {"r", "c"} <= set(words) else {}
    found = {k: axis for k, word in enumerate(words) if (axis := _LABELS.get(word) or short.get(word))}
    return {k: axis for k, axis in found.items() if list(found.values()).count(axis) == 1}


def _by_count(varying: list[int], counts: list[int], plan_shape: Sequence[int] | None) -> list[dict[int, str]]:
    """Return the possible assignments of unnamed numbers to plane, row and column."""
    axes = {2: "yx", 3: "zyx"}.get(len(varying))
    if axes is None:
        return []
    orders = list(permutations(axes))
    if plan_shape is not None:
        wanted = dict(zip("zyx", plan_shape, strict=True))
        orders = [o for o in orders if all(wanted[axis] == n for axis, n in zip(o, counts, strict=True))]
        if len(axes) == 2 and plan_shape[0] != 1:
            orders = []
    return [dict(zip(varying, order, strict=True)) for order in orders]


def _template(literals: Sequence[str], values: Sequence[Sequence[str]], fields: dict[int, str]) -> str:
    parts = [literals[0]]
    for k, literal in enumerate(literals[1:]):
        parts.append(f"{{{fields[k]}}}" if k in fields else values[k][0])
        parts.append(literal)
    return "".join(parts)
