"""Depth maps of scenes with known slopes, drawn by renderers that share no code with the estimators."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, preset
from lfcal.lattice import (
    DepthMap,
    depth_map,
    depth_seconds,
    elemental_depth,
    elemental_seconds,
    lattice_of,
    metric_depth,
    save_depth,
    save_points,
    sensor_slope,
)
from tests.lattice.fourier_scenes import RING, SIDE, SURFACES, camera_of, instrument, scene, white_of
from tests.lattice.lattices import Straight
from tests.lattice.plenoptic_scenes import Drawn, Surface, ball, draw, plane, step, texture

SHAPE = (230, 260)
GOOD_PX = 0.3
OFFSET = (0.3, -0.2)

FOCUSED: dict[str, tuple[float, str, Surface, dict[str, Any]]] = {
    "plane": (24.0, "hexagonal", plane(3.0), {"noise": 0.02}),
    "slant": (24.0, "hexagonal", plane(3.0, 0.4, 0.6), {"noise": 0.01}),
    "step": (24.0, "hexagonal", step(2.5, 4.0), {"noise": 0.01}),
    "ball": (24.0, "hexagonal", ball(4.0, 2.2, 90), {"noise": 0.01}),
    "three lens types": (24.0, "hexagonal", plane(3.0, 0.4, 0.6), {"noise": 0.01, "focus": (2.0, 3.0, 5.0)}),
    "square lattice": (20.0, "square", plane(2.6, 0.0, 0.3), {"noise": 0.01}),
    "small micro-images": (11.0, "hexagonal", plane(2.6, 0.0, 0.3), {"noise": 0.01}),
    "images in front": (20.0, "hexagonal", plane(-3.0, 0.0, 0.3), {"noise": 0.01, "focus": (-3.0,)}),
    "far plane": (24.0, "hexagonal", plane(9.0), {"noise": 0.01}),
    "defocused everywhere": (24.0, "hexagonal", plane(3.0), {"noise": 0.01, "focus": (1.2,)}),
}
VIEWS: dict[str, tuple[str, Surface, dict[str, Any]]] = {
    "plane": ("square", plane(0.7), {"noise": 0.02}),
    "slant": ("square", plane(-0.5, 0.6, 0.6), {"noise": 0.01}),
    "hexagonal slant": ("hexagonal", plane(-0.5, 0.6, 0.6), {"noise": 0.01}),
    "step": ("square", step(-1.5, 1.5), {"noise": 0.01}),
}


def lattice(shape: tuple[int, int], pitch: float, kind: str = "hexagonal", rotation: float = 0.02) -> Straight:
    middle = ((shape[0] - 1) / 2 + OFFSET[0], (shape[1] - 1) / 2 + OFFSET[1])
    return Straight(kind, math.degrees(rotation), middle, pitch, shape)


def drawn_views(kind: str, surface: Surface, **how: Any) -> Drawn:
    """Draw a frame of a camera whose lenslets are focused at infinity."""
    how = {"shade": texture(0, 40.0), **how}
    return draw((440, 440), 13.0, surface, kind=kind, rotation=0.02, focus=(math.inf,), **how)


@pytest.fixture(scope="module")
def flat() -> Drawn:
    return draw(SHAPE, 24.0, plane(3.0), rotation=0.02, noise=0.01)


def errors(found: DepthMap, drawn: Drawn) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of the disparity, and over their standard errors."""
    true = drawn.slope(*np.moveaxis(found.places_px(), -1, 0))
    wanted = true * found.disparity_px if found.method == "views" else found.disparity_px / true
    off = found.disparity - wanted
    return off, off / found.disparity_sigma


def check(found: DepthMap, drawn: Drawn, share: float = 0.9, *, edges: bool = False) -> None:
    """Check that enough samples are within 0.3 px, and that the errors agree with their standard errors.

    Along ``edges`` of depth, windows show both depths, and a few samples have that of the other side.
    """
    off, pull = errors(found, drawn)
    good = np.abs(np.where(found.known, off, np.inf)) <= GOOD_PX
    inner = (slice(4, -4),) * 2
    assert good[inner].mean() >= share
    assert good[found.known].mean() >= 0.93, "of the samples with a depth"
    pulls = np.abs(pull[found.known])
    # 68 % of normal errors are within one standard error, 95 % within two
    assert np.quantile(pulls, 0.68) < 1.5
    assert edges or np.quantile(pulls, 0.95) < 3.5
    sure = found.confidence > 0.9
    assert good[sure].mean() >= 0.93
    assert found.image.shape == found.slope.shape and np.isfinite(found.image).all()


