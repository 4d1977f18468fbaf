"""The public names of `lfcal.psf`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.psf.assembly import AssemblySettings, assemble, assemble_plan, iter_assemble, iter_assemble_plan
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.compare import Comparison, compare, iter_compare
from lfcal.psf.cutout import Cutout, find_cutout
from lfcal.psf.export import export, iter_export
from lfcal.psf.facts import Facts
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf, regions_of
from lfcal.psf.quality.inspect import inspect, iter_inspect
from lfcal.psf.quality.report import QualityReport
from lfcal.psf.report import iter_report, report
from lfcal.psf.saving import iter_save, iter_save_regions, save, save_regions
from lfcal.psf.store import PSFWriter
from lfcal.psf.transpose import transpose
from lfcal.psf.verify import MatrixCheck, iter_verify, verify

__all__ = [
    "AssemblyReport",
    "AssemblySettings",
    "Comparison",
    "Cutout",
    "Facts",
    "MatrixCheck",
    "PSFMatrix",
    "PSFWriter",
    "QualityReport",
    "assemble",
    "assemble_plan",
    "compare",
    "export",
    "find_cutout",
    "inspect",
    "iter_assemble",
    "iter_assemble_plan",
    "iter_compare",
    "iter_export",
    "iter_inspect",
    "iter_report",
    "iter_save",
    "iter_save_regions",
    "iter_verify",
    "open_psf",
    "regions_of",
    "report",
    "save",
    "save_regions",
    "transpose",
    "verify",
]
