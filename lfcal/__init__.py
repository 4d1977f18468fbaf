"""PSF calibration and acquisition for plenoptic (light-field) cameras.

Ten names do most of what is done: ``read_camera`` or ``preset``, ``ScanPlan``, ``open_frames``, ``assemble`` or
``simulate_psf``, ``open_psf``, ``inspect``, ``fit_camera``, ``Projector``. The rest is in packages, in the order in
which data pass through them (which may import which is in ``tests/architecture/test_imports.py``):

- ``base``: what every part stands on: axes, errors, files, progress, threads
- ``camera``: what the optics are; presets; descriptions of other programs; the scan plan and its forecast
- ``lattice``: the lenslet array found in a white image; views, refocusing
- ``frames``: where frames come from and how they are cleaned
- ``psf``: the matrix H: cutout, assembly, storage, transpose, aperture, export
- ``simulate``: the simulated camera: engines, effects, and what accuracy costs
- ``fit``: the optics retrieved from measured patterns
- ``judge``: whether H is good: metrics, faults, findings, the verdict, reports, trends, comparisons
- ``devices``, ``acquire``: cameras and stages; the crash-safe recording
- ``targets``, ``campaign``: many points in one frame; several regions, and sessions that end when H is known
- ``reconstruct``: the projector pair and the solvers
- ``multiplex``: plenoptic multiplexing
- ``accuracy``: curves of error against seconds, bytes or frames, everywhere accuracy is paid for
- ``records``, ``tasks``: settings, and one record for each task, of which command, form, script and job file are made
- ``work``: units of long work, on threads, processes and several machines
- ``cli``, ``napari``: the command line, and the plug-in of napari

Only names of these packages are public, not those of the modules within them.
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
    """Return one of the ten names or a package, imported when it is first asked for."""
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
