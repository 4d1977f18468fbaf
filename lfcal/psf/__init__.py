"""The PSF matrix H.

- ``matrix``: `PSFMatrix`, lazy, with its transposed view; ``planes`` is where its values come from, ``facts`` what is
  known of its positions, ``travel`` how it goes to another process
- ``opening``, ``store``, ``layout``: the H file; ``chunk_codec`` compresses it on all processors, ``nexus`` tells
  viewers what to plot; ``steps`` stores it within a tolerance
- ``specification``, ``json_schema``: an H file held against the published schema of its format
- ``cutout``, ``gather``, ``assembly``, ``assemble``, ``assemble_plan``, ``pedestal``: frames to H with the shifting
  cutout
- ``picked``: patterns of a few positions, no other frame read
- ``orientation``, ``spot_path``: which way the frames of a scan lie, from where the pattern is in some of them
- ``transpose``: HT, one slice of it, depth-plane sums
- ``verify``: is a file still what was written?
- ``aperture``, ``quality``, ``compare``, ``report``: is it any good?
- ``export``, ``matlab``, ``lens_centre``, ``tiff_export``: H for other programs
- ``mat_import``, ``rearranged``, ``lfc_import``, ``plain_pickle``: theirs for lfcal
"""

from lfcal.psf.assemble import assemble, iter_assemble
from lfcal.psf.assemble_plan import AssemblySettings, assemble_plan, iter_assemble_plan
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.compare import Comparison, compare, iter_compare
from lfcal.psf.cutout import Cutout, find_cutout
from lfcal.psf.export import export, iter_export
from lfcal.psf.facts import Facts
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf, regions_of
from lfcal.psf.quality import QualityReport, inspect, iter_inspect
from lfcal.psf.report import iter_report, report
from lfcal.psf.store import PSFWriter, iter_save, save, save_regions
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
    "iter_verify",
    "open_psf",
    "regions_of",
    "report",
    "save",
    "save_regions",
    "transpose",
    "verify",
]
