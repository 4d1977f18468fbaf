"""Filling of missing positions of H during assembly, from a source that predicts them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work
from lfcal.psf.facts import Facts

__all__ = ["Fill", "Filled"]


@dataclass(frozen=True, eq=False)
class Filled:
    """Facts about a plane whose missing positions were filled.

    Attributes
    ----------
    facts
        Facts about the positions, including their origin.
    uncertainty
        Standard deviation of every entry ``(ny, nx, nt, ns)``, 0 where only `Facts.noise` is known. None: not stated.
    """

    facts: Facts
    uncertainty: NDArray[np.float32] | None


Fill = Callable[[int, NDArray[np.float32], Facts], Work[Filled]]
"""Function of a plane's index, values ``(ny, nx, nt, ns)`` and facts that fills missing positions in the values."""
