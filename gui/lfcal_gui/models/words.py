"""Words that pages share: planes by their numbers; notes without the command line's options. No Qt."""

from __future__ import annotations

import re

BRACKETS = re.compile(r"\s*\([^()]*--[^()]*\)")
PLANNING = re.compile(r"[:,] (?:or )?make (?:its|the) plan[^;]*lfcal plan[^;]*")
VALUES = re.compile(r"(?<=read as )--[a-z]+ ")
CLAUSES = re.compile(r"; |, (?=--)")


TIMES = re.compile(r"(?<=\d) ?x ?(?=\d)")
ELECTRONS = re.compile(r"(?<=\d )e-(?![\w-])")
UNITS = re.compile(r"(?<=\d) (?=[a-zA-Zµ%°])")
NAMES = re.compile(r"(?<=[a-z])_(?=[a-z])")


def capital(words: str) -> str:
    """Return words that begin with a capital."""
    return words[:1].upper() + words[1:]


def typeset(text: str) -> str:
    """Return ``text`` of the library as a window writes it: times signs, and no names of Python."""
    return NAMES.sub(" ", ELECTRONS.sub("e⁻", TIMES.sub(" × ", text.replace("`", ""))))


def unbroken(text: str) -> str:
    """Return ``text`` whose lines do not end between a number and its unit."""
    return UNITS.sub("\u00a0", text)


def plane_words(z: int, count: int) -> str:
    """Return plane ``z`` of ``count`` in words: planes count from 0, so "1 of 2" would be the last of them."""
    return f"Plane {z} (0 to {count - 1})" if count > 1 else f"Plane {z} (the only one)"


def said_in_window(text: str) -> str:
    """Return one line of ``text`` less the clauses that name options of the command line."""
    first, *others = CLAUSES.split(PLANNING.sub("", BRACKETS.sub("", VALUES.sub("", text))))
    return "; ".join([first, *(part for part in others if "--" not in part)])
