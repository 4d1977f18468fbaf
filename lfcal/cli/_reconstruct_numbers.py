"""Options of ``lfcal reconstruct`` that are a number, or found by lfcal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

__all__ = ["iterations_of", "margin_of", "variance_of"]


def iterations_of(text: str) -> tuple[int, bool, str]:
    """Return the most iterations that ``--iterations`` allows, whether a run stops by itself, and by what.

    ``auto`` stops by left-out pixels, ``auto:NAME`` by another of `STOPS`.
    """
    from lfcal.reconstruct.solvers import MOST_ITERATIONS, STOPS

    ways = {"auto": STOPS[0]} | {f"auto:{name}": name for name in STOPS[1:]}
    count = _number("--iterations", text, 1, "a number", ways)
    return (MOST_ITERATIONS, True, ways[text]) if count is None else (count, False, STOPS[0])


def margin_of(text: str, H: PSFMatrix, shape: tuple[int, int]) -> int:
    """Return the pixels around frames of ``shape`` that ``--margin`` asks for: a number, or ``auto``."""
    from lfcal.reconstruct import usual_margin

    pixels = _number("--margin", text, 0, "a number of pixels", ("auto",))
    return usual_margin(H.period, (H.shape[3], H.shape[4]), shape) if pixels is None else pixels


def variance_of(H: PSFMatrix) -> tuple[float, float] | None:
    """Return variance without light (counts²) and per count (counts) of the frames that H was made from, if stored."""
    from lfcal.psf import noise_of

    found = noise_of(H.provenance)
    return None if found is None or found.slope == 0 else (found.floor, found.slope)


def _number(option: str, text: str, least: int, kind: str, words: Iterable[str]) -> int | None:
    """Return a whole number of at least ``least``; None for one of ``words``."""
    from lfcal.base import InputError

    if text in words:
        return None
    try:
        count = int(text)
    except ValueError:
        raise InputError.expected(option, f"{kind}, or {' or '.join(words)}", repr(text), "correct it") from None
    if count < least:
        raise InputError.expected(option, f"at least {least}, or {' or '.join(words)}", count, "correct it")
    return count