@pytest.mark.few(5)
@pytest.mark.parametrize("name", FOCUSED)
def test_depths_of_micro_images(name: str) -> None:
    pitch, kind, surface, how = FOCUSED[name]
    drawn = draw(SHAPE, pitch, surface, kind=kind, rotation=0.02, **how)
    slopes = (-12.0, -1.5) if name == "images in front" else (1.5, 16.0)
    found = depth_map(drawn.frame, lattice(SHAPE, pitch, kind), white=drawn.white, method="micro-images", slopes=slopes)
    check(found, drawn, edges=name in ("step", "ball"))


@pytest.mark.few(1)
@pytest.mark.parametrize("name", VIEWS)
def test_depths_of_views(name: str) -> None:
    kind, surface, how = VIEWS[name]
    drawn = drawn_views(kind, surface, **how)
    found = depth_map(drawn.frame, lattice((440, 440), 13.0, kind), white=drawn.white, method="views")
    check(found, drawn, edges=name == "step")


@pytest.mark.few(1)
@pytest.mark.parametrize("rotation", [0.3, -0.8])
def test_rotated_lattices(rotation: float) -> None:
    drawn = draw(SHAPE, 22.0, plane(3.0, 0.3, 0.2), rotation=rotation, noise=0.01)
    check(depth_map(drawn.frame, lattice(SHAPE, 22.0, rotation=rotation), white=drawn.white, slopes=(1.5, 12.0)), drawn)


@pytest.mark.few(1)
@pytest.mark.parametrize("slope", [3.0, 4.0, 5.0])
def test_a_small_pupil_makes_disparities_too_large_by_at_most_0_2_px(slope: float) -> None:
    """The pupil clips the blurred spots of lenslets out of focus on one side."""
    bias = []
    for pupil in (None, 0.73):
        how: dict[str, Any] = {"focus": (2.0, 3.0, 5.0), "noise": 0.01, "flat": True, "pupil": pupil}
        drawn = draw(SHAPE, 22.0, plane(slope), rotation=0.02, **how)
        found = depth_map(drawn.frame, lattice(SHAPE, 22.0), white=drawn.white, slopes=(1.5, 15.0))
        assert found.known.mean() > 0.9
        bias.append(float(np.median(errors(found, drawn)[0][found.known])))
    assert abs(bias[0]) < 0.05 < bias[1] < 0.2, bias


def test_the_method_follows_from_the_frame(flat: Drawn) -> None:
    found = depth_map(flat.frame, lattice(SHAPE, 24.0), white=flat.white)
    assert found.method == "micro-images"
    check(found, flat)
    other = drawn_views("square", plane(0.4, 0.4, 0.0), noise=0.01)
    assert depth_map(other.frame, lattice((440, 440), 13.0, "square"), white=other.white).method == "views"


@pytest.mark.long
def test_without_a_white_frame(flat: Drawn) -> None:
    check(depth_map(flat.frame, lattice(SHAPE, 24.0), slopes=(1.5, 12.0)), flat)
    other = drawn_views("square", plane(-0.5, 0.4, 0.4), noise=0.01)
    check(depth_map(other.frame, lattice((440, 440), 13.0, "square"), method="views"), other)


def test_the_rim_of_small_micro_images_does_not_move_the_depth() -> None:
    drawn = draw(SHAPE, 11.0, plane(2.6), rotation=0.02)
    for white in (drawn.white, None):
        found = depth_map(drawn.frame, lattice(SHAPE, 11.0), white=white, slopes=(1.5, 12.0))
        off, _ = errors(found, drawn)
        assert abs(np.median(off[found.known])) < 0.1 and found.known.mean() > 0.9


@pytest.mark.few(4)
@pytest.mark.parametrize("method", ["micro-images", "views"])
@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("white", [True, False])
def test_a_uniform_scene_has_no_depth(method: str, noise: float, white: bool) -> None:
    focus = 3.0 if method == "micro-images" else math.inf
    how: dict[str, Any] = {"shade": lambda y, x: np.full(np.shape(y), 0.6), "noise": noise, "focus": (focus,)}
    drawn = draw(SHAPE, 13.0, plane(3.0), rotation=0.02, **how)
    found = depth_map(drawn.frame, lattice(SHAPE, 13.0), white=drawn.white if white else None, method=method)
    assert found.known.mean() < 0.01 and not found.confidence[~found.known].any()


def test_noise_has_no_depth() -> None:
    frame = np.random.default_rng(0).normal(100, 20, SHAPE)
    for method in ("micro-images", "views"):
        assert depth_map(frame, lattice(SHAPE, 16.0), method=method).known.mean() < 0.02


