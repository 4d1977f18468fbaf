"""Views, refocusing and planes of frames, on lattices of cameras, of parts of sensors and of single lens types."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Microscope, Sensor
from lfcal.lattice import (
    cropped,
    extract_views,
    fit_lattice,
    lattice_of,
    render,
    sharpness_shares,
    total_focus,
    type_lattice,
)
from lfcal.lattice._refocus import refocus, sensor_slope, slope_of_virtual_depth, virtual_depth_of_slope
from lfcal.lattice.fit import LatticeFit
from tests.lattice.lattices import Straight
from tests.lattice.white_frames import WhiteFrame, draw_white

REAL = Path(__file__).parents[3] / "shared/data/lfm_guv"
needs_real = pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")


def clean(kind: str, **options: Any) -> tuple[WhiteFrame, LatticeFit]:
    """Return a noiseless white image and its lattice, the same objects for the same options."""
    return _clean(kind, tuple(sorted(options.items())))


@cache
def _clean(kind: str, options: tuple[tuple[str, Any], ...]) -> tuple[WhiteFrame, LatticeFit]:
    how = {"dead": 0.0, "falloff": 0.0, "dark": 0.0, "snr": 200.0, **dict(options)}
    truth = draw_white((400, 420), kind=kind, **how)
    return truth, fit_lattice(truth.frame)


def scene_frame(fit: LatticeFit, scene: Any, slope: float) -> NDArray[np.float32]:
    """Draw a frame whose every pixel p shows ``scene(x, y)`` at S = c + w (p - c), c the nearest lenslet's centre."""
    y, x = np.mgrid[: fit.shape[0], : fit.shape[1]].astype(float)
    index = np.rint(fit.lenslet_at(y, x))
    best, centres = np.full(fit.shape, np.inf), np.zeros((*fit.shape, 2))
    for i, j in itertools.product((-1, 0, 1), repeat=2):
        here = fit.centres_px(index[..., 0] + i, index[..., 1] + j)
        distance = np.hypot(here[..., 0] - y, here[..., 1] - x)
        near = distance < best
        best[near], centres[near] = distance[near], here[near]
    row = centres[..., 0] + slope * (y - centres[..., 0])
    column = centres[..., 1] + slope * (x - centres[..., 1])
    return np.asarray(scene(column, row), np.float32)


@pytest.mark.long
def test_pixels_beyond_the_radius_have_no_weight() -> None:
    truth, fit = clean("square")
    for white in (None, truth.frame):
        views = extract_views(truth.frame, fit, white=white, radius_px=4.0)
        beyond = np.hypot(views.offsets[:, None], views.offsets[None, :]) > 4.0
        assert beyond.any() and not views.weights[beyond].any()
        assert (views.weights[~beyond] > 0).any(axis=(1, 2)).all()


@pytest.mark.parametrize("axes", ["frame", "lattice"])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.few(1)
def test_every_view_of_a_plane_in_the_lenslets_is_that_plane(kind: str, axes: str) -> None:
    """Slope 0: the light below a lenslet is one value. Linear scenes survive the resampling exactly."""
    _, fit = clean(kind, rotation=0.004)
    frame = scene_frame(fit, lambda x, y: 2 * x - 3 * y + 5000, 0.0)
    views = extract_views(frame, fit, radius_px=5.0, axes=axes)
    assert views.images.dtype == np.float32
    middle = views.central
    spread = [np.abs(views.images[j, i] - middle).max() for j, i in ((5, 8), (8, 5), (2, 5), (5, 2), (7, 7))]
    assert max(spread) < 0.05
    down, right = views.step_px
    turn = views.rotation_rad
    assert turn == (fit.rotation_rad if axes == "lattice" else 0.0)
    # samples at the border may contain what lenslets next to them see
    middle = middle[1:-1, 1:-1]
    along = right * (2 * math.cos(turn) - 3 * math.sin(turn))
    across = down * (-2 * math.sin(turn) - 3 * math.cos(turn))
    assert np.diff(middle, axis=1).mean() == pytest.approx(along, rel=1e-4)
    assert np.diff(middle, axis=0).mean() == pytest.approx(across, rel=1e-3)
    assert np.abs(np.diff(middle, axis=1) - along).max() < 0.2
    if kind == "hexagonal":
        assert down == right == fit.row_pitch_px


