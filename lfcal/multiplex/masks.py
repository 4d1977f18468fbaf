"""Light-field modulators: pinholes, lenslets, MURA and sum-of-sinusoids masks, masks at a distance.

Their gain can be compared with an upper bound for any mask, and with that of the best small binary mask.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_choice, check_number, check_tuple
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator

__all__ = [
    "MASKS",
    "MAX_EXHAUSTIVE",
    "best_binary_mask",
    "dirichlet_minimum",
    "mask",
    "mask_at_distance",
    "mask_gain_bound",
    "mask_pattern",
    "noise_shares",
    "shadow_shift_px",
]

Array = NDArray[np.float64]

MASKS = ("pinhole", "lenslet", "MURA", "sum_of_sinusoids")
MAX_SIZE = math.isqrt(MAX_SAMPLES)

MAX_SHIFT_PX = 1e4
"""Largest shift of the shadow from view to view (pixels); it limits the computing time."""


def mask(kind: str, size: int) -> Modulator:
    """Return a light-field modulator with ``size`` x ``size`` pixels and as many views (Ihrke et al., section 4.2).

    Attenuation masks are assumed to be at the distance from the sensor at which their shadow moves by one pixel per
    view. The matrix A (`Modulator.matrix`) is then the circulant matrix of the mask pattern, with Sigma = F^-1 M-hat
    and Pi^T = F. Here F is the discrete Fourier transform, and M-hat the transform of the pattern (eq. 9). For the
    pinhole, A is the identity. For the lenslet, A is N times the identity for N views, because a lenslet collects the
    light of the entire super-pixel for each view.

    Parameters
    ----------
    kind
        Kind of modulator: ``"MURA"`` (modified uniformly redundant array), ``"pinhole"``, ``"lenslet"`` or
        ``"sum_of_sinusoids"``.
    size
        Side of the mask (px): an odd prime for MURA, an odd number for the sum of sinusoids, any number for the others.

    Raises
    ------
    InputError
        If ``kind`` is unknown, or no mask of this kind has this size.

    Examples
    --------
    >>> from lfcal.multiplex import mask, transmission
    >>> for kind in ("pinhole", "lenslet", "MURA", "sum_of_sinusoids"):
    ...     print(f"{kind}: {transmission(mask(kind, 5)):.3f} of the light")
    pinhole: 0.040 of the light
    lenslet: 1.000 of the light
    MURA: 0.480 of the light
    sum_of_sinusoids: 0.232 of the light
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
    """Return the transmission of one period of a mask, ``(size, size)``, from 0 to 1; all 1 for a lenslet.

    ``kind`` and ``size`` are the parameters of `mask`.

    Examples
    --------
    >>> from lfcal.multiplex import mask_pattern
    >>> print(mask_pattern("MURA", 5).astype(int))  # 12 of 25 open
    [[0 0 0 0 0]
     [1 1 0 0 1]
     [1 0 1 1 0]
     [1 0 1 1 0]
     [1 1 0 0 1]]
    """
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
    """Return the sum of all harmonics with equal weight, shifted and scaled so that its continuous profile is in 0 … 1.

    The profile is D(x) D(y) with D(x) = 1 + 2 sum_k cos(2 pi k x/p). D is p at its peaks and zero on every other pixel,
    with negative lobes between the pixels. If only the samples were scaled, the mask would be a pinhole.
    """
    if p % 2 == 0:
        raise InputError.expected("size of sum_of_sinusoids (px)", "an odd number", p, f"choose {p - 1} or {p + 1}")
    highest, lowest = float(p * p), p * dirichlet_minimum(p)
    pattern = np.full((p, p), -lowest)
    pattern[0, 0] += highest
    return pattern / (highest - lowest)


