"""Depths of a list's planes: stage coordinates, shifted so that a step is one pixel, and the agreement of the two."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, StageAxes
from lfcal.frames.lists.listing import Listing

__all__ = ["LEAST", "MOST", "Depths", "ListedPlanes", "find_depths", "with_depths"]

LEAST, MOST = 0.5, 2.0
"""Range of scales of z that are accepted; others mean another unit or column."""
SIGMAS = 4.0
"""Difference between z and steps, in standard errors, that is significant."""
MIN_DIFFERENCE = 0.01
"""Smallest reported difference between z and steps, as a fraction of the range of z."""


@dataclass(frozen=True, eq=False)
class ListedPlanes:
    """The planes of a list, by rising coordinate along the depth axis.

    Attributes
    ----------
    name
        Name of the list, for messages.
    heights
        Coordinate of each plane (µm), or its number if ``counted``.
    sizes, errors
        Step in each plane, and its standard error (µm).
    counted
        Whether the list numbers its planes.
    """

    name: str
    heights: NDArray[np.float64]
    sizes: NDArray[np.float64]
    errors: NDArray[np.float64]
    counted: bool = False


@dataclass(frozen=True)
class Depths:
    """Stage axes with the sign of the depth axis, the depth of each plane (µm), and notes, one line each."""

    axes: StageAxes
    depths: tuple[float, ...]
    notes: tuple[str, ...]


def find_depths(
    camera: Camera, axes: StageAxes, planes: ListedPlanes, given: tuple[float, ...] | None = None
) -> Depths:
    """Return the depths of a list's planes, from nearest to farthest, or by number if planes are counted.

    With a main lens, the step that moves the image by one pixel is longer for planes farther away. If the list has z
    coordinates, their distances are preserved, and the steps determine the zero of the stage. The stated error includes
    the disagreement between steps and z. If the list only numbers its planes, the steps alone determine the depths.

    Parameters
    ----------
    camera
        The camera to calibrate.
    axes
        Stage axes; the sign of the depth axis is kept if the steps do not determine it.
    planes
        Planes of the list.
    given
        Depths (µm) from the nearest to the farthest, if they are known more accurately.

    Raises
    ------
    InputError
        If the steps do not correspond to one pixel of the camera, or z is in another unit.
    """
    if given is not None and len(given) != len(planes.heights):
        raise InputError.expected(
            "planes",
            f"{len(planes.heights)} as in the list",
            len(given),
            "correct the depths (--depths or --virtual-depths)",
        )
    rising = camera.step_um(1.0) - camera.step_um(0.0)
    if planes.counted:
        return _of_numbers(camera, axes, planes, given, rising)
    if rising <= 0:
        offsets = _offsets(planes.heights, axes)
        words = "depths: stage coordinates; the zero of the stage is assumed to be the working plane"
        return _found(axes, given, offsets, (words,))
    scale, error = _scale(planes, rising)
    sense = axes.away[0] if abs(scale) <= 3 * error else "+" if scale > 0 else "-"
    axes = replace(axes, away=sense + axes.away[1])
    offsets = _offsets(planes.heights, axes)
    if given is not None:
        return _found(axes, given, offsets, ())
    order = slice(None) if sense == "+" else slice(None, None, -1)
    by_steps = (planes.sizes[order] - camera.step_um(0.0)) / rising
    errors = planes.errors[order] / rising
    # one unknown for all planes: the zero of the stage
    depths = offsets + float(by_steps.mean() - offsets.mean())
    common = float(np.sqrt((errors**2).sum())) / len(errors)
    apart, note = _differences(by_steps - depths, errors, float(np.ptp(depths)), (scale, error))
    words = (
        "depths: inferred from the steps, which are one pixel (uncertainty from scatter and rounding: ± "
        f"{common:.4g} µm for all{apart}); state the depths if you know them more accurately (--depths)"
    )
    return _found(axes, None, depths, (words, *note))


def _offsets(heights: NDArray[np.float64], axes: StageAxes) -> NDArray[np.float64]:
    """Return the coordinates with the sign that makes them increase away from the camera."""
    return np.sort(heights if axes.away[0] == "+" else -heights)


def _found(
    axes: StageAxes, given: tuple[float, ...] | None, depths: NDArray[np.float64], notes: tuple[str, ...]
) -> Depths:
    if given is not None:
        return Depths(axes, tuple(sorted(given)), ("depths: as given",))
    return Depths(axes, _rounded(depths), notes)


def _rounded(depths: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(round(float(z), 3) for z in depths)


def _scale(planes: ListedPlanes, rising: float) -> tuple[float, float]:
    """Return the ratio of the change of the steps to that expected from the list's z, with its standard error.

    The ratio is 1 for one plane, which does not determine a scale.
    """
    heights = planes.heights - planes.heights.mean()
    if len(heights) < 2:
        return 1.0, math.inf
    weights = heights / (heights @ heights) / rising
    scale, error = float(weights @ planes.sizes), float(np.sqrt((weights**2) @ (planes.errors**2)))
    if LEAST < abs(scale) + 3 * error and abs(scale) - 3 * error < MOST:
        return scale, error
    if abs(scale) > max(5 * error, 1e-5):
        z = float(np.ptp(planes.heights))
        raise InputError.expected(
            f"{planes.name}, z of the planes",
            f"a range of about {z * abs(scale):.4g} µm, inferred from the steps of its planes",
            f"{z:.4g} µm",
            _remedy(abs(scale)),
        )
    raise InputError.expected(
        f"{planes.name}, steps of its planes",
        "steps that move the image by one pixel, which are longer in farther planes",
        f"{planes.sizes.min():.5g} … {planes.sizes.max():.5g} µm",
        "check the camera and the columns; if all planes have the same step, record them again with the "
        "steps of a plan",
    )


def _remedy(factor: float) -> str:
    """Return the remedy for z values to multiply by ``factor``: state the unit if ``factor`` is that of a unit."""
    for unit, power in (("mm", 1e3), ("um", 1e-3)):
        if LEAST < factor / power < MOST:
            return f"is z in {unit}? state its unit (--columns z_{unit}=COLUMN)"
    return "check unit and column of z (--columns z_um=COLUMN), and the distances of the camera"


def _differences(
    rest: NDArray[np.float64], errors: NDArray[np.float64], span: float, scale: tuple[float, float]
) -> tuple[str, tuple[str, ...]]:
    """Return the difference between z and steps in words, for the stated error, and a note; empty if they agree.

    ``rest`` are the depths from the steps of each plane, minus those from z.
    """
    if len(rest) < 2:
        return "", ()
    slope, error = scale
    most = float(np.abs(rest).max())
    # each is compared with the mean of all
    own = np.sqrt(errors**2 * (1 - 2 / len(rest)) + (errors**2).sum() / len(rest) ** 2)
    off = abs(abs(slope) - 1) > SIGMAS * error or (np.abs(rest) > SIGMAS * own).any()
    if not off or 2 * most < MIN_DIFFERENCE * span:
        return "", ()
    note = (
        f"z: its range is {1 / abs(slope):.3f} times the range that the steps of the planes imply, and single planes "
        f"differ by up to {most:.4g} µm; check unit and scale of z, pixel pitch, focal length and working distance"
    )
    return f", up to ± {most:.4g} µm for one, because z and the steps disagree", (note,)


def _of_numbers(
    camera: Camera, axes: StageAxes, planes: ListedPlanes, given: tuple[float, ...] | None, rising: float
) -> Depths:
    """Return the depths of numbered planes, in the order of their numbers."""
    falling = rising > 0 and bool(planes.sizes[-1] < planes.sizes[0])
    if given is not None:
        ordered = sorted(given, reverse=falling) if rising > 0 else list(given)
        return Depths(axes, tuple(ordered), ("depths: as given, one for each plane number",))
    if rising <= 0:
        raise InputError.expected(
            f"{planes.name}, depths", "lengths", "plane numbers", "state one depth for each number (--depths)"
        )
    depths = (planes.sizes - camera.step_um(0.0)) / rising
    errors = planes.errors / rising
    apart = np.diff(depths) * (-1 if falling else 1)
    if apart.size and (apart <= 3 * np.hypot(errors[1:], errors[:-1])).any():
        raise InputError.expected(
            f"{planes.name}, steps of its planes",
            "steps of one pixel each, which increase from plane to plane",
            ", ".join(f"{size:.5g}" for size in planes.sizes) + " µm",
            "state the depths (--depths), or give z as a length",
        )
    words = (
        "depths: inferred from the steps, which are one pixel (uncertainty from scatter and rounding: up to ± "
        f"{float(errors.max()):.4g} µm for each); state the depths if you know them more accurately (--depths)"
    )
    return Depths(axes, _rounded(depths), (words,))


def with_depths(listing: Listing, depths: tuple[float, ...], axes: StageAxes) -> Listing:
    """Return ``listing``, which numbers its planes, with their ``depths`` as z coordinates (µm).

    Raises
    ------
    InputError
        If the list contains a number that belongs to no plane.
    """
    numbers = listing.places[:, 2].astype(np.intp)
    numbers -= numbers.min() if numbers.min() in (0, 1) else 0
    if numbers.min() < 0 or numbers.max() >= len(depths):
        k = int(numbers.argmax())
        raise InputError.expected(
            f"{listing.name}, plane of {listing.label(k)}",
            f"one of {len(depths)} planes, counted from 0 or 1",
            f"{listing.places[k, 2]:g}",
            "correct the list, or make the plan of the scan in the list (lfcal plan CAMERA --positions LIST)",
        )
    if axes.away[1] != "z":
        raise InputError.expected(
            f"{listing.name}, depth axis",
            "z, because the list numbers its planes",
            axes.away,
            "correct the stage axes (--stage)",
        )
    places = listing.places.copy()
    places[:, 2] = np.array(depths)[numbers] * (1 if axes.away[0] == "+" else -1)
    return replace(listing, places=places, counted=False)
