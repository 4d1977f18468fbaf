"""The ten most used names of lfcal, each loaded on first use."""

from __future__ import annotations

from lfcal.camera import ScanPlan, preset, read_camera
from lfcal.fit import fit_camera
from lfcal.frames import open_frames
from lfcal.judge import inspect
from lfcal.psf import open_psf
from lfcal.reconstruct import Projector
from lfcal.simulate import simulate_psf
from lfcal.tasks import assemble

__all__ = [
    "Projector",
    "ScanPlan",
    "assemble",
    "fit_camera",
    "inspect",
    "open_frames",
    "open_psf",
    "preset",
    "read_camera",
    "simulate_psf",
]
