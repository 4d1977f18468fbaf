"""Brute force for a Fourier light-field microscope: the native image by quadrature, then planes of samples by FFT.

Shares no code with lfcal. The objective's image of a point in the native plane is a sum of plane waves over the pupil;
the Fourier lens is a lens phase between two propagations over its focal length, done as one optical Fourier transform;
each lenslet is an aperture with a lens phase; the sensor is reached by the angular spectrum (exact, not Fresnel).
"""

from __future__ import annotations

import numpy as np
from scipy.special import j0


def native_image(r, z, *, magnification, na, index, wavelength):
    """Field at radii r of the native image plane of a point at z: the Debye integral by many Gauss nodes."""
    alpha = np.arcsin(na / index)
    k = 2 * np.pi * index / wavelength
    t, w = np.polynomial.legendre.leggauss(int(0.6 * k * np.sin(alpha) / magnification * r.max()) + 100)
    t, w = alpha / 2 * (t + 1), alpha / 2 * w
    weight = w * np.sqrt(np.cos(t)) * np.sin(t) * np.exp(1j * k * z * (np.cos(t) - 1))
    return np.concatenate(
        [j0(np.outer(part, k * np.sin(t) / magnification)) @ weight for part in np.array_split(r, 50)]
    )


def light_on_sensor(
    z, *, optics, fourier, centres, focal, gap, width, pixel, pixels, per=3, pad=49, square=False, aside=(0.0, 0.0)
):
    """Light in pixels x pixels about the axis, in units of the light through the pupil.

    ``aside`` (x, y) is where the chief ray of the point meets the sensor: a linear phase over the pupil.
    ``per`` samples per pixel, on lenslets and sensor alike; ``pad`` pixels more before light comes back in.
    """
    magnification, na, index, wavelength = optics
    step = pixel / per
    count = (pixels + pad) // 2 * 2 * per
    grid = np.arange(count) - count // 2
    x = grid * step
    # the samples of the native plane that the Fourier lens turns into those of the pupil plane
    squares, where = np.unique(grid[:, None] ** 2 + grid**2, return_inverse=True)
    radii = np.sqrt(squares) * wavelength * fourier / (count * step)
    image = native_image(radii, z, magnification=magnification, na=na, index=index, wavelength=wavelength)
    image = image[where].reshape(count, count)
    pupil = np.fft.fftshift(np.fft.fft2(np.fft.ifftshift(image)))
    pupil = pupil * np.exp(2j * np.pi / (wavelength * gap) * (x[None, :] * aside[0] + x[:, None] * aside[1]))
    pupil /= np.sqrt((np.abs(pupil) ** 2).sum() * step**2)
    lens = np.zeros_like(pupil)
    for (cx, cy), f in zip(centres, focal, strict=True):
        dx, dy = x[None, :] - cx, x[:, None] - cy
        parts = (np.arange(5) - 2) / 5 * step
        inside = np.zeros((count, count))
        for sy in parts:
            for sx in parts:
                a, b = abs(dx + sx), abs(dy + sy)
                inside += (np.maximum(a, b) if square else np.hypot(a, b)) <= width / 2
        lens += inside / 25 * np.exp(-1j * np.pi / (wavelength * f) * (dx**2 + dy**2))
    frequency = np.fft.fftfreq(count, step)
    square_f = frequency[:, None] ** 2 + frequency[None, :] ** 2
    travel = np.exp(2j * np.pi * gap * (np.sqrt(1 / wavelength**2 - square_f) - 1 / wavelength))
    field = np.fft.ifft2(np.fft.fft2(pupil * lens) * travel)
    # the exact integral over each pixel: a sum over its samples is that over a smaller pixel, and spots look smaller
    share = np.sinc(np.fft.fftfreq(count, step) * pixel)
    light = np.fft.ifft2(np.fft.fft2(np.abs(field) ** 2) * share[:, None] * share).real * pixel**2
    middle, half = count // 2, pixels // 2 * per
    own = slice(middle - half, middle + half + 1, per)
    return np.maximum(light[own, own], 0.0)
