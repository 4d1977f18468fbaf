"""The expected depth-plane sum of a camera: the shadow, the footprint of the lenslets, and diffraction tails.

The edges of an aperture diffract light far beyond its geometric shadow. Beyond distance r from the middle of a shadow
of radius R, a circular pupil in a beam of f-number N leaves ``wavelength N / pi^2 (1/(r - R) + 1/(r + R))`` of its
light (the edge waves of the near and the far rim; in focus, R = 0, the mean of Airy's ``1 - J0^2 - J1^2``). The two
edges of a slit leave half of that on its axis, so that square lenslets produce crosses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, Microscope

__all__ = ["expected_sum", "footprint_variance"]

RAYS = 20_000
"""Number of rays of the shadow: some tens in each pixel of a large shadow."""

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Grid:
    """Pixels ``(nt, ns)`` around the middle one, and their pitch along each axis (µm)."""

    shape: tuple[int, int]
    pitch_um: tuple[float, float]

    def axes(self) -> tuple[Values, Values]:
        """Return the distances of rows and of columns from the middle (µm)."""
        rows, columns = ((np.arange(n) - (n - 1) // 2).astype(np.float64) for n in self.shape)
        return rows * self.pitch_um[0], columns * self.pitch_um[1]

    def deposit(self, y: Values, x: Values, weight: Values) -> Values:
        """Return the sum of the weights in each pixel, for weights at given positions (µm)."""
        edges = [np.append(a - p / 2, a[-1] + p / 2) for a, p in zip(self.axes(), self.pitch_um, strict=True)]
        sums: Values = np.histogram2d(y, x, bins=edges, weights=weight)[0]
        return sums


def expected_sum(
    camera: Camera, depth_um: float, cutout: tuple[int, int], pixel_scale: tuple[float, float] = (1.0, 1.0)
) -> Values:
    """Return the mean pattern of a plane over all positions ``(nt, ns)``; the total light, inside and outside, is 1.

    Parameters
    ----------
    camera
        The camera.
    depth_um
        Depth of the plane (µm).
    cutout
        Pixels ``(nt, ns)``.
    pixel_scale
        Cutout pixels per sensor pixel, for rows and columns.
    """
    pitch = camera.sensor.pixel_um / pixel_scale[0], camera.sensor.pixel_um / pixel_scale[1]
    # odd and twice as large, because light that leaves the cutout by one effect may return by the next
    grid = _Grid((2 * cutout[0] + 1, 2 * cutout[1] + 1), pitch)
    shadow, pupil_tail = _pupil(camera, camera.image_shift_um(depth_um), grid)
    lens = _lens(camera, camera.image_shift_um(depth_um), grid)
    whole = _convolved(_convolved(shadow + pupil_tail, _footprint(camera, grid)), lens)
    # pixel (n - 1)//2 of the cutout is the middle one, in both arrays
    top, left = (cutout[0] - (cutout[0] - 1) // 2, cutout[1] - (cutout[1] - 1) // 2)
    inside: Values = np.maximum(whole[top : top + cutout[0], left : left + cutout[1]], 0.0)
    return inside


def _convolved(one: Values, other: Values) -> Values:
    """Return the middle of the convolution of two pictures of one shape; scipy.signal takes a second to load."""
    from scipy.fft import irfft2, next_fast_len, rfft2  # the import takes a tenth of a second

    rows, columns = one.shape
    fast = next_fast_len(2 * rows - 1, real=True), next_fast_len(2 * columns - 1, real=True)
    product = rfft2(one, fast) * rfft2(other, fast)
    top, left = (rows - 1) // 2, (columns - 1) // 2
    middle: Values = irfft2(product, fast)[top : top + rows, left : left + columns]
    return middle


def footprint_variance(camera: Camera) -> float:
    """Return the second moment that lenslets add to a depth-plane sum, both axes together (µm²)."""
    lattice = camera.lattice
    bend = float(np.mean([(lattice.gap_um / kind.focal_length_um) ** 2 for kind in lattice.types]))
    # w²/12 along each side of a square, D²/16 along each axis of a disc
    own = 1 / 6 if lattice.edge_to_edge else 1 / 8
    return bend * own * lattice.clear_diameter_um**2


def _pupil(camera: Camera, shift: float, grid: _Grid) -> tuple[Values, Values]:
    """Return the sum of the geometric shadow of the pupil and the tail of its rim, with a total of 1."""
    radii, weights, rim = _shadow_rays(camera, shift)
    blur = math.sqrt(camera.wavelength_um * abs(shift) / 2)
    strength = rim * camera.wavelength_um * camera.optics.working_f_number / math.pi**2
    edge = float(radii[-1])
    y, x = np.meshgrid(*grid.axes(), indexing="ij")
    r = np.hypot(y, x)
    # the edge wave is not a tail within the first Fresnel zone, or within the zone's image by a lenslet
    outside = r > edge + max(blur, camera.lattice.clear_diameter_um / 2, 4 * strength)
    near, far = r[outside] - edge, r[outside] + edge
    tail = np.zeros_like(r)
    tail[outside] = strength / (2 * math.pi * r[outside]) * (near**-2 + far**-2) * math.prod(grid.pitch_um)
    # golden-angle spiral: uniform coverage with few rays
    angle = np.arange(radii.size) * math.pi * (3 - math.sqrt(5))
    core = grid.deposit(radii * np.sin(angle), radii * np.cos(angle), weights)
    return core * (1 - float(tail.sum())), tail


def _shadow_rays(camera: Camera, shift: float) -> tuple[Values, Values, float]:
    """Return the radii on the sensor of rays evenly spread over the pupil (µm), their light, and the one at the rim.

    The light at the rim is relative to the mean of all rays.
    """
    u = (np.arange(RAYS) + 0.5) / RAYS
    gap, optics = camera.lattice.gap_um, camera.optics
    if not isinstance(optics, Microscope):
        return np.sqrt(u) * abs(shift - gap) / (2 * optics.working_f_number), np.full(RAYS, 1 / RAYS), 1.0
    # sine condition: even light over angles is 1/cos over the pupil, and a defocused ray moves by the tangent
    sine = np.sqrt(u) * math.sin(optics.half_angle_rad)
    cosine = np.sqrt(1 - sine**2)
    share = (1 / cosine) / float((1 / cosine).sum())
    place = optics.medium_index / optics.magnification * (shift * sine / cosine - gap * sine)
    return np.abs(place), share, float(share[-1] * RAYS)


def _footprint(camera: Camera, grid: _Grid) -> Values:
    """Return the distribution of the light of all positions of a cell by a lenslet, which is its aperture."""
    lattice = camera.lattice
    scale = float(np.mean([lattice.gap_um / kind.focal_length_um for kind in lattice.types]))
    if lattice.edge_to_edge:
        side = (np.arange(141) + 0.5) / 141 - 0.5
        y, x = (a.ravel() * lattice.clear_diameter_um * scale for a in np.meshgrid(side, side))
    else:
        u = (np.arange(RAYS) + 0.5) / RAYS
        r, angle = np.sqrt(u) * lattice.clear_diameter_um / 2 * scale, np.arange(RAYS) * math.pi * (3 - math.sqrt(5))
        y, x = r * np.sin(angle), r * np.cos(angle)
        # a disc that extends beyond its cell ends at the cell's edge
        own = lattice.in_cell(x / scale, y / scale)
        y, x = y[own], x[own]
    return grid.deposit(y, x, np.full(y.size, 1 / y.size))


def _lens(camera: Camera, shift: float, grid: _Grid) -> Values:
    """Return a lenslet's diffraction beyond its geometric image, as a kernel of sum 1."""
    lattice = camera.lattice
    width, gap = lattice.clear_diameter_um, lattice.gap_um
    bend = float(np.mean([1 - gap / kind.focal_length_um for kind in lattice.types]))
    # the image of one lenslet's aperture; near a focus on the lenslets, the beam limits it and not the lenslet
    half = width / 2 * min(1.0, abs(bend - gap / shift) if shift else 1.0)
    touching = lattice.clear_um is None or lattice.clear_um >= lattice.pitch_um
    strength = camera.wavelength_um * gap / width / math.pi**2
    start = max(math.sqrt(camera.wavelength_um * gap / 2), max(grid.pitch_um))
    rows, columns = grid.axes()
    kernel = np.zeros(grid.shape)
    if lattice.edge_to_edge:
        tail = partial(_seam, half=width / 2) if touching else partial(_slit, half=half)
        kernel[:, (columns.size - 1) // 2] += tail(rows, start=start, strength=strength / 2) * grid.pitch_um[0]
        kernel[(rows.size - 1) // 2] += tail(columns, start=start, strength=strength / 2) * grid.pitch_um[1]
    else:
        r = np.hypot(rows[:, None], columns)
        kernel = _slit(r, half, start, strength) / (math.pi * np.maximum(r, start)) * math.prod(grid.pitch_um)
    middle = (rows.size - 1) // 2, (columns.size - 1) // 2
    kernel[middle] += 1 - float(kernel.sum())
    return kernel


def _seam(x: Values, half: float, start: float, strength: float) -> Values:
    """Return the light density of the edge between touching lenslets, whose two edge waves nearly cancel.

    At this edge the phase is continuous, but its slope is not. The amplitudes are 1/(x + h) and -1/(x - h). The two
    lenslets deflect the light of the edge to the positions ``-h`` and ``h``.
    """
    away = np.abs(x)
    outside = away > half + start
    density = np.zeros_like(x)
    density[outside] = strength / 2 * (1 / (away[outside] - half) - 1 / (away[outside] + half)) ** 2
    return density


def _slit(x: Values, half: float, start: float, strength: float) -> Values:
    """Return the light density at distances ``x`` on both sides: half of -d/dX of strength (1/(X-h) + 1/(X+h))."""
    away = np.abs(x)
    outside = away > half + start
    density = np.zeros_like(x)
    density[outside] = strength / 2 * ((away[outside] - half) ** -2 + (away[outside] + half) ** -2)
    return density
