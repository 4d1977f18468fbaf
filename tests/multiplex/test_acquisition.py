"""One scene recorded through each modulator: measured noise against the forecast, and the scenes themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.multiplex import MASKS, acquire_light_field, cfa, mask, snr_gain
from lfcal.multiplex.scenes import filament_light_field

DRAGONFLY = 10**-0.93


@pytest.mark.parametrize("chi2", [DRAGONFLY, math.inf])
def test_measured_gain_is_the_forecast(chi2: float) -> None:
    """Even light: the noise of demultiplexed views over a pinhole's, as in figure 7."""
    light = np.full((25, 100, 100), 1 / 25)
    kinds = [mask(kind, 5) for kind in MASKS]
    found = acquire_light_field(light, kinds, chi2=chi2, signal_e=1e6, rng=np.random.default_rng(0), filter="nearest")
    for one in found:
        gain = 10 * math.log10(found[0].noise / one.noise)
        assert gain == pytest.approx(snr_gain(one.modulator, kinds[0], chi2), abs=0.1)
        assert one.snr_db == pytest.approx(10 * math.log10(1 / 25 / one.noise))


def test_figure_7_order_of_modulators() -> None:
    scene = filament_light_field(5, (24, 28), np.random.default_rng(3))
    kinds = ("lenslet", "MURA", "pinhole", "sum_of_sinusoids")
    found = acquire_light_field(
        scene, [mask(k, 5) for k in kinds], chi2=DRAGONFLY, signal_e=2e4, rng=np.random.default_rng(4)
    )
    noise = [one.noise for one in found]
    assert noise == sorted(noise)
    assert found[0].views.shape == (25, 24, 28) and found[0].frame.shape == (120, 140)
    # without noise each gives the scene back
    span = np.ptp(found[0].truth)
    assert all(np.sqrt(np.mean((one.clean - one.truth) ** 2)) < 0.05 * span for one in found)


def test_scene_is_a_light_field() -> None:
    scene = filament_light_field(5, (12, 14), np.random.default_rng(3))
    assert scene.shape == (25, 60, 70) and scene.min() > 0 and scene.sum(0).max() <= 1 + 1e-6
    assert np.abs(scene[0] - scene[24]).max() > 0.1 * scene.max(), "views must differ"


def test_bad_acquisitions() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError):
        acquire_light_field(np.ones((25, 10, 10)), [mask("MURA", 5)], chi2=0.0, rng=rng)
    with pytest.raises(InputError):
        acquire_light_field(np.ones((25, 10, 10)), [cfa("Bayer")], chi2=1.0, rng=rng)
