"""Demultiplexing filters: error of colours or samples between pixels versus time per frame."""

from __future__ import annotations

import math

import numpy as np

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.camera import Sensor
from lfcal.multiplex import WAYS, cfa, iter_measure_filters, zone_plate

__all__ = ["PART"]

SIDE = 256
HIGHEST = 0.2
"""Highest frequency of the scene (cycles per pixel)."""

FULL = 0.8


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and time of demultiplexing a known noisy scene, for each pair of route and filter in `WAYS`."""
    sensor = _sensor(subject)
    pattern = sensor.cfa or "Bayer"
    modulator = cfa(pattern)
    scene = zone_plate((SIDE, SIDE), HIGHEST)
    # values relative to the full well; rms photon and read noise at the mean level
    level = FULL * sensor.full_well_e
    rms = math.sqrt(level / 2 + sensor.read_noise_e**2) / level
    noise = rms * np.random.default_rng(0).standard_normal((SIDE, SIDE))
    pixels = math.prod(sensor.shape)
    named = (
        f"the sensor's {pattern} pattern" if sensor.cfa else f"a {pattern} pattern, because the sensor has no filters"
    )
    yield Truth(
        f"the scene itself, a zone plate up to {HIGHEST:g} cycles per pixel",
        (
            f"{named}; noise of {100 * rms:.2g} %",
            f"times scaled from {SIDE} x {SIDE} px to a frame",
        ),
    )
    for route, name in WAYS:
        yield AccuracyStep(f"{route}, {name}")
        work = iter_measure_filters(
            scene, modulator, ways=((route, name),), noise=noise, rounds=2, workers=subject.workers
        )
        trial = (yield from work)[0]
        cost = trial.seconds * pixels / SIDE**2
        yield CostPoint(trial.name, {"route": route, "filter": name, "pattern": pattern}, trial.error, cost, "seconds")


def _sensor(subject: Subject) -> Sensor:
    if subject.matrix is not None and subject.matrix.camera is not None:
        return subject.matrix.camera.sensor
    return subject.planned.camera.sensor


PART = AccuracyPart(
    "filters",
    "Multiplexing: route and filter",
    "rms error of the samples, relative to the scene's range",
    "time per frame of the sensor",
    "seconds",
    measure,
    rank=90,
)
