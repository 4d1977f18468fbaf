"""Tables of the wave engine for one depth plane: one set per lens type, built once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft as sf
from numpy.typing import NDArray

from lfcal.camera import cell_corners
from lfcal.simulate.engines._kernels import LensAperture, MainLensField, Zoom
from lfcal.simulate.engines._nodes import NodeRule, fitted_rule
from lfcal.simulate.engines._polygon import area, clip, disc_transform, regular
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.field import field_table
from lfcal.simulate.engines.masks import RING, disc_table, polygon_table
from lfcal.simulate.scene import Scene

__all__ = [
    "LensTable",
    "PlaneTables",
    "aperture_outline",
    "aperture_radius",
    "aperture_tables",
    "aperture_width",
    "bent",
    "build_tables",
    "ray_aberration",
    "serve",
    "steepest_sine",
    "table_reach",
    "tail_px",
    "window_of",
    "zoom_of",
]

TAIL, NEAREST, FARTHEST = 8, 20, 64
"""Ratio to the window's margin of the distance over which tails are followed beyond the window, and the smallest and
largest distance (pixels). About a tenth of the tail is farther away."""

ARC_SIDES = 96
"""Number of sides of the circle with equal area that represents a disc clipped by its cell (error 5e-4 radii)."""

BEST = 1 / 16
"""Upper limit of the fraction of light behind the brightest lenslet, so that the floor stays low near focus."""

Array = NDArray[Any]
Lit = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class LensTable:
    """Tables for the responses of one lens type.

    Attributes
    ----------
    width
        Width of the window on the sensor (pixels).
    pull
        The middle of the window is at c + pull (X0 - c), for a lenslet at c and a chief ray at X0.
    half
        Number of samples from the middle of the aperture to beyond its edge.
    aperture, zoom, field
        Inputs of the kernels; see `lfcal.simulate.engines._kernels`.
    energy
        Light transmitted by a lenslet at each sample of the field.
    field_reach_um
        Distance from the source's image up to which the field is valid (µm).
    """

    width: int
    pull: float
    half: int
    aperture: LensAperture
    zoom: Zoom
    field: MainLensField
    energy: Lit
    field_reach_um: float


@dataclass(frozen=True, slots=True)
class PlaneTables:
    """Tables of all lens types of a plane, and values shared by the types.

    Attributes
    ----------
    kinds
        Table of each lens type.
    rule
        Nodes and weights of the integration over pixels.
    spread_um2
        Product L = lambda B' of the wavelength and the reduced gap (µm²).
    ratio
        Ratio B'/a' of the reduced gap to the reduced image distance (see `Scene`); 0 in modes other than ``"E"``.
    floor
        Energy below which a lenslet is left out.
    reach_um
        Distance from the source's image beyond which no lenslet exceeds the floor (µm).
    """

    kinds: tuple[LensTable, ...]
    rule: NodeRule
    spread_um2: float
    ratio: float
    floor: float
    reach_um: float


def aperture_outline(scene: Scene) -> NDArray[np.float64]:
    """Return a lenslet's aperture as a polygon: its cell, or the part of the clear disc within the cell.

    The result contains the corners ``(n, 2)`` as (x, y), relative to the lenslet's centre (µm).
    """
    cell = cell_corners(scene.lattice.basis_um())
    return cell if scene.gapless else clip(regular(ARC_SIDES) * scene.clear_radius_um, cell)


def aperture_radius(scene: Scene) -> float:
    """Return the largest distance of a point of a lenslet's aperture from its centre (µm)."""
    if scene.round_lenslets:
        return scene.clear_radius_um
    return float(np.hypot(*aperture_outline(scene).T).max())


def steepest_sine(scene: Scene) -> float:
    """Return the sine, at most 1, of the steepest ray between lenslets and sensor."""
    cone, half = 1 / (2 * scene.f_number), aperture_width(scene) / 2
    # rays that the lenslets' spherical aberration deflects
    cone += 4 * abs(scene.lenslet_quartic) * scene.wavelength_um / (2 * math.pi) * half**3
    return min(cone + half / min(abs(kind.focal_length_um) for kind in scene.lattice.types), 1.0)


def aperture_width(scene: Scene) -> float:
    """Return the larger side of the bounding box of a lenslet's aperture (µm)."""
    if scene.round_lenslets:
        return 2 * scene.clear_radius_um
    return float(np.ptp(aperture_outline(scene), axis=0).max())


