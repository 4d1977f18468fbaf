"""Waves through lenslets in a pupil plane: the engine of a Fourier light-field microscope.

Behind a lenslet at c with focal length f and aperture A, on a sensor B away, the paraxial (Fresnel) field is

    E(x) = 1/(lambda B) exp(i k |x - c|²/2B) ∫ A(v) U(c + v) exp(i k |v|²/2 (1/B - 1/f)) exp(-i k v.(x - c)/B) dv,

with U of `PupilScene`. The integral is a Fourier transform, evaluated as two matrix products in a window about the
lenslet's geometric spot. Where windows overlap, fields are added before squaring. Pixels are integrated by
Gauss-Legendre nodes. What falls outside a window of half width m lambda B/d is about 0.2/m of a spot, for round and for
square apertures of width d alike. Wider windows reduce this error and take more time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import centre, raise_if_abandoned
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate.engines._quadrature import gauss_legendre
from lfcal.simulate.engines.base import Certificate, EnergyError, Ledger, Sampling

__all__ = ["PUPIL_LEVELS", "PupilPlane", "pupil_bytes", "pupil_cost", "pupil_error", "pupil_passed"]

PUPIL_LEVELS = ("wave", "reference")
"""Levels of this engine: windows about the spots, or the whole cutout behind every lenslet."""

OUTSIDE = 0.27
"""L1 error of a spot in a window of half width m lambda B/d, times m. The fraction 0.2 of its light is outside (2/pi²
for a square aperture), and interferes with the other lenslets' spots."""

PERIODS = 1.5
"""Ratio of the distance of a spot's aliases to the width of its window, so that no alias reaches into it."""

FEWEST, ROWS_PER_SAMPLE = 48, 8
"""Smallest number of samples over a lenslet; rows per sample for computing its area within the aperture."""

FINER, IN_STEPS_OF = 2.5, 16
"""For a fixed box: factor on the number of samples over a lenslet. The number is a multiple of the second value, so
that small changes of the camera do not change it."""

BLOCK_NODES = 1 << 22
"""Nodes on the sensor whose field is in memory at a time (complex64)."""

SPARE_ENERGY = 0.01
"""Fraction by which the light of a response may exceed its input, due to the integration over pixels."""

F8 = NDArray[np.float64]
Complex = NDArray[Any]

Box = tuple[slice, slice]
"""Rows and columns of the cutout."""


@dataclass(frozen=True)
class _Behind:
    """The light of one lenslet: window of pixels, and the transform along x of what the lenslet passes."""

    rows: slice
    columns: slice
    along_y: Complex
    half_done: Complex


def _covered(y: F8, x: F8, step: float, radius: float) -> F8:
    """Return the fraction of square samples ``(len(y), len(x))`` within a disc about 0."""
    fine = (np.arange(ROWS_PER_SAMPLE) + 0.5) / ROWS_PER_SAMPLE - 0.5
    rows = y[:, None] + fine * step
    half = np.sqrt(np.maximum(radius**2 - rows**2, 0.0))[..., None]
    inside = np.minimum(x + step / 2, half) - np.maximum(x - step / 2, -half)
    share: F8 = (np.clip(inside, 0.0, step) / step).mean(1)
    return share


def _within(scene: PupilScene, at: tuple[float, float], v: F8, step: float) -> F8:
    """Return the fraction of each sample of a lenslet at (y, x) that is within its aperture and the pupil."""
    size = scene.lenslets.clear_um
    if scene.lenslets.aperture == "round":
        own = _covered(v, v, step, size / 2)
    else:
        edge = np.clip((size / 2 + step / 2 - np.abs(v)) / step, 0.0, 1.0)
        own = edge[:, None] * edge
    if math.hypot(*at) + size / math.sqrt(2) < scene.pupil_radius_um:
        return own
    return own * _covered(at[0] + v, at[1] + v, step, scene.pupil_radius_um)


def _blur_um(scene: PupilScene, focal: float) -> float:
    """Return the half width of a lenslet's spot by rays, 20 % more than paraxially."""
    lenslets = scene.lenslets
    spread = lenslets.spread(scene.objective, scene.z_um)
    return 1.2 * lenslets.clear_um / 2 * (abs(1 - lenslets.gap_um / focal) + abs(spread))


def _half_um(scene: PupilScene, sampling: Sampling, focal: float, *, whole: bool) -> float:
    """Return the half width of a lenslet's window on the sensor."""
    if whole:
        reach = np.abs(np.array(scene.lenslets.lens_centres_um)).max() + max(map(abs, scene.axis_um))
        return float(reach) + max(scene.cutout) * scene.pixel_um / 2 + _blur_um(scene, focal)
    return sampling.margin_px * scene.pixel_um + _blur_um(scene, focal)


