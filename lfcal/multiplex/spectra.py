"""Tables over wavelength: filters, illuminants, quantum efficiencies, from files or as shipped with their sources."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import FileFormatError, InputError, read_text

__all__ = ["TABLES", "Spectra", "colour_matching", "daylight", "read_spectra", "shipped_spectra"]

Array = NDArray[np.float64]

TABLES = ("filters", "illuminants", "silicon")
"""Tables that ship: filter transmissions R G B C M Y W, illuminants A and D65, quantum efficiency of silicon."""

FOLDER = Path(__file__).with_name("tables")
LARGEST_FILE = 4_000_000


@dataclass(frozen=True, eq=False)
class Spectra:
    """Curves over wavelength.

    Attributes
    ----------
    names
        One per curve.
    wavelengths_nm
        Rising ``(n,)`` (nm).
    values
        ``(len(names), n)``.
    source
        Where the values come from, as the file says.

    Examples
    --------
    >>> from lfcal.multiplex import Spectra
    >>> lamp = Spectra(("lamp",), [400, 500, 700], [[0.2, 1.0, 0.6]], source="data sheet")
    >>> print(lamp.on([450, 600]).round(3))  # nm
    [[0.6 0.8]]
    """

    names: tuple[str, ...]
    wavelengths_nm: Array = field(repr=False)
    values: Array = field(repr=False)
    source: str = ""

    def __post_init__(self) -> None:
        """Check that the parts fit together."""
        waves, values = np.array(self.wavelengths_nm, float), np.array(self.values, float)
        good = waves.ndim == 1 and len(waves) > 1 and np.isfinite(waves).all() and (np.diff(waves) > 0).all()
        if not good or waves[0] <= 0:
            raise InputError.expected(
                "wavelengths (nm)", "two or more rising numbers above 0", waves.shape, "sort them"
            )
        if values.shape != (len(self.names), len(waves)) or not np.isfinite(values).all():
            wanted = f"finite values {(len(self.names), len(waves))}"
            raise InputError.expected("spectra", wanted, values.shape, "one row per name")
        for name, array in (("wavelengths_nm", waves), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def on(self, wavelengths_nm: ArrayLike) -> Array:
        """Return the curves ``(len(names), n)`` at wavelengths (nm), linear between the table's.

        Raises
        ------
        InputError
            If the table does not reach there: nothing is known beyond its ends.
        """
        wanted = np.atleast_1d(np.asarray(wavelengths_nm, float))
        low, high = self.wavelengths_nm[[0, -1]]
        if wanted.min() < low or wanted.max() > high:
            got = f"{wanted.min():g} … {wanted.max():g} nm"
            raise InputError.expected(
                f"wavelengths of {', '.join(self.names)}"[:60],
                f"{low:g} … {high:g} nm",
                got,
                "choose bands within the table",
            )
        return np.stack([np.interp(wanted, self.wavelengths_nm, row) for row in self.values])

    def named(self, name: str) -> Spectra:
        """Return one curve by name."""
        if name not in self.names:
            raise InputError.expected("spectrum", " or ".join(self.names), repr(name), "choose one of these")
        return Spectra((name,), self.wavelengths_nm, self.values[[self.names.index(name)]], self.source)


def read_spectra(path: str | os.PathLike[str]) -> Spectra:
    r"""Read a CSV: a first row ``wavelength_nm,NAME,…``, then numbers; lines that begin with # tell the source.

    Raises
    ------
    FileFormatError
        If it is no such table.
    StorageError
        If there is no such file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.multiplex import read_spectra
    >>> lines = ["# data sheet of 2021", "wavelength_nm,red,green", "500,0.0,0.8", "600,0.9,0.1"]
    >>> _ = Path("filters.csv").write_text("\n".join(lines), encoding="utf-8")
    >>> found = read_spectra("filters.csv")
    >>> print(found.names, found.on(550).round(2).tolist(), found.source)
    ('red', 'green') [[0.45], [0.45]] data sheet of 2021
    """
    file = Path(path)
    text = read_text(file, limit=LARGEST_FILE, foreign=True).lstrip("\ufeff")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    source = " ".join(line.lstrip("# ") for line in lines if line.startswith("#"))
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    try:
        names = tuple(name.strip() for name in rows[0][1:])
        values = np.array([[float(cell) for cell in row] for row in rows[1:]]).T
        if rows[0][0].strip() != "wavelength_nm" or len(values) != len(names) + 1:
            raise ValueError(f"first row {rows[0][:4]}")
        return Spectra(names, values[0], values[1:], source)
    except (ValueError, IndexError, InputError) as error:
        wanted = "a row wavelength_nm,NAME,… and rows of numbers"
        raise FileFormatError.expected(str(file), wanted, str(error)[:80], "correct it") from error


def shipped_spectra(name: str) -> Spectra:
    """Return one of `TABLES`; its `Spectra.source` says what the numbers are.

    Examples
    --------
    >>> from lfcal.multiplex import shipped_spectra
    >>> print(shipped_spectra("illuminants").names, shipped_spectra("silicon").on([450, 550, 650]).round(2))
    ('A', 'D65') [[0.78 0.71 0.48]]
    """
    if name not in TABLES:
        raise InputError.expected("table", " or ".join(TABLES), repr(name), "or read your own with read_spectra")
    return read_spectra(FOLDER / f"{name}.csv")


def daylight(temperature_k: float) -> Spectra:
    """Return CIE daylight of a correlated colour temperature, relative power, 100 at 560 nm (CIE 15).

    ``S0 + M1 S1 + M2 S2`` with M1 and M2 from the chromaticity of the daylight locus. D65 is the one of 6504 K.

    Parameters
    ----------
    temperature_k
        4000 … 25 000 K.
    """
    if not 4000 <= temperature_k <= 25_000:
        raise InputError.expected("colour temperature (K)", "4000 … 25 000", temperature_k, "use illuminant A below")
    t = 1e3 / temperature_k
    x = (
        -4.6070 * t**3 + 2.9678 * t**2 + 0.09911 * t + 0.244063
        if temperature_k <= 7000
        else -2.0064 * t**3 + 1.9018 * t**2 + 0.24748 * t + 0.237040
    )
    y = -3.000 * x * x + 2.870 * x - 0.275
    below = 0.0241 + 0.2562 * x - 0.7341 * y
    m1, m2 = (-1.3515 - 1.7703 * x + 5.9114 * y) / below, (0.0300 - 31.4424 * x + 30.0717 * y) / below
    parts = read_spectra(FOLDER / "daylight_components.csv")
    power = parts.values[0] + m1 * parts.values[1] + m2 * parts.values[2]
    return Spectra((f"D {temperature_k:.0f} K",), parts.wavelengths_nm, power[None], parts.source)


def colour_matching(wavelengths_nm: ArrayLike) -> Array:
    """Return colour matching functions x, y, z ``(3, n)`` as the fit of lobes of Wyman, Sloan and Shirley 2013.

    "Simple Analytic Approximations to the CIE XYZ Color Matching Functions", Journal of Computer Graphics Techniques
    2(2):1, multi-lobe fit to the CIE 1931 observer; its peaks are within 1 % of the tables.
    """
    waves = np.asarray(wavelengths_nm, float)

    def lobe(height: float, middle: float, left: float, right: float) -> Array:
        width = np.where(waves < middle, left, right)
        return np.asarray(height * np.exp(-0.5 * ((waves - middle) / width) ** 2))

    return np.stack(
        [
            lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2),
            lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1),
            lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8),
        ]
    )
