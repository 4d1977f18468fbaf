"""Missing positions of H, filled by somebody who knows what would be there while H is assembled."""

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
    """What is known of a plane whose missing positions were filled.

    Attributes
    ----------
    facts
        Of the positions, their origin among them.
    uncertainty
        Standard deviation of every entry ``(ny, nx, nt, ns)``, 0 where none is stated beside the noise; or None.
    """

    facts: Facts
    uncertainty: NDArray[np.float32] | None


Fill = Callable[[int, NDArray[np.float32], Facts], Work[Filled]]
"""Fills the missing positions of a plane in place: its number, its values ``(ny, nx, nt, ns)``, and its facts."""
