from __future__ import annotations

import numpy as np
import pytest

from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors._tiles import AxisTiles, TilePlan
from lfcal.reconstruct.projectors.grid import Grid
from tests.speeds import measured_speeds, same_speeds


def test_transform_matrices_are_the_fourier_transform():
    for tiles in (AxisTiles(7, 2, 1), AxisTiles(7, 2, 3, half=True), AxisTiles(6, 1, 1, half=True)):
        data = np.random.default_rng(0).standard_normal(tiles.taken)
        padded = np.zeros(tiles.length)
        padded[: tiles.taken] = data
        spectrum = tiles.analysis() @ data
        assert np.allclose(spectrum, np.fft.fft(padded)[: tiles.frequencies])
        back = (tiles.synthesis() @ spectrum).real
        assert np.allclose(back, padded[tiles.lead : tiles.lead + tiles.valid])


def test_tiles_cover_the_lattice_once():
    for cells in range(1, 12):
        for count in range(1, cells + 1):
            tiles = AxisTiles(cells, 2, count)
            assert tiles.valid * count >= cells > tiles.valid * (count - 1) - count
            assert tiles.padded >= tiles.lead + cells


def test_grid_packs_and_unpacks():
    grid = Grid((7, 9), (3, 4), (5, 5), (-2, 5))
    image = np.random.default_rng(1).random((7, 9))
    packed = grid.pack(image, float, before=(2, 1), after=(0, 3))
    assert np.array_equal(grid.unpack(packed, before=(2, 1)), image)
    label = np.arange(12).reshape(3, 4)
    tiled = grid.tiled(label)
    assert all(tiled[y, x] == label[(y + 2) % 3, (x - 5) % 4] for y in range(7) for x in range(9))


@pytest.mark.parametrize("speeds", [same_speeds, measured_speeds])
def test_auto_takes_the_method_that_suits(speeds):
    with speeds():
        check_the_method_that_suits()


def check_the_method_that_suits():
    rng = np.random.default_rng(2)
    many_taps = Projector(rng.random((1, 5, 5, 61, 61), np.float32), (240, 240))
    assert many_taps.method == "polyphase"
    spots = np.zeros((1, 24, 24, 49, 49), np.float32)
    spots[..., 24, ::12] = 1
    assert Projector(spots, (240, 240)).method == "sparse"
    assert "set-up" in str(many_taps.forecast())


def test_spectra_are_as_large_as_forecast():
    H = np.random.default_rng(3).random((2, 4, 5, 17, 17), np.float32)
    P = Projector(H, (90, 91), method="polyphase").prepare()
    plan = P.forecast().plan
    assert isinstance(plan, TilePlan)
    assert P.forecast().chosen.operand_bytes == 2 * plan.spectrum_bytes(8, 20)
