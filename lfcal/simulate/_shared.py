"""Names of `lfcal.simulate` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.cutout_light import light_in_cutout
from lfcal.simulate.plane_task import Budget, EffectsLike, budgeted, tolerance_for
from lfcal.simulate.response import PlaneResponse, at_wavelength
from lfcal.simulate.sample import sample_recording, sample_session
from lfcal.simulate.scene import LAWS
from lfcal.simulate.simulate import effects_from_records, effects_to_records
from lfcal.simulate.staging import filtered, lattice_scene_for, origin_of, outlook_of, resolve_level, scene_for

__all__ = [
    "LAWS",
    "AnyScene",
    "Budget",
    "EffectsLike",
    "PlaneResponse",
    "PupilScene",
    "at_wavelength",
    "budgeted",
    "effects_from_records",
    "effects_to_records",
    "filtered",
    "lattice_scene_for",
    "light_in_cutout",
    "origin_of",
    "outlook_of",
    "resolve_level",
    "sample_recording",
    "sample_session",
    "scene_for",
    "tolerance_for",
]
