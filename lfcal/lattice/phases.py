"""Where the micro-images lie about a lattice's points, by the phases of their first waves.

An iris of an odd number of blades has no centre of symmetry: where its images touch, the gaps between them draw the
place about which they are most symmetric away, by a tenth of a pitch and more. The lattice's first Fourier
coefficients are those of one micro-image, however many overlap. Those of blades are Bessel functions of their number,
and as good as nothing there, so that the phases are the place alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice.micro_image import mean_micro_image
from lfcal.lattice.model import LatticeModel
from lfcal.lattice.selection import thinned

__all__ = ["PhaseCentre", "phase_centre"]

Array = NDArray[np.float64]

WAVES = np.array([[1, 0], [0, 1], [1, 1], [1, -1]])
"""Waves per lattice step (q, r); the first ones of a lattice are among them."""


@dataclass(frozen=True, slots=True)
class PhaseCentre:
    """Where the micro-images lie about their lattice points.

    Attributes
    ----------
    shift, sigma
        ``(2,)`` as (x, y): from the lattice point to the centre, and its standard error (pixels).
    contrast
        Amplitude of the strongest wave over the light.
    """

    shift: Array
    sigma: Array
    contrast: float


def phase_centre(
    image: NDArray[np.float32], model: LatticeModel, centres: Array, light: Array, workers: int | None
) -> PhaseCentre:
    """Return where the micro-images about ``centres`` ``(n, 2)`` as (x, y) lie, which are a lattice's.

    Parameters
    ----------
    image
        White frame, evened out.
    model
        The lattice.
    centres, light
        Lattice points (x, y) of lenslets that are alive, and what each is divided by.
    workers
        Threads; None takes every processor.
    """
    basis = model.basis()
    chosen = thinned(len(centres))
    micro = mean_micro_image(image, centres[chosen], light[chosen], float(np.abs(basis).sum(0).max()), workers)
    n = micro.table.shape[0]
    at = np.linspace(-1, 1, n) * math.ceil(float(np.abs(basis).sum(0).max()))
    places = np.stack(np.broadcast_arrays(at, at[:, None]), -1)
    index = places @ np.linalg.inv(basis)
    # a tent over two cells along each axis: its transform vanishes at every wave of the lattice but its own
    tent = np.clip(1 - np.abs(index), 0, None).prod(-1)
    reciprocal = WAVES @ np.linalg.inv(basis).T
    length = np.hypot(*reciprocal.T)
    first = length < 1.25 * length.min()
    found = np.array([(micro.table * tent * np.exp(-2j * np.pi * (index @ wave))).sum() for wave in WAVES[first]])
    weight = np.abs(found)
    contrast = float(weight.max() / (micro.table * tent).sum())
    # micro-images that overlap may turn a wave over: its phase counts from there
    phase = -np.angle(found * np.where(found.real < 0, -1, 1)) / (2 * np.pi)
    rows = reciprocal[first] * weight[:, None]
    covariance = np.linalg.inv(rows.T @ rows)
    shift = covariance @ (rows.T @ (phase * weight))
    left = (phase * weight) - rows @ shift
    spread = float(left @ left) / max(1, len(left) - 2)
    return PhaseCentre(shift, np.sqrt(np.diag(covariance) * spread), contrast)
