"""The lens law of a main lens: the field on the array against Rayleigh and Sommerfeld's integral over a thin lens."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import preset
from lfcal.simulate.engines.field import choose_mode, field_table
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import scene_of

FAR_UM = 2e8  # of the lens from the array: angles at the image are those of a telecentric cone
NODES, ANGLES = 90, 400


def aperture(blades: int, turn: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes (n, 2) and weights over a regular polygon of area pi, or the unit disc."""
    t, w = np.polynomial.legendre.leggauss(NODES)
    t, w = (t + 1) / 2, w / 2
    if blades == 0:
        angles = 2 * math.pi * np.arange(ANGLES) / (ANGLES)
        rho = np.sqrt(t)[:, None]
        points = np.stack([rho * np.cos(angles), rho * np.sin(angles)], axis=-1)
        return points.reshape(-1, 2), np.repeat(math.pi * w / (ANGLES), ANGLES)
    corner = turn + 2 * math.pi * np.arange(blades + 1) / blades
    radius = math.sqrt(2 * math.pi / (blades * math.sin(2 * math.pi / blades)))
    corners = radius * np.stack([np.cos(corner), np.sin(corner)], axis=1)
    points, weights = [], []
    for p, q in itertools.pairwise(corners):
        # a triangle from the middle: the outer side is drawn to the inside
        points.append(t[:, None, None] * ((1 - t)[None, :, None] * p + t[None, :, None] * q))
        weights.append(w[:, None] * w * t[:, None] * abs(p[0] * q[1] - p[1] * q[0]))
    return np.concatenate(points).reshape(-1, 2), np.concatenate(weights).ravel()


def thin_lens(scene: Scene, at: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the field at points (n, 2) of the array behind a thin lens with a stop of diameter b/Nw; unit energy."""
    points, weights = aperture(scene.iris.blades, scene.iris.rotation_rad)
    radius, k = (FAR_UM + scene.image_um) / (2 * scene.f_number), 2 * math.pi / scene.wavelength_um
    points = points * radius
    to_image = np.sqrt(np.square(points).sum(1) + (FAR_UM + scene.image_um) ** 2)
    found = []
    for x in at:
        way = np.sqrt(np.square(points - x).sum(1) + FAR_UM**2)
        # the waves of the middle are taken off both: differences of large numbers
        phase = k * ((way - FAR_UM) - (to_image - FAR_UM - scene.image_um))
        found.append((weights * FAR_UM / way**2 * np.exp(1j * phase)).sum())
    return np.array(found) * radius / (math.sqrt(math.pi) * scene.wavelength_um)


@pytest.mark.parametrize("blades", [0, 7])
@pytest.mark.parametrize("depth", [4.0, 0.2])
def test_the_field_of_the_tangent_law_is_that_behind_a_thin_lens(blades: int, depth: float) -> None:
    camera = preset("bench")
    camera = replace(camera, optics=replace(camera.optics, blades=blades))
    scene = scene_of(camera, virtual_depth=depth, cutout=(9, 9), pupil_um=math.inf)
    scene = replace(scene, exact_defocus=True, exact_rays=True)
    assert choose_mode(scene) == ("E" if depth > 1 else "U")

    def off(law: float) -> float:
        table = field_table(replace(scene, lens_law=law), 1.0, 240.0 if depth > 1 else 24.0)
        middle = len(table.values) // 2
        steps = np.linspace(0, 1.2 * scene.shadow_radius_um + 6, 12).astype(int)
        places = np.concatenate([np.stack([steps, 0 * steps], 1), np.stack([steps // 2, steps * 3 // 4], 1)])
        values = table.values[middle + places[:, 1], middle + places[:, 0]]
        if table.mode == "E":
            values = values * np.exp(-1j * math.pi * np.square(places).sum(1) / (scene.wavelength_um * scene.image_um))
        wanted = thin_lens(scene, places.astype(float))
        turn = np.vdot(values, wanted)
        values = values * turn / abs(turn)
        return float(np.linalg.norm(values - wanted) / np.linalg.norm(wanted))

    tangent, sine = off(1.0), off(0.0)
    assert tangent < 2e-3 and sine > 5 * tangent
