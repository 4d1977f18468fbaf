"""The public names of `lfcal.reconstruct.solvers`: each is loaded on first use."""

from __future__ import annotations

from lfcal.reconstruct.solvers.measurement import Measurement

__all__ = [
    "Measurement",
]
