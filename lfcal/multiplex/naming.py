"""Create modulators from names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lfcal.base import InputError, any_of
from lfcal.multiplex.colour_filters import cfa
from lfcal.multiplex.exposures import camera_array, coded_shutter, neutral_density
from lfcal.multiplex.masks import MASKS, mask
from lfcal.multiplex.matrix_file import MATRIX_SUFFIXES, load_modulator
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.polarisation import polarisers
from lfcal.multiplex.spectra import TABLES, Spectra, read_spectra, shipped_spectra, spectral_array

__all__ = ["GRAMMAR", "is_whole", "modulator_of"]

GRAMMAR = (
    "Bayer, RG/GB, MURA:11, lenslet:5, nd:1,0.25/0.0625,0.25, polarisers:0,45/135,90, bands:RG/GB:3, "
    "shutter:100,010/001,111, cameras:2x2, FILE.npy, FILE.json, or several of these joined by *"
)
"""Examples of names, for messages."""

BAND_TABLES = ("filters", "efficiency", "illuminant")
"""Tables that ``bands:`` accepts: files for `read_spectra`, or those included in lfcal (silicon, A, D65)."""


def is_whole(text: str) -> bool:
    """Return whether a text consists of one to nine ASCII digits."""
    return text.isascii() and text.isdigit() and len(text) < 10


def modulator_of(text: str) -> Modulator:
    """Return the modulator for a name or a matrix file, or the product of several of these joined by ``*``.

    `GRAMMAR` contains examples of names. Slashes separate the rows of a super-pixel, and commas the pixels of a row.
    ``nd:`` is followed by transmissions, ``polarisers:`` by angles in degrees, and ``shutter:`` by a digit for each
    time interval at each pixel: 0 for closed, 1 for open. ``bands:PATTERN:N`` uses the included model filters and
    silicon sensor for N bands between 400 and 700 nm. Other tables (`spectral_array`, `read_spectra`) are given as in
    ``bands:RG/GB:3:filters=own.csv,efficiency=sensor.csv,illuminant=D65``. ``cameras:2x2`` is an array of cameras. A
    mask or lenslet without a size has 11 pixels along each side.

    Examples
    --------
    >>> from lfcal.multiplex import modulator_of
    >>> for text in ("RG/GB", "polarisers:0,45/135,90", "lenslet:5*Bayer"):
    ...     found = modulator_of(text)
    ...     print(f"{found.name}: {found.side} pixels, {found.count} samples, rank {found.rank()}")
    Bayer: (2, 2) pixels, 3 samples, rank 3
    polarisers 0°/45°/135°/90°: (2, 2) pixels, 3 samples, rank 3
    lenslet x Bayer: (10, 10) pixels, 75 samples, rank 75
    """
    if "*" in text:
        first, second = text.rsplit("*", 1)
        return modulator_of(first) * modulator_of(second)
    written = text.strip()
    if written.lower().endswith(MATRIX_SUFFIXES):
        return load_modulator(written)
    kind, _, rest = written.partition(":")
    word = kind.strip().lower().replace("-", "_").replace(" ", "_")
    if word in _READERS and rest:
        return _READERS[word](rest)
    found = {m.lower(): m for m in MASKS}.get(word)
    if found is None:
        if ":" in written:
            raise InputError.expected("modulator", GRAMMAR, repr(text)[:60], "write the name like one of these")
        return cfa(written)
    if ":" in written and not is_whole(rest.strip()):
        raise InputError.expected(
            f"size of {found} (px)", "a whole number", repr(rest), "write the name, a colon and the size: MURA:11"
        )
    return mask(found, int(rest or 11))


def _table(what: str, text: str) -> Any:
    try:
        return np.array([[float(cell) for cell in row.split(",")] for row in text.split("/")])
    except ValueError as error:
        raise InputError.expected(
            what, "rows of equally many numbers", repr(text)[:60], "write it in this form: 1,0.25/0.5,1"
        ) from error


def _bands(text: str) -> Modulator:
    pattern, _, rest = text.partition(":")
    count, _, given = rest.partition(":")
    if not is_whole(count):
        raise InputError.expected(
            "bands", "a pattern and a number of bands", repr(text)[:60], "write it in this form: bands:RG/GB:3"
        )
    tables: dict[str, Spectra] = {}
    for words in filter(None, given.split(",")):
        what, _, table = (word.strip() for word in words.partition("="))
        if what not in BAND_TABLES or what in tables or not table:
            wanted = any_of(f"{name}=FILE.csv" for name in BAND_TABLES)
            raise InputError.expected(
                "spectra of the bands", wanted, repr(words)[:60], "give each file once, separated by commas"
            )
        tables[what] = _spectra(table)
    tables.setdefault("efficiency", shipped_spectra("silicon"))
    filters, efficiency, illuminant = (tables.get(what) for what in BAND_TABLES)
    return spectral_array(pattern, int(count), filters=filters, efficiency=efficiency, illuminant=illuminant)


def _spectra(text: str) -> Spectra:
    """Return the table in a file, or the included table or illuminant of this name."""
    illuminants = shipped_spectra("illuminants")
    if text.upper() in illuminants.names:
        return illuminants.named(text.upper())
    return shipped_spectra(text) if text in TABLES else read_spectra(text)


def _shutter(text: str) -> Modulator:
    rows = [row.split(",") for row in text.split("/")]
    lengths = {len(pixel) for row in rows for pixel in row}
    if set(text) - set("01,/") or len({len(row) for row in rows}) != 1 or len(lengths) != 1:
        raise InputError.expected(
            "shutter", "rows of equally many digits 0 and 1", repr(text)[:60], "write it in this form: 100,010/001,111"
        )
    return coded_shutter([[[float(c) for c in pixel] for pixel in row] for row in rows])


def _cameras(text: str) -> Modulator:
    rows, _, columns = text.partition("x")
    if not (is_whole(rows) and is_whole(columns)):
        raise InputError.expected("cameras", "ROWSxCOLUMNS", repr(text)[:60], "write it in this form: cameras:2x2")
    return camera_array(int(rows), int(columns))


_READERS: dict[str, Callable[[str], Modulator]] = {
    "nd": lambda text: neutral_density(_table("exposures", text)),
    "polarisers": lambda text: polarisers(_table("angles of polarisers", text)),
    "bands": _bands,
    "shutter": _shutter,
    "cameras": _cameras,
}
