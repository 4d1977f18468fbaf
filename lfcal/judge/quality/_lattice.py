"""Position errors from the phase of a pattern's spots relative to the lenslet lattice."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import for_each_chunk, kernel_input
from lfcal.camera import Camera
from lfcal.judge.quality._kernels import spot_pass

__all__ = ["ORDERS", "SpotLattice", "displacements", "find_spots", "wave_vectors"]

SCALES = np.concatenate([np.linspace(0.3, 0.9, 10), np.linspace(0.95, 2.4, 30), np.linspace(2.5, 5.0, 11)])
"""Ratios of spot to lattice wave number that are tried: 1 / (1 - 1/v)."""

FASTEST = 2.6
"""Highest wave number tried (rad per pixel): below Nyquist's pi with a margin."""

SAMPLE = 500
"""Approximate number of patterns with which spacing and order are searched for."""

WAVE_S = 2e-10
"""Additional processor time (s) for each pixel and wave of `spot_waves` by numpy."""

BRIGHT = 0.92
"""Strength of the lattice's wave above which the pattern is fully lit and its phase is reliable."""

STRONG = 0.4
"""Modulation below which positions cannot be measured from the spots, because too few lenslets are lit."""

ORDERS = {
    "as planned": "",
    "x reversed": "the scan runs backwards along x, or the frames are mirrored left to right",
    "y reversed": "the scan runs backwards along y, or the frames are mirrored top to bottom",
    "both reversed": "the scan runs backwards along both axes, or the frames are turned by 180°",
    "axes swapped": "x and y of the scan are swapped",
}
"""Orders in which the positions may have been recorded, in words."""


@dataclass(frozen=True, slots=True)
class SpotLattice:
    """The spots of one plane.

    Attributes
    ----------
    waves
        Wave vectors of the lenslet lattice ``(k, 2)`` as (x, y) (rad per pixel).
    scale
        Ratio of spot to lattice wave number: 1 / (1 - 1/v).
    order
        Key of `ORDERS`: the scan order that fits the phases.
    modulation
        Modulation by the spots' wave, 0 to 1.
    across
        Number of lenslets across the pattern.
    """

    waves: NDArray[np.float64]
    scale: float
    order: str
    modulation: float
    across: float

    @property
    def usable(self) -> bool:
        """Whether positions can be measured from the phases."""
        return self.modulation >= STRONG and self.across >= 1.7

    @property
    def steady(self) -> bool:
        """Whether the pattern's centroid follows the source; it does not if it is the image of a single lenslet."""
        return self.across >= 1.25 or self.modulation < STRONG

    @property
    def virtual_depth(self) -> float:
        """Virtual depth v from the spacing of the spots, p (1 - 1/v)."""
        turned = self.order == "both reversed"
        scale = -self.scale if turned else self.scale
        return scale / (scale - 1) if abs(scale - 1) > 1e-3 else math.inf


def wave_vectors(
    camera: Camera | None, period: tuple[int, int], scale: tuple[float, float] = (1.0, 1.0)
) -> NDArray[np.float64]:
    """Return the wave vectors of the lenslet lattice, ``(2 or 3, 2)`` as (x, y) (rad per pixel of H).

    With a camera, they are the wave vectors of its lattice, unrounded, at ``scale`` (rows, columns) pixels of H for
    each sensor pixel. Without a camera, they follow from the period: hexagonal if one side is sqrt(3) times the other
    (three types if x is the longer side), else rectangular.
    """
    ny, nx = period
    if camera is not None:
        basis = camera.lattice.basis_um() / camera.sensor.pixel_um * np.array(scale[::-1])
        hexagonal = camera.lattice.kind == "hexagonal"
    else:
        hexagonal = any(abs(r / math.sqrt(3) - 1) < 0.08 for r in (nx / ny, ny / nx))
        pitch = nx / 3 if hexagonal and nx > ny else nx
        row = ny / 2 if hexagonal else ny
        basis = np.array([[pitch, 0.0], [pitch / 2 if hexagonal else 0.0, row]])
    first = np.asarray(2 * math.pi * np.linalg.inv(basis).T, np.float64)
    if not hexagonal:
        return first
    third = min(first[0] + first[1], first[0] - first[1], key=lambda k: float(np.hypot(*k)))
    vectors: NDArray[np.float64] = np.stack([first[0], first[1], third])
    return vectors


