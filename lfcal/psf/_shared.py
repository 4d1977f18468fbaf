"""Names of `lfcal.psf` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.psf._export import ExportOptions, check_missing, export_files, export_notes
from lfcal.psf._transpose import depth_sum, ht_slice
from lfcal.psf.assembly import AssembledPlanes, AssemblyProgress, planes_of_frames
from lfcal.psf.codes import CODES, code_of, codes_for, refused_by
from lfcal.psf.cutout import INTERPOLATIONS, Window
from lfcal.psf.denoising import mean_noise
from lfcal.psf.facts import Origin
from lfcal.psf.filling import Filled
from lfcal.psf.half_cell import copied_positions
from lfcal.psf.layout import Header, Plane
from lfcal.psf.lens_centre import lens_centre_of
from lfcal.psf.light import dark_planes, empty_positions, empty_words
from lfcal.psf.make import PlaneSource, Reopening, Zeros, iter_make, iter_write
from lfcal.psf.mat_import import MAT_ORDERS, check_mat_order
from lfcal.psf.measured_noise import scan_noise
from lfcal.psf.opening import head_of, mat_order_of, mat_orders_of, opening_notes
from lfcal.psf.orientation import AS_IS, ORIENTATIONS, FoundOrientation, either_words, find_orientation
from lfcal.psf.picked import iter_pick
from lfcal.psf.provenance import OF_FRAMES, computed_words, light_shares, optics_of, simulated_planes
from lfcal.psf.saving import iter_transpose_file
from lfcal.psf.store import FORMAT
from lfcal.psf.upright import AUTO, CHECK, check_found, iter_upright
from lfcal.psf.voxels import pixel_um, voxel_um

__all__ = [
    "AS_IS",
    "AUTO",
    "CHECK",
    "CODES",
    "FORMAT",
    "INTERPOLATIONS",
    "MAT_ORDERS",
    "OF_FRAMES",
    "ORIENTATIONS",
    "AssembledPlanes",
    "AssemblyProgress",
    "ExportOptions",
    "Filled",
    "FoundOrientation",
    "Header",
    "Origin",
    "Plane",
    "PlaneSource",
    "Reopening",
    "Window",
    "Zeros",
    "check_found",
    "check_mat_order",
    "check_missing",
    "code_of",
    "codes_for",
    "computed_words",
    "copied_positions",
    "dark_planes",
    "depth_sum",
    "either_words",
    "empty_positions",
    "empty_words",
    "export_files",
    "export_notes",
    "find_orientation",
    "head_of",
    "ht_slice",
    "iter_make",
    "iter_pick",
    "iter_transpose_file",
    "iter_upright",
    "iter_write",
    "lens_centre_of",
    "light_shares",
    "mat_order_of",
    "mat_orders_of",
    "mean_noise",
    "opening_notes",
    "optics_of",
    "pixel_um",
    "planes_of_frames",
    "refused_by",
    "scan_noise",
    "simulated_planes",
    "voxel_um",
]
