"""The paper's figures as data, and its statements as tests."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.multiplex import cfa, mask, snr_gain
from lfcal.multiplex.noise import PAPER_CAMERAS
from lfcal.multiplex.paper import LIGHT_FIELD, paper_figure


def number(words: str, before: str) -> float:
    """Return the number after some words of a line."""
    return float(words.split(before)[1].split()[0])


def test_figure_3_spatial_does_not_ring_and_fourier_does() -> None:
    panels = {p.title: p for p in paper_figure(3).panels}
    fourier, spatial = (number(panels[name].numbers, "uniform parts") for name in ("Fourier", "spatial, cubic"))
    assert fourier > 1 > spatial
    assert number(panels["spatial, cubic"].numbers, "rms") < number(panels["Fourier"].numbers, "rms")
    assert panels["Fourier"].image.shape == panels["spatial, cubic"].image.shape == (40, 50, 3)
    # shown as bright as the scene is: neither black nor burnt out
    for title in ("ground truth, magnified", "spatial, cubic"):
        image = np.asarray(panels[title].image, float)
        assert 0.1 * image.max() < image.mean() < 0.9 * image.max() and len(np.unique(image)) > 2, title


def test_figure_5_has_one_scale_and_cubic_channels_avoid_ringing() -> None:
    found = paper_figure(5)
    assert len({p.levels for p in found.panels}) == 1 and len(found.panels) == 6 and found.columns == 3
    for row in (found.panels[:3], found.panels[3:]):
        rings = [number(p.numbers, "uniform parts") for p in row]
        assert rings[2] < 0.2 * rings[1] < 0.2 * rings[0]


def test_figure_6_marks_the_user_s_camera() -> None:
    found = paper_figure(6, camera="mine", chi2=30.0)
    for _, curves in found.curves:
        assert curves.cameras["mine"] == 30.0 and set(PAPER_CAMERAS) <= set(curves.cameras)
    # "all alternative filters are slightly better where additive noise dominates", CYMG most, by about 0.6 dB
    gains = {
        name: snr_gain(cfa(name), cfa("Bayer"), [0.0, math.inf]) for name in ("CYMG", "CYYM", "RGBE", "RGBW", "CMYW")
    }
    assert all(g[0] > 0 > g[1] for g in gains.values()) and max(gains, key=lambda n: gains[n][0]) == "CYMG"
    # "lenslets always perform best", MURA well for additive noise, sums of sinusoids "always worse than a pinhole"
    chi2 = np.logspace(-4, 4, 33)
    lens, mura, hole, sines = (snr_gain(mask(kind, 11), mask("pinhole", 11), chi2) for kind in LIGHT_FIELD)
    assert (lens > np.maximum(np.maximum(mura, hole), sines)).all() and (sines < 0).all()
    assert mura[0] > 7 and mura[-1] < 0


def test_figure_7_orders_the_modulators_as_the_paper() -> None:
    found = paper_figure(7)
    views = found.panels[4:]
    order = [number(p.numbers, "SNR") for p in views]
    assert order == sorted(order, reverse=True) and len({p.levels for p in views}) == 1
    assert [number(p.numbers, "forecast") for p in views] == pytest.approx([20.6, 7.2, 0.0, -0.9], abs=0.06)
    with pytest.raises(InputError):
        paper_figure(4)


@pytest.mark.long
def test_figure_7_of_the_user_s_camera_in_bright_light() -> None:
    bright = paper_figure(7, camera="mine", chi2=1e3)
    assert "mine" in bright.title and number(bright.panels[5].numbers, "forecast") < 0
