"""The coherent Debye path: a microscope's field on the sensor, for all lenslets together.

For square lenslets that fill the plane, along the pixel rows, array and propagation act on rows and columns
separately. One step from the radial field on the array to the field at the sensor's nodes is then two small
matrices,

    V = A_y U A_x^T,   A = (propagation) (lenslets' phase) (interpolation),

The cost of accuracy arises once per lattice phase, not per position: U needs only the samples of its band, and its
symmetry halves each matrix. The light is limited in angle and in space, so that the rank of U is about half its size:
U = C R. The array is periodic, so that nodes at equal places behind their lenslets share a row of A, in all phases.
Pixels that little light reaches have half the nodes. Positions that are mirror images about a lenslet share their
response: for lenslets of 15 pixels, 36 of 225 remain. Other arrays use the coherent sum over lenslets in the wave
engine, with the same field.

The fields of a vectorial scene are even or odd in each of x and y, and so are the halved matrices of the axes. The
intensities of the fields add. Mirroring keeps the light of each field; transposing exchanges those of the same order.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import scipy.fft as sf
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, for_each_chunk, one_blas_thread
from lfcal.simulate._symmetry import AxisPhase, axis_phase, is_separable
from lfcal.simulate.engines._debye import debye_fields, radial_field
from lfcal.simulate.engines._fields_sum import wave_plane
from lfcal.simulate.engines._nodes import WindowNodes, fitted_rule
from lfcal.simulate.engines._separable import fold_rows, in_blocks, pixel_sums, product
from lfcal.simulate.engines.base import Certificate, EnergyError, Ledger, Pilot, PlaneEngine, Sampling
from lfcal.simulate.engines.masks import taper
from lfcal.simulate.scene import Scene

__all__ = ["MOST_ROWS", "DebyePlane", "debye_plane", "highest_order", "is_separable", "reach_um"]

MARGIN_PER_NODE = 10
"""Window margin of the sum over lenslets: pixels for each node per pixel, so that both are refined together.

Where lenslets touch, the truncated light would have cancelled: two nodes miss 2.5 % of a response, three 0.8 %.
"""
BEYOND = 0.5
"""Width of a rim around the lenslets whose rays reach the cutout, in lenslets for each node per pixel above one.
Lenslet edges scatter light from there into the cutout. If the cutout receives little other light, a rim of half a
lenslet leaves an error of 0.35 %, and one of one and a half lenslets 0.04 %.
"""
SPARE_ORDERS, SPARE_SHARE = 20, 3
"""Additional diffraction orders of the array, beyond those in its geometric cone, for each node per pixel above one.

The first number is the minimum, and the second is a multiple of the orders in the cone. Where lenslets meet, their
phase has a kink. Near it, the sum of n orders has an error of 0.6 N/n, with N orders in the cone. With N = 18 (f/7) and
20 additional orders, the light of an image on a corner is 1.5 % too large; with 54 additional orders, 1e-4. The kinks
also scatter light far from the image. In a cutout of 151 pixels, 20 additional orders miss 0.2 % of the light of an
image on a corner, and 60 miss 0.02 %.
"""
MOST_SPARE = 4
"""Largest multiple of the spare orders; more orders have no effect."""
CACHED = 256
"""Largest number of matrices and responses that are kept for reuse."""
DEBYE_CACHE_BYTES = 1 << 29
"""Largest total size of the kept matrices, and of the kept responses (bytes)."""

LEFT_OUT = 1e-5
"""Fraction of the norm of a field that its factors may omit."""
FAINT_LIGHT = 5e-3
"""Fraction of the light that may fall outside the pixels with all nodes, along each axis.

Pixels farther out have half the nodes. With one node instead of two, a fifth of the light there is misplaced. The
error of a response grows by about 0.1 % at most, because lenslets carry only part of the light as far as assumed.
"""
GRAINS = 1e6
"""Number of grains in a step of the coarse grid. Nodes whose positions differ by less than a grain are equal."""
MOST_ROWS = 4096
"""Largest number of rows of matrices that are kept for reuse."""

T = TypeVar("T", bound="Matrix | tuple[Matrix, ...]")
Matrix = NDArray[np.float32]
Pair = tuple[AxisPhase, AxisPhase]
RowName = tuple[float, int, int]  # pitch, reach, and place of a node behind its lenslet and on the coarse grid


@dataclass(frozen=True, slots=True)
class Turn:
    """Symmetry operations that derive a response from another: a swap of the axes, then flips along y and x."""

    flip_y: bool
    flip_x: bool
    swapped: bool

    def applied(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return a view of ``image``, shape ``(rows, columns)``, after these operations."""
        own = image.T if self.swapped else image
        return own[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1]


