"""Scans whose positions run in another direction than their numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._modelled import correlation, plane_of
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FoundFault, PutIn
from lfcal.judge.faults.places import place_map

__all__ = ["FAULTS", "WrongOrder"]

F4 = NDArray[np.float32]

TRIED = 8
"""Number of patterns of a plane that are compared with mirrored positions."""

POOR = 0.75
"""Correlation above which patterns are in the right order."""

GOOD = 0.85
"""Smallest correlation of patterns in the right order."""

BETTER = 0.15
"""Smallest increase of the correlation by another order."""

LAGS = (1, 2, 3, 4, 5, 6, 8, 10)
"""Numbers of frames by which a scan may be late or early."""

Index = NDArray[np.intp]
Order = Callable[[Index], Index]
"""Takes positions ``(n, 3)``, and returns the positions whose patterns they contain."""


def _flipped(period: tuple[int, int], axes: tuple[int, ...]) -> Order:
    def order(index: Index) -> Index:
        other = index.copy()
        for axis in axes:
            other[:, axis] = period[axis - 1] - 1 - other[:, axis]
        return other

    return order


def _to_and_fro(period: tuple[int, int], axis: int) -> Order:
    """Return the order of a serpentine scan that is read as a raster scan, or the reverse: odd lines run back."""

    def order(index: Index) -> Index:
        other, along = index.copy(), 3 - axis
        back = index[:, axis] % 2 == 1
        other[back, along] = period[along - 1] - 1 - other[back, along]
        return other

    return order


def _late(period: tuple[int, int], by: int) -> Order:
    """Return the order of a serpentine scan whose patterns are late by a number of frames."""
    ny, nx = period

    def order(index: Index) -> Index:
        z, y, x = index.T
        when = (y * nx + np.where(y % 2, nx - 1 - x, x) - by) % (ny * nx)
        row, column = np.divmod(when, nx)
        return np.stack([z, row, np.where(row % 2, nx - 1 - column, column)], 1)

    return order


def _orders(period: tuple[int, int]) -> dict[str, Order]:
    found = {
        "rows of positions are reversed": _flipped(period, (1,)),
        "columns of positions are reversed": _flipped(period, (2,)),
        "rows and columns of positions are reversed": _flipped(period, (1, 2)),
    }
    for by in LAGS:
        frames = "1 frame" if by == 1 else f"{by} frames"
        found[f"all patterns are {frames} late"] = _late(period, by)
        found[f"all patterns are {frames} early"] = _late(period, -by)
    return found


class WrongOrder(Fault):
    """Planes with a reversed axis or reversed lines of positions, or with frames assigned to other positions."""

    name = "order"
    title = "patterns in the wrong order"
    subject = "frames"
    rank = 3
    needs_camera = False
    advice = (
        "Correct the axes of the scan, or leave out the first frames. Then assemble H again. No new "
        "recording is needed."
    )
    settles: ClassVar[tuple[str, ...]] = (
        "scan_order",
        "misplaced",
        "position",
        "stage_gain",
        "pitch",
        "seam",
        "drift",
        "jitter",
        "backlash",
    )
    explains: ClassVar[tuple[str, ...]] = (
        "strangers",
        "frame_shift",
        "stage_axes",
        "backlash",
        "jitter",
        "bad_pixels",
        "dead_line",
        "hot_line",
        "line_offsets",
        "mosaic",
        "not_linear",
        "saturated",
        "compression",
        "depth_label",
        "focus_drift",
        "ghost",
        "pupil",
        "type_focus",
        "type_light",
        "lamp",
        "flicker",
        "exposure",
        "background",
    )

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault with the planes whose patterns are in a wrong order, and the order that matches."""
        period = evidence.plan.period
        orders = _orders(period)
        back = {f"every other {line} of positions is reversed": axis for axis, line in ((1, "row"), (2, "column"))}
        lines = {name: _to_and_fro(period, axis) for name, axis in back.items()}
        turned: dict[int, str] = {}
        reported = 0.0
        for z in np.unique(evidence.index[:, 0]).tolist():
            own = np.flatnonzero((evidence.index[:, 0] == z) & ~evidence.asked)
            found = _best(evidence, z, own, orders)
            for name, order in lines.items():
                if found is not None:
                    break
                found = _best(evidence, z, own[evidence.index[own, back[name]] % 2 == 1], {name: order})
            if found is not None:
                turned[z], reported = found[0], max(reported, found[1])
        if not turned:
            return
        words = "; ".join(f"plane {z}: {name}" for z, name in list(turned.items())[:3])
        yield FoundFault(
            self,
            words + (f"; and {len(turned) - 3} more planes" if len(turned) > 3 else ""),
            reported,
            len(turned) / len(np.unique(evidence.index[:, 0])),
            positions=evidence.index[np.isin(evidence.index[:, 0], list(turned))],
            picture=place_map(evidence, evidence.alike, "correlation", "correlation with the camera's pattern"),
            put_in=_turned({z: {**orders, **lines}[name] for z, name in turned.items()}),
        )


def _best(evidence: Evidence, z: int, own: Index, orders: dict[str, Order]) -> tuple[str, float] | None:
    """Return the order of the patterns ``own`` (indices) of a plane, and its significance. None: the planned order."""
    own = own[np.linspace(0, len(own) - 1, min(TRIED, len(own))).astype(int)]
    if not own.size:
        return None
    data, index = evidence.data[own], evidence.index[own]
    plane, still = plane_of(evidence.camera, z, 0.0), np.zeros((len(own), 2))
    usual = float(np.median(correlation(plane.patterns(index[:, 1:], still), data)))
    moved = evidence.starts.window[own]
    if moved.any() and np.ptp(moved, axis=0).max() < 1:  # the same for all cutouts: the anchor is wrong
        usual = max(usual, float(np.median(evidence.alike[own])))
    if usual > POOR:
        return None
    found, best = None, max(GOOD, usual + BETTER)
    for name, order in orders.items():
        alike = float(np.median(correlation(plane.patterns(order(index)[:, 1:], still), data)))
        if alike > best:
            best, found = alike, (name, (alike - usual) / 0.02)
    return found


def _turned(turned: dict[int, Order]) -> PutIn:
    def put_in(patch: Patch) -> F4:
        other = patch.index.copy()
        for z, order in turned.items():
            own = other[:, 0] == z
            other[own] = order(other[own])
        return patch.at(other)

    return put_in


FAULTS = (WrongOrder(),)