def test_only_the_textured_half_has_a_depth() -> None:
    half = texture(0)
    how: dict[str, Any] = {"noise": 0.01, "shade": lambda y, x: np.where(x < 0, 0.5, half(y, x))}
    drawn = draw(SHAPE, 24.0, plane(3.0), rotation=0.02, **how)
    found = depth_map(drawn.frame, lattice(SHAPE, 24.0), white=drawn.white, slopes=(1.5, 12.0))
    columns = found.places_px()[0, :, 1]
    assert not found.known[:, columns < SHAPE[1] / 2 - 40].any()
    assert found.known[:, columns > SHAPE[1] / 2 + 20].mean() > 0.95


def test_saturated_dead_hot_and_invalid_pixels(flat: Drawn) -> None:
    bad = np.random.default_rng(0).random(SHAPE) < 0.01
    given: dict[str, Any] = {"white": flat.white, "slopes": (1.5, 12.0)}
    for frame, share in (
        (np.minimum(flat.frame, 1300), 0.85),
        (np.where(bad, 0, flat.frame), 0.9),
        (np.where(bad, 6000, flat.frame), 0.9),
    ):
        check(depth_map(frame, lattice(SHAPE, 24.0), **given), flat, share=share)
    bad[100:140, 100:150] = True
    frame = np.where(bad, np.where(np.indices(SHAPE)[0] % 2, np.nan, np.inf), flat.frame)
    found = depth_map(frame, lattice(SHAPE, 24.0), **given)
    check(found, flat)
    same = depth_map(np.where(bad, 1e6, flat.frame), lattice(SHAPE, 24.0), mask=bad, **given)
    np.testing.assert_array_equal(found.slope, same.slope)


def test_few_lenslets() -> None:
    for size in (30, 60):
        drawn = draw((size, size), 24.0, plane(3.0), rotation=0.02)
        found = depth_map(drawn.frame, lattice((size, size), 24.0), white=drawn.white, slopes=(1.5, 12.0))
        off, _ = errors(found, drawn)
        assert np.abs(off[found.known]).max(initial=0) < 1
        assert found.known.any() == (size == 60), "one lenslet alone has no disparity"


def test_threads_do_not_change_the_map(flat: Drawn) -> None:
    one, four = (depth_map(flat.frame, lattice(SHAPE, 24.0), slopes=(1.5, 12.0), workers=workers) for workers in (1, 4))
    np.testing.assert_array_equal(one.slope, four.slope)
    np.testing.assert_allclose(one.image, four.image, rtol=1e-5)


def test_metric_depths_are_those_of_the_camera() -> None:
    for name, depths in (("bench", (-20e3, -5e3, 15e3)), ("lfm_20x05", (-60.0, 10.0, 40.0))):
        camera = preset(name)
        found = metric_depth(map_of([sensor_slope(camera, z) for z in depths]), camera)
        assert found.z_um is not None and found.z_sigma_um is not None
        np.testing.assert_allclose(found.z_um[0], depths, rtol=1e-4)
        assert (found.z_sigma_um > 0).all()
        points, chosen = found.points()
        assert chosen.all()
        # the chief ray moves by one pixel per step
        x = (5.0 * np.arange(3) - camera.sensor.centre_px[1]) * [camera.step_um(z) for z in depths]
        np.testing.assert_allclose(points[:, 0], x, rtol=1e-3)


def map_of(slope: list[float], method: str = "views", disparity: float = 0.5) -> DepthMap:
    """Return a map of one row with these slopes."""
    own = np.array([slope], np.float32)
    one = np.ones_like(own)
    return DepthMap(own, 0.01 * one, one, one, method, (0.0, 0.0), (5.0, 5.0), disparity)


def test_slopes_beyond_infinity_have_no_depth() -> None:
    found = metric_depth(map_of([500.0, 1e6, np.nan]), preset("bench"))
    assert found.z_um is not None and np.isnan(found.z_um).all() and not len(found.points()[0])


def test_measured_planes_correct_a_wrong_camera() -> None:
    true, depths = preset("bench"), (-18e3, -8e3)
    wrong = replace(true, lattice=replace(true.lattice, gap_um=1.06 * true.lattice.gap_um))
    found = map_of([sensor_slope(true, z) for z in depths], "micro-images", 11.0)
    planes = [(z, sensor_slope(true, z)) for z in (-20e3, -12e3, -6e3)]
    plain, better, single = (metric_depth(found, wrong, measured=given).z_um for given in ((), planes, planes[:1]))
    assert plain is not None and np.abs(plain[0] - depths).min() > 300
    np.testing.assert_allclose(better[0], depths, atol=30)
    assert single is not None and np.abs(single[0] - depths).max() < 60


