"""Fit the pose of a target to the images of its holes, with pitch and distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.targets.images import HoleImages, hole_images
from lfcal.targets.pose import Pose
from lfcal.targets.target import Target

__all__ = ["PoseFit", "fit_pose"]

Array = NDArray[np.float64]

ANGLES = ("rotation_rad", "tilt_right_rad", "tilt_down_rad")
NAMES = tuple(field.name for field in fields(Pose))

MOUNT = {"rotation_rad": math.radians(5.0), "tilt_right_rad": math.radians(3.0), "tilt_down_rad": math.radians(3.0)}
"""Assumed uncertainty of the angles of a mount (rad)."""

SCALE = 0.03
"""Assumed relative uncertainty of the ratio of pitch to distance."""

BENT = 0.01
"""Typical relative distortion of lenses at the sensor's corner."""

LEAST_PX = 0.02
"""Smallest error of a centroid (pixels); a fit of few points may suggest a smaller one."""

FEW_PAIRS = 8
"""Smallest number of neighbours for measuring their correlation."""

FAR = 4.0
"""Number of standard deviations above which a point gets a lower weight."""


@dataclass(frozen=True, eq=False)
class PoseFit:
    """Measured pose of a target.

    Attributes
    ----------
    pose, sigma
        The pose, and the standard deviations of its values.
    scale, scale_sigma
        Ratio of the measured to the described pitch (rows, columns), at the described distance, and its standard
        deviation.
    bend, bend_sigma
        Relative distortion at the sensor's corner (displacement divided by the distance from the axis), and its
        standard deviation. It grows with the square of the distance.
    rms_px
        RMS deviation of the images from their fitted positions, per axis (pixels).
    """

    pose: Pose
    sigma: Pose
    scale: tuple[float, float]
    scale_sigma: tuple[float, float]
    bend: float
    bend_sigma: float
    rms_px: float
    _values: Array
    _spread: Array

    def images(self, target: Target, camera: Camera, z_um: float) -> HoleImages:
        """Return the images of all holes for this pose."""
        return _images(self._values, target, camera, z_um)

    def pixel_sigma(self, target: Target, camera: Camera, z_um: float) -> Array:
        """Return the standard deviation ``(n, 2)`` of the positions of the images (pixels)."""
        rows = _slopes(self._values, target, camera, z_um)
        found: Array = np.sqrt(np.maximum(np.einsum("nik,kl,nil->ni", rows, self._spread, rows), 0.0))
        return found


def fit_pose(
    target: Target, camera: Camera, z_um: float, holes: NDArray[np.intp], pixels: Array, *, start: Pose | None = None
) -> PoseFit:
    """Return the pose, pitch and distortion that best explain the images ``pixels`` ``(n, 2)`` of ``holes`` ``(n, 2)``.

    This is a least-squares fit with the stated pose as a prior. `Target.within` gives the bounds of each value (treated
    as two standard deviations). The uncertainty of an angle is at least that of a mount, and right and down are hardly
    limited. Points far from their fitted positions have a lower weight (Huber loss). The fit begins at the pose
    ``start``. None: at the stated pose.
    """
    from scipy.optimize import least_squares

    known = replace(target, absent=())
    columns = known.shape[1]
    which = np.asarray(holes, np.intp) @ np.array([columns, 1])
    step = camera.step_um(z_um)
    centre = _values_of(target.pose)
    begin = _values_of(start or target.pose)
    prior = _prior(target, step)
    # a single row or hole does not determine tilt or pitch across it, so the prior applies
    noise = 0.2

    def residuals(values: Array) -> Array:
        off = (_images(values, known, camera, z_um).pixels[which] - pixels) / noise
        return np.concatenate([off.ravel(), (values - centre) / prior])

    scale = np.minimum(prior, np.array([1e-3, 1e-3, 1e-3, step, step, 1e3, 1e-3, 1e-3, 1e-3]))
    for _ in range(3):
        found = least_squares(residuals, begin, x_scale=scale, loss="huber", f_scale=FAR)
        begin = np.asarray(found.x, np.float64)
        off = _images(begin, known, camera, z_um).pixels[which] - pixels
        usual = 1.4826 * float(np.median(np.abs(off)))
        freedom = max(0.2, 1 - 5 / (2 * len(pixels)))
        noise = max(LEAST_PX, usual / math.sqrt(freedom))
    # a deviation shared by neighbours is not noise: the centroid depends on the phase
    slopes = np.asarray(found.jac, np.float64)
    spread: Array = np.asarray(np.linalg.inv(slopes.T @ slopes), np.float64) * _alike(np.asarray(holes, np.intp), off)
    sigma = np.sqrt(np.diag(spread))
    numbers = {name: float(v) for name, v in zip(NAMES, sigma[:6], strict=True)}
    rms = float(np.sqrt(np.square(np.clip(off, -FAR * noise, FAR * noise)).mean()))
    return PoseFit(
        Pose(*begin[:6].tolist()),
        Pose(**{name: min(value, 1.0) if name in ANGLES else value for name, value in numbers.items()}),
        (1.0 + float(begin[6]), 1.0 + float(begin[7])),
        (float(sigma[6]), float(sigma[7])),
        float(begin[8]),
        float(sigma[8]),
        rms,
        begin,
        spread,
    )


