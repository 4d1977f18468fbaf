"""Names of `lfcal.camera` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.camera._plan_files import stage_table, useq_sequence
from lfcal.camera.derived import DEPTH, NOISE, STEP, WHOLE_FRAMES, assumed_of
from lfcal.camera.description import build, nearest_lens
from lfcal.camera.distortion import monomials, polynomial_powers
from lfcal.camera.forecast import readout_hours
from lfcal.camera.lattice import cell_corners
from lfcal.camera.plan import FORMAT, MAX_WAIT_S, HalfCell, half_cell
from lfcal.camera.regions import parse_regions
from lfcal.camera.shadow import cutout_for, half_extent_px, rms_radius_px
from lfcal.camera.written import read_camera_value, read_length, read_pitch, read_sensor, read_values

__all__ = [
    "DEPTH",
    "FORMAT",
    "MAX_WAIT_S",
    "NOISE",
    "STEP",
    "WHOLE_FRAMES",
    "HalfCell",
    "assumed_of",
    "build",
    "cell_corners",
    "cutout_for",
    "half_cell",
    "half_extent_px",
    "monomials",
    "nearest_lens",
    "parse_regions",
    "polynomial_powers",
    "read_camera_value",
    "read_length",
    "read_pitch",
    "read_sensor",
    "read_values",
    "readout_hours",
    "rms_radius_px",
    "stage_table",
    "useq_sequence",
]