def spot_waves(
    frames: NDArray[np.float32], floor: float, vectors: NDArray[np.float64], workers: int | None = None
) -> NDArray[np.complex128]:
    """Return the Fourier sums ``(n, waves)`` of the patterns at the wave vectors q in ``vectors``.

    Each is the sum over pixels of the excess above ``floor`` times ``exp(-i q r)``; other pixels count as 0. The wave
    vectors ``(waves, 2)``, as (x, y), are in rad per pixel, and r is relative to the middle pixel.
    """
    n, nt, ns = frames.shape
    s = np.arange(ns) - (ns - 1) // 2
    t = np.arange(nt) - (nt - 1) // 2
    across = np.exp(-1j * s[:, None] * vectors[:, 0])
    down = np.exp(-1j * t[:, None] * vectors[:, 1])
    out = np.empty((n, len(vectors)), np.complex128)
    if spot_pass.spared(WAVE_S * frames.size * len(vectors)):
        for k, frame in enumerate(frames):
            light = np.where(np.isfinite(frame) & (frame > floor), frame - floor, 0.0)
            out[k] = ((light @ across.real + 1j * (light @ across.imag)) * down).sum(axis=0)
        return out
    shown = kernel_input(frames)
    for_each_chunk(lambda a, b: spot_pass(shown[a:b], floor, across, down, out[a:b], np.empty_like(out[0])), n, workers)
    return out