def _alike(holes: NDArray[np.intp], off: Array) -> float:
    """Return the factor by which correlated deviations ``(n, 2)`` of neighbours increase variances.

    If neighbours in a sequence have the correlation r, n values are equivalent to n (1 - r) / (1 + r) independent ones
    (Bayley and Hammersley 1946). This is applied to rows and to columns.
    """
    at = {tuple(hole): k for k, hole in enumerate(holes.tolist())}
    power, grows = float(np.square(off).mean()), 1.0
    for step in ((1, 0), (0, 1)):
        pairs = [(k, at[r + step[0], c + step[1]]) for (r, c), k in at.items() if (r + step[0], c + step[1]) in at]
        if len(pairs) < FEW_PAIRS or power == 0:
            continue
        first, second = np.array(pairs).T
        likeness = min(0.9, max(0.0, float((off[first] * off[second]).mean()) / power))
        grows *= (1 + likeness) / (1 - likeness)
    return grows


def _values_of(pose: Pose) -> Array:
    return np.array([getattr(pose, name) for name in NAMES] + [0.0, 0.0, 0.0])


def _prior(target: Target, step_um: float) -> Array:
    """Return the standard deviation with which each value is known before the fit."""
    known = []
    for name in NAMES:
        stated = getattr(target.within, name) / 2
        # the frame determines the position of the target independently of the stage, but hardly its distance
        least = {"right_um": 1e3 * step_um, "down_um": 1e3 * step_um, "away_um": 1e-3}.get(name) or MOUNT[name]
        known.append(max(stated, least))
    return np.array([*known, SCALE, SCALE, BENT])


def _images(values: Array, target: Target, camera: Camera, z_um: float) -> HoleImages:
    """Return the images of a target's holes for fitted values of pose, pitch and distortion."""
    pitch = tuple(p * (1.0 + s) for p, s in zip(target.pitch_um, values[6:8], strict=True))
    seen = replace(target, pose=Pose(*values[:6].tolist()), pitch_um=pitch)
    images = hole_images(seen, camera, z_um)
    centre = np.array(camera.sensor.centre_px)
    away = images.pixels - centre
    far = np.square(away).sum(1) / np.square(centre).sum()
    return replace(images, pixels=centre + away * (1.0 + values[8] * far)[:, None])


def _slopes(values: Array, target: Target, camera: Camera, z_um: float) -> Array:
    """Return the derivatives ``(n, 2, 9)`` of the image positions with respect to the fitted values."""
    step = camera.step_um(z_um)
    out = []
    for k, by in enumerate([1e-5, 1e-5, 1e-5, 0.01 * step, 0.01 * step, 1.0, 1e-5, 1e-5, 1e-5]):
        further, less = values.copy(), values.copy()
        further[k] += by
        less[k] -= by
        ahead, behind = (_images(v, target, camera, z_um).pixels for v in (further, less))
        out.append((ahead - behind) / (2 * by))
    return np.stack(out, axis=-1)
