"""The pattern of file names that nobody has given: which number in them is the plane, the row and the column."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

__all__ = ["NameGuess", "guess_pattern"]

_LABELS = {
    **dict.fromkeys(("x", "col", "column", "ix", "posx"), "x"),
    **dict.fromkeys(("y", "row", "iy", "posy"), "y"),
    **dict.fromkeys(("z", "plane", "slice", "depth", "iz", "posz"), "z"),
}
_PAIR = {"r": "y", "c": "x"}
"""Short for row and column, where both occur."""

_DIGITS = re.compile(r"[0-9]+")


@dataclass(frozen=True)
class NameGuess:
    """What file names look like.

    Attributes
    ----------
    templates
        Patterns that fit them, as `lfcal.frames.NamePattern` takes them: one where there is no doubt; several where
        the numbers have no names and the scan does not tell them apart; none where names hold no position.
    numbered
        Files that differ in one number alone: a scan order fits these.
    fitting, names
        How many names are of this kind, and how many there are.
    """

    templates: tuple[str, ...]
    numbered: int
    fitting: int
    names: int

    @property
    def certain(self) -> bool:
        """Whether one pattern fits every name."""
        return len(self.templates) == 1 and self.fitting == self.names


def guess_pattern(names: Sequence[str], plan_shape: Sequence[int] | None = None) -> NameGuess:
    """Return the pattern that ``names`` follow.

    Numbers are told by the word before them (``x012``, ``row-3``, ``plane1``). Those without such a word are told by
    how many values they take, where the scan has as many planes, rows and columns and no two of these are equal.

    Parameters
    ----------
    names
        Relative paths of image files.
    plan_shape
        Positions of the scan ``(nz, ny, nx)``, where known.
    """
    kinds = Counter(_DIGITS.sub("#", name) for name in names)
    if not kinds:
        return NameGuess((), 0, 0, 0)
    kind, fitting = kinds.most_common(1)[0]
    alike = [name for name in names if _DIGITS.sub("#", name) == kind]
    values = list(zip(*(_DIGITS.findall(name) for name in alike), strict=True))
    varying = [k for k, numbers in enumerate(values) if len({int(n) for n in numbers}) > 1]
    literals = _DIGITS.split(alike[0])
    # braces and stars have a meaning in patterns and cannot stand for themselves
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
    """Return which number stands for which axis by the word before it; a word that occurs again tells nothing."""
    words = [match[1].lower() if (match := re.search(r"([A-Za-z]+)[-_= .]?$", text)) else "" for text in literals[:-1]]
    short = _PAIR if {"r", "c"} <= set(words) else {}
    found = {k: axis for k, word in enumerate(words) if (axis := _LABELS.get(word) or short.get(word))}
    return {k: axis for k, axis in found.items() if list(found.values()).count(axis) == 1}


def _by_count(varying: list[int], counts: list[int], plan_shape: Sequence[int] | None) -> list[dict[int, str]]:
    """Return the ways in which unnamed numbers can be plane, row and column."""
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
