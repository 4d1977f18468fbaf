"""The microscope's fields on the lenslet array: the Debye integral of an aplanatic objective.

With k = 2 pi n / lambda, sin(alpha) = NA / n and image-side distance r = M times the object-side one (Broxton et
al. 2013, eq. 3; Gu 1996)::

    U(r) = integral_0^alpha sqrt(cos t) sin t J0(k r sin t / M) exp(-2 i k z sin^2(t/2)) dt

z > 0 is away from the objective, where the image is in front of the array. By Parseval, the energy through the pupil
is 2 pi (M/k)^2 (1 - cos alpha), so the field is normalised without using its peak, which may be zero.

The dipoles of a vectorial scene give five fields, K_m(r) times cosine or sine of m phi, whose intensities add. K_m has
J_m instead of J0, and the amplitude a_m in its integrand. Factors i^m, constant over a field, are omitted.

A dipole along x radiates, per solid angle, cos(t) cos(phi) along theta and -sin(phi) along phi. The objective turns
theta into the radial direction, and the tube lens is so slow that fields stay transverse. Averaging over dipoles along
x, y and z (Richards and Wolf 1959; Novotny and Hecht, Principles of Nano-Optics, 3.6 and 4.1) gives five fields whose
intensities add. One has the order m = 0; those of m = 1 and 2 vary by cosine and sine of m phi, with

    a0 = (1 + cos t)/2,    a2 = (1 - cos t)/2,    a1 = sin t / sqrt(2),    a0² + a1² + a2² = 1,

so that the pupil is as bright as that of a scalar point, whose single field has a0 = 1.

Behind a plane interface, n2 sin t2 = n1 sin t. Each plane wave has Fresnel's coefficients (Török et al. 1995;
`Specimen.crossing`), a scalar one those of waves polarised along the interface. Its phase is k (d n2 cos t2 - D n1 cos
t), with D and d the depths of focal plane and source (Gibson and Lanni 1991). Beyond total reflection, cos t2 is
imaginary: the light of a source close to the interface is attenuated by exp(-k d n2 |cos t2|).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Microscope
from lfcal.simulate.engines._quadrature import gauss_legendre
from lfcal.simulate.engines._radial import SPARE_NODES, Radial, hankel_sum, parity_spline
from lfcal.simulate.engines.zernike import zernike_radial
from lfcal.simulate.scene import Scene, Specimen

__all__ = [
    "DIPOLE_FIELDS",
    "SCALAR",
    "DebyeField",
    "PupilLight",
    "debye_field",
    "debye_fields",
    "debye_nodes",
    "field_shares",
    "objective_of",
    "pupil_light",
    "pupil_nodes",
    "pupil_phase",
    "radial_field",
]

PHASE_SAMPLES = 512
"""Number of samples of the phase over the pupil that determine its total variation."""
SHARE_NODES = 96
"""Number of nodes for the fraction of light in each field, which varies slowly over the pupil."""

F8 = NDArray[np.float64]
C16 = NDArray[np.complex128]


class PupilLight(NamedTuple):
    """A quadrature rule over the pupil with the light in it; unit energy over all fields.

    The field of order m on the array is sum_t light[m, t] J_m(k sine[t] r / M).
    """

    sine: F8  # (n,) sine of the angle in the immersion medium
    light: C16  # (orders, n): one order for a scalar point, else orders 0, 1 and 2


def objective_of(scene: Scene) -> Microscope:
    """Return the scene's microscope; raises `InputError` for a main lens."""
    if scene.objective is None:
        raise InputError.expected("Debye field", "a microscope", "a main lens", "use the level wave")
    return scene.objective


def _crossed(scene: Scene) -> Specimen | None:
    """Return the specimen if light crosses its interface on the way to the objective; otherwise None."""
    specimen, medium = scene.specimen, objective_of(scene).medium_index
    if specimen is None or specimen.index == medium or specimen.source_um(scene.z_um) < 0:
        return None
    return specimen


def _sections(scene: Scene, count: int) -> tuple[F8, F8]:
    """Return angles ``(n,)`` in the immersion medium and weights dt, ``count`` nodes to a section of the pupil.

    Square roots of cosines have branch points at 90 degrees and where total reflection begins: t = end (1 - s^2), and
    s^2 (3 - 2 s) between two such ends, make them smooth.
    """
    optics, specimen = objective_of(scene), _crossed(scene)
    alpha = optics.half_angle_rad
    s, w = gauss_legendre(count, 0.0, 1.0)
    critical = alpha
    if specimen is not None and specimen.index < optics.numerical_aperture:
        critical = min(alpha, math.asin(specimen.index / optics.medium_index))
    inner = critical * (1 - s * s), 2 * critical * w * s
    if critical == alpha:
        return inner
    rest = alpha - critical
    outer = critical + rest * s * s * (3 - 2 * s), 6 * rest * w * s * (1 - s)
    return np.concatenate([inner[0], outer[0]]), np.concatenate([inner[1], outer[1]])


