"""The coherent Debye path: a microscope's field, all lenslets at once, on the sensor.

For square lenslets that fill the plane, along the pixel rows, array and propagation act on rows and columns
separately. One step from the radial field on the array to the field at the sensor's nodes is then two small
matrices,

    V = A_y U A_x^T,   A = (propagation) (lenslets' phase) (interpolation),

whose accuracy is bought once per lattice phase, not per position: U needs only the samples of its own band, and
its symmetry halves each matrix. Positions that mirror each other about a lenslet share their response: 36 of 225
remain for lenslets of 15 pixels. Other arrays take the wave engine's coherent sum over lenslets, same field.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import scipy.fft as sf
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import expectation
from lfcal.simulate._separable import left_product, respond
from lfcal.simulate.debye import radial_field
from lfcal.simulate.engine import Certificate, EnergyError, Ledger, Pilot, PlaneEngine, Sampling
from lfcal.simulate.masks import taper
from lfcal.simulate.nodes import fitted_rule
from lfcal.simulate.scene import Scene
from lfcal.simulate.wave import WavePlane
from lfcal.threads import for_each_chunk

__all__ = ["DebyePlane", "debye_plane", "is_separable"]

LEAST_MARGIN = 20
"""Window margin (px) of the sum over lenslets that abut: what is cut off would have cancelled."""
FINE = 12
"""Samples per pixel, at least, at which the lenslets' phase is represented."""
KEPT = 256
"""Matrices and responses held for reuse."""

Matrix = NDArray[np.float32]
Phase = tuple[float, float, float, int]


def is_separable(scene: Scene) -> bool:
    """Return whether the array acts on rows and columns separately."""
    lattice = scene.lattice
    square = lattice.kind == "square" and scene.aperture == "cell" and lattice.rotation_rad == 0
    return square and math.isinf(scene.pupil_um) and len(lattice.types) == 1


def debye_plane(scene: Scene, sampling: Sampling | None = None) -> PlaneEngine:
    """Return the engine of level ``"debye"``: `DebyePlane`, or for other arrays the wave engine with this field."""
    chosen = sampling or Sampling()
    if is_separable(scene):
        return DebyePlane(scene, chosen)
    if scene.aperture == "cell":
        chosen = replace(chosen, margin_px=max(chosen.margin_px, LEAST_MARGIN))
    return WavePlane(scene, chosen, mode="D")


