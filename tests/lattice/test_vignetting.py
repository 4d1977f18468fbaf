from __future__ import annotations

import numpy as np
import pytest

from lfcal.frames.corrections.steps import White
from lfcal.lattice.fit import fit_lattice
from lfcal.lattice.vignetting import vignetting_map
from tests.lattice.white_frames import draw_white


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_fall_of_light_is_recovered(kind: str) -> None:
    truth = draw_white(kind=kind, falloff=0.4)
    fit = fit_lattice(truth.frame, dark=100.0)
    fall = vignetting_map(fit)
    rows, columns = truth.frame.shape
    y, x = np.mgrid[:rows, :columns]
    centre = ((rows - 1) / 2, (columns - 1) / 2)
    radius = ((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / (centre[0] ** 2 + centre[1] ** 2)
    frame = fall.frame()
    assert frame.max() == pytest.approx(1.0, abs=1e-6)
    inner = (slice(10, -10), slice(10, -10))
    assert np.abs(frame - (1 - 0.4 * radius))[inner].max() < 0.02
    assert fall.falloff == pytest.approx(0.6, abs=0.02)
    assert fall.scatter < 0.01
    assert np.array_equal(np.isnan(fall.lenslets), fit.dead)


@pytest.mark.long
def test_the_smooth_frame_serves_as_white_frame() -> None:
    truth = draw_white(falloff=0.4, dead=0.0)
    fall = vignetting_map(fit_lattice(truth.frame, dark=100.0))
    corrected = (truth.frame - 100.0) * White(fall.frame(), dark=0.0).gain
    even = fit_lattice(np.clip(corrected, 0, None))
    assert np.nanstd(even.light) / np.nanmean(even.light) < 0.01


def test_a_few_lenslets_lower_the_degree_of_the_surface() -> None:
    fit = fit_lattice(draw_white((110, 110), pitch=17.0, dead=0.0).frame)
    fall = vignetting_map(fit, degree=6)
    assert 0.5 < fall.falloff < 1.0 and fall.surface.powers.sum(1).max() == 3


def test_scatter_is_that_of_the_lenslets_light() -> None:
    fit = fit_lattice(draw_white(scatter=0.03, snr=200.0, dead=0.0).frame, dark=100.0)
    assert vignetting_map(fit).scatter == pytest.approx(0.03, rel=0.15)