def test_depth_maps_are_written_as_tiff_and_points(flat: Drawn, tmp_path: Path) -> None:
    found = depth_map(flat.frame, lattice(SHAPE, 24.0), white=flat.white, slopes=(1.5, 12.0))
    save_depth(tmp_path / "depth.tif", found)
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        pages, facts = file.asarray(), file.imagej_metadata or {}
    assert pages.dtype == np.float32 and pages.shape == (5, *found.slope.shape)
    np.testing.assert_array_equal(pages[0], found.slope)
    assert facts["Labels"][0] == "slope (1)" and json.loads(facts["Info"])["method"] == "micro-images"
    count = save_points(tmp_path / "points.ply", found)
    head, _, body = (tmp_path / "points.ply").read_bytes().partition(b"end_header\n")
    assert f"element vertex {count}\n".encode() in head and count == found.known.sum()
    assert len(body) == count * (3 * 4 + 3 + 2 * 4)
    first = np.frombuffer(body[:12], "<f4")
    np.testing.assert_allclose(
        first, [*found.places_px()[found.known][0][::-1], found.slope[found.known][0]], rtol=1e-6
    )


def test_wrong_input_is_refused(flat: Drawn) -> None:
    field = lattice(SHAPE, 24.0)
    for frame, how, what in (
        (flat.frame[1:], {}, "frame: expected .* px"),
        (flat.frame, {"mask": np.zeros((3, 3))}, "mask"),
        (flat.frame, {"method": "stereo"}, "method"),
        (flat.frame, {"method": "micro-images", "slopes": (-1.0, 5.0)}, "slopes"),
        (flat.frame, {"method": "views", "slopes": (5.0, 1.0)}, "slopes"),
    ):
        with pytest.raises(InputError, match=what):
            depth_map(frame, field, **how)
    with pytest.raises(InputError, match=r"frame: expected .* px"):
        depth_seconds(flat.frame[1:], field)
    with pytest.raises(InputError, match="complete micro-image"):
        depth_map(np.ones((9, 9)), lattice((9, 9), 24.0))


def test_the_forecast_counts_pairs_of_micro_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """Micro-images at the edge of the measured part have fewer neighbours than most of a large frame."""
    spent = [0.0]

    def match(light: Any, good: Any, lenslets: Any, how: Any, found: Any, numbers: tuple[int, int]) -> None:
        spent[0] += float((lenslets.near[numbers[0] : numbers[1]] >= 0).sum())

    monkeypatch.setattr("lfcal.lattice.depth.match_lenslets", match)
    monkeypatch.setattr("lfcal.lattice.depth.time.thread_time", lambda: spent[0])
    frame, field = np.ones((900, 1000), np.float32), lattice((900, 1000), 11.0)
    wanted = depth_seconds(frame, field, method="micro-images")
    spent[0] = 0.0
    depth_map(frame, field, method="micro-images", workers=1)
    assert wanted == pytest.approx(spent[0], rel=1e-6)


def test_a_camera_alone_finds_nothing_in_a_uniform_frame() -> None:
    camera = preset("bench")
    field = lattice_of(camera)
    found = depth_map(np.ones(field.shape), field, camera=camera, type_of=camera.lattice.type_of)
    assert found.method == "micro-images" and not found.known.any()


@pytest.fixture(scope="module")
def white() -> NDArray[np.float64]:
    return white_of(instrument())


