"""Notes and refusals of the intake without the command line's options, which the window has widgets for. No Qt."""

from __future__ import annotations

import re

__all__ = ["said_in_window"]

BRACKETS = re.compile(r"\s*\([^()]*--[^()]*\)")
PLANNING = re.compile(r"[:,] (?:or )?make (?:its|the) plan[^;]*lfcal plan[^;]*")
VALUES = re.compile(r"(?<=read as )--[a-z]+ ")
CLAUSES = re.compile(r"; |, (?=--)")


def said_in_window(text: str) -> str:
    """Return one line of ``text`` less the clauses that name options of the command line."""
    first, *others = CLAUSES.split(PLANNING.sub("", BRACKETS.sub("", VALUES.sub("", text))))
    return "; ".join([first, *(part for part in others if "--" not in part)])
