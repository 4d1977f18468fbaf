"""Level ``"reference"``: the whole lenslet plane on one grid, all lenslets coherent, propagated to the sensor by FFT.

It is slow and has none of the simplifications of the other levels, which are compared with it at some positions.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft as sf
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.simulate.engines._propagator import sensor_propagator
from lfcal.simulate.engines.base import Certificate, EnergyError, Ledger, Pilot, Sampling
from lfcal.simulate.engines.field import choose_mode, field_table
from lfcal.simulate.engines.masks import RING, Bend, bent_polygon, disc_table
from lfcal.simulate.engines.tables import (
    aperture_outline,
    aperture_radius,
    lenslet_aberration,
    ray_aberration,
)
from lfcal.simulate.engines.tilted import TiltedArray
from lfcal.simulate.scene import Scene, pixel_response

__all__ = ["ReferencePlane", "pixel_bins"]

BENT_FINE = 4
"""Fine samples for each grid sample, for bending a lenslet's cell; with six, a response changes by 2e-5."""
MAX_SAMPLES = 6000
"""Largest side of the grid (samples): 0.6 GB in double precision."""
REFERENCE_CACHE_BYTES = 64_000_000
"""Largest total size of stored lenslets (bytes), which are reused at equal positions relative to the grid."""
Complex = NDArray[np.complex128]


def pixel_bins(n: int, per_px: int, pixels: int, first: float, fill: float = 1.0) -> NDArray[np.float64]:
    """Return weights ``(pixels, n)`` that integrate ``n`` samples of band-limited light over ``pixels`` pixels.

    There are ``per_px`` samples per pixel. Pixel 0 is centred on sample ``first``, which may be a fraction; ``fill`` is
    the light-sensitive fraction of a pixel's width. The weights are the inverse Fourier transform of the pixel's
    transfer function, fill sinc(f fill), with the frequency f in cycles per pixel. With the trapezoidal rule, a small
    spot would have an error of 1 % to 2 % at 8 samples per pixel.
    """
    f = np.fft.rfftfreq(n, 1 / per_px)  # cycles per pixel
    centres = first / per_px + np.arange(pixels)
    transfer = fill * np.sinc(f * fill) * np.exp(-2j * np.pi * np.outer(centres, f))
    bins: NDArray[np.float64] = np.fft.irfft(transfer, n, axis=1)
    return bins


