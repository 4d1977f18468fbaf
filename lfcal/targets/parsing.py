"""Targets in words, as the command line takes them."""

from __future__ import annotations

import math
import re

from lfcal.base import InputError
from lfcal.targets.pose import length_um
from lfcal.targets.target import Target

__all__ = ["parse_target", "proposed_hole", "target_words"]

EXAMPLE = "for example array:12x12@1.2mm,hole=20um or array:12x12@1.2mm,hex"


def parse_target(text: str) -> Target:
    """Return the target of ``"point"``, ``"point,hole=50um"`` or ``"array:ROWSxCOLUMNS@PITCH"``.

    An array's pitch is one length, or ``ROWxCOLUMN`` for rows and columns; lengths are in µm unless they end in mm.
    Then may follow, after commas: ``hex``, ``hole=20um``, ``absent=0:0+0:1`` (rows and columns of holes left out).
    A hexagonal array has one pitch, that of neighbouring holes.

    Raises
    ------
    InputError
        If it is none of these.

    Examples
    --------
    >>> from lfcal.targets import parse_target
    >>> target = parse_target("array:12x10@1.2mm,hex,hole=20um")
    >>> print(len(target.holes), "holes, rows", round(target.pitch_um[0]), "µm apart")
    120 holes, rows 1039 µm apart
    """
    head, *more = (part.strip() for part in text.strip().split(","))
    hexagonal, hole, absent = _settings(more)
    if head == "point":
        if hexagonal or absent:
            raise _wrong(text)
        return Target(hole_um=hole)
    match = re.fullmatch(r"array:(\d{1,6})[x×](\d{1,6})@([^x×]+)(?:[x×]([^x×]+))?", head)
    if match is None or (hexagonal and match[4]):
        raise _wrong(text)
    along = length_um(match[4] or match[3])
    across = along * math.sqrt(3) / 2 if hexagonal else length_um(match[3])
    kind = "hexagonal" if hexagonal else "square"
    return Target(kind, (int(match[1]), int(match[2])), (across, along), hole, absent)


def proposed_hole(text: str) -> float | None:
    """Return the holes' diameter (µm) of ``"array"`` or ``"array,hole=20um"``, whose pitch is wanted; else None."""
    head, *more = (part.strip() for part in text.strip().split(","))
    if head != "array":
        return None
    hexagonal, hole, absent = _settings(more)
    if hexagonal or absent:
        raise InputError.expected("target", "array or array,hole=20um where the pitch is proposed", repr(text), EXAMPLE)
    return hole


def _settings(parts: list[str]) -> tuple[bool, float, tuple[tuple[int, int], ...]]:
    hexagonal, hole = False, 0.0
    absent: tuple[tuple[int, int], ...] = ()
    names = [part.partition("=")[0] for part in parts]
    if len(set(names)) < len(names):
        raise InputError.expected("target", "each setting once", ", ".join(names), EXAMPLE)
    for part in parts:
        name, _, value = part.partition("=")
        if part == "hex":
            hexagonal = True
        elif name == "hole" and value:
            hole = length_um(value)
        elif name == "absent" and re.fullmatch(r"\d{1,6}:\d{1,6}(\+\d{1,6}:\d{1,6})*", value):
            pairs = (pair.split(":") for pair in value.split("+"))
            absent = tuple((int(row), int(column)) for row, column in pairs)
        else:
            raise InputError.expected("target", "hex, hole=LENGTH or absent=ROW:COLUMN+…", repr(part), EXAMPLE)
    return hexagonal, hole, absent


def _wrong(text: str) -> InputError:
    return InputError.expected("target", "point or array:ROWSxCOLUMNS@PITCH", repr(text), EXAMPLE)


def target_words(target: Target) -> str:
    """Return the words that `parse_target` makes the same target of, its pose left out.

    Examples
    --------
    >>> from lfcal.targets import Target, target_words
    >>> print(target_words(Target("square", (12, 10), (1200.0, 1500.0), absent=((0, 0), (0, 1)))))
    array:12x10@1200umx1500um,absent=0:0+0:1
    """
    hole = [f"hole={target.hole_um:.10g}um"] if target.hole_um else []
    marks = ["absent=" + "+".join(f"{row}:{column}" for row, column in target.absent)] if target.absent else []
    if target.kind == "point":
        return ",".join(["point", *hole])
    (rows, columns), (across, along) = target.shape, target.pitch_um
    pitch = f"{along:.10g}um" if target.kind == "hexagonal" or across == along else f"{across:.10g}umx{along:.10g}um"
    kind = ["hex"] if target.kind == "hexagonal" else []
    return ",".join([f"array:{rows}x{columns}@{pitch}", *kind, *hole, *marks])
