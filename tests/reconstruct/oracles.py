"""Slow and obvious counterparts of the projectors."""

from __future__ import annotations

import numpy as np


def dense(H, image_shape, anchor=(0, 0)):
    """Return the operator as a matrix (pixels, planes * pixels), entry by entry from the definition."""
    nz, ny, nx, nt, ns = H.shape
    rows, columns = image_shape
    ct, cs = (nt - 1) // 2, (ns - 1) // 2
    matrix = np.zeros((rows, columns, nz, rows, columns))
    for vy in range(rows):
        for vx in range(columns):
            pattern = H[:, (vy - anchor[0]) % ny, (vx - anchor[1]) % nx]
            for py in range(max(0, vy - ct), min(rows, vy + nt - ct)):
                for px in range(max(0, vx - cs), min(columns, vx + ns - cs)):
                    matrix[py, px, :, vy, vx] = pattern[:, py - vy + ct, px - vx + cs]
    return matrix.reshape(rows * columns, nz * rows * columns)


def convolved(H, volume, anchor=(0, 0)):
    """Return the image by one 'same' convolution per source position."""
    from scipy.signal import convolve2d  # takes longer to load than everything else that is collected

    _, ny, nx = H.shape[:3]
    image = np.zeros(volume.shape[1:])
    for z, plane in enumerate(volume):
        for y in range(ny):
            for x in range(nx):
                comb = np.zeros_like(plane)
                rows, columns = slice((y + anchor[0]) % ny, None, ny), slice((x + anchor[1]) % nx, None, nx)
                comb[rows, columns] = plane[rows, columns]
                image += convolve2d(comb, H[z, y, x], mode="same")
    return image


def lenslet_psf(nz=3, period=5, cutout=31, spread=0.7, slope=0.3):
    """Return the H of an ideal lenslet array: a spot under each lenslet that sees the source, shifted with depth."""
    c, half = (cutout - 1) // 2, period // 2
    t, s = np.mgrid[:cutout, :cutout]
    H = np.zeros((nz, period, period, cutout, cutout))
    for z in range(nz):
        for y in range(period):
            for x in range(period):
                for k in range(-3, 4):
                    for j in range(-3, 4):
                        dy, dx = half + period * k - y, half + period * j - x
                        if max(abs(dy), abs(dx)) > 12 - 2 * z:
                            continue
                        ty, tx = c + dy * (1 - (z - 1) * slope), c + dx * (1 - (z - 1) * slope)
                        H[z, y, x] += np.exp(-((t - ty) ** 2 + (s - tx) ** 2) / (2 * spread**2))
    return H / H.sum(axis=(3, 4)).mean(axis=(1, 2))[:, None, None, None, None]
