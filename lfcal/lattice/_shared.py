"""Names of `lfcal.lattice` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.lattice._refocus import slope_of_virtual_depth
from lfcal.lattice.camera_check import DIFFERS, FIT_PX, FITS, WRONG, CameraCheck, CheckLine, check_camera
from lfcal.lattice.elemental_depth import elemental_seconds, iter_elemental_depth
from lfcal.lattice.lattice_file import lattice_dict, lattice_files
from lfcal.lattice.lattice_fit import LatticeErrors
from lfcal.lattice.micro_images import TypeOf, first_pixel
from lfcal.lattice.rendering import check_slopes
from lfcal.lattice.view_files import (
    TOTAL,
    save_focal_stack,
    save_total_focus,
    save_views,
    stack_names,
    view_names,
)

__all__ = [
    "DIFFERS",
    "FITS",
    "FIT_PX",
    "TOTAL",
    "WRONG",
    "CameraCheck",
    "CheckLine",
    "LatticeErrors",
    "TypeOf",
    "check_camera",
    "check_slopes",
    "elemental_seconds",
    "first_pixel",
    "iter_elemental_depth",
    "lattice_dict",
    "lattice_files",
    "save_focal_stack",
    "save_total_focus",
    "save_views",
    "slope_of_virtual_depth",
    "stack_names",
    "view_names",
]
