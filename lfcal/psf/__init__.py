"""The PSF matrix H.

- ``matrix``: `PSFMatrix`, lazy, with its transposed view; ``planes`` is where its values come from
- ``store``: the H file; ``chunk_codec`` compresses it on all processors
- ``cutout``, ``assemble``: frames to H with the shifting cutout
- ``transpose``: HT, one slice of it, depth-plane sums
- ``aperture``, ``quality``, ``compare``, ``report``: is it any good?
- ``export``, ``matlab``: H for other programs, and theirs for lfcal
"""

from lfcal.psf.assemble import AssemblyReport, assemble, iter_assemble
from lfcal.psf.cutout import Cutout, find_cutout
from lfcal.psf.export import export, iter_export
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.store import PSFWriter, iter_save, save
from lfcal.psf.transpose import transpose

__all__ = [
    "AssemblyReport",
    "Cutout",
    "PSFMatrix",
    "PSFWriter",
    "assemble",
    "export",
    "find_cutout",
    "iter_assemble",
    "iter_export",
    "iter_save",
    "open_psf",
    "save",
    "transpose",
]
