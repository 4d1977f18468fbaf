"""Filter arrays over any number of spectral bands: filters, illuminant and quantum efficiency as curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_number, check_tuple
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator
from lfcal.multiplex.spectra import Spectra, shipped_spectra

__all__ = ["band_edges", "bandpass_filters", "cosine_basis", "spectral_array"]

Array = NDArray[np.float64]

VISIBLE_NM = (400.0, 700.0)
POINTS = 16
"""Wavelengths over which each band's mean is taken."""


def band_edges(bands: int | Sequence[float]) -> Array:
    """Return the edges (nm) of a number of equal bands of 400 … 700 nm, or the edges given, checked."""
    if isinstance(bands, int | np.integer) and not isinstance(bands, bool):
        check_number("spectral bands", int(bands), at_least=1, at_most=MAX_SAMPLES, integer=True)
        return np.linspace(*VISIBLE_NM, int(bands) + 1)
    edges = np.array(check_tuple("edges of the bands (nm)", tuple(np.asarray(bands, float).tolist()), above=0))
    if len(edges) < 2 or (np.diff(edges) <= 0).any():
        raise InputError.expected("edges of the bands (nm)", "two or more rising numbers", edges, "sort them")
    return edges


def bandpass_filters(middles_nm: ArrayLike, width_nm: float) -> Spectra:
    """Return Gaussian filters named F0, F1, … of a full width at half maximum, 1 at their middles: a model.

    Examples
    --------
    >>> from lfcal.multiplex import bandpass_filters
    >>> filters = bandpass_filters([500, 600], width_nm=40)
    >>> print(filters.names, filters.on([480, 500, 600]).round(3).tolist())  # half at half the width away
    ('F0', 'F1') [[0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    middles = np.atleast_1d(np.asarray(middles_nm, float))
    check_number("width of the filters (nm)", width_nm, above=0)
    waves = np.arange(300.0, 1101.0, 2.0)
    values = np.exp(-4 * np.log(2) * ((waves - middles[:, None]) / width_nm) ** 2)
    return Spectra(tuple(f"F{k}" for k in range(len(middles))), waves, values, f"Gaussians {width_nm:g} nm wide")


def cosine_basis(bands: int, count: int) -> Array:
    """Return the ``count`` smoothest cosines over ``bands`` bands as columns ``(bands, count)``.

    Spectra of most surfaces lie near their span: with it few filters tell many bands.

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
    """Return a filter array over spectral bands: A = mean over each band of filter x efficiency x illuminant.

    Parameters
    ----------
    pattern
        Rows parted by slashes: names of ``filters`` parted by commas, or single letters, such as ``"RG/GB"``.
    bands
        Number of equal bands of 400 … 700 nm, or their edges (nm).
    filters
        Transmissions 0 … 1; by default the model filters R G B C M Y W that ship.
    illuminant
        Relative power of the light on the scene (one curve): the samples are then reflectances, each times its band's
        share of the spectrum (`Modulator.light`), and its photons count, with a mean of one over the bands. None: the
        samples are photons in each band.
    efficiency
        Electrons per photon (one curve); None: one.
    basis
        ``(bands, N)``: the samples are coefficients of these spectra instead of the bands (`cosine_basis`).

    Raises
    ------
    InputError
        If a filter is not known, a table does not reach over the bands, or shares are outside 0 … 1.

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
        photons = _one_curve(illuminant, waves, "illuminant") * waves  # power over the energy of a photon
        seen = seen * photons / (photons.mean(1) @ np.diff(edges) / (edges[-1] - edges[0]))
    plenoptic, names, light = _samples(seen.mean(2), edges, basis)
    spatial = np.array([[float(name == kind) for kind in kinds] for row in rows for name in row])
    title = f"{pattern}, {len(edges) - 1} bands"
    return Modulator(title, (len(rows), len(rows[0])), spatial, plenoptic, colours=names, light=light)


def _samples(seen: Array, edges: Array, basis: ArrayLike | None) -> tuple[Array, tuple[str, ...], Array]:
    """Return Pi ``(N, kinds)``, names of the samples, and the samples of even light."""
    width = np.diff(edges) / (edges[-1] - edges[0])  # even light: each band holds its share of the spectrum
    if basis is None:
        middles = (edges[1:] + edges[:-1]) / 2
        return seen.T, tuple(f"{middle:.0f} nm" if len(edges) < 60 else f"{middle:.1f} nm" for middle in middles), width
    table = np.asarray(basis, float)
    if table.ndim != 2 or len(table) != len(width) or not np.isfinite(table).all() or not table.size:
        raise InputError.expected("basis of spectra", f"({len(width)}, N)", table.shape, "one row per band")
    light = np.linalg.lstsq(table, width, rcond=None)[0]
    return (seen @ table).T, tuple(f"coefficient {k} nm" for k in range(table.shape[1])), light


def _shares(curve: Spectra, waves: Array) -> Array:
    values = curve.on(waves.ravel()).reshape(len(curve.names), *waves.shape)
    if values.min() < 0 or values.max() > 1:
        told = f"{values.min():.3g} … {values.max():.3g}"
        raise InputError.expected(f"transmission of {curve.names[0]}", "0 … 1", told, "per cent are no shares")
    return values


def _one_curve(curve: Spectra | None, waves: Array, what: str, most: float = np.inf) -> Array:
    if curve is None:
        return np.ones_like(waves)
    if len(curve.names) != 1:
        raise InputError.expected(what, "one curve", ", ".join(curve.names), "choose with Spectra.named")
    values: Array = curve.on(waves.ravel()).reshape(waves.shape)
    if values.min() < 0 or values.max() > most or not values.any():
        told = f"{values.min():.3g} … {values.max():.3g}"
        raise InputError.expected(what, f"0 … {most:g}, not all zero", told, "correct the table")
    return values


def _pattern(pattern: str, known: tuple[str, ...]) -> list[list[str]]:
    rows = [
        [name.strip() for name in (row.split(",") if "," in row else list(row.strip()) if _single(known) else [row])]
        for row in str(pattern).split("/")
    ]
    good = all(len(row) == len(rows[0]) for row in rows) and len(rows) * len(rows[0]) <= MAX_SAMPLES
    strange = [name for row in rows for name in row if name not in known]
    if strange or not good or not rows[0]:
        wanted = f"equal rows of {', '.join(known)}"[:90]
        raise InputError.expected("filter pattern", wanted, repr(pattern)[:60], 'for example "RG/GB" or "F0,F1/F2,F3"')
    return rows


def _single(known: tuple[str, ...]) -> bool:
    return any(len(name) == 1 for name in known)