def dirichlet_minimum(p: int) -> float:
    """Return the minimum of D(x) = sin(pi x)/sin(pi x/p) over real x, for odd ``p``; 0 for p = 1."""
    if p == 1:
        return 0.0
    from scipy.optimize import minimize_scalar

    def profile(x: float) -> float:
        return math.sin(math.pi * x) / math.sin(math.pi * x / p)

    # the first lobe next to the peak is the deepest
    found = minimize_scalar(profile, bounds=(1.0, min(2.0, p / 2)), method="bounded", options={"xatol": 1e-12})
    return min(float(found.fun), profile(min(2.0, p / 2)))


def mask_at_distance(pattern: ArrayLike, shift_px: float, *, view_width: float = 0.0, name: str = "mask") -> Modulator:
    """Return the modulator of a periodic mask at some distance in front of the sensor (Ihrke et al., eq. 9).

    A pixel at x records i(x) = sum_v l(x, v) m(x - s v). Here l is the light field, m the mask, v the view, and s the
    shift. The mask consists of cells as large as a pixel. The transmission of a pixel for a view is the mean of the
    shadow over the pixel and over the directions of the view. Transmissions therefore remain within the range of the
    mask's values. For any shift, the light of each view summed over a super-pixel equals the light that passes one
    period of the mask. Sigma is F^-1 M-hat, with the discrete Fourier transform F and the transform M-hat of the
    pattern. Pi^T contains the Fourier transform of a shifted cell for each frequency w and view v. For integer shifts
    and views without angular extent, this is exp(-2 pi i s v w), which is the Fourier basis if s = 1. With s = 0 (mask
    on the sensor), all views pass the same mask, and only their sum can be recovered.

    Parameters
    ----------
    pattern
        Transmission of one period of the mask, ``(rows, columns)``, with one value from 0 to 1 for each pixel.
    shift_px
        Shift s of the mask's shadow from one view to the next (px), as returned by `shadow_shift_px`.
    view_width
        Angular extent of a view divided by the step between views, 0 to 1. 0: a single direction, as in eq. 9. 1:
        contiguous views, as behind a full aperture; the shadows are then blurred by s pixels.
    name
        Name in tables and plots.

    Raises
    ------
    InputError
        If ``pattern`` is not an array of at most 4096 transmissions from 0 to 1, or another parameter is out of range.

    Examples
    --------
    >>> from lfcal.multiplex import amplification, mask_at_distance, mask_pattern
    >>> pattern = mask_pattern("MURA", 3)
    >>> for shift in (0.0, 0.8, 1.0):
    ...     found = mask_at_distance(pattern, shift)
    ...     print(f"{shift} px per view: rank {found.rank()} of {found.count}, noise x {amplification(found):.2f}")
    0.0 px per view: rank 1 of 9, noise x inf
    0.8 px per view: rank 9 of 9, noise x 1.58
    1.0 px per view: rank 9 of 9, noise x 0.75
    """
    values = np.asarray(pattern, float)
    good = values.ndim == 2 and values.size and np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1
    if not good:
        raise InputError.expected(
            "mask",
            "rows and columns of transmissions from 0 to 1",
            array_words(values),
            "give one transmission per pixel of the mask",
        )
    if values.size > MAX_SAMPLES:
        raise InputError.expected("mask", f"up to {MAX_SAMPLES} pixels", values.size, "choose a smaller mask")
    check_number("shift of the shadow (px per view)", shift_px, at_least=-MAX_SHIFT_PX, at_most=MAX_SHIFT_PX)
    check_number("width of a view (steps)", view_width, at_least=0, at_most=1)
    rows, columns = values.shape
    transfer = np.fft.fft2(values).ravel()
    inverse = np.kron(_fourier(rows), _fourier(columns)).conj() / values.size
    plenoptic = np.kron(*(_moved_cell(n, shift_px, view_width) for n in values.shape))  # views x frequencies
    return Modulator(name, (rows, columns), inverse * transfer, plenoptic, (rows, columns), cell=(rows, columns))