def _ordered(y: NDArray[np.int64], x: NDArray[np.int64], period: tuple[int, int]) -> dict[str, NDArray[np.float64]]:
    """Return, for each of `ORDERS`, the actual positions ``(n, 2)`` as (x, y) of the frames numbered (y, x)."""
    ny, nx = period
    swapped = (y, x)
    if ny != nx:  # the frames were recorded along y first, but counted along x
        swapped = ((y * nx + x) // ny, (y * nx + x) % ny)
    places = {
        "as planned": (x, y),
        "x reversed": (-x, y),
        "y reversed": (x, -y),
        "both reversed": (-x, -y),
        "axes swapped": swapped,
    }
    return {name: np.stack(place, -1).astype(float) for name, place in places.items()}


def find_spots(
    plane: NDArray[np.float32],
    use: NDArray[np.bool_],
    floor: float,
    waves: NDArray[np.float64],
    diameter_px: float,
    workers: int | None = None,
) -> SpotLattice | None:
    """Return the spots of a plane, or None if nothing is lit.

    The spots of a pattern are ``p (1 - 1/v)`` apart. As the source moves over the lattice's cell, their phase follows
    the lattice's wave vectors. Spacing and scan order are searched together: the order is the one under which the
    phases agree.

    Parameters
    ----------
    plane
        Patterns ``(ny, nx, nt, ns)``.
    use
        Positions to use ``(ny, nx)``.
    floor
        Threshold of lit pixels.
    waves
        Wave vectors of the lattice; see `wave_vectors`.
    diameter_px
        Diameter of the pattern (pixels).
    workers
        Number of threads. None: all processors.
    """
    period = (plane.shape[0], plane.shape[1])
    y, x = _sparse_grid(use)
    if y.size < 16:
        return None
    frames = np.ascontiguousarray(plane[y, x], np.float32)
    length = float(np.hypot(*waves.T).mean())
    places = _ordered(y, x, period)
    scales = SCALES[SCALES * np.hypot(*waves.T).max() < FASTEST]
    best = _search(frames, floor, waves, places, scales, workers)
    if best is None:
        return None
    scale, order, modulation = best
    scale = _spacing(frames, floor, waves, places[order], scale)
    return SpotLattice(waves, scale, order, modulation, diameter_px * scale * length / (2 * math.pi))


def _sparse_grid(use: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of a regular grid of about `SAMPLE` used positions, at most four apart.

    A regular grid keeps the lattice's waves apart as the whole cell does; random positions would not.
    """
    ny, nx = use.shape
    stride = min(4, max(1, round(math.sqrt(ny * nx / SAMPLE))))
    keep = np.zeros_like(use)
    keep[:: min(stride, max(1, ny // 8)), :: min(stride, max(1, nx // 8))] = True
    y, x = np.nonzero(keep & use)
    return y.astype(np.int64), x.astype(np.int64)


def _spacing(
    frames: NDArray[np.float32],
    floor: float,
    waves: NDArray[np.float64],
    place: NDArray[np.float64],
    start: float,
) -> float:
    """Return the ratio of the spots' to the lattice's wave number, from the phase across the middle of the pattern.

    ``D(r) = sum_X H_X(r) exp(-i k X)`` varies as ``exp(i scale k r)`` wherever the pattern is fully lit, for any shape
    of the spots. Its phase from pixel to pixel, summed over the brightest part, gives the spacing.
    """
    n, nt, ns = frames.shape
    lit = frames.reshape(n, -1) - np.float32(floor)
    np.maximum(lit, 0, out=lit)
    lit[~np.isfinite(lit)] = 0
    phase = place @ waves.T
    real, imaginary = np.cos(phase).T.astype(np.float32) @ lit, -np.sin(phase).T.astype(np.float32) @ lit
    found = []
    for wave, image in zip(waves, (real + 1j * imaginary).reshape(-1, nt, ns), strict=True):
        bright = np.abs(image) > BRIGHT * np.abs(image).max()
        steps = []
        for axis, k in ((1, wave[0]), (0, wave[1])):
            a, b = (np.moveaxis(image, axis, 0)[s] for s in (slice(None, -1), slice(1, None)))
            both = np.moveaxis(bright, axis, 0)[:-1] & np.moveaxis(bright, axis, 0)[1:]
            product = complex((np.conj(a) * b)[both].sum())
            # measured relative to the start, so that a phase beyond half a turn is not folded
            steps.append(start * k + cmath.phase(product * cmath.exp(-1j * start * k)) if product else start * k)
        found.append(float(np.dot(steps, wave) / (wave @ wave)))
    scale = float(np.mean(found))
    return scale if abs(scale / start - 1) < 0.5 else start


def _search(
    frames: NDArray[np.float32],
    floor: float,
    waves: NDArray[np.float64],
    places: dict[str, NDArray[np.float64]],
    scales: NDArray[np.float64],
    workers: int | None,
) -> tuple[float, str, float] | None:
    """Return spacing, order of the scan and modulation with the best agreement, or None if nothing is lit."""
    vectors = (scales[:, None, None] * waves).reshape(-1, 2)
    sums = spot_waves(frames, floor, vectors, workers).reshape(len(frames), len(scales), len(waves))
    energy = float(spot_waves(frames, floor, np.zeros((1, 2)), workers).real.mean())
    if not energy > 0:
        return None
    size = np.abs(sums).mean(0) / energy
    best, top = None, 0.0
    for name, place in places.items():
        turn = np.exp(-1j * (place @ waves.T))
        agree = np.abs((sums * turn[:, None, :]).mean(0)) / energy
        score = agree.min(1)
        k = int(np.argmax(score))
        # "as planned" comes first and must be exceeded clearly, because a symmetric lattice fits other orders too
        if best is None or score[k] > 1.15 * top:
            best, top = (float(scales[k]), name, float(size[k].min())), float(score[k])
    return best


def displacements(
    plane: NDArray[np.float32], spots: SpotLattice, floor: float, workers: int | None = None
) -> NDArray[np.float64]:
    """Return the displacement of each pattern's lattice, ``(2, ny, nx)`` as (y, x) (pixels).

    It comes from the phases of the spots' waves, relative to those of the mean. A frame at a wrong position is
    displaced by as many pixels as it is positions away; a stage error e displaces by -e / (v - 1).
    """
    ny, nx = plane.shape[:2]
    frames = plane.reshape(ny * nx, *plane.shape[2:])
    sums = spot_waves(frames, floor, spots.scale * spots.waves, workers)
    y, x = np.divmod(np.arange(ny * nx), nx)
    place = _ordered(y, x, (ny, nx))[spots.order]
    turned = sums * np.exp(-1j * (place @ spots.waves.T))
    turned /= np.abs(turned) + 1e-300  # only phases: bright patterns are not placed more accurately
    phase = np.angle(turned * np.conj(turned.mean(0)))
    shift = phase @ np.linalg.pinv(spots.waves).T
    return np.ascontiguousarray(shift[:, ::-1].T.reshape(2, ny, nx))