def test_views_look_from_the_side_named() -> None:
    """Counter-test for u and v: a frame brighter to the right of each lenslet's centre brightens views of u > 0."""
    _, fit = clean("square", rotation=0.0)
    y, x = np.mgrid[: fit.shape[0], : fit.shape[1]]
    centres = fit.centres_px(*np.moveaxis(np.rint(fit.lenslet_at(y, x)), -1, 0))
    right = extract_views((x - centres[..., 1]).astype(np.float32), fit)
    down = extract_views((y - centres[..., 0]).astype(np.float32), fit)
    for k, offset in enumerate(right.offsets):
        assert np.median(right.images[:, k]) == pytest.approx(offset, abs=0.05)
        assert np.median(down.images[k]) == pytest.approx(offset, abs=0.05)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("slope", [-5.0, *(pytest.param(slope, marks=pytest.mark.long) for slope in (3.0, 6.5))])
@pytest.mark.few(1)
def test_refocusing_is_sharpest_at_the_slope_of_the_scene(kind: str, slope: float) -> None:
    _, fit = clean(kind, rotation=0.0)
    spot = fit.centres_px(1, 2) + np.array([4.0, -6.0])

    def scene(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return 10 + 100 * np.exp(-((x - spot[1]) ** 2 + (y - spot[0]) ** 2) / (2 * 9.0**2))

    views = extract_views(scene_frame(fit, scene, slope), fit)
    slopes = [slope + d for d in (-3, -1.5, 0, 1.5, 3)]
    stack = refocus(views, slopes, samples=4)
    assert [int(np.argmax([image.max() for image in stack]))] == [2]
    best = stack[2] - 10.0
    rows, columns = best.shape
    y, x = np.mgrid[:rows, :columns]
    near = best > 0.3 * best.max()
    weight = np.where(near, best, 0)
    # sample k of a stack lies at (k + 1/2) / samples - 1/2 view samples; the corner view sample is a known place
    found = np.array([(weight * y).sum(), (weight * x).sum()]) / weight.sum()
    found = (found + 0.5) / 4 - 0.5
    want = (spot - corner(fit, views.shape)) / np.array(views.step_px)
    assert found == pytest.approx(want, abs=0.12)


def corner(fit: LatticeFit, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Place of view sample (0, 0): found from a frame that shows its own coordinates (no rotation)."""
    y, x = np.mgrid[: fit.shape[0], : fit.shape[1]]
    row = extract_views(y.astype(np.float32), fit).central
    column = extract_views(x.astype(np.float32), fit).central
    assert row.shape == shape
    return np.array([row[0, 0], column[0, 0]])


def test_the_white_frame_removes_the_micro_images_own_light() -> None:
    truth, fit = clean("square", fill=0.9, falloff=0.3)
    white = truth.frame.astype(np.float32)
    stack = refocus(extract_views(0.5 * white, fit, white=white), [-3.0, 0.0, 2.0])
    values = stack[:, 4:-4, 4:-4] / white.max()
    assert values.std() / values.mean() < 0.01
    plain = refocus(extract_views(0.5 * white, fit), [-3.0, 0.0, 2.0])[:, 4:-4, 4:-4]
    assert plain.std() / plain.mean() > 0.03


def test_the_slope_of_a_depth_agrees_with_traced_rays() -> None:
    """A point's spots below pinholes: (spot - c) w = S - c, with c the micro-image centres on the sensor."""
    camera = Camera("c", MainLens(), LensletLattice("hexagonal", 174.0, 870.0), Sensor())
    assert isinstance(camera.optics, MainLens)
    b, gap, source, f = camera.optics.image_distance_um, 870.0, 900.0, camera.optics.focal_length_um
    lens = np.array([-400.0, 0.0, 350.0])
    for z_um in (-60e3, -30e3, 50e3):
        distance = camera.optics.working_distance_um + z_um
        # the ray through pupil point p and pinhole: p + b ((p - source)/distance - p/f) = lens
        pupil = (lens + b * source / distance) / (1 + b / distance - b / f)
        spot = lens + gap * ((pupil - source) / distance - pupil / f)
        centre, chief = lens * (1 + gap / b), -source * (b + gap) / distance
        assert (spot - centre) * sensor_slope(camera, z_um) == pytest.approx(chief - centre)
    micro = Camera("m", Microscope(), LensletLattice("square", 125.0, 2500.0, (LensType(2500.0),)), Sensor())
    assert sensor_slope(micro, 10.0) == micro.virtual_depth(10.0)


def test_frames_that_do_not_fit_are_refused() -> None:
    truth, fit = clean("square")
    for frame, how, what in (
        (truth.frame[:-1], {}, "frame: expected .* px"),
        (truth.frame, {"white": truth.frame[1:]}, "white frame"),
        (truth.frame, {"dark": np.zeros((2, 2))}, "dark"),
        (truth.frame, {"radius_px": 0.2}, "radius"),
    ):
        with pytest.raises(InputError, match=what):
            extract_views(frame, fit, **how)
    views = extract_views(truth.frame, fit)
    for slopes, samples, what in (([math.nan], 1, "slope"), ([0.0], 0, "samples")):
        with pytest.raises(InputError, match=what):
            refocus(views, slopes, samples=samples)


def test_the_mosaic_keeps_the_middle_view() -> None:
    _, fit = clean("square")
    views = extract_views(np.random.default_rng(0).random(fit.shape), fit)
    n, (rows, columns) = len(views.offsets), views.shape
    assert views.mosaic().shape == (n * rows, n * columns)
    picked = views.mosaic(3)
    top, left = (size // step // 2 * step for size, step in zip(picked.shape, views.shape, strict=True))
    assert np.array_equal(picked[top : top + rows, left : left + columns], views.central)


@pytest.mark.long
@needs_real
def test_the_real_vesicle() -> None:
    """A hollow sphere: a ring in the middle view, largest contrast when focused near the lenslets' plane."""
    from lfcal.frames import read_image

    frame, white, dark = (
        read_image(REAL / f"{name}_GUVExperim1.tif") for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    fit = fit_lattice(white, dark=dark)
    views = extract_views(frame, fit, white=white, dark=dark)
    assert views.images.shape == (13, 13, 28, 28)
    stack = refocus(views, [-6, 0, 6], samples=4)
    contrast = stack.std(axis=(1, 2)) / stack.mean(axis=(1, 2))
    assert contrast.argmax() == 1
    ring = stack[1]
    y, x = np.mgrid[: ring.shape[0], : ring.shape[1]]
    bright = ring > np.percentile(ring, 95)
    centre = (y[bright].mean(), x[bright].mean())
    radius = np.hypot(y[bright] - centre[0], x[bright] - centre[1])
    assert radius.std() / radius.mean() < 0.1


TYPES = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))


def camera_of(kind: str, turn: float = 0.013) -> Camera:
    types = TYPES if kind == "hexagonal" else TYPES[:1]
    lattice = LensletLattice(kind, 82.0, 400.0, types, turn, (7.0, -11.0), type_step=2 if len(types) == 3 else 1)
    return Camera("c", MainLens(), lattice, Sensor((330, 400), 5.0))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_a_described_camera_gives_what_its_white_image_gives(kind: str) -> None:
    truth = draw_white((330, 400), pitch=16.4, kind=kind, rotation=0.013, dead=0.0, snr=200.0, falloff=0.0)
    fit = fit_lattice(truth.frame)
    camera = camera_of(kind)
    camera = replace(camera, lattice=fit.to_lattice(camera))
    lattice = lattice_of(camera)
    assert (lattice.kind, lattice.shape) == (fit.kind, fit.shape)
    assert (lattice.pitch_px, lattice.row_pitch_px, lattice.rotation_rad) == pytest.approx(
        (fit.pitch_px, fit.row_pitch_px, fit.rotation_rad)
    )
    np.testing.assert_allclose(lattice.basis_px(), fit.basis_px())
    frame = np.random.default_rng(0).random(fit.shape)
    np.testing.assert_allclose(extract_views(frame, lattice).images, extract_views(frame, fit).images, atol=1e-5)


def test_points_and_lenslets_are_inverse() -> None:
    y, x = np.mgrid[0:100:7, 0:120:11].astype(float)
    for kind in ("square", "hexagonal"):
        lattice = lattice_of(camera_of(kind, 0.7), (100, 120), (40, 60))
        index = lattice.lenslet_at(y, x)
        np.testing.assert_allclose(lattice.centres_px(index[..., 0], index[..., 1]), np.stack([y, x], -1), atol=1e-9)


def test_the_lattice_of_a_part_of_the_sensor_is_that_of_the_whole() -> None:
    camera = camera_of("hexagonal")
    whole, part = lattice_of(camera), lattice_of(camera, (150, 170), (30, 50))
    np.testing.assert_allclose(part.centres_px(3, -2), whole.centres_px(3, -2) - (30, 50))
    frame = np.random.default_rng(0).random((330, 400))
    cut = extract_views(frame[30:180, 50:220], part)
    (y, x), step = cut.grid.corner_px, cut.step_px
    # the same lenslets, looked up one by one in the views of the whole frame along the lattice
    seen = {tuple(np.round(c - (30, 50), 6)) for c in extract_views(frame, whole).grid.centres_px}
    assert {tuple(np.round(c, 6)) for c in cut.grid.centres_px} <= seen
    assert cut.shape[0] * step[0] > 150 - 2 * 16.4 and cut.shape[1] * step[1] > 170 - 2 * 16.4
    assert min(y, x) >= cut.radius_px - 1


def test_frames_off_the_sensor_are_refused_with_the_numbers() -> None:
    camera = camera_of("square")
    for given, what in (
        (((150, 170),), r"330 rows and 400 columns.*got 150 rows and 170 columns.*--origin"),
        (((150, 170), (200, 0)), r"150 rows and 170 columns starting at row 200, column 0"),
        (((150, 170), (-1, 0)), "origin"),
        (((150, 170), (0, 0.5)), "origin"),
    ):
        with pytest.raises(InputError, match=what):
            lattice_of(camera, *given)
    assert cropped(lattice_of(camera), (330, 400)).shape == (330, 400)
    with pytest.raises(InputError, match="a hexagonal lattice with a lens type 1, got a square lattice"):
        type_lattice(lattice_of(camera), camera.lattice.type_of, 1)


@pytest.mark.parametrize("step", [1, 2])
def test_the_lenslets_of_a_type_are_a_lattice(step: int) -> None:
    camera = replace(camera_of("hexagonal"), lattice=replace(camera_of("hexagonal").lattice, type_step=step))
    every = lattice_of(camera)
    q, r = (v.ravel() for v in np.mgrid[-6:7, -6:7])
    places, types = every.centres_px(q, r), camera.lattice.type_of(q, r)
    for k in range(3):
        lattice = type_lattice(every, camera.lattice.type_of, k)
        index = lattice.lenslet_at(*places[types == k].T)
        np.testing.assert_allclose(index, np.rint(index), atol=1e-9)
        np.testing.assert_allclose(lattice.centres_px(*np.rint(index).T), places[types == k], atol=1e-9)
        found = lattice.among(list(zip(q.tolist(), r.tolist(), strict=True)))
        np.testing.assert_array_equal(found, np.rint(index).astype(int))
        others = lattice.lenslet_at(*places[types != k].T)
        assert (np.abs(others - np.rint(others)).max(1) > 0.3).all()
        assert lattice.pitch_px == pytest.approx(math.sqrt(3) * every.pitch_px)
        assert lattice.row_pitch_px == pytest.approx(math.sqrt(3) * every.row_pitch_px)
        assert lattice.rotation_rad == pytest.approx(every.rotation_rad - math.pi / 6)
        ideal = Straight("hexagonal", math.degrees(lattice.rotation_rad), (0, 0), lattice.pitch_px)
        np.testing.assert_allclose(lattice.basis_px(), ideal.basis_px(), atol=1e-9)


def test_views_of_a_type_lie_on_the_samples_of_all() -> None:
    """A frame in which each lenslet shows its type: views of a type show that type alone, at all samples."""
    camera = camera_of("hexagonal")
    every = lattice_of(camera)
    y, x = np.mgrid[:330, :400].astype(float)
    index = np.rint(every.lenslet_at(y, x)).astype(int)
    frame = 10.0 + camera.lattice.type_of(index[..., 0], index[..., 1])
    all_views = extract_views(frame, every, radius_px=4.0)
    for k in range(3):
        views = extract_views(frame, type_lattice(every, camera.lattice.type_of, k), radius_px=4.0, raster=every)
        np.testing.assert_allclose(views.images, 10.0 + k, atol=1e-5)
        assert views.step_px == all_views.step_px
        away = (np.array(views.grid.corner_px) - np.array(all_views.grid.corner_px)) / views.step_px
        assert away == pytest.approx(np.rint(away), abs=1e-9)


FRAME, PITCH, GAP, PIXEL = (260, 300), 24.0, 600.0, 5.0
FOCAL = tuple(GAP / (1 - 1 / v) for v in (2.0, 3.0, 6.0))
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def types_camera() -> Camera:
    lattice = LensletLattice("hexagonal", PITCH * PIXEL, GAP, tuple(map(LensType, FOCAL)), 0.03, (3.0, -8.0))
    return Camera("three types", Microscope(), lattice, Sensor(FRAME, PIXEL))


@pytest.fixture(scope="module")
def texture() -> Array:
    """Return a random scene, one value a pixel of the sensor, twice as wide as the frame."""
    field = gaussian_filter(np.random.default_rng(5).normal(size=(2 * FRAME[0], 2 * FRAME[1])), 3.5)
    return 100 + 40 * field / field.std()


def scene(texture: Array, y: Array, x: Array) -> Array:
    return map_coordinates(texture, [y + FRAME[0] / 2, x + FRAME[1] / 2], order=1, mode="nearest")


def draw(types_camera: Camera, texture: Array, depth_left: float, depth_right: float) -> Array:
    """Draw the frame of two half planes at virtual depths, separated by the middle column.

    Lenslet of focal length f and diameter d, sensor B behind it: light that would meet at a = v B behind the lenslet
    meets at s, 1/s = 1/f + 1/a; on the sensor it fills a disc of diameter d |1 - B/s|.
    """
    lattice = types_camera.lattice
    y, x = np.mgrid[: FRAME[0], : FRAME[1]].astype(float)
    nearest, centre, focal = np.full(FRAME, np.inf), np.zeros((*FRAME, 2)), np.zeros(FRAME)
    for q, r in itertools.product(range(-14, 15), repeat=2):
        here = types_camera.pixels(lattice.centres_um(q, r))
        away = np.hypot(y - here[0], x - here[1])
        mine = away < nearest
        nearest[mine], centre[mine], focal[mine] = away[mine], here, FOCAL[int(lattice.type_of(q, r))]
    ring = [(0.0, 0.0)]
    for radius, n in ((0.25, 6), (0.42, 10)):
        angles = 2 * np.pi * np.arange(n) / n
        ring += list(zip(radius * np.cos(angles), radius * np.sin(angles), strict=True))
    shown = np.zeros(FRAME)
    for v, left in ((depth_left, True), (depth_right, False)):
        a = v * GAP
        disc = PITCH * np.abs(1 - GAP * (1 / focal + 1 / a))
        value, total = np.zeros(FRAME), np.zeros(FRAME)
        for down, right in ring:
            sy = centre[..., 0] + v * (y + disc * down - centre[..., 0])
            sx = centre[..., 1] + v * (x + disc * right - centre[..., 1])
            on = (sx < FRAME[1] / 2) == left
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
def test_the_types_in_focus_have_the_largest_shares(types_camera: Camera, texture: Array, depth: float) -> None:
    frame = draw(types_camera, texture, depth, depth)
    lattice, type_of = lattice_of(types_camera), types_camera.lattice.type_of
    one = [render(frame, lattice, [depth], type_of=type_of, shares=[np.eye(3)[k]], samples=4) for k in range(3)]
    together = render(
        frame, lattice, [depth], type_of=type_of, shares=[sharpness_shares(types_camera, depth)], samples=4
    )
    wanted = scene(texture, *places(together))
    each = [likeness(planes.images[0], wanted) for planes in one]
    blur = [abs(1 - GAP * (1 / f + 1 / (depth * GAP))) for f in FOCAL]
    assert np.argmax(each) == np.argmin(blur) and np.argmin(each) == np.argmax(blur)
    alike = likeness(render(frame, lattice, [depth], samples=4).images[0], wanted)
    best = likeness(together.images[0], wanted)
    assert best > 0.97 and best > alike and best > max(each) - 0.01


def test_planes_are_sharp_at_their_own_depth(types_camera: Camera, texture: Array) -> None:
    frame = draw(types_camera, texture, 3.4, 3.4)
    slopes = [2.4, 2.9, 3.4, 3.9, 4.4]
    shares = [sharpness_shares(types_camera, w) for w in slopes]
    planes = render(frame, lattice_of(types_camera), slopes, type_of=types_camera.lattice.type_of, shares=shares)
    wanted = scene(texture, *places(planes))
    assert np.argmax([likeness(image, wanted) for image in planes.images]) == 2
    inner = planes.disagreement[:, 12:-12, 12:-12]
    assert np.isfinite(inner[1:]).all() and np.argmin(np.median(inner, (1, 2))) == 2


@pytest.mark.long
def test_all_in_focus_finds_two_depths(types_camera: Camera, texture: Array) -> None:
    frame = draw(types_camera, texture, 2.2, 4.5)
    slopes = [2.2, 2.8, 3.5, 4.5, 5.5]
    shares = [sharpness_shares(types_camera, w) for w in slopes]
    planes = render(frame, lattice_of(types_camera), slopes, type_of=types_camera.lattice.type_of, shares=shares)
    image, slope = total_focus(planes)
    y, x = places(planes)
    left, right = x < FRAME[1] / 2 - 30, x > FRAME[1] / 2 + 30
    inner = np.zeros(image.shape, bool)
    inner[12:-12, 12:-12] = True
    assert (slope[left & inner] == np.float32(2.2)).mean() > 0.85
    assert (slope[right & inner] == np.float32(4.5)).mean() > 0.85
    wanted = scene(texture, y, x)
    for part in (left & inner, right & inner):
        assert np.corrcoef(image[part], wanted[part])[0, 1] > 0.95
    # no single plane shows both
    assert all(likeness(one, wanted) < likeness(image, wanted) for one in planes.images)


def test_the_white_frame_divides_its_light_out(types_camera: Camera) -> None:
    y, x = np.mgrid[: FRAME[0], : FRAME[1]]
    white = 1000 * (1 - 0.5 * ((y - 130) ** 2 + (x - 150) ** 2) / 200**2) + 100
    planes = render(
        0.5 * (white - 100) + 100, lattice_of(types_camera), [3.0, -3.0], white=white, dark=100.0, samples=2
    )
    assert planes.images.std() / planes.images.mean() < 1e-3
    assert np.nanmax(planes.disagreement[np.isfinite(planes.disagreement)]) < 1e-2 * planes.images.mean() ** 2


def test_depths_and_slopes_are_inverse() -> None:
    camera = camera_of("hexagonal")
    for v in (-5.0, 2.0, 5.5):
        assert slope_of_virtual_depth(camera, v) == pytest.approx(sensor_slope(camera, camera.depth_of(v)))
        assert virtual_depth_of_slope(camera, sensor_slope(camera, camera.depth_of(v))) == pytest.approx(v)
    with pytest.raises(InputError, match="slope"):
        virtual_depth_of_slope(camera, 1e4)
    assert [int(np.argmax(sharpness_shares(camera, v))) for v in (2.0, 3.0, 5.0)] == [0, 1, 2]


def test_wrong_input_of_rendering_is_refused(types_camera: Camera) -> None:
    frame, lattice = np.ones(FRAME), lattice_of(types_camera)
    for given, slopes, how, what in (
        (frame, [1.0], {}, r"below -1.5 or above 1.5, got 1;"),
        (frame[1:], [2.0], {}, "light-field frame"),
        (frame, [2.0], {"white": frame[1:]}, "white frame"),
        (frame, [2.0], {"samples": 0}, "samples"),
    ):
        with pytest.raises(InputError, match=what):
            render(given, lattice, slopes, **how)
    with pytest.raises(InputError, match="planes"):
        total_focus(render(frame, lattice, []))