def _fourier(n: int) -> NDArray[np.complex128]:
    """Return exp(-2 pi i k w/n), ``(k, w)``; phases are reduced as integers, so only rounding errors remain."""
    k = np.arange(n)
    result: NDArray[np.complex128] = np.exp(-2j * np.pi * (np.outer(k, k) % n) / n)
    return result


def _moved_cell(n: int, shift: float, view_width: float) -> NDArray[np.complex128]:
    """Return the Fourier transform of a mask cell's shadow on the pixels for each view, ``(view, frequency)``."""
    width = abs(shift) * view_width
    views = np.arange(n)
    distance = np.arange(n) - shift * views[:, None]  # from the shadow of the first cell to each pixel
    nearest = distance - n * np.rint(distance / n)
    seen = np.zeros((n, n))
    reach = math.ceil((1 + width / 2) / n) + 1  # number of mask periods that one pixel may see
    for period in range(-reach, reach + 1):
        seen += cell_overlap(nearest + n * period, width)
    result: NDArray[np.complex128] = seen @ _fourier(n)
    return result


def cell_overlap(distance: ArrayLike, blur: float) -> Array:
    """Return the fraction of a mask cell's light that falls on a pixel; cell and pixel are one pixel wide.

    ``distance`` is the distance between the centres of the cell's shadow and the pixel, and ``blur`` the movement of
    the shadow within a view (pixels). The fraction is the convolution of three boxes (cell, pixel and movement); the
    fractions on all pixels add up to one.
    """
    t = np.asarray(distance, float)
    if blur < 1e-6:  # below this, the difference of the integrals would be rounding errors
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(t)))
    ends = [np.clip(t + sign * blur / 2, -1.0, 1.0) for sign in (1, -1)]
    # the integral of the triangle 1 - |t| up to each end
    upper, lower = (0.5 + e - np.sign(e) * e * e / 2 for e in ends)
    return np.asarray((upper - lower) / blur)


def shadow_shift_px(distance_um: float, view_step: float, pixel_um: float) -> float:
    """Return the shift of a mask's shadow from one view to the next (px): z dv / pixel pitch.

    Parameters
    ----------
    distance_um
        Distance z between the mask and the sensor (µm).
    view_step
        Step dv between adjacent views, as the tangent of the angle between them.
    pixel_um
        Pixel pitch (µm).

    Examples
    --------
    >>> from lfcal.multiplex import shadow_shift_px
    >>> step = 1 / 4 / 11  # 11 views across an f/4 aperture
    >>> print(f"{shadow_shift_px(242, step, pixel_um=5.5):.2f} px at 242 µm")
    1.00 px at 242 µm
    """
    check_tuple("distance (µm) and view step", (distance_um, view_step), 2)
    check_number("pixel pitch (µm)", pixel_um, above=0)
    return distance_um * view_step / pixel_um


MAX_EXHAUSTIVE = 4
"""Side up to which all binary masks are tried: 65 536 with 4 x 4 px."""


def noise_shares(chi2: float) -> tuple[float, float]:
    """Return the fractions of the noise variance that are due to additive noise and to photon noise.

    ``chi2``, 0 to inf, is the variance of photon noise divided by that of additive noise.
    """
    if not chi2 >= 0:
        raise InputError.expected("chi^2", "a number from 0 to inf", chi2, "give a number in this range")
    additive = 1.0 / (1.0 + chi2)
    return additive, 1.0 - additive


