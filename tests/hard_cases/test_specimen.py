"""Indices and angles at which a microscope's interface and vector fields lose their digits."""

from __future__ import annotations

import mpmath as mp
import numpy as np

from lfcal.camera import Microscope
from lfcal.simulate.engines._debye import debye_field, debye_nodes, pupil_phase
from lfcal.simulate.engines._radial import bessel
from lfcal.simulate.scene import Specimen
from tests.hard_cases.record import hard_case, worst
from tests.simulate.scenes import microscope_scene


@hard_case(
    "Specimen's index below the NA",
    wrong="total reflection begins inside the pupil: a branch point, beyond which the light must decay",
    measure="relative change of the fields with twice the number of nodes, for index 1.33 and within 1e-6 of the NA",
    bound=1e-9,
)
def test_total_reflection():
    objective = Microscope(60.0, 1.4, 1.518)
    r, changes = np.linspace(0, 1000, 30), []
    for index in (1.33, 1.4 * (1 - 1e-6), 1.4, 1.4 * (1 + 1e-6)):
        scene = microscope_scene(
            0.5, objective=objective, f_number=60 / 2.8, vectorial=True, specimen=Specimen(index, 20.0)
        )
        for order in range(3):
            wanted = debye_field(scene, r, nodes=2 * debye_nodes(scene, 1000.0), order=order)
            changes.append(np.abs(debye_field(scene, r, order=order) - wanted).max() / np.abs(wanted).max())
    return worst(*changes)


@hard_case(
    "Phase of a specimen that nearly matches",
    wrong="n2 cos t2 - n1 cos t loses ten digits by cancellation, and all digits near the axis",
    measure="relative error of the phase compared with 40 digits, for indices that differ by 1e-9",
    bound=1e-13,
)
def test_near_index():
    mp.mp.dps = 40
    scene = microscope_scene(0.0, specimen=Specimen(1 + 1e-9, 1e4))
    theta, errors = np.array([1e-6, 0.1, 0.5]), []
    for angle, found in zip(theta, pupil_phase(scene, theta), strict=True):
        n2, t = mp.mpf(1 + 1e-9), mp.mpf(float(angle))
        path = mp.mpf(10000) * (mp.sqrt(n2**2 - mp.sin(t) ** 2) - n2 - mp.cos(t) + 1)
        exact = float(2 * mp.pi / mp.mpf(scene.wavelength_um) * path)
        errors.append(abs(found.real / exact - 1))
    return worst(*errors)


@hard_case(
    "Second Bessel function next to the axis",
    wrong="2 J1(x)/x - J0(x) is +-1 for the smallest x, and loses all digits below 1e-8",
    measure="largest relative error compared with 30 digits, for x from 1e-150 to 0.02",
    bound=1e-11,
)
def test_second_bessel():
    mp.mp.dps = 30
    x = np.array([1e-150, 1e-8, 1e-4, 0.01, 0.0199999, 0.02])
    exact = np.array([float(mp.besselj(2, mp.mpf(float(v)))) for v in x])
    assert bessel(2, np.array([0.0, 5e-324])).tolist() == [0.0, 0.0]
    return float(np.abs(bessel(2, x) / exact - 1).max())
