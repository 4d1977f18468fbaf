"""The coherent reference against Fresnel's integral summed as it stands (`tests.simulate.brute_force`).

At 12 samples a pixel they agree to 0.03 %, whatever the camera. The sum's own error is found by doubling its nodes, on
lenslets and on pixels, and by more lenslets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.threads import one_blas_thread
from lfcal.camera import LensletLattice, LensType, preset
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import scene_of
from tests.simulate.brute_force import Fineness, brute_force, lenslets
from tests.simulate.scenes import PIXEL, camera_scene, relative_error

SAMPLES = 12.0
AGREE = 3e-4
OWN = 1.5e-4
"""Relative L1 error that the sum may have itself."""
AT = (2 * PIXEL, -3 * PIXEL)

long = pytest.mark.long


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Products of small matrices lose by threads."""
    with one_blas_thread():
        yield


def hexagonal(v: float, pixels: float = 7, **changes: object) -> Scene:
    """Return lenslets of three types at f/5, in focus at v = 2, 3 and 5."""
    pitch = pixels * PIXEL
    lattice = LensletLattice(
        "hexagonal",
        pitch,
        5 * pitch,
        tuple(LensType.focused_at(depth, 5 * pitch) for depth in (2.0, 3.0, 5.0)),
        clear_um=pitch - 0.5 * PIXEL,
        rotation_rad=float(changes.pop("turn", 0.0)),  # type: ignore[arg-type]
        offset_um=changes.pop("offset", (0.0, 0.0)),  # type: ignore[arg-type]
    )
    return camera_scene(v, image_um=v * 5 * pitch, lattice=lattice, **({"cutout": (11, 11)} | changes))


def square(v: float, turn: float = 0.0) -> Scene:
    """Return square lenslets that fill the plane, behind an iris of six blades."""
    pitch = 7 * PIXEL
    lattice = LensletLattice("square", pitch, 5 * pitch, (LensType.focused_at(3.0, 5 * pitch),), rotation_rad=turn)
    iris = replace(camera_scene().iris, blades=6)
    return camera_scene(v, image_um=v * 5 * pitch, lattice=lattice, aperture="cell", iris=iris, cutout=(11, 11))


def camera(name: str, v: float, cutout: int) -> Scene:
    """Return a preset with its finite exit pupil."""
    return scene_of(preset(name), virtual_depth=v, cutout=(cutout, cutout))


CASES: dict[str, tuple[Callable[[], Scene], float]] = {
    "hexagonal v=2": (lambda: hexagonal(2.0), 190.0),
    "square cells": (lambda: square(2.0), 190.0),
}
LONG_CASES: dict[str, tuple[Callable[[], Scene], float]] = {
    "hexagonal v=4": (lambda: hexagonal(4.0), 260.0),
    "hexagonal v=-3": (lambda: hexagonal(-3.0), 260.0),
    "hexagonal, native plane": (lambda: hexagonal(0.0), 200.0),
    "hexagonal, 15 px": (lambda: hexagonal(3.0, 15, cutout=(31, 31)), 420.0),
    "turned, off the axis": (lambda: hexagonal(3.0, turn=0.3, offset=(9.7, -4.1), pixel_fill=0.8), 220.0),
    "square cells, turned": (lambda: square(-2.0, 0.2), 220.0),
    "pupil near the array": (lambda: hexagonal(2.5, pupil_um=900.0), 220.0),
    "bench": (lambda: camera("bench", 3.0, 21), 400.0),
    "r29": (lambda: camera("r29", 4.0, 41), 900.0),
}
EVERY = [*((n, c) for n, c in CASES.items()), *(pytest.param(n, c, marks=long) for n, c in LONG_CASES.items())]


def computed(scene: Scene, samples: float = SAMPLES) -> np.ndarray:
    return ReferencePlane(scene, Sampling(samples)).point(*AT)


@pytest.mark.parametrize(("name", "case"), EVERY)
@pytest.mark.few(1)
def test_reference_is_the_summed_integral_at_twelve_samples(name: str, case: tuple[Callable[[], Scene], float]) -> None:
    make, reach = case
    scene = make()
    wanted = brute_force(scene, AT, (2, -3), Fineness(reach_um=reach))
    assert relative_error(computed(scene), wanted) < AGREE


@long
@pytest.mark.parametrize("name", [*CASES, *(n for n in LONG_CASES if n not in ("bench", "r29", "hexagonal, 15 px"))])
def test_the_sum_has_converged(name: str) -> None:
    make, reach = (CASES | LONG_CASES)[name]
    scene, fine = make(), Fineness(reach_um=reach)
    found = brute_force(scene, AT, (2, -3), fine)
    for change in ({"nodes": 2.0}, {"pixel": 32}, {"reach_um": 1.5 * reach}):
        assert relative_error(found, brute_force(scene, AT, (2, -3), replace(fine, **change))) < OWN


def test_lenslets_lie_as_the_lattice_says() -> None:
    for scene in (hexagonal(2.0, turn=0.3, offset=(9.7, -4.1)), square(2.0, 0.2)):
        centres, kinds = lenslets(scene.lattice, (20.0, -30.0), 120.0)
        wanted, types = scene.lattice.lenslets_within(120.0, 120.0, (20.0, -30.0))
        near = np.hypot(*(wanted - (20.0, -30.0)).T) <= 120.0
        order, other = np.lexsort(centres.T.round(6)), np.lexsort(wanted[near].T.round(6))
        np.testing.assert_allclose(centres[order], wanted[near][other], atol=1e-9)
        assert (kinds[order] == types[near][other]).all()


@pytest.mark.long
def test_a_wrong_gap_shows() -> None:
    """A gap off by a hundredth of itself is far outside the bound."""
    scene = hexagonal(2.0)
    wrong = replace(scene, lattice=replace(scene.lattice, gap_um=1.01 * scene.gap_um))
    assert relative_error(computed(wrong), computed(scene)) > 10 * AGREE