def debye_plane(scene: Scene, sampling: Sampling | None = None) -> PlaneEngine:
    """Return the engine of level ``"debye"``: `DebyePlane` if `is_separable`, else a wave engine with the Debye field.

    Raises
    ------
    InputError
        If the rays have exact angles.
    """
    chosen = sampling or Sampling()
    if is_separable(scene):
        return DebyePlane(scene, chosen)
    if scene.exact_rays:
        raise InputError.expected(
            "effect 'non-paraxial angles'",
            "a plane whose light fits into one grid, or the level reference",
            "a plane with a wider field",
            "choose the level reference (--level reference), or switch the effect off (--effect exact_angles=off)",
        )
    margin = max(chosen.margin_px, MARGIN_PER_NODE * chosen.nodes_per_px)
    return wave_plane(scene, replace(chosen, margin_px=margin))


def reach_um(scene: Scene, sampling: Sampling) -> tuple[float, float]:
    """Return the distance from the source's image up to which light on the array is computed (µm).

    The second result is the width of the fade-out at the end of this distance (µm).
    """
    pitch = max(scene.lattice.pitch_um, scene.lattice.row_step_um)
    # how far light of cone and lenslets travels sideways over the gap: lenslets outside the cutout may contribute
    spill = 1.1 * (1 / (2 * scene.f_number) * scene.gap_um + scene.lattice.pitch_um / 2)
    beyond = BEYOND * max(1, sampling.nodes_per_px - 1) * pitch
    half = max(scene.cutout) / 2 * scene.pixel_um + scene.farthest_um + spill + beyond
    return half, max(pitch / 2, min(pitch, beyond / 2))


def _parts(value: NDArray[np.inexact]) -> Matrix:
    """Return real part, imaginary part and their sum, stacked; negligible values are set to 0.

    A hundred denormal numbers in a matrix make its products three times slower.
    """
    parts = np.stack([value.real, value.imag, value.real + value.imag])
    parts[np.abs(parts) < 1e-12 * np.abs(parts).max(initial=0.0)] = 0
    return np.ascontiguousarray(parts, np.float32)


def _factors(field: NDArray[np.complex128]) -> tuple[Matrix, Matrix]:
    """Return the parts of C (n, rank) and of R^T (n, rank), where C R is ``field`` (n, n) up to `LEFT_OUT`."""
    with one_blas_thread():
        columns, rows, order = scipy.linalg.qr(field, mode="economic", pivoting=True, check_finite=False)
    beyond = np.sqrt(np.cumsum((np.abs(rows) ** 2).sum(axis=1)[::-1])[::-1])
    rank = max(1, int(np.count_nonzero(beyond > LEFT_OUT * beyond[0])))
    turned = np.empty((order.size, rank), np.complex128)
    turned[order] = rows[:rank].T
    return _parts(np.asarray(columns[:, :rank], np.complex128)), _parts(turned)


def highest_order(turns: float, nodes_per_px: int) -> int:
    """Return the highest diffraction order that is computed for lenslets with p^2/(lambda f) = ``turns``.

    Here p is the lenslet pitch, lambda the wavelength, and f the focal length. Orders up to half of ``turns`` are
    within the lenslet's cone. The number of orders beyond it increases with ``nodes_per_px``.
    """
    cone = math.ceil(turns / 2)
    return cone + max(SPARE_ORDERS, SPARE_SHARE * cone) * min(max(1, nodes_per_px - 1), MOST_SPARE)


def _lens_orders(scene: Scene, pitch: float, nodes_per_px: int) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
    """Return the orders m and coefficients t_m of the lenslets' periodic phase exp(-i pi x^2 / (lambda f))."""
    rate = 1 / (scene.wavelength_um * scene.lattice.types[0].focal_length_um)
    most = highest_order(pitch**2 * rate, nodes_per_px)
    count = int(sf.next_fast_len(64 * most))  # 64 samples for each cycle of the highest order keep aliases far away
    x = (np.arange(count) / count - 0.5) * pitch
    m = np.arange(-most, most + 1)
    return m, sf.fft(sf.ifftshift(np.exp(-1j * np.pi * rate * x * x)))[m] / count


def _powers(turns: NDArray[np.complex128], most: int) -> NDArray[np.complex128]:
    """Return powers -most ... most ``(2 most + 1, n)`` of numbers of modulus 1."""
    powers = np.ones((2 * most + 1, turns.size), np.complex128)
    powers[most + 1 :] = np.cumprod(np.broadcast_to(turns, (most, turns.size)), axis=0)
    powers[:most] = powers[:most:-1].conj()
    return powers


