"""PSF calibration and acquisition for plenoptic (light-field) cameras.

Ten names cover most tasks: ``read_camera`` or ``preset``, ``ScanPlan``, ``open_frames``, ``assemble`` or
``simulate_psf``, ``open_psf``, ``inspect``, ``fit_camera``, ``Projector``. The rest is in packages, listed in the
order in which data pass through them (``tests/architecture/test_imports.py`` states which may import which):

- ``base``: shared foundations: axes, errors, files, progress, threads
- ``camera``: the optics; presets; camera files of other programs; the scan plan and its forecast
- ``lattice``: the lenslet array found in a white image; views, refocusing
- ``frames``: sources of frames, and their corrections
- ``psf``: the matrix H: cutout, assembly, storage, transpose, aperture, export
- ``simulate``: the simulated camera: engines, effects, and the cost of accuracy
- ``fit``: the optics retrieved from measured patterns
- ``judge``: the quality of H: metrics, faults, findings, the verdict, reports, trends, comparisons
- ``devices``, ``acquire``: cameras and stages; the crash-safe recording
- ``targets``, ``campaign``: many points in one frame; several regions, and sessions that end when H is accurate enough
- ``recalibrate``: the camera, from ordinary frames of unknown objects
- ``reconstruct``: the projector pair and the solvers
- ``multiplex``: plenoptic multiplexing
- ``accuracy``: curves of error against seconds, bytes or frames
- ``records``, ``tasks``: settings, and one record for each task; commands, forms, scripts and job files are generated
  from them
- ``work``: units of long work, on threads, processes and several machines
- ``cli``, ``napari``: the command line, and the napari plug-in

Only names that these packages export are public; the modules within them are not.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfcal._face import *  # noqa: F403

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """Return one of the ten names or a package, imported on first use."""
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from lfcal._lazy import public_names

    names = public_names(__name__)
    if name == "__all__":
        return sorted(names)
    if name in names:
        module, there = names[name]
        return getattr(importlib.import_module(module), there)
    if name in __dir__():
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    from lfcal._lazy import public_names

    packages = (part.name for part in pkgutil.iter_modules(sys.modules[__name__].__path__) if part.ispkg)
    return sorted({*public_names(__name__), *packages, "__version__"})
