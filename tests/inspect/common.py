"""A clean recording of the bench camera by lfcal's own simulator, and faults put into it."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan, preset
from lfcal.inspect import Evidence, Finding, iter_evidence, iter_search
from lfcal.progress import drain
from lfcal.psf import PSFMatrix
from lfcal.simulate import simulate_psf

PEAK, READ, PHOTONS = 3000.0, 3.0, 0.2
PATTERNS = 60
Values = NDArray[np.float32]


@cache
def plan() -> ScanPlan:
    """Return a scan of two planes."""
    return ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=41)


@cache
def _light() -> Values:
    H = simulate_psf(plan().camera, plan(), workers=1)
    values = np.asarray(H[:], np.float32)
    return values * np.float32(PEAK / values.max())


def noisy(light: Values, seed: int = 0) -> Values:
    """Return light as a camera counts it: lamp (0.5 %), photons, read noise."""
    rng = np.random.default_rng(seed)
    lit = light * (1 + 0.005 * rng.standard_normal(light.shape[:3]))[..., None, None]
    found = lit + np.sqrt(READ**2 + PHOTONS * np.maximum(lit, 0)) * rng.standard_normal(light.shape)
    return found.astype(np.float32)


def clean() -> Values:
    """Return the recording without a fault, to be changed at will."""
    return noisy(_light())


def light() -> Values:
    """Return the light before any noise, to be changed at will."""
    return _light().copy()


def matrix(values: Values) -> PSFMatrix:
    """Return H of the values."""
    return PSFMatrix(values, depths=plan().depths_um, camera=plan().camera, anchor=plan().anchor)


def evidence_of(values: Values, patterns: int = PATTERNS) -> Evidence:
    """Return what patterns show beside their camera."""
    found = drain(iter_evidence(matrix(values), patterns=patterns))
    assert isinstance(found, Evidence), found
    return found


def faults_of(values: Values, patterns: int = PATTERNS) -> dict[str, Finding]:
    """Return the faults that are found, by name."""
    found, _ = drain(iter_search(evidence_of(values, patterns)))
    return {one.name: one for one in found}


def scaled(values: Values, image: Values) -> Values:
    """Return values times an image of the sensor ``(rows, columns)`` under each cutout."""
    out = values.copy()
    _, ny, nx, nt, ns = values.shape
    for y in range(ny):
        for x in range(nx):
            out[:, y, x] *= image[y : y + nt, x : x + ns]
    return out


def added(values: Values, image: Values) -> Values:
    """Return values with an image of the sensor ``(rows, columns)`` added under each cutout."""
    out = values.copy()
    _, ny, nx, nt, ns = values.shape
    for y in range(ny):
        for x in range(nx):
            out[:, y, x] += image[y : y + nt, x : x + ns]
    return out


def sensor(value: float) -> Values:
    """Return an image of the scanned part of the sensor."""
    _, ny, nx, nt, ns = plan().shape
    return np.full((ny + nt - 1, nx + ns - 1), value, np.float32)


def compressed(values: Values, quality: int) -> Values:
    """Return each frame as a JPEG of 8 bits gives it back."""
    out = np.empty_like(values)
    for k, frame in enumerate(values.reshape(-1, *values.shape[3:])):
        bytes_ = np.clip(frame / PEAK * 230 + 10, 0, 255).astype(np.uint8)
        done, packed = cv2.imencode(".jpg", bytes_, [cv2.IMWRITE_JPEG_QUALITY, quality])
        assert done
        back = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE).astype(np.float32)
        out.reshape(-1, *values.shape[3:])[k] = (back - 10) / 230 * PEAK
    return out
