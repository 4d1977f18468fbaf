"""Scenes in which light leaves the grid, falls between samples, or is steeper than rays near the axis."""

from __future__ import annotations

from dataclasses import replace

from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.reference import ReferencePlane
from tests.hard_cases.record import hard_case, worst
from tests.simulate.scenes import PIXEL, camera_scene, relative_error

ERROR = "relative L1 deviation from the coherent reference"
STEEP = camera_scene(0.0, cutout=(25, 25), period=(1, 1), exact_rays=True, exact_defocus=True, f_number=2.2)


def on_grid(scene, samples=5, margin=20):
    """Return the response of a source a third of a pixel beside a pixel's middle."""
    return GridPlane(scene, Sampling(samples_per_px=samples, margin_px=margin)).point(PIXEL / 3, 0.0)


def reference(scene):
    """Return the same by the reference."""
    return ReferencePlane(scene, Sampling(samples_per_px=7)).point(PIXEL / 3, 0.0)


@hard_case(
    "Cutout smaller than the pattern",
    wrong="light that leaves the grid on one side re-enters on the other side",
    measure=ERROR,
    bound=0.01,
)
def test_small_cutout():
    scene = camera_scene(-3.0, cutout=(31, 31), period=(1, 1))
    return relative_error(on_grid(scene), reference(scene))


@hard_case(
    "Even and odd numbers of samples per pixel",
    wrong="the samples of a pixel are displaced by half a sample",
    measure=ERROR + ", the larger one of 6 and 7 samples",
    bound=0.005,
)
def test_even_samples():
    scene = camera_scene(3.0, cutout=(31, 31), period=(1, 1))
    wanted = reference(scene)
    return worst(*(relative_error(on_grid(scene, samples), wanted) for samples in (6, 7)))


@hard_case(
    "Few samples per pixel",
    wrong="samples shared by two pixels have a wrong weight, so light is created or lost",
    measure="fraction of the light of a wide cutout that is created or lost between array and pixels",
    bound=2e-4,
)
def test_light_between_pixels():
    scene = camera_scene(3.0, cutout=(91, 91), period=(1, 1), wavelength_um=0.7)
    engine = GridPlane(scene, Sampling(samples_per_px=3, margin_px=20))
    engine.point(0.0, 0.0)
    book = engine.certificate
    return abs(book.energy_out / book.energy_in - 1)


@hard_case(
    "Fast lens on the native plane, exact angles",
    wrong="rays have no defined direction there, so angles remain paraxial: an error of 2.6 %",
    measure=ERROR,
    bound=0.01,
)
def test_steep_and_near():
    scene = replace(STEEP, pixel_um=PIXEL / 2)
    return relative_error(on_grid(scene), reference(scene))
