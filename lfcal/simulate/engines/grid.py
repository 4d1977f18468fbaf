"""Level ``"grid"``: all lenslets of a position on one grid, propagated to the sensor by two FFTs.

All arrays are in single precision, unless double precision is requested.

The transmission of the array is tabulated once, on samples with the same offsets in every pixel. For a position, a
part of this table is multiplied by the main lens's field and propagated over the gap. Fields of all lenslets are
added, no window truncates their light, and rays have exact angles at any depth, including the native plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.fft as sf
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, for_each_chunk, kernel_spared, raise_if_abandoned
from lfcal.simulate._symmetry import mirrored_rows
from lfcal.simulate.engines._binning import bin_light, bin_light_by_numpy
from lfcal.simulate.engines._kernels import LensAperture, Split, fill_disc, mask_from_table
from lfcal.simulate.engines._nodes import MANY_ANGLES, conserving_rule, fitted_rule
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.base import Certificate, EnergyError, Ledger, Pilot, Sampling
from lfcal.simulate.engines.extent import MAX_SAMPLES, MAX_SIDE, SWITCH, Extent
from lfcal.simulate.engines.field import choose_mode, field_spectrum
from lfcal.simulate.engines.masks import RING, Bend, bent_polygon_table
from lfcal.simulate.engines.tables import (
    aperture_outline,
    aperture_radius,
    aperture_tables,
    lenslet_aberration,
    ray_aberration,
    steepest_sine,
)
from lfcal.simulate.engines.tilted import TiltedArray
from lfcal.simulate.scene import Scene, pixel_response

if TYPE_CHECKING:
    from lfcal.simulate.engines._fused import FusedResponse

__all__ = ["GridPlane", "extent_of", "largest_angle"]

SLACK = 1e-4
"""Largest energy that rounding in single precision may add to a position."""

TRANSFORM_S = 1.2e-8
"""Additional processor time (s) per sample of separate transforms and of binning by numpy."""

SLOW_TO_COMPILE = 2.5
"""As ``slow`` of `kernel_spared`: compiling `respond` takes 1.3 s."""

Complex = NDArray[Any]  # single precision, or double where it is asked for
Place = tuple[float, float]


class _Separate(NamedTuple):
    """Propagation of fields to the pixels by separate FFTs and binning."""

    transfer: Complex
    binned: Callable[..., None]


class _Gap:
    """Propagation from the array to the pixels, shared by the engines of a plane.

    Parameters
    ----------
    transfer
        Transfer function (n, n) over the gap.
    alike
        Whether all positions have the same path behind the array, in single precision.
    """

    def __init__(self, transfer: Complex, alike: bool) -> None:
        self._transfer, self._alike = transfer, alike
        self._fused: FusedResponse | None = None

    def way(self, positions: int) -> FusedResponse | _Separate:
        """Return the object that propagates the fields of ``positions`` positions to the pixels.

        It uses compiled passes or, if these are not worth compiling, separate FFTs.
        """
        if self._fused is None:
            separate = TRANSFORM_S * positions * len(self._transfer) ** 2
            kernel = "lfcal.simulate.engines._fused_llvm", "respond"
            if self._alike and kernel_spared(*kernel, separate, slow=SLOW_TO_COMPILE):
                return _Separate(self._transfer, bin_light_by_numpy)
            from lfcal.simulate.engines._fused import FusedResponse  # compiled code: loaded only when it is needed

            if not (self._alike and FusedResponse.transforms(len(self._transfer))):
                return _Separate(self._transfer, bin_light)
            self._fused = FusedResponse(self._transfer)
            self._transfer = self._transfer[:0].copy()  # the passes have their own
        return self._fused


def largest_angle(scene: Scene) -> float:
    """Return the number of samples per pixel that is needed for all angles of the light between lenslets and sensor."""
    return 2 * scene.reduced_pixel_um * steepest_sine(scene) / scene.wavelength_um


def extent_of(scene: Scene) -> Extent:
    """Return the extent of the light of one position on the array and on the sensor."""
    px = scene.reduced_pixel_um
    # rays at the rim of the cone go outwards if the image is in front of the array or on it
    outwards = scene.fresnel_number < SWITCH or scene.reduced_image_um < 0
    aside = scene.reduced_gap_um / (2 * scene.f_number) if outwards else 0.0
    shadow = scene.shadow_radius_um + ray_aberration(scene) + scene.farthest_um / scene.scale
    around = shadow / px, (aside + lenslet_aberration(scene)) / px
    return Extent(*around, max(scene.cutout) / 2, scene.lattice.pitch_um / px)


def _per_px(sampling: Sampling) -> int:
    wanted = sampling.samples_per_px
    per = 4 if wanted is None else round(wanted)
    if per < 1 or (wanted is not None and per != wanted):
        raise InputError.expected(
            "samples per pixel of a grid",
            "a whole number of 1 or more",
            wanted,
            "leave it out, or give a number such as 4",
        )
    return per


class GridPlane:
    """Engine of level ``"grid"`` for one depth plane.

    Parameters
    ----------
    scene
        The scene to compute.
    sampling
        ``samples_per_px`` (an integer, default 4) for both array and sensor, the ``margin_px`` around the shadow, and
        ``double``; the other fields are not used.
    mode
        Mode of propagation as in `lfcal.simulate.engines.field.FieldTable`. None: that of `choose_mode`.

    Raises
    ------
    InputError
        If ``samples_per_px`` is not an integer, a grid is too large, or the array is tilted too much.
    """

    level = "grid"

    def __init__(self, scene: Scene, sampling: Sampling | None = None, mode: str | None = None) -> None:
        self.scene = scene
        self.sampling = sampling or Sampling()
        self.mode = mode or choose_mode(scene)
        self.per_px = _per_px(self.sampling)
        self._n = extent_of(scene).side(self.per_px, self.sampling.margin_px)
        if self._n > MAX_SAMPLES:
            remedy = "choose another level, or a depth whose light reaches fewer lenslets"
            raise InputError.expected(
                "sampling grid of one position of the source",
                f"at most {MAX_SAMPLES} samples on each side",
                self._n,
                remedy,
            )
        self._dtype = np.dtype(np.complex128 if self.sampling.double else np.complex64)
        self._real = np.dtype(np.float64 if self.sampling.double else np.float32)
        self._dx = scene.reduced_pixel_um / self.per_px
        # an even number of samples on both sides of a pixel's middle
        self._between = 0.5 if self.per_px % 2 == 0 else 0.0
        self._apertures = self._lenslets()
        self._array = self._transmission((0, 0), scene.period)
        self._table, self._size = self._main_field()
        self._tilted = None
        if scene.tilt != (0.0, 0.0):
            self._tilted = TiltedArray(scene, self._n, self._dx, self._n / 2 * self._dx, self._dtype)
        band = min(2.0 * self.per_px, largest_angle(scene))
        if scene.pixel_fill == 1:  # pixels without gaps cannot create light
            self._rule = conserving_rule(self.per_px, band, MANY_ANGLES)
        else:
            self._rule = fitted_rule(self.per_px, band, scene.pixel_fill, falloff=MANY_ANGLES)
        self._weights = (self._rule.weights * scene.reduced_pixel_um).astype(self._real)
        self._gap = _Gap(self._transfer(), self._tilted is None and not self.sampling.double)
        self._lit: tuple[Place, Complex] | None = None
        self._wider: GridPlane | None = None
        self._ledger = Ledger()
        self._pilot = Pilot()

    # -- set-up ------------------------------------------------------------------------------------------
    def _lenslets(self) -> tuple[tuple[LensAperture, ...], ...]:
        """Return aperture and phase of each lens type on the grid's samples; for a polygon, real and imaginary part."""
        scene, dx = self.scene, self._dx
        reach = (self._half_lenslet + 1) * dx * math.sqrt(2)
        bends = (-math.pi / (scene.wavelength_um * kind.focal_length_um) for kind in scene.lattice.types)
        if scene.round_lenslets:
            discs = (aperture_tables(scene, dx, reach, b, 1.0, self._real.type, kind=k) for k, b in enumerate(bends))
            return tuple((disc,) for disc in discs)
        outline, none, found = aperture_outline(scene), np.zeros(2, self._real), []
        for kind, bend in enumerate(bends):
            # a square, not the disc around it
            tables, step = bent_polygon_table(outline, dx, reach / math.sqrt(2), Bend(bend, scene.quartic(kind)))
            parts = (np.ascontiguousarray(part, self._real) for part in tables)
            found.append(tuple(LensAperture(none, none, 1.0, part, step, 0.0, 0.0) for part in parts))
        return tuple(found)

    @property
    def _half_lenslet(self) -> int:
        """Samples from a lenslet's middle to its edge."""
        return math.ceil(aperture_radius(self.scene) / self._dx) + RING

    def _transmission(self, first: tuple[int, int], count: tuple[int, int]) -> Complex:
        """Return the array's transmission on the grids of ``count`` positions, starting from ``first`` (y, x)."""
        scene, dx, half = self.scene, self._dx, self._half_lenslet
        rows, columns = ((c - 1) * self.per_px + self._n for c in count)
        if max(rows, columns) > MAX_SIDE:
            got, remedy = f"{rows} x {columns}", "choose another level"
            limit = f"at most {MAX_SIDE} samples on each side"
            raise InputError.expected("sampled transmission of the lenslet array", limit, got, remedy)
        top, left = ((f * self.per_px - self._n // 2 + self._between) * dx for f in first)
        array = np.zeros((rows, columns), self._dtype)
        reach = (half + 1) * dx
        height, width = (rows - 1) / 2 * dx, (columns - 1) / 2 * dx
        centres, kinds = scene.lattice.lenslets_within(width + reach, height + reach, (left + width, top + height))
        gains = np.sqrt(scene.passed(centres))
        parts, none = np.empty((2, 2, 2 * half + 1, 2 * half + 1), self._real)
        for (x, y), kind, gain in zip(centres, kinds, gains, strict=True):
            i, j = round((y - top) / dx), round((x - left) / dx)
            place = dx, left + j * dx - x, top + i * dx - y
            if scene.round_lenslets:
                fill_disc(self._apertures[kind][0], *place, Split(parts[0], parts[1]))
            else:
                for aperture, part in zip(self._apertures[kind], parts, strict=True):
                    mask_from_table(aperture, *place, Split(part, none[0]))
            _lay(gain * (parts[0] + 1j * parts[1]), i - half, j - half, array)
        return array

    def _main_field(self) -> tuple[Complex, int]:
        """Return the spectrum of the main lens's field about a source's image, and its side.

        The phase of the sphere that converges to the image is omitted, because it is not sampled finely enough to be
        shifted.
        """
        aside = self.scene.farthest_um / self.scene.scale
        spectrum = field_spectrum(self.scene, self._dx, (self._n // 2 + 2) * self._dx + aside, self.mode)
        return spectrum.astype(self._dtype), spectrum.shape[0]

    def _transfer(self) -> Complex:
        """Return the transfer function over the gap, with the pixels' response to the angle of light."""
        scene, f = self.scene, sf.fftfreq(self._n, self._dx)
        glass = (scene.glass[0] / scene.scale, scene.glass[1])
        step, separable = sensor_propagator(f, scene.wavelength_um, scene.reduced_gap_um, scene.exact_rays, glass)
        if separable:
            step = step[:, None] * step[None, :]
        if scene.accept[0]:
            power, from_y, from_x = scene.accept
            sines = scene.wavelength_um * f
            # as a factor of the amplitude
            step = step * pixel_response(power / 2, sines[:, None] + from_y, sines[None, :] + from_x)
        return step.astype(self._dtype)

    def in_mode(self, mode: str) -> GridPlane:
        """Return an engine for the field of the scene in another ``mode``; it shares the table of the array."""
        other = copy(self)
        other.mode, other._lit, other._wider = mode, None, None
        other._table, other._size = other._main_field()
        other._ledger, other._pilot = Ledger(), Pilot()
        return other

    def displaced(self, offsets_um: NDArray[np.float64]) -> GridPlane:
        """Return an engine of the same plane for displaced sources, which shares the tables if they extend far enough.

        ``offsets_um`` is as in `Displaceable.displaced`.
        """
        scene = replace(self.scene, offsets_um=offsets_um)
        if scene.farthest_um > self.scene.farthest_um:
            # the light extends beyond this grid; twice as far, because the next source may be farther away
            if self._wider is None or scene.farthest_um > self._wider.scene.farthest_um:
                self._wider = GridPlane(replace(scene, offsets_um=2 * offsets_um), self.sampling, self.mode)
            return self._wider.displaced(offsets_um)
        other = copy(self)
        other.scene, other._lit = scene, None
        other._ledger, other._pilot = Ledger(), Pilot()
        return other

    # -- responses ---------------------------------------------------------------------------------------
    @property
    def grid_side(self) -> int:
        """Number of samples along a side of the grid; see `PlaneEngine.grid_side`."""
        return self._n

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far."""
        return self._ledger.certificate

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the cutouts of the positions in ``ys`` and ``xs``; see `PlaneEngine.rows`."""
        scene = self.scene
        rows, columns = np.atleast_1d(np.asarray(ys, np.int64)), np.atleast_1d(np.asarray(xs, np.int64))
        result = np.empty((rows.size, columns.size, *scene.cutout), np.float32) if out is None else out
        mirrored = mirrored_rows(scene, rows)
        computed = [(r, c) for r in range(rows.size) if r not in mirrored for c in range(columns.size)]

        way = self._gap.way(len(computed))

        def some(start: int, stop: int) -> None:
            work = self._workspace(way)
            for r, places in groupby(computed[start:stop], key=itemgetter(0)):
                raise_if_abandoned()
                cs = [c for _, c in places]  # consecutive columns
                pixels = [(int(rows[r]), int(columns[c])) for c in cs]
                self._respond([scene.source_um(*p) for p in pixels], pixels, way, work, result[r, cs[0] : cs[-1] + 1])

        for_each_chunk(some, len(computed), workers)
        for r, twin in mirrored.items():
            result[r] = result[twin][:, ::-1]
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        out = np.empty((1, *self.scene.cutout), np.float32)
        way = self._gap.way(1)
        self._respond([(y_um, x_um)], [self.scene.nearest_pixel(y_um, x_um)], way, self._workspace(way), out)
        cutout: NDArray[np.float32] = out[0]
        return cutout

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    def _workspace(self, way: FusedResponse | _Separate) -> Any:
        """Return the work arrays of one thread."""
        if isinstance(way, _Separate):
            return np.empty((self._n, self._n), self._dtype)
        return way.workspace(self.scene.cutout[0])

    def _respond(
        self,
        sources: Sequence[Place],
        pixels: Sequence[tuple[int, int]],
        way: FusedResponse | _Separate,
        work: Any,
        out: NDArray[np.float32],
    ) -> None:
        """Fill ``out`` (k, nt, ns) for sources (y, x) on the sensor and their cutouts' middle pixels."""
        scene, per = self.scene, self.per_px
        # where the samples of the cutout's middle pixel begin, some of which are in the previous pixel
        first = self._n // 2 - per // 2 - self._rule.beyond
        top, left = (first - (count // 2) * per for count in scene.cutout)

        def met(source: Place, pixel: tuple[int, int]) -> tuple[Complex, Complex, tuple[int, int]]:
            y, x = ((s - p * scene.pixel_um) / scene.scale / self._dx for s, p in zip(source, pixel, strict=True))
            return self._incoming((y, x)), *self._array_part(pixel)

        if isinstance(way, _Separate):
            for source, pixel, one in zip(sources, pixels, out, strict=True):
                lit, table, (y, x) = met(source, pixel)
                power, spectrum = self._spectrum(lit, table[y : y + self._n, x : x + self._n], pixel, work)
                spectrum *= way.transfer
                light = sf.ifft2(spectrum, overwrite_x=True, workers=1)
                way.binned(light, self._weights, per, top, left, one)
                self._certify(power * self._dx**2, float(one.sum(dtype=np.float64)))
            return
        done = 0
        # positions with the same field and table are computed by one call
        for _, some in groupby(map(met, sources, pixels), key=lambda found: (id(found[0]), id(found[1]))):
            alike = list(some)
            lit, table, _ = alike[0]
            part = out[done : done + len(alike)]
            corners = [corner for _, _, corner in alike]
            powers = way.each(lit, (table, corners), self._weights, (per, top, left), work, part)
            for power, one in zip(powers.tolist(), part, strict=True):
                self._certify(power * self._dx**2, float(one.sum(dtype=np.float64)))
            done += len(alike)

    def _spectrum(self, lit: Complex, seen: Complex, pixel: tuple[int, int], work: Complex) -> tuple[float, Complex]:
        """Return the power of the field behind the array, and its spectrum (n, n)."""
        if self._tilted is None:
            np.multiply(lit, seen, out=work)
            return float(np.vdot(work, work).real), sf.fft2(work, overwrite_x=True, workers=1)
        heights = self._tilted.heights(self._farther(pixel))
        np.multiply(self._tilted.met(lit, heights), seen, out=work)
        return float(np.vdot(work, work).real), self._tilted.left(work, heights)

    def _farther(self, pixel: tuple[int, int]) -> NDArray[np.float64]:
        """Return the additional distance of the array from the sensor at the samples of the grid about a pixel (µm)."""
        axis = np.arange(self._n, dtype=np.float64) - self._n // 2 + self._between
        y, x = ((p * self.per_px + axis) * self._dx for p in pixel)
        return self.scene.farther_at(y[:, None], x[None, :])

    def _array_part(self, pixel: tuple[int, int]) -> tuple[Complex, tuple[int, int]]:
        """Return a table of the array, and the position (row, column) in it at which the grid about a pixel begins."""
        if not all(0 <= p < count for p, count in zip(pixel, self.scene.period, strict=True)):
            return self._transmission(pixel, (1, 1)), (0, 0)
        return self._array, (pixel[0] * self.per_px, pixel[1] * self.per_px)

    def _incoming(self, aside: Place) -> Complex:
        """Return the main lens's field ``(n, n)``, including its sphere, for a source displaced by ``aside`` (y, x).

        For a tilted array, return the parts that `TiltedArray.met` takes.
        """
        known = self._lit
        if known is not None and math.dist(known[0], aside) < 1e-9:
            return known[1]
        lit = self._shifted((self._between - aside[0], self._between - aside[1]))
        if self.mode == "E":
            bend = -math.pi / (self.scene.wavelength_um * self.scene.reduced_image_um)
            axis = np.arange(self._n) - self._n // 2 + self._between
            y, x = (np.exp(1j * bend * ((axis - a) * self._dx) ** 2).astype(self._dtype) for a in aside)
            lit *= y[:, None]
            lit *= x[None, :]
        if self._tilted is not None:
            lit = self._tilted.parts(lit)
        self._lit = aside, lit
        return lit

    def _shifted(self, by: Place) -> Complex:
        """Return the ``(n, n)`` values of the main lens's field displaced by ``by`` samples (y, x)."""
        n, size = self._n, self._size
        whole = [math.floor(b + 0.5) for b in by]
        f = sf.fftfreq(size)
        y, x = (np.exp(2j * np.pi * f * (b - w)).astype(self._dtype) for b, w in zip(by, whole, strict=True))
        field = sf.ifft2(self._table * y[:, None] * x[None, :], overwrite_x=True, workers=1)
        part = np.zeros((n, n), self._dtype)
        row, column = (n // 2 - size // 2 - w for w in whole)
        _lay(field, row, column, part)
        return part

    def _certify(self, energy_in: float, energy_out: float) -> None:
        ratio = energy_out / energy_in if energy_in > 0 else 0.0
        if not ratio <= 1 + SLACK:  # also true for NaN
            raise EnergyError.expected(
                "energy on the sensor",
                "at most the energy transmitted by the array",
                f"{ratio:.6g} times as much",
                f"choose a smaller tolerance, or in Python set samples_per_px above {self.per_px}",
            )
        self._ledger.add(1, energy_in, energy_out, ratio)


def _lay(piece: Complex, row: int, column: int, on: Complex) -> None:
    """Add ``piece`` to the array ``on``; its first sample is at (``row``, ``column``), which may be outside."""
    top, left = max(0, -row), max(0, -column)
    bottom, right = min(piece.shape[0], on.shape[0] - row), min(piece.shape[1], on.shape[1] - column)
    if top < bottom and left < right:
        on[row + top : row + bottom, column + left : column + right] += piece[top:bottom, left:right]
