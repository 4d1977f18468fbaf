"""The microscope's field on the lenslet array: the scalar Debye integral of an aplanatic objective.

With k = 2 pi n / lambda, sin(alpha) = NA / n and image-side distance r = M times the object-side one (Broxton et
al. 2013, eq. 3; Gu 1996)::

    U(r) = integral_0^alpha sqrt(cos t) sin t J0(k r sin t / M) exp(-2 i k z sin^2(t/2)) dt

z > 0 is away from the objective, where the image lies before the array. Energy through the pupil, by Parseval, is
2 pi (M/k)^2 (1 - cos alpha), so the field is normalised without looking at its peak, which may be a null.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Microscope
from lfcal.errors import InputError
from lfcal.simulate.engines.quadrature import gauss_legendre
from lfcal.simulate.engines.radial import SPARE_NODES, Radial, even_spline, hankel_sum
from lfcal.simulate.engines.zernike import zernike_radial
from lfcal.simulate.scene import Scene

__all__ = ["debye_field", "debye_nodes", "radial_field"]


def _objective(scene: Scene) -> Microscope:
    if scene.objective is None:
        raise InputError.expected("Debye field", "a microscope", "a main lens", "use level 'wave'")
    return scene.objective


def debye_nodes(scene: Scene, r_um: float) -> int:
    """Return how many Gauss-Legendre nodes the integral needs out to ``r_um`` on the array.

    Half the phase's range plus half the Bessel function's largest argument, plus 30: fewer nodes do not lose
    a digit, they lose everything (errors of 50-2000 %).
    """
    optics = _objective(scene)
    k, alpha = 2 * math.pi * optics.medium_index / scene.wavelength_um, optics.half_angle_rad
    phase = 2 * k * abs(scene.z_um) * math.sin(alpha / 2) ** 2
    waves = sum(2 * math.pi * abs(w) * (n + 1) for n, _, w in scene.wavefront)
    return int((phase + waves + k * math.sin(alpha) * r_um / optics.magnification) / 2) + SPARE_NODES


def debye_field(scene: Scene, r_um: NDArray[np.float64], nodes: int | None = None) -> NDArray[np.complex128]:
    """Return U at distances ``r_um`` from the source's image on the array; unit energy through the pupil.

    Raises
    ------
    InputError
        For a main lens, or a wavefront that is not rotationally symmetric.
    """
    optics = _objective(scene)
    if any(m for _, m, _ in scene.wavefront):
        raise InputError.expected(
            "microscope's wavefront", "rotationally symmetric terms (m = 0)", scene.wavefront, "leave the others out"
        )
    k, alpha = 2 * math.pi * optics.medium_index / scene.wavelength_um, optics.half_angle_rad
    s, w = gauss_legendre(nodes or debye_nodes(scene, float(np.max(r_um, initial=0.0))), 0.0, 1.0)
    # sqrt(cos t) has a branch point at 90 degrees: t = alpha (1 - s^2) makes it smooth for NA close to n
    theta, weight = alpha * (1 - s * s), 2 * alpha * w * s
    phase = -2 * k * scene.z_um * np.sin(theta / 2) ** 2
    rho = np.sin(theta) / math.sin(alpha)
    for n, _, waves in scene.wavefront:
        phase = phase + 2 * np.pi * waves * zernike_radial(n, 0, rho)
    g = weight * np.sqrt(np.cos(theta)) * np.sin(theta) * np.exp(1j * phase)
    level = math.sqrt(2 * math.pi * 2) * math.sin(alpha / 2) * optics.magnification / k
    rate = k / optics.magnification * np.sin(theta)
    return hankel_sum(np.asarray(r_um, np.float64), rate, g / level)


def radial_field(scene: Scene, reach_um: float) -> Radial:
    """Return a function of r, exact to 1e-5 of the largest value, out to ``reach_um``: a spline of `debye_field`."""
    optics = _objective(scene)
    step = scene.wavelength_um * optics.magnification / optics.numerical_aperture / 10
    n = math.ceil(reach_um / step) + 8
    return even_spline(debye_field(scene, step * np.arange(n, dtype=np.float64)), step)
