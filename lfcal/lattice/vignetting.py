"""Fall-off of light over the field: one gain per lenslet, and a smooth surface through them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice._smooth_field import SmoothField, fit_field
from lfcal.lattice.fit import LatticeFit

__all__ = ["Vignetting", "vignetting_map"]


@dataclass(frozen=True, eq=False)
class Vignetting:
    """Relative illumination over the field, normalised to 1 at the maximum of a smooth surface fitted to the lenslets.

    Attributes
    ----------
    lenslets
        Relative light of each lenslet, ``(n,)``, in the order of the lattice fit; NaN for dead lenslets.
    surface
        Smooth surface fitted to the light of the lenslets.
    scatter
        Relative rms deviation of the lenslets, except dead ones, from the surface.
    falloff
        Minimum of the surface within the lit part of the frame, at least half of its minimum over the lenslets.
    """

    lenslets: NDArray[np.float64] = field(repr=False)
    surface: SmoothField = field(repr=False)
    scatter: float
    falloff: float

    def frame(self) -> NDArray[np.float32]:
        """Return the smooth surface at every pixel, ``(rows, columns)`` float32: a white frame without micro-images.

        The correction ``White(vignetting.frame(), dark=0.0)`` flattens the field and leaves micro-images unchanged.
        Dividing by the white image itself would also amplify the noise between micro-images. Outside the lit part of
        the frame, the surface is unknown and limited to values of at least `falloff`.
        """
        return np.maximum(self.surface.frame(), np.float32(self.falloff))


def vignetting_map(fit: LatticeFit, *, degree: int = 4) -> Vignetting:
    """Fit a smooth surface to the light of the lenslets over the field, and return it.

    Parameters
    ----------
    fit
        Lattice fitted to a white image from which the dark level was subtracted. A remaining pedestal would reduce the
        apparent fall-off.
    degree
        Maximum degree of the polynomial surface; with only a few lenslets, a lower degree is used.

    Examples
    --------
    >>> from lfcal.frames import read_image
    >>> from lfcal.lattice import Vignetting, fit_lattice, vignetting_map
    >>> fit = fit_lattice(read_image("session/white/white_0.png"), dark=64.0)
    >>> light: Vignetting = vignetting_map(fit, degree=2)
    >>> print(f"{light.falloff:.2f} at the dimmest place, {light.frame().max():.2f} at the brightest")
    0.95 at the dimmest place, 1.00 at the brightest
    """
    alive = ~fit.dead
    centres = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    surface = fit_field(centres[alive], fit.light[alive], fit.shape, degree)
    # outside the lit part of the frame, the surface is arbitrary
    lit = surface.at(*centres[alive].T)
    low = np.maximum(centres[alive].min(0) - fit.pitch_px, 0).astype(int)
    high = (centres[alive].max(0) + fit.pitch_px + 1).astype(int)
    inside = surface.frame()[low[0] : high[0], low[1] : high[1]]
    top, bottom = float(inside.max()), max(float(inside.min()), 0.5 * float(lit.min()), 0.0)
    scaled = SmoothField(surface.shape, surface.powers, surface.terms / top)
    relative = np.where(alive, fit.light / top, np.nan)
    deviation = relative[alive] / scaled.at(centres[alive, 0], centres[alive, 1]) - 1
    return Vignetting(relative, scaled, float(np.sqrt((deviation**2).mean())), bottom / top)
