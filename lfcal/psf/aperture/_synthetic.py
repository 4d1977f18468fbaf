"""Depth-plane sums of a known iris, with the disturbances of real images."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture.shape import Aperture, StuckBlade, polygon_area

__all__ = ["Disturbance", "IrisFault", "depth_sum_of"]

OVERSAMPLING = 3

MANY = 24
"""Number of waves of a random ripple."""

RAYS: NDArray[np.float64] = np.linspace(0.0, 2 * math.pi, 14_400, endpoint=False)


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Disturbances of a synthetic depth-plane sum, in units of its lit level.

    Attributes
    ----------
    noise
        Standard deviation of a pixel.
    blur_px
        Gaussian blur, standard deviation (pixels).
    ripple, ripple_pitch_px
        Amplitude of the ripple that the lenslet lattice leaves, and its pitch (pixels).
    pattern
        Pattern of the ripple, with random phases. ``"square"``: two crossed waves along rows and columns.
        ``"hexagonal"``: three waves at 60 degrees in a random rotation. ``"random"``: many waves of about this pitch in
        all directions, which a few waves cannot describe.
    vignetting, tilt
        Relative decrease of light from the centre to the rim, and slope of the light over a radius.
    hot
        Fraction of hot pixels.
    ellipticity
        Half the difference of the axes.
    pedestal
        Background level.
    """

    noise: float = 0.05
    blur_px: float = 2.0
    ripple: float = 0.04
    ripple_pitch_px: float = 31.0
    pattern: str = "square"
    vignetting: float = 0.12
    tilt: float = 0.08
    hot: float = 0.002
    ellipticity: float = 0.01
    pedestal: float = 0.05


@dataclass(frozen=True, slots=True)
class IrisFault:
    """Faults of a synthetic iris.

    Attributes
    ----------
    stuck, out
        Displaced blade, counted from the first vertex, and its outward displacement as a fraction of the apothem.
    rim
        Direction (rad) of the nearest point of a second rim, its distance from the centre divided by the apothem, and
        the curvature of the rim times the apothem.
    obstructed
        Radius of a dark disc halfway to the edge, as a fraction of the apothem.
    central
        Radius of a dark disc in the middle, like that of an annular stop.
    """

    stuck: int = -1
    out: float = 0.0
    rim: tuple[float, float, float] | None = None
    obstructed: float = 0.0
    central: float = 0.0


SOUND = IrisFault()


