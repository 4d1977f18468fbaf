"""Planes seen by lenslets of three types, against frames drawn by the thin-lens equation alone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, Microscope, Sensor
from lfcal.lattice import lattice_of, render, sharpness_shares, total_focus
from lfcal.lattice._refocus import sensor_slope, slope_of_virtual_depth, virtual_depth_of_slope
from tests.lattice.test_micro_images import camera_of

SHAPE, PITCH, GAP, PIXEL = (260, 300), 24.0, 600.0, 5.0
FOCAL = tuple(GAP / (1 - 1 / v) for v in (2.0, 3.0, 6.0))
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def camera() -> Camera:
    lattice = LensletLattice("hexagonal", PITCH * PIXEL, GAP, tuple(map(LensType, FOCAL)), 0.03, (3.0, -8.0))
    return Camera("three types", Microscope(), lattice, Sensor(SHAPE, PIXEL))


@pytest.fixture(scope="module")
def texture() -> Array:
    """Return a random scene, one value a pixel of the sensor, twice as wide as the frame."""
    field = gaussian_filter(np.random.default_rng(5).normal(size=(2 * SHAPE[0], 2 * SHAPE[1])), 3.5)
    return 100 + 40 * field / field.std()


def scene(texture: Array, y: Array, x: Array) -> Array:
    return map_coordinates(texture, [y + SHAPE[0] / 2, x + SHAPE[1] / 2], order=1, mode="nearest")


def draw(camera: Camera, texture: Array, depth_left: float, depth_right: float) -> Array:
    """Draw the frame of two half planes at virtual depths, parted by the middle column.

    Lenslet of focal length f and diameter d, sensor B behind it: light that would meet at a = v B behind the lenslet
    meets at s, 1/s = 1/f + 1/a; on the sensor it fills a disc of diameter d |1 - B/s|.
    """
    lattice = camera.lattice
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    nearest, centre, focal = np.full(SHAPE, np.inf), np.zeros((*SHAPE, 2)), np.zeros(SHAPE)
    for q, r in itertools.product(range(-14, 15), repeat=2):
        here = camera.pixels(lattice.centres_um(q, r))
        away = np.hypot(y - here[0], x - here[1])
        mine = away < nearest
        nearest[mine], centre[mine], focal[mine] = away[mine], here, FOCAL[int(lattice.type_of(q, r))]
    ring = [(0.0, 0.0)]
    for radius, n in ((0.25, 6), (0.42, 10)):
        angles = 2 * np.pi * np.arange(n) / n
        ring += list(zip(radius * np.cos(angles), radius * np.sin(angles), strict=True))
    shown = np.zeros(SHAPE)
    for v, left in ((depth_left, True), (depth_right, False)):
        a = v * GAP
        disc = PITCH * np.abs(1 - GAP * (1 / focal + 1 / a))
        value, total = np.zeros(SHAPE), np.zeros(SHAPE)
        for down, right in ring:
            sy = centre[..., 0] + v * (y + disc * down - centre[..., 0])
            sx = centre[..., 1] + v * (x + disc * right - centre[..., 1])
            on = (sx < SHAPE[1] / 2) == left
            value += np.where(on, scene(texture, sy, sx), 0)
            total += on
        shown += np.where(total > len(ring) / 2, value / np.maximum(total, 1), 0)
    return shown


def places(planes) -> tuple[Array, Array]:
    rows, columns = (
        planes.grid.corner_px[k] + planes.grid.step_px[k] * ((np.arange(n) + 0.5) / planes.samples - 0.5)
        for k, n in enumerate(planes.images.shape[1:])
    )
    return np.meshgrid(rows, columns, indexing="ij")


def likeness(image: Array, wanted: Array) -> float:
    inner = (slice(12, -12), slice(12, -12))
    seen = image[inner] != 0
    return float(np.corrcoef(image[inner][seen], wanted[inner][seen])[0, 1])


@pytest.mark.long
@pytest.mark.parametrize("depth", [2.1, 3.4, 6.0])
def test_the_types_in_focus_decide(camera: Camera, texture: Array, depth: float) -> None:
    frame = draw(camera, texture, depth, depth)
    lattice, type_of = lattice_of(camera), camera.lattice.type_of
    one = [render(frame, lattice, [depth], type_of=type_of, shares=[np.eye(3)[k]], samples=4) for k in range(3)]
    together = render(frame, lattice, [depth], type_of=type_of, shares=[sharpness_shares(camera, depth)], samples=4)
    wanted = scene(texture, *places(together))
    each = [likeness(planes.images[0], wanted) for planes in one]
    blur = [abs(1 - GAP * (1 / f + 1 / (depth * GAP))) for f in FOCAL]
    assert np.argmax(each) == np.argmin(blur) and np.argmin(each) == np.argmax(blur)
    alike = likeness(render(frame, lattice, [depth], samples=4).images[0], wanted)
    best = likeness(together.images[0], wanted)
    assert best > 0.97 and best > alike and best > max(each) - 0.01


def test_planes_are_sharp_at_their_own_depth(camera: Camera, texture: Array) -> None:
    frame = draw(camera, texture, 3.4, 3.4)
    slopes = [2.4, 2.9, 3.4, 3.9, 4.4]
    shares = [sharpness_shares(camera, w) for w in slopes]
    planes = render(frame, lattice_of(camera), slopes, type_of=camera.lattice.type_of, shares=shares)
    wanted = scene(texture, *places(planes))
    assert np.argmax([likeness(image, wanted) for image in planes.images]) == 2
    inner = planes.disagreement[:, 12:-12, 12:-12]
    assert np.isfinite(inner[1:]).all() and np.argmin(np.median(inner, (1, 2))) == 2


@pytest.mark.long
def test_all_in_focus_finds_two_depths(camera: Camera, texture: Array) -> None:
    frame = draw(camera, texture, 2.2, 4.5)
    slopes = [2.2, 2.8, 3.5, 4.5, 5.5]
    shares = [sharpness_shares(camera, w) for w in slopes]
    planes = render(frame, lattice_of(camera), slopes, type_of=camera.lattice.type_of, shares=shares)
    image, slope = total_focus(planes)
    y, x = places(planes)
    left, right = x < SHAPE[1] / 2 - 30, x > SHAPE[1] / 2 + 30
    inner = np.zeros(image.shape, bool)
    inner[12:-12, 12:-12] = True
    assert (slope[left & inner] == np.float32(2.2)).mean() > 0.85
    assert (slope[right & inner] == np.float32(4.5)).mean() > 0.85
    wanted = scene(texture, y, x)
    for part in (left & inner, right & inner):
        assert np.corrcoef(image[part], wanted[part])[0, 1] > 0.95
    # no single plane shows both
    assert all(likeness(one, wanted) < likeness(image, wanted) for one in planes.images)


def test_the_white_frame_divides_its_light_out(camera: Camera) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    white = 1000 * (1 - 0.5 * ((y - 130) ** 2 + (x - 150) ** 2) / 200**2) + 100
    planes = render(0.5 * (white - 100) + 100, lattice_of(camera), [3.0, -3.0], white=white, dark=100.0, samples=2)
    assert planes.images.std() / planes.images.mean() < 1e-3
    assert np.nanmax(planes.disagreement[np.isfinite(planes.disagreement)]) < 1e-2 * planes.images.mean() ** 2


def test_depths_and_slopes_are_each_other_s_inverse() -> None:
    camera = camera_of("hexagonal")
    for v in (-5.0, 2.0, 5.5):
        assert slope_of_virtual_depth(camera, v) == pytest.approx(sensor_slope(camera, camera.depth_of(v)))
        assert virtual_depth_of_slope(camera, sensor_slope(camera, camera.depth_of(v))) == pytest.approx(v)
    with pytest.raises(InputError, match="slope"):
        virtual_depth_of_slope(camera, 1e4)
    best = [int(np.argmax(sharpness_shares(camera, v))) for v in (2.0, 3.0, 5.0)]
    assert best == [0, 1, 2]


def test_what_cannot_be_rendered_is_refused(camera: Camera) -> None:
    frame, lattice = np.ones(SHAPE), lattice_of(camera)
    with pytest.raises(InputError, match=r"below -1.5 or above 1.5, got 1;"):
        render(frame, lattice, [1.0])
    with pytest.raises(InputError, match="light-field frame"):
        render(frame[1:], lattice, [2.0])
    with pytest.raises(InputError, match="white frame"):
        render(frame, lattice, [2.0], white=frame[1:])
    with pytest.raises(InputError, match="samples"):
        render(frame, lattice, [2.0], samples=0)
    with pytest.raises(InputError, match="planes"):
        total_focus(render(frame, lattice, []))
