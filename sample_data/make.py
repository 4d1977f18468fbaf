"""Make the sample data: ``python sample_data/make.py [OUT]``. A fixed seed makes the same files every time.

The data are simulated recordings of the small ``bench`` camera, with noise, in two forms:

- ``session``: a folder of files, as another program would write them: two depth planes of 33 x 19 positions, 16-bit PNG
  frames, dark and white frames, camera, plan, manifest, and the known truth;
- ``recorded``: a session that lfcal recorded with a simulated camera and stage: the first plane, packed, with dark
  and reference frames.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.acquire import Options, iter_finish, record
from lfcal.base.progress import drain
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.devices import simulated_rig
from lfcal.simulate import SimulatedCamera
from lfcal.simulate.effects import (
    Effect,
    ExactAngles,
    IrisDiffraction,
    IrisShape,
    LensletDiffraction,
    LensTypeDefocus,
    Telecentricity,
)
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.sample import LIGHT, SENSOR_EFFECTS, pack_light
from lfcal.simulate.sensor.session import frame_name, write_session

__all__ = [
    "frame_name",
    "make",
    "make_light",
    "make_recorded",
    "recorded_plan",
    "sample_camera",
    "sample_plan",
    "sample_source",
]

SEED = 20
SENSOR = (80, 96)
CUTOUT = 55
VIRTUAL_DEPTHS = (3.0, 4.0)
DARKS, WHITES = 8, 4

OPTICS: tuple[Effect, ...] = (
    LensTypeDefocus(),
    LensletDiffraction(),
    IrisDiffraction(),
    IrisShape(),
    Telecentricity(),
    ExactAngles(),
)
FINELY: dict[str, Any] = {"level": "grid", "sampling": Sampling(samples_per_px=8, margin_px=40, double=True)}
"""Fixed level with an error of 0.1 %; double precision, so that rounding does not change the numbers of photons."""


def sample_camera() -> Camera:
    """Return the bench camera with the smallest sufficient sensor for the scan."""
    camera = preset("bench")
    return replace(camera, name="bench (sample session)", sensor=replace(camera.sensor, shape=SENSOR))


def sample_plan() -> ScanPlan:
    """Return the plan of the session."""
    return ScanPlan.for_camera(sample_camera(), virtual_depths=VIRTUAL_DEPTHS, cutout=CUTOUT, exposure_s=0.02)


def sample_source() -> SimulatedCamera:
    """Return the simulated camera that records the session."""
    return SimulatedCamera(sample_plan(), (*OPTICS, *SENSOR_EFFECTS), **FINELY, peak=0.8, seed=SEED)


def recorded_plan() -> ScanPlan:
    """Return the plan of the recorded session: the first plane."""
    return ScanPlan.for_camera(sample_camera(), virtual_depths=VIRTUAL_DEPTHS[:1], cutout=CUTOUT, exposure_s=0.02)


def make(out: Path) -> None:
    """Replace ``out`` by the folder of files, and write the light of its frames next to it."""
    shutil.rmtree(out, ignore_errors=True)
    source = sample_source()
    write_session(source, out, darks=DARKS, whites=WHITES)
    make_light(source, out.parent / LIGHT)


def make_light(source: SimulatedCamera, out: Path) -> None:
    """Write the light of all frames in the compact form that an installed package contains."""
    light = np.empty((*source.plan.shape[:3], *source.shape), np.float32)
    for index in range(len(source)):
        light[source.position(index)] = source.light(index)
    out.write_bytes(pack_light(light, source.plan))


def make_recorded(out: Path) -> None:
    """Replace ``out`` by a session that is recorded with simulated devices and packed."""
    shutil.rmtree(out, ignore_errors=True)
    plan = recorded_plan()
    optics = SimulatedCamera(plan, OPTICS, **FINELY, peak=0.8, seed=SEED)
    record(out, plan, simulated_rig(plan, optics=optics, seed=SEED), Options(darks=DARKS, reference_every=100))
    drain(iter_finish(out))
    (out / "session.lock").unlink(missing_ok=True)


def main() -> None:
    """Make both forms."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", nargs="?", type=Path, default=Path(__file__).parent)
    out = parser.parse_args().out
    make(out / "session")
    make_recorded(out / "recorded")


if __name__ == "__main__":
    main()