class DebyePlane:
    """Engine of level ``"debye"`` for contiguous square lenslets along the pixel rows (see `is_separable`).

    ``sampling.nodes_per_px`` sets the nodes on the sensor; the band of the field sets the samples on the array.
    """

    level = "debye"

    def __init__(self, scene: Scene, sampling: Sampling | None = None) -> None:
        self.scene = scene
        self.sampling = sampling or Sampling()
        self._ledger = Ledger()
        self._pilot = Pilot()
        self._lock = threading.Lock()
        self._matrices: dict[AxisPhase, Matrix] = {}
        self._lefts: dict[AxisPhase, tuple[Matrix, ...]] = {}
        self._rights: dict[AxisPhase, tuple[Matrix, ...]] = {}
        self._axes: dict[tuple[int, int], tuple[WindowNodes, NDArray[np.int64], Matrix]] = {}
        self._lenses: dict[float, tuple[NDArray[np.int64], NDArray[np.complex128]]] = {}
        self._rows: dict[RowName, NDArray[np.complex64]] = {}
        self._responses: dict[Pair, NDArray[np.float32]] = {}
        px, lam = scene.pixel_um, scene.wavelength_um
        light, bend = 1 / (2 * lam * scene.f_number), scene.lattice.pitch_um / (2 * lam * scene.gap_um)
        band = 2 * (light + bend) * px
        self.rule = fitted_rule(self.sampling.nodes_per_px, band, scene.pixel_fill)
        self._faint_rule = fitted_rule(math.ceil(self.sampling.nodes_per_px / 2), band, scene.pixel_fill)
        self._samples = math.ceil(2.4 * light * px)  # the field's band, with a fifth to spare
        self._coarse = px / self._samples
        self._half, fade = reach_um(scene, self.sampling)
        self._count = math.ceil(self._half / self._coarse) + 1
        self._fields = debye_fields(scene)
        self._quarters, self._energy, self._lit = self._tables(fade)

    # -- tables ------------------------------------------------------------------------------------------
    def _tables(self, fade: float) -> tuple[list[tuple[Matrix, Matrix]], float, float]:
        """Return each field on the coarse quarter grid (see `_factors`), their energy, and `_reach`."""
        x = np.arange(self._count, dtype=np.float64) * self._coarse
        down, across = np.tril_indices(self._count)
        r = np.hypot(x[across], x[down])
        edge = taper(x, self._half - fade, self._half)  # a hard edge would cause ripples over the whole sensor
        weight = np.where(x == 0, 1.0, 2.0)
        radial: dict[int, NDArray[np.complex128]] = {}
        for order in {field.order for field in self._fields}:
            whole = np.empty((x.size, x.size), np.complex128)
            whole[down, across] = radial_field(self.scene, float(r.max()), order)(r)
            whole[across, down] = whole[down, across]
            radial[order] = whole * edge[:, None] * edge[None, :]
        quarters, light = [], np.zeros(x.size)
        for one in self._fields:
            field = radial[one.order]
            if one.order:
                field = field * one.angular(x[None, :], x[:, None])
            light += (field.real**2 + field.imag**2) @ weight
            quarters.append(_factors(field))
        light *= weight * self._coarse**2
        return quarters, float(light.sum()), self._reach(light)

    def _reach(self, light: NDArray[np.float64]) -> float:
        """Return the distance from the source within which all light except `FAINT_LIGHT` reaches the sensor (µm).

        ``light`` is the light on the rows of the array.
        """
        scene = self.scene
        beyond = np.cumsum(light[::-1])[::-1]
        bright = int(np.count_nonzero(beyond > FAINT_LIGHT * beyond[0]))
        half = max(scene.lattice.pitch_um, scene.lattice.row_step_um) / 2
        slope = 1 / (2 * scene.f_number) + half / abs(scene.lattice.types[0].focal_length_um)
        return bright * self._coarse + 1.1 * slope * scene.gap_um  # lenslets and cone carry light sideways

    def _nodes(self, phase: AxisPhase) -> tuple[WindowNodes, NDArray[np.int64], Matrix]:
        """Return the nodes of a phase, and the pixels and weights of each; see `WindowNodes.pixels`."""
        _, shift, _, pixels = phase
        middle = min(pixels, 2 * math.ceil((self._lit + abs(shift)) / self.scene.pixel_um) + 1)
        with self._lock:
            known = self._axes.get((pixels, middle))
        if known is None:
            nodes = WindowNodes.of(self.rule, self._faint_rule, pixels, middle)
            known = nodes, *nodes.pixels()
            with self._lock:
                self._axes[pixels, middle] = known
        return known

    def _matrix(self, phase: AxisPhase) -> Matrix:
        """Return the matrices A of a phase, ``(parities, 3, nodes, n)``, as real part, imaginary part and their sum.

        The first matrix is for even fields, the second for odd ones, if there are any. The array is periodic, so nodes
        at equal positions behind their lenslets have the same row. Each row is computed only once for all phases.
        """
        with self._lock:
            known = self._matrices.get(phase)
        if known is not None:
            return known
        from lfcal.simulate.engines._tile_llvm import DOWN

        place, shift, pitch, _ = phase
        px, dx = self.scene.pixel_um, self._coarse
        s = self._nodes(phase)[0].positions * px + shift
        steps = np.floor(s / dx + 1e-6).astype(np.int64)
        behind, aside = (s - place) % pitch, s - steps * dx
        places = np.rint(np.stack([behind, aside + dx]) * (GRAINS / dx)).astype(np.int64)
        keys = places[0] << 32 | places[1]
        _, first, row_of = np.unique(keys, return_index=True, return_inverse=True)
        reach = self._count + math.ceil(((max(self.scene.cutout) / 2 + 2) * px + abs(shift)) / dx)
        names = [(pitch, reach, key) for key in keys[first].tolist()]
        wide = self._wide(names, behind[first], aside[first])
        parities = 2 if any(any(field.odd) for field in self._fields) else 1
        # rows of zeros complete the last tile
        made = np.zeros((parities, 3, -(-s.size // DOWN) * DOWN, self._count), np.float32)
        fold_rows(wide, row_of, reach + steps, made)
        self._cache(self._matrices, phase, made)
        return made

    def _wide(
        self, names: list[RowName], behind: NDArray[np.float64], aside: NDArray[np.float64]
    ) -> NDArray[np.complex64]:
        """Return the rows of nodes; only rows that are not in the cache are computed. See `_responding`."""
        with self._lock:
            kept = {name: self._rows[name] for name in names if name in self._rows}
        missing = [i for i, name in enumerate(names) if name not in kept]
        if missing:
            rows = self._responding(behind[missing], aside[missing], *names[0][:2])
            new = {names[i]: row for i, row in zip(missing, rows, strict=True)}
            kept |= new
            with self._lock:
                if len(self._rows) + len(new) > MOST_ROWS:
                    self._rows.clear()
                self._rows |= new
        return np.stack([kept[name] for name in names])

    def _responding(
        self, behind: NDArray[np.float64], aside: NDArray[np.float64], pitch: float, reach: int
    ) -> NDArray[np.complex64]:
        """Return the fields ``(nodes, distances)`` of coarse samples at nodes, ``behind`` a lenslet's centre.

        Distances are ``aside`` plus up to ``reach`` steps of the coarse grid to either side. The lenslets' phase is
        periodic, sum_m t_m exp(2 pi i m (x - place)/p). Order m of a band-limited sample psi at x_k arrives as
        exp(-i pi L m^2/p^2 + 2 pi i m s/p) psi_L(s - x_k - L m/p), L = lambda B.
        """
        scene, dx = self.scene, self._coarse
        m, t = self._lens(pitch)
        band, spread = 1.04 / (2 * scene.wavelength_um * scene.f_number), scene.wavelength_um * scene.gap_um
        turn = t * np.exp(1j * np.pi * (2 * m * behind[:, None] / pitch - spread * (m / pitch) ** 2))
        top = 1 / dx - band
        size = int(sf.next_fast_len(2 * reach + 1 + math.ceil(2 * spread * (top + m.max() / pitch) / dx)))
        f = sf.fftfreq(2 * size, dx / 2)
        seen = np.flatnonzero(np.abs(f) < top)
        f = f[seen]
        moved = _powers(np.exp(-2j * np.pi * spread / pitch * f), m.size // 2)
        wave = taper(f, band, top) * np.exp(-1j * np.pi * (2 * f * reach * dx + spread * f * f))
        carried = (math.sqrt(scene.pixel_um) * moved * wave).astype(np.complex64)
        # nodes have few distances from the coarse grid
        _, first, which = np.unique(np.rint(aside * (GRAINS / dx)), return_index=True, return_inverse=True)
        moves = np.exp(2j * np.pi * aside[first, None] * f).astype(np.complex64)
        spectra = np.zeros((behind.size, 2 * size), np.complex64)
        with one_blas_thread():
            spectra[:, seen] = (turn.astype(np.complex64) @ carried) * moves[which]
        # every second number of a transform is that of the sum of both halves
        folded = spectra[:, :size] + spectra[:, size:]
        made: NDArray[np.complex64] = sf.ifft(folded, axis=1, overwrite_x=True)[:, : 2 * reach + 1]
        return made

    def _lens(self, pitch: float) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
        with self._lock:
            if pitch not in self._lenses:
                self._lenses[pitch] = _lens_orders(self.scene, pitch, self.sampling.nodes_per_px)
            return self._lenses[pitch]

    def _factor(self, phase: AxisPhase, axis: int) -> tuple[Matrix, ...]:
        """Return each field's factor on the nodes of a phase.

        Along y (axis 0) it is A C ``(3, nodes, rank)``, along x (A R^T)^T in blocks (see `in_blocks`).
        """
        store = (self._lefts, self._rights)[axis]
        with self._lock:
            known = store.get(phase)
        if known is not None:
            return known
        matrices = self._matrix(phase)
        made = tuple(
            product(matrices[int(field.odd[axis])], factors[axis])
            for field, factors in zip(self._fields, self._quarters, strict=True)
        )
        if axis == 1:
            from lfcal.simulate.engines._tile_llvm import ACROSS

            made = tuple(in_blocks(one, ACROSS) for one in made)
        self._cache(store, phase, made, CACHED // len(made))
        return made

    def _cache(self, store: dict[AxisPhase, T], key: AxisPhase, value: T, most: int = CACHED) -> None:
        with self._lock:
            size = sum(part.nbytes for part in value)
            if len(store) >= max(1, min(most, DEBYE_CACHE_BYTES // size)):
                store.clear()
            store[key] = value

    # -- responses ---------------------------------------------------------------------------------------
    @property
    def grid_side(self) -> int:
        """Number of samples along a side of the grid; see `PlaneEngine.grid_side`."""
        return 2 * self._count - 1

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

        places = [
            (r, c, *self._place(scene.source_um(int(y), int(x)), (int(y), int(x))))
            for r, y in enumerate(rows)
            for c, x in enumerate(columns)
        ]
        keys = sorted({place[2] for place in places})
        made: dict[Pair, NDArray[np.float32]] = {}

        def some(start: int, stop: int) -> None:
            for key in keys[start:stop]:
                made[key] = self._response(key)

        for_each_chunk(some, len(keys), workers)
        for r, c, key, turn in places:
            result[r, c] = turn.applied(made[key])
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        key, turn = self._place((y_um, x_um), self.scene.nearest_pixel(y_um, x_um))
        return np.array(turn.applied(self._response(key)))

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    def _place(self, source: tuple[float, float], pixel: tuple[int, int]) -> tuple[Pair, Turn]:
        """Return the key of a response, and the symmetry operations that derive the response of a source from it."""
        (y, flip_y), (x, flip_x) = (axis_phase(self.scene, axis, source[axis], pixel[axis]) for axis in (0, 1))
        swapped = x < y and y[2:] == x[2:]  # same pitch and cutout along both axes: the transpose can be used too
        return ((x, y) if swapped else (y, x)), Turn(flip_y, flip_x, swapped)

    def _response(self, key: Pair) -> NDArray[np.float32]:
        with self._lock:
            known = self._responses.get(key)
        if known is not None:
            return known
        made = self._compute(*key)
        with self._lock:
            if len(self._responses) >= CACHED:
                self._responses.clear()
            self._responses[key] = made
        return made

    def _compute(self, y: AxisPhase, x: AxisPhase) -> NDArray[np.float32]:
        from lfcal.simulate.engines._tile_llvm import row_light  # loads numba

        image = np.empty((y[3], x[3]), np.float32)
        lefts, rights = self._factor(y, 0), self._factor(x, 1)
        (_, pixels, weights), (across, _, _) = self._nodes(y), self._nodes(x)
        lines = np.zeros((y[3], across.positions.size), np.float32)
        for left, right in zip(lefts, rights, strict=True):
            row_light(left, right, pixels, weights, lines)
        pixel_sums(lines, across.runs, across.weights, image)
        energy_out = float(image.sum(dtype=np.float64))
        ratio = energy_out / self._energy
        if ratio > 1 + 5e-3:  # allows for the node rule's error
            remedy = f"choose the level wave (--level wave), or in Python set nodes_per_px above {self.rule.per_px}"
            raise EnergyError.expected(
                "energy on the sensor",
                "at most the energy that reaches the array",
                f"{ratio:.4g} times as much",
                remedy,
            )
        self._ledger.add(1, self._energy, energy_out, ratio)
        return image
