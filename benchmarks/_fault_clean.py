"""Recordings without a fault, for which an inspection must not report one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_recordings import CAMERAS, Recording
from lfcal.camera import Camera, LensletLattice, ScanPlan, preset

__all__ = ["clean_cameras"]

F4 = NDArray[np.float32]

PRNU, FLICKER = 0.01, 0.01
"""Relative rms scatter of the pixel response and of the light of frames, in recordings with PRNU or flicker."""


def _one_type() -> Camera:
    camera = preset("bench")
    return replace(camera, lattice=replace(camera.periodic, types=camera.lattice.types[1:2]))


def _square() -> Camera:
    camera = preset("bench")
    old = camera.lattice
    return replace(camera, lattice=LensletLattice("square", old.pitch_um, old.gap_um, old.types[1:2]))


def _turned(degrees: float) -> Camera:
    camera = preset("bench")
    return replace(camera, lattice=replace(camera.periodic, rotation_rad=math.radians(degrees)))


def _whole_60x() -> Camera:
    """Return a `lfm_60x12` whose pitch is 15 pixels instead of 15.4, so that the period is a whole number of pixels."""
    camera = preset("lfm_60x12")
    return replace(camera, sensor=replace(camera.sensor, pixel_um=camera.lattice.pitch_um / 15))


def _plans() -> Iterator[tuple[str, ScanPlan]]:
    def of(camera: Camera, *virtual: float) -> ScanPlan:
        return ScanPlan.for_camera(camera, virtual_depths=virtual)

    yield "bench", of(preset("bench"), 3.0, 4.0)
    yield "bench, negative depths", of(preset("bench"), -4.0, -3.0)
    yield "bench, turned by 0.3°", of(_turned(0.3), 3.0, 4.0)
    yield "bench, one lens type", of(_one_type(), 3.0, 4.0)
    yield "bench, square lattice", of(_square(), 3.0, 4.0)
    yield "bench, near and far", of(preset("bench"), 2.0, 5.0)
    yield "r29-like", of(CAMERAS["r29-like"]().camera, 3.0, 4.0)
    yield "lfm_20x05", CAMERAS["lfm_20x05"]()
    yield "lfm_20x05, above focus", ScanPlan.for_camera(preset("lfm_20x05"), depths_um=(15.0, 30.0))
    yield "lfm_60x12", ScanPlan.for_camera(_whole_60x(), depths_um=(-4.0, -3.0))


def clean_cameras(count: int) -> Iterator[tuple[str, Recording, F4]]:
    """Yield names, recordings and values ``(nz, ny, nx, nt, ns)``: each also with PRNU, flicker, half the light."""
    done = 0
    for name, plan in _plans():
        recording = Recording(plan)
        rng = np.random.default_rng(20)
        uneven = (1 + PRNU * rng.standard_normal(recording.sensor(0.0).shape)).astype(np.float32)
        lamp = (1 + FLICKER * rng.standard_normal(plan.shape[:3]))[..., None, None]
        for words, light in (
            ("", recording.light),
            (", 1 % PRNU", lambda r=recording, u=uneven: r.scaled(r.light(), u)),
            (", 1 % flicker", lambda r=recording, g=lamp: (r.light() * g).astype(np.float32)),
            (", half the light", lambda r=recording: r.light() / np.float32(2)),
        ):
            if done == count:
                return
            yield name + words, recording, recording.noisy(light(), seed=done)
            done += 1
