"""Small scenes and the on/off measurement shared by the simulator's tests."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.simulate.effects import (
    Effect,
    IrisDiffraction,
    IrisShape,
    LensletDiffraction,
    LensTypeDefocus,
    Telecentricity,
)
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse

BASE: tuple[Effect, ...] = (LensTypeDefocus(), LensletDiffraction(), IrisDiffraction(), IrisShape(), Telecentricity())
"""The optics of the described camera; an effect under test is switched on and off in addition to these."""

FAST = Sampling(nodes_per_px=3, margin_px=4)
"""Incoherent and quick: differences between two simulations do not need more."""


def peak_bytes(make: Callable[[], object]) -> tuple[object, int]:
    """Return what ``make`` makes and the most memory that was held meanwhile."""
    tracemalloc.start()
    try:
        return make(), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def small_camera(rows: int = 160, columns: int = 160, **sensor: object) -> Camera:
    """Return the bench camera with a small sensor."""
    camera = preset("bench")
    return replace(camera, sensor=replace(camera.sensor, shape=(rows, columns), **sensor))  # type: ignore[arg-type]


def small_plan(virtual_depth: float = 4.0, camera: Camera | None = None, **options: object) -> ScanPlan:
    """Return the plan of one plane of the bench camera."""
    return ScanPlan.for_camera(camera or small_camera(), virtual_depths=[virtual_depth], **options)  # type: ignore[arg-type]


def some_positions(plan: ScanPlan, rows: int = 3, columns: int = 3) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return a few positions spread over the period."""
    ny, nx = plan.period
    return tuple(np.unique(np.linspace(0, n - 1, k).astype(np.intp)) for n, k in ((ny, rows), (nx, columns)))  # type: ignore[return-value]


def difference(without: NDArray[np.floating], with_it: NDArray[np.floating]) -> float:
    """Return sum(|without - with|) / sum(|with|)."""
    a, b = np.asarray(without, float), np.asarray(with_it, float)
    return float(np.abs(a - b).sum() / np.abs(b).sum())


def responses(plan: ScanPlan, effects: tuple[Effect, ...], z: int = 0, level: str = "auto") -> NDArray[np.float32]:
    """Return responses of a few positions."""
    return PlaneResponse(plan, z, effects, level=level, sampling=FAST).rows(*some_positions(plan))


def long(*values: object, **named: str) -> ParameterSet:
    """Return the parameters of a variant that runs with --long only."""
    return pytest.param(*values, marks=pytest.mark.long, **named)