def errors_of_map(found: DepthMap, camera: Camera, surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of the disparity of the outermost elemental image, and over their standard errors."""
    known = metric_depth(found, camera)
    assert known.across_um is not None
    true = surface(known.across_um[..., 0], known.across_um[..., 1])
    rate = -camera.lattice.gap_um * (20.0 / 150e3) ** 2
    off = ((found.slope - rate * true) * found.disparity_px)[found.known]
    return off, off / found.disparity_sigma[found.known]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", SURFACES)
def test_depths_of_elemental_images(white: NDArray[np.float64], name: str) -> None:
    at = instrument()
    camera = camera_of(at)
    found = elemental_depth(scene(at, SURFACES[name]), camera, white=white)
    off, relative = errors_of_map(found, camera, SURFACES[name])
    # the field has 70 % of the pixels of the map
    assert found.known.mean() > 0.55 and np.mean(np.abs(off) < GOOD_PX) >= 0.9
    assert np.median(np.abs(off)) < 0.1 and 0.2 < np.median(np.abs(relative)) < 1.5
    assert found.confidence[found.known].mean() > 0.9


@pytest.mark.long
def test_three_lenslets_none_of_them_on_the_axis() -> None:
    """The map shows the lenslet nearest to the axis, whose image moves with the depth: the positions follow it."""
    at = instrument(((-1000.0, 0.0), *RING[1:6:2]), focal=58e3)
    camera, surface = camera_of(at), SURFACES["step"]
    found = elemental_depth(scene(at, surface), camera, white=white_of(at))
    off, _ = errors_of_map(found, camera, surface)
    assert found.known.mean() > 0.3 and np.mean(np.abs(off) < GOOD_PX) >= 0.9
    known = metric_depth(found, camera)
    assert known.across_um is not None and known.z_um is not None
    # the edge of the step is at x = 0
    x, z = known.across_um[..., 1][found.known], known.z_um[found.known]
    assert np.mean((z < 0) == (x < 0)) > 0.97


def test_a_part_of_the_sensor_nan_and_masks(white: NDArray[np.float64]) -> None:
    at = instrument()
    camera, surface = camera_of(at), SURFACES["plane"]
    frame, first = scene(at, surface), (2, 3)
    frame[190:200, 180:190], bad = np.nan, np.zeros(frame.shape, bool)
    bad[60:80, 200:220] = True
    frame[bad] = 1e5
    part = (slice(first[0], None), slice(first[1], None))
    found = elemental_depth(frame[part], camera, origin=first, white=white[part], mask=bad[part])
    whole = elemental_depth(frame, camera, white=white, mask=bad)
    both = found.known & whole.known
    assert np.count_nonzero(both) > 0.99 * np.count_nonzero(whole.known)
    np.testing.assert_allclose(found.slope[both], whole.slope[both], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(np.add(found.corner_px, first), whole.corner_px)
    known, same = (metric_depth(one, camera, origin=at) for one, at in ((found, first), (whole, (0, 0))))
    assert known.across_um is not None and same.across_um is not None
    np.testing.assert_allclose(known.across_um[both], same.across_um[both], rtol=1e-3, atol=1e-3)
    off, _ = errors_of_map(whole, camera, surface)
    assert np.mean(np.abs(off) < GOOD_PX) >= 0.9
    rows, columns = np.nonzero(whole.known)
    rows, columns = rows + whole.corner_px[0], columns + whole.corner_px[1]
    assert not (np.isin(rows, range(192, 198)) & np.isin(columns, range(182, 188))).any()


@pytest.mark.long
def test_bands_and_threads_do_not_change_an_elemental_map(
    white: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch
) -> None:
    at = instrument()
    frame, camera = scene(at, SURFACES["ball"]), camera_of(at)
    whole = elemental_depth(frame, camera, white=white, workers=1)
    monkeypatch.setattr("lfcal.lattice._depth_views.BAND_BYTES", 1)
    np.testing.assert_array_equal(elemental_depth(frame, camera, white=white, workers=3).slope, whole.slope)


def test_slopes_limit_the_search(white: NDArray[np.float64]) -> None:
    at = instrument()
    frame, camera = scene(at, SURFACES["plane"]), camera_of(at)
    wanted = sensor_slope(camera, 12.0)
    near = elemental_depth(frame, camera, white=white, slopes=(wanted - 0.003, wanted + 0.003))
    assert near.known.mean() > 0.6 and np.nanmedian(near.slope) == pytest.approx(wanted, rel=0.02)
    far = elemental_depth(frame, camera, white=white, slopes=(wanted + 0.01, wanted + 0.02))
    assert far.known.mean() < 0.02
    assert 0 < elemental_seconds(frame, camera) < 60


def test_wrong_elemental_images_are_refused() -> None:
    camera = camera_of(instrument())
    frame = np.ones((SIDE, SIDE))
    for words, frame_given, camera_given, how in (
        ("two or more", np.ones((50, 50)), camera, {}),
        ("mask", frame, camera, {"mask": np.zeros((3, 3), bool)}),
        ("white image", frame, camera, {"white": np.ones((3, 3))}),
        ("slopes", frame, camera, {"slopes": (0.1, 0.0)}),
        ("Fourier", frame, preset("bench"), {}),
    ):
        with pytest.raises(InputError, match=words):
            elemental_depth(frame_given, camera_given, **how)


def test_a_dark_frame_has_no_depth() -> None:
    """Relative to a mean of zero, the blank elemental images once agreed on a depth at 0.6 % of the samples."""
    camera = preset("flfm_20x05")
    for value in (0.0, -3.0):
        found = elemental_depth(np.full(camera.sensor.shape, value), camera, slopes=(-0.002, 0.002))
        assert not found.known.any()