class DebyePlane:
    """Engine of level ``"debye"`` for square lenslets along the pixel rows.

    ``sampling.nodes_per_px`` sets the nodes on the sensor; the samples on the array follow from the field's band.
    """

    level = "debye"

    def __init__(self, scene: Scene, sampling: Sampling | None = None) -> None:
        self.scene = scene
        self.sampling = sampling or Sampling()
        self._ledger = Ledger()
        self._pilot = Pilot(self)
        self._lock = threading.Lock()
        self._matrices: dict[Phase, NDArray[np.float32]] = {}
        self._lefts: dict[Phase, NDArray[np.float32]] = {}
        self._responses: dict[tuple[Phase, Phase], NDArray[np.float32]] = {}
        px, lam = scene.pixel_um, scene.wavelength_um
        light, bend = 1 / (2 * lam * scene.f_number), scene.lattice.pitch_um / (2 * lam * scene.gap_um)
        self.rule = fitted_rule(self.sampling.nodes_per_px, 2 * (light + bend) * px, scene.pixel_fill)
        self._coarse = px / math.ceil(2.5 * light * px)  # the field's band, with a fifth to spare
        pitch = max(scene.lattice.pitch_um, scene.lattice.row_step_um)
        half = max(scene.cutout) / 2 * px + 2.5 * pitch
        self._half, self._fade = half, pitch
        per = 2 * self.rule.per_px
        self._fine = px / (per * math.ceil(FINE / per))
        self._count = int(sf.next_fast_len(2 * math.ceil((half + pitch) / self._fine)))
        self._basis = self._interpolation(light)
        self._field, self._energy = self._quarter()
        self._step = np.exp(-1j * np.pi * lam * scene.gap_um * sf.fftfreq(self._count, self._fine) ** 2)

    # -- tables ------------------------------------------------------------------------------------------
    def _interpolation(self, band: float) -> NDArray[np.float64]:
        """Return ``(n, count)``: the fine samples that each coarse sample and its mirror image stand for."""
        n = math.ceil(self._half / self._coarse) + 1
        f = sf.rfftfreq(self._count, self._fine)
        kernel = taper(f, 1.05 * band, 1 / self._coarse - 1.05 * band) * (self._coarse / self._fine)
        spectra = kernel * 2 * np.cos(2 * np.pi * np.outer(np.arange(n) * self._coarse, f))
        spectra[0] /= 2
        basis: NDArray[np.float64] = sf.fftshift(sf.irfft(spectra, self._count, axis=1), axes=1)
        return basis

    def _quarter(self) -> tuple[Matrix, float]:
        """Return the field on the coarse quarter grid, parts first, and the energy on the whole grid."""
        x = np.arange(self._basis.shape[0]) * self._coarse
        r = np.hypot(x[None, :], x[:, None])
        edge = taper(x, self._half - self._fade, self._half)
        field = radial_field(self.scene, float(r.max()))(r) * edge[:, None] * edge[None, :]
        weight = np.where(x == 0, 1.0, 2.0)
        energy = float(weight @ np.abs(field) ** 2 @ weight) * self._coarse**2
        return np.stack([field.real, field.imag]).astype(np.float32), energy

    def _matrix(self, phase: Phase) -> Matrix:
        """Return A ``(2, nodes, n)``: a lenslet at ``place`` from the source, nodes moved by ``shift``."""
        with self._lock:
            known = self._matrices.get(phase)
        if known is not None:
            return known
        place, shift, pitch, pixels = phase
        scene, lam = self.scene, self.scene.wavelength_um
        x = (np.arange(self._count) - self._count // 2) * self._fine
        local = np.mod(x - place + pitch / 2, pitch) - pitch / 2
        lens = np.exp(-1j * np.pi / (lam * scene.lattice.types[0].focal_length_um) * local**2)
        f = sf.fftfreq(self._count, self._fine)
        carried = (self._step * np.exp(2j * np.pi * f * shift)).astype(np.complex64)
        behind = sf.fft((lens * self._basis).astype(np.complex64), axis=1, overwrite_x=True)
        behind *= carried
        field = sf.ifft(behind, axis=1, overwrite_x=True)
        index = self._count // 2 + np.rint(self.rule.positions(pixels) * scene.pixel_um / self._fine).astype(int)
        seen = field[:, index].T * math.sqrt(scene.pixel_um)
        made = np.ascontiguousarray(np.stack([seen.real, seen.imag]), np.float32)
        self._keep(self._matrices, phase, made)
        return made

    def _left(self, phase: Phase) -> Matrix:
        """Return (A U)^T ``(2, n, nodes)`` of a row phase."""
        with self._lock:
            known = self._lefts.get(phase)
        if known is not None:
            return known
        a = self._matrix(phase)
        made = np.empty((2, a.shape[2], a.shape[1]), np.float32)
        left_product(a, self._field, made)
        self._keep(self._lefts, phase, made)
        return made

    def _keep(self, store: dict[Phase, Matrix], key: Phase, value: Matrix) -> None:
        with self._lock:
            if len(store) >= KEPT:
                store.clear()
            store[key] = value

    # -- responses ---------------------------------------------------------------------------------------
    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far."""
        return self._ledger.certificate

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the cutouts of positions ys x xs; see `PlaneEngine.rows`."""
        scene = self.scene
        rows, columns = np.atleast_1d(np.asarray(ys, np.int64)), np.atleast_1d(np.asarray(xs, np.int64))
        result = np.empty((rows.size, columns.size, *scene.cutout), np.float32) if out is None else out

        def some(start: int, stop: int) -> None:
            for r in range(start, stop):
                for c, x in enumerate(columns):
                    y = int(rows[r])
                    result[r, c] = self._respond(scene.source_um(y, int(x)), (y, int(x)))

        for_each_chunk(some, rows.size, workers)
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout about the pixel nearest to a chief ray; see `PlaneEngine.point`."""
        return np.array(self._respond((y_um, x_um), self.scene.nearest_pixel(y_um, x_um)))

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the CPU-seconds of ``n_positions`` of a whole period; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(n_positions)

    def _phase(self, axis: int, source: float, pixel: int) -> tuple[Phase, bool]:
        """Return the key of a source coordinate's matrix, and whether the response is its mirror image."""
        lattice = self.scene.lattice
        pitch = (lattice.row_step_um, lattice.pitch_um)[axis]
        place = (lattice.offset_um[1 - axis] - source) % pitch
        shift = pixel * self.scene.pixel_um - source
        grain = self.scene.pixel_um * 1e-9
        mirrored = (pitch - place) % pitch
        flip = (round(mirrored / grain), round(-shift / grain)) < (round(place / grain), round(shift / grain))
        if flip:
            place, shift = mirrored, -shift
        return (round(place / grain) * grain, round(shift / grain) * grain, pitch, self.scene.cutout[axis]), flip

    def _respond(self, source: tuple[float, float], pixel: tuple[int, int]) -> NDArray[np.float32]:
        (y, flip_y), (x, flip_x) = (self._phase(axis, source[axis], pixel[axis]) for axis in (0, 1))
        turned = x < y and y[2:] == x[2:]
        key = (x, y) if turned else (y, x)
        with self._lock:
            made = self._responses.get(key)
        if made is None:
            made = self._compute(*key)
            with self._lock:
                if len(self._responses) >= KEPT:
                    self._responses.clear()
                self._responses[key] = made
        image = made.T if turned else made
        return image[:: -1 if flip_y else 1, :: -1 if flip_x else 1]

    def _compute(self, y: Phase, x: Phase) -> NDArray[np.float32]:
        image = np.empty((y[3], x[3]), np.float32)
        weights = self.rule.weights.astype(np.float32)
        respond(self._left(y), self._matrix(x), weights, weights, self.rule.per_px, image)
        energy_out = float(image.sum(dtype=np.float64))
        ratio = energy_out / self._energy
        if ratio > 1 + 1e-3:
            remedy = f"raise nodes_per_px above {self.rule.per_px}"
            raise EnergyError(
                expectation("energy on the sensor", "at most what reached the array", f"{ratio:.4g} times that", remedy)
            )
        self._ledger.add(1, self._energy, energy_out, ratio)
        return image
