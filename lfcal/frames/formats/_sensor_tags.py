"""Sensor facts from TIFF/EP and DNG tags: colour filters, black and white level, white balance."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError

__all__ = ["check_pattern", "needs_raw_reader", "sensor_facts"]

CFA, LINEAR = 32803, 34892
"""Photometric interpretations of sensor samples: a mosaic with colour filters, and samples without one."""

_REPEAT, _PATTERN, _EXIF, _EXIF_PATTERN = 33421, 33422, 34665, "CFAPattern"
_COLOURS, _LINEARISATION, _NEUTRAL, _ACTIVE = 50710, 50712, 50728, 50829
_BLACK_REPEAT, _BLACK, _BLACK_SLOPES, _WHITE = 50713, 50714, (50715, 50716), 50717
_LETTERS = "RGBCMYW"
"""Colours by their numbers in a filter pattern."""


def sensor_facts(path: Path, page: Any) -> dict[str, Any]:
    """Return the facts that a page's tags state about its samples, independent of the file's name.

    Parameters
    ----------
    path
        The file, for messages.
    page
        A ``tifffile.TiffPage`` of one sample per pixel.

    Returns
    -------
    dict
        ``cfa`` (pattern by rows), ``black_level`` (a sample value, or one for each position of the pattern),
        ``saturation`` and ``gains`` (one for each position of the pattern), as far as they are stated.

    Raises
    ------
    FileFormatError
        If the samples are a colour mosaic whose pattern is missing or impossible.
    """
    facts: dict[str, Any] = {}
    side, cfa = _pattern(page)
    if int(page.photometric) == CFA and not cfa:
        raise FileFormatError.expected(
            str(path),
            "the pattern of its colour filters (tags CFARepeatPatternDim and CFAPattern)",
            "a colour mosaic (photometric interpretation 32803) without it",
            "add the tags; save frames of a sensor without filters with photometric interpretation 1 (BlackIsZero)",
        )
    if cfa:
        check_pattern(path, cfa)
        facts["cfa"] = cfa
    if (black := _black(page, side, cfa)) is not None:
        facts["black_level"] = black
    white = _numbers(page, _WHITE)
    if white and white[0] > 0:
        facts["saturation"] = white[0]
    neutral = _numbers(page, _NEUTRAL)
    if cfa and len(neutral) == 3 and min(neutral) > 0 and set(cfa) <= set("RGB"):
        facts["gains"] = tuple(neutral[1] / neutral["RGB".index(letter)] for letter in cfa)
    return facts


def needs_raw_reader(page: Any) -> bool:
    """Return whether a camera RAW reader must apply a table or a crop to obtain the sensor's samples."""
    area = _numbers(page, _ACTIVE)
    whole = not area or list(area) == [0, 0, int(page.imagelength), int(page.imagewidth)]
    return not whole or page.tags.get(_LINEARISATION) is not None or any(any(_numbers(page, t)) for t in _BLACK_SLOPES)


def check_pattern(path: Path, cfa: str) -> None:
    """Raise `FileFormatError` for an impossible pattern; the greens of a Bayer pattern must be on a diagonal."""
    known = len(cfa) in (0, 4, 16, 36) and set(cfa) <= set("RGBWCMYE")
    if known and len(cfa) == 4 and set(cfa) <= set("RGB"):
        known = sorted(cfa) == ["B", "G", "G", "R"] and "GG" in (cfa[0] + cfa[3], cfa[1] + cfa[2])
    if not known:
        raise FileFormatError.expected(str(path), "a known colour filter pattern", repr(cfa), "correct the Bayer tag")


def _pattern(page: Any) -> tuple[tuple[int, int], str]:
    """Return rows and columns of the filter pattern, and its letters by rows; empty if none is stated."""
    repeat, places = _numbers(page, _REPEAT), _bytes(page, _PATTERN)
    if not places and int(page.photometric) == CFA and page.tags.get(_EXIF) is not None:
        # Exif stores two numbers, columns and rows, before the colours
        exif = page.tags[_EXIF].value
        stored = exif.get(_EXIF_PATTERN, b"") if isinstance(exif, dict) else b""
        raw = bytes(stored) if isinstance(stored, bytes | tuple | list) else b""
        for order in (">HH", "<HH"):
            columns, rows = struct.unpack(order, raw[:4].ljust(4, b"\0"))
            if rows * columns and len(raw) == 4 + rows * columns:
                repeat, places = (rows, columns), raw[4:]
    if not places or len(repeat) != 2 or repeat[0] * repeat[1] != len(places):
        return (1, 1), ""
    colours = _bytes(page, _COLOURS) or bytes(range(len(_LETTERS)))
    letters = "".join(_LETTERS[p] if p in colours and p < len(_LETTERS) else "?" for p in places)
    return (int(repeat[0]), int(repeat[1])), letters


def _black(page: Any, side: tuple[int, int], cfa: str) -> Any:
    """Return the black level: one for each position of the colour pattern, or one number without a pattern."""
    levels = _numbers(page, _BLACK)
    rows, columns = (int(n) for n in (_numbers(page, _BLACK_REPEAT) or (1, 1)))
    if not levels or rows < 1 or columns < 1 or len(levels) != rows * columns:
        return None
    if not cfa:
        return levels[0] if len(set(levels)) == 1 else None
    if side[0] % rows or side[1] % columns:
        return None
    return tuple(levels[r % rows * columns + c % columns] for r in range(side[0]) for c in range(side[1]))


def _bytes(page: Any, code: int) -> bytes:
    tag = page.tags.get(code)
    value = b"" if tag is None else tag.value
    if isinstance(value, int):
        return bytes([value]) if 0 <= value < 256 else b""
    try:
        return bytes(value)
    except (TypeError, ValueError):
        return b""


def _numbers(page: Any, code: int) -> tuple[float, ...]:
    """Return the numbers of a tag, with fractions evaluated; empty if it is absent or has none."""
    tag = page.tags.get(code)
    if tag is None:
        return ()
    values = tag.value if isinstance(tag.value, tuple | list) else (tag.value,)
    if int(tag.dtype) in (5, 10):  # fractions
        pairs = list(zip(values[::2], values[1::2], strict=False))
        values = tuple(a / b if b else math.nan for a, b in pairs)
    try:
        found = tuple(float(v) for v in values)
    except (TypeError, ValueError):
        return ()
    return found if all(math.isfinite(v) for v in found) else ()
