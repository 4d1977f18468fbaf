"""The step and the cutout compared with rays that are traced one by one: thin lens, lenslets, sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor, half_extent_px, preset
from lfcal.camera.shadow import _edge_slope

Array = NDArray[np.float64]


def lenslets(camera: Camera, reach: float) -> tuple[Array, NDArray[np.intp]]:
    """Centres of the lenslets themselves (in their own plane) within ``reach`` pitches, and their types."""
    box = reach * camera.lattice.pitch_um
    centres, types = camera.lattice.lenslets_within(box, box)
    return centres / camera.lattice_scale, types


def pinhole_pattern(camera: Camera, source: Array, distance: float) -> tuple[Array, NDArray[np.intp]]:
    """Sensor points lit through lenslets taken as pinholes: rays from ``source`` over the pupil.

    A ray from the source through pupil point p leaves the thin lens with slope changed by -p/f. The pupil
    point whose ray meets pinhole c solves one linear equation; it must lie in the pupil.
    """
    optics = camera.optics
    assert isinstance(optics, MainLens)
    b, gap = optics.image_distance_um, camera.lattice.gap_um
    centres, types = lenslets(camera, 25)
    # meets the array at p + b * ((p - source)/distance - p/f) = c
    scale = 1 + b / distance - b / optics.focal_length_um
    pupil = (centres + b * source / distance) / scale
    slope = (pupil - source) / distance - pupil / optics.focal_length_um
    lit = np.hypot(*pupil.T) <= optics.focal_length_um / optics.f_number / 2
    return (centres + gap * slope)[lit], types[lit]


def sorted_rows(points: Array) -> Array:
    order = np.lexsort((points[:, 0].round(3), points[:, 1].round(3)))
    rows: Array = points[order]
    return rows


@pytest.mark.parametrize("name", ["r29", "bench"])
def test_one_period_of_steps_moves_the_pattern_by_one_period_of_micro_images(name: str) -> None:
    camera, start = preset(name), np.array([-310.0, 120.0])
    pitch_y, pitch_x = camera.lattice.period_um
    for z_um in (-120e3, -52e3, -20e3, 30e3, 44e3, 150e3):
        distance = camera.optics.working_distance_um + z_um
        here, types = pinhole_pattern(camera, start, distance)
        for shift in (np.array([pitch_x, 0.0]), np.array([0.0, pitch_y])):
            # the image moves against the object: a step of the image to the right is one of the object to the left
            step = -camera.step_um(z_um) * shift / camera.sensor.pixel_um
            there, types_there = pinhole_pattern(camera, start + step, distance)
            assert len(here) == len(there) > 0
            assert np.allclose(sorted_rows(here + shift), sorted_rows(there), atol=1e-6)
            assert np.array_equal(np.sort(types), np.sort(types_there)), z_um


def test_the_magnification_of_the_image_plane_would_not_be_periodic() -> None:
    """Counter-test: steps by the paraxial magnification to the array are off by the pitch's 1 + B/b."""
    camera = preset("r29")
    assert isinstance(camera.optics, MainLens)
    z = -52e3
    distance = camera.optics.working_distance_um + z
    naive = camera.sensor.pixel_um * distance / camera.optics.image_distance_um
    cells = 30
    error_px = cells * camera.period_px[1] * (naive / camera.step_um(z) - 1)
    assert error_px == pytest.approx(9.95, abs=0.1)


def test_a_telecentric_microscope_steps_by_the_magnification_at_every_depth() -> None:
    for camera in map(preset, ("lfm_20x05", "lfm_60x12")):
        assert {camera.step_um(z) for z in (-20.0, 0.0, 35.0)} == {camera.sensor.pixel_um / camera.magnification}


def traced_extent_px(camera: Camera, z_um: float) -> float:
    """Largest distance from the chief ray on the sensor over rays through pupil and lenslets, for many places."""
    optics = camera.optics
    assert isinstance(optics, MainLens)
    b, gap, distance = optics.image_distance_um, camera.lattice.gap_um, optics.working_distance_um + z_um
    n = optics.blades or 400
    radius = optics.focal_length_um / optics.f_number / 2
    if optics.blades:
        radius *= math.sqrt(math.pi / (n / 2 * math.sin(2 * math.pi / n)))
    angle = 2 * np.pi * np.arange(n) / n
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    pupil = np.concatenate([rim * k for k in np.linspace(0, 1, 40)])
    centres, types = lenslets(camera, 8)
    focal = np.array([t.focal_length_um for t in camera.lattice.types])[types]
    clear = camera.lattice.clear_diameter_um / camera.lattice_scale / 2
    worst = 0.0
    for place in np.random.default_rng(1).uniform(-500, 500, (15, 2)):
        slope = (pupil - place) / distance - pupil / optics.focal_length_um
        hit = pupil + b * slope
        chief = (b + gap) * -place / distance
        offset = hit[:, None] - centres[None]
        nearest = np.hypot(*offset.transpose(2, 0, 1)).argmin(1)
        local = hit - centres[nearest]
        spot = hit + gap * (slope - local / focal[nearest, None])
        through = np.hypot(*local.T) <= clear
        worst = max(worst, float(np.abs(spot - chief)[through].max()))
    return worst / camera.sensor.pixel_um


@pytest.mark.parametrize(
    ("name", "v"), [("r29", 1.1), ("r29", 5.5), ("r29", -3.0), ("r29", 0.3), ("r29", -0.3), ("bench", 4.0)]
)
def test_the_cutout_contains_every_ray_and_little_more(name: str, v: float) -> None:
    camera = preset(name)
    z = camera.depth_of(v)
    airy = 1.22 * camera.wavelength_um * camera.lattice.gap_um / camera.lattice.clear_diameter_um
    margin = 3 * airy / camera.sensor.pixel_um
    bound, traced = half_extent_px(camera, z), traced_extent_px(camera, z)
    assert traced <= bound - 0.9 * margin
    # the bound takes corner and lenslet edge in line, which the sampled places may miss
    assert bound - margin - traced < 0.35 * camera.pitch_px


def test_shadow_of_the_paper_s_camera() -> None:
    camera = preset("r29")
    # a/Nw = 4 * 871.75/5 um = 126.8 px for a circular iris far from the array
    circular = Camera("c", MainLens(200e3, 4.0, 1e6, blades=0), camera.lattice, camera.sensor)
    shadow_um, _ = _edge_slope(circular, camera.depth_of(4.0))
    assert 2 * shadow_um / camera.sensor.pixel_um == pytest.approx(126.8 / (1 + 4 * 871.75 / 250e3), rel=1e-3)
    assert ScanPlan.for_camera(camera, virtual_depths=[5.5]).cutout[0] == pytest.approx(181, abs=4)


def test_extent_of_a_microscope_follows_the_sine_condition() -> None:
    lattice = LensletLattice("square", 125.0, 2500.0, (LensType(2500.0),))
    base = preset("lfm_20x05")
    camera = Camera("m", base.optics, lattice, Sensor((500, 500), 125 / 15), 1e-1)
    assert _edge_slope(camera, 25.0)[0] == pytest.approx(20 * 25 * math.tan(math.pi / 6))
    assert _edge_slope(camera, -25.0) == _edge_slope(camera, 25.0)
    # behind the array the cone has opened further by the time it meets the sensor
    assert half_extent_px(camera, 25.0) - half_extent_px(camera, -25.0) == pytest.approx(2 * 2500 * 0.025 / (125 / 15))
