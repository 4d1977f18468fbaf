"""The coherent reference against Fresnel's integral as a plain sum (`tests.simulate.brute_force`), and its parts.

With 12 samples per pixel they agree to 0.03 %, whatever the camera. The error of the sum itself is measured by
doubling its nodes, on lenslets and on pixels, and with more lenslets.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import InputError, one_blas_thread
from lfcal.camera import LensletLattice, LensType, preset
from lfcal.simulate import Sampling
from lfcal.simulate.engines import reference
from lfcal.simulate.engines.reference import ReferencePlane, pixel_bins
from lfcal.simulate.scene import PupilIris, Scene
from lfcal.simulate.staging import scene_of
from tests.simulate.brute_force import Fineness, brute_force, lenslets
from tests.simulate.scenes import PIXEL, camera_scene, microscope_scene, moments, relative_error

SAMPLES = 12.0
AGREE = 3e-4
OWN = 1.5e-4
"""Relative L1 error that the sum may have itself."""

AT = (2 * PIXEL, -3 * PIXEL)


def hexagonal(v: float, pixels: float = 7, **changes: object) -> Scene:
    """Return lenslets of three types at f/5, in focus at v = 2, 3 and 5."""
    pitch = pixels * PIXEL
    lattice = LensletLattice(
        "hexagonal",
        pitch,
        5 * pitch,
        tuple(LensType.focused_at(depth, 5 * pitch) for depth in (2.0, 3.0, 5.0)),
        clear_um=pitch - 0.5 * PIXEL,
        rotation_rad=float(changes.pop("turn", 0.0)),
        offset_um=changes.pop("offset", (0.0, 0.0)),
    )
    return camera_scene(v, image_um=v * 5 * pitch, lattice=lattice, **({"cutout": (11, 11)} | changes))


def square(v: float, turn: float = 0.0) -> Scene:
    """Return square lenslets that fill the plane, behind an iris of six blades."""
    pitch = 7 * PIXEL
    lattice = LensletLattice("square", pitch, 5 * pitch, (LensType.focused_at(3.0, 5 * pitch),), rotation_rad=turn)
    iris = replace(camera_scene().iris, blades=6)
    return camera_scene(v, image_um=v * 5 * pitch, lattice=lattice, aperture="cell", iris=iris, cutout=(11, 11))


def photographic(name: str, v: float, cutout: int) -> Scene:
    """Return a preset with its finite exit pupil."""
    return scene_of(preset(name), virtual_depth=v, cutout=(cutout, cutout))


CASES: dict[str, tuple[Callable[[], Scene], float]] = {
    "hexagonal v=2": (lambda: hexagonal(2.0), 190.0),
    "square cells": (lambda: square(2.0), 190.0),
    "hexagonal v=4": (lambda: hexagonal(4.0), 260.0),
    "hexagonal v=-3": (lambda: hexagonal(-3.0), 260.0),
    "hexagonal, native plane": (lambda: hexagonal(0.0), 200.0),
    "turned, off the axis": (lambda: hexagonal(3.0, turn=0.3, offset=(9.7, -4.1), pixel_fill=0.8), 220.0),
    "square cells, turned": (lambda: square(-2.0, 0.2), 220.0),
    "pupil near the array": (lambda: hexagonal(2.5, pupil_um=900.0), 220.0),
    "hexagonal, 15 px": (lambda: hexagonal(3.0, 15, cutout=(31, 31)), 420.0),
    "bench": (lambda: photographic("bench", 3.0, 21), 400.0),
    "r29": (lambda: photographic("r29", 4.0, 41), 900.0),
}
"""Scenes and how far (µm) from the source their lenslets are summed; the first runs without --long."""
EVERY = [pytest.param(name, marks=[pytest.mark.long] if k else []) for k, name in enumerate(CASES)]


def computed(scene: Scene) -> np.ndarray:
    return ReferencePlane(scene, Sampling(SAMPLES)).point(*AT)


@pytest.mark.parametrize("name", EVERY)
def test_the_reference_is_the_summed_integral(name: str) -> None:
    make, reach = CASES[name]
    with one_blas_thread():  # products of small matrices lose by threads
        wanted = brute_force(make(), AT, (2, -3), Fineness(reach_um=reach))
    assert relative_error(computed(make()), wanted) < AGREE


@pytest.mark.long
@pytest.mark.parametrize("name", list(CASES)[:-3])
def test_the_sum_has_converged(name: str) -> None:
    make, reach = CASES[name]
    scene, fine = make(), Fineness(reach_um=reach)
    with one_blas_thread():
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


def test_pixel_weights_integrate_what_is_band_limited():
    n, per_px = 60, 4
    x = np.arange(n) / per_px
    for fill, first in ((1.0, 24.0), (0.7, 21.3)):
        bins = pixel_bins(n, per_px, 3, first, fill)
        centres = first / per_px + np.arange(3)
        for waves in (0, 4, 13):
            f = waves / (n / per_px)
            wanted = fill * np.sinc(f * fill) * np.cos(2 * np.pi * f * centres + 0.3)
            assert np.abs(bins @ np.cos(2 * np.pi * f * x + 0.3) - wanted).max() < 1e-14
    half_weights = np.array([0.5, 1, 1, 1, 0.5]) / per_px  # the trapezoid rule is far off at one wave per pixel
    wave = np.cos(2 * np.pi * 0.9 * np.arange(-2, 3) / per_px)
    assert abs(half_weights @ wave - np.sinc(0.9)) > 0.1 * np.sinc(0.9)


def test_rows_are_points_and_follow_the_source():
    scene = camera_scene(2.5, cutout=(45, 45), iris=PupilIris())
    engine = ReferencePlane(scene, Sampling(5.0))
    row = engine.rows([1], [2, 47])[0]
    assert np.array_equal(row[0], engine.point(1 * PIXEL, 2 * PIXEL))
    assert relative_error(row[1], row[0]) < 1e-5  # a period of the array further
    between = engine.point(1 * PIXEL, 2.3 * PIXEL)
    assert 0 < moments(row[0])[1] - moments(between)[1] + 0.3 < 0.6
    certificate = engine.certificate
    assert certificate.responses == 4
    assert certificate.energy_out <= certificate.energy_in


def test_samplings_that_no_grid_has_are_refused():
    with pytest.raises(InputError, match="whole number"):
        ReferencePlane(camera_scene(), Sampling(2.5))
    with pytest.raises(InputError, match="samples on each side"):
        ReferencePlane(camera_scene(400.0), Sampling(8.0))


def test_lenslets_that_lie_alike_on_the_grid_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    lattice = LensletLattice("square", 72.0, 1440.0, (LensType(1440.0),), offset_um=(3.0, -11.0))
    scene = microscope_scene(0.0, lattice=lattice, cutout=(21, 21))
    made = []
    own = ReferencePlane._lens_at
    monkeypatch.setattr(ReferencePlane, "_lens_at", lambda *given: made.append(given) or own(*given))
    held = ReferencePlane(scene, Sampling(samples_per_px=2)).rows([2], [3])
    assert len(made) == 1
    monkeypatch.setattr(ReferencePlane, "_lens", own)
    again = ReferencePlane(scene, Sampling(samples_per_px=2)).rows([2], [3])
    assert relative_error(held, again) < 1e-7


def test_lenslets_that_lie_otherwise_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "REFERENCE_CACHE_BYTES", 1e6)
    engine = ReferencePlane(camera_scene(2.5, cutout=(45, 45)), Sampling(5.0))
    engine.rows([1], [2])
    assert 0 < sum(lens.nbytes for lens in engine._cached.values()) <= 1e6
