"""Text functions shared by pages: names of planes, messages without command-line options. No Qt."""

from __future__ import annotations

import re

from lfcal.base import format_seconds

BRACKETS = re.compile(r"\s*\([^()]*--[^()]*\)")
PLANNING = re.compile(r"[:,] (?:or )?make (?:its|the) plan[^;]*lfcal plan[^;]*")
VALUES = re.compile(r"(?<=read as )--[a-z]+ ")
CLAUSES = re.compile(r"; |, (?=--)")


TIMES = re.compile(r"(?<=\d) ?x ?(?=\d)")
ELECTRONS = re.compile(r"(?<=\d )e-(?![\w-])")
SPACE = "\u00a0"
"""Space at which a line is not broken."""

UNITS = re.compile(r"(?<=\d) (?=[a-zA-Zµ%°])")
TIMES_OF = re.compile(rf"({SPACE}(?:d|h|min)) (?=\d)")
SIGNS = re.compile(r"([≤≥<>≈=±]) (?=[-+−]?\d)")
PRODUCTS = re.compile(r"(?<=\d) ([×x]) (?=\d)")
MINUS = re.compile(r"<[^>]*>|(?<![\w.,)\]/-])-(?=\.?\d)")
NAMES = re.compile(r"(?<=[a-z])_(?=[a-z])")


def capital(words: str) -> str:
    """Return ``words`` with a capital first letter."""
    return words[:1].upper() + words[1:]


def typeset(text: str) -> str:
    """Return ``text`` of the library for the window: with × signs, and without Python names."""
    return NAMES.sub(" ", ELECTRONS.sub("e⁻", TIMES.sub(" × ", text.replace("`", ""))))


def unbroken(text: str) -> str:
    """Return ``text`` with no line break between a number and its unit or sign, or within 4 min 19 s or 95 × 55."""
    joined = TIMES_OF.sub(rf"\1{SPACE}", UNITS.sub(SPACE, text))
    return PRODUCTS.sub(rf"{SPACE}\1{SPACE}", SIGNS.sub(rf"\1{SPACE}", joined))


def minus(text: str) -> str:
    """Return ``text`` for display, with minus signs in place of the hyphens of negative numbers."""
    return MINUS.sub(lambda found: "−" if found[0] == "-" else found[0], text) if "-" in text else text


def rough_seconds(seconds: float, about: str = "about ") -> str:
    """Return a forecast as text, with as many digits as it is accurate."""
    if seconds < 1:
        return "less than 1 s"
    return about + (f"{seconds:.0f} s" if seconds < 10 else format_seconds(seconds))


def plane_words(z: int, count: int) -> str:
    """Return the name of plane ``z`` of ``count``; numbers start at 0, so "1 of 2" would be the last one."""
    return f"Plane {z} (0 to {count - 1})" if count > 1 else f"Plane {z} (the only one)"


def said_in_window(text: str) -> str:
    """Return ``text`` as one line without the clauses that name command-line options."""
    first, *others = CLAUSES.split(PLANNING.sub("", BRACKETS.sub("", VALUES.sub("", text))))
    return "; ".join([first, *(part for part in others if "--" not in part)])