def depth_sum_of(
    side: int,
    blades: int,
    curvature: float,
    disturbance: Disturbance,
    rng: np.random.Generator,
    *,
    fill: float = 0.42,
    fault: IrisFault = SOUND,
) -> tuple[NDArray[np.float64], Aperture]:
    """Return a disturbed depth-plane sum ``(side, side)`` and its iris; centre and rotation are random.

    Parameters
    ----------
    side
        Side of the cutout (pixels).
    blades, curvature
        Blade count and curvature of the iris; a curvature of 1 is a circle.
    disturbance
        Disturbances of the image.
    rng
        Random generator.
    fill
        Ratio of the radius of a circle with the iris's area to ``side``.
    fault
        Faults of the iris.
    """
    from scipy import ndimage

    column, row = (side - 1) / 2 + rng.uniform(-4, 4, 2)
    step = 2 * math.pi / blades
    rotation = rng.uniform(0, step)
    radius = fill * side
    # the circle of the same area has this radius
    apothem = radius * math.sqrt(math.pi / polygon_area(blades, 1.0, curvature))
    # centres of sub-pixels, so that edges are antialiased by their covered area
    fine = (np.arange(side * OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    x = (fine - column)[None, :] * (1 + disturbance.ellipticity)
    y = (fine - row)[:, None] * (1 - disturbance.ellipticity)
    edge = _outline(blades, rotation, apothem, curvature, fault)
    lit = np.hypot(x, y) < np.interp(np.arctan2(y, x), RAYS, edge, period=2 * math.pi)
    if fault.obstructed:
        lit &= np.hypot(x - 0.5 * apothem, y) > fault.obstructed * apothem
    lit &= np.hypot(x, y) >= fault.central * apothem
    image = lit.reshape(side, OVERSAMPLING, side, OVERSAMPLING).mean((1, 3))
    image = ndimage.gaussian_filter(image, disturbance.blur_px)
    rows, columns = (np.asarray(a, np.float64) for a in np.indices(image.shape))
    u, v = (columns - column) / radius, (rows - row) / radius
    image *= (1 - disturbance.vignetting * (u * u + v * v)) * (1 + disturbance.tilt * u)
    image *= 1 + disturbance.ripple * _ripple(disturbance, rows, columns, rng)
    image += disturbance.pedestal + rng.normal(0, disturbance.noise, image.shape)
    hot = np.flatnonzero(rng.random(image.shape) < disturbance.hot)
    image.flat[hot] += rng.uniform(0.5, 3, hot.size)
    stuck = None
    if fault.stuck >= 0:
        direction = (rotation + (fault.stuck + 0.5) * step) % (2 * math.pi)
        stuck = StuckBlade(fault.stuck, direction, fault.out * apothem, 0.0)
    truth = Aperture(
        blades if curvature < 1 else 0,
        (float(row), float(column)),
        rotation,
        apothem,
        math.pi * float(np.mean(edge**2)),
        curvature,
        disturbance.blur_px,
        kind=_kind(curvature, fault),
        stuck=stuck,
        rim=fault.rim,
    )
    return image, truth


def _outline(blades: int, rotation: float, apothem: float, curvature: float, fault: IrisFault) -> NDArray[np.float64]:
    """Return the radius in the directions `RAYS`, up to the nearest blade or the rim; each is an arc or a line."""
    arcs = [(rotation + (k + 0.5) * 2 * math.pi / blades, apothem, curvature / apothem) for k in range(blades)]
    if fault.stuck >= 0:
        direction, distance, bend = arcs[fault.stuck]
        arcs[fault.stuck] = direction, distance * (1 + fault.out), bend
    if fault.rim is not None:
        arcs.append((fault.rim[0], apothem * fault.rim[1], fault.rim[2] / apothem))
    edge = np.full(RAYS.size, np.inf)
    for direction, distance, bend in arcs:
        c, s = np.cos(RAYS - direction), np.sin(RAYS - direction)
        if bend > 0:
            # a circle of radius 1/bend, whose centre is behind by its radius minus the distance
            behind = distance - 1 / bend
            inside = 1 / bend**2 - (behind * s) ** 2
            reach = np.where(inside > 0, behind * c + np.sqrt(np.maximum(inside, 0)), np.inf)
        else:
            reach = np.where(c > 1e-9, distance / np.maximum(c, 1e-9), np.inf)
        edge = np.minimum(edge, reach)
    return edge


def _ripple(
    disturbance: Disturbance, rows: NDArray[np.float64], columns: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the ripple of amplitude about 1."""
    wave = 2 * math.pi / disturbance.ripple_pitch_px
    if disturbance.pattern == "square":
        phase = rng.uniform(0, 2 * math.pi, 2)
        crossed: NDArray[np.float64] = np.cos(wave * columns + phase[0]) * np.cos(wave * rows + phase[1])
        return crossed
    if disturbance.pattern == "hexagonal":
        angles = rng.uniform(0, 2 * math.pi) + np.arange(3) * math.pi / 3
        waves, size = np.full(3, wave), 0.5
    else:
        angles = rng.uniform(0, 2 * math.pi, MANY)
        waves, size = wave * rng.uniform(0.8, 1.2, MANY), math.sqrt(0.5 / MANY)
    total = np.zeros(rows.shape)
    for q, angle, phase in zip(waves, angles, rng.uniform(0, 2 * math.pi, angles.size), strict=True):
        total += size * np.cos(q * (columns * math.cos(angle) + rows * math.sin(angle)) + phase)
    return total


def _kind(curvature: float, fault: IrisFault) -> str:
    if fault.rim is not None:
        return "cat's eye"
    if fault.stuck >= 0:
        return "stuck blade"
    if fault.obstructed or fault.central:
        return "obstructed" if fault.obstructed else "annular"
    return "round" if curvature == 1 else "polygon" if curvature == 0 else "rounded polygon"
