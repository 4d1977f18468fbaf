"""Nodes and compiled loops of the microscope's separable path, against numpy in double precision."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from lfcal.simulate.engines._nodes import WindowNodes, fitted_rule
from lfcal.simulate.engines._separable import in_blocks, pixel_sums
from lfcal.simulate.engines._tile_llvm import ACROSS, DOWN, row_light


def parts(value: np.ndarray) -> np.ndarray:
    return np.stack([value.real, value.imag, value.real + value.imag]).astype(np.float32)


@pytest.mark.parametrize(("pixels", "middle"), [(11, 5), (11, 4), (11, 11), (12, 20), (9, 0)])
def test_pixels_take_the_light_at_their_own_nodes(pixels: int, middle: int) -> None:
    """A wave within the band has a known integral over each pixel, also from half the nodes outside the middle."""
    fine, coarse = fitted_rule(4, 1.5, 0.9), fitted_rule(2, 1.5, 0.9)
    nodes = WindowNodes.of(fine, coarse, pixels, middle)
    half = min(pixels, middle + (pixels - middle) % 2) / 2
    centres = np.arange(pixels) - (pixels - 1) / 2
    places, weights = nodes.pixels()
    for f, phase in ((0.0, 0.0), (0.3, 0.4), (0.6, 1.1)):
        wanted = 0.9 * np.sinc(0.9 * f) * np.cos(2 * np.pi * f * centres + phase)
        seen = np.cos(2 * np.pi * f * nodes.positions + phase)
        by_node = np.zeros(pixels)
        for at, weight, light in zip(places, weights, seen, strict=True):
            np.add.at(by_node, at[at >= 0], weight[at >= 0] * light)
        assert np.abs(by_node - wanted).max() < 5e-3
        by_runs = np.empty((1, pixels), np.float32)
        pixel_sums(seen[None].astype(np.float32), nodes.runs, nodes.weights, by_runs)
        assert np.abs(by_runs[0] - by_node).max() < 1e-6
    inside = np.count_nonzero(np.abs(nodes.positions) < half)
    assert inside >= 4 * 2 * half
    assert nodes.positions.size <= 4 * 2 * half + 2 * (pixels - 2 * half) + 6


@pytest.mark.parametrize("shape", [(DOWN, 16, 1), (24, 53, 37), (40, 7, 3), (8, 33, 130)])
def test_light_of_two_factors_on_pixels(shape: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(4)
    high, wide, n = shape
    left, right = (rng.normal(size=(k, n)) + 1j * rng.normal(size=(k, n)) for k in (high, wide))
    used = high - 3  # the last nodes only complete a tile
    pixels = np.stack([np.arange(used) // 2, np.where(np.arange(used) % 3, -1, 1)], axis=1)
    weights = rng.random(pixels.shape).astype(np.float32)
    lines = np.ones((high, wide), np.float32)
    row_light(parts(left), in_blocks(parts(right), ACROSS), pixels, weights, lines)
    wanted = np.ones((high, wide))
    for i, light in enumerate(np.abs(left[:used] @ right.T) ** 2):
        for pixel, weight in zip(pixels[i], weights[i], strict=True):
            if pixel >= 0:
                wanted[pixel] += weight * light
    assert np.abs(lines - wanted).max() < 2e-6 * wanted.max()


@pytest.mark.long
@pytest.mark.parametrize("features", ["+avx,+avx2,+fma", ""])
def test_light_of_two_factors_on_other_processors(features: str, tmp_path) -> None:
    """Sums are spread over fewer registers where a processor has only small ones."""
    settings = {
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": features,
        "NUMBA_CACHE_DIR": str(tmp_path),
    }
    test = f"{__file__}::test_light_of_two_factors_on_pixels"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", test]
    done = subprocess.run(command, env=os.environ | settings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
