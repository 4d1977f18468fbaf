"""The aperture that is expected from a camera's description."""

from __future__ import annotations

import math

from lfcal.base import InputError
from lfcal.camera import Camera, MainLens
from lfcal.psf.aperture.shape import Aperture, polygon_area

__all__ = ["expected_aperture", "footprint_px"]


def footprint_px(camera: Camera | None, pixel_scale: tuple[float, float] = (1.0, 1.0)) -> float:
    """Return the width over which a lenslet spreads the light of a defocused point (px); 0 without a lenslet lattice.

    A lenslet displaces a ray that passes it at the distance e from its centre by ``e B/f`` on the sensor. B is the
    distance of the sensor from the lenslets, and f is the shortest focal length of the lens types. ``pixel_scale`` is
    the number of cutout pixels per sensor pixel (rows, columns).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.psf.aperture import footprint_px
    >>> microscope = preset("lfm_20x05")  # lenslets of 15 pixels, their own focal length from the sensor
    >>> print(round(footprint_px(microscope), 2), "px")
    15.0 px
    """
    if camera is None or not camera.has_lattice:
        return 0.0
    lattice = camera.lattice
    bend = max(lattice.gap_um / kind.focal_length_um for kind in lattice.types)
    return bend * lattice.clear_diameter_um / camera.sensor.pixel_um * math.sqrt(math.prod(pixel_scale))


def expected_aperture(
    camera: Camera, depth_um: float, cutout: tuple[int, int], pixel_scale: tuple[float, float] = (1.0, 1.0)
) -> Aperture | None:
    """Return the geometric shadow of the iris on the sensor; None if the plane is not imaged or is in focus.

    Lenslets are ignored. Behind a main lens, a ray through the point p of the pupil meets the sensor at the distance
    ``p (a - B)/(b + a)`` from the chief ray. Here b is the distance of the pupil in front of the lenslets. Behind them,
    a is the distance of the image and B that of the sensor. Other optics cast a round shadow of the radius
    ``|a - B| / (2 N)``, with the working f-number N.

    Parameters
    ----------
    camera
        Description of the camera.
    depth_um
        Object depth of the plane (µm, relative to the working plane, positive away from the camera).
    cutout
        Number of rows and columns of the cutout, ``(nt, ns)``, in whose middle pixel the aperture is centred.
    pixel_scale
        Cutout pixels per sensor pixel (rows, columns).

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.psf.aperture import expected_aperture
    >>> camera = preset("bench")  # seven straight blades
    >>> shadow = expected_aperture(camera, camera.depth_of(3.0), cutout=(55, 55))
    >>> print(shadow.describe())
    7 blades, centre (27.0, 27.0) px, diameter 21.7 px, rotated 11.5°, curvature 0.00
    """
    optics, pixel = camera.optics, camera.sensor.pixel_um / math.sqrt(math.prod(pixel_scale))
    try:
        shift = camera.image_shift_um(depth_um)
    except InputError:
        return None
    if not math.isfinite(shift):
        return None
    away = shift - camera.lattice.gap_um
    if isinstance(optics, MainLens):
        pupil = optics.focal_length_um / optics.f_number / 2
        radius = pupil * abs(away) / (optics.image_distance_um + shift) / pixel
        blades, turn, curvature = optics.blades, optics.blade_rotation_rad, optics.blade_curvature
    else:
        radius = abs(away) / (2 * optics.working_f_number) / pixel
        blades, turn, curvature = 0, 0.0, 1.0
    if not radius > 0:
        return None
    centre = ((cutout[0] - 1) // 2, (cutout[1] - 1) // 2)
    area = math.pi * radius**2
    if not blades or curvature == 1:
        return Aperture(0, centre, 0.0, radius, area, 1.0, confident=True, kind="round")
    # behind the image, the shadow is inverted
    turn = (turn + (math.pi if away < 0 else 0.0)) % (2 * math.pi / blades)
    apothem = radius * math.sqrt(math.pi / polygon_area(blades, 1.0, curvature))
    kind = "rounded polygon" if curvature else "polygon"
    return Aperture(blades, centre, turn, apothem, area, curvature, confident=True, kind=kind)
