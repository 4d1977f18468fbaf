"""The microscope's fields on the lenslet array: the Debye integral of an aplanatic objective.

With k = 2 pi n / lambda, sin(alpha) = NA / n and image-side distance r = M times the object-side one (Broxton et
al. 2013, eq. 3; Gu 1996)::

    U(r) = integral_0^alpha sqrt(cos t) sin t J0(k r sin t / M) exp(-2 i k z sin^2(t/2)) dt

z > 0 is away from the objective, where the image lies before the array. Energy through the pupil, by Parseval, is
2 pi (M/k)^2 (1 - cos alpha), so the field is normalised without looking at its peak, which may be a null.

The dipoles of a vectorial scene make five fields, K_m(r) times cosine or sine of m phi, whose intensities add: K_m has
J_m for J0 and the amplitude a_m of `lfcal.simulate.engines._objective` in its integrand, where phases and amplitudes
behind an interface come from too. Factors i^m, the same all over a field, are left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.simulate.engines._objective import field_shares, objective_of, pupil_light, pupil_nodes
from lfcal.simulate.engines._radial import Radial, hankel_sum, parity_spline
from lfcal.simulate.scene import Scene

__all__ = ["DIPOLE_FIELDS", "SCALAR", "DebyeField", "debye_field", "debye_fields", "debye_nodes", "radial_field"]

FAINT = 1e-7
"""Share of the light below which a field is lost in the rounding of single precision."""


class DebyeField(NamedTuple):
    """One field of a point on the array: K_m(r) times cos(m phi), or sin(m phi)."""

    order: int
    sine: bool = False

    @property
    def odd(self) -> tuple[bool, bool]:
        """Whether the field is odd in y, and in x."""
        return self.sine, self.sine != (self.order % 2 == 1)

    def angular(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the factor cos(m phi) or sin(m phi) at (x, y), which are broadcast."""
        phi = self.order * np.arctan2(y, x)
        factor: NDArray[np.float64] = np.sin(phi) if self.sine else np.cos(phi)
        return factor


SCALAR = DebyeField(0)
"""The one field of a scalar point; of dipoles the field of order 0."""

DIPOLE_FIELDS = (SCALAR, DebyeField(1), DebyeField(1, True), DebyeField(2), DebyeField(2, True))
"""The fields of isotropic dipoles."""


def debye_fields(scene: Scene) -> tuple[DebyeField, ...]:
    """Return the fields whose intensities are a point's light, those apart that carry none to speak of."""
    if not scene.vectorial:
        return (SCALAR,)
    shares = field_shares(scene)
    return tuple(field for field in DIPOLE_FIELDS if field == SCALAR or shares[field.order] > FAINT)


def debye_nodes(scene: Scene, r_um: float) -> int:
    """Return how many Gauss-Legendre nodes the integral needs out to ``r_um`` on the array: see `pupil_nodes`."""
    return pupil_nodes(scene, r_um)


def debye_field(
    scene: Scene, r_um: NDArray[np.float64], nodes: int | None = None, order: int = 0
) -> NDArray[np.complex128]:
    """Return U, or K_m of ``order`` m, at distances ``r_um`` from the source's image on the array.

    Unit energy passes the pupil, in all fields together; those of an order share it evenly between cosine and sine.

    Raises
    ------
    InputError
        For a main lens, a wavefront that is not rotationally symmetric, or an order that the scene does not have.
    """
    optics = objective_of(scene)
    pupil = pupil_light(scene, nodes or debye_nodes(scene, float(np.max(r_um, initial=0.0))))
    if not 0 <= order < len(pupil.light):
        raise InputError.expected("order of the field", f"0 to {len(pupil.light) - 1}", order, "see Scene.vectorial")
    rate = 2 * math.pi * optics.medium_index / scene.wavelength_um / optics.magnification * pupil.sine
    return hankel_sum(np.asarray(r_um, np.float64), rate, pupil.light[order], order)


def radial_field(scene: Scene, reach_um: float, order: int = 0) -> Radial:
    """Return a function of r, exact to 1e-5 of the largest value, out to ``reach_um``: a spline of `debye_field`."""
    optics = objective_of(scene)
    step = scene.wavelength_um * optics.magnification / optics.numerical_aperture / 10
    n = math.ceil(reach_um / step) + 8
    values = debye_field(scene, step * np.arange(n, dtype=np.float64), order=order)
    return parity_spline(values, step, odd=order % 2 == 1)
