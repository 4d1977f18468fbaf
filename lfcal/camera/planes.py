"""The depth planes of a scan: where they are, and how long each is exposed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lfcal.base import InputError, check_number, check_tuple
from lfcal.camera.description import Camera
from lfcal.camera.main_lens import Microscope

__all__ = ["MAX_WAIT_S", "checked_depths", "checked_exposures", "depths_of"]

NEAR = 0.5
"""Depth over an objective's focal length up to which its aperture is taken as that of the focal plane: at -1 the source
would be in the lens."""

MAX_WAIT_S = 86_400.0
"""A day: longer exposures and waits are slips of the pen, and their sum over all positions would overflow."""


def depths_of(camera: Camera, depths: Iterable[float] | None, virtual: Iterable[float] | None) -> tuple[float, ...]:
    """Return object-space depths (µm) from whichever is given: themselves, or virtual depths."""
    if (depths is None) == (virtual is None):
        raise InputError.expected("depth planes", "depths in µm or virtual depths", "both or neither", "give one")
    values: Sequence[float] = tuple(depths if depths is not None else () if virtual is None else virtual)
    for value in values:
        check_number("depth", value)
    return tuple(values) if depths is not None else tuple(camera.depth_of(v) for v in values)


def checked_depths(camera: Camera, depths: Sequence[float]) -> tuple[float, ...]:
    """Return depths (µm) that the camera can see, strictly ordered; others raise `InputError`."""
    checked = check_tuple("depths (µm)", depths)
    for z in checked:
        # raises where the main lens has no image of the plane
        camera.step_um(z)
        if isinstance(camera.optics, Microscope):
            _check_near(camera.optics, z)
    steps = np.diff(np.array(checked))
    if steps.size and not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError.expected(
            "depths (µm)",
            "rising or falling throughout",
            "another order or a repeated plane",
            "sort them and remove repetitions",
        )
    return checked


def _check_near(optics: Microscope, z_um: float) -> None:
    """Raise unless the objective, which its focal length lies from the focal plane, sees depth z in the cone of it."""
    focal = optics.medium_index * optics.tube_length_um / optics.magnification
    if not abs(z_um) < NEAR * focal:
        limit = f"within {NEAR * focal:.6g} µm of the focal plane ({NEAR:g} of the objective's focal length)"
        raise InputError.expected("depth", limit, f"{z_um:g} µm", "choose a plane nearer to it")


def checked_exposures(given: float | Sequence[float], planes: int) -> tuple[float, ...]:
    """Return the exposure of each of ``planes`` planes (s); one that is given is that of all."""
    # a list of one is one exposure for all planes, as JSON writes it
    given = given.tolist() if isinstance(given, np.ndarray) else given
    several = isinstance(given, list | tuple) and len(given) != 1
    values = check_tuple(
        "exposures (s), one or one per plane",
        given if isinstance(given, list | tuple) else [given],
        planes if several else 1,
        above=0,
        at_most=MAX_WAIT_S,
    )
    return values if several else values * planes
