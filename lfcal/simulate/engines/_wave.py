"""Level ``"wave"``: the light of each lenslet by a zoomed Fourier transform of the main lens's tabulated field.

With c the lenslet's centre, X0 the source's image and L = lambda B', a lenslet's field on the sensor is

    V(s) = exp(i pi |s-c|^2 / L) / L * integral E(x + c - X0) m(x) exp(i pi sigma x^2 / L)
           exp(-2 pi i x.(s - c + (B'/a')(c - X0)) / L) dx,     sigma = 1 - B'/a' - B'/f

(E-mode; near the native plane E is the field U itself, sigma = 1 - B'/f, and the term in B'/a' is absent). All steep
phases have cancelled, so single precision suffices. Intensities of lenslets are added, or their fields (``coherent``)
if their spots overlap.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import for_each_chunk, raise_if_abandoned
from lfcal.simulate._symmetry import mirrored_rows
from lfcal.simulate.engines._kernels import LightTarget, Optics, respond
from lfcal.simulate.engines._lenslets import SPOT, LensletLight, LensletWindow, select, square_fields
from lfcal.simulate.engines._tails import Tail, tail_of
from lfcal.simulate.engines.base import Certificate, EnergyError, Ledger, Pilot, Sampling
from lfcal.simulate.engines.extent import SWITCH
from lfcal.simulate.engines.field import choose_mode
from lfcal.simulate.engines.tables import Array, LensTable, PlaneTables, bent, build_tables, serve, tail_px
from lfcal.simulate.scene import Scene, pixel_response

__all__ = ["WavePlane"]

TOLERANCE = 0.02
"""Fraction by which a response's energy may exceed its input before the sampling counts as too coarse."""

FAINT = 0.01
"""Fraction of the best-lit lenslet's energy that limits the absolute error of fainter lenslets."""
COHERENT_BATCH = 8
"""Number of positions whose node grids are in memory at the same time."""

PILOT_COLUMNS = 48
"""Positions of a row that are timed, so that work done once for each lenslet of a row has its usual share."""