def pupil_phase(scene: Scene, theta: F8) -> C16:
    """Return the phase (rad) at the angles ``theta`` (rad), 0 on the axis; its imaginary part is an attenuation.

    d n2 cos t2 - D n1 cos t minus its value on the axis is z n2 (cos t2 - 1) + D (n2 cos t2 - n1 cos t - n2 + n1).
    With q = n1 sin t, the bracket is q^2 (n2 - n1) (1 + (n2 + n1)/(n2 cos t2 + n1 cos t)) / ((n1 + n1 cos t)(n2 + n2
    cos t2)), which avoids cancellation.
    """
    optics, specimen, n1 = objective_of(scene), _crossed(scene), objective_of(scene).medium_index
    k = 2 * math.pi / scene.wavelength_um
    if specimen is None:
        phase = (-2 * k * n1 * scene.z_um * np.sin(theta / 2) ** 2).astype(np.complex128)
    else:
        n2, q, first = specimen.index, n1 * np.sin(theta), n1 * np.cos(theta)
        second = specimen.crossing(n1, theta).axial
        fall = q * q / (n2 + second)  # n2 (1 - cos t2)
        apart = (n2 - n1) * (1 + (n2 + n1) / (second + first)) / (n1 + first)
        phase = k * fall * (specimen.depth_um * apart - scene.z_um)
    rho = np.sin(theta) / math.sin(optics.half_angle_rad)
    for n, _, waves in scene.wavefront:
        phase = phase + 2 * np.pi * waves * zernike_radial(n, 0, rho)
    return phase


def _amplitudes(scene: Scene, theta: F8) -> C16:
    """Return the amplitudes ``(orders, n)`` of the fields that `PupilLight` names, before the apodisation."""
    specimen, n1 = _crossed(scene), objective_of(scene).medium_index
    half, sine = np.sin(theta / 2) ** 2, np.sin(theta)
    if specimen is None:
        fields = np.stack([1 - half, sine / math.sqrt(2), half]) if scene.vectorial else np.ones((1, theta.size))
        return fields.astype(np.complex128)
    n2 = specimen.index
    second, s, p = specimen.crossing(n1, theta)
    if not scene.vectorial:
        return s[None, :]
    # s - p cos t2 over one denominator, without the terms that cancel for equal indices
    differ = n1 * (n1 / n2 * (2 - 2 * half) + second / n2) - n2
    apart = 2 * half * s * differ / (n2 * np.cos(theta) + n1 * second / n2)
    return np.stack([s - apart / 2, p * n1 / n2 * sine / math.sqrt(2), apart / 2])


def pupil_nodes(scene: Scene, r_um: float) -> int:
    """Return the number of nodes for each section of the pupil that the integral needs out to ``r_um`` on the array.

    It is half the phase's variation plus half the Bessel function's largest argument, plus 30. With fewer nodes, the
    result is not slightly less accurate but useless (errors of 50-2000 %).
    """
    optics = objective_of(scene)
    k, alpha = 2 * math.pi * optics.medium_index / scene.wavelength_um, optics.half_angle_rad
    if _crossed(scene) is None:
        phase = 2 * k * abs(scene.z_um) * math.sin(alpha / 2) ** 2
        phase += sum(2 * math.pi * abs(w) * (n + 1) for n, _, w in scene.wavefront)
    else:
        steps = np.diff(pupil_phase(scene, np.sort(_sections(scene, PHASE_SAMPLES)[0])).real)
        phase = float(np.abs(steps).sum())
    return int((phase + k * math.sin(alpha) * r_um / optics.magnification) / 2) + SPARE_NODES


