"""Regions of the field of one small camera whose wavefront grows with the field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit import Measured, Setup
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import RegionPlace, described_effects
from lfcal.simulate.effects import FieldAberrations, Zernike
from tests.fit.common import measured, some_index

READ, PEAK = 8.0, 16e3
ANCHORS = {"centre": (985.0, 1190.0), "edge": (985.0, 2250.0), "corner": (150.0, 2250.0), "far": (1800.0, 500.0)}
LAW = FieldAberrations(0.35, 0.3, 0.05, -0.04, 0.0, 6000.0)
ON_AXIS = Zernike(((4, 0, 0.15), (3, 1, 0.05), (2, 2, -0.08)))


def camera() -> Camera:
    found = preset("bench")
    return replace(found, sensor=replace(found.sensor, shape=(2000, 2400)))


def plan_at(name: str, cutout: int = 21, depths: tuple[float, ...] = (2.2, 2.7)) -> ScanPlan:
    return ScanPlan.for_camera(camera(), virtual_depths=depths, cutout=cutout, anchor=ANCHORS[name])


def true_setup(places: Sequence[RegionPlace] = (), planes: int = 2) -> Setup:
    """Return a camera that is otherwise than described, by what over the field are pixels."""
    found = camera()
    lattice = found.lattice
    grow = 1.0002
    types = zip(lattice.types, (0.02, -0.015, 0.01), strict=True)
    true = replace(
        lattice,
        gap_um=1.015 * lattice.gap_um,
        rotation_rad=lattice.rotation_rad + 1.2e-3,
        pitch_um=grow * lattice.pitch_um,
        row_pitch_um=None if lattice.row_pitch_um is None else grow * lattice.row_pitch_um,
        offset_um=(lattice.offset_um[0] + 1.5, lattice.offset_um[1] - 1.0),
        types=tuple(replace(one, focal_length_um=(1 + d) * one.focal_length_um) for one, d in types),
    )
    effects = (*described_effects(found), ON_AXIS, LAW)
    return Setup(replace(found, lattice=true), effects, (0.0,) * planes, regions=tuple(places))


def recorded(true: Setup, name: str, count: int, rng: np.random.Generator, **how: object) -> Measured:
    """Return noisy patterns of a region; its number is that in ``ANCHORS``."""
    plan = plan_at(name, **how)  # type: ignore[arg-type]
    index = some_index(plan, count)
    own = true.of_region(list(ANCHORS).index(name))
    light = predict(own, plan, index, np.zeros((count, 2)), Fineness.finest)
    clean = PEAK * np.maximum(light, 0) / light.max()
    data = rng.poisson(clean) + READ * rng.standard_normal(clean.shape)
    return measured(plan, data, index, (READ**2, 1.0))


def unlike(true: Setup, found: Setup, plan: ScanPlan, count: int = 12) -> float:
    """Return how far the patterns of a setup are from the true ones (relative L2), their light alike."""
    index = some_index(plan, count)
    still = np.zeros((count, 2))
    wanted, own = (predict(one, plan, index, still, Fineness.finest).astype(float) for one in (true, found))
    off = (own * wanted).sum() / np.square(own).sum() * own - wanted
    return float(np.sqrt(np.square(off).sum() / np.square(wanted).sum()))