class WavePlane:
    """Engine of level ``"wave"`` for one depth plane.

    Parameters
    ----------
    scene, sampling
        The scene to compute, and the sampling.
    mode
        Mode of propagation as in `lfcal.simulate.engines.field.FieldTable`. None: that of `choose_mode`.
    """

    level = "wave"

    def __init__(self, scene: Scene, sampling: Sampling | None = None, mode: str | None = None) -> None:
        self.scene = scene
        self.sampling = sampling or Sampling()
        self.mode = mode or choose_mode(scene)
        self.tables = build_tables(scene, self.sampling, self.mode)
        self._wider: PlaneTables | None = None
        wanted = self.sampling.coherent
        self.coherent = self._overlap() if wanted is None else wanted
        self._tails = () if self.coherent else self._tails_of(self.tables)
        self._dtype = np.dtype(np.float64 if self.sampling.double else np.float32)
        self._ledger = Ledger()
        self._pilot = Pilot(PILOT_COLUMNS)

    def _tails_of(self, tables: PlaneTables) -> tuple[Tail, ...]:
        return tuple(tail_of(self.scene, self.sampling, lens, kind) for kind, lens in enumerate(tables.kinds))

    def _overlap(self) -> bool:
        """Return whether spots of neighbouring lenslets overlap so much that their fields must be added."""
        if self.mode != "E" or self.scene.shadow_radius_um < 0.6 * self.scene.lattice.pitch_um:
            return True
        apart = abs(1 - self.tables.ratio) * self.scene.lattice.pitch_um
        return apart < 0.5 * max(lens.width for lens in self.tables.kinds) * self.scene.reduced_pixel_um

    def displaced(self, offsets_um: NDArray[np.float64]) -> WavePlane:
        """Return an engine of the same plane for displaced sources, which shares the tables if they extend far enough.

        ``offsets_um`` is as in `Displaceable.displaced`.
        """
        scene = replace(self.scene, offsets_um=offsets_um)
        other = copy(self)
        other.scene = scene
        # sources far outside their cutouts illuminate lenslets that are not in the tables
        if scene.farthest_um > self.scene.farthest_um and not serve(self.tables, scene, self.sampling, self.mode):
            if self._wider is None or not serve(self._wider, scene, self.sampling, self.mode):
                # twice as far, because the next source may be farther away
                farther = replace(scene, offsets_um=2 * offsets_um)
                self._wider = build_tables(farther, self.sampling, self.mode)
            other.tables = self._wider
        other._ledger = Ledger()
        other._pilot = Pilot(PILOT_COLUMNS)
        return other

    @property
    def grid_side(self) -> int:
        """Nodes on a side of the largest window of a lenslet."""
        return max(lens.width for lens in self.tables.kinds) * self.sampling.nodes_per_px

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

        # of rows that are mirror images about a row of lenslets, one is computed and then mirrored
        mirrored = mirrored_rows(scene, rows)
        computed = [r for r in range(rows.size) if r not in mirrored]

        def some(start: int, stop: int) -> None:
            for r in computed[start:stop]:
                raise_if_abandoned()
                source = np.array([scene.source_um(int(rows[r]), int(x)) for x in columns])
                pixel = np.stack([np.full(columns.size, rows[r]), columns], axis=1)
                self._respond(source, pixel, result[r])

        for_each_chunk(some, len(computed), workers)
        for r, twin in mirrored.items():
            result[r] = result[twin][:, ::-1]
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        result = np.empty((1, *self.scene.cutout), np.float32)
        pixel = np.array([self.scene.nearest_pixel(y_um, x_um)], np.int64)
        self._respond(np.array([[y_um, x_um]]), pixel, result)
        cutout: NDArray[np.float32] = result[0]
        return cutout

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    # -- one row of positions ------------------------------------------------------------------------------
    def _respond(self, source_yx: NDArray[np.float64], pixel: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        """Fill ``out`` (n, nt, ns) for sources (n, 2) as (y, x) on the sensor; pixels are the cutouts' centres."""
        # to the reduced frame, where micro-images have the pitch of lenslets, and to the lattice's (x, y)
        source = np.ascontiguousarray(source_yx[:, ::-1]) / self.scene.scale
        image: Array = np.zeros(out.shape, np.float64) if self.sampling.double else out
        image[...] = 0
        batch = min(len(source), COHERENT_BATCH) if self.coherent else len(source)
        # squaring clears the grids, so that one target serves all batches
        target = self._target(image, batch if self.coherent else 0)
        for start in range(0, len(source), batch):
            part = slice(start, start + batch)
            self._add_lenses(source[part], pixel[part], target._replace(image=image[part]))
        if self.scene.accept[0] and not self._directed:
            self._undirected_gain(image, source, pixel)
        if image is not out:
            out[...] = image

    def _add_lenses(self, source: NDArray[np.float64], pixel: NDArray[np.int64], target: LightTarget) -> None:
        """Add the light behind every lenslet that one of the sources (n, 2), as (x, y), reaches."""
        lo, hi = source.min(0), source.max(0)
        middle, span = (lo + hi) / 2, (hi - lo) / 2 + self.tables.reach_um
        centres, types = self.scene.lattice.lenslets_within(span[0], span[1], (middle[0], middle[1]))
        optics = self.scene.passed(centres), *self.scene.tilted(centres, types)
        for centre, kind, passed, moved, widened in zip(centres, types, *optics, strict=True):
            if passed == 0:
                continue
            lens = self.tables.kinds[kind]
            if moved or widened or passed != 1:
                bend = math.pi * widened / self.tables.spread_um2
                lens = replace(lens, pull=lens.pull + moved, aperture=bent(lens.aperture, bend, math.sqrt(passed)))
            spots, far = self._add_lens(centre, lens, source, pixel, target, self.tables.ratio + moved)
            tail = self._tails[kind] if self._tails else None
            if tail and len(far):
                tail.add_far(far, passed, lens.width, target.image)
            if len(spots):
                beyond = tail.add(spots, lens.width, target.image) if tail else 0.0
                self._certify(spots, lens, tail.edge if tail else 1.0, beyond)
        if self.coherent:
            rule = self.tables.rule
            square_fields(*target[1:], rule.weights.astype(self._dtype), rule.per_px, target.image)

    def _target(self, image: Array, count: int) -> LightTarget:
        """Return the target of the light for ``image``, with empty node grids and boxes of ``count`` positions."""
        nt, ns = (self.tables.rule.count(n) for n in self.scene.cutout)
        boxes = np.tile(np.array([1 << 30, -(1 << 30)] * 2, np.int64), (count, 1))
        return LightTarget(image, np.zeros((count, nt, ns), self._dtype), np.zeros((count, nt, ns), self._dtype), boxes)

    def _add_lens(
        self,
        centre: NDArray[np.float64],
        lens: LensTable,
        source: NDArray[np.float64],
        pixel: NDArray[np.int64],
        target: LightTarget,
        ratio: float,
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Add the light behind the lenslet at ``centre`` (x, y) for sources (n, 2) as (x, y).

        ``ratio`` is B'/a', that of this lenslet if the array is tilted. Returns two `SPOT` arrays: the spots, and
        those whose windows miss the cutout.
        """
        scene, tables, dx = self.scene, self.tables, lens.field.dx_um
        spots = np.empty(len(source), SPOT)
        beyond = tail_px(self.sampling) if self._tails else 0
        window = LensletWindow(scene.reduced_pixel_um, ratio, lens.pull, lens.width, *scene.cutout, beyond)
        found, far = select(
            LensletLight(lens.energy, tables.floor, dx, lens.half), window, centre, source, pixel, spots
        )
        missed, spots = spots[len(source) - far :], spots[:found]
        if found:
            # positions with the same lenslet position between two samples share its mask
            spots = spots[np.argsort(np.round(spots["x0"] / dx, 6), kind="stable")]
            respond(lens.field, lens.aperture, lens.zoom, self._optics(lens), spots, target)
        return spots, missed

    def _optics(self, lens: LensTable) -> Optics:
        """Return the plane's values for a kernel; no exact rays near the native plane, where rays cross."""
        scene, tables = self.scene, self.tables
        share = (tables.spread_um2 / (lens.field.dx_um * scene.reduced_pixel_um)) ** 2
        flat = 1 / tables.spread_um2, share, 1 - tables.ratio
        none = np.ones(5)
        # near the native plane, rays cross and have no unique direction
        straight = scene.exact_rays and self.mode == "E"
        accept = scene.accept if self._directed else (0.0, 0.0, 0.0)
        if not straight and accept[0] == 0:
            return Optics(*flat, 0.0, 0.0, 0.0, 0.0, accept, none)
        gap, a = scene.reduced_gap_um, scene.reduced_image_um
        sigma = lens.aperture.bend * tables.spread_um2 / math.pi
        # 1/a' + 1/f = (1 - sigma)/B', by the definition of sigma; without the source's sphere 1/f
        bends = (1 - sigma) / gap + (0.0 if self.mode == "E" else 1 / a)
        if not straight:
            return Optics(*flat, 0.0, 1 / a, bends, gap, accept, none)
        # a plate needs t n G(s²/n²) instead of t/n G(s²), so n^(1 - 2k) t of the series' k-th term remains
        thick, index = scene.glass[0] / scene.scale, scene.glass[1]
        left = np.asarray(1 + thick / gap * (index ** (1.0 - 2 * np.arange(2, 7)) - 1 / index), np.float64)
        return Optics(*flat, 2 * math.pi * gap / scene.wavelength_um, 1 / a, bends, gap, accept, left)

    @property
    def _directed(self) -> bool:
        """Whether each point of a lenslet is lit from one direction, away from the native plane."""
        return self.mode == "E" or (self.mode == "D" and self.scene.fresnel_number >= SWITCH)

    def _undirected_gain(self, image: Array, source: NDArray[np.float64], pixel: NDArray[np.int64]) -> None:
        """Multiply by the pixels' angular response near the native plane, where one lenslet has the light.

        A ray of slope -u meets that lenslet at X0 + a' u, and the sensor at c + o (X0 - c) + (o a' - B') u, with o = 1
        - B'/f: a pixel thus corresponds to one u.
        """
        scene, px = self.scene, self.scene.reduced_pixel_um
        (power, *chief), gap, a = scene.accept, scene.reduced_gap_um, scene.reduced_image_um
        for k, x0 in enumerate(source):
            pitch = 2 * scene.lattice.pitch_um
            centres, kinds = scene.lattice.lenslets_within(pitch, pitch, (float(x0[0]), float(x0[1])))
            nearest = int(np.argmin(np.hypot(*(centres - x0).T)))
            at_infinity = 1.0 - scene.lens_curvature(int(kinds[nearest]))
            spread = at_infinity * a - gap
            slopes = []
            for axis, count in enumerate(scene.cutout):
                image_at, centre = x0[1 - axis], centres[nearest][1 - axis]
                at = (np.arange(count) - count // 2 + pixel[k, axis]) * px
                # in focus, one pixel receives all slopes: use their mean
                u = (at - centre - at_infinity * (image_at - centre)) / spread if abs(spread) > 0.3 * gap else 0 * at
                rim = 1.5 / (2 * scene.f_number)
                slopes.append((at - image_at - a * np.clip(u, -rim, rim)) / gap + chief[axis])
            image[k] *= pixel_response(power, slopes[0][:, None], slopes[1][None, :])

    def _certify(self, spots: NDArray[Any], lens: LensTable, edge: float, beyond: float) -> None:
        """Raise `EnergyError` if a window received more than its lenslet transmitted.

        A lenslet transmits ``edge`` times the light in its samples; ``beyond`` is the light outside the windows.
        """
        energy_in, energy_out = spots["energy_in"], spots["energy_out"]
        # relative errors behind a faint lenslet look large, but are negligible compared with the light of a bright one
        slack = TOLERANCE * np.maximum(energy_in, FAINT * float(lens.energy.max()))
        ratio = energy_out / np.maximum(energy_in, 1e-300)
        if (energy_out > energy_in + slack).any():
            used = self.scene.reduced_pixel_um / lens.field.dx_um
            finer = f"samples_per_px above {used:g} or nodes_per_px above {self.tables.rule.per_px}"
            remedy = f"choose a smaller tolerance, or in Python increase {finer}"
            wanted, got = (
                f"at most the transmitted energy (+{100 * TOLERANCE:.0f} %)",
                f"{float(ratio.max()):.3g} times that",
            )
            raise EnergyError.expected("energy behind a lenslet", wanted, got, remedy)
        bright = energy_in >= FAINT * float(lens.energy.max())
        worst = float(ratio[bright].max(initial=0.0))
        self._ledger.add(len(energy_in), edge * float(energy_in.sum()), float(energy_out.sum()) + beyond, worst)
