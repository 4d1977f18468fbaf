"""The lattice's centre under an iris that has no centre of symmetry, drawn here corner by corner."""

import math

import numpy as np
import pytest
from scipy import ndimage

from lfcal.lattice._iris_centre import _transforms
from lfcal.lattice.fit import fit_lattice

ROTATION, CENTRE, SHAPE = 0.03, np.array([47.3, 53.6]), (96, 108)


def inside(x, y, blades, radius, turn):
    """Return where a polygon of the area of a disc lies, a disc where it has no blades."""
    if not blades:
        return np.hypot(x, y) < radius
    apothem = radius * math.sqrt(math.pi / (blades * math.tan(math.pi / blades)))
    corner = np.mod(np.arctan2(y, x) - turn, 2 * math.pi / blades) - math.pi / blades
    return np.hypot(x, y) * np.cos(corner) < apothem


def basis(kind, pitch):
    step = math.pi / 3 if kind == "hexagonal" else math.pi / 2
    angles = np.array([ROTATION, ROTATION + step])
    return pitch * np.stack([np.cos(angles), np.sin(angles)], -1)


def white(kind, pitch, blades, fill, *, turn=0.2, over=4, noise=0.0):
    """Return an antialiased frame of micro-images, which add where they overlap."""
    rows, columns = ((np.arange(n * over) + 0.5) / over - 0.5 for n in SHAPE)
    x, y = columns[None] - CENTRE[1], rows[:, None] - CENTRE[0]
    vectors = basis(kind, pitch)
    cell = np.stack(np.broadcast_arrays(x, y), -1) @ np.linalg.inv(vectors)
    part = cell - np.floor(cell)
    light = np.zeros(cell.shape[:2])
    for q in (-1, 0, 1, 2):
        for r in (-1, 0, 1, 2):
            away = (part - (q, r)) @ vectors
            light += inside(away[..., 0], away[..., 1], blades, fill * pitch / 2, turn)
    fine = ndimage.gaussian_filter(light, 0.6 * over)
    frame = 3000 * fine.reshape(SHAPE[0], over, SHAPE[1], over).mean((1, 3)) + 64
    return frame + noise * np.random.default_rng(0).standard_normal(SHAPE)


def off_centre(fit, kind, pitch):
    """Return (row, column) from the true lattice to the fitted one."""
    away = np.array(fit.origin_px) - CENTRE
    vectors = basis(kind, pitch)[:, ::-1]
    return away - np.rint(away @ np.linalg.inv(vectors)) @ vectors


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("kind", "blades", "fill"),
    [("hexagonal", 7, 0.98), ("hexagonal", 5, 0.9), ("hexagonal", 5, 1.03), ("square", 5, 1.03), ("square", 9, 1.03)],
)
def test_the_centre_is_that_of_the_iris_and_not_that_of_symmetry(kind, blades, fill):
    fit = fit_lattice(white(kind, 11.0, blades, fill), dark=64.0)
    assert np.abs(off_centre(fit, kind, 11.0)).max() < 0.004  # a tenth of a pixel and more without
    assert max(fit.errors.origin_px) < 0.01
    apart = np.array(fit.measured_px) - np.array([fit.centres_px(*index) for index in fit.index]).reshape(-1, 2)
    assert np.abs(np.nanmedian(apart, axis=0)).max() < 0.02  # the places came along


@pytest.mark.parametrize("blades", [0, 6])
def test_an_iris_with_a_centre_of_symmetry_keeps_it(blades):
    fit = fit_lattice(white("hexagonal", 11.0, blades, 0.98), dark=64.0)
    assert np.abs(off_centre(fit, "hexagonal", 11.0)).max() < 0.004


def test_noise_is_in_the_stated_error():
    fit = fit_lattice(white("hexagonal", 11.0, 7, 0.95, noise=150.0), dark=64.0)
    off = np.abs(off_centre(fit, "hexagonal", 11.0))
    assert (off < 4 * np.array(fit.errors.origin_px)).all() and max(fit.errors.origin_px) < 0.08


@pytest.mark.parametrize("blades", [5, 6, 7])
def test_the_transform_of_a_polygon_is_that_of_its_pixels(blades):
    at = (np.arange(1200) + 0.5) / 60 - 10
    x, y = at[None], at[:, None]
    drawn = inside(x, y, blades, 4.0, 0.3)
    for wave in ((0.1, 0.02), (-0.05, 0.12), (0.2, -0.17)):
        summed = (drawn * np.exp(-2j * np.pi * (wave[0] * x + wave[1] * y))).sum() / drawn.sum()
        ((transform,),) = _transforms(np.array([wave]), blades, np.array([4.0]), np.array([0.3]))
        assert abs(transform - summed) < 2e-3
