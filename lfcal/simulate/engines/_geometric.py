"""Level ``"geometric"``: rays only.

Each lenslet's part of the iris's shadow is drawn on the sensor with exact pixel areas.

A pupil point u (in radii of the disc f/(2 Nw)) sends its ray through X = X0 + a' u/(2 Nw) on the array and, by a
lenslet at c, to s = c + (1 - B'/f)(X - c) - B' u/(2 Nw). Two forms of this map avoid division by a' or sigma. Lenslets
smaller than the shadow are clipped by it and drawn; otherwise the pupil is clipped by the lenslet. Wavefront, iris
fringes and lenslet diffraction are not part of this level.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import for_each_chunk
from lfcal.simulate.engines._polygon import Points, area, half_planes, iris_outline, regular
from lfcal.simulate.engines._spots import LitLenslets, Shapes, SpotDrawing, canvas, draw_spots
from lfcal.simulate.engines.base import Certificate, Ledger, Pilot
from lfcal.simulate.engines.tables import aperture_outline
from lfcal.simulate.scene import Scene, pixel_response

__all__ = ["GeometricPlane", "lattice_passed"]

LEAST_SPOT_PX = 1e-3
"""Smallest radius of a spot; a lenslet exactly in focus is drawn with this size."""
CIRCLE = 48
"""Number of sides of the polygon with equal area that represents a round lenslet."""


def _outlines(scene: Scene) -> tuple[Points, Points]:
    """Return the outlines of a lenslet about its centre (µm), and of the pupil in radii of f/(2 Nw)."""
    lens: Points = aperture_outline(scene)
    if scene.round_lenslets:
        lens = regular(CIRCLE, math.pi / CIRCLE) * scene.clear_radius_um
    return lens, iris_outline(scene.iris)


def lattice_passed(scene: Scene) -> float | None:
    """Return the light that lenslets transmit to the sensor's pixels, as a fraction of that of a point's full cone.

    It is the mean over all positions of the point. The area in which a lenslet overlaps the pupil's shadow, integrated
    over all displacements, is the product of both areas. None if pixels respond differently to angles.
    """
    if scene.accept[0]:
        return None
    lens, pupil = _outlines(scene)
    a, b = scene.lattice.basis_um()
    cell = abs(float(a[0] * b[1] - a[1] * b[0]))
    return abs(area(lens)) / cell * abs(area(pupil)) / math.pi * scene.pixel_fill**2 if len(pupil) else 0.0


class GeometricPlane:
    """Engine of level ``"geometric"`` for one depth plane."""

    level = "geometric"

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._ledger = Ledger()
        self._pilot = Pilot()
        lens, pupil = _outlines(scene)
        gap, a, cone = scene.reduced_gap_um, scene.reduced_image_um, 1 / (2 * scene.f_number)
        # 1 - B'/f of each type: the part of sigma that is independent of the plane
        at_infinity = np.array([1.0 - scene.lens_curvature(k) for k in range(len(scene.lattice.types))])
        lens_is_smaller = float(np.abs(lens).max()) < abs(a) * cone
        self._lens_is_smaller, self._empty = lens_is_smaller, len(pupil) < 3
        if self._empty:
            return
        if lens_is_smaller:  # then |a'| is large, and may be divided by
            subject, window = lens, pupil * (a * cone)
            factor, sign, density = 1.0, 1.0, 1 / (math.pi * (a * cone) ** 2)
            pull, size = np.full(at_infinity.size, gap / a), at_infinity - gap / a
        else:  # the shadow is smaller, or a point at a' = 0: the pupil is drawn, because it always has a shape
            subject, window = pupil, lens
            factor, sign, density = a * cone, -1.0, 1 / math.pi
            pull, size = at_infinity, (at_infinity * a - gap) * cone
        normals, limits = half_planes(window)
        about, reach = (float(np.hypot(*p.T).max()) for p in (window, subject))
        far, inner = reach * abs(factor), float(limits.min())
        self._shapes = Shapes(np.ascontiguousarray(subject), normals, limits, factor, sign, far, inner, about)
        # the same radius on the sensor, in any unit of the subject
        least = LEAST_SPOT_PX * scene.reduced_pixel_um / reach
        self._drawing = SpotDrawing(scene.reduced_pixel_um, density * scene.pixel_fill**2, least)
        self._reach = about + far
        self._spread = pull, size

    @property
    def grid_side(self) -> int:
        """0, because rays are not on a grid."""
        return 0

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far; a spot counts only inside the cutout."""
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
                source = np.array([scene.source_um(int(rows[r]), int(x)) for x in columns])
                self._draw(source, np.stack([np.full(columns.size, rows[r]), columns], axis=1), result[r])

        for_each_chunk(some, rows.size, workers)
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        result = np.empty((1, *self.scene.cutout), np.float32)
        self._draw(np.array([[y_um, x_um]]), np.array([self.scene.nearest_pixel(y_um, x_um)]), result)
        cutout: NDArray[np.float32] = result[0]
        return cutout

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    def _draw(self, source_yx: NDArray[np.float64], pixel: NDArray[np.int64], out: NDArray[np.float32]) -> None:
        scene = self.scene
        out[...] = 0
        if self._empty:
            return
        source = np.ascontiguousarray(source_yx[:, ::-1]) / scene.scale
        lo, hi = source.min(0), source.max(0)
        middle, span = (lo + hi) / 2, (hi - lo) / 2 + self._visible_reach()
        centres, kinds = scene.lattice.lenslets_within(span[0], span[1], (middle[0], middle[1]))
        pull, size = self._spread
        moved, widened = scene.tilted(centres, kinds)
        lenslets = LitLenslets(centres, pull[kinds] + moved, size[kinds] + widened, scene.passed(centres))
        if not scene.accept[0]:
            target = canvas(out, self._shapes)
            self._ledger.add(*draw_spots(target, source, pixel, lenslets, self._shapes, self._drawing))
            return
        for k in range(len(source)):
            # for each lenslet, the ray through the middle of its lit part
            lands = centres - lenslets.pull[:, None] * (centres - source[k])
            slope = (lands - (centres if self._lens_is_smaller else source[k])) / scene.reduced_gap_um
            power, from_y, from_x = scene.accept
            seen = lenslets._replace(
                gain=lenslets.gain * pixel_response(power, slope[:, 1] + from_y, slope[:, 0] + from_x)
            )
            part = slice(k, k + 1)
            target = canvas(out[part], self._shapes)
            self._ledger.add(*draw_spots(target, source[part], pixel[part], seen, self._shapes, self._drawing))

    def _visible_reach(self) -> float:
        """Return the largest distance from the source at which a lenslet is lit and draws into the cutout (µm)."""
        scene = self.scene
        pull, size = self._spread
        rate = float(np.abs(1 - pull).min())
        spot = float(np.abs(size).max()) * float(np.hypot(*self._shapes.subject.T).max())
        shown = math.hypot(*scene.cutout) / 2 * scene.reduced_pixel_um + spot + scene.reduced_pixel_um
        shown += scene.farthest_um / scene.scale
        return min(self._reach, shown / max(rate, 1e-9))
