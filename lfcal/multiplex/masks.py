"""Light-field modulators: pinholes, lenslets, MURA and sum-of-sinusoids masks, masks at a distance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.checks import check_choice, check_number, check_tuple
from lfcal.errors import InputError
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator

__all__ = ["MASKS", "dirichlet_minimum", "mask", "mask_at_distance", "mask_pattern", "shadow_shift_px"]

Array = NDArray[np.float64]

MASKS = ("pinhole", "lenslet", "MURA", "sum_of_sinusoids")
MAX_SIZE = math.isqrt(MAX_SAMPLES)


def mask(kind: str, size: int) -> Modulator:
    """Return a light-field modulator of ``size`` x ``size`` pixels and as many views (Ihrke et al., section 4.2).

    Attenuation masks lie where neighbouring views shift their shadow by one pixel: A is the circulant matrix of the
    mask's pattern, Sigma = F^-1 M-hat and Pi^T = F (equation 9). The pinhole's is the identity; the lenslet's is N
    times the identity, as it gathers the light of the whole super-pixel for each view.

    Parameters
    ----------
    kind
        ``"MURA"``, ``"pinhole"``, ``"lenslet"`` or ``"sum_of_sinusoids"``.
    size
        Pixels along a side: an odd prime for MURA, odd for sinusoids, anything from 1 for the others.

    Raises
    ------
    InputError
        If there is no such mask.
    """
    check_choice("mask", kind, MASKS)
    pattern = mask_pattern(kind, size)
    views = (size, size)
    if kind in ("pinhole", "lenslet"):
        lens = kind == "lenslet"
        identity = np.eye(size * size)
        return Modulator(
            kind, views, (size * size if lens else 1.0) * identity, identity, views, cell=views, lenslets=lens
        )
    return mask_at_distance(pattern, 1.0, name=kind)


def mask_pattern(kind: str, size: int) -> Array:
    """Return the transmission ``(size, size)`` of one period of a mask, in 0 … 1; ones for a lenslet."""
    check_choice("mask", kind, MASKS)
    check_number(f"size of {kind} (px)", size, at_least=1, at_most=MAX_SIZE, integer=True)
    if kind == "MURA":
        return _mura(size)
    if kind == "sum_of_sinusoids":
        return _sinusoids(size)
    pattern = np.full((size, size), float(kind == "lenslet"))
    pattern[0, 0] = 1.0
    return pattern


def _mura(p: int) -> Array:
    """Return the modified uniformly redundant array of Gottesman and Fenimore (1989)."""
    if p < 3 or any(p % k == 0 for k in range(2, math.isqrt(p) + 1)):
        raise InputError.expected("size of MURA (px)", "an odd prime", p, "choose 3, 5, 7, 11, 13, 17 …")
    residue = -np.ones(p)
    residue[[k * k % p for k in range(1, p)]] = 1
    pattern = (np.outer(residue, residue) > 0).astype(float)
    pattern[0, :] = 0
    pattern[1:, 0] = 1
    return pattern


def _sinusoids(p: int) -> Array:
    """Sum of all harmonics with equal weight, shifted and scaled to 0 … 1 on its continuous profile.

    The profile is D(x) D(y), D(x) = 1 + 2 sum_k cos(2 pi k x/p): p at its peaks and zero on every other pixel, with
    negative lobes between the pixels; scaled on the samples alone it would be a pinhole.
    """
    if p % 2 == 0:
        raise InputError.expected("size of sum_of_sinusoids (px)", "an odd number", p, "choose an odd one")
    highest, lowest = float(p * p), p * dirichlet_minimum(p)
    pattern = np.full((p, p), -lowest)
    pattern[0, 0] += highest
    return pattern / (highest - lowest)


def dirichlet_minimum(p: int) -> float:
    """Return the least value of D(x) = sin(pi x)/sin(pi x/p) over real x, ``p`` odd (1 for p = 1)."""
    if p == 1:
        return 0.0
    from scipy.optimize import minimize_scalar

    def profile(x: float) -> float:
        return math.sin(math.pi * x) / math.sin(math.pi * x / p)

    # the first lobe beside the peak is the deepest
    found = minimize_scalar(profile, bounds=(1.0, min(2.0, p / 2)), method="bounded", options={"xatol": 1e-12})
    return min(float(found.fun), profile(min(2.0, p / 2)))


def mask_at_distance(pattern: ArrayLike, shift_px: float, *, name: str = "mask") -> Modulator:
    """Return the modulator of a periodic mask in front of the sensor, i(x) = sum_v l(x, v) m(x - s v) (equation 9).

    Sigma = F^-1 M-hat and Pi^T holds exp(-2 pi i s v w): the Fourier basis itself for s = 1. With s = 0 (mask on the
    sensor) all views pass the same mask and only their sum can be recovered. A shift that is no whole number moves the
    mask's band-limited profile.

    Parameters
    ----------
    pattern
        Transmission ``(rows, columns)`` of one period, one value per pixel.
    shift_px
        s: by how many pixels the mask's shadow moves from one view to the next (`shadow_shift_px`).
    name
        For tables and plots.

    Raises
    ------
    InputError
        If the pattern is not an array of transmissions from 0 to 1.
    """
    values = np.asarray(pattern, float)
    good = values.ndim == 2 and values.size and np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1
    if not good:
        raise InputError.expected("mask", "rows and columns of transmissions from 0 to 1", _told(values), "correct it")
    if values.size > MAX_SAMPLES:
        raise InputError.expected("mask", f"up to {MAX_SAMPLES} pixels", values.size, "choose a smaller one")
    check_number("shift of the shadow (px per view)", shift_px)
    rows, columns = values.shape
    transfer = np.fft.fft2(values).ravel()
    inverse = np.kron(_fourier(rows, -1.0), _fourier(columns, -1.0)) / values.size
    plenoptic = np.kron(_fourier(rows, shift_px), _fourier(columns, shift_px))  # views x frequencies
    return Modulator(name, (rows, columns), inverse * transfer, plenoptic, (rows, columns), cell=(rows, columns))


def _fourier(n: int, shift: float) -> NDArray[np.complex128]:
    """Return exp(-2 pi i shift k w/n), ``(k, w)``, frequencies w from zero up and then negative."""
    frequencies = np.fft.fftfreq(n, 1 / n)
    whole = float(shift).is_integer()
    # whole shifts: reduce the phase in integers, exact to rounding
    product = np.outer(np.arange(n), frequencies) * shift
    result: NDArray[np.complex128] = np.exp(-2j * np.pi * (np.mod(product, n) if whole else product) / n)
    if n % 2 == 0 and not whole:
        result[:, n // 2] = result[:, n // 2].real  # the highest frequency is half at each end
    return result


def _told(values: Array) -> str:
    if values.ndim != 2 or not values.size or not np.isfinite(values).all():
        return f"shape {values.shape}"
    return f"{values.min():.3g} … {values.max():.3g}"


def shadow_shift_px(distance_um: float, view_step: float, pixel_um: float) -> float:
    """Return by how many pixels the shadow of a mask moves per view: z dv / pixel.

    Parameters
    ----------
    distance_um
        Distance z of mask and sensor (µm).
    view_step
        Step dv between views, tangent of the angle.
    pixel_um
        Pixel pitch (µm).
    """
    check_tuple("distance (µm) and view step", (distance_um, view_step), 2)
    check_number("pixel pitch (µm)", pixel_um, above=0)
    return distance_um * view_step / pixel_um
