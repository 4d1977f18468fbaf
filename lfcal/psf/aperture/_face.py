"""The public names of `lfcal.psf.aperture`: each is loaded on first use."""

from __future__ import annotations

from lfcal.psf.aperture.expected import expected_aperture, footprint_px
from lfcal.psf.aperture.f_number import FNumber, working_f_number
from lfcal.psf.aperture.fit import fit_aperture
from lfcal.psf.aperture.iris import Iris, joint_iris
from lfcal.psf.aperture.shape import Aperture, with_error

__all__ = [
    "Aperture",
    "FNumber",
    "Iris",
    "expected_aperture",
    "fit_aperture",
    "footprint_px",
    "joint_iris",
    "with_error",
    "working_f_number",
]
