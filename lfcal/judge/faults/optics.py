"""Faults of the optics: planes at depths other than stated, a ghost image, and a lens type with less light."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import fft as sf

from lfcal.camera import LensletLattice, ScanPlan
from lfcal.judge._modelled import NEAR_ARRAY
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, adding
from lfcal.judge.faults._series import SURE
from lfcal.judge.faults.places import share_of

__all__ = ["FAULTS", "DepthLabel", "GhostFault", "TypeLight"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

DEEP, DEEP_NEAR = 0.004, 0.03
"""Change of the virtual depth above which it is reported: relative, and near the array absolute."""

GHOSTLY = 0.003
"""Smallest fraction of the light of a ghost."""

BRIGHTEST = 0.5
"""Largest fraction of the light of a ghost; brighter ones are usually an error of the fit of nonlinear values."""

NEAR_PX = 3
"""Displacement within which a ghost cannot be distinguished from the pattern's tails (pixels)."""

ROUNDS = 2
"""Number of iterations for the fraction of a ghost."""

TURNS = 3
"""Number of iterations for the light of types."""

DIM = 0.03
"""Relative difference between the light of a lens type and the light of the others above which it is reported."""


VIEWS: dict[str, Callable[[F4], F4]] = {
    "upright": lambda light: light,
    "rotated by 180°": lambda light: light[:, ::-1, ::-1],
    "mirrored top to bottom": lambda light: light[:, ::-1],
    "mirrored left to right": lambda light: light[:, :, ::-1],
}
"""Possible shapes of a ghost, as functions of patterns ``(n, nt, ns)``."""