def pupil_light(scene: Scene, nodes: int) -> PupilLight:
    """Return the light in the pupil, with ``nodes`` nodes for each of its sections.

    Raises
    ------
    InputError
        For a main lens, or a wavefront that is not rotationally symmetric.
    """
    optics = objective_of(scene)
    if any(m for _, m, _ in scene.wavefront):
        raise InputError.expected(
            "wavefront of the microscope",
            "only rotationally symmetric terms (m = 0)",
            f"a term with m = {next(m for _, m, _ in scene.wavefront if m)}",
            "leave the other terms out",
        )
    theta, weight = _sections(scene, nodes)
    sine, turn = np.sin(theta), np.exp(1j * pupil_phase(scene, theta))
    fields = _amplitudes(scene, theta) * turn
    k, alpha = 2 * math.pi * optics.medium_index / scene.wavelength_um, optics.half_angle_rad
    passed = 2 * math.sin(alpha / 2) ** 2  # integral of sin t over the pupil
    if _crossed(scene) is not None:
        passed = float(weight * sine @ (np.abs(fields) ** 2).sum(0))
    level = math.sqrt(2 * math.pi * passed) * optics.magnification / k
    return PupilLight(sine, fields * (weight * np.sqrt(np.cos(theta)) * sine / level))


def field_shares(scene: Scene) -> tuple[float, ...]:
    """Return the fraction of the light in the fields of each order; they sum to 1."""
    theta, weight = _sections(scene, SHARE_NODES)
    fields = _amplitudes(scene, theta) * np.exp(-np.maximum(pupil_phase(scene, theta).imag, 0))
    energy = (np.abs(fields) ** 2) @ (weight * np.sin(theta))
    return tuple(float(e) for e in energy / energy.sum())


# -- fields on the array --------------------------------------------------------------------------------

FAINT = 1e-7
"""Fraction of the light below which a field is smaller than the rounding errors of single precision."""


class DebyeField(NamedTuple):
    """One field of a point on the array: K_m(r) times cos(m phi), or sin(m phi)."""

    order: int
    sine: bool = False

    @property
    def odd(self) -> tuple[bool, bool]:
        """Whether the field is odd in y, and in x."""
        return self.sine, self.sine != (self.order % 2 == 1)

    def angular(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the factor cos(m phi) or sin(m phi) at (x, y), with broadcasting."""
        phi = self.order * np.arctan2(y, x)
        factor: NDArray[np.float64] = np.sin(phi) if self.sine else np.cos(phi)
        return factor


SCALAR = DebyeField(0)
"""The only field of a scalar point; for dipoles, the field of order 0."""

DIPOLE_FIELDS = (SCALAR, DebyeField(1), DebyeField(1, True), DebyeField(2), DebyeField(2, True))
"""The fields of isotropic dipoles."""


def debye_fields(scene: Scene) -> tuple[DebyeField, ...]:
    """Return the fields whose intensities add up to a point's light, without those of negligible light."""
    if not scene.vectorial:
        return (SCALAR,)
    shares = field_shares(scene)
    return tuple(field for field in DIPOLE_FIELDS if field == SCALAR or shares[field.order] > FAINT)


def debye_nodes(scene: Scene, r_um: float) -> int:
    """Return the number of Gauss-Legendre nodes needed out to ``r_um`` on the array; see `pupil_nodes`."""
    return pupil_nodes(scene, r_um)


def debye_field(
    scene: Scene, r_um: NDArray[np.float64], nodes: int | None = None, order: int = 0
) -> NDArray[np.complex128]:
    """Return U, or K_m of ``order`` m, at distances ``r_um`` from the source's image on the array.

    All fields together carry unit energy through the pupil; fields of one order share it evenly between cosine and
    sine.

    Raises
    ------
    InputError
        For a main lens, a wavefront that is not rotationally symmetric, or an order that the scene does not have.
    """
    optics = objective_of(scene)
    pupil = pupil_light(scene, nodes or debye_nodes(scene, float(np.max(r_um, initial=0.0))))
    if not 0 <= order < len(pupil.light):
        raise InputError.expected(
            "order of the angular term of the field",
            f"0 to {len(pupil.light) - 1}",
            order,
            "give an order in this range",
        )
    rate = 2 * math.pi * optics.medium_index / scene.wavelength_um / optics.magnification * pupil.sine
    return hankel_sum(np.asarray(r_um, np.float64), rate, pupil.light[order], order)


def radial_field(scene: Scene, reach_um: float, order: int = 0) -> Radial:
    """Return a function of r, exact to 1e-5 of the largest value, out to ``reach_um``: a spline of `debye_field`."""
    optics = objective_of(scene)
    step = scene.wavelength_um * optics.magnification / optics.numerical_aperture / 10
    n = math.ceil(reach_um / step) + 8
    values = debye_field(scene, step * np.arange(n, dtype=np.float64), order=order)
    return parity_spline(values, step, odd=order % 2 == 1)
