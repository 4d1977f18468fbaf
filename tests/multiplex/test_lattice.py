"""Super-pixels of any pitch and angle: views, whole pixels, weights by dense least squares, and both theorems."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.lattice import LatticeFit, extract_views, lattice_of, view_grid
from lfcal.multiplex import (
    Modulator,
    SuperPixelLattice,
    cfa,
    channel_grid,
    demultiplex,
    demultiplex_generally,
    demultiplex_lattice,
    demultiplex_lattice_weighted,
    demultiplex_weighted,
    lattice_channels,
    lattice_channels_weighted,
    lattice_transmissions,
    mask,
    modulator_from_matrix,
    multiplex,
)
from lfcal.multiplex.heterodyne import lattice_by_sinc, lattice_by_spectrum


def lattice(kind: str, pitch: float = 11.37, angle: float = 0.013, origin=(70.3, 81.7)) -> SuperPixelLattice:
    along = pitch * np.array([math.cos(angle), math.sin(angle)])
    across = (0.87 if kind == "hexagonal" else 1.0) * pitch * np.array([-math.sin(angle), math.cos(angle)])
    lean = 0.5 if kind == "hexagonal" else 0.0
    return SuperPixelLattice(kind, origin, tuple(along.tolist()), tuple((lean * along + across).tolist()))


def small(kind: str) -> SuperPixelLattice:
    return lattice(kind, 5.3, 0.04, (20.3, 21.7))


def as_fit(given: SuperPixelLattice, shape: tuple[int, int]) -> LatticeFit:
    q, r = (v.ravel() for v in np.meshgrid(range(-15, 16), range(-15, 16)))
    index = np.stack([q, r], 1)
    centres = index @ np.array([given.along_px, given.across_px]) + np.array(given.origin_px)[::-1]
    half = given.pitch_px / 2
    index = index[((centres >= half) & (centres <= np.array(shape[::-1]) - 1 - half)).all(1)]
    n, angle = len(index), math.atan2(given.along_px[1], given.along_px[0])
    numbers = (given.pitch_px, given.row_pitch_px, angle, given.origin_px, 0.0, 0.0, 0.0)
    return LatticeFit(given.kind, shape, *numbers, index, np.zeros((n, 2)), np.ones(n), np.zeros(n, bool))


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_linear_channels_are_the_extracted_views(kind: str) -> None:
    given = lattice(kind)
    frame = np.random.default_rng(0).random((150, 170), np.float32)
    fit = as_fit(given, frame.shape)
    views = extract_views(frame, fit, radius_px=5.0, axes="lattice")
    channels = lattice_channels(frame, given, 11)
    assert channels.shape == views.images.shape
    np.testing.assert_allclose(channels, views.images, atol=2e-5)


def test_the_longer_side_of_a_super_pixel_fits_in_the_frame() -> None:
    given, shape = lattice("square"), (150, 170)
    small, large = (channel_grid(shape, given, side).shape for side in (3, 11))
    assert small != large
    for side in ((3, 11), (11, 3)):
        assert channel_grid(shape, given, side).shape == large
        assert lattice_channels(np.ones(shape), given, side).shape == (*side, *large)


def test_filters_keep_polynomials() -> None:
    given = lattice("square")
    y, x = np.mgrid[:150, :170] / 100.0
    for (name, power), spacing in itertools.product((("linear", 1), ("cubic", 2)), (1.0, 0.97)):
        channels = lattice_channels(y**power + x**power, given, 9, spacing_px=spacing, filter=name)
        grid = view_grid(given, (150, 170), 4 * spacing, axes="lattice")
        rows, columns = (np.arange(n) for n in grid.shape)
        place = columns[None, :, None] * given.along_px + rows[:, None, None] * np.array(given.across_px)
        offsets = (np.arange(9) - 4) * spacing
        cy = (place[..., 1] + grid.corner_px[0] + offsets[:, None, None, None]) / 100
        cx = (place[..., 0] + grid.corner_px[1] + offsets[None, :, None, None]) / 100
        # away from the border, where samples are repeated
        inner = (..., slice(1, -1), slice(1, -1))
        np.testing.assert_allclose(channels[inner], (cy**power + cx**power)[inner], atol=1e-10)


def test_whole_pixels_are_plain_demultiplexing() -> None:
    frame = np.random.default_rng(1).random((55, 66))
    given = SuperPixelLattice("square", (5.0, 5.0), (11.0, 0.0), (0.0, 11.0))
    for kind in ("lenslet", "pinhole"):
        m = mask(kind, 11)
        plain = frame.reshape(5, 11, 6, 11).transpose(1, 3, 0, 2).reshape(121, 5, 6) / m.matrix[0, 0]
        for name in ("nearest", "linear", "cubic"):
            np.testing.assert_allclose(demultiplex_lattice(frame, given, m, filter=name), plain, atol=1e-12)
    np.testing.assert_allclose(demultiplex(frame, mask("lenslet", 11)) * 121, plain, atol=1e-12)


def test_mask_of_non_integer_period() -> None:
    """A MURA mask whose shadow repeats every 8.6 pixels, light smooth over it."""
    pitch, p = 8.6, 5
    coarse = mask("MURA", p)
    light = np.linspace(0.5, 1.5, 25)
    cell = multiplex(light[:, None, None] * np.ones((p, p)), coarse)
    harmonics = np.fft.fftfreq(p, 1 / p)
    shape, centre = (120, 130), (60.0, 64.0)
    weights = np.fft.fft2(cell) / p**2
    waves = [
        np.exp(2j * np.pi * np.outer((np.arange(n) - c) / pitch + (p - 1) / 2 / p, harmonics))
        for n, c in zip(shape, centre, strict=True)
    ]
    frame = (waves[0] @ weights @ waves[1].T).real
    given = SuperPixelLattice("square", centre, (pitch, 0.0), (0.0, pitch))
    views = demultiplex_lattice(frame, given, coarse, filter="cubic")
    assert np.abs(views.mean((1, 2)) - light).max() < 0.25
    linear = demultiplex_lattice(frame, given, coarse, filter="linear")
    assert np.abs(views - light[:, None, None]).mean() < np.abs(linear - light[:, None, None]).mean()
    whole = SuperPixelLattice("square", centre, (9.0, 0.0), (0.0, 9.0))
    wrong = demultiplex_lattice(frame, whole, coarse, filter="cubic")
    assert np.abs(wrong - light[:, None, None]).mean() > 3 * np.abs(views - light[:, None, None]).mean()


def test_the_lattice_of_a_camera() -> None:
    given = lattice_of(preset("r29"))
    assert given.kind == "hexagonal" and given.pitch_px == pytest.approx(31.7)
    assert given.centres_px(0, 0) == pytest.approx(((4384 - 1) / 2, (6576 - 1) / 2))


@pytest.mark.long
def test_threads_change_nothing() -> None:
    given = lattice_of(preset("r29"))
    near = SuperPixelLattice("hexagonal", (40.0, 50.0), *given.basis_px().tolist())
    frame = np.random.default_rng(2).integers(0, 4096, (220, 260)).astype(np.uint16)
    one = lattice_channels(frame, near, 31, filter="cubic", workers=1)
    np.testing.assert_array_equal(one, lattice_channels(frame, near, 31, filter="cubic", workers=3))
    out = np.empty_like(one)
    assert lattice_channels(frame, near, 31, filter="cubic", out=out) is out


RNG = np.random.default_rng
Array = NDArray[np.float64]


TALL = modulator_from_matrix("tall", (5, 5), RNG(9).random((25, 4)), views=(2, 2), cell=(5, 5))


def shares_of(given: SuperPixelLattice, shape: tuple[int, int], m: Modulator, at: tuple[int, int]) -> Array:
    """Return what each channel of one sample takes of every pixel, ``(K, rows, columns)``, by plain loops."""
    grid = channel_grid(shape, given, m.side, spacing_px=None)
    step = (given.row_pitch_px / m.side[0], given.pitch_px / m.side[1])
    found = np.zeros((m.pixels, *shape))
    for k in range(m.pixels):
        a, b = divmod(k, m.side[1])
        for lens, share in zip(grid.near[at], grid.share[at], strict=True):
            y = grid.centres_px[lens, 0] + (a - (m.side[0] - 1) / 2) * step[0]
            x = grid.centres_px[lens, 1] + (b - (m.side[1] - 1) / 2) * step[1]
            top, left = math.floor(y), math.floor(x)
            for row, down in ((top, top + 1 - y), (top + 1, y - top)):
                for column, across in ((left, left + 1 - x), (left + 1, x - left)):
                    if share * down * across:
                        found[k, row, column] += share * down * across
    return found


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("m", [mask("MURA", 5), mask("lenslet", 4), TALL], ids=lambda m: m.name)
def test_weighted_views_are_dense_least_squares(kind: str, m: Modulator) -> None:
    given, shape = small(kind), (41, 44)
    frame, weights = RNG(2).random(shape), RNG(3).random(shape) * (RNG(4).random(shape) > 0.05)
    found = demultiplex_lattice_weighted(frame, given, m, weights)
    assert found.samples.shape == (m.count, *channel_grid(shape, given, m.side, spacing_px=None).shape)
    at = (2, 3)
    shares = shares_of(given, shape, m, at)
    total, squared = (shares * weights).sum((1, 2)), (shares**2 * weights).sum((1, 2))
    assert (total > 0).all()
    values = (shares * weights * frame).sum((1, 2)) / total
    root = total / np.sqrt(squared)
    wanted = np.linalg.lstsq(root[:, None] * m.matrix, root * values, rcond=None)[0]
    np.testing.assert_allclose(found.samples[:, *at], wanted, atol=1e-9 * max(1, np.abs(wanted).max()))
    # the noise of every pixel through all channels that take it
    inverse = np.linalg.pinv(root[:, None] * m.matrix) * root
    every = np.tensordot(inverse / total, shares * weights, 1)
    lit = weights > 0
    variance = (every[:, lit] ** 2 / weights[lit]).sum(1)
    np.testing.assert_allclose(found.deviation[:, *at], np.sqrt(variance), rtol=1e-6)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_equal_weights_change_nothing(kind: str) -> None:
    given, frame = small(kind), RNG(5).random((41, 44)).astype(np.float32)
    m = mask("MURA", 5)
    plain, weighed = (demultiplex_lattice(frame, given, m, weights=w) for w in (None, np.full(frame.shape, 7.0)))
    assert weighed.dtype == np.float32
    np.testing.assert_allclose(weighed, plain, atol=1e-4)
    plain, weighed = (lattice_channels(frame, given, 5, weights=w) for w in (None, np.full(frame.shape, 7.0)))
    np.testing.assert_allclose(weighed, plain, atol=1e-6)
    out = np.empty_like(plain)
    assert lattice_channels(frame, given, 5, weights=np.ones(frame.shape), out=out) is out


def test_whole_pixels_are_the_weighted_route_of_super_pixels() -> None:
    given = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0))
    frame, weights = RNG(6).random((35, 40)), RNG(7).random((35, 40)) * (RNG(8).random((35, 40)) > 0.1)
    one = demultiplex_lattice_weighted(frame, given, mask("lenslet", 5), weights)
    two = demultiplex_weighted(frame, mask("lenslet", 5), weights)
    lit = weights.reshape(7, 5, 8, 5).transpose(1, 3, 0, 2).reshape(25, 7, 8) > 0
    np.testing.assert_allclose(one.samples[lit], two.samples[lit], atol=1e-12)
    np.testing.assert_allclose(one.deviation[lit], two.deviation[lit], rtol=1e-9)
    channels = lattice_channels_weighted(frame, given, 5, weights)
    np.testing.assert_allclose(channels.samples.reshape(25, 7, 8), 25 * one.samples, atol=1e-12)


def test_dead_and_saturated_pixels_are_bridged() -> None:
    given, shape = lattice("square", 9.7, 0.01, (20.3, 21.7)), (120, 130)
    y, x = np.mgrid[: shape[0], : shape[1]] / 100
    frame, weights = 1 + y + 2 * x, np.ones(shape)
    frame[40:44, 50:53], weights[40:44, 50:53] = np.nan, 0
    frame[80, 20:30], weights[80, 20:30] = 4095, 0
    found = lattice_channels_weighted(frame, given, 7, weights)
    plain = lattice_channels(1 + y + 2 * x, given, 7)
    assert np.isfinite(found.deviation).all()
    # a missing channel is replaced by super-pixels around it, over which this light changes evenly
    np.testing.assert_allclose(found.samples, plain, atol=0.25)
    assert (np.abs(found.samples - plain) < 1e-9).mean() > 0.9
    with pytest.raises(InputError):
        lattice_channels(frame, given, 7)


def test_what_no_pixel_measures_has_an_infinite_deviation() -> None:
    given, frame = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0)), np.ones((35, 40))
    weights = np.ones(frame.shape)
    weights[2::5, 3::5] = 0
    found = demultiplex_lattice_weighted(frame, given, mask("lenslet", 5), weights)
    lost = np.isinf(found.deviation).all((1, 2))
    assert np.flatnonzero(lost).tolist() == [13] and not found.samples[13].any()
    assert np.isfinite(np.delete(found.deviation, 13, 0)).all()
    assert np.isinf(lattice_channels_weighted(frame, given, 5, weights).deviation[2, 3]).all()


@pytest.mark.long
@pytest.mark.parametrize("m", [mask("MURA", 5), mask("lenslet", 5)], ids=lambda m: m.name)
@pytest.mark.few(1)
def test_the_stated_deviation_is_measured_within_a_percent(m: Modulator) -> None:
    given, shape = small("square"), (60, 64)
    deviation = RNG(10).uniform(0.5, 2.0, shape)
    rng, ratios = RNG(11), []
    for _ in range(20):
        one = demultiplex_lattice_weighted(deviation * rng.standard_normal(shape), given, m, 1 / deviation**2)
        ratios.append((one.samples / one.deviation) ** 2)
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1, abs=0.01)


def test_wrong_lattices_and_weights_are_refused() -> None:
    frame, large, ones = np.ones((41, 44)), np.ones((199, 199)), np.ones((41, 44))
    given, m, mura = small("square"), mask("MURA", 5), mask("MURA", 3)
    for call, what in (
        (lambda: lattice_channels(np.ones((8, 8)), lattice("square"), 31), "expected"),
        (lambda: lattice_channels(large, lattice("square"), 0), "expected"),
        (lambda: lattice_channels(large, lattice("square"), 5, filter="sinc"), "expected"),
        (lambda: lattice_channels(large, lattice("square"), 5, spacing_px=0.0), "expected"),
        (lambda: lattice_channels(large, lattice("square"), 5, out=np.ones((5, 5))), "expected"),
        (lambda: demultiplex_lattice(large, lattice("square"), cfa("Bayer")), "expected"),
        (lambda: SuperPixelLattice("square", (0, 0), (1, 0), (1, 0)), "expected"),
        (lambda: SuperPixelLattice("triangular", (0, 0), (9, 0), (0, 9)), "expected"),
        (lambda: demultiplex_lattice(frame, given, m, weights=ones, filter="cubic"), "reconstruction with weights"),
        (lambda: demultiplex_lattice(frame, given, m, weights=ones, route="fourier"), "reconstruction with weights"),
        (lambda: demultiplex_lattice(frame, given, m, weights=ones, filter="sinc"), "reconstruction with weights"),
        (lambda: demultiplex_lattice_weighted(frame, given, cfa("Bayer"), ones), "super-pixel"),
        (lambda: lattice_transmissions((9, 9), TURNED, mura, profile="steps"), "profile"),
        (lambda: demultiplex_lattice(np.ones((400, 400)), TURNED, mura, filter="sinc"), "for the filter sinc"),
        (lambda: demultiplex_lattice(np.ones((90, 90)), TURNED, mura, route="radon"), "route"),
    ):
        with pytest.raises(InputError, match=what):
            call()
    for bad in (np.zeros(frame.shape), -ones, np.ones((3, 3)), np.full(frame.shape, np.nan)):
        with pytest.raises(InputError, match="weights of the pixels"):
            demultiplex_lattice(frame, given, m, weights=bad)
        with pytest.raises(InputError, match="weights of the pixels"):
            lattice_channels(frame, given, 5, weights=bad)


RNG = np.random.default_rng


def closing(shape: tuple[int, int], down: tuple[int, int], right: tuple[int, int]) -> SuperPixelLattice:
    """Return a turned lattice of no whole pitch that closes over a periodic frame: its waves are bins of the frame."""
    waves = np.array([down, right]) / np.array(shape)
    across, along = np.linalg.inv(waves).T
    return SuperPixelLattice("square", (3.3, 4.1), tuple(along[::-1].tolist()), tuple(across[::-1].tolist()))


SHAPE = (96, 100)
TURNED = closing(SHAPE, (18, 1), (-1, 19))


def smooth(count: int, seed: int = 0) -> np.ndarray:
    """Return samples of two waves each, well below half a cycle per super-pixel, periodic over the frame."""
    y, x = (np.arange(n) / n for n in SHAPE)
    rng = RNG(seed)
    light = np.ones((count, *SHAPE))
    for _ in range(3):
        ky, kx = rng.integers(-6, 7, 2)
        light += 0.2 * np.cos(2 * np.pi * (ky * y[:, None] + kx * x) + rng.uniform(0, 6, (count, 1, 1)))
    return light


@pytest.mark.parametrize("kind", ["sum_of_sinusoids", "MURA"])
@pytest.mark.parametrize("size", [3, 5])
def test_both_routes_are_equal_and_recover_the_light(kind: str, size: int) -> None:
    m, light = mask(kind, size), smooth(size * size)
    assert TURNED.pitch_px % 1 > 0.05 and abs(TURNED.rotation_rad) > 0.03
    frame = (lattice_transmissions(SHAPE, TURNED, m, profile="sinusoids") * light).sum(0)
    places = RNG(1).uniform(0, 90, (40, 2))
    one = lattice_by_spectrum(frame, TURNED, m, places)
    two = lattice_by_sinc(frame, TURNED, m, places)
    assert np.abs(one - two).max() < 1e-12 * np.abs(one).max() * m.condition
    spectra = np.fft.fft2(light) / light[0].size
    fy, fx = (np.fft.fftfreq(n) for n in SHAPE)
    waves = np.exp(2j * np.pi * (places[:, :1, None] * fy[:, None] + places[:, 1:, None] * fx))
    truth = np.einsum("nyx,pyx->np", spectra, waves).real
    np.testing.assert_allclose(one, truth, atol=1e-10)


def test_routes_differ_if_the_frame_is_not_band_limited() -> None:
    m = mask("sum_of_sinusoids", 3)
    frame = RNG(2).random(SHAPE)
    one = demultiplex_lattice(frame, TURNED, m, route="fourier")
    assert np.abs(one - demultiplex_lattice(frame, TURNED, m, filter="sinc")).max() > 0.1


def test_even_periods_and_whole_pixels_are_the_plain_routes() -> None:
    whole = SuperPixelLattice("square", (1.5, 1.5), (4.0, 0.0), (0.0, 4.0))
    random = Modulator("random", (4, 4), RNG(3).random((16, 16)), np.eye(16), (4, 4), cell=(4, 4))
    frame = RNG(4).random((32, 40))
    plain = demultiplex(frame, random, route="fourier")
    for options in ({"route": "fourier"}, {"filter": "sinc"}):
        found = demultiplex_lattice(frame, whole, random, **options)
        np.testing.assert_allclose(found, plain, atol=1e-9 * np.abs(plain).max())


def test_a_mask_that_is_turned_and_no_whole_number_of_pixels_wide() -> None:
    """5.3 px, turned by 0.2 degrees, MURA 5 x 5: views of 0.6 … 1.4 were 0.51 … 1.48 by cubic interpolation."""
    angle, pitch = np.radians(0.2), 5.3
    along = (pitch * np.cos(angle), pitch * np.sin(angle))
    given = SuperPixelLattice("square", (60.0, 64.0), along, (-along[1], along[0]))
    m, light = mask("MURA", 5), np.linspace(0.6, 1.4, 25)
    frame = np.tensordot(light, lattice_transmissions((160, 170), given, m, profile="sinusoids"), 1)
    cubic = demultiplex_lattice(frame, given, m, filter="cubic")
    fourier = demultiplex_lattice(frame, given, m, route="fourier")
    off = [np.abs(one - light[:, None, None])[:, 4:-4, 4:-4].max() for one in (fourier, cubic)]
    assert off[0] < 0.05 < off[1]


def test_shares_of_cells_are_within_those_of_the_mask() -> None:
    m = mask("MURA", 5)
    shares = lattice_transmissions((300, 320), TURNED, m)
    assert shares.min() >= 0 and shares.max() <= 1
    np.testing.assert_allclose(shares.mean((1, 2)), m.matrix.mean(0), atol=2e-3)
    # on whole pixels a cell is a pixel
    whole = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0))
    plain = lattice_transmissions((10, 15), whole, m)
    np.testing.assert_allclose(plain, np.tile(m.matrix.T.reshape(25, 5, 5), (1, 2, 3)), atol=1e-12)
    sines = lattice_transmissions((60, 60), TURNED, mask("sum_of_sinusoids", 5), profile="sinusoids")
    assert sines.min() >= -1e-9 and sines.max() <= 1 + 1e-9, "the profile between the pixels is one of a mask"


def test_sharp_cells_of_a_turned_mask_by_the_general_route() -> None:
    """What neither theorem covers: cells with borders across pixels, at a pitch that is no number of pixels."""
    m = mask("MURA", 3)
    shares = lattice_transmissions(SHAPE, TURNED, m)
    light = np.linspace(0.5, 1.5, 9)[:, None, None] * np.ones(SHAPE)
    found = demultiplex_generally((shares * light).sum(0), shares, TURNED.pitch_px, smoothness=1e-5, tolerance=1e-8)
    np.testing.assert_allclose(found.samples, np.broadcast_to(light[:, :1, :1], found.samples.shape), atol=0.02)
