"""A tilted array: rays by exact geometry, fields on it against plane waves, and engines against each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.simulate._symmetry import is_mirror_symmetric, is_separable
from lfcal.simulate.effects import ArrayTilt, LensletDiffraction
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.engines.tilted import TiltedArray
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import BASE, small_camera, small_plan, switched
from tests.simulate.scenes import camera_scene, microscope_scene, moments, relative_error

TILT = (0.01, -0.02)


def edge_plan(v: float) -> ScanPlan:
    return small_plan(v, small_camera(160, 3000), anchor=(70.0, 2800.0))


@pytest.mark.few(2)
@pytest.mark.parametrize("v", [4.0, -3.0, 2.2, 0.5])
@pytest.mark.parametrize("tilt", [(0.0, 1e-3), (4e-3, -3e-3)])
def test_estimate_is_honest(v: float, tilt: tuple[float, float]) -> None:
    plan, effect = edge_plan(v), ArrayTilt(*tilt)
    measured = switched(plan, effect)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


@pytest.mark.few(1)
@pytest.mark.parametrize("v", [4.0, -3.0])
def test_estimate_on_the_axis_is_that_of_the_lenslets_between(v: float) -> None:
    plan, effect = small_plan(v, small_camera(300, 300)), ArrayTilt(0.05, 0.0)
    measured = switched(plan, effect)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_the_region_has_the_gap_and_the_image_of_its_place() -> None:
    plan = edge_plan(4.0)
    plain, tilted = (PlaneResponse(plan, 0, (*BASE, *more)).scene for more in ((), (ArrayTilt(2e-3, 1e-3),)))
    y, x = outlook_of(plan, 0).field_um
    farther = 2e-3 * y + 1e-3 * x
    assert farther > 5
    assert tilted.gap_um - plain.gap_um == pytest.approx(farther)
    assert tilted.image_um - plain.image_um == pytest.approx(farther)
    assert plain.pupil_um - tilted.pupil_um == pytest.approx(farther)


def test_rays_through_lenslets_land_where_straight_lines_do() -> None:
    """By similar triangles for each lenslet at its own height: (a + d)/(B + d) from the image to the sensor."""
    scene = camera_scene(4.0, cutout=(81, 81), lenslet_diffraction=False)
    # in focus at v = 2, all of them: spots of two pixels' radius
    scene = replace(scene, lattice=replace(scene.lattice, types=scene.lattice.types[:1]))
    y, x = 3, 7
    images = [engine_for(s, "geometric").rows([y], [x])[0, 0] for s in (scene, replace(scene, tilt=TILT))]
    middle = np.array([(n - 1) / 2 for n in scene.period[::-1]]) * scene.pixel_um
    source = np.array([x, y]) * scene.pixel_um
    reach = scene.shadow_radius_um - scene.clear_radius_um
    centres, _ = scene.lattice.lenslets_within(reach, reach, (x * scene.pixel_um, y * scene.pixel_um))
    moved = []
    for c in centres:
        if np.hypot(*(c - source)) > reach:
            continue
        d = float((c - middle) @ np.array(TILT[::-1]))
        flat, lands = (c + (scene.gap_um + k) / (scene.image_um + k) * (source - c) for k in (0.0, d))
        # a window of 9 pixels holds one spot, and nothing of the next
        column, row = np.round((lands - source) / scene.pixel_um).astype(int) + 40
        places = [np.array(moments(image[row - 4 : row + 5, column - 4 : column + 5]))[::-1] for image in images]
        moved.append(((places[1] - places[0]) * scene.pixel_um, lands - flat))
    found, wanted = np.array(moved).transpose(1, 0, 2)
    assert len(found) > 4 and np.abs(wanted).max() > 0.1
    assert np.abs(found - wanted).max() < 0.1 * np.abs(wanted).max()


@pytest.mark.few(1)
@pytest.mark.parametrize("exact", [False, True])
def test_windows_follow_it_in_part(exact: bool) -> None:
    """Windows take each lenslet at its own height, and parallel to the sensor: about half of what a tilt does."""
    flat = camera_scene(6.0, cutout=(45, 45), exact_rays=exact, exact_defocus=exact)
    tilted = replace(flat, tilt=(0.03, -0.04))
    by_windows, by_grid = (
        [engine_for(scene, level, sampling).rows([3], [20])[0, 0] for scene in (flat, tilted)]
        for level, sampling in (
            ("wave", Sampling(4, 4, 12, coherent=True)),
            ("grid", Sampling(samples_per_px=6, margin_px=24)),
        )
    )
    effect = relative_error(*by_grid)
    assert effect > 0.02
    assert relative_error(by_windows[1], by_grid[1]) < relative_error(by_windows[0], by_grid[0]) + 0.5 * effect


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("v", [3.0, 0.3])
@pytest.mark.parametrize("exact", [False, True])
def test_the_grid_follows_it_as_the_reference_does(v: float, exact: bool) -> None:
    flat = camera_scene(v, cutout=(33, 33), exact_rays=exact, exact_defocus=exact)
    tilted = replace(flat, tilt=(0.017, -0.01))
    grid = Sampling(samples_per_px=6, margin_px=24)
    by_grid, by_reference = (
        [engine_for(scene, level, sampling).rows([3], [20])[0, 0] for scene in (flat, tilted)]
        for level, sampling in (("grid", grid), ("reference", Sampling(6.0)))
    )
    assert relative_error(*by_reference) > 0.005
    assert relative_error(by_grid[1], by_reference[1]) < relative_error(by_grid[0], by_reference[0]) + 3e-4


def field_on(scene: Scene) -> tuple[TiltedArray, np.ndarray, float, np.ndarray]:
    """Return an array, how far its samples lie, the samples' distance, and their places (y, x)."""
    n, dx = 96, 0.9
    axis = (np.arange(n) - n // 2) * dx
    farther = scene.farther_at(axis[:, None], axis[None, :])
    return TiltedArray(scene, n, dx, n / 2 * dx, np.complex128), farther, dx, axis


@pytest.mark.parametrize("exact", [False, True])
def test_a_plane_wave_is_met_where_the_array_lies(exact: bool) -> None:
    """By its formula: exp(2 pi i (s r - d (sqrt(1 - s²) - 1))/lambda) at a point r that lies d before the plane."""
    scene = camera_scene(3.0, tilt=(0.05, -0.03), exact_rays=exact)
    tilted, farther, dx, axis = field_on(scene)
    heights = tilted.heights(farther)
    for turns in ((0, 0), (8, -11)):
        f = np.array(turns) / (axis.size * dx)
        sines2 = float(f @ f) * scene.wavelength_um**2
        assert sines2 < 0.1
        longer = np.sqrt(1 - sines2) - 1 if exact else -sines2 / 2
        plane = np.exp(2j * np.pi * (f[0] * axis[:, None] + f[1] * axis[None, :]))
        wanted = plane * np.exp(-2j * np.pi / scene.wavelength_um * farther * longer)
        assert np.abs(tilted.met(tilted.parts(plane), heights) - wanted).max() < 5e-4
        # and from there to the plane again
        back = np.fft.ifft2(tilted.left(wanted.copy(), heights))
        assert np.abs(back - plane)[8:-8, 8:-8].max() < 0.02  # a slope is not periodic: its border spreads


def test_leaving_is_the_adjoint_of_meeting() -> None:
    rng = np.random.default_rng(0)
    tilted, farther, _, axis = field_on(camera_scene(3.0, tilt=(0.02, 0.01)))
    heights = tilted.heights(farther)
    e, b = (rng.standard_normal((2, axis.size, axis.size, 2)) @ [1, 1j])[:2]
    on_array = np.vdot(b, tilted.met(tilted.parts(e), heights))
    on_plane = np.vdot(np.fft.ifft2(tilted.left(b.copy(), heights)), e)
    assert on_array == pytest.approx(on_plane, rel=1e-10)


def test_a_tilt_too_far_for_any_polynomial_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"array tilt: expected a smaller tilt over the lit lenslets, got 0\.5 rad over"
    ):
        engine_for(camera_scene(6.0, tilt=(0.5, 0.0)), "grid")


