"""The public names of `lfcal.reconstruct.solvers`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.reconstruct.solvers.measurement import Measurement

__all__ = [
    "Measurement",
]
