"""The light far from a point, against waves that are rendered here by Fourier transforms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.fft as sf
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan
from lfcal.targets._tails import Tails, simulated_tails
from tests.targets.common import bench

PER_PX = 10
"""Samples of a rendered pixel along an axis: they hold light up to 30° from the axis."""


def round_iris(side: int) -> Camera:
    """Return the bench camera with a round iris."""
    camera = bench(side)
    return replace(camera, optics=replace(camera.optics, blades=0))


def rendered(camera: Camera, z_um: float, pixels: int, phase: tuple[float, float]) -> NDArray[np.float64]:
    """Return the light of a point on the axis, in so many pixels a side.

    Plane waves as the iris lets them through meet all lenslets, and go on to the sensor by their angular spectrum.
    The array is hexagonal, with three types that take turns along a row; ``phase`` (rows, columns) shifts it (periods).
    """
    optics, lattice, wave = camera.optics, camera.lattice, camera.wavelength_um
    step, size = camera.sensor.pixel_um / PER_PX, PER_PX * pixels
    to_array, to_image = (1 / (1 / optics.focal_length_um - 1 / (optics.working_distance_um + z)) for z in (0.0, z_um))
    away = np.abs(np.fft.fftfreq(size, step)[:, None] + 1j * np.fft.fftfreq(size, step)) * wave
    along = 2 * np.pi / wave * (np.sqrt(np.maximum(1 - away**2, 0)) - 1)
    axis = (np.arange(size) - (size - 1) / 2) * step

    # the edge of the iris within one step of the angle
    iris = np.clip((optics.focal_length_um / (2 * optics.f_number) / to_image - away) * size * step / wave + 0.5, 0, 1)
    middle = np.exp(2j * np.pi * np.fft.fftfreq(size, step) * axis[0])
    field = sf.ifft2(iris * np.exp(-1j * (to_image - to_array) * along) * middle[:, None] * middle)

    pitch = lattice.pitch_um * to_array / (to_array + lattice.gap_um)
    cell = (math.sqrt(3) * pitch, pitch)
    y, x = axis[:, None] - phase[0] * cell[0], axis[None, :] - phase[1] * 3 * pitch
    # a hexagonal array is two rectangular ones
    nearest, kind = np.full((size, size), np.inf), np.zeros((size, size), int)
    for half in (0, 1):
        row, column = np.round(y / cell[0] - half / 2), np.round(x / cell[1] - half / 2)
        distance = np.hypot(y - (row + half / 2) * cell[0], x - (column + half / 2) * cell[1])
        kind = np.where(distance < nearest, (column - half) % 3, kind).astype(int)
        nearest = np.minimum(distance, nearest)
    focal = np.array([one.focal_length_um for one in lattice.types])[kind]
    lens = np.clip((lattice.clear_um / 2 - nearest) / step + 0.5, 0, 1) * np.exp(
        -1j * np.pi / wave / focal * nearest**2
    )
    light = np.abs(sf.ifft2(sf.fft2(field * lens) * np.exp(1j * lattice.gap_um * along))) ** 2
    return light.reshape(pixels, PER_PX, pixels, PER_PX).sum((1, 3))


def crosstalk(light: NDArray[np.float64], cutout: int, pitch: int) -> float:
    """Return the light of eight neighbours in a cutout over its own."""
    middle, half = light.shape[0] // 2, cutout // 2

    def held(row: int, column: int) -> float:
        top, left = middle + row * pitch - half, middle + column * pitch - half
        return float(light[max(top, 0) : top + cutout, max(left, 0) : left + cutout].sum())

    around = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
    return sum(held(*one) for one in around) / held(0, 0)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("virtual_depth", "window", "aside"), [(2.0, 101, (-2, 3, 12)), (4.0, 151, (-1, 6))], ids=["near", "far"]
)
def test_crosstalk_is_that_of_waves_through_the_whole_array(
    virtual_depth: float, window: int, aside: tuple[int, ...]
) -> None:
    camera = round_iris(240)
    scan = ScanPlan.for_camera(camera, virtual_depths=(virtual_depth,))
    (cutout, _), found = scan.cutout, simulated_tails(scan, 0)
    # phases 0, 1/3 and 2/3, of which the last mirrors the second
    phases = ((0.0, 1), (1 / 3, 2))
    light = sum(a * b * rendered(camera, scan.depths_um[0], window, (y, x)) for y, a in phases for x, b in phases)
    assert isinstance(light, np.ndarray)
    # the rest is light beyond 27°, and how the edges of lenslets lie on samples
    for pitch in (cutout + px for px in aside):
        share = crosstalk(light, cutout, pitch)
        assert share > 1e-3 and found.grid((pitch, pitch)) == pytest.approx(share, rel=0.25), pitch


def test_where_one_grid_is_too_small_for_four_cutouts_the_window_is_smaller(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = ScanPlan.for_camera(round_iris(240), virtual_depths=(2.0,))
    whole = simulated_tails(scan, 0)
    simulated_tails.cache_clear()
    monkeypatch.setattr("lfcal.simulate.accuracy.sampling.MAX_SAMPLES", 320)
    less = simulated_tails(scan, 0)
    simulated_tails.cache_clear()
    assert less.light.shape < whole.light.shape == (101, 101)
    near = (scan.cutout[0], scan.cutout[0])
    assert less.grid(near) == pytest.approx(whole.grid(near), rel=0.4)


def test_tails_are_simulated_once() -> None:
    scan = ScanPlan.for_camera(round_iris(240), virtual_depths=(2.0,))
    found = simulated_tails(scan, 0)
    assert simulated_tails(scan, 0) is found and not found.light.flags.writeable


@pytest.mark.parametrize(("away", "least"), [(6, 9), (4, 7), (7, None)])
def test_the_least_pitch_is_sought_up_to_two_cutouts(away: int, least: int | None) -> None:
    """Light at one distance: cutouts of 5 px at multiples of the pitch hold it up to two pixels from their middle."""
    light = np.zeros((21, 21))
    light[10, 10], light[10 + away, 10] = 1.0, 0.01
    tails = Tails(light, (5, 5), "waves")
    if least is None:
        with pytest.raises(InputError, match="two cutouts' distance"):
            tails.least_pitch(0.005)
    else:
        assert tails.least_pitch(0.005) == least
