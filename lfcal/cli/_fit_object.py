"""``lfcal fit --object``: the frame of a known object, predicted by H as found, or by H of each region of the field."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import InputError
from lfcal.cli._fit_check import new_frame, single_frames
from lfcal.cli._fit_validate import error_dict

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.cli._fit_source import PatternReading
    from lfcal.fit import Compared, Fit, Measured, NewFrame

__all__ = ["ObjectPlace", "nearest", "object_dict", "object_error", "object_words", "read_object"]


@dataclass(frozen=True, eq=False)
class ObjectPlace:
    """Where H holds.

    Attributes
    ----------
    H
        Its file.
    middle_px
        The middle (row, column) of its scan on the sensor.
    gains
        Light of each of its planes: regions may have been recorded in other light.
    """

    H: Path
    middle_px: tuple[float, float]
    gains: tuple[float, ...]

    @classmethod
    def of(cls, H: Path, fit: Fit) -> ObjectPlace:
        """Return the place of a fit's H."""
        plan = fit.planned
        row, column = (a + (n - 1) / 2 for a, n in zip(plan.anchor, plan.period, strict=True))
        return cls(H, (row, column), tuple(map(float, fit.levels.gains)))


def read_object(
    frame: Path, scene: Path, how: PatternReading, fitted: Measured
) -> tuple[NewFrame, NDArray[np.float32]]:
    """Return the frame of a known object, corrected, and the object; before anything is fitted."""
    from lfcal.frames import corrected_view
    from lfcal.reconstruct import load_volume

    with ExitStack() as stack:
        view = corrected_view(single_frames(frame, stack), how.recipe, fitted.plan)
        if len(view) != 1:
            raise InputError.expected(f"{frame}, frames", "one", len(view), "name the frame of the object")
        shot = new_frame(view, 0, None, None, frame.name)
    volume = load_volume(scene)
    planes, shape = len(fitted.plan.depths_um), shot.values.shape
    if volume.shape != (planes, *shape):
        wanted = f"{(planes, *shape)}: the planes of H, the pixels of the frame"
        raise InputError.expected(f"{scene}, volume", wanted, volume.shape, "resample it")
    if not np.isfinite(volume).all() or not volume.any():
        raise InputError.expected(f"{scene}, volume", "finite values, some above 0", "others", "correct it")
    return shot, volume


def nearest(places: Sequence[ObjectPlace], shape: tuple[int, int], origin: tuple[float, float]) -> NDArray[np.intp]:
    """Return for each pixel ``(rows, columns)`` of a frame the number of the place whose middle is nearest.

    ``origin`` is the frame's first pixel (row, column) on the sensor.
    """
    rows, columns = (np.arange(n) + o for n, o in zip(shape, origin, strict=True))
    away = [np.add.outer((rows - r) ** 2, (columns - c) ** 2) for r, c in (one.middle_px for one in places)]
    found: NDArray[np.intp] = np.argmin(away, axis=0)
    return found


def object_error(
    places: Sequence[ObjectPlace],
    shot: NewFrame,
    volume: NDArray[np.float32],
    given: tuple[float, float] | None,
    workers: int | None,
) -> Compared:
    """Return a known object's frame beside what H makes of the object: of each of its points that H which is nearest.

    One period is taken to be like the next only from a point to the nearest region.
    """
    from lfcal.fit import predicted_frame
    from lfcal.psf import open_psf
    from lfcal.reconstruct import Projector

    noise = given or shot.noise
    if noise is None:
        raise InputError.expected(f"{shot.label}, noise", "a variance of its samples", "none", "state it with --noise")
    rows, columns = shot.values.shape
    near = nearest(places, (rows, columns), shot.origin)
    common = np.mean([one.gains for one in places], axis=0)
    light, cutout = np.zeros((rows, columns)), (1, 1)
    for k, one in enumerate(places):
        # in one light: what a region was recorded in is no property of the camera
        scale = (common / np.array(one.gains)).astype(np.float32)
        own = np.where(near == k, volume, np.float32(0)) * scale[:, None, None]
        with open_psf(one.H) as matrix:
            cutout = matrix.cutout
            if own.any():
                row, column = (a - o for a, o in zip(matrix.anchor, shot.origin, strict=True))
                light += Projector(matrix, (rows, columns), (row, column), workers=workers).forward(own)
    return predicted_frame(light, shot, noise, cutout)


def object_dict(found: Compared) -> dict[str, Any]:
    """Return how well a known object's frame was predicted, as plain types."""
    return {"frame": found.label, "error": error_dict(found.error), "chi2": found.chi_square.lit, "light": found.gain}


def object_words(found: Compared) -> str:
    """Return how well a known object's frame was predicted, for people."""
    return f"{found.label}: predicted with an error {found.error}, chi² {found.chi_square.lit:.3f}"
