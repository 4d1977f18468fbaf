"""What a simulation costs, foretold from the description and one short timing of this machine.

Counts are complex multiply-adds; the machine's rate is that of a small matrix product on one thread. The constants
were fitted to the engines of this package and hold within a factor of about 2; `predict_seconds` measures instead.
"""

from __future__ import annotations

import math
import time
from functools import lru_cache

import numpy as np

from lfcal.simulate.effects.outlook import Outlook
from lfcal.threads import one_blas_thread

__all__ = ["engine_seconds", "frame_seconds", "machine_rate", "table_seconds"]

NODES = 3
"""Sensor nodes per pixel and axis that a usual tolerance takes."""

MARGIN = 4
"""Pixels of window around a geometric spot."""


@lru_cache(maxsize=1)
def machine_rate() -> float:
    """Return complex multiply-adds per second of one thread of this machine (measured once, 20 ms)."""
    n = 96
    a = np.ones((n, n), np.complex64)
    best = math.inf
    with one_blas_thread():
        for _ in range(8):
            start = time.perf_counter()
            a @ a
            best = min(best, time.perf_counter() - start)
    return n**3 / best


def engine_seconds(outlook: Outlook, level: str) -> float:
    """Return CPU-seconds of one whole plane at a level: ``geometric``, ``wave``, ``microscope`` or ``reference``."""
    positions = outlook.period[0] * outlook.period[1]
    pixels = outlook.pixels
    if level == "geometric":
        per_response = 1.5e-6 + 4e-9 * (2 * max(outlook.geometric_px) + 2) ** 2
        return positions * (outlook.lenslets * per_response + pixels * 1.0e-10)
    if level in ("debye", "microscope"):
        side = 2.2 * math.sqrt(pixels) * 3
        return positions / 4 * side**2 * math.log2(side) * 4 / machine_rate()
    macs = sum(_macs(outlook, radius) for radius in outlook.geometric_px) / len(outlook.defocus)
    wave = positions * 1.3 * outlook.lenslets * (2.0 * macs / machine_rate() + 6e-6)
    return wave if level == "wave" else 800 * wave


def _macs(outlook: Outlook, spot_px: float) -> float:
    """Return multiply-adds of one lenslet's response: two matrix products between aperture and sensor nodes."""
    half = math.ceil(spot_px + MARGIN)
    finest = 2 * (half + 0.5) * outlook.pixel_um**2 / (outlook.wavelength_um * outlook.gap_um)
    n = 2 * outlook.lit_px * max(1.0, finest) + 3
    m = (2 * half + 1) * NODES
    return n * n * m + n * m * m


def table_seconds(outlook: Outlook) -> float:
    """Return CPU-seconds of the Fourier transform that makes a plane's table of the main iris's fringes."""
    side = 2 * (2 * outlook.shadow_px + 4 * outlook.camera.pitch_px)
    return side**2 * math.log2(max(2.0, side)) * 20 / machine_rate()


def frame_seconds(outlook: Outlook, effect: str) -> float:
    """Return CPU-seconds of one frame effect over all frames of a plane."""
    rows, columns = outlook.camera.sensor.shape
    nanoseconds = {"shot_noise": 25.0, "read_noise": 9.0, "fixed_pattern": 9.0}.get(effect, 1.0)
    return outlook.period[0] * outlook.period[1] * rows * columns * nanoseconds * 1e-9
