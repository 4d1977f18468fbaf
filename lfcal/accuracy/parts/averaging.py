"""Averaging and exposure: noise of H versus recording time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import format_seconds, format_share
from lfcal.camera import Camera, Forecast, ScanPlan
from lfcal.frames import Noise
from lfcal.simulate import expose
from lfcal.simulate.effects import FrameEffect, Quantisation, ReadNoise, Saturation, ShotNoise
from lfcal.simulate.sensor import FrameKind, temporal_noise

__all__ = ["EFFECTS", "PART", "dark_level", "expected_noise"]

EXPOSURES = (1.0, 0.25, 4.0)
"""Exposures relative to that of the plan, at which the brightest pixel reaches `FULL` of the full well."""

FRAMES = (1, 2, 4, 8, 16, 32, 64)
FULL = 0.8
EFFECTS: tuple[FrameEffect, ...] = (ShotNoise(), Saturation(), ReadNoise(), Quantisation())
"""Effects of the sensor, without drift and fixed pattern."""

PATTERNS = 4
DARK_PIXELS = 200_000
PIXELS = 40_000_000
"""Largest number of pixels exposed for one point; 64 frames of large cutouts would take minutes."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the relative error of the mean of simulated frames, for several exposures and numbers of frames."""
    plan = subject.planned
    patterns = yield from subject.iter_patterns()
    flat = np.maximum(patterns.values.reshape(-1, *plan.cutout), 0)
    chosen = flat[:: max(1, len(flat) // PATTERNS)][:PATTERNS]
    sensor = plan.camera.sensor
    camera = replace(plan.camera, sensor=replace(sensor, shape=plan.cutout))
    unit = FULL * sensor.full_well_e / float(flat.max())
    z = subject.middle
    yield Truth(
        "the light to which the frames are exposed",
        (
            f"{len(chosen)} patterns; {plan.exposures[z]:g} s bring the brightest pixel to {100 * FULL:g} % of "
            f"{sensor.full_well_e:g} e-, read noise {sensor.read_noise_e:g} e-",
            "the L1 error is the sum of the absolute errors relative to the sum of the light; do not compare it with "
            'the rms error of "Recording: whole scan, or a fit", in which bright pixels weigh more',
            "with photon noise, read noise, full well and quantisation; the mean of dark frames is "
            "subtracted; without drift and fixed pattern",
            *_cut_off(plan.camera),
        ),
    )
    dark = dark_level(camera)
    for times in EXPOSURES:
        light = (chosen * np.float32(unit * times)).astype(np.float32)
        for count in sorted({*FRAMES, plan.frames_averaged}):
            if count * light.size > PIXELS:
                break
            yield AccuracyStep(f"{count} frames of {times:g} times the exposure", 0.3)
            yield _point(plan, (camera, dark), light, times, count)


def dark_level(camera: Camera) -> float:
    """Return the mean sample value of simulated dark frames of ``camera`` (counts).

    If the black level is not well above the read noise, negative values are clipped to zero, and the mean exceeds the
    black level.
    """
    black = np.zeros(camera.sensor.shape, np.float32)
    frames = range(max(1, DARK_PIXELS // black.size))
    means = [expose(black, camera, EFFECTS, exposure_s=1.0, kind=FrameKind.DARK, index=k).mean() for k in frames]
    return float(np.mean(means))


def _point(
    plan: ScanPlan, sensor: tuple[Camera, float], light: NDArray[np.float32], times: float, count: int
) -> CostPoint:
    """Return the point for the mean of ``count`` frames of ``light`` (patterns, nt, ns), less the dark level."""
    camera, dark = sensor
    total = float(light.sum(dtype=np.float64))
    off = 0.0
    seconds = plan.exposures[0] * times
    for number, one in enumerate(light):
        mean = np.zeros(one.shape)
        for index in range(count):
            frame = expose(one, camera, EFFECTS, exposure_s=seconds, seed=number, index=index)
            mean += frame.astype(np.float64) - dark
        off += float(np.abs(mean / count * camera.sensor.electrons_per_count - one).sum())
    exposures = tuple(t * times for t in plan.exposures)
    scan = replace(plan, frames_averaged=count, exposure_s=exposures)
    noise = temporal_noise(EFFECTS, camera)
    model = expected_noise(light, noise, camera.sensor.electrons_per_count, count)
    settings = {"frames_averaged": count, "exposure_s": list(exposures)}
    label = f"{count} frame{'s' * (count > 1)} of {format_seconds(exposures[len(exposures) // 2])}"
    others = {"error by the noise model (%)": 100 * model, "frames": float(scan.n_positions * count)}
    full = float((light >= camera.sensor.full_well_e).mean())
    note = f"{format_share(full)} of the pixels are saturated" if full else ""
    hours, own = Forecast.of(scan).hours, scan == plan
    return CostPoint(label, settings, off / total, 3600 * hours, "seconds", others, note, in_use=own)


def _cut_off(camera: Camera) -> tuple[str, ...]:
    sensor = camera.sensor
    if sensor.black_level * sensor.electrons_per_count >= 3 * sensor.read_noise_e:
        return ()
    return (
        f"the black level of {sensor.black_level:g} is within the read noise, so values are clipped at zero "
        "and do not average out",
    )


def expected_noise(light_e: NDArray[np.float32], noise: Noise, electrons_per_count: float, count: int) -> float:
    """Return the expected mean absolute error of the mean of ``count`` frames, as a fraction of the mean light.

    ``light_e`` is the light in a frame (electrons per pixel), and ``noise`` the noise of a single frame (counts). The
    mean of n values with normal noise of variance v has the mean absolute error ``sqrt(2 v / (pi n))``. With few
    electrons, the noise is not normal, and the result is approximate.
    """
    counts = light_e.astype(np.float64) / electrons_per_count
    variance = float(noise.constant) + float(noise.slope) * counts
    return math.sqrt(2 / (math.pi * count)) * float(np.sqrt(variance).sum() / counts.sum())


PART = AccuracyPart(
    "averaging",
    "Recording: averaging and exposure",
    "relative L1 error of H due to noise, without noise reduction",
    "recording time of the whole scan",
    "seconds",
    measure,
    rank=55,
)
