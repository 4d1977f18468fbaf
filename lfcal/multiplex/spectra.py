"""Filter arrays for any number of spectral bands, from curves over wavelength.

Tables of filters, illuminants and quantum efficiencies are read from files, or are included in lfcal.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import FileFormatError, InputError, any_of, array_words, check_number, check_tuple, read_text
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator

__all__ = [
    "TABLES",
    "Spectra",
    "bandpass_filters",
    "colour_matching",
    "cosine_basis",
    "daylight",
    "read_spectra",
    "shipped_spectra",
    "spectral_array",
]

Array = NDArray[np.float64]

TABLES = ("filters", "illuminants", "silicon")
"""Included tables: filter transmissions R G B C M Y W, illuminants A and D65, quantum efficiency of silicon."""

FOLDER = Path(__file__).with_name("tables")
LARGEST_FILE = 4_000_000


@dataclass(frozen=True, eq=False)
class Spectra:
    """Curves tabulated as a function of wavelength, such as the transmissions of filters.

    Attributes
    ----------
    names
        Names of the curves.
    wavelengths_nm
        Wavelengths in increasing order, ``(n,)`` (nm).
    values
        Values of the curves, ``(len(names), n)``.
    source
        Origin of the values, as stated in the file.

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
                "wavelengths (nm)",
                "two or more increasing numbers above 0",
                array_words(waves),
                "give the wavelengths in increasing order",
            )
        if values.shape != (len(self.names), len(waves)) or not np.isfinite(values).all():
            wanted = f"finite values of shape {(len(self.names), len(waves))}"
            raise InputError.expected("spectra", wanted, array_words(values), "give one row of numbers per name")
        for name, array in (("wavelengths_nm", waves), ("values", values)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def on(self, wavelengths_nm: ArrayLike) -> Array:
        """Return the curves at n wavelengths ``wavelengths_nm`` by linear interpolation, ``(len(names), n)``.

        Raises
        ------
        InputError
            If a wavelength is outside the range of the table.
        """
        wanted = np.atleast_1d(np.asarray(wavelengths_nm, float))
        low, high = self.wavelengths_nm[[0, -1]]
        if wanted.min() < low or wanted.max() > high:
            got = f"{wanted.min():g} … {wanted.max():g} nm"
            raise InputError.expected(
                f"wavelengths of {', '.join(self.names)}"[:60],
                f"{low:g} … {high:g} nm",
                got,
                "choose wavelengths within this range",
            )
        return np.stack([np.interp(wanted, self.wavelengths_nm, row) for row in self.values])

    def named(self, name: str) -> Spectra:
        """Return a table that contains only the curve called ``name``."""
        if name not in self.names:
            raise InputError.expected("spectrum", any_of(self.names), repr(name), "choose one of these")
        return Spectra((name,), self.wavelengths_nm, self.values[[self.names.index(name)]], self.source)


def read_spectra(path: str | os.PathLike[str]) -> Spectra:
    r"""Read the curves in a CSV file.

    The header is ``wavelength_nm,NAME,…``, with a name for each curve, and is followed by rows of numbers. Lines that
    begin with ``#`` state the origin of the values.

    Raises
    ------
    FileFormatError
        If the file is not such a table.
    StorageError
        If the file does not exist.

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
        wanted = "a header row wavelength_nm,NAME,… followed by rows of numbers"
        raise FileFormatError.expected(str(file), wanted, str(error)[:80], "correct the file") from error


def shipped_spectra(name: str) -> Spectra:
    """Return the included table ``name``, one of `TABLES`; its `Spectra.source` states the origin of the values.

    Examples
    --------
    >>> from lfcal.multiplex import shipped_spectra
    >>> print(shipped_spectra("illuminants").names, shipped_spectra("silicon").on([450, 550, 650]).round(2))
    ('A', 'D65') [[0.78 0.71 0.48]]
    """
    if name not in TABLES:
        raise InputError.expected(
            "included spectra", any_of(TABLES), repr(name), "choose one of these, or read a file with read_spectra"
        )
    return read_spectra(FOLDER / f"{name}.csv")


def daylight(temperature_k: float) -> Spectra:
    """Return the relative power of CIE daylight at a correlated colour temperature, 100 at 560 nm (CIE 15).

    The power is ``S0 + M1 S1 + M2 S2`` with the tabulated CIE components S0, S1 and S2; M1 and M2 follow from the
    chromaticity of the daylight locus. D65 is daylight at 6504 K.

    Parameters
    ----------
    temperature_k
        Correlated colour temperature, 4000 … 25 000 K.
    """
    if not 4000 <= temperature_k <= 25_000:
        raise InputError.expected(
            "colour temperature (K)", "4000 to 25 000", temperature_k, "use illuminant A for lower temperatures"
        )
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
    """Return the colour matching functions x, y, z ``(3, n)`` at wavelengths in nm.

    This is the multi-lobe fit to the CIE 1931 observer by Wyman, Sloan and Shirley (2013), "Simple Analytic
    Approximations to the CIE XYZ Color Matching Functions", Journal of Computer Graphics Techniques 2(2):1. The peaks
    agree with the tabulated values to 1 %.
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


VISIBLE_NM = (400.0, 700.0)
POINTS = 16
"""Number of wavelengths for the mean over each band."""


def band_edges(bands: int | Sequence[float]) -> Array:
    """Return the edges of spectral bands in increasing order (nm).

    ``bands`` is the number of equally wide bands between 400 and 700 nm, or the edges themselves, which are checked.
    """
    if isinstance(bands, int | np.integer) and not isinstance(bands, bool):
        check_number("number of spectral bands", int(bands), at_least=1, at_most=MAX_SAMPLES, integer=True)
        return np.linspace(*VISIBLE_NM, int(bands) + 1)
    edges = np.array(check_tuple("edges of the bands (nm)", tuple(np.asarray(bands, float).tolist()), above=0))
    if len(edges) < 2 or (np.diff(edges) <= 0).any():
        raise InputError.expected(
            "edges of the bands (nm)",
            "two or more increasing numbers",
            ", ".join(f"{edge:g}" for edge in edges),
            "list the edges in increasing order, without repetition",
        )
    return edges


def bandpass_filters(middles_nm: ArrayLike, width_nm: float) -> Spectra:
    """Return Gaussian band-pass filters F0, F1, … with a peak transmission of 1, tabulated from 300 to 1100 nm.

    ``middles_nm`` contains their centre wavelengths (nm), and ``width_nm`` is their full width at half maximum (nm).

    Examples
    --------
    >>> from lfcal.multiplex import bandpass_filters
    >>> filters = bandpass_filters([500, 600], width_nm=40)
    >>> print(filters.names, filters.on([480, 500, 600]).round(3).tolist())  # 0.5 at half the width from the centre
    ('F0', 'F1') [[0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    middles = np.atleast_1d(np.asarray(middles_nm, float))
    check_number("width of the filters (nm)", width_nm, above=0)
    waves = np.arange(300.0, 1101.0, 2.0)
    values = np.exp(-4 * np.log(2) * ((waves - middles[:, None]) / width_nm) ** 2)
    return Spectra(tuple(f"F{k}" for k in range(len(middles))), waves, values, f"Gaussians {width_nm:g} nm wide")


def cosine_basis(bands: int, count: int) -> Array:
    """Return the ``count`` lowest-frequency cosines over ``bands`` bands as columns, ``(bands, count)``.

    The reflectance spectra of most surfaces are approximately equal to linear combinations of these columns. In this
    basis, a few filters therefore suffice to recover many bands.

    Examples
    --------
    >>> from lfcal.multiplex import cosine_basis
    >>> print(cosine_basis(4, 2).round(3))
    [[ 1.     0.924]
     [ 1.     0.383]
     [ 1.    -0.383]
     [ 1.    -0.924]]
    """
    check_number("coefficients", count, at_least=1, at_most=bands, integer=True)
    phase = np.pi * (np.arange(bands) + 0.5) / bands
    return np.asarray(np.cos(np.outer(phase, np.arange(count))))


def spectral_array(
    pattern: str,
    bands: int | Sequence[float],
    *,
    filters: Spectra | None = None,
    illuminant: Spectra | None = None,
    efficiency: Spectra | None = None,
    basis: ArrayLike | None = None,
) -> Modulator:
    """Return a filter array, as a modulator of spectral bands.

    Each entry of its matrix is the mean over a band of the product of the filter's transmission, the quantum efficiency
    and the relative number of photons of the illuminant.

    Parameters
    ----------
    pattern
        Layout of the super-pixel: rows separated by slashes, each with names of ``filters`` separated by commas, or
        with single letters, such as ``"RG/GB"``.
    bands
        Number of equally wide bands between 400 and 700 nm, or the edges of the bands (nm).
    filters
        Transmissions of the filters, 0 to 1. None: the included model filters R, G, B, C, M, Y and W.
    illuminant
        Relative spectral power of the illuminant (one curve). Its number of photons is normalised to a mean of 1 over
        the bands. Samples are then reflectances, each multiplied by the fraction of the spectral range that its band
        occupies (`Modulator.light`). None: samples are the numbers of photons in each band.
    efficiency
        Quantum efficiency of the sensor, in electrons per photon (one curve). None: 1.
    basis
        Basis spectra as columns, ``(bands, N)``, such as `cosine_basis`. The samples are then the coefficients of these
        spectra instead of the bands. None: the bands themselves.

    Raises
    ------
    InputError
        If a filter is unknown, a table does not cover the bands, or a transmission is not between 0 and 1.

    Examples
    --------
    >>> from lfcal.multiplex import amplification, bandpass_filters, cosine_basis, shipped_spectra, spectral_array
    >>> filters = bandpass_filters([430, 510, 590, 670], width_nm=80)
    >>> silicon = shipped_spectra("silicon")
    >>> plain = spectral_array("F0,F1/F2,F3", 4, filters=filters, efficiency=silicon)
    >>> print(plain.colours, f"noise x {amplification(plain):.2f}")
    ('438 nm', '512 nm', '588 nm', '662 nm') noise x 2.16
    >>> smooth = spectral_array("F0,F1/F2,F3", 31, filters=filters, efficiency=silicon, basis=cosine_basis(31, 4))
    >>> print(smooth.count, "coefficients of 31 bands, rank", smooth.rank())
    4 coefficients of 31 bands, rank 4
    """
    table = shipped_spectra("filters") if filters is None else filters
    rows = _pattern(pattern, table.names)
    edges = band_edges(bands)
    waves = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(POINTS) + 0.5) / POINTS
    kinds = sorted({name for row in rows for name in row}, key=[n for row in rows for n in row].index)
    shares = np.stack([_shares(table.named(kind), waves)[0] for kind in kinds])
    seen = shares * _one_curve(efficiency, waves, "quantum efficiency", most=1.0)
    if illuminant is not None:
        photons = _one_curve(illuminant, waves, "illuminant") * waves  # power divided by the energy of a photon
        seen = seen * photons / (photons.mean(1) @ np.diff(edges) / (edges[-1] - edges[0]))
    plenoptic, names, light = _samples(seen.mean(2), edges, basis)
    spatial = np.array([[float(name == kind) for kind in kinds] for row in rows for name in row])
    title = f"{pattern}, {len(edges) - 1} bands"
    return Modulator(title, (len(rows), len(rows[0])), spatial, plenoptic, colours=names, light=light)


def _samples(seen: Array, edges: Array, basis: ArrayLike | None) -> tuple[Array, tuple[str, ...], Array]:
    """Return Pi ``(N, kinds)``, the names of the samples, and the samples of unmodulated light."""
    width = np.diff(edges) / (edges[-1] - edges[0])  # uniform light: each band has its share of the spectrum
    if basis is None:
        middles = (edges[1:] + edges[:-1]) / 2
        return seen.T, tuple(f"{middle:.0f} nm" if len(edges) < 60 else f"{middle:.1f} nm" for middle in middles), width
    table = np.asarray(basis, float)
    if table.ndim != 2 or len(table) != len(width) or not table.size:
        raise InputError.expected("basis of spectra", f"shape ({len(width)}, N)", table.shape, "give one row per band")
    if not np.isfinite(table).all():
        raise InputError.expected("basis of spectra", "finite numbers", "NaN or infinity", "correct the values")
    light = np.linalg.lstsq(table, width, rcond=None)[0]
    return (seen @ table).T, tuple(f"coefficient {k} nm" for k in range(table.shape[1])), light


def _shares(curve: Spectra, waves: Array) -> Array:
    values = curve.on(waves.ravel()).reshape(len(curve.names), *waves.shape)
    if values.min() < 0 or values.max() > 1:
        reported = f"{values.min():.3g} … {values.max():.3g}"
        raise InputError.expected(
            f"transmission of {curve.names[0]}", "values from 0 to 1", reported, "give fractions, not per cent"
        )
    return values


def _one_curve(curve: Spectra | None, waves: Array, what: str, most: float = np.inf) -> Array:
    if curve is None:
        return np.ones_like(waves)
    if len(curve.names) != 1:
        raise InputError.expected(what, "one curve", ", ".join(curve.names), "choose one with Spectra.named")
    values: Array = curve.on(waves.ravel()).reshape(waves.shape)
    if values.min() < 0 or values.max() > most or not values.any():
        reported = f"{values.min():.3g} … {values.max():.3g}"
        raise InputError.expected(what, f"values from 0 to {most:g}, not all zero", reported, "correct the curve")
    return values


def _pattern(pattern: str, known: tuple[str, ...]) -> list[list[str]]:
    rows = [
        [name.strip() for name in (row.split(",") if "," in row else list(row.strip()) if _single(known) else [row])]
        for row in str(pattern).split("/")
    ]
    good = all(len(row) == len(rows[0]) for row in rows) and len(rows) * len(rows[0]) <= MAX_SAMPLES
    strange = [name for row in rows for name in row if name not in known]
    if strange or not good or not rows[0]:
        wanted = f"rows of equally many letters {', '.join(known)}"[:90]
        raise InputError.expected(
            "filter pattern", wanted, repr(pattern)[:60], 'give a value such as "RG/GB" or "F0,F1/F2,F3"'
        )
    return rows


def _single(known: tuple[str, ...]) -> bool:
    return any(len(name) == 1 for name in known)
