"""Depth maps of a Fourier light-field microscope: scenes drawn ray by ray."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Camera, preset
from lfcal.lattice import DepthMap, elemental_depth, elemental_seconds, metric_depth, sensor_slope
from tests.lattice.fourier_scenes import RING, SIDE, SURFACES, Surface, camera_of, instrument, scene, white_of

GOOD_PX = 0.3


@pytest.fixture(scope="module")
def white() -> NDArray[np.float64]:
    return white_of(instrument())


def errors(found: DepthMap, camera: Camera, surface: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors of the disparity of the outermost elemental image, and over their standard errors."""
    known = metric_depth(found, camera)
    assert known.across_um is not None
    true = surface(known.across_um[..., 0], known.across_um[..., 1])
    rate = -camera.lattice.gap_um * (20.0 / 150e3) ** 2
    off = ((found.slope - rate * true) * found.disparity_px)[found.known]
    return off, off / found.disparity_sigma[found.known]


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces(white: NDArray[np.float64], name: str) -> None:
    at = instrument()
    camera = camera_of(at)
    found = elemental_depth(scene(at, SURFACES[name]), camera, white=white)
    off, relative = errors(found, camera, SURFACES[name])
    # the field has 70 % of the pixels of the map
    assert found.known.mean() > 0.55 and np.mean(np.abs(off) < GOOD_PX) >= 0.9
    assert np.median(np.abs(off)) < 0.1 and 0.2 < np.median(np.abs(relative)) < 1.5
    assert found.confidence[found.known].mean() > 0.9


def test_three_lenslets_none_of_them_on_the_axis() -> None:
    """The map shows the lenslet nearest to the axis, whose image moves with the depth: the positions follow it."""
    at = instrument(((-1000.0, 0.0), *RING[1:6:2]), focal=58e3)
    camera, surface = camera_of(at), SURFACES["step"]
    found = elemental_depth(scene(at, surface), camera, white=white_of(at))
    off, _ = errors(found, camera, surface)
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
    off, _ = errors(whole, camera, surface)
    assert np.mean(np.abs(off) < GOOD_PX) >= 0.9
    rows, columns = np.nonzero(whole.known)
    assert not (
        np.isin(rows + whole.corner_px[0], range(192, 198)) & np.isin(columns + whole.corner_px[1], range(182, 188))
    ).any()


def test_bands_and_threads_do_not_change_the_map(white: NDArray[np.float64], monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_refusals() -> None:
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


@pytest.mark.parametrize("value", [0.0, -3.0])
def test_a_frame_without_light_has_no_depth(value: float) -> None:
    """Relative to a mean of zero, the blank elemental images once agreed on a depth at 0.6 % of the samples."""
    camera = preset("flfm_20x05")
    found = elemental_depth(np.full(camera.sensor.shape, value), camera, slopes=(-0.002, 0.002))
    assert not found.known.any()
