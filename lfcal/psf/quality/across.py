"""What planes say of each other: energies, copies, depths."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, MainLens
from lfcal.errors import InputError
from lfcal.psf.quality.frames import PlaneMeasures

__all__ = ["Across", "compare_planes", "shadow_sizes"]

DARK_PLANE = 0.1
"""A plane with less than this share of the usual energy is dark."""

NOVEL = 0.05
"""A plane that differs from another by less than this share of what neighbours differ by is its copy."""

BLIND = 0.02
"""Where noise alone makes two recordings differ by more than this, copies cannot be told."""

CLEAR = 4.0
"""The shadow's second moment is told from the lenslets' own where the sum is so many times that."""

FREEDOM = 0.1
"""Virtual depth by which a shadow may seem off: the tails of diffraction, the exact place of the sensor."""

NEAR = 0.6
"""Nearer to v = 1 than this the shadow is too small to be measured."""


@dataclass(frozen=True, slots=True)
class Across:
    """Values per plane ``(nz,)`` by metric key, and words."""

    values: dict[str, NDArray[np.float64]]
    details: dict[str, str]


def compare_planes(planes: list[PlaneMeasures], depths: NDArray[np.float64], camera: Camera | None) -> Across:
    """Return what the measured planes, in the order of H, say of each other."""
    details: dict[str, str] = {}
    energy = np.array([p.energy if p.lit else 0.0 for p in planes])
    usual = float(np.median(energy[energy > 0])) if (energy > 0).any() else 0.0
    dark = energy < DARK_PLANE * usual if usual else np.ones(len(planes), bool)
    values = {"planes_lit": dark.astype(float)}
    values["plane_energy"] = _energy(energy, ~dark, depths, camera)
    copies, pairs = _copies(planes, ~dark)
    values["plane_copies"] = copies
    if pairs:
        details["plane_copies"] = ", ".join(f"planes {a} and {b} are alike" for a, b in pairs)
    sizes = shadow_sizes(planes, camera)
    found = _in_order(planes, depths) if camera is None else _at_depth(planes, sizes, depths, camera)
    values |= {key: np.where(copies == 1, math.nan, value) for key, value in found.items()}
    return Across(values, details)


def _energy(
    energy: NDArray[np.float64], lit: NDArray[np.bool_], depths: NDArray[np.float64], camera: Camera | None
) -> NDArray[np.float64]:
    """Return each plane's deviation from equal energy (per cent), or from 1/distance² where that fits better."""
    out = np.full(energy.size, math.nan)
    if lit.sum() < 2:
        return out
    models = [np.ones(energy.size)]
    if camera is not None and isinstance(camera.optics, MainLens):
        models.append((camera.optics.working_distance_um / (camera.optics.working_distance_um + depths)) ** 2)
    tried = []
    for model in models:
        share = energy[lit] / model[lit]
        tried.append(100 * np.abs(share / np.median(share) - 1))
    out[lit] = min(tried, key=lambda d: float(d.max()))
    return out


def _copies(planes: list[PlaneMeasures], lit: NDArray[np.bool_]) -> tuple[NDArray[np.float64], list[tuple[int, int]]]:
    """Return which planes are copies of an earlier one, and the pairs.

    Planes are held against each other on some patterns; two that differ far less than neighbouring planes
    usually do are the same recording.
    """
    out = np.zeros(len(planes))
    chosen = [z for z in range(len(planes)) if lit[z] and planes[z].sample.size]
    if len(chosen) < 2:
        return out, []
    vectors = np.stack([planes[z].sample for z in chosen])
    norms = np.sqrt((vectors.astype(np.float64) ** 2).sum(1))
    apart = 1 - (vectors @ vectors.T).astype(np.float64) / np.maximum(np.outer(norms, norms), 1e-300)
    step = float(np.median(np.diagonal(apart, 1))) if len(chosen) > 2 else 0.0
    # what noise alone makes two recordings of the same patterns differ by
    noisy = [
        planes[z].dark.noise * math.sqrt((vectors[k] > 0).sum()) / max(norms[k], 1e-300) for k, z in enumerate(chosen)
    ]
    pairs = []
    for b in range(1, len(chosen)):
        for a in range(b):
            chance = 3 * noisy[a] * noisy[b]
            if chance < BLIND and apart[a, b] < max(NOVEL * min(max(step, 0.02), 0.2), chance):
                pairs.append((chosen[a], chosen[b]))
                out[chosen[b]] = 1
                break
    return out, pairs


