"""The noise of dark pixels is held against the sensor's, which stands in where no pixel is dark."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.judge import inspect
from lfcal.judge.quality import QualityReport
from lfcal.psf import Facts, PSFMatrix

from .faults import base
from .scenes import hexagonal

SIGMA = 0.002
"""Noise of the scene, over the brightest pixel."""


def noisy(stated: float | None, slope: float = 1e-4) -> QualityReport:
    scene = hexagonal()
    values = base(scene).astype(np.float64)
    values = values / values.max() + SIGMA * np.random.default_rng(4).standard_normal(values.shape)
    if stated is None:
        return inspect(PSFMatrix(values.astype(np.float32), depths=scene.depths))
    noise = np.broadcast_to(np.array([stated**2, slope]), (*values.shape[:3], 2))
    facts = Facts.of(values.shape[:3], (values.shape[3], values.shape[4]), noise=noise)
    return inspect(PSFMatrix(values.astype(np.float32), depths=scene.depths, facts=facts))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("stated", "ratio", "merit"), [(SIGMA, 1, "good"), (SIGMA / 4, 4, "bad"), (4 * SIGMA, 4, "bad")]
)
def test_noise_is_held_against_the_sensors(stated: float, ratio: float, merit: str) -> None:
    found = noisy(stated)["noise"]
    assert found.merit == merit and found.value == pytest.approx(ratio, rel=0.15)
    assert ("less noise" in str(found)) == (stated > SIGMA)


def test_without_figures_of_the_sensor_it_is_unknown() -> None:
    assert noisy(None)["noise"].merit == "unknown"
    assert noisy(SIGMA, slope=0.0)["noise"].merit == "unknown", "taken from repeats: no figure of the sensor"
