"""Names of `lfcal.lattice` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.lattice.camera_check import DIFFERS, FIT_PX, FITS, WRONG, CameraCheck, CheckLine, check_camera
from lfcal.lattice.lattice_file import lattice_dict, lattice_files
from lfcal.lattice.lattice_fit import LatticeErrors
from lfcal.lattice.micro_images import TypeOf
from lfcal.lattice.rendering import check_slopes

__all__ = [
    "DIFFERS",
    "FITS",
    "FIT_PX",
    "WRONG",
    "CameraCheck",
    "CheckLine",
    "LatticeErrors",
    "TypeOf",
    "check_camera",
    "check_slopes",
    "lattice_dict",
    "lattice_files",
]
