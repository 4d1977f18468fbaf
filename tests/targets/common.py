"""Cameras and scans of the tests of targets."""

from __future__ import annotations

from dataclasses import replace

from lfcal.camera import Camera, LensType, ScanPlan, preset
from lfcal.camera.distortion import LatticeDistortion

__all__ = ["bench", "distorted", "scan_of", "small", "turned"]


def bench(side: int = 480) -> Camera:
    """Return the small camera with a larger sensor."""
    camera = preset("bench")
    return replace(camera, sensor=replace(camera.sensor, shape=(side, side)))


def small(side: int = 300) -> Camera:
    """Return a camera of 12 x 21 positions: searches are quick."""
    camera = bench(side)
    pitch = 7 * camera.sensor.pixel_um
    # the same f-number of the lenslets, in focus where the large ones are
    gap = camera.lattice.gap_um * pitch / camera.lattice.pitch_um
    types = tuple(LensType.focused_at(v, gap) for v in (2.0, 3.0, 5.0))
    lattice = replace(camera.lattice, pitch_um=pitch, gap_um=gap, types=types, clear_um=None)
    return replace(camera, lattice=lattice)


def turned(camera: Camera, rotation_rad: float) -> Camera:
    """Return the camera with its array turned."""
    return replace(camera, lattice=replace(camera.lattice, rotation_rad=rotation_rad))


def distorted(camera: Camera, share: float = 0.01) -> Camera:
    """Return the camera with an array that is seen wider towards the rim, by a share of the distance 1 mm out."""
    bent = LatticeDistortion("radial", (0.0, 0.0), 1000.0, ((1000.0 * share,),))
    return replace(camera, lattice=replace(camera.lattice, distortion=bent))


def scan_of(camera: Camera, virtual_depth: float = 4.0) -> ScanPlan:
    """Return the scan of one plane, with a cutout of 31 x 31 px."""
    return ScanPlan.for_camera(camera, virtual_depths=(virtual_depth,), cutout=31)
