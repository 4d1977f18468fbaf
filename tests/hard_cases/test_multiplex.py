"""Where naive demultiplexing divides by zero, wraps around or invents light."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice import view_grid
from lfcal.multiplex import (
    SuperPixelLattice,
    amplification,
    cfa,
    demultiplex,
    demultiplex_lattice,
    lattice_channels,
    mask,
    mask_at_distance,
    modulator_from_matrix,
    multiplex,
    snr_gain,
    transmission,
)
from lfcal.multiplex.summary import describe

pytestmark = pytest.mark.hard_case


def checkerboard() -> np.ndarray:
    """Half of its Fourier weights are exactly zero."""
    return (np.indices((4, 4)).sum(0) % 2).astype(float)


@pytest.mark.parametrize("route", ["spatial", "fourier"])
def test_exactly_singular_mask(route: str) -> None:
    m = mask_at_distance(checkerboard(), 1.0)
    assert m.rank() == 2 and amplification(m) == math.inf and m.condition == math.inf
    assert snr_gain(m, mask("pinhole", 4), 1.0) == -math.inf
    assert 0 < amplification(m, recoverable=True) < math.inf
    light = np.random.default_rng(0).random(16)[:, None, None] * np.ones((12, 12))
    result = demultiplex(multiplex(light, m), m, route=route)
    assert np.isfinite(result).all()
    # what is measured comes back, what is not is zero
    projector = m.inverse() @ m.matrix
    np.testing.assert_allclose(
        result, np.broadcast_to((projector @ light[:, 0, 0])[:, None, None], result.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.diag(projector), 1 - m.lost(), atol=1e-12)


def test_nearly_singular_mask_and_the_stated_cut_off() -> None:
    m = modulator_from_matrix("nearly", (2, 1), np.array([[1.0, 1.0], [1.0, 1.0 + 1e-9]]), colours=("a", "b"))
    assert m.rank() == 2 and amplification(m) > 1e8
    assert m.rank(1e-6) == 1 and np.abs(m.inverse(1e-6)).max() < 1
    noisy = np.random.default_rng(0).normal(1, 0.01, (8, 8))
    assert np.abs(demultiplex(noisy, m)).max() > 1e5
    assert np.abs(demultiplex(noisy, m, rcond=1e-6)).max() < 2
    with pytest.raises(InputError, match="cut-off"):
        m.rank(-1.0)


def test_super_pixel_of_one() -> None:
    frame = np.random.default_rng(1).random((5, 7))
    for m in (mask("pinhole", 1), mask("lenslet", 1), mask("sum_of_sinusoids", 1)):
        assert (amplification(m), transmission(m), m.rank()) == (1.0, 1.0, 1)
        for options in ({}, {"filter": "sinc"}, {"route": "fourier"}, {"filter": "bilateral"}, {"filter": "nearest"}):
            np.testing.assert_allclose(demultiplex(frame, m, **options)[0], frame, atol=1e-12)
    assert snr_gain(mask("lenslet", 1), mask("pinhole", 1), 3.0) == 0
    white = cfa("W")
    assert white.rank() == 1 and demultiplex(frame, white).shape == (3, 5, 7)
    np.testing.assert_allclose(demultiplex(frame, white).sum(0), frame)
    one = SuperPixelLattice("square", (0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    np.testing.assert_allclose(lattice_channels(frame, one, 1)[0, 0], frame)


@pytest.mark.parametrize("route", ["spatial", "fourier"])
def test_zero_transmission(route: str) -> None:
    dark = mask_at_distance(np.zeros((3, 3)), 1.0)
    assert (dark.rank(), transmission(dark), amplification(dark)) == (0, 0.0, math.inf)
    assert amplification(dark, recoverable=True) == math.inf
    for chi2 in (0.0, 1.0, math.inf):
        assert snr_gain(dark, mask("pinhole", 3), chi2) == -math.inf
    assert dark.lost().tolist() == [1.0] * 9
    np.testing.assert_array_equal(demultiplex(np.ones((6, 6)), dark, route=route), 0)
    assert describe(dark, mask("pinhole", 3), 0.0).gain_db == -math.inf
    with pytest.raises(InputError, match="recovers every sample"):
        snr_gain(mask("pinhole", 3), dark, 0.0)


@pytest.mark.parametrize("shape", [(1, 1), (10, 40), (40, 10), (0, 0)])
def test_frame_smaller_than_a_super_pixel(shape: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="super-pixel"):
        demultiplex(np.ones(shape), mask("MURA", 11))
    lattice = SuperPixelLattice("square", (5.0, 5.0), (11.3, 0.0), (0.0, 11.3))
    with pytest.raises(InputError, match="super-pixel"):
        lattice_channels(np.ones(shape), lattice, 11)


@pytest.mark.parametrize("filter", ["nearest", "linear", "cubic", "lanczos", "sinc", "bilateral"])
def test_a_single_super_pixel(filter: str) -> None:
    m = mask("MURA", 3)
    light = np.arange(1.0, 10)[:, None, None] * np.ones((3, 3))
    np.testing.assert_allclose(demultiplex(multiplex(light, m), m, filter=filter)[:, 0, 0], light[:, 0, 0], atol=1e-10)
    np.testing.assert_allclose(
        demultiplex(multiplex(light, m), m, route="fourier")[:, 0, 0], light[:, 0, 0], atol=1e-10
    )


@pytest.mark.parametrize("shape", [(13, 15), (12, 13), (17, 12), (23, 31)])
@pytest.mark.parametrize("name", ["Bayer", "X-Trans", "RGBW 4x4"])
@pytest.mark.few(6)
def test_frames_that_end_within_a_super_pixel(shape: tuple[int, int], name: str) -> None:
    m = cfa(name)
    light = np.array([3.0, 2.0, 1.0])[:, None, None] * np.ones(shape)
    frame = multiplex(light, m)
    for options in ({}, {"filter": "bilateral"}, {"route": "fourier"}):
        result = demultiplex(frame, m, **options)
        assert result.shape == (3, *shape)
        np.testing.assert_allclose(result, light, atol=1e-10)
    assert demultiplex(frame, m, out=np.empty((3, *shape), np.float32)).dtype == np.float32


@pytest.mark.parametrize("pitch", [3.001, math.pi, 4.5, 7.0 / 1.5])
def test_non_integer_periods(pitch: float) -> None:
    """Pinholes at any pitch: the view's samples follow the pinholes over the whole frame, no drift."""
    shape = (60, 90)
    y, x = np.indices(shape)
    scene = 2 + np.sin(y / 17) + np.cos(x / 23)
    lattice = SuperPixelLattice("square", (30.0, 45.0), (pitch, 0.02), (-0.02, pitch))
    views = demultiplex_lattice(scene, lattice, mask("pinhole", 3), filter="cubic")
    # shares are those of one super-pixel each: its centre is the sample's place
    grid = view_grid(lattice, shape, pitch / 3, axes="lattice")
    cy, cx = np.moveaxis(grid.centres_px[grid.near[..., 0]], -1, 0)
    np.testing.assert_allclose(views[4], 2 + np.sin(cy / 17) + np.cos(cx / 23), atol=5e-3)


def test_mask_shadow_of_a_fraction_of_a_pixel_says_what_it_loses() -> None:
    pattern = (np.random.default_rng(0).random((5, 5)) < 0.5).astype(float)
    for shift in (0.0, 0.1, 0.5, 1.0, 2.5, 5.0):
        m = mask_at_distance(pattern, shift)
        assert np.isfinite(m.inverse()).all() and np.isrealobj(m.matrix)
        assert m.rank() + round(m.lost().sum()) == 25
        assert -1e-12 < m.matrix.min() and m.matrix.max() < 1 + 1e-12
    assert mask_at_distance(pattern, 5.0).rank() == 1


def test_extreme_light_levels() -> None:
    for scale in (1e-30, 1e30):
        frame = scale * np.random.default_rng(2).random((12, 12))
        for options in ({}, {"filter": "bilateral"}, {"route": "fourier"}):
            result = demultiplex(frame, cfa("CYMG"), **options)
            assert np.isfinite(result).all() and np.abs(result).max() < 10 * scale
    even = demultiplex(np.full((12, 12), 7.0), cfa("Bayer"), filter="bilateral")
    np.testing.assert_allclose(even, 7.0)
