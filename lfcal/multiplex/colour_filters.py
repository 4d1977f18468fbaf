"""Colour filter arrays as modulators: common ones, and any pattern in letters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from lfcal.base import InputError, check_tuple
from lfcal.multiplex.modulator import Modulator

__all__ = ["CFA_PATTERNS", "FILTERS", "cfa", "parse_pattern"]

FILTERS: Mapping[str, tuple[float, float, float]] = {
    "R": (1, 0, 0),
    "G": (0, 1, 0),
    "B": (0, 0, 1),
    "C": (0, 1, 1),
    "M": (1, 0, 1),
    "Y": (1, 1, 0),
    "W": (1, 1, 1),
    "E": (0, 1, 1),
}
"""Transmissions of ideal filters for red, green and blue; emerald is assumed to be ideal cyan."""

CFA_PATTERNS: Mapping[str, str] = {
    "Bayer": "RG/GB",
    "CYMG": "CY/MG",
    "CYYM": "CY/YM",
    "Sony": "RG/EB",
    "RGBW": "RG/BW",
    "RGBW 4x4": "WBWG/BWGW/WGWR/GWRW",
    "CMYW": "CM/YW",
    "X-Trans": "GBGGRG/RGRBGB/GBGGRG/GRGGBG/BGBRGR/GRGGBG",
}
"""Patterns as rows of letters, separated by slashes. ``RGBW 4x4`` is the pattern of Kodak, half of it clear.

A name that consists of filter letters, such as ``RGBE``, has this layout. Sony's pattern has emerald instead of the
second green of a Bayer pattern.
"""

MAX_SIDE = 16


def parse_pattern(pattern: str, filters: Mapping[str, Sequence[float]] = FILTERS) -> list[str]:
    """Return the letters of the filters in each row of a pattern.

    The pattern is a name in `CFA_PATTERNS`, rows separated by slashes, or the letters of a square in row-major order.
    The keys of ``filters`` are the letters allowed.

    Raises
    ------
    InputError
        If a letter is not a key of ``filters``, or the rows have different lengths. Also if the letters of a pattern
        without slashes do not fill a square, or a side of the pattern exceeds 16 filters.
    """
    if not isinstance(pattern, str):
        raise InputError.expected(
            "colour filter pattern",
            "letters that name filters",
            repr(pattern)[:60],
            'write the letters of each row, with / between rows: "RG/GB"',
        )
    wanted = "".join(pattern.lower().split()).replace("-", "").replace("×", "x")
    known = {"".join(name.lower().split()).replace("-", ""): rows for name, rows in CFA_PATTERNS.items()}
    known |= {"rgbw2x2": CFA_PATTERNS["RGBW"], "rgbw4": CFA_PATTERNS["RGBW 4x4"]}
    text = known.get(wanted) or "".join(pattern.upper().split())
    rows = text.split("/")
    if len(rows) == 1:
        side = math.isqrt(len(text))
        if side * side == len(text):
            rows = [text[k : k + side] for k in range(0, len(text), side or 1)]
    letters = set("".join(rows))
    filters_only = letters <= set(filters)
    row = filters_only and len(rows) == 1 and len(rows[0]) > 1  # letters of no square
    if row or not filters_only or len({len(r) for r in rows}) != 1 or not rows[0]:
        raise InputError.expected(
            "colour filter pattern",
            f"{', '.join(CFA_PATTERNS)}, or rows of equal length of the letters {''.join(filters)}",
            repr(pattern),
            f'write stripes as "{rows[0]}/{rows[0]}"'
            if row and len(text) <= MAX_SIDE
            else 'write the letters of each row, with / between rows: "RG/GB"',
        )
    if max(len(rows), len(rows[0])) > MAX_SIDE:
        raise InputError.expected(
            "colour filter pattern",
            f"up to {MAX_SIDE} x {MAX_SIDE} filters",
            f"{len(rows)} x {len(rows[0])}",
            "give one period of the pattern",
        )
    return rows


def cfa(pattern: str, *, filters: Mapping[str, Sequence[float]] | None = None) -> Modulator:
    """Return the modulator of a colour filter array over red, green and blue (Ihrke et al., section 4.1).

    The matrix Sigma has one column for each kind of filter: 1 at the pixels with this filter, else 0. The matrix Pi
    contains the transmissions of the filters (see `Modulator`).

    Parameters
    ----------
    pattern
        ``"Bayer"``, ``"CYMG"``, ``"CYYM"``, ``"Sony"``, ``"RGBW"``, ``"RGBW 4x4"``, ``"CMYW"``, ``"X-Trans"``, or
        letters of `FILTERS` in row-major order, such as ``"GRBG"`` or ``"RGB/GBR"``.
    filters
        Additional or replacement filters: mapping from letters to transmissions (red, green, blue), 0 to 1.

    Raises
    ------
    InputError
        If the pattern cannot be read, or a filter does not consist of three transmissions.

    Examples
    --------
    >>> from lfcal.multiplex import cfa
    >>> print(cfa("Bayer").matrix)  # a row of red, green, blue for each pixel
    [[1. 0. 0.]
     [0. 1. 0.]
     [0. 1. 0.]
     [0. 0. 1.]]
    >>> print(cfa("RGB/GBR").side, cfa("RS/GB", filters={"S": (0.2, 0.2, 0.2)}).rank())
    (2, 3) 3
    """
    known = dict(FILTERS)
    for letter, shares in (filters or {}).items():
        known[str(letter).upper()] = check_tuple(f"filter {letter}", tuple(shares), 3, at_least=0, at_most=1)
    rows = parse_pattern(pattern, known)
    letters = "".join(rows)
    kinds = sorted(set(letters), key=letters.index)
    spatial = np.array([[float(letter == kind) for kind in kinds] for letter in letters])
    plenoptic = np.array([known[kind] for kind in kinds], float).T
    return Modulator(_name(pattern, rows), (len(rows), len(rows[0])), spatial, plenoptic, colours=("R", "G", "B"))


def _name(pattern: str, rows: list[str]) -> str:
    text = "/".join(rows)
    return next((name for name, known in CFA_PATTERNS.items() if known == text), pattern)
