"""Multiplexing bases: noise of a recovered sample versus exposure."""

from __future__ import annotations

import math

import numpy as np

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import format_seconds
from lfcal.camera import Sensor
from lfcal.multiplex import MASKS, Modulator, amplification, mask

__all__ = ["PART", "sample_noise"]

EXPOSURES = (1.0, 1 / 4, 1 / 16, 1 / 64)
"""Exposures, relative to that at which unmodulated light reaches `FULL` of the full well."""

FULL = 0.8
PRIMES = (3, 5, 7, 11, 13)
"""Sides of super-pixels for which every mask exists."""

PIXELS = 400_000
"""Number of pixels exposed for each point."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the noise of samples recovered by the pseudo-inverse, for each of `MASKS` in uniform light.

    Each mask is measured at several exposures.
    """
    plan = subject.planned
    sensor, exposure = plan.camera.sensor, max(plan.exposures)
    side = min(PRIMES, key=lambda p: abs(p - plan.camera.pitch_px))
    electrons = FULL * sensor.full_well_e
    yield Truth(
        "uniform light, equal in all samples",
        (
            f"super-pixels of {side} x {side} px for a pitch of {plan.camera.pitch_px:.3g} px",
            f"{exposure:g} s of unmodulated light fill {100 * FULL:g} % of {sensor.full_well_e:g} e-; read "
            f"noise {sensor.read_noise_e:g} e-",
        ),
    )
    for kind in MASKS:
        yield AccuracyStep(kind)
        modulator = mask(kind, side)
        inverse = modulator.inverse()
        for share in EXPOSURES:
            yield AccuracyStep(f"{kind}, exposure 1/{1 / share:g}", 0.2)
            rng = np.random.default_rng([MASKS.index(kind), EXPOSURES.index(share)])
            error = sample_noise(modulator, inverse, electrons * share, sensor, rng)
            settings = {"mask": kind, "size": side, "exposure_s": exposure * share}
            label = f"{kind.replace('_', ' ')}, {format_seconds(exposure * share)}"
            others = {"signal-to-noise ratio (dB)": -10 * math.log10(error), "amplification": amplification(modulator)}
            yield CostPoint(label, settings, error, exposure * share, "seconds", others)


def sample_noise(
    modulator: Modulator, inverse: np.ndarray, electrons: float, sensor: Sensor, rng: np.random.Generator
) -> float:
    """Simulate frames of uniform light with photon and read noise; return the relative rms error of recovered samples.

    Parameters
    ----------
    modulator, inverse
        The modulator and its pseudo-inverse ``(samples, pixels)``.
    electrons
        Number of electrons in a pixel in unmodulated light.
    sensor
        Sensor with its read noise.
    rng
        Random generator for the noise.
    """
    even = np.full(modulator.count, 1 / modulator.count)
    light = modulator.matrix @ even
    trials = max(8, PIXELS // modulator.pixels)
    # a lenslet concentrates its light on one pixel, whose full well is not larger
    seen = rng.poisson(np.broadcast_to(light * electrons, (trials, light.size)))
    frames = (seen + rng.normal(0, sensor.read_noise_e, seen.shape)) / electrons
    off = (frames - light) @ inverse.T
    return float(np.sqrt(np.mean(off**2)) * modulator.count)


PART = AccuracyPart(
    "bases",
    "Multiplexing: masks and exposure",
    "rms noise of a recovered sample, relative to its value",
    "exposure of a frame",
    "seconds",
    measure,
    rank=100,
)