def _samples(scene: PupilScene, half: float) -> int:
    """Return the samples over a lenslet for light within ``half`` of its spot (µm)."""
    spread = scene.wavelength_um * scene.lenslets.gap_um
    return max(FEWEST, math.ceil(scene.lenslets.clear_um * 2 * PERIODS * half / spread))


def _sizes(scene: PupilScene, sampling: Sampling, focal: float, *, whole: bool) -> tuple[int, int, int]:
    """Return the samples over a lenslet, and the nodes of its window in rows and columns."""
    half = _half_um(scene, sampling, focal, whole=whole)
    window = 2 * half / scene.pixel_um + 1
    rows, columns = (math.ceil(min(window, n)) * sampling.nodes_per_px for n in scene.cutout)
    return _samples(scene, half) + 2, rows, columns


def pupil_cost(scene: PupilScene, level: str, sampling: Sampling) -> float:
    """Return the number of complex multiply-adds of one response, including an equivalent for filling the matrices."""
    total = 0.0
    for focal in scene.lenslets.focal_um:
        n, rows, columns = _sizes(scene, sampling, float(focal), whole=level == "reference")
        total += n * n * columns + n * rows * columns + 60.0 * n * (2 * n + rows + columns)
    return total + 20.0 * math.prod(scene.cutout) * sampling.nodes_per_px**2


def pupil_bytes(scene: PupilScene, level: str, sampling: Sampling) -> int:
    """Return the estimated peak memory for computing one response (bytes)."""
    sizes = [_sizes(scene, sampling, float(focal), whole=level == "reference") for focal in scene.lenslets.focal_um]
    held = sum(8 * n * (rows + columns) for n, rows, columns in sizes)
    made = max(64 * n * n + 24 * n * (rows + columns) for n, rows, columns in sizes)
    return held + made + 16 * max(BLOCK_NODES, scene.cutout[1] * sampling.nodes_per_px**2) + 4 * math.prod(scene.cutout)


def pupil_passed(scene: PupilScene) -> float:
    """Return the light that the lenslets transmit to light-sensitive areas, as a fraction of that through the pupil."""
    count = 4 * FEWEST
    step = scene.lenslets.clear_um / (count - 2)
    v: F8 = np.asarray((np.arange(count) - (count - 1) / 2) * step, np.float64)
    total = 0.0
    for x, y in scene.lenslets.lens_centres_um:
        field = scene.field(y + v[:, None], x + v[None, :])
        total += float((_within(scene, (y, x), v, step) * np.abs(field) ** 2).sum()) * step**2
    return total * scene.pixel_fill**2


def pupil_error(scene: PupilScene, level: str, sampling: Sampling) -> float:
    """Return the expected relative L1 error of a response.

    It is due to light outside the windows, unless the level is ``"reference"``, and to the integration over pixels.
    """
    airy = scene.wavelength_um * scene.lenslets.gap_um / scene.lenslets.clear_um / scene.pixel_um
    outside = 0.0 if level == "reference" else OUTSIDE * airy / sampling.margin_px
    # error of n nodes for a fringe of half the highest frequency: a^2n (n!)^4 / ((2n + 1) ((2n)!)^3)
    n, a = sampling.nodes_per_px, math.pi / airy
    return outside + a ** (2 * n) * math.factorial(n) ** 4 / ((2 * n + 1) * math.factorial(2 * n) ** 3)


