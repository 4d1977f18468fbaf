"""Lattice fit: error of the fitted lenslet positions in a white image versus time of the fit."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.camera import Camera
from lfcal.lattice import MicroImageLattice, fit_lattice, lattice_of
from lfcal.simulate import expose
from lfcal.simulate.effects import FrameEffect, Quantisation, ReadNoise, Saturation, ShotNoise
from lfcal.simulate.sensor import FrameKind

__all__ = ["PART", "white_discs"]

SIDES = (8, 12, 18, 28, 42, 64, 96, 140)
"""Sides of the fitted parts of the white image (lenslets)."""

LEVEL = 0.6
"""Fraction of the full well that the brightest pixels reach."""

NOISE: tuple[FrameEffect, ...] = (ShotNoise(), Saturation(), ReadNoise(), Quantisation())
FILL, SOFT_PX = 0.95, 0.4
"""Largest diameter of a micro-image over the pitch, and the width of its edge (pixels)."""

GROWTH = 2.6
"""Expected ratio of the time of a point to that of the previous one, which is the ratio of the frames' areas."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and time of lattice fits to increasingly large parts of a synthetic white image of the camera."""
    camera, exposure = subject.planned.camera, max(subject.planned.exposures)
    sensor = camera.sensor
    yield Truth(
        "the lattice of the camera description, at whose points the micro-images are drawn",
        (
            f"discs of {_diameter_px(camera):.3g} px with edges of {SOFT_PX:g} px; brightest at {100 * LEVEL:g} % of "
            f"{sensor.full_well_e:g} e-, read noise {sensor.read_noise_e:g} e-; one frame",
            "an error of 1 % is 0.01 px",
        ),
    )
    took = None
    for side in SIDES:
        part = _middle(camera, side)
        yield AccuracyStep(f"{side} lenslets on each side", None if took is None else GROWTH * took)
        light = white_discs(part) * np.float32(LEVEL * sensor.full_well_e)
        frame = expose(light, part, NOISE, exposure_s=exposure, kind=FrameKind.WHITE)
        if took is None:  # the first fit of a session compiles
            _fitted(part, frame, subject.workers)
        point = _fitted(part, frame, subject.workers)
        took = point.cost
        yield point
        if part.sensor.shape == sensor.shape:
            return


def _middle(camera: Camera, side: int) -> Camera:
    """Return the camera with only the middle of its sensor, at least ``side`` lenslets wide if the sensor is.

    The numbers of rows and columns keep their parity, so that the middle stays on the same part of a pixel.
    """
    wanted = math.ceil(side * camera.pitch_px)
    rows, columns = (min(n, wanted + (n - wanted) % 2) for n in camera.sensor.shape)
    return replace(camera, sensor=replace(camera.sensor, shape=(rows, columns)))


def _diameter_px(camera: Camera) -> float:
    """Return the diameter of a micro-image (pixels): that of the iris's image, or the largest without overlap."""
    image = camera.lattice.gap_um / camera.optics.working_f_number / camera.sensor.pixel_um
    return min(image, FILL * camera.pitch_px)


def white_discs(camera: Camera) -> NDArray[np.float32]:
    """Return a white image ``(rows, columns)`` with values from 0 to 1: a disc with soft edges behind each lenslet."""
    true, (rows, columns) = lattice_of(camera), camera.sensor.shape
    radius = _diameter_px(camera) / 2
    out = np.empty((rows, columns), np.float32)
    x = np.arange(columns, dtype=float)
    for row in range(rows):
        distance = _nearest(true, np.full(columns, float(row)), x)[1]
        out[row] = 1 / (1 + np.exp(np.clip((distance - radius) / SOFT_PX, -40, 40)))
    return out


def _nearest(true: MicroImageLattice, y: NDArray[np.float64], x: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return indices ``(n, 2)`` of the lenslets nearest to points, and their distances (pixels)."""
    near = np.rint(true.lenslet_at(y, x))
    # in an oblique basis the nearest lenslet may be a neighbour of the rounded one
    index = near + np.array([(q, r) for q in (-1, 0, 1) for r in (-1, 0, 1)])[:, None]
    centres = true.centres_px(index[..., 0], index[..., 1])
    distance = np.hypot(centres[..., 0] - y, centres[..., 1] - x)
    best = distance.argmin(axis=0)
    at = np.arange(best.size)
    return index[best, at], distance[best, at]


def _fitted(camera: Camera, frame: NDArray[np.uint16] | NDArray[np.float32], workers: int | None) -> CostPoint:
    start = time.perf_counter()
    fit = fit_lattice(frame, dark=camera.sensor.black_level, workers=workers)
    took = time.perf_counter() - start
    found = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    distance = _nearest(lattice_of(camera), found[:, 0], found[:, 1])[1]
    rows, columns = frame.shape
    count = len(fit.index)
    settings = {"rows": rows, "columns": columns}
    others = {"lenslets": float(count), "pitch error (px)": abs(fit.pitch_px - camera.pitch_px)}
    label = f"{count} lenslets, {rows} x {columns} px"
    return CostPoint(label, settings, math.sqrt(float((distance**2).mean())), took, "seconds", others)


PART = AccuracyPart(
    "lattice",
    "White image: lattice fit",
    "rms distance between the fitted and the true lenslets, in pixels",
    "time of the fit",
    "seconds",
    measure,
    rank=40,
)
