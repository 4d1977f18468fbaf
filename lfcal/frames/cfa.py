"""Colour filter patterns: their phases, channel names, and neighbours of the same colour."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, any_of

__all__ = [
    "cfa_from",
    "channel_names",
    "channel_phase",
    "check_cfa",
    "check_greens",
    "pattern_side",
    "phases",
    "same_colour_offsets",
]

_SIDES = {0: 1, 1: 1, 4: 2, 16: 4, 36: 6}
_LETTERS = "RGBWCMYE"


def check_cfa(cfa: str) -> str:
    """Return ``cfa``; raise `InputError` unless it is empty, or a square pattern in row-major order.

    A square pattern has 1, 4, 16 or 36 of the letters R, G, B, W, C, M, Y and E.
    """
    if not isinstance(cfa, str) or len(cfa) not in _SIDES or any(letter not in _LETTERS for letter in cfa):
        raise InputError.expected(
            "colour filter pattern",
            f"1, 4, 16 or 36 letters from {_LETTERS}",
            repr(cfa),
            'list the letters of one period row by row ("GRBG"), or give "" for a monochrome sensor',
        )
    return cfa


def pattern_side(cfa: str) -> int:
    """Return the period of the pattern in pixels: 1 for monochrome, 2 for Bayer."""
    return _SIDES[len(check_cfa(cfa))]


def cfa_from(cfa: str, origin: tuple[int, int]) -> str:
    """Return the pattern of frames that start at pixel ``origin`` (row, column) of a sensor with pattern ``cfa``."""
    side = pattern_side(cfa)
    places = [((r + origin[0]) % side, (c + origin[1]) % side) for r in range(side) for c in range(side)]
    return "".join(cfa[r * side + c] for r, c in places) if cfa else ""


def phases(cfa: str) -> list[tuple[slice, slice]]:
    """Return, for each position of the pattern in row-major order, the strided slices (rows, columns) of its pixels."""
    side = pattern_side(cfa)
    return [(slice(r, None, side), slice(c, None, side)) for r in range(side) for c in range(side)]


def channel_names(cfa: str) -> tuple[str, ...]:
    """Return a name for each position of the pattern in row-major order: its letter, with a number if it is repeated.

    ``"GRBG"`` becomes ``("G1", "R", "B", "G2")``: G1 is the first green in row-major order.
    """
    names = []
    for k, letter in enumerate(check_cfa(cfa)):
        many = cfa.count(letter) > 1
        names.append(f"{letter}{cfa[: k + 1].count(letter)}" if many else letter)
    return tuple(names)


def channel_phase(cfa: str, channel: str) -> tuple[int, int]:
    """Return the row and the column of ``channel`` in the pattern.

    Raises
    ------
    InputError
        If the pattern is monochrome or has no such channel.
    """
    names = channel_names(cfa)
    if not names:
        wanted = "none for monochrome frames"
        raise InputError.expected("colour channel", wanted, repr(channel), "leave the channel out (--channel)")
    if channel not in names:
        raise InputError.expected("colour channel", any_of(names), repr(channel), "choose one of these")
    return divmod(names.index(channel), pattern_side(cfa))


def same_colour_offsets(cfa: str, reach: int = 2) -> list[list[list[NDArray[np.int32]]]]:
    """Return, for each pattern position ``[row][column]``, its same-colour neighbours in rings of equal distance.

    Each ring is an ``(n, 2)`` array of row and column offsets, nearest ring first. Both offsets are at most ``reach``
    periods of the pattern.
    """
    side = pattern_side(cfa)
    letters = cfa or "W"
    span = range(-reach * side, reach * side + 1)
    table: list[list[list[NDArray[np.int32]]]] = []
    for r in range(side):
        line = []
        for c in range(side):
            rings: dict[int, list[tuple[int, int]]] = {}
            for dr in span:
                for dc in span:
                    same = letters[((r + dr) % side) * side + (c + dc) % side] == letters[r * side + c]
                    if same and (dr or dc):
                        # keyed by squared distance: whole numbers, so equal distances fall into one ring exactly
                        rings.setdefault(dr * dr + dc * dc, []).append((dr, dc))
            line.append([np.array(rings[d], np.int32) for d in sorted(rings)])
        table.append(line)
    return table


def check_greens(frame: NDArray[Any], cfa: str, name: str) -> None:
    """Raise an error if the Bayer tag of a RAW file appears to exchange the greens with red and blue.

    RAW readers do not check this tag. If it is wrong, the supposed greens differ in the brightest 1 % of the 2 x 2
    cells of ``frame`` (the raw mosaic), while the other two colours agree. The error is raised if the difference
    between the greens exceeds both 2.5 times that between the other two colours and 5 % of the mean value of the pixels
    in these cells. Patterns other than Bayer's are not checked. An exchange of red and blue is not detected, and
    neither is a wrong tag in a grey scene. ``name`` is the name of the file in the message.

    Raises
    ------
    FileFormatError
        If the tag appears to exchange the greens with red and blue.
    """
    # RGGB, BGGR, GRBG and GBRG only: other mosaics have no second green in their cells
    if sorted(cfa) != ["B", "G", "G", "R"]:
        return
    # an odd last row or column is not a complete cell
    rows, columns = (n // 2 * 2 for n in frame.shape)
    cells = [frame[r:rows:2, c:columns:2].astype(np.float32) for r in (0, 1) for c in (0, 1)]
    light = cells[0] + cells[1] + cells[2] + cells[3]
    if not light.size or not np.isfinite(light).all():
        return
    # only bright cells: in dark ones all four differ only by noise
    bright = light >= np.percentile(light, 99)
    main, across = (float(np.abs(a - b)[bright].mean()) for a, b in ((cells[0], cells[3]), (cells[1], cells[2])))
    greens, others = (main, across) if cfa[0] == "G" else (across, main)
    # `light` sums four pixels, so 0.0125 of it is 5 % of one
    if greens > 2.5 * others and greens > 0.0125 * float(light[bright].mean()):
        ratio = greens / max(others, 1e-9)
        raise FileFormatError.expected(
            f"{name}, green pixels of {cfa}",
            "similar values at both green pixels of a cell",
            f"a difference {ratio:.1f} times that of the other two pixels",
            "correct the Bayer tag of the file, or the colour filter pattern that was given",
        )
