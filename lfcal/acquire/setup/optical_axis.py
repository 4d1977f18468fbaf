"""Find the optical axis: the lateral position at which a movement in depth does not move the image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.acquire._looking import Looker
from lfcal.acquire.control import Control
from lfcal.acquire.options import Options
from lfcal.base import Clock, InputError, Work
from lfcal.camera import ScanPlan
from lfcal.devices import Rig

__all__ = ["OpticalAxis", "find_optical_axis", "iter_optical_axis"]


@dataclass(frozen=True, slots=True)
class OpticalAxis:
    """Measured position of the optical axis in object space and on the sensor.

    Attributes
    ----------
    object_um
        Lateral position (right, down) of a source whose image does not move when its depth changes, in object
        coordinates of the plan (µm).
    image_px
        Position (row, column) of that image on the sensor (px), the mean of the positions fitted in each plane.
    residual_px
        RMS distance of the positions fitted in each plane from ``image_px`` (px).
    """

    object_um: tuple[float, float]
    image_px: tuple[float, float]
    residual_px: float


def find_optical_axis(object_um: ArrayLike, image_px: ArrayLike) -> OpticalAxis:
    """Return the optical axis, computed from the images of a source at several depths and lateral positions.

    In each plane k, the image position is an affine function ``M_k p + t_k`` of the lateral position p, with the matrix
    ``M_k`` and the shift ``t_k``. The axis is the p at which all planes agree best (least squares).

    Parameters
    ----------
    object_um
        J >= 3 lateral positions (right, down) of the source in each of K >= 2 planes (µm), ``(K, J, 2)``.
    image_px
        Centroids (row, column) of the images on the sensor (px), ``(K, J, 2)``.

    Raises
    ------
    InputError
        If there are too few positions or planes, or the magnification is the same at all depths. A telecentric system
        has no such axis; if its image moves, a stage axis is tilted.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.acquire.setup import OpticalAxis, find_optical_axis
    >>> places = np.random.default_rng(0).uniform(-500, 500, (3, 6, 2))  # six in each of three planes (um)
    >>> images = [(150, 160) + m * (p - (30, -80))[:, ::-1] for m, p in zip((0.03, 0.04, 0.05), places)]
    >>> axis: OpticalAxis = find_optical_axis(places, images)
    >>> print([round(v, 1) for v in axis.object_um], [round(v, 1) for v in axis.image_px])
    [30.0, -80.0] [150.0, 160.0]
    """
    places, seen = np.asarray(object_um, float), np.asarray(image_px, float)
    if places.shape != seen.shape or places.ndim != 3 or places.shape[0] < 2 or places.shape[1] < 3:
        raise InputError.expected(
            "optical axis",
            "3 or more positions in 2 or more planes, and an image of each",
            f"shape {places.shape} and {seen.shape}",
            "measure more of them",
        )
    maps, shifts, residuals = [], [], []
    for place, image in zip(places, seen, strict=True):
        design = np.column_stack([place, np.ones(len(place))])
        solution, *_ = np.linalg.lstsq(design, image, rcond=None)
        maps.append(solution[:2].T)
        shifts.append(solution[2])
        residuals.append(design @ solution - image)
    scale, offset = np.array(maps), np.array(shifts)
    change = (scale - scale.mean(axis=0)).reshape(-1, 2)
    noise = float(np.sqrt(np.mean(np.square(residuals))))
    span = float(np.ptp(places.reshape(-1, 2), axis=0).max())
    # the change of scale must move the edge of the measured field by more than the centroids' noise
    if np.linalg.svd(change, compute_uv=False)[-1] * span < max(3 * noise, 1e-6):
        raise InputError.expected(
            "magnification",
            "one that changes with depth",
            "the same in all planes",
            "use planes farther apart; a telecentric system has no such axis, so centre the scan in the field",
        )
    # M_k a + t_k is the same in all planes: its deviations from the mean vanish
    axis, *_ = np.linalg.lstsq(change, -(offset - offset.mean(axis=0)).ravel(), rcond=None)
    images = scale @ axis + offset
    middle = images.mean(axis=0)
    residual = float(np.sqrt(((images - middle) ** 2).sum(axis=1).mean()))
    return OpticalAxis((float(axis[0]), float(axis[1])), (float(middle[0]), float(middle[1])), residual)


def iter_optical_axis(
    rig: Rig,
    plan: ScanPlan,
    *,
    planes: Sequence[int] | None = None,
    options: Options | None = None,
    control: Control | None = None,
) -> Work[OpticalAxis]:
    """Measure the optical axis with images at 45 lateral positions in each of several depth planes.

    Nothing is recorded, and the stage returns to its previous position.

    Parameters
    ----------
    rig, plan, options, control
        As in `lfcal.acquire.iter_record`.
    planes
        Indices of the depth planes. None: first and last.

    Raises
    ------
    InputError
        If there are fewer than two planes (nothing was moved), there is no light, or the axis cannot be computed
        (`find_optical_axis`).

    Examples
    --------
    >>> from lfcal.acquire.setup import iter_optical_axis
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0, 5.0], cutout=21)
    >>> axis = drain(iter_optical_axis(simulated_rig(plan), plan))
    >>> print(f"{max(abs(v - 159.5) for v in axis.image_px):.0f} pixels from the sensor's centre")
    0 pixels from the sensor's centre
    """
    options, control = options or Options(), control or Control()
    chosen = sorted(set(planes if planes is not None else (0, len(plan.depths_um) - 1)))
    if len(chosen) < 2:
        raise InputError.expected(
            "planes for the optical axis",
            "two or more",
            f"{len(chosen)}",
            "plan a second plane: the axis is where a move in depth does not shift the image",
        )
    objects = _places(plan, chosen)
    targets = plan.stage.to_stage(objects.reshape(-1, 3))
    exposures = plan.exposures
    clock = Clock("optical axis", len(targets))
    seen = []
    with Looker(rig, plan, options, control, targets=targets) as looker:
        for k, (x, y, depth) in enumerate(targets.tolist()):
            yield clock.at(k)
            looker.go((x, y, depth))
            seen.append(looker.find_spot(exposures[chosen[k // objects.shape[1]]]))
    yield clock.at(len(targets))
    return find_optical_axis(objects[..., :2], np.array(seen).reshape(len(chosen), -1, 2))


def _places(plan: ScanPlan, planes: list[int]) -> NDArray[np.float64]:
    """Return object points (right, down, away) ``(K, 45, 3)`` (µm): nine at each of five places of the sensor.

    The places are the centre and four points around it. The nine positions are a third of a period apart, so that the
    first harmonics of the lenslets' pattern cancel. The harmonics would displace centroids by more than the change
    of magnification does.
    """
    ny, nx = plan.period
    rows, columns = (size // 4 // n * n for size, n in zip(plan.camera.sensor.shape, (ny, nx), strict=True))
    corners = np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]]) * np.array([max(columns, nx), max(rows, ny)])
    within = np.stack(np.meshgrid([-nx / 3, 0, nx / 3], [-ny / 3, 0, ny / 3]), axis=-1).reshape(-1, 2)
    offsets = (corners[:, None] + within).reshape(-1, 2)
    result = np.zeros((len(planes), len(offsets), 3))
    for k, z in enumerate(planes):
        result[k, :, :2] = offsets * plan.camera.step_um(plan.depths_um[z])
        result[k, :, 2] = plan.depths_um[z]
    return result
