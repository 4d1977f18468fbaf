from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from lfcal.base.errors import InputError
from lfcal.frames.source import Position
from lfcal.psf.cutout import Cutout, find_cutout


def spot(row: float, column: float, shape: tuple[int, int] = (60, 70), width: float = 2.5) -> np.ndarray:
    r, c = np.mgrid[: shape[0], : shape[1]]
    return np.exp(-((r - row) ** 2 + (c - column) ** 2) / (2 * width**2))


def test_the_window_follows_the_point_one_pixel_a_step() -> None:
    cutout = Cutout((5, 7), anchor=(20, 30))
    for z, y, x in np.ndindex(2, 3, 4):
        window = cutout.window(Position(z, y, x))
        assert (window.row, window.column) == (20 + y - 2, 30 + x - 3)
        assert window.row_residual == window.column_residual == 0


def test_the_rest_is_at_most_half_a_pixel() -> None:
    for value in (-0.75, -0.5, -0.2, 0.0, 0.3, 0.5, 0.51, 1.5):
        window = Cutout((3, 3), anchor=(10 + value, 10)).window(Position(0, 0, 0))
        assert -0.5 < window.row_residual <= 0.5
        assert window.row + 1 + window.row_residual == pytest.approx(10 + value)


@pytest.mark.parametrize(("interpolation", "bound"), [("linear", 0.04), ("cubic", 1e-3), ("fourier", 1e-4)])
def test_interpolation_against_the_analytic_spot(interpolation: str, bound: float) -> None:
    frame = spot(30.3, 35.6).astype(np.float32)
    cutout = Cutout((31, 31), anchor=(30.3, 35.6), interpolation=interpolation)
    window = cutout.window(Position(0, 0, 0))
    cut = cutout.resample(frame[cutout.region(window)], window)
    truth = spot(15, 15, (31, 31))
    assert np.abs(cut - truth).max() < bound
    wrong = cutout.resample(frame[cutout.region(window)], window._replace(row_residual=-window.row_residual))
    assert np.abs(wrong - truth).max() > 3 * bound  # the sign matters


def test_fourier_is_exact_for_band_limited_patterns() -> None:
    n = 21
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft2(rng.normal(size=(n, n)))
    base = np.fft.irfft2(spectrum, s=(n, n))
    cutout = Cutout((n, n), anchor=(10.25, 9.6), interpolation="fourier")
    moved = ndimage.fourier_shift(np.fft.fft2(base), (-0.25, 0.4))
    window = cutout.window(Position(0, 0, 0))
    np.testing.assert_allclose(cutout.resample(base, window), np.fft.ifft2(moved).real, atol=1e-5)


def test_resampling_makes_the_period_whole() -> None:
    """A pattern of period 9.8 px becomes one of 10; the cutout steps by resampled pixels and keeps the energy."""
    scale = (10 / 9.8, 10 / 10.3)
    cutout = Cutout((31, 31), anchor=(45.0, 45.0), interpolation="cubic", scale=scale)
    for y, x in [(0, 0), (5, 3)]:
        window = cutout.window(Position(0, y, x))
        frame = spot(45 + y / scale[0], 45 + x / scale[1], (90, 90)).astype(np.float32)
        cut = cutout.resample(frame[cutout.region(window)], window)
        r, c = np.mgrid[-15:16, -15:16]
        truth = np.exp(-((r / scale[0]) ** 2 + (c / scale[1]) ** 2) / (2 * 2.5**2)) / (scale[0] * scale[1])
        assert np.abs(cut - truth).max() < 2e-3
        assert cut.sum() == pytest.approx(frame.sum(), rel=2e-3)
    with pytest.raises(InputError, match="linear or cubic"):
        Cutout((31, 31), scale=scale)


def test_bad_cutouts_are_refused() -> None:
    for options, words in (
        ({"shape": (4, 5)}, "odd"),
        ({"shape": (0, 5)}, "odd"),
        ({"shape": (5, 5), "anchor": (float("nan"), 0)}, "finite"),
        ({"shape": (5, 5), "interpolation": "sharp"}, "interpolation"),
        ({"shape": (5, 5), "outside": "wrap"}, "outside"),
    ):
        with pytest.raises(InputError, match=words):
            Cutout(**options)  # type: ignore[arg-type]


@pytest.mark.parametrize("lost", [0.001, 0.005, 0.05])
def test_the_size_follows_from_the_energy_lost(lost: float) -> None:
    images, centres = [], []
    rng = np.random.default_rng(4)
    for dy, dx in [(0, 0), (3, 5), (7, 2)]:
        images.append(1000 * spot(70 + dy, 70 + dx, (150, 150), 8.0) + 100 + rng.normal(0, 0.05, (150, 150)))
        centres.append((70 + dy, 70 + dx))
    nt, ns = find_cutout(images, centres, lost=lost)
    assert nt % 2 == ns % 2 == 1
    for image, (r, c) in zip(images, centres, strict=True):
        signal = image - 100
        kept = signal[r - nt // 2 : r + nt // 2 + 1, c - ns // 2 : c + ns // 2 + 1].sum() / signal.sum()
        assert kept >= 1 - 1.2 * lost
        tight = signal[r - nt // 2 + 3 : r + nt // 2 - 2, c - ns // 2 + 3 : c + ns // 2 - 2].sum() / signal.sum()
        assert tight < 1 - lost / 2  # the size is not simply too large


def test_a_dark_frame_has_no_cutout() -> None:
    with pytest.raises(InputError, match="light"):
        find_cutout([np.full((20, 20), 7.0)], [(10, 10)])
    with pytest.raises(InputError, match="a fraction above 0 and below 1"):
        find_cutout([spot(5, 5, (20, 20))], [(5, 5)], lost=2)
