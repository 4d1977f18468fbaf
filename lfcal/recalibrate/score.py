"""The orthogonal score: information of a frame of an unknown object about the camera.

Let m = H(u) g be the expected frame for unknowns u and a volume g. A derivative J = dH/du g is partly the same as a
change of the volume, H dg. This part is projected out, so that to first order the result does not depend on errors of
the volume (effective score; Bickel et al. 1993). Changes of a voxel are limited to about its square root, which keeps
dark voxels dark.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.recalibrate._patterns import VoxelPatterns
from lfcal.recalibrate._scene import ObjectFrame, SceneEstimate

__all__ = ["Goodness", "Score", "goodness", "orthogonal", "score_and_goodness", "score_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

STEPS = 40
"""Largest number of conjugate-gradient steps of a projection."""

RIDGE = 1e-3
"""Regularisation of the projection, relative to the largest diagonal entry."""

DARK = 1e-5
"""Value of a voxel, relative to the largest, below which it cannot change."""

PROBES = 2
"""Number of images of white noise that determine the expected residual."""


@dataclass(frozen=True, eq=False)
class Score:
    """Information of one or more frames about the camera's unknowns, after elimination of objects and dark fields.

    Attributes
    ----------
    information
        Matrix ``(k, k)`` for unknowns in units of their scales.
    gradient
        Vector ``(k,)``: information times the step of the unknowns that the frames alone suggest.
    """

    information: F8
    gradient: F8

    @classmethod
    def none(cls, count: int) -> Score:
        """Return the score of no frames, for ``count`` unknowns."""
        return cls(np.zeros((count, count)), np.zeros(count))

    def __add__(self, other: Score) -> Score:
        """Return the score of the frames of both objects together."""
        return Score(self.information + other.information, self.gradient + other.gradient)


def orthogonal(
    patterns: VoxelPatterns, volume: F4, weight: F4, images: F4, fields: F4 | None = None, steps: int = STEPS
) -> F4:
    """Return ``images`` ``(k, rows, columns)`` without the part that changes of volume and dark field can produce.

    Parameters
    ----------
    patterns, volume
        Patterns of the n voxels, and values of the voxels ``(n,)``.
    weight
        Inverse variance of each pixel ``(rows, columns)``.
    images
        Images to project.
    fields
        Dark fields ``(d, rows, columns)``. None: there is no dark field.
    steps
        Largest number of conjugate-gradient steps.
    """
    light = np.maximum(volume, 0)
    lit = light > DARK * light.max(initial=0.0)
    patterns, root = patterns.of(lit), np.sqrt(light[lit]).astype(np.float32)[None]
    own = _orthonormal(weight, images[:0] if fields is None else fields)

    def rest(some: F4) -> F4:
        flat = some.reshape(len(some), -1)
        imitated: F4 = np.matmul(np.matmul(flat * weight.ravel(), own.T), own)
        return (flat - imitated).reshape(some.shape)

    if not lit.any():  # a window without signal
        return rest(images)

    def normal(v: F4) -> F4:
        found: F4 = root * patterns.sums(weight * rest(patterns.images(root * v)))
        return found

    images = rest(images)
    right = root * patterns.sums(weight * images)
    ridge = np.float32(RIDGE * float(normal(np.ones_like(root)).max(initial=0.0)))
    found, left = np.zeros_like(right), right.copy()
    direction, power = left.copy(), np.square(left, dtype=np.float64).sum(1)
    first = power.copy()
    for _ in range(steps):
        if (power < 1e-6 * first).all():
            break
        along = normal(direction) + ridge * direction
        size = power / np.maximum((direction * along).sum(1, dtype=np.float64), 1e-30)
        length = size.astype(np.float32)[:, None]
        found += length * direction
        left -= length * along
        now = np.square(left, dtype=np.float64).sum(1)
        direction = left + (now / np.maximum(power, 1e-30)).astype(np.float32)[:, None] * direction
        power = now
    free: F4 = images - rest(patterns.images(root * found))
    return free


def _orthonormal(weight: F4, fields: F4) -> F4:
    """Return an orthonormal basis ``(d, pixels)`` of images ``(d, rows, columns)`` in the product with ``weight``."""
    flat = fields.reshape(len(fields), weight.size).astype(np.float64)
    values, vectors = np.linalg.eigh((flat * weight.ravel()) @ flat.T)
    good = values > 1e-10 * values.max(initial=0.0)
    basis: F4 = ((vectors[:, good] / np.sqrt(values[good])).T @ flat).astype(np.float32)
    return basis


def score_of(patterns: VoxelPatterns, frame: ObjectFrame, scene: SceneEstimate, derivatives: F4, fields: F4) -> Score:
    """Return the score of a frame.

    Parameters
    ----------
    patterns, frame, scene
        Patterns of the voxels, the frame, and the estimate of its object.
    derivatives
        Derivatives of the expected frame with respect to the unknowns, ``(k, rows, columns)``, for the volume of the
        scene.
    fields
        Dark fields ``(d, rows, columns)``, which are eliminated as well.
    """
    weight = frame.inverse_variance(scene.expected)
    free = orthogonal(patterns, scene.volume, weight, derivatives, fields)
    return _score(free, weight, frame.electrons - scene.expected)


class Goodness(NamedTuple):
    """How large the residual of a frame is relative to its noise.

    Attributes
    ----------
    ratio
        Weighted sum of squared residuals divided by its expected value; about 1 if the model explains the frame.
    freedom
        Degrees of freedom of the residual. Noise alone changes the ratio by about ``sqrt(2 / freedom)``.
    """

    ratio: float
    freedom: float


def goodness(patterns: VoxelPatterns, frame: ObjectFrame, scene: SceneEstimate, fields: F4, seed: int = 0) -> Goodness:
    """Return the goodness of fit of a frame.

    Components that changes of the volume or the dark fields can explain are projected out of the residual. Its expected
    sum of squares follows from simulated white noise with the same components projected out. ``seed`` is that of the
    noise; the other parameters are those of `score_of`.
    """
    weight = frame.inverse_variance(scene.expected)
    images = _residual_and_noise(frame, scene, weight, seed)
    return _goodness(images, orthogonal(patterns, scene.volume, weight, images, fields), weight)


def score_and_goodness(
    patterns: VoxelPatterns, frame: ObjectFrame, scene: SceneEstimate, derivatives: F4, fields: F4, seed: int = 0
) -> tuple[Score, Goodness]:
    """Return the score of a frame, and the goodness of fit after the step that the score proposes.

    Both share one projection. The parameters are those of `score_of`; ``seed`` is that of the noise, as in `goodness`.
    """
    weight = frame.inverse_variance(scene.expected)
    images = _residual_and_noise(frame, scene, weight, seed)
    free = orthogonal(patterns, scene.volume, weight, np.concatenate([images, derivatives]), fields)
    moved, free = free[len(images) :], free[: len(images)]
    own = _orthonormal(weight, moved)
    flat = free.reshape(len(free), -1)
    left = flat - (flat * weight.ravel()) @ own.T @ own
    return _score(moved, weight, images[0]), _goodness(images, left.reshape(images.shape).astype(np.float32), weight)


def _score(free: F4, weight: F4, residual: F4) -> Score:
    """Return the score of a residual, given the projected derivatives ``free``."""
    flat = free.reshape(len(free), -1)
    weighted = (flat * weight.ravel()).astype(np.float64)
    return Score(weighted @ flat.T.astype(np.float64), weighted @ residual.ravel().astype(np.float64))


def _residual_and_noise(frame: ObjectFrame, scene: SceneEstimate, weight: F4, seed: int) -> F4:
    """Return the residual, and images of white noise that is drawn: ``(1 + PROBES, rows, columns)``."""
    rng = np.random.default_rng(seed)
    scale = np.where(weight > 0, 1 / np.sqrt(np.maximum(weight, 1e-12)), 0)
    probes = scale * rng.standard_normal((PROBES, *weight.shape))
    residual = frame.valid * (frame.electrons - scene.expected)
    return np.concatenate([residual[None], probes]).astype(np.float32)


def _goodness(images: F4, free: F4, weight: F4) -> Goodness:
    """Return the goodness of fit, given residual and drawn noise, ``images``, and what their projection leaves.

    The drawn noise determines only the degrees of freedom that the projection removes. They are fewer than those that
    remain, so that the result depends little on the draw.
    """
    drawn, left = ((np.square(one, dtype=np.float64) * weight).sum((1, 2)) for one in (images, free))
    freedom = float((weight > 0).sum() - (drawn - left)[1:].mean())
    return Goodness(float(left[0]) / freedom, freedom)
