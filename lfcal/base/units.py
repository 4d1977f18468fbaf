"""Numbers with units as readable text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from datetime import datetime

__all__ = [
    "format_bytes",
    "format_count",
    "format_dates",
    "format_length",
    "format_number",
    "format_pixels",
    "format_plane",
    "format_seconds",
    "format_share",
    "format_slope",
    "format_span",
]


def format_bytes(n: float) -> str:
    """Return ``n`` bytes as text in decimal units, such as ``'685.0 MB'``."""
    value = float(n)
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if abs(value) < 1000 or unit == "TB":
            return f"{value:.0f} {unit}" if unit == "B" else f"{value:.1f} {unit}"
        value /= 1000
    raise AssertionError("unreachable")


def format_seconds(seconds: float) -> str:
    """Return a duration as text, such as ``'2 h 05 min'``, ``'42 s'`` or ``'3.1 ms'``."""
    if seconds < 1e-3:
        return f"{seconds * 1e6:.0f} µs"
    if seconds < 1:
        return f"{seconds * 1e3:.3g} ms"
    if seconds < 10:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def format_span(seconds: float) -> str:
    """Return a time span as text: in days if it is at least two days (``'5.3 days'``), else as in `format_seconds`."""
    return f"{seconds / 86400:.1f} days" if seconds >= 2 * 86400 else format_seconds(seconds)


def format_slope(slope: float, span_s: float, error: float | None = None) -> str:
    """Return the slope of values over time as text, without a unit; if it is NaN, return the time span.

    Parameters
    ----------
    slope, error
        The slope and its standard error; None if the error is unknown.
    span_s
        Time from the first value to the last (s); NaN if there are fewer than two values.

    Returns
    -------
    str
        ``'+0.12'``, ``'+0.12 ± 0.01'`` or ``'within 6 h 00 min'``; empty if neither slope nor time span is known.
    """
    if math.isfinite(slope):
        return f"{slope:+.2g}" if error is None else f"{slope:+.2g} ± {error:.1g}"
    return f"within {format_span(span_s)}" if span_s > 0 else ""


def format_dates(first: datetime, last: datetime) -> str:
    """Return a range of days as text, such as ``'2026-05-01 to 2026-06-01'``, or a single day."""
    days = dict.fromkeys(f"{one:%Y-%m-%d}" for one in (first, last))
    return " to ".join(days)


def format_length(um: float) -> str:
    """Return a length (µm) as text in a suitable unit, such as ``'250 mm'``."""
    size = abs(um)
    if size >= 1e6:
        return f"{um / 1e6:.4g} m"
    if size >= 1e3:
        return f"{um / 1e3:.4g} mm"
    if size >= 1 or size == 0:
        return f"{um:.4g} µm"
    return f"{um * 1e3:.4g} nm"


def format_plane(depth_um: float, z: int, name: str = "") -> str:
    """Return the depth (µm) of a plane as text, or ``'plane 3'`` with its index ``z`` if the depth is NaN.

    With ``name``, a depth has the form ``'name = 250 µm'``.
    """
    if math.isnan(depth_um):
        return f"plane {z}"
    return f"{name} = {format_length(depth_um)}" if name else format_length(depth_um)


def format_number(value: float, digits: int = 3) -> str:
    """Return a number with ``digits`` significant digits as text, such as ``'0.35'``.

    Between 1000 and a million, the text has thousands separators, such as ``'49,400'``.
    """
    if not 1e3 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return f"{float(f'{value:.{digits}g}'):,.0f}"


def format_pixels(shape: Sequence[int]) -> str:
    """Return the shape ``(rows, columns)`` of an image as text, such as ``'480 x 640 px'``."""
    return f"{' x '.join(map(str, shape))} px"


def format_count(many: int, one: str, several: str) -> str:
    """Return a count with its noun in the singular or plural: ``1 position``, ``1,254 positions``."""
    return f"{many:,} {one if many == 1 else several}"


def format_share(share: float, among: Iterable[float] = ()) -> str:
    """Return a fraction in per cent as text, with two significant digits or, from 100 % on, as a whole number.

    Examples are ``'0.35 %'`` and ``'140 %'``. The text has up to six digits if they are needed to distinguish it from
    the fractions ``among``.

    Examples
    --------
    >>> from lfcal.base import format_share
    >>> format_share(0.0103), format_share(0.0103, among=(0.01, 0.5))
    ('1 %', '1.03 %')
    """
    exact = _percent(share, 6)
    others = [one for one in among if _percent(one, 6) != exact]
    digits = next(n for n in range(2, 7) if _percent(share, n) not in {_percent(one, n) for one in others})
    return _percent(share, digits)


def _percent(share: float, digits: int) -> str:
    percent = 100 * share
    whole = len(f"{abs(percent):.0f}") >= max(3, digits)
    return f"{percent:.0f} %" if whole else f"{percent:.{digits}g} %"
