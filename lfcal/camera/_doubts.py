"""Checks for implausible values of a camera: wrong units, and parts that do not match."""

from __future__ import annotations

import numpy as np

from lfcal.camera.derived import derived_of
from lfcal.camera.description import Camera
from lfcal.camera.main_lens import Microscope
from lfcal.camera.pupil_lenslets import PupilLenslets
from lfcal.camera.quantities import Quantity, quantities_of, value_at

__all__ = ["doubts"]

FACTORS = ((1e3, "mm for µm"), (1e-3, "nm for µm"), (1e6, "m for µm"))
FEWEST_PIXELS = 4.0
"""Diameter of a micro-image (pixels) below which its lattice cannot be measured."""


def doubts(camera: Camera) -> tuple[str, ...]:
    """Return warnings about camera values that are possible but probably not intended, one line each.

    Raises
    ------
    InputError
        If values of the camera are so extreme that derived quantities cannot be calculated.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import doubts, preset
    >>> camera = preset("r29")
    >>> for line in doubts(replace(camera, sensor=replace(camera.sensor, pixel_um=0.0055))):
    ...     print(line)
    pixel pitch (sensor.pixel_um) is 0.0055 µm; did you mean 5.5 µm (mm for µm)?
    """
    derived_of(camera)  # raises if nothing can be calculated
    found = [line for quantity in quantities_of(camera) for line in _unusual(camera, quantity)]
    if isinstance(camera.lattice, PupilLenslets):
        return (*found, *_lenslets(camera, camera.lattice))
    return (*found, *_sensor(camera), *_apertures(camera))


def _unusual(camera: Camera, quantity: Quantity) -> list[str]:
    value = value_at(camera, quantity.path)
    if quantity.usual is None or value is None:
        return []
    low, high = quantity.usual
    worst = next((v for v in (value if isinstance(value, tuple) else (value,)) if not low <= v <= high), None)
    if worst is None:
        return []
    shown = f"{quantity.label} ({quantity.path}) is {worst:g}"
    if not quantity.path.endswith("_um") and quantity.path != "lattice.types":
        return [f"{shown}, which is unusual"]
    for factor, mistake in FACTORS:
        if low <= worst * factor <= high:
            return [f"{shown} µm; did you mean {worst * factor:g} µm ({mistake})?"]
    return [f"{shown} µm, which is unusual; check the value, which is in µm"]


def _lenslets(camera: Camera, lenslets: PupilLenslets) -> list[str]:
    """Return warnings about lenslets that overlap or are outside the pupil, and about images outside the sensor."""
    assert isinstance(camera.optics, Microscope)
    found, centres = [], np.array(lenslets.lens_centres_um)
    if lenslets.clear_um > 1.001 * lenslets.spacing_um:
        found.append(
            f"lenslets of {lenslets.clear_um:g} µm overlap: the closest two are {lenslets.spacing_um:g} µm apart"
        )
    dark = np.hypot(*centres.T) - lenslets.clear_um / 2 > lenslets.pupil_um(camera.optics) / 2
    if dark.any():
        pupil = f"the pupil of {lenslets.pupil_um(camera.optics):.0f} µm"
        remedy = "check the focal length of the Fourier lens, the magnification and the NA"
        found.append(f"{int(dark.sum())} of {len(centres)} lenslets are outside {pupil}; {remedy}")
    pixels = camera.pixels(centres + np.array(lenslets.offset_um))
    outside = ((pixels < 0) | (pixels > np.array(camera.sensor.shape) - 1)).any(-1)
    if outside.any():
        rows, columns = camera.sensor.shape
        found.append(
            f"{int(outside.sum())} of {len(centres)} elemental images are outside the {rows} x {columns} px sensor"
        )
    return found


def _sensor(camera: Camera) -> list[str]:
    rows, columns = camera.sensor.shape
    x, y = (v / camera.sensor.pixel_um for v in camera.lattice.offset_um)
    found = []
    if camera.pitch_px < FEWEST_PIXELS:
        found.append(
            f"micro-images of {camera.pitch_px:.3g} px are too small to be measured; check the lenslet pitch "
            "and the pixel size"
        )
    if abs(x) > columns / 2 or abs(y) > rows / 2:
        found.append(
            f"the offset of the lattice, {x:.0f}, {y:.0f} px from the centre, is outside the {rows} x "
            f"{columns} px sensor"
        )
    centre = camera.distortion.centre_px if camera.distortion is not None else (0.0, 0.0)
    if not (0 <= centre[0] <= columns and 0 <= centre[1] <= rows):
        found.append(
            f"the centre of the manufacturer's distortion ({centre[0]:.0f}, {centre[1]:.0f} px) is outside the "
            f"{rows} x "
            f"{columns} "
            "px sensor; check the size of the sensor, and that the file belongs to this camera"
        )
    return found


def _apertures(camera: Camera) -> list[str]:
    """Return a warning if micro-images overlap because the main optics are faster than the lenslets."""
    optics, lattice = camera.optics, camera.lattice
    ratio = lattice.gap_um / (optics.working_f_number * lattice.clear_diameter_um)
    if ratio <= 1.5:
        return []
    remedy = (
        "magnification and NA of the objective"
        if optics.telecentric
        else "f-number and image distance of the main lens"
    )
    return [f"micro-images would be {ratio:.2g} lenslets wide and overlap; check the gap, and {remedy}"]
