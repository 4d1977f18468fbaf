"""The unknown object and dark field of a frame, estimated with accelerated Richardson-Lucy for a fixed camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from lfcal.recalibrate._patterns import VoxelPatterns

__all__ = ["ObjectFrame", "SceneEstimate", "dark_fields", "estimate_scene"]

F4 = NDArray[np.float32]

LEAST = 1e-3
"""Smallest expected number of electrons in a pixel, which avoids a division by zero."""

MOST_EXTRAPOLATED = 0.95
"""Largest step of the extrapolation (Biggs and Andrews 1997), relative to the last change."""


@dataclass(frozen=True, eq=False)
class ObjectFrame:
    """A frame of an unknown object, on the pixels of a window or of the whole sensor.

    Attributes
    ----------
    electrons
        Signal ``(rows, columns)`` in electrons, with the dark field.
    valid
        Weight of each pixel, 1 or 0: 0 outside the frame, and for saturated and defective pixels.
    read_e
        Read noise (electrons rms).
    prnu
        Relative rms variation of the response of pixels.
    name
        Name for messages and reports.
    """

    electrons: F4
    valid: F4
    read_e: float = 0.0
    prnu: float = 0.0
    name: str = "frame"

    def inverse_variance(self, expected: F4) -> F4:
        """Return the inverse variance of each pixel ``(rows, columns)`` (1/e²); 0 where the frame is not valid."""
        signal = np.maximum(expected, LEAST)
        variance = signal + np.float32(self.read_e**2) + np.float32(self.prnu**2) * np.square(signal)
        return (self.valid / variance).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SceneEstimate:
    """Estimate of the object and the dark field of a frame.

    Attributes
    ----------
    volume
        Value of each voxel ``(n,)``: electrons that pass the iris.
    dark
        Coefficients of the dark fields `dark_fields` ``(d,)`` (electrons).
    light, expected
        Images ``(rows, columns)`` of the object alone, and with the dark field (electrons).
    """

    volume: F4
    dark: F4
    light: F4
    expected: F4


def dark_fields(shape: tuple[int, int], parts: int = 1) -> F4:
    """Return positive images ``(d, rows, columns)`` whose sums are smooth dark fields of ``parts`` x ``parts`` pieces.

    They are products of B-splines. One piece is bilinear; more are at most cubic. Positive images allow the
    multiplicative steps of Richardson-Lucy.
    """
    degree = min(parts, 3)
    knots = np.clip(np.linspace(-degree, parts + degree, parts + 2 * degree + 1) / parts, 0, 1)
    y, x = (BSpline.design_matrix(np.linspace(0, 1, n), knots, degree).toarray() for n in shape)
    found: F4 = np.einsum("ya,xb->abyx", y, x).reshape(-1, *shape).astype(np.float32)
    return found


def estimate_scene(patterns: VoxelPatterns, frame: ObjectFrame, fields: F4, iterations: int) -> SceneEstimate:
    """Return the object and dark field that explain a frame, by accelerated Richardson-Lucy iterations.

    Photon and read noise together are treated as Poisson noise of a signal that is larger by the square of the read
    noise (Snyder et al. 1993). The acceleration is that of Biggs and Andrews (1997).

    Parameters
    ----------
    patterns
        H of the window.
    frame
        The frame.
    fields
        Dark fields ``(d, rows, columns)``.
    iterations
        Number of iterations.
    """
    shift = np.float32(frame.read_e**2)
    data = frame.valid * (np.maximum(frame.electrons, 0) + shift)
    whole = np.maximum(patterns.sums(frame.valid[None])[0], 1e-6)
    shares = np.maximum(np.einsum("dyx,yx->d", fields, frame.valid), 1e-6)
    light = float((frame.valid * np.maximum(frame.electrons, 0)).sum())
    now = np.full(len(patterns), 0.8 * light / float(whole.sum()), np.float32)
    dark = (0.2 * light / len(fields) / shares).astype(np.float32)
    before, dark_before = now, dark
    change: F4 | None = None
    step = np.float32(0)
    for _ in range(iterations):
        point = np.maximum(now + step * (now - before), np.float32(0.01) * now)
        dark_point = np.maximum(dark + step * (dark - dark_before), np.float32(0.01) * dark)
        expected = patterns.images(point[None])[0] + np.einsum("d,dyx->yx", dark_point, fields) + shift
        ratio = data / np.maximum(expected, LEAST)
        before, now = now, point * patterns.sums(ratio[None])[0] / whole
        dark_before, dark = dark, dark_point * np.einsum("dyx,yx->d", fields, ratio) / shares
        last, change = change, now - point
        if last is not None:
            power = float(np.vdot(last, last))
            step = np.float32(min(MOST_EXTRAPOLATED, max(0.0, float(np.vdot(change, last)) / max(power, 1e-20))))
    image = patterns.images(now[None])[0]
    return SceneEstimate(now, dark, image, image + np.einsum("d,dyx->yx", dark, fields))
