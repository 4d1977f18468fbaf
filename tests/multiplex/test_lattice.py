"""Super-pixels of any pitch and angle, against the views of the frames package and whole-pixel demultiplexing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.lattice import LatticeFit, extract_views, lattice_of, view_grid
from lfcal.multiplex import SuperPixelLattice, cfa, demultiplex, demultiplex_lattice, lattice_channels, mask, multiplex
from lfcal.multiplex.lattice import channel_grid


def lattice(kind: str, pitch: float = 11.37, angle: float = 0.013) -> SuperPixelLattice:
    along = pitch * np.array([math.cos(angle), math.sin(angle)])
    across = (0.87 if kind == "hexagonal" else 1.0) * pitch * np.array([-math.sin(angle), math.cos(angle)])
    lean = 0.5 if kind == "hexagonal" else 0.0
    return SuperPixelLattice(kind, (70.3, 81.7), tuple(along.tolist()), tuple((lean * along + across).tolist()))


def as_fit(given: SuperPixelLattice, shape: tuple[int, int]) -> LatticeFit:
    q, r = (v.ravel() for v in np.meshgrid(range(-15, 16), range(-15, 16)))
    index = np.stack([q, r], 1)
    centres = index @ np.array([given.along_px, given.across_px]) + np.array(given.origin_px)[::-1]
    half = given.pitch_px / 2
    index = index[((centres >= half) & (centres <= np.array(shape[::-1]) - 1 - half)).all(1)]
    n = len(index)
    row, pitch = given.row_pitch_px, given.pitch_px
    angle = math.atan2(given.along_px[1], given.along_px[0])
    return LatticeFit(
        given.kind,
        shape,
        pitch,
        row,
        angle,
        given.origin_px,
        0.0,
        0.0,
        0.0,
        index,
        np.zeros((n, 2)),
        np.ones(n),
        np.zeros(n, bool),
    )


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_linear_channels_are_the_extracted_views(kind: str) -> None:
    given = lattice(kind)
    frame = np.random.default_rng(0).random((150, 170), np.float32)
    fit = as_fit(given, frame.shape)
    views = extract_views(frame, fit, radius_px=5.0, axes="lattice")
    channels = lattice_channels(frame, given, 11)
    assert channels.shape == views.images.shape
    np.testing.assert_allclose(channels, views.images, atol=2e-5)


def test_the_longer_side_of_a_super_pixel_lies_in_the_frame() -> None:
    given, shape = lattice("square"), (150, 170)
    small, large = (channel_grid(shape, given, side).shape for side in (3, 11))
    assert small != large
    for side in ((3, 11), (11, 3)):
        assert channel_grid(shape, given, side).shape == large
        assert lattice_channels(np.ones(shape), given, side).shape == (*side, *large)


@pytest.mark.parametrize(("name", "power"), [("linear", 1), ("cubic", 2)])
@pytest.mark.parametrize("spacing", [1.0, 0.97])
def test_filters_keep_polynomials(name: str, power: int, spacing: float) -> None:
    given = lattice("square")
    y, x = np.mgrid[:150, :170] / 100.0
    channels = lattice_channels(y**power + x**power, given, 9, spacing_px=spacing, filter=name)
    grid = view_grid(given, (150, 170), 4 * spacing, axes="lattice")
    rows, columns = (np.arange(n) for n in grid.shape)
    place = columns[None, :, None] * given.along_px + rows[:, None, None] * np.array(given.across_px)
    offsets = (np.arange(9) - 4) * spacing
    cy = (place[..., 1] + grid.corner_px[0] + offsets[:, None, None, None]) / 100
    cx = (place[..., 0] + grid.corner_px[1] + offsets[None, :, None, None]) / 100
    # away from the border, where samples are repeated
    inner = (..., slice(1, -1), slice(1, -1))
    np.testing.assert_allclose(channels[inner], (cy**power + cx**power)[inner], atol=1e-10)


def test_whole_pixels_are_plain_demultiplexing() -> None:
    frame = np.random.default_rng(1).random((55, 66))
    given = SuperPixelLattice("square", (5.0, 5.0), (11.0, 0.0), (0.0, 11.0))
    for kind in ("lenslet", "pinhole"):
        m = mask(kind, 11)
        plain = frame.reshape(5, 11, 6, 11).transpose(1, 3, 0, 2).reshape(121, 5, 6) / m.matrix[0, 0]
        for name in ("nearest", "linear", "cubic"):
            np.testing.assert_allclose(demultiplex_lattice(frame, given, m, filter=name), plain, atol=1e-12)
    np.testing.assert_allclose(demultiplex(frame, mask("lenslet", 11)) * 121, plain, atol=1e-12)


def test_mask_of_non_integer_period() -> None:
    """A MURA mask whose shadow repeats every 8.6 pixels, light smooth over it."""
    pitch, p = 8.6, 5
    coarse = mask("MURA", p)
    light = np.linspace(0.5, 1.5, 25)
    cell = multiplex(light[:, None, None] * np.ones((p, p)), coarse)
    harmonics = np.fft.fftfreq(p, 1 / p)
    shape, centre = (120, 130), (60.0, 64.0)
    weights = np.fft.fft2(cell) / p**2
    waves = [
        np.exp(2j * np.pi * np.outer((np.arange(n) - c) / pitch + (p - 1) / 2 / p, harmonics))
        for n, c in zip(shape, centre, strict=True)
    ]
    frame = (waves[0] @ weights @ waves[1].T).real
    given = SuperPixelLattice("square", centre, (pitch, 0.0), (0.0, pitch))
    views = demultiplex_lattice(frame, given, coarse, filter="cubic")
    assert np.abs(views.mean((1, 2)) - light).max() < 0.25
    linear = demultiplex_lattice(frame, given, coarse, filter="linear")
    assert np.abs(views - light[:, None, None]).mean() < np.abs(linear - light[:, None, None]).mean()
    whole = SuperPixelLattice("square", centre, (9.0, 0.0), (0.0, 9.0))
    wrong = demultiplex_lattice(frame, whole, coarse, filter="cubic")
    assert np.abs(wrong - light[:, None, None]).mean() > 3 * np.abs(views - light[:, None, None]).mean()


def test_camera_lattice_and_threads() -> None:
    given = lattice_of(preset("r29"))
    assert given.kind == "hexagonal" and given.pitch_px == pytest.approx(31.7)
    assert given.centres_px(0, 0) == pytest.approx(((4384 - 1) / 2, (6576 - 1) / 2))
    near = SuperPixelLattice("hexagonal", (40.0, 50.0), *given.basis_px().tolist())
    frame = np.random.default_rng(2).integers(0, 4096, (220, 260)).astype(np.uint16)
    one = lattice_channels(frame, near, 31, filter="cubic", workers=1)
    np.testing.assert_array_equal(one, lattice_channels(frame, near, 31, filter="cubic", workers=3))
    out = np.empty_like(one)
    assert lattice_channels(frame, near, 31, filter="cubic", out=out) is out


@pytest.mark.parametrize(
    "call",
    [
        lambda: lattice_channels(np.ones((8, 8)), lattice("square"), 31),
        lambda: lattice_channels(np.ones((99, 99)), lattice("square"), 0),
        lambda: lattice_channels(np.ones((99, 99)), lattice("square"), 5, filter="sinc"),
        lambda: lattice_channels(np.ones((99, 99)), lattice("square"), 5, spacing_px=0.0),
        lambda: lattice_channels(np.ones((199, 199)), lattice("square"), 5, out=np.ones((5, 5))),
        lambda: demultiplex_lattice(np.ones((199, 199)), lattice("square"), cfa("Bayer")),
        lambda: SuperPixelLattice("square", (0, 0), (1, 0), (1, 0)),
        lambda: SuperPixelLattice("triangular", (0, 0), (9, 0), (0, 9)),
    ],
)
def test_bad_lattices(call) -> None:
    with pytest.raises(InputError):
        call()
