"""The public names of `lfcal.psf`: each is loaded on first use."""

from __future__ import annotations

from lfcal.psf._export import export, iter_export
from lfcal.psf._transpose import transpose
from lfcal.psf._verify import MatrixCheck, iter_verify, verify
from lfcal.psf.assembly import assemble, assemble_plan, forecast_assembly, iter_assemble, iter_assemble_plan
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.cutout import Cutout, find_cutout
from lfcal.psf.denoising import denoised, with_new_noise
from lfcal.psf.facts import Facts
from lfcal.psf.layout import Stored
from lfcal.psf.make import units_of
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf, regions_of
from lfcal.psf.provenance import codec_of, noise_of, origin_of
from lfcal.psf.saving import MatrixPlanes, iter_save, iter_save_regions, save, save_regions
from lfcal.psf.store import PSFWriter
from lfcal.records import AssemblySettings

__all__ = [
    "AssemblyReport",
    "AssemblySettings",
    "Cutout",
    "Facts",
    "MatrixCheck",
    "MatrixPlanes",
    "PSFMatrix",
    "PSFWriter",
    "Stored",
    "assemble",
    "assemble_plan",
    "codec_of",
    "denoised",
    "export",
    "find_cutout",
    "forecast_assembly",
    "iter_assemble",
    "iter_assemble_plan",
    "iter_export",
    "iter_save",
    "iter_save_regions",
    "iter_verify",
    "noise_of",
    "open_psf",
    "origin_of",
    "regions_of",
    "save",
    "save_regions",
    "transpose",
    "units_of",
    "verify",
    "with_new_noise",
]
