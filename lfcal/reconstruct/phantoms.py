"""Synthetic volumes for tests, and the error of their reconstruction."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, any_of

__all__ = ["PHANTOMS", "nrmse", "phantom", "points", "vesicle"]


def nrmse(estimate: ArrayLike, truth: ArrayLike) -> float:
    """Return the normalised root-mean-square error: the norm of ``estimate - truth`` divided by that of ``truth``.

    Raises
    ------
    InputError
        If the shapes differ, the arrays are empty, or ``truth`` is zero everywhere.
    """
    a, b = _pair(estimate, truth)
    size = float(np.linalg.norm(b))
    if size == 0:
        raise InputError.expected(
            "truth", "a volume that contains values other than zero", "only zeros", "use another measure"
        )
    return float(np.linalg.norm(a - b)) / size


def _pair(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if x.shape != y.shape:
        got = f"the shapes {x.shape} and {y.shape}"
        raise InputError.expected("arrays to compare", "the same shape", got, "crop them to the same shape")
    if x.size == 0:
        raise InputError.expected("arrays to compare", "at least one value", "none", "give arrays with values")
    return x, y


Shape = tuple[int, int, int]


PHANTOMS = ("points", "vesicle", "plume")
"""Names that `phantom` accepts."""


def points(shape: Shape, positions: Iterable[tuple[int, int, int]], brightness: float = 1.0) -> NDArray[np.float64]:
    """Return a volume of ``shape`` ``(nz, Y, X)`` that is zero except for ``brightness`` at ``positions`` (z, y, x).

    The brightness of repeated positions is added up.

    Raises
    ------
    InputError
        If a position is outside the volume.
    """
    volume = np.zeros(shape)
    for position in positions:
        if not all(0 <= p < n for p, n in zip(position, shape, strict=True)):
            raise InputError.expected("point", f"a point inside {shape}", position, "move the point")
        volume[position] += brightness
    return volume


def vesicle(
    shape: Shape,
    centre: tuple[float, float, float] | None = None,
    radius: float | None = None,
    *,
    thickness: float = 1.5,
    z_step: float = 1.0,
    brightness: float = 1.0,
) -> NDArray[np.float64]:
    """Return a volume ``(nz, Y, X)`` with a spherical shell, like a labelled membrane.

    Parameters
    ----------
    shape
        Shape ``(nz, Y, X)`` of the volume.
    centre
        Centre (z, y, x) of the shell, in planes and voxels; by default the middle.
    radius, thickness
        Radius of the shell (None: a quarter of the smaller of Y and X), and standard deviation of its Gaussian profile
        (voxels in y and x).
    z_step
        Ratio of the distance between planes to the distance between voxels in a plane.
    brightness
        Value on the shell.
    """
    middle = tuple((n - 1) / 2 for n in shape) if centre is None else centre
    size = min(shape[1:]) / 4 if radius is None else radius
    z, y, x = np.ogrid[: shape[0], : shape[1], : shape[2]]
    r = np.sqrt(((z - middle[0]) * z_step) ** 2 + (y - middle[1]) ** 2 + (x - middle[2]) ** 2)
    shell: NDArray[np.float64] = brightness * np.exp(-((r - size) ** 2) / (2 * thickness**2))
    return shell


def plume(shape: Shape, *, width: float | None = None, brightness: float = 1.0, seed: int = 0) -> NDArray[np.float64]:
    """Return a volume with a turbulent jet that widens along x and is brightest in the middle plane.

    Parameters
    ----------
    shape
        Shape ``(nz, Y, X)`` of the volume.
    width
        Rms width of the jet along y at x = 0 (voxels). None: a sixteenth of Y.
    brightness
        Largest value, approximately.
    seed
        Random seed of the shape of the jet.
    """
    nz, height, length = shape
    start = height / 16 if width is None else width
    rng = np.random.default_rng(seed)
    x = np.arange(length)
    spread = start * (1 + 2 * x / length)
    phases = rng.uniform(0, 2 * np.pi, 4)
    sway = sum(np.sin(2 * np.pi * (k + 1) * x / length + phases[k]) / (k + 1) for k in range(4)) * start / 3
    y = np.arange(height)[:, None] - (height - 1) / 2 - sway * (x / length)
    z = (np.arange(nz) - (nz - 1) / 2) / max(1.0, nz / 4)
    from scipy.special import erf  # slow to import

    sheet = np.exp(-(y**2) / (2 * spread**2)) * (start / spread) * 0.5 * (1 + erf((length - x) / (length / 6) - 2))
    volume: NDArray[np.float64] = brightness * np.exp(-(z**2) / 2)[:, None, None] * sheet
    return volume


def phantom(name: str, shape: Shape, seed: int = 0) -> NDArray[np.float64]:
    """Return the phantom ``"points"``, ``"vesicle"`` or ``"plume"``, a volume of ``shape`` ``(nz, Y, X)``.

    Details are scaled to the shape. ``seed`` is the random seed of the points and of the plume.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name == "points":
        rng = np.random.default_rng(seed)
        # away from the border, where half of a point's pattern would be cut off.
        margin = [min(n // 4, 12) if axis else 0 for axis, n in enumerate(shape)]
        low, high = np.array(margin), np.array(shape) - np.array(margin)
        where = rng.integers(low, np.maximum(high, low + 1), (max(4, 2 * shape[0]), 3))
        return points(shape, [(int(z), int(y), int(x)) for z, y, x in where])
    if name == "vesicle":
        return vesicle(shape, z_step=max(1.0, min(shape[1:]) / (2 * shape[0])))
    if name == "plume":
        return plume(shape, seed=seed)
    raise InputError.expected("phantom", any_of(PHANTOMS), repr(name), "choose one of these")
