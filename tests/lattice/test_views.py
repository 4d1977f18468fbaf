from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Microscope, Sensor
from lfcal.lattice._refocus import refocus, sensor_slope
from lfcal.lattice.fit import LatticeFit, fit_lattice
from lfcal.lattice.views import extract_views
from tests.lattice.white_frames import WhiteFrame, draw_white

REAL = Path(__file__).parents[3] / "shared/data/lfm_guv"
needs_real = pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")


def clean(kind: str, **options: Any) -> tuple[WhiteFrame, LatticeFit]:
    truth = draw_white((400, 420), **{"kind": kind, "dead": 0.0, "falloff": 0.0, "dark": 0.0, "snr": 200.0, **options})
    return truth, fit_lattice(truth.frame)


def scene_frame(fit: LatticeFit, scene: Any, slope: float) -> NDArray[np.float32]:
    """Draw a frame whose every pixel p shows ``scene(x, y)`` at S = c + w (p - c), c the nearest lenslet's centre."""
    y, x = np.mgrid[: fit.shape[0], : fit.shape[1]].astype(float)
    index = np.rint(fit.lenslet_at(y, x))
    best = np.full(fit.shape, np.inf)
    centres = np.zeros((*fit.shape, 2))
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            here = fit.centres_px(index[..., 0] + i, index[..., 1] + j)
            distance = np.hypot(here[..., 0] - y, here[..., 1] - x)
            near = distance < best
            best[near], centres[near] = distance[near], here[near]
    row = centres[..., 0] + slope * (y - centres[..., 0])
    column = centres[..., 1] + slope * (x - centres[..., 1])
    return np.asarray(scene(column, row), np.float32)


@pytest.mark.long
@pytest.mark.parametrize("with_white", [False, True])
def test_pixels_beyond_the_radius_have_no_weight(with_white: bool) -> None:
    truth, fit = clean("square")
    white = truth.frame if with_white else None
    views = extract_views(truth.frame, fit, white=white, radius_px=4.0)
    beyond = np.hypot(views.offsets[:, None], views.offsets[None, :]) > 4.0
    assert beyond.any() and not views.weights[beyond].any() and (views.weights[~beyond] > 0).any(axis=(1, 2)).all()


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
    # samples at the border may take what lenslets beside them see
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
def test_refocusing_is_sharpest_at_the_scene_s_slope_and_in_its_place(kind: str, slope: float) -> None:
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


@pytest.mark.parametrize("z_um", [-60e3, -30e3, 50e3])
def test_the_slope_of_a_depth_agrees_with_traced_rays(z_um: float) -> None:
    """A point's spots below pinholes: (spot - c) w = S - c, with c the micro-image centres on the sensor."""
    camera = Camera("c", MainLens(), LensletLattice("hexagonal", 174.0, 870.0), Sensor())
    assert isinstance(camera.optics, MainLens)
    b, gap, distance = camera.optics.image_distance_um, 870.0, camera.optics.working_distance_um + z_um
    source = 900.0
    lens = np.array([-400.0, 0.0, 350.0])
    # the ray through pupil point p and pinhole: p + b ((p - source)/distance - p/f) = lens
    pupil = (lens + b * source / distance) / (1 + b / distance - b / camera.optics.focal_length_um)
    slope = (pupil - source) / distance - pupil / camera.optics.focal_length_um
    spot = lens + gap * slope
    centre = lens * (1 + gap / b)
    chief = -source * (b + gap) / distance
    assert (spot - centre) * sensor_slope(camera, z_um) == pytest.approx(chief - centre)
    micro = Camera("m", Microscope(), LensletLattice("square", 125.0, 2500.0, (LensType(2500.0),)), Sensor())
    assert sensor_slope(micro, 10.0) == micro.virtual_depth(10.0)


def test_frames_that_do_not_fit_are_refused() -> None:
    truth, fit = clean("square")
    with pytest.raises(InputError, match="shape"):
        extract_views(truth.frame[:-1], fit)
    with pytest.raises(InputError, match="white frame"):
        extract_views(truth.frame, fit, white=truth.frame[1:])
    with pytest.raises(InputError, match="dark"):
        extract_views(truth.frame, fit, dark=np.zeros((2, 2)))
    with pytest.raises(InputError, match="radius"):
        extract_views(truth.frame, fit, radius_px=0.2)
    views = extract_views(truth.frame, fit)
    with pytest.raises(InputError, match="slope"):
        refocus(views, [math.nan])
    with pytest.raises(InputError, match="samples"):
        refocus(views, [0.0], samples=0)


def test_the_mosaic_keeps_the_middle_view() -> None:
    _, fit = clean("square")
    views = extract_views(np.random.default_rng(0).random(fit.shape), fit)
    n, (rows, columns) = len(views.offsets), views.shape
    assert views.mosaic().shape == (n * rows, n * columns)
    picked = views.mosaic(3)
    middle = picked.shape[0] // rows // 2
    assert np.array_equal(
        picked[middle * rows : (middle + 1) * rows, middle * columns : (middle + 1) * columns], views.central
    )


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
