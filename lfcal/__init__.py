"""PSF calibration and acquisition for plenoptic (light-field) cameras.

- ``axes``: array conventions shared by every part
- ``errors``, ``progress``, ``files``, ``units``, ``plain``, ``threads``, ``figures``, ``version``: common ground
- ``camera``: what the optics are; presets; Raytrix XML; scan plan and its forecast
- ``frames``: where frames come from and how they are cleaned
- ``psf``: the matrix H: cutout, assembly, storage, transpose, judgement, export
- ``simulate``: the simulated camera
- ``fit``: the optics retrieved from measured patterns
- ``campaign``: what needs both recording and fit: adaptive sessions
- ``targets``: many points in one frame: targets, and the few frames that show all phases
- ``reconstruct``: projector pair and solvers
- ``multiplex``: plenoptic multiplexing
- ``accuracy``: curves of error against seconds, bytes or frames, everywhere accuracy is paid for
- ``cli``: the command line
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

__version__ = "0.1.0"


def __getattr__(name: str) -> ModuleType:
    """Import a part of the library when it is first asked for: ``import lfcal; lfcal.psf``."""
    if name in __dir__():
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(part.name for part in pkgutil.iter_modules(__path__))