class PupilPlane:
    """Engine of one plane of a Fourier light-field microscope, with the level ``"wave"`` or ``"reference"``."""

    def __init__(self, scene: PupilScene, level: str, sampling: Sampling) -> None:
        self.scene, self.level, self.sampling = scene, level, sampling
        self._ledger = Ledger()
        nodes, self._weights = gauss_legendre(sampling.nodes_per_px, -0.5, 0.5)
        self._nodes = nodes * scene.pixel_fill * scene.pixel_um
        self._kind = np.complex128 if sampling.double else np.complex64

    @property
    def grid_side(self) -> int:
        """Always 0, because the size of a window differs between spots."""
        return 0

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far."""
        return self._ledger.certificate

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions, extrapolated from position (0, 0)."""
        start = time.thread_time()
        self.rows([0], [0])
        return n_positions * (time.thread_time() - start)

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the responses ``(len(ys), len(xs), nt, ns)`` of the positions in ``ys`` and ``xs`` (any integers).

        The responses are written to ``out``; None: to a new array. ``workers`` is ignored, because every response uses
        all processors.
        """
        del workers  # a response is a few large matrix products, which use all processors
        y, x = np.asarray(ys, np.intp), np.asarray(xs, np.intp)
        if out is None:
            out = np.empty((len(y), len(x), *self.scene.cutout), np.float32)
        for i, row in enumerate(y):
            for j, column in enumerate(x):
                out[i, j] = self._response((int(row), int(column)), self.scene.source_um(int(row), int(column)))
        return out

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout ``(nt, ns)`` for a chief ray that meets the sensor at the point (``y_um``, ``x_um``).

        The point (µm) is relative to the sensor point of source position (0, 0). The cutout is centred on the nearest
        pixel, see `PupilScene.nearest_pixel`.
        """
        return self._response(self.scene.nearest_pixel(y_um, x_um), (y_um, x_um))

    def light_in(self, box: Box, chief_um: tuple[float, float]) -> NDArray[np.float32]:
        """Return the light in part of the cutout of position (0, 0), for one chief ray.

        ``box`` contains the slices of rows and columns of this part. The chief ray meets the sensor at ``chief_um``,
        (y, x) relative to the sensor point of position (0, 0) (µm). The fields of all lenslets are computed in the
        whole box, at nodes that do not depend on the lenslets. The light is therefore a smooth function of every
        parameter of the camera, as a fit requires.
        """
        rows, columns = self._axes((0, 0))
        tilt = self._tilt(chief_um)
        field: Complex | None = None
        for place, focal in zip(
            self.scene.lenslets.lens_centres_um, self.scene.lenslets.focal_um.tolist(), strict=True
        ):
            raise_if_abandoned()
            _, behind = self._behind((place[1], place[0]), focal, tilt, rows, columns, box)
            if behind is not None:
                own = behind.along_y @ behind.half_done
                field = own if field is None else field + own
        shape = (box[0].stop - box[0].start, box[1].stop - box[1].start)
        if field is None:
            return np.zeros(shape, np.float32)
        light = self._on_pixels(field, *shape)
        return (light * (self.scene.pixel_um * self.scene.pixel_fill) ** 2).astype(np.float32)

    # -- one response ------------------------------------------------------------------------------------
    def _axes(self, pixel: tuple[int, int]) -> tuple[F8, F8]:
        """Return the centres of the rows and columns of the cutout about a pixel, from the optical axis (µm)."""
        scene = self.scene
        rows, columns = (
            np.asarray((np.arange(n) - centre(n) + k) * scene.pixel_um - axis, np.float64)
            for n, k, axis in zip(scene.cutout, pixel, scene.axis_um, strict=True)
        )
        return rows, columns

    def _tilt(self, chief: tuple[float, float]) -> tuple[float, float]:
        """Return the slope of a chief ray that meets the sensor at the point ``chief`` (y, x) (µm)."""
        (y, x), (ay, ax), gap = chief, self.scene.axis_um, self.scene.lenslets.gap_um
        return (y - ay) / gap, (x - ax) / gap

    def _response(self, pixel: tuple[int, int], chief: tuple[float, float]) -> NDArray[np.float32]:
        """Return the light of a chief ray, as it meets the sensor (µm), in the cutout about a pixel."""
        scene, (nt, ns) = self.scene, self.scene.cutout
        (rows, columns), tilt = self._axes(pixel), self._tilt(chief)
        passed, parts = 0.0, []
        for place, focal in zip(scene.lenslets.lens_centres_um, scene.lenslets.focal_um.tolist(), strict=True):
            raise_if_abandoned()
            light, behind = self._behind((place[1], place[0]), focal, tilt, rows, columns)
            passed += light
            parts += [behind] if behind is not None else []
        found = np.zeros((nt, ns), np.float32)
        for top, block in self._blocks(parts):
            found[top : top + len(block)] = block
        found *= np.float32((scene.pixel_um * scene.pixel_fill) ** 2)
        received = float(found.sum(dtype=np.float64)) / scene.pixel_fill**2
        self._ledger.add(1, passed, received, received / passed if passed else 0.0)
        if received > (1 + SPARE_ENERGY) * passed + 1e-9:
            raise EnergyError.expected(
                "simulated light", "no more light on the sensor than enters", "more", "use a smaller tolerance"
            )
        return found

    def _behind(
        self,
        at: tuple[float, float],
        focal: float,
        tilt: tuple[float, float],
        rows: F8,
        columns: F8,
        box: Box | None = None,
    ) -> tuple[float, _Behind | None]:
        """Return the light that a lenslet at (y, x) passes, and that light in its window or ``box``. None: no light."""
        scene, gap = self.scene, self.scene.lenslets.gap_um
        spot = [c + gap * (s + t) for c, s, t in zip(at, scene.slope(*at), tilt, strict=True)]
        if box is None:
            half = _half_um(scene, self.sampling, focal, whole=self.level == "reference")
            count = _samples(scene, half) + 2
            windows = self._windows(spot, half, rows, columns)
        else:
            windows = box
            ends = zip((rows, columns), box, spot, strict=True)
            half = max(float(abs(axis[k] - c)) for axis, w, c in ends for k in (w.start, w.stop - 1)) + scene.pixel_um
            count = math.ceil(_samples(scene, FINER * half) / IN_STEPS_OF) * IN_STEPS_OF + 2
        step = scene.lenslets.clear_um / (count - 2)
        v: F8 = np.asarray((np.arange(count) - (count - 1) / 2) * step, np.float64)
        within = _within(scene, at, v, step)
        y, x = at[0] + v[:, None], at[1] + v[None, :]
        k = 2 * np.pi / scene.wavelength_um
        bend = np.exp(0.5j * k * (1 / gap - 1 / focal) * v * v)
        field = scene.field(y, x)
        light = float((within * np.abs(field) ** 2).sum()) * step**2
        field *= (
            within * (bend * np.exp(1j * k * tilt[0] * y[:, 0]))[:, None] * (bend * np.exp(1j * k * tilt[1] * x[0]))
        )
        held = float((np.abs(field) ** 2).sum()) * step**2
        if not held or any(w.start >= w.stop for w in windows):
            return light, None
        field *= step**2 / (scene.wavelength_um * gap)
        if box is None:
            # samples cut by the edge pass their share of the light, not its square
            field *= math.sqrt(light / held)
        along_y, along_x = (
            self._transform(axis[w], c, v) for axis, w, c in zip((rows, columns), windows, at, strict=True)
        )
        return light, _Behind(windows[0], windows[1], along_y, field.astype(self._kind) @ along_x.T)

    def _windows(self, spot: Sequence[float], half: float, rows: F8, columns: F8) -> Box:
        """Return the rows and columns within ``half`` of a spot; at level reference all."""
        if self.level == "reference":
            return slice(0, len(rows)), slice(0, len(columns))
        return _part(rows, spot[0], half), _part(columns, spot[1], half)

    def _transform(self, pixels: F8, at: float, v: F8) -> Complex:
        """Return the kernel ``(nodes, n)`` of the Fresnel integral from samples of a lenslet to the nodes of pixels."""
        k, gap = 2 * np.pi / self.scene.wavelength_um, self.scene.lenslets.gap_um
        e = (pixels[:, None] + self._nodes).ravel() - at
        out: Complex = np.exp(1j * k / gap * (e * e / 2)[:, None] - 1j * k / gap * e[:, None] * v).astype(self._kind)
        return out

    def _blocks(self, parts: list[_Behind]) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield first row and light of blocks of pixel rows, fields of all lenslets summed."""
        (nt, ns), per = self.scene.cutout, self.sampling.nodes_per_px
        height = max(1, min(nt, BLOCK_NODES // (ns * per * per)))
        for top in range(0, nt, height):
            raise_if_abandoned()
            bottom = min(nt, top + height)
            field = np.zeros(((bottom - top) * per, ns * per), self._kind)
            for one in parts:
                first, last = max(top, one.rows.start), min(bottom, one.rows.stop)
                if first < last:
                    own = one.along_y[(first - one.rows.start) * per : (last - one.rows.start) * per]
                    columns = slice(one.columns.start * per, one.columns.stop * per)
                    field[(first - top) * per : (last - top) * per, columns] += own @ one.half_done
            yield top, self._on_pixels(field, bottom - top, ns)

    def _on_pixels(self, field: Complex, rows: int, columns: int) -> NDArray[np.float32]:
        """Return the mean light of each pixel ``(rows, columns)`` of a field at its nodes."""
        light, per = field.real**2 + field.imag**2, self.sampling.nodes_per_px
        w = self._weights.astype(light.dtype)
        found: NDArray[np.float32] = np.einsum(
            "aibj,i,j->ab", light.reshape(rows, per, columns, per), w, w, optimize=True
        )
        return found


def _part(axis: F8, middle: float, half: float) -> slice:
    """Return the pixels of an axis within ``half`` of ``middle``."""
    first, last = np.searchsorted(axis, (middle - half, middle + half))
    return slice(int(first), int(last))
