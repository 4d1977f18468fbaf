"""The scene of a depth plane from a described camera."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

from lfcal.base import InputError
from lfcal.camera import Camera, LensletLattice, Microscope
from lfcal.simulate._pupil import PupilIris
from lfcal.simulate.scene import Scene

__all__ = ["scene_of"]


def scene_of(
    camera: Camera,
    z_um: float | None = None,
    *,
    virtual_depth: float | None = None,
    cutout: tuple[int, int],
    period: tuple[int, int] | None = None,
    anchor_px: tuple[float, float] = (0.0, 0.0),
    gap_um: float | None = None,
    **overrides: Any,
) -> Scene:
    """Return the scene of one depth plane of ``camera``.

    Parameters
    ----------
    z_um, virtual_depth
        The plane, one of the two; neither is the native plane.
    cutout, period
        Pixels ``(nt, ns)`` of a response, and source positions ``(ny, nx)``; None: the camera's period, rounded.
    anchor_px
        Source position (0, 0) as (y, x) pixels from the centre of a type-0 micro-image.
    gap_um
        Distance from lenslets to sensor where it is not the camera's; the image stays where it is.
    overrides
        Fields of `Scene` to set, for example ``pupil_um=math.inf`` for a telecentric model.

    Raises
    ------
    InputError
        For a depth given twice, an unknown field or a value out of range.
    """
    # a misspelt field would silently leave the camera's value
    unknown = sorted(set(overrides) - {f.name for f in fields(Scene)})
    if unknown:
        raise InputError.expected("scene", "fields of Scene", unknown[0], "correct the name")
    if z_um is not None and virtual_depth is not None:
        raise InputError.expected("depth", "z or virtual depth", "both", "give one of them")
    positions = _whole_period(camera) if period is None else period
    # one of the two is computed from the other, so that a and z cannot disagree
    depth = camera.depth_of(virtual_depth) if virtual_depth is not None else float(z_um or 0.0)
    a = virtual_depth * camera.lattice.gap_um if virtual_depth is not None else camera.image_shift_um(depth)
    lattice = _on_array(camera, anchor_px)
    if gap_um is not None:
        lattice = replace(lattice, gap_um=gap_um)
    known = {"image_um": a, "z_um": depth, "lattice": lattice, "cutout": cutout, "period": positions}
    return Scene(**(_described(camera) | known | overrides))


def _described(camera: Camera) -> dict[str, Any]:
    """Return the fields of a scene that hold for every plane of ``camera``."""
    optics, lattice, sensor = camera.optics, camera.lattice, camera.sensor
    known: dict[str, Any] = {
        "wavelength_um": camera.wavelength_um,
        "pixel_um": sensor.pixel_um,
        "f_number": optics.working_f_number,
        "aperture": "cell" if lattice.gapless else "circle",
        # a square share of light-sensitive area: the side is its root
        "pixel_fill": math.sqrt(sensor.fill_factor),
    }
    if isinstance(optics, Microscope):
        return known | {"objective": optics}
    iris = PupilIris(optics.blades, optics.blade_curvature, optics.blade_rotation_rad)
    return known | {"iris": iris, "pupil_um": optics.image_distance_um}


def _whole_period(camera: Camera) -> tuple[int, int]:
    y, x = camera.period_px
    return max(1, round(y)), max(1, round(x))


def _on_array(camera: Camera, anchor_px: tuple[float, float]) -> LensletLattice:
    """Return the lenslets themselves: the micro-image lattice divided by `Camera.lattice_scale`."""
    # of a distorted lattice a scene is one cell: that of the sensor's middle, unless `Camera.local` named another
    seen, s, px = camera.lattice.local((0.0, 0.0)), camera.lattice_scale, camera.sensor.pixel_um
    # shifted with the anchor: sensor distances are s times those on the array
    y, x = anchor_px
    return replace(seen.scaled(1 / s), offset_um=(-x * px / s, -y * px / s))
