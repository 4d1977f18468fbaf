"""Pixels that are not square."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.simulate.engines._oblong import OblongPlane
from lfcal.simulate.engines.base import PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from tests.simulate.scenes import camera_scene, microscope_scene, relative_error


def summed(scene, level, sampling, row, column):
    """Return the response on pixels 5 wide and 7 high, by sums of whole square ones."""
    (nt, ns), fifth = scene.cutout, scene.pixel_um / 5
    fine = replace(scene, pixel_um=fifth, pixel_aspect=1.0, cutout=(7 * nt, 5 * ns))
    image = engine_for(fine, level, sampling).rows([7 * row], [5 * column])[0, 0]
    return image.reshape(nt, 7, ns, 5).sum(axis=(1, 3))


@pytest.mark.parametrize(
    ("level", "scene", "bound"),
    [
        ("debye", microscope_scene(5.0, cutout=(27, 35), pixel_aspect=1.4), 1e-3),
        ("wave", camera_scene(3.0, cutout=(27, 35), pixel_aspect=1.4), 0.02),
        ("geometric", camera_scene(3.0, cutout=(27, 35), pixel_aspect=1.4), 0.15),
    ],
)
def test_they_hold_the_light_of_the_square_ones_within(level, scene, bound):
    engine = engine_for(scene, level, Sampling(nodes_per_px=4, margin_px=8))
    assert isinstance(engine, OblongPlane)
    assert isinstance(engine, PlaneEngine)
    wanted = summed(scene, level, Sampling(nodes_per_px=1, margin_px=40), 2, 3)
    found = engine.rows([2], [3])[0, 0]
    assert relative_error(found, wanted) < bound
    assert found.sum() == pytest.approx(wanted.sum(), rel=2e-3)
    assert np.allclose(engine.point(2 * 1.4 * scene.pixel_um, 3 * scene.pixel_um), found, atol=1e-6)
    # the counter-test: a source half a pixel off, and pixels taken for square ones
    assert relative_error(engine.point(2.4 * 1.4 * scene.pixel_um, 3 * scene.pixel_um), wanted) > 1.5 * bound
    square = engine_for(replace(scene, pixel_aspect=1.0), level).rows([2], [3])[0, 0]
    assert relative_error(square, wanted) > 1.5 * bound