def mask_gain_bound(size: int, chi2: float) -> float:
    """Return an upper bound on the SNR gain over the pinhole (dB) of any mask of ``size`` x ``size`` pixels.

    The bound follows from the N Fourier coefficients of a mask with N pixels and the mean transmission tau. The zeroth
    coefficient is N tau. The sum of squares of the others is at most N^2 tau (1 - tau), because transmissions are
    between 0 and 1. The noise variance is proportional to the sum of the inverse squares of all coefficients. This sum
    is smallest if all except the zeroth are equal; tau is then optimised. Masks based on cyclic difference sets reach
    this bound if they have the optimal tau.

    Parameters
    ----------
    size
        Side of the mask (px), and number of views along each axis.
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf.

    Examples
    --------
    >>> from lfcal.multiplex import mask, mask_gain_bound, snr_gain
    >>> for chi2 in (0.0, 10.0):
    ...     gain = snr_gain(mask("MURA", 5), mask("pinhole", 5), chi2)
    ...     print(f"chi^2 = {chi2:g}: MURA {gain:.2f} dB, no mask above {mask_gain_bound(5, chi2):.2f} dB")
    chi^2 = 0: MURA 3.80 dB, no mask above 4.15 dB
    chi^2 = 10: MURA 0.72 dB, no mask above 1.53 dB
    """
    from scipy.optimize import minimize_scalar

    check_number("size of the mask (px)", size, at_least=1, at_most=MAX_SIZE, integer=True)
    additive, photon = noise_shares(chi2)
    n = size * size
    if n == 1:
        return 0.0  # a hole

    def log_noise(tau: float) -> float:
        amplified = (1 / tau + (n - 1) ** 2 * (1 / (1 - tau))) / tau / n**3
        return math.log(amplified * (additive + photon * tau))

    # 1/tau^2 + c/(tau (1 - tau)) times a line has one minimum; the grid brackets it
    grid = (np.arange(4 * n) + 0.5) / (4 * n)
    k = int(np.argmin([log_noise(tau) for tau in grid]))
    step = 1 / (4 * n)
    low, high = max(grid[k] - step, 1e-12), min(grid[k] + step, 1 - 1e-12)
    found = minimize_scalar(log_noise, bounds=(low, high), method="bounded", options={"xatol": 1e-12})
    least = min(float(found.fun), log_noise(grid[k]))
    return 5 / math.log(10) * (math.log(additive + photon / n) - least)


def best_binary_mask(size: int, chi2: float) -> Array:
    """Return the mask ``(size, size)`` of zeros and ones with the largest SNR gain at ``chi2``; all masks are tried.

    ``chi2`` is the ratio of photon to additive noise variance of the camera (`camera_chi2`). The shadow moves by one
    pixel from view to view.

    Raises
    ------
    InputError
        If ``size`` is not from 1 to `MAX_EXHAUSTIVE`, or ``chi2`` is negative.

    Examples
    --------
    >>> from lfcal.multiplex import best_binary_mask, mask, mask_at_distance, mask_gain_bound, snr_gain
    >>> pattern = best_binary_mask(4, chi2=2.0)  # a difference set
    >>> gain = snr_gain(mask_at_distance(pattern, 1.0), mask("pinhole", 4), 2.0)
    >>> print(f"{pattern.sum():.0f} of 16 pixels open, {gain:.1f} of {mask_gain_bound(4, 2.0):.1f} dB")
    6 of 16 pixels open, 2.2 of 2.2 dB
    """
    check_number("size of the mask (px)", size, at_least=1, at_most=MAX_EXHAUSTIVE, integer=True)
    additive, photon = noise_shares(chi2)
    n = size * size
    best, least = np.ones((size, size)), math.inf
    codes = np.arange(1, 2**n)
    for part in np.array_split(codes, -(-len(codes) // 8192)):
        masks = ((part[:, None] >> np.arange(n)) & 1).astype(float).reshape(-1, size, size)
        power = np.abs(np.fft.fft2(masks)) ** 2
        # a weight of zero means a lost sample; rounding must not turn its inverse into a large number
        lost = (power < 1e-9).any((1, 2))
        noise = (1 / np.where(power < 1e-9, 1.0, power)).sum((1, 2)) * (additive + photon * masks.mean((1, 2)))
        noise[lost] = math.inf
        k = int(np.argmin(noise))
        if noise[k] < least:
            best, least = masks[k], float(noise[k])
    return best