def tail_px(sampling: Sampling) -> int:
    """Return how far beyond its window a lenslet's light is computed (pixels); 0 if ``sampling.coherent`` is true."""
    return 0 if sampling.coherent else min(FARTHEST, max(NEAREST, TAIL * sampling.margin_px))


def build_tables(scene: Scene, sampling: Sampling, mode: str) -> PlaneTables:
    """Return the tables of a plane; ``mode`` is as in `lfcal.simulate.engines.field.FieldTable`."""
    spread = scene.wavelength_um * scene.reduced_gap_um
    ratio = scene.reduced_gap_um / scene.reduced_image_um if mode == "E" else 0.0
    band = 2 * aperture_radius(scene) * scene.reduced_pixel_um / spread
    rule = fitted_rule(sampling.nodes_per_px, band, scene.pixel_fill)
    # lens types with the same sample distance share a field, whose FFTs are the slowest part
    fields: dict[float, tuple[MainLensField, Lit, float]] = {}
    kinds = tuple(_lens_table(scene, sampling, mode, k, rule, fields) for k in range(len(scene.lattice.types)))
    floor = sampling.energy_floor * min(BEST, max(float(kind.energy.max()) for kind in kinds))
    reach = max(_lit_radius(energy, dx, floor) for dx, (_, energy, _) in fields.items())
    return PlaneTables(kinds, rule, spread, ratio, floor, reach)