@pytest.mark.long
def test_cells_are_bent_too() -> None:
    flat = camera_scene(6.0, cutout=(45, 45), aperture="cell")
    tilted = replace(flat, tilt=(0.03, -0.04))
    wave, grid = (
        engine_for(tilted, level, sampling).rows([3], [20])[0, 0]
        for level, sampling in (
            ("wave", Sampling(4, 4, 12, coherent=True)),
            ("grid", Sampling(samples_per_px=6, margin_px=24)),
        )
    )
    plain = engine_for(flat, "grid", Sampling(samples_per_px=6, margin_px=24)).rows([3], [20])[0, 0]
    assert relative_error(wave, grid) < 0.65 * relative_error(plain, grid)


def test_nothing_is_mirrored_or_separated() -> None:
    def upright(**more: object) -> Scene:
        return camera_scene(period=(26, 45), iris=camera_scene().iris.__class__(), **more)

    assert is_mirror_symmetric(upright()) and not is_mirror_symmetric(upright(tilt=(1e-3, 0.0)))
    assert is_separable(microscope_scene()) and not is_separable(microscope_scene(tilt=(1e-3, 0.0)))


def test_an_array_that_meets_the_sensor_is_refused() -> None:
    with pytest.raises(InputError, match="array tilt") as error:
        PlaneResponse(edge_plan(4.0), 0, (LensletDiffraction(), ArrayTilt(0.0, -0.2)))
    assert "\n" not in str(error.value)
