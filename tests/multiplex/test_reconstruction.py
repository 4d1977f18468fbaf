"""Both routes: plain loops, exact recovery of band-limited light, equality, corollary 1, ringing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.multiplex import Modulator, arrange, cfa, demultiplex, mask, multiplex
from lfcal.multiplex.filters import LINEAR_FILTERS, kernel
from lfcal.multiplex.quality import measure_filters, ringing
from lfcal.multiplex.scenes import colour_edges, view_edges, zone_plate

RNG = np.random.default_rng
CASES = [
    (cfa("Bayer"), (24, 30)),
    (cfa("CYMG"), (26, 30)),
    (cfa("RGB/GBR"), (24, 30)),
    (cfa("X-Trans"), (24, 30)),
    (mask("MURA", 5), (35, 40)),
    (mask("sum_of_sinusoids", 3), (24, 27)),
    (mask("pinhole", 5), (35, 30)),
    (mask("lenslet", 5), (35, 40)),
    (mask("lenslet", 3) * cfa("Bayer"), (24, 30)),
    (cfa("RRGG"), (8, 8)),
]
IDS = [m.name for m, _ in CASES]


def by_loops(frame: NDArray[np.float64], m: Modulator, name: str, samples: tuple[int, int]) -> NDArray[np.float64]:
    """Theorem 1 as plainly as it can be written."""
    (py, px), (rows, columns) = m.side, frame.shape
    ny, nx = rows // py, columns // px
    out = np.zeros((m.count, ny * samples[0], nx * samples[1]))
    inverse = np.linalg.pinv(m.matrix)
    where_y, where_x = m.positions
    for n in range(out.shape[1]):
        for k in range(out.shape[2]):
            y, x = (n + 0.5) * py / samples[0] - 0.5, (k + 0.5) * px / samples[1] - 0.5
            channels = np.zeros(m.pixels)
            for a in range(py):
                for b in range(px):
                    ty, tx = (y - where_y[a]) / py, (x - where_x[b]) / px
                    near_y, near_x = (np.arange(np.floor(t) - 4, np.floor(t) + 6) for t in (ty, tx))
                    wy, wx = (kernel(name, t - near) for t, near in ((ty, near_y), (tx, near_x)))
                    iy, ix = (np.clip(v, 0, top - 1).astype(int) for v, top in ((near_y, ny), (near_x, nx)))
                    part = frame[a::py, b::px][np.ix_(iy, ix)]
                    channels[a * px + b] = (wy / wy.sum()) @ part @ (wx / wx.sum())
            out[:, n, k] = inverse @ channels
    return out


@pytest.mark.few(10)
@pytest.mark.parametrize(("modulator", "shape"), CASES, ids=IDS)
@pytest.mark.parametrize("name", ["linear", "cubic", "lanczos"])
def test_spatial_route_is_theorem_1(modulator: Modulator, shape: tuple[int, int], name: str) -> None:
    small = tuple(min(n, 3 * s) // s * s for n, s in zip(shape, modulator.side, strict=True))
    frame = RNG(1).random(small)
    samples = (2, 3)
    expected = by_loops(frame, modulator, name, samples)
    result = demultiplex(frame, modulator, filter=name, samples=samples, workers=2)
    np.testing.assert_allclose(result, expected, atol=1e-10 * max(1, np.abs(expected).max()))


@pytest.mark.parametrize("samples", [None, 1, (2, 3), 7])
def test_fourier_route_is_the_spatial_route_with_a_sinc(samples) -> None:
    for modulator, shape in CASES:
        frame = RNG(2).random(shape)
        one = demultiplex(frame, modulator, filter="sinc", samples=samples)
        two = demultiplex(frame, modulator, route="fourier", samples=samples)
        np.testing.assert_allclose(one, two, atol=1e-12 * max(1, np.abs(one).max()), err_msg=modulator.name)
        if samples == 7:  # one sample per lenslet needs no filter
            assert not np.allclose(demultiplex(frame, modulator, filter="cubic", samples=samples), two, atol=1e-3)


@pytest.mark.parametrize("name", ["nearest", "linear", "cubic", "lanczos", "sinc", "bilateral", "fourier"])
def test_even_light_is_recovered(name: str) -> None:
    options = {"route": "fourier"} if name == "fourier" else {"filter": name}
    for modulator, shape in CASES[:-1]:
        light = RNG(3).random(modulator.count)[:, None, None] * np.ones(shape)
        result = demultiplex(multiplex(light, modulator), modulator, **options)
        wanted = np.broadcast_to(light[:, :1, :1], result.shape)
        np.testing.assert_allclose(result, wanted, atol=1e-8, err_msg=modulator.name)


def band_limited(modulator: Modulator, cells: tuple[int, int]) -> NDArray[np.float64]:
    """Return samples that are periodic and below half a cycle per super-pixel."""
    shape = tuple(n * s for n, s in zip(cells, modulator.side, strict=True))
    y, x = (np.arange(n) / n for n in shape)
    light = np.ones((modulator.count, *shape))
    rng = RNG(4)
    for _ in range(4):
        ky, kx = (int(rng.integers(-(n // 2) + 1, (n + 1) // 2)) for n in cells)
        phase = rng.uniform(0, 6, modulator.count)
        light += 0.1 * np.cos(2 * np.pi * (ky * y[:, None] + kx * x) + phase[:, None, None])
    return light


@pytest.mark.parametrize(
    "modulator", [cfa("Bayer"), cfa("CYYM"), mask("MURA", 5), mask("sum_of_sinusoids", 3)], ids=lambda m: m.name
)
def test_band_limited_light_is_recovered_exactly(modulator: Modulator) -> None:
    light = band_limited(modulator, (9, 8))
    frame = multiplex(light, modulator)
    for options in ({"route": "fourier"}, {"filter": "sinc"}):
        result = demultiplex(frame, modulator, samples=modulator.side, **options)
        np.testing.assert_allclose(result, light, atol=1e-10)
    wrong = demultiplex(frame, modulator.shifted(0, 1), samples=modulator.side, route="fourier")
    assert np.abs(wrong - light).max() > 0.01, "a pattern off by a pixel must not fit"
    placed = demultiplex(np.roll(frame, 1, 1), modulator, origin=(0, 1), samples=modulator.side, route="fourier")
    np.testing.assert_allclose(placed, np.roll(light, 1, 2), atol=1e-10)


@pytest.mark.parametrize("modulator", [cfa("CYMG"), mask("MURA", 5)], ids=lambda m: m.name)
def test_linear_filters_commute_with_decorrelation(modulator: Modulator) -> None:
    """Corollary 1: blurring the correlated channels is blurring the samples; a median is not."""
    py, px = modulator.side
    frame = RNG(5).random((py * 12, px * 12))
    eye = np.eye(modulator.pixels)
    identity = Modulator("channels", modulator.side, eye, eye, views=modulator.side)
    channels = demultiplex(frame, identity, samples=modulator.side, filter="cubic")
    samples = demultiplex(frame, modulator, samples=modulator.side, filter="cubic")
    inverse = modulator.inverse()

    def commutes(operate) -> bool:
        before = np.tensordot(inverse, np.stack([operate(c) for c in channels]), 1)
        after = np.stack([operate(s) for s in samples])
        return bool(np.allclose(before, after, atol=1e-10))

    assert commutes(lambda c: cv2.GaussianBlur(c, (0, 0), 1.5))
    assert commutes(lambda c: cv2.Laplacian(c, -1))
    assert commutes(lambda c: cv2.resize(c, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_LINEAR))
    assert not commutes(lambda c: cv2.medianBlur(c.astype(np.float32), 3).astype(float))


def test_fourier_route_rings_at_edges_and_cubic_does_not() -> None:
    """Figures 3 and 5."""
    chart = colour_edges((160, 200))
    frame = multiplex(chart, cfa("Bayer"))
    ways: tuple[dict[str, str], ...] = ({"filter": "cubic"}, {"route": "fourier"})
    cubic, fourier = (ringing(demultiplex(frame, cfa("Bayer"), **o), chart, (2, 2)) for o in ways)
    assert cubic.flat < 1e-12 and fourier.flat > 0.01
    assert fourier.overshoot > 1.5 * cubic.overshoot
    field, sines = view_edges(5, (32, 40)), mask("sum_of_sinusoids", 5)
    frame = multiplex(field, sines)
    cubic, fourier = (ringing(demultiplex(frame, sines, samples=5, **o), field, (5, 5)) for o in ways)
    assert cubic.flat < 1e-12 and fourier.flat > 0.1


def test_errors_of_the_filters() -> None:
    found = measure_filters(colour_edges((96, 96)), cfa("Bayer"), rounds=1)
    trials = {t.filter: t for t in found if t.route == "spatial"}
    linear = [t.error for name, t in trials.items() if name in LINEAR_FILTERS]
    assert trials["bilateral"].error < min(linear)
    assert {"lmmse", "directional"} <= set(trials)
    assert trials["bilateral"].ringing is not None and trials["bilateral"].ringing.overshoot < 1e-12
    smooth = {t.filter: t.error for t in measure_filters(zone_plate((96, 96), 0.1), cfa("Bayer"), rounds=1)}
    assert smooth["nearest"] > smooth["linear"] > smooth["cubic"] > smooth["lanczos"]
    assert any(t.efficient for t in trials.values())


@pytest.mark.few(1)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32, np.float64])
def test_sample_types_and_threads(dtype) -> None:
    frame = RNG(6).integers(0, 200, (15, 21)).astype(dtype)
    expected = demultiplex(frame.astype(float), cfa("GRBG"))
    out = np.empty((3, 15, 21), np.float32)
    for workers in (1, 3):
        result = demultiplex(frame, cfa("GRBG"), out=out, workers=workers)
        assert result is out
        np.testing.assert_allclose(result, expected, atol=1e-3)
    wanted = np.float64 if dtype in (np.float64, np.int32) else np.float32
    assert demultiplex(frame, cfa("GRBG")).dtype == wanted


def test_views_and_colours_are_separated() -> None:
    product = mask("lenslet", 3) * cfa("Bayer")
    light = (np.arange(9)[:, None] + 10.0 * np.arange(3)).ravel()
    result = arrange(demultiplex(multiplex(light[:, None, None] * np.ones((18, 18)), product), product), product)
    assert result.shape == (3, 3, 3, 6, 6)
    np.testing.assert_allclose(result[1, 2, 1], 5 + 10, atol=1e-9)


def test_wrong_options_and_frames_are_refused() -> None:
    plain = np.ones((8, 8))
    for frame, options in (
        (plain, {"route": "radon"}),
        (plain, {"filter": "box"}),
        (plain, {"samples": 0}),
        (plain, {"samples": (1, 2, 3)}),
        (plain, {"origin": (0.5, 0)}),
        (plain, {"rcond": 2.0}),
        (plain, {"rcond": 1e-6, "filter": "directional"}),
        (plain, {"out": np.empty((3, 4, 4))}),
        (np.ones((8, 8, 3)), {}),
        (np.full((8, 8), np.nan), {}),
        (np.ones((8, 8), complex), {}),
        (np.ones(8), {}),
    ):
        with pytest.raises(InputError):
            demultiplex(frame, cfa("Bayer"), **options)
    with pytest.raises(InputError):
        multiplex(np.ones((2, 8, 8)), cfa("Bayer"))
