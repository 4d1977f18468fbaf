import math

import numpy as np
import pytest

from lfcal.psf.aperture._ripple import find_ripple


def disc(waves, noise, seed=0, side=161):
    """Return an even disc with (pitch, direction, amplitude, phase) waves, and the waves alone."""
    y, x = np.indices((side, side)) - 80.0
    total = np.zeros((side, side))
    for pitch, turn, size, phase in waves:
        q = 2 * math.pi / pitch
        total += size * np.cos(q * (x * math.cos(turn) + y * math.sin(turn)) + phase)
    lit = np.hypot(x, y) < 70
    return lit * (1 + total) + np.random.default_rng(seed).normal(0, noise, lit.shape), total


@pytest.mark.parametrize(
    "waves", [[(26, 0.3, 0.03, 1.0)], [(40, t, 0.02, p) for t, p in ((0.1, 0), (1.15, 2), (2.2, 4))]]
)
def test_waves_are_found_inside_and_hold_at_the_edge(waves):
    flat, truth = disc(waves, 0.02)
    found = find_ripple(flat, 80.0, 80.0, 60.0)
    assert len(found.waves) == len(waves)
    y, x = np.indices(flat.shape) - 80.0
    ring = (np.hypot(x, y) > 60) & (np.hypot(x, y) < 70)
    error = found.at(x, y) - truth
    assert np.std(error[ring]) < 0.12 * np.std(truth[ring])
    clean = found.removed(flat, 80.0, 80.0, 75.0)
    inside = np.hypot(x, y) < 68
    assert np.std(clean[inside]) < 1.05 * 0.02


def test_noise_and_shading_are_no_ripple():
    flat, _ = disc([], 0.05)
    y, x = np.indices(flat.shape) - 80.0
    assert find_ripple(flat, 80.0, 80.0, 60.0).amplitude == 0
    shaded = flat * (1 - 0.3 * (x**2 + y**2) / 4900 + 0.1 * x / 70)
    found = find_ripple(shaded, 80.0, 80.0, 60.0)
    assert found.amplitude == 0 and math.isnan(found.pitch_px)