class ReferencePlane:
    """Engine of level ``"reference"`` for one depth plane, which computes in complex128 throughout.

    ``sampling.samples_per_px`` (an integer, default 8) sets the grid for both array and sensor. ``mode`` is as in
    `lfcal.simulate.engines.field.FieldTable`. None: that of `choose_mode`.
    """

    level = "reference"

    def __init__(self, scene: Scene, sampling: Sampling | None = None, mode: str | None = None) -> None:
        self.scene = scene
        self.sampling = sampling or Sampling()
        self.mode = mode or choose_mode(scene)
        self._ledger = Ledger()
        self._pilot = Pilot(columns=1)
        wanted = self.sampling.samples_per_px
        self.per_px = 8 if wanted is None else round(wanted)
        if self.per_px < 1 or (wanted is not None and self.per_px != wanted):
            raise InputError.expected(
                "samples per pixel of the reference",
                "a whole number of 1 or more",
                wanted,
                "leave it out, or give a number such as 8",
            )
        self._dx = scene.reduced_pixel_um / self.per_px
        self._reach = self._lit_radius()
        seen = max(scene.cutout) / 2 * scene.reduced_pixel_um + scene.farthest_um / scene.scale
        half = max(self._reach, seen) + self._spill()
        self._n = self._side(half)
        self._axis = (np.arange(self._n) - self._n // 2) * self._dx
        self._field = self._centre_field()
        self._tilted = None
        if scene.tilt != (0.0, 0.0):
            self._tilted = TiltedArray(scene, self._n, self._dx, self._reach + aperture_radius(scene), np.complex128)
            self._parts = self._tilted.parts(self._field)
        self._disc: tuple[NDArray[np.float64], float] | None = None
        self._cached: dict[tuple[int, float, float], Complex] = {}
        self._step, self._separable = sensor_propagator(
            sf.fftfreq(self._n, self._dx),
            scene.wavelength_um,
            scene.reduced_gap_um,
            scene.exact_rays,
            (scene.glass[0] / scene.scale, scene.glass[1]),
        )

    # -- set-up ------------------------------------------------------------------------------------------
    def _lit_radius(self) -> float:
        """Return the distance from the source up to which lenslets are computed (µm)."""
        scene = self.scene
        blur = 4 * math.sqrt(scene.wavelength_um * abs(scene.reduced_image_um))
        near = 60 * scene.wavelength_um * scene.f_number
        return 1.15 * scene.shadow_radius_um + max(blur, near) + aperture_radius(scene) + ray_aberration(scene)

    def _spill(self) -> float:
        """Return how far light travels sideways behind the array (µm)."""
        scene = self.scene
        return 1.5 * scene.lattice.pitch_um + scene.reduced_gap_um / (2 * scene.f_number) + lenslet_aberration(scene)

    def _side(self, half: float) -> int:
        n = int(sf.next_fast_len(2 * math.ceil(half / self._dx)))
        n += n % 2
        if n > MAX_SAMPLES:
            raise InputError.expected(
                "reference grid",
                f"at most {MAX_SAMPLES} samples on each side",
                n,
                "choose another level, or a depth that lights fewer lenslets",
            )
        return n

    def _centre_field(self) -> Complex:
        """Return the main lens's field on the grid, its converging sphere included, about the source's image."""
        table = field_table(self.scene, self._dx, self._reach + aperture_radius(self.scene), self.mode)
        size, n = table.values.shape[0], self._n
        field = np.zeros((n, n), np.complex128)
        m = min(size, n) // 2
        field[n // 2 - m : n // 2 + m, n // 2 - m : n // 2 + m] = table.values[
            size // 2 - m : size // 2 + m, size // 2 - m : size // 2 + m
        ]
        if self.mode == "E":
            sphere = np.exp(-1j * np.pi / (self.scene.wavelength_um * self.scene.reduced_image_um) * self._axis**2)
            field *= sphere[:, None] * sphere[None, :]
        return field

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
        """Return the cutouts of the positions in ``ys`` and ``xs``, one at a time; see `PlaneEngine.rows`."""
        scene = self.scene
        rows, columns = np.atleast_1d(np.asarray(ys, np.int64)), np.atleast_1d(np.asarray(xs, np.int64))
        result = np.empty((rows.size, columns.size, *scene.cutout), np.float32) if out is None else out
        for i, y in enumerate(rows):
            for j, x in enumerate(columns):
                source = scene.source_um(int(y), int(x))
                result[i, j] = self._respond(source, (int(y), int(x)), workers)
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        return self._respond((y_um, x_um), self.scene.nearest_pixel(y_um, x_um), 1)

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    def lenslet_field(self, y_um: float, x_um: float) -> Complex:
        """Return the field just behind the array, ``(n, n)``, centred on a chief ray; n is `grid_side`.

        The chief ray meets the sensor at the point (``y_um``, ``x_um``), relative to the sensor point of source
        position (0, 0) (µm).
        """
        scene, axis, dx = self.scene, self._axis, self._dx
        source = np.array([x_um, y_um]) / scene.scale
        reach = self._reach + aperture_radius(scene)
        centres, kinds = scene.lattice.lenslets_within(reach, reach, (float(source[0]), float(source[1])))
        lit, tilted = self._field, self._tilted
        if tilted is not None:
            heights = tilted.heights(scene.farther_at(source[1] + axis[:, None], source[0] + axis[None, :]))
            lit = tilted.met(self._parts, heights)
        behind = np.zeros_like(self._field)
        gains = np.sqrt(scene.passed(centres))
        size = 2 * (math.ceil(aperture_radius(scene) / dx) + 2 * RING) + 1
        for (cx, cy), kind, gain in zip(centres - source, kinds, gains, strict=True):
            i, j = round(cy / dx) + self._n // 2 - size // 2, round(cx / dx) + self._n // 2 - size // 2
            if math.hypot(cx, cy) > self._reach or min(i, j) < 0 or max(i, j) + size > self._n:
                continue
            rows, columns = slice(i, i + size), slice(j, j + size)
            lens = self._lens(axis[columns] - cx, axis[rows] - cy, int(kind))
            behind[rows, columns] += gain * lens * lit[rows, columns]
        return behind if tilted is None else sf.ifft2(tilted.left(behind, heights), overwrite_x=True)

    def _lens(self, x: NDArray[np.float64], y: NDArray[np.float64], kind: int) -> Complex:
        """Return a lenslet's transmission at (x, y) from its centre, cached for equal positions in the grid."""
        where = kind, round(float(x[0]) / self._dx, 9), round(float(y[0]) / self._dx, 9)
        lens = self._cached.get(where)
        if lens is None:
            lens = self._lens_at(x, y, kind)
            if (len(self._cached) + 1) * lens.nbytes > REFERENCE_CACHE_BYTES:
                self._cached.clear()
            self._cached[where] = lens
        return lens

    def _lens_at(self, x: NDArray[np.float64], y: NDArray[np.float64], kind: int) -> Complex:
        """Return a lenslet's aperture and its phase."""
        scene, dx = self.scene, self._dx
        bend = Bend(-np.pi / (scene.wavelength_um * scene.lattice.types[kind].focal_length_um), scene.quartic(kind))
        if not scene.round_lenslets:
            n = x.size
            centre = (-float(x[n // 2]), -float(y[n // 2]))
            return bent_polygon(aperture_outline(scene), dx, centre, n, bend, BENT_FINE, every=BENT_FINE)
        r2 = x[None, :] ** 2 + y[:, None] ** 2
        if self._disc is None:
            self._disc = disc_table(scene.clear_radius_um, dx, math.sqrt(float(r2.max())) + 3 * dx, fine=512)
        table, step = self._disc
        lens: Complex = np.interp(r2, step * np.arange(table.size), table) * bend.turned(x, y)
        return lens

    def _respond(self, source: tuple[float, float], pixel: tuple[int, int], workers: int | None) -> NDArray[np.float32]:
        scene, dx = self.scene, self._dx
        behind = self.lenslet_field(*source)
        energy_in = float((np.abs(behind) ** 2).sum()) * dx * dx
        spectrum = sf.fft2(behind, workers=workers or -1, overwrite_x=True)
        if self._separable:
            spectrum *= self._step[:, None]
            spectrum *= self._step[None, :]
        else:
            spectrum *= self._step
        if scene.accept[0]:
            power, from_y, from_x = scene.accept
            sines = scene.wavelength_um * sf.fftfreq(self._n, dx)
            spectrum *= pixel_response(power / 2, sines[:, None] + from_y, sines[None, :] + from_x)  # in amplitude
        light = np.abs(sf.ifft2(spectrum, workers=workers or -1, overwrite_x=True)) ** 2
        light *= dx * dx
        sides = []
        for axis, count in enumerate(scene.cutout):
            # the grid is centred on the source, the pixels on the cutout
            shift = (pixel[axis] * scene.pixel_um - source[axis]) / scene.scale / dx
            first = self._n // 2 + shift - (count // 2) * self.per_px
            sides.append(pixel_bins(self._n, self.per_px, count, first, scene.pixel_fill))
        image = sides[0] @ light @ sides[1].T * self.per_px**2
        energy_out = float(image.sum())
        self._certify(energy_in, energy_out)
        result: NDArray[np.float32] = image.astype(np.float32)
        return result

    def _certify(self, energy_in: float, energy_out: float) -> None:
        ratio = energy_out / energy_in if energy_in > 0 else 0.0
        if ratio > 1 + 1e-6:
            raise EnergyError.expected(
                "energy on the sensor",
                "at most the energy transmitted by the array",
                f"{ratio:.3g} times as much",
                f"choose a smaller tolerance, or in Python set samples_per_px above {self.per_px}",
            )
        self._ledger.add(1, energy_in, energy_out, ratio)