class DepthLabel(Fault):
    """Planes that were recorded at a depth other than the stated one."""

    name = "depth_label"
    title = "planes at other depths than stated"
    subject = "optics"
    rank = 50
    advice = (
        "Correct the depths of these planes, or the distance of the zero position of the stage. No new "
        "recording is needed."
    )
    settles: ClassVar[tuple[str, ...]] = ("depth",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault with the planes whose virtual depths differ from those stated."""
        values, sigmas = evidence.column("depth")
        z, camera = evidence.index[:, 0], evidence.plan.camera
        planes, words, worst, reported = [], [], 0.0, 0.0
        across = np.full(len(evidence.plan.depths_um), np.nan)
        for plane in np.unique(z).tolist():
            own = (z == plane) & np.isfinite(sigmas)
            if own.sum() < 4:
                continue
            mean = float(np.median(values[own]))
            error = max(1.4826 * float(np.median(np.abs(values[own] - mean))) / np.sqrt(own.sum()), 1e-4)
            across[plane] = 100 * mean
            v = camera.virtual_depth(evidence.plan.depths_um[plane])
            near = abs(v) <= NEAR_ARRAY
            if abs(mean) > max(DEEP_NEAR if near else DEEP, SURE * error):
                planes.append(plane)
                there = v + mean * (1.0 if near else v)
                words.append(f"plane {plane}: v = {there:.3f} instead of {v:.3f}")
                worst, reported = max(worst, abs(mean)), max(reported, abs(mean) / error)
        if planes:
            more = f" and {len(words) - 3} more" if len(words) > 3 else ""
            yield FoundFault(
                self,
                "; ".join(words[:3]) + more,
                reported,
                share_of(evidence, worst, ("depth",)) * len(planes) / len(np.unique(z)),
                positions=evidence.index[np.isin(z, planes)],
                picture=FaultPicture(across, "%", "virtual depth relative to that stated", ("plane",)),
                put_in=_deeper(np.where(np.isin(np.arange(len(across)), planes), across / 100, 0.0)),
            )


def _deeper(shares: F8) -> PutIn:
    return lambda patch: patch.moved(depth=shares[patch.index[:, 0]])


class GhostFault(Fault):
    """A second, faint image of the pattern: displaced, mirrored or rotated."""

    name = "ghost"
    title = "ghost image"
    subject = "optics"
    strong_rank = 8
    rank = 54
    advice = (
        "Look for a reflection between filter, cover glass and sensor. A lens hood or a tilted filter may remove it."
    )
    settles: ClassVar[tuple[str, ...]] = ("leak", "background", "truncation")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault, with the displacement that matches best, if the residual contains a copy of the pattern."""
        left, light = evidence.left, evidence.light
        best: tuple[float, float, str, tuple[int, int], F8] | None = None
        for name, view in VIEWS.items():
            share, sigmas, place, table = _displaced(left, view(light), near=name == "upright")
            if best is None or sigmas > best[1]:
                best = share, sigmas, name, place, table
        assert best is not None
        share, sigmas, name, place, table = best
        if not GHOSTLY < share < BRIGHTEST or sigmas < SURE:
            return
        copy = _aside(VIEWS[name](light), *place)
        for _ in range(ROUNDS):  # recovers what the fit of each pattern absorbed at first
            now = evidence.with_data(evidence.data - np.float32(share) * copy, evidence.valid)
            power = float(np.square(copy).sum(dtype=np.float64))
            share += float((now.left * copy).sum(dtype=np.float64)) / max(power, 1e-300)
        if share > BRIGHTEST or not _in_most(left, copy, share):
            return
        yield FoundFault(
            self,
            f"{100 * share:.1f} % of the light, {name}, displaced by {place[0]:+d} px (down) and {place[1]:+d} px "
            "(right)",
            sigmas,
            share,
            picture=FaultPicture(
                100 * table,
                "%",
                "residual, as a fraction of the displaced pattern",
                ("down (px)", "across (px)"),
                origin=(-(table.shape[0] // 2), -(table.shape[1] // 2)),
            ),
            repair=adding(evidence.index, -np.float32(share) * copy),
            put_in=lambda patch: patch.light + np.float32(share) * _aside(VIEWS[name](patch.light), *place),
        )


def _aside(view: F4, down: int, across: int) -> F4:
    """Return patterns displaced by whole pixels; samples displaced out of the cutout are lost."""
    out = np.zeros_like(view)
    (to_y, from_y), (to_x, from_x) = (
        (slice(max(0, by), n + min(0, by)), slice(max(0, -by), n - max(0, by)))
        for by, n in ((down, view.shape[1]), (across, view.shape[2]))
    )
    out[:, to_y, to_x] = view[:, from_y, from_x]
    return out


def _displaced(left: F4, view: F4, *, near: bool) -> tuple[float, float, tuple[int, int], F8]:
    """Return fraction, significance and displacement of the most likely copy, and the fraction at each displacement."""
    shape = tuple(sf.next_fast_len(2 * n) for n in left.shape[1:])
    top = np.zeros(shape)
    for one, other in zip(left, view, strict=True):
        spectrum = sf.rfft2(one, shape) * np.conj(sf.rfft2(other, shape))
        top += sf.irfft2(spectrum, shape)
    power = float(np.square(view).sum(dtype=np.float64))
    table = sf.fftshift(top) / max(power, 1e-300)
    rows, columns = (n // 2 for n in shape)
    reach = [n // 2 for n in left.shape[1:]]
    table = table[rows - reach[0] : rows + reach[0] + 1, columns - reach[1] : columns + reach[1] + 1]
    y, x = (np.arange(-r, r + 1) for r in reach)
    free = np.hypot(y[:, None], x) > NEAR_PX if near else np.ones(table.shape, np.bool_)
    scatter = max(1.4826 * float(np.median(np.abs(table[free] - np.median(table[free])))), 1e-12)
    k = int(np.argmax(np.where(free, table, -np.inf)))
    place = int(y[k // table.shape[1]]), int(x[k % table.shape[1]])
    share = float(table.ravel()[k])
    return share, (share - float(np.median(table[free]))) / scatter / 2, place, table


def _in_most(left: F4, copy: F4, share: float) -> bool:
    """Return whether most patterns ``(n, nt, ns)`` contain at least a third of the fraction ``share`` of a copy."""
    power = np.square(copy).sum((1, 2), dtype=np.float64)
    seen = left.any((1, 2)) & (power > 0)
    each = (left * copy).sum((1, 2), dtype=np.float64)[seen] / power[seen]
    return bool(each.size) and float(np.median(each)) > share / 3


class TypeLight(Fault):
    """Lenslets of one type that transmit less light than the others."""

    name = "type_light"
    title = "lens type with less light"
    subject = "optics"
    rank = 56
    advice = (
        "Check the array for dirt or a coating, and look at the white image. If the lens types differ, state their "
        "transmission."
    )

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault for the lens type whose light differs most from the light of others, if this is significant."""
        types = len(evidence.plan.camera.lattice.types)
        if types < 2:
            return
        which = _types_of(evidence.plan, evidence.index, evidence.plan.cutout)
        gains, errors = _of_types(evidence, which, types)
        lit, now = 1 + gains, evidence
        if np.abs(gains).max() > DIM:
            for _ in range(TURNS):  # recovers what the other unknowns absorbed at first
                own = lit[which].astype(np.float32)
                shaded = replace(evidence, model=evidence.model * own, columns=evidence.columns * own[:, None])
                now = shaded.with_data(evidence.data, evidence.valid)
                lit = lit * (1 + np.clip(_of_types(now, which, types)[0], -0.5, 0.5))
        gains = lit / lit.max() - 1 if np.abs(gains).max() > DIM else gains
        # each is relative to the light of all; the worst one is reported, and the others compensate for it
        k = int(np.argmax(np.abs(gains)))
        if not np.isfinite(errors[k]) or abs(gains[k]) < max(DIM, SURE * errors[k]):
            return
        focal = evidence.plan.camera.lattice.types[k].focal_length_um
        yield FoundFault(
            self,
            f"type {k} (focal length {focal:.0f} µm) passes {100 * (1 + gains[k]):.0f} % of the light of the others",
            float(abs(gains[k]) / errors[k]),
            float(abs(gains[k]) / types),
            picture=FaultPicture(100 * gains, "%", "light of each lens type relative to the others", ("lens type",)),
            repair=adding(evidence.index, now.left - replace(evidence, values=now.values).left),
            put_in=_dimmed(1 + gains),
        )


def _of_types(evidence: Evidence, which: NDArray[np.intp], types: int) -> tuple[F8, F8]:
    """Return the relative deviation of the light of each type, and its standard deviations ``(types,)``."""
    gains, errors = np.zeros(types), np.full(types, np.inf)
    for kind in range(types):
        values, sigmas = evidence.beyond(np.where(which == kind, evidence.light, np.float32(0)))
        good = np.isfinite(sigmas)
        if good.sum() > 3:
            gains[kind] = float(np.median(values[good]))
            scatter = 1.4826 * float(np.median(np.abs(values[good] - gains[kind])))
            errors[kind] = scatter / np.sqrt(good.sum())
    return gains, errors


def _dimmed(gains: F8) -> PutIn:
    def put_in(patch: Patch) -> F4:
        which = _types_of(patch.evidence.plan, patch.index, (patch.light.shape[1], patch.light.shape[2]))
        return patch.light * gains[which].astype(np.float32)

    return put_in


def _types_of(plan: ScanPlan, index: NDArray[np.intp], cutout: tuple[int, int]) -> NDArray[np.intp]:
    """Return the type of the lenslet whose centre is nearest to each sample, ``(n, nt, ns)``."""
    camera = plan.camera
    lattice = camera.periodic
    nt, ns = cutout
    out = np.empty((len(index), nt, ns), np.intp)
    for k, (y, x) in enumerate(index[:, 1:].tolist()):
        rows = plan.anchor[0] + y + np.arange(nt) - (nt - 1) / 2
        columns = plan.anchor[1] + x + np.arange(ns) - (ns - 1) / 2
        points = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), -1))
        out[k] = _nearest_type(lattice, points)
    return out


def _nearest_type(lattice: LensletLattice, points: F8) -> NDArray[np.intp]:
    index = lattice.lenslet_at(points)
    base = np.floor(index)
    best = np.full(points.shape[:-1], np.inf)
    found = np.zeros(points.shape[:-1], np.intp)
    for i in (0, 1):
        for j in (0, 1):
            q, r = base[..., 0] + i, base[..., 1] + j
            apart = np.square(lattice.centres_um(q, r) - points).sum(-1)
            nearer = apart < best
            best = np.where(nearer, apart, best)
            found = np.where(nearer, lattice.type_of(q, r), found)
    return found


FAULTS = (DepthLabel(), GhostFault(), TypeLight())
