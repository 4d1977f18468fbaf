"""Responses of a plan's planes, and of depths near them, on the sensor; cached, and placed on an image."""

from __future__ import annotations

import threading
from collections import OrderedDict
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal.base import centre
from lfcal.camera import ScanPlan, half_extent_px
from lfcal.simulate.engines import Sampling
from lfcal.simulate.plane_task import Budget
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import origin_of

__all__ = ["DISPLACED_CACHED", "NEAR_PX", "Responses", "Window", "joined", "place", "sum_of"]

DISPLACED_CACHED = 8
"""Number of responses away from the planes that are kept in memory."""

NEAR_PX = 0.5
"""Change of the shadow's radius up to which the same sampling can be used."""

ROWS_CACHED = 4
"""Number of rows of responses that are kept in memory."""

Window = tuple[int, int, NDArray[np.float32]]
"""Window of light: row and column of its middle pixel on the sensor, and its values."""


class Responses:
    """Light on the sensor from sources in the planes of a plan and at depths near them.

    Parameters
    ----------
    plan
        The scan plan.
    budget
        Effects and tolerance.
    level, sampling
        As in `simulate_psf`.
    like
        Responses of another region of the field, whose sampling is reused without a probe. None: determine the
        sampling.
    """

    def __init__(
        self,
        plan: ScanPlan,
        budget: Budget,
        level: str,
        sampling: Sampling | None,
        *,
        like: Responses | None = None,
    ) -> None:
        self.plan, self.budget, self.level, self.sampling, self.like = plan, budget, level, sampling, like
        self.cached: dict[tuple[int, float], PlaneResponse] = {}
        self._probed: set[tuple[int, float]] = set()
        self._rows: OrderedDict[tuple[int, int], NDArray[np.float32]] = OrderedDict()
        self._lock = threading.RLock()

    def at(self, z: int, depth_error_um: float = 0.0) -> PlaneResponse:
        """Return the response for the depth that is ``depth_error_um`` (µm) farther from the camera than plane ``z``.

        Its cutout contains the geometric pattern and is at least as large as that of the plan.
        """
        with self._lock:
            key = (z, depth_error_um)
            if key not in self.cached:
                self._evict()
                reach = max(self._extent_px(z, dz) for dz in (0.0, depth_error_um))
                if self.plan.camera.has_lattice:  # the neighbours of the lenslets in the shadow are lit too
                    reach += 2 * self.plan.camera.pitch_px
                cutout = tuple(max(n, 2 * int(reach) + 1) for n in self.plan.cutout)
                effects, share = self.budget.at(self.plan.depths_um[z])
                made = PlaneResponse(
                    self.plan,
                    z,
                    effects,
                    level=self.level,
                    tolerance=share,
                    sampling=self.sampling,
                    cutout=(cutout[0], cutout[1]),
                    depth_error_um=depth_error_um,
                    on_sensor=True,
                )
                near = (self.like or self)._probed_near(z, depth_error_um)
                if near is None and self.like is not None:
                    near = self.like.at(z, depth_error_um)
                if near is None:
                    self._probed.add(key)
                else:
                    made.adopt(near)
                self.cached[key] = made
            return self.cached[key]

    def windows(self, z: int, depth_error_um: float, image_px: tuple[float, float]) -> list[Window]:
        """Return windows with the light of a source whose paraxial chief ray meets the sensor at ``image_px``.

        ``image_px`` is (row, column) in sensor pixels; the other arguments are as in `at`. The windows are as in
        `PlaneResponse.point`, but relative to sensor pixel (0, 0).
        """
        top, left = self.origin
        found = self.at(z, depth_error_um).point(image_px[0] - top, image_px[1] - left)
        return [(row + top, column + left, values) for row, column, values in found]

    def of_position(self, z: int, y: int, x: int) -> Window:
        """Return the window with the light of position (``y``, ``x``) of plane ``z`` without any displacement.

        The last few rows of positions are cached.
        """
        return y + self.origin[0], x + self.origin[1], self._row(z, y)[x]

    @cached_property
    def origin(self) -> tuple[int, int]:
        """The pixel (row, column) onto which position (0, 0) is imaged."""
        row, column, _, _ = origin_of(self.plan)
        return row, column

    # -- workings --------------------------------------------------------------------------------------
    def _extent_px(self, z: int, depth_error_um: float) -> float:
        return half_extent_px(self.plan.camera, self.plan.depths_um[z] + depth_error_um)

    def _probed_near(self, z: int, depth_error_um: float) -> PlaneResponse | None:
        """Return the nearest probed response whose light is sampled as finely; that of the plane itself comes first."""
        if depth_error_um:
            self.at(z)
        here = self._extent_px(z, depth_error_um)
        differences = {dz: abs(self._extent_px(z, dz) - here) for plane, dz in self._probed if plane == z}
        nearest = min(differences, key=differences.__getitem__, default=None)
        return self.cached[z, nearest] if nearest is not None and differences[nearest] < NEAR_PX else None

    def _evict(self) -> None:
        """Discard the oldest responses away from the planes, because a moving stage adds one at every step."""
        displaced = [key for key in self.cached if key[1]]
        for key in displaced[: max(0, len(displaced) - DISPLACED_CACHED + 1)]:
            del self.cached[key]
            self._probed.discard(key)

    def _row(self, z: int, y: int) -> NDArray[np.float32]:
        """Return the responses of one row of positions ``(nx, nt, ns)``."""
        with self._lock:
            if (z, y) in self._rows:
                self._rows.move_to_end((z, y))
                return self._rows[z, y]
        row: NDArray[np.float32] = self.at(z).rows([y], range(self.plan.period[1]), workers=1)[0]
        with self._lock:
            self._rows[z, y] = row
            while len(self._rows) > ROWS_CACHED:
                self._rows.popitem(last=False)
        return row


def joined(windows: list[Window]) -> Window:
    """Return the sum of windows as ``(row, column, values)``: first row, first column, and an image with all windows.

    Each of the given windows contains the row and column of its middle pixel instead, as in `PlaneResponse.point`.
    """
    rows, columns = [row for row, _, _ in windows], [column for _, column, _ in windows]
    nt, ns = windows[0][2].shape
    out = np.zeros((max(rows) - min(rows) + nt, max(columns) - min(columns) + ns), np.float32)
    for row, column, values in windows:
        place(out, values, row - min(rows) + centre(nt), column - min(columns) + centre(ns))
    return min(rows) - centre(nt), min(columns) - centre(ns), out


def sum_of(windows: list[Window]) -> NDArray[np.float32]:
    """Return the sum of windows at their positions, as the smallest image that contains them all."""
    return joined(windows)[2]


def place(out: NDArray[np.float32], values: NDArray[np.float32], row: int, column: int) -> None:
    """Add the window ``values``, centred on pixel ``(row, column)``, to ``out``; parts outside ``out`` are ignored."""
    top, left = row - centre(values.shape[0]), column - centre(values.shape[1])
    r0, c0 = max(0, top), max(0, left)
    r1, c1 = min(out.shape[0], top + values.shape[0]), min(out.shape[1], left + values.shape[1])
    if r0 < r1 and c0 < c1:
        out[r0:r1, c0:c1] += values[r0 - top : r1 - top, c0 - left : c1 - left]
