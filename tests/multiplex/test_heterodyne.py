"""Masks of non-integer and turned pitch: both theorems on a real lattice."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.multiplex import (
    Modulator,
    SuperPixelLattice,
    demultiplex,
    demultiplex_generally,
    demultiplex_lattice,
    lattice_transmissions,
    mask,
)
from lfcal.multiplex.heterodyne import lattice_by_sinc, lattice_by_spectrum

RNG = np.random.default_rng


def closing(
    shape: tuple[int, int], down: tuple[int, int], right: tuple[int, int], origin=(3.3, 4.1)
) -> SuperPixelLattice:
    """Return a turned lattice of no whole pitch that closes over a periodic frame: its waves are bins of the frame."""
    waves = np.array([down, right]) / np.array(shape)
    across, along = np.linalg.inv(waves).T
    return SuperPixelLattice("square", (3.3, 4.1), tuple(along[::-1].tolist()), tuple(across[::-1].tolist()))


SHAPE = (96, 100)
TURNED = closing(SHAPE, (18, 1), (-1, 19))


def smooth(count: int, seed: int = 0) -> np.ndarray:
    """Return samples of two waves each, well below half a cycle per super-pixel, periodic over the frame."""
    y, x = (np.arange(n) / n for n in SHAPE)
    rng = RNG(seed)
    light = np.ones((count, *SHAPE))
    for _ in range(3):
        ky, kx = rng.integers(-6, 7, 2)
        light += 0.2 * np.cos(2 * np.pi * (ky * y[:, None] + kx * x) + rng.uniform(0, 6, (count, 1, 1)))
    return light


@pytest.mark.parametrize("kind", ["sum_of_sinusoids", "MURA"])
@pytest.mark.parametrize("size", [3, 5])
def test_both_routes_are_one_and_give_the_light_back(kind: str, size: int) -> None:
    m, light = mask(kind, size), smooth(size * size)
    assert TURNED.pitch_px % 1 > 0.05 and abs(TURNED.rotation_rad) > 0.03
    frame = (lattice_transmissions(SHAPE, TURNED, m, profile="sinusoids") * light).sum(0)
    places = RNG(1).uniform(0, 90, (40, 2))
    one = lattice_by_spectrum(frame, TURNED, m, places)
    two = lattice_by_sinc(frame, TURNED, m, places)
    assert np.abs(one - two).max() < 1e-12 * np.abs(one).max() * m.condition
    spectra = np.fft.fft2(light) / light[0].size
    fy, fx = (np.fft.fftfreq(n) for n in SHAPE)
    waves = np.exp(2j * np.pi * (places[:, :1, None] * fy[:, None] + places[:, 1:, None] * fx))
    truth = np.einsum("nyx,pyx->np", spectra, waves).real
    np.testing.assert_allclose(one, truth, atol=1e-10)


def test_routes_part_where_the_frame_is_not_band_limited() -> None:
    m = mask("sum_of_sinusoids", 3)
    frame = RNG(2).random(SHAPE)
    one = demultiplex_lattice(frame, TURNED, m, route="fourier")
    assert np.abs(one - demultiplex_lattice(frame, TURNED, m, filter="sinc")).max() > 0.1


def test_even_periods_and_whole_pixels_are_the_plain_routes() -> None:
    whole = SuperPixelLattice("square", (1.5, 1.5), (4.0, 0.0), (0.0, 4.0))
    random = Modulator("random", (4, 4), RNG(3).random((16, 16)), np.eye(16), (4, 4), cell=(4, 4))
    frame = RNG(4).random((32, 40))
    plain = demultiplex(frame, random, route="fourier")
    for options in ({"route": "fourier"}, {"filter": "sinc"}):
        found = demultiplex_lattice(frame, whole, random, **options)
        np.testing.assert_allclose(found, plain, atol=1e-9 * np.abs(plain).max())


def test_a_mask_that_is_turned_and_no_whole_number_of_pixels_wide() -> None:
    """5.3 px, turned by 0.2 degrees, MURA 5 x 5: views of 0.6 … 1.4 were 0.51 … 1.48 by cubic interpolation."""
    angle, pitch = np.radians(0.2), 5.3
    along = (pitch * np.cos(angle), pitch * np.sin(angle))
    given = SuperPixelLattice("square", (60.0, 64.0), along, (-along[1], along[0]))
    m, light = mask("MURA", 5), np.linspace(0.6, 1.4, 25)
    frame = np.tensordot(light, lattice_transmissions((160, 170), given, m, profile="sinusoids"), 1)
    cubic = demultiplex_lattice(frame, given, m, filter="cubic")
    fourier = demultiplex_lattice(frame, given, m, route="fourier")
    inner = np.s_[:, 4:-4, 4:-4]
    assert (
        np.abs(fourier[inner] - light[:, None, None]).max() < 0.05 < np.abs(cubic[inner] - light[:, None, None]).max()
    )


def test_cells_keep_within_the_mask_and_its_light() -> None:
    m = mask("MURA", 5)
    shares = lattice_transmissions((300, 320), TURNED, m)
    assert shares.min() >= 0 and shares.max() <= 1
    np.testing.assert_allclose(shares.mean((1, 2)), m.matrix.mean(0), atol=2e-3)
    # on whole pixels a cell is a pixel
    whole = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0))
    plain = lattice_transmissions((10, 15), whole, m)
    np.testing.assert_allclose(plain, np.tile(m.matrix.T.reshape(25, 5, 5), (1, 2, 3)), atol=1e-12)
    sines = lattice_transmissions((60, 60), TURNED, mask("sum_of_sinusoids", 5), profile="sinusoids")
    assert sines.min() >= -1e-9 and sines.max() <= 1 + 1e-9, "the profile between the pixels is one of a mask"


def test_sharp_cells_of_a_turned_mask_by_the_general_route() -> None:
    """What neither theorem covers: cells with borders across pixels, at a pitch that is no number of pixels."""
    m = mask("MURA", 3)
    shares = lattice_transmissions(SHAPE, TURNED, m)
    light = np.linspace(0.5, 1.5, 9)[:, None, None] * np.ones(SHAPE)
    found = demultiplex_generally((shares * light).sum(0), shares, TURNED.pitch_px, smoothness=1e-5, tolerance=1e-8)
    np.testing.assert_allclose(found.samples, np.broadcast_to(light[:, :1, :1], found.samples.shape), atol=0.02)


def test_bad_lattices_and_profiles() -> None:
    m = mask("MURA", 3)
    with pytest.raises(InputError, match="profile"):
        lattice_transmissions((9, 9), TURNED, m, profile="steps")
    with pytest.raises(InputError, match="super-pixels for the filter sinc"):
        demultiplex_lattice(np.ones((400, 400)), TURNED, m, filter="sinc")
    with pytest.raises(InputError, match="route"):
        demultiplex_lattice(np.ones((90, 90)), TURNED, m, route="radon")
