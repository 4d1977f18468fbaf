"""The variance that H states of its samples is that between sessions: cut out, moved, averaged."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.frames import ArraySource, CorrectionChain, Dark, White, corrected
from lfcal.frames.source import Noise
from lfcal.psf import assemble
from lfcal.psf.cutout import Cutout

SESSIONS = 60
NOISE = Noise(4.0, 0.5, 64.0)


def spot(row: float, column: float, shape: tuple[int, int]) -> np.ndarray:
    rows, columns = np.indices(shape)
    return 800 * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / (2 * 3.0**2))


def session(
    seed: int, cutout: Cutout, repeats: int, drift: tuple[float, float], white: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pattern of one position and its stated variance."""
    rng = np.random.default_rng(seed)
    shape = (61, 61)
    light = spot(30 + drift[0], 30 + drift[1], shape)
    fall = np.linspace(0.3, 1.0, shape[1])[None] * np.ones(shape)
    light = light * fall if white else light
    counts = light + 64 + np.sqrt(NOISE.constant + NOISE.slope * light) * rng.standard_normal((repeats, *shape))
    source = ArraySource(
        counts.astype(np.float32), [(0, 0, 0)] * repeats, drifts=[drift] * repeats, metadata={"noise": NOISE}
    )
    steps = (Dark(level=64.0), White(1000 * fall, 0.0)) if white else (Dark(level=64.0),)
    matrix = assemble(corrected(source, CorrectionChain(steps)), (1, 1, 1), cutout).matrix
    stated = matrix.variance(0, 0, 0)
    assert stated is not None
    return np.asarray(matrix[0, 0, 0]), stated


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("interpolation", "drift", "repeats", "white"),
    [
        ("nearest", (0.0, 0.0), 1, False),
        ("nearest", (0.0, 0.0), 3, False),
        ("linear", (0.5, 0.25), 1, False),
        ("cubic", (0.5, 0.25), 2, False),
        ("fourier", (0.3, 0.5), 1, False),
        ("nearest", (0.0, 0.0), 2, True),
    ],
)
def test_stated_variance_is_that_between_sessions(
    interpolation: str, drift: tuple[float, float], repeats: int, white: bool
) -> None:
    cutout = Cutout((21, 21), (30.0, 30.0), interpolation)
    found = [session(seed, cutout, repeats, drift, white) for seed in range(SESSIONS)]
    values, stated = (np.array([pair[k] for pair in found]) for k in (0, 1))
    ratio = values.var(axis=0, ddof=1) / stated.mean(axis=0)
    assert values.var(axis=0, ddof=1).sum() / stated.mean(axis=0).sum() == pytest.approx(1.0, abs=0.05)
    if interpolation == "fourier":
        return  # it spreads the noise of bright pixels over dark ones, which no function of the signal can say
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    bright = stated.mean(axis=0) > np.median(stated.mean(axis=0))
    # a pattern under a white image has two numbers for all its pixels, which fit to some per cent
    assert ratio[bright].mean() == pytest.approx(ratio[~bright].mean(), abs=0.15 if white else 0.06)


def test_resampled_frames_keep_their_variance() -> None:
    """A cutout whose pixels are larger than the sensor's holds more light a pixel, and its noise."""
    cutout = Cutout((21, 21), (30.0, 30.0), "linear", "error", (0.9, 0.8))
    found = [session(seed, cutout, 1, (0.0, 0.0), False) for seed in range(SESSIONS)]
    values, stated = (np.array([pair[k] for pair in found]) for k in (0, 1))
    assert (values.var(axis=0, ddof=1) / stated.mean(axis=0)).mean() == pytest.approx(1.0, abs=0.08)