def shadow_sizes(planes: list[PlaneMeasures], camera: Camera | None) -> NDArray[np.float64]:
    """Return the diameter of the iris's shadow on the sensor, per plane (pixels); NaN where not known.

    Light through the iris reaches r = P (1 - 1/v) - e B/f, P on the shadow at the lenslets and e on a lenslet,
    and over a whole cell both are spread independently: the second moment of a depth-plane sum is that of the
    shadow, which a disc of diameter D has as D²/8, plus that of the lenslets, which does not depend on depth.
    """
    sizes = np.full(len(planes), math.nan)
    if camera is None:
        return sizes
    pixel, gap = camera.sensor.pixel_um, camera.lattice.gap_um
    lens = camera.lattice.clear_diameter_um / 2 / pixel
    bend = float(np.mean([(gap / kind.focal_length_um) ** 2 for kind in camera.lattice.types]))
    airy = 0.42 * camera.wavelength_um * gap / camera.lattice.clear_diameter_um / pixel
    own = bend * lens**2 / 2 + 2 * airy**2 + 2 / 12
    for z, p in enumerate(planes):
        if p.lit and p.spread > CLEAR * own:
            sizes[z] = math.sqrt(8 * (p.spread - own))
    return sizes


def _at_depth(
    planes: list[PlaneMeasures], sizes: NDArray[np.float64], depths: NDArray[np.float64], camera: Camera
) -> dict[str, NDArray[np.float64]]:
    """Return per plane how far the shadow's size is off (per cent), and whether it is another plane's."""
    off, order = np.full(len(planes), math.nan), np.full(len(planes), math.nan)
    try:
        away = np.array([camera.virtual_depth(float(z)) - 1 for z in depths])
    except InputError:  # a depth this camera cannot see: plane numbers, or another camera's depths
        return {"depth": off, "depth_order": order}
    known = np.flatnonzero(np.isfinite(sizes) & (np.abs(away) > NEAR))
    if known.size < 2:
        return {"depth": off, "depth_order": order}
    wanted = np.abs(away[known])
    # the f-number may not be what the camera states: one scale for all, found whatever the order
    scale = float(np.median(np.sort(sizes[known]) / np.sort(wanted)))
    beyond = np.array([_beyond(planes[z]) for z in known])
    for k, z in enumerate(known):
        apart = np.abs(sizes[z] / (scale * wanted) - 1)
        if beyond[k] is not None:
            apart = np.where((away[known] > 0) == beyond[k], apart, apart + 1)
        off[z] = 100 * max(0.0, apart[k] - FREEDOM / wanted[k])
        order[z] = float(apart[k] > 3 * apart.min() + 0.05)
    if np.nansum(order):  # depths in a wrong order are not wrong as well
        off[known] = math.nan
    return {"depth": off, "depth_order": order}


def _beyond(plane: PlaneMeasures) -> bool | None:
    """Return whether the image lies beyond the sensor (v > 1), by the spots' spacing; None if they do not tell."""
    if plane.spots is None or plane.spots.order != "as planned" or abs(plane.spots.scale - 1) < 0.05:
        return None
    return bool(plane.spots.scale > 1)


def _in_order(planes: list[PlaneMeasures], depths: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return which planes stand out of order: the image moves one way as the source moves away."""
    found = np.array([p.spots.virtual_depth if p.spots is not None else math.nan for p in planes])
    order = np.full(found.size, math.nan)
    places = np.flatnonzero(np.isfinite(found))
    if places.size > 2:
        places = places[np.argsort(depths[places], kind="stable")]
        order[places] = _out_of_order(found[places])
    return {"depth_order": order}


def _out_of_order(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a flag for each value outside the longest monotonic run, rising or falling."""
    best: list[int] = []
    for sign in (1.0, -1.0):
        chains: list[list[int]] = []
        for k, v in enumerate(sign * values):
            before = [c for c in chains if sign * values[c[-1]] <= v]
            chains.append([*max(before, key=len, default=[]), k])
        best = max([best, *chains], key=len)
    flags = np.ones(values.size)
    flags[best] = 0
    return flags