def serve(tables: PlaneTables, scene: Scene, sampling: Sampling, mode: str) -> bool:
    """Return whether the tables of a plane extend far enough for ``scene``, the same plane with displaced sources."""
    for lens in tables.kinds:
        dx = lens.field.dx_um
        if table_reach(scene, sampling, mode, dx, lens.width // 2) + (lens.half + 2) * dx > lens.field_reach_um + dx:
            return False
    return True


def _lit_radius(energy: Lit, dx: float, floor: float) -> float:
    lit = energy >= max(floor, 1e-300)
    rows = np.nonzero(lit.any(1))[0]
    if rows.size == 0:
        return 0.0
    # for each row, the lit sample farthest from the middle: a list of all of them is larger than the table
    middle, lit_row = energy.shape[0] // 2, lit[rows]
    last = energy.shape[1] - 1 - lit_row[:, ::-1].argmax(1)
    columns = np.maximum(middle - lit_row.argmax(1), last - middle)
    return float(np.hypot(rows - middle, columns).max() + 1) * dx


def ray_aberration(scene: Scene) -> float:
    """Return an upper bound of the displacement of rays on the array by the wavefront (µm).

    The displacement is 2 Nw lambda dW/du, with the working f-number Nw and the wavelength lambda. W is the wavefront
    (waves) as a function of the distance u from the pupil's centre (pupil radii).

    A Zernike polynomial of order n that is 1 at the rim has slopes up to n^2.
    """
    return 2 * scene.f_number * scene.wavelength_um * sum(abs(w) * n * n for n, _, w in scene.wavefront)


def lenslet_aberration(scene: Scene) -> float:
    """Return the displacement (µm) on the sensor of a lenslet's outermost ray due to its spherical aberration.

    It is that of the lens type with the largest aberration.
    """
    steepest = 4 * abs(scene.lenslet_quartic) * aperture_radius(scene) ** 3
    return scene.reduced_gap_um * scene.wavelength_um / (2 * math.pi) * steepest


def _spot(scene: Scene, mode: str, kind: int) -> tuple[float, float, float]:
    """Return sigma, the geometric spot's radius (µm) and the pull of its middle towards the source."""
    radius = aperture_radius(scene)
    gap, cone = scene.reduced_gap_um, 1 / (2 * scene.f_number)
    at_infinity = 1.0 - scene.lens_curvature(kind)  # sigma without the source's sphere
    whole_pupil = abs(at_infinity * scene.reduced_image_um - gap) * cone  # spot of a lenslet that receives all light
    if mode != "E":
        return at_infinity, min(whole_pupil, abs(at_infinity) * radius + gap * cone), at_infinity
    sigma = scene.sigma(kind)
    if abs(sigma) * radius <= whole_pupil:
        return sigma, abs(sigma) * radius, gap / scene.reduced_image_um
    return sigma, whole_pupil, at_infinity


def _lens_table(
    scene: Scene,
    sampling: Sampling,
    mode: str,
    kind: int,
    rule: NodeRule,
    fields: dict[float, tuple[MainLensField, Lit, float]],
) -> LensTable:
    px, spread = scene.reduced_pixel_um, scene.wavelength_um * scene.reduced_gap_um
    sigma, _, pull = _spot(scene, mode, kind)
    half_px, dx = window_of(scene, sampling, mode, kind)
    half = math.ceil(aperture_radius(scene) / dx) + RING
    if dx not in fields:
        fields[dx] = _field(scene, sampling, mode, dx, half, half_px)
    field, energy, held = fields[dx]
    width = 2 * half_px + 1
    bend = math.pi * sigma / spread
    dtype = np.float64 if sampling.double else np.float32
    aperture = aperture_tables(scene, dx, (half + 1) * dx * math.sqrt(2), bend, dx * dx * px / spread, dtype, kind=kind)
    zoom = zoom_of(rule, width, px, 2 * np.pi / spread * dx * np.arange(half + 1), dtype)
    return LensTable(width, pull, half, aperture, zoom, field, energy, held)


def window_of(scene: Scene, sampling: Sampling, mode: str, kind: int) -> tuple[int, float]:
    """Return half the width of the window on the sensor (pixels), and the sample spacing on the array (µm).

    They are those of the lens type with the index ``kind``.
    """
    px = scene.reduced_pixel_um
    _, extent, pull = _spot(scene, mode, kind)
    extent += abs(pull) * ray_aberration(scene) + lenslet_aberration(scene)
    if scene.tilt != (0.0, 0.0):  # the farthest lenslets' spots are the widest
        rim = (scene.shadow_radius_um + math.hypot(*scene.period) * scene.pixel_um) * np.array([[1.0, 0.0], [0.0, 1.0]])
        _, widened = scene.tilted(np.concatenate([rim, -rim]), np.full(4, kind))
        extent += math.sqrt(2) * float(np.abs(widened).max()) * aperture_radius(scene)
    half_px = math.ceil(extent / px - 1e-3) + sampling.margin_px  # the same at sigma = 0 and next to it
    return half_px, px / (sampling.samples_per_px or _fewest_samples(scene, mode, half_px))


def zoom_of(rule: NodeRule, width: int, px: float, rates: NDArray[Any], dtype: type) -> Zoom:
    """Return the transform from samples on the array to the nodes of a window on the sensor, along one axis.

    ``rates`` contains, for the samples from the aperture's middle to its edge, the increase of the phase along the
    sensor (rad/µm). ``rule`` contains the nodes in a pixel, the window is ``width`` pixels wide, and ``px`` is the
    pixel pitch (µm). ``dtype`` is the real type of the transform.
    """
    nodes = rule.positions(width) * px
    angle = np.outer(nodes[nodes.size // 2 :], rates)
    # in float64 up to here, because large phases would lose digits; sines and cosines do not
    cosine: Array = np.cos(angle).astype(dtype)
    sine: Array = np.sin(angle).astype(dtype)
    bins: Array = rule.matrix(width).astype(dtype)
    turned = np.ascontiguousarray(cosine.T), np.ascontiguousarray(sine.T)
    return Zoom(cosine, sine, *turned, bins, np.ascontiguousarray(bins.T), nodes, rule.per_px)


def aperture_tables(
    scene: Scene,
    dx: float,
    reach: float,
    bend: float,
    level: float,
    dtype: type,
    *,
    kind: int = 0,
    fine: int | None = None,
) -> LensAperture:
    """Return the tables of a lenslet's transmission, with the factor ``level`` for its amplitude.

    The tables extend to the distance ``reach`` from the centre and are sampled for fields at the spacing ``dx`` (µm).
    ``bend`` is the quadratic phase (rad/µm^2), ``kind`` the index of the lens type, and ``dtype`` the real type.
    ``fine`` is the oversampling of a polygon's table relative to ``dx``. None: that of `fineness`.
    """
    if scene.round_lenslets:
        m, step = disc_table(scene.clear_radius_um, dx, reach)
        r2, quartic = step * np.arange(m.size), scene.quartic(kind)
        value = level * m * np.exp(1j * r2 * (bend + quartic * r2))
        parts = value.real.astype(dtype), value.imag.astype(dtype)
        return LensAperture(*parts, step, np.zeros((0, 0), dtype), 1.0, bend, quartic)
    # a square, not the disc around it
    table, step = polygon_table(aperture_outline(scene), dx, reach / math.sqrt(2), fine)
    none: Array = np.zeros(2, dtype)
    return LensAperture(none, none, 1.0, (level * table).astype(dtype), step, bend, scene.quartic(kind))


def bent(aperture: LensAperture, by: float, gain: float = 1.0) -> LensAperture:
    """Return the aperture with ``by`` (rad/µm^2) added to its quadratic phase, and its amplitude times ``gain``."""
    dtype = aperture.disc_re.dtype
    if aperture.cell.size:
        return aperture._replace(bend=aperture.bend + by, cell=(gain * aperture.cell).astype(dtype))
    turn = gain * np.exp(1j * by * aperture.disc_step * np.arange(aperture.disc_re.size))
    value = (aperture.disc_re + 1j * aperture.disc_im) * turn
    parts = value.real.astype(dtype), value.imag.astype(dtype)
    return aperture._replace(disc_re=parts[0], disc_im=parts[1], bend=aperture.bend + by)


def _fewest_samples(scene: Scene, mode: str, half_px: int) -> float:
    """Return the samples per pixel, in halves, whose alias-free half range L/(2 dx) contains the window."""
    px = scene.reduced_pixel_um
    need = 2 * (half_px + 0.5) * px * px / (scene.wavelength_um * scene.reduced_gap_um)
    if mode != "E":
        need = max(need, 1.2 * px / (scene.wavelength_um * scene.f_number))
    return max(1.0, math.ceil(2 * need) / 2)


def _field(
    scene: Scene, sampling: Sampling, mode: str, dx: float, half: int, half_px: int
) -> tuple[MainLensField, Lit, float]:
    """Return the field table, the light that a lenslet at each sample transmits, and the range of validity (µm)."""
    reach = table_reach(scene, sampling, mode, dx, half_px) + (half + 2) * dx
    values = field_table(scene, dx, reach, mode).values
    n = values.shape[0]
    f = sf.fftfreq(n, dx)
    radius = scene.clear_radius_um
    if not scene.round_lenslets:
        radius = math.sqrt(abs(area(aperture_outline(scene))) / math.pi)
    shape = disc_transform(radius, np.hypot(f[None, : n // 2 + 1], f[:, None]))
    # |E|^2 convolved with the aperture's shape: the energy of a lenslet at every sample, by one pair of FFTs
    light = np.square(values.real)
    light += np.square(values.imag)
    dtype = np.float64 if sampling.double else np.float32
    field = MainLensField(values.real.astype(dtype), values.imag.astype(dtype), dx)
    del values  # twice as large, and no longer needed
    spectrum = sf.rfft2(light, overwrite_x=True)
    spectrum *= shape
    return field, sf.irfft2(spectrum, s=(n, n), overwrite_x=True).astype(np.float32), reach


def table_reach(scene: Scene, sampling: Sampling, mode: str, dx: float, half_px: int) -> float:
    """Return the largest distance from the source's image at which lenslets contribute (µm).

    The fraction of light that is diffracted farther than r beyond the edge of the iris's shadow is 2 lambda Nw / (pi^2
    r). Here lambda is the wavelength and Nw the working f-number. A lenslet does not contribute if it is darker than
    `Sampling.energy_floor`, or beyond the reach of the sampled spectrum. Neither does one whose spot misses the cutout.
    ``mode`` is as in `build_tables`, ``dx`` is the sample spacing of the field (µm), and ``half_px`` half the window on
    the sensor (pixels).
    """
    lam, nw, radius = scene.wavelength_um, scene.f_number, aperture_radius(scene)
    shadow = scene.shadow_radius_um
    best = min(BEST, (radius / max(shadow, radius)) ** 2)
    floor = max(sampling.energy_floor, 1e-7) * best
    tail = radius * math.sqrt(lam * nw / (math.pi**2 * max(shadow, radius) * floor))
    # the sampled spectrum ends at 1/(2 dx), so nothing gets farther than its highest frequency travels over a'
    tail = min(tail, abs(scene.reduced_image_um) * lam / (2 * dx) + 80 * lam * nw)
    lit = 1.15 * shadow + radius + tail + ray_aberration(scene)
    spot_rate = abs(1 - scene.reduced_gap_um / scene.reduced_image_um) if mode == "E" else 1.0
    shown = (
        math.hypot(*scene.cutout) / 2 + 1.5 * half_px + tail_px(sampling) + 2
    ) * scene.reduced_pixel_um + ray_aberration(scene)
    shown += scene.farthest_um / scene.scale
    return min(lit, shown / max(spot_rate, 1e-6) + radius)
