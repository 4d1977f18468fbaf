from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice._lit_part import blurred
from lfcal.lattice._spectrum import guess_lattice, upright
from lfcal.lattice.fit import fit_lattice
from tests.lattice.white_frames import draw_pupils, draw_white


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("degrees", [-1.0, 0.2, 12.0, 90.0])
def test_upright_undoes_any_choice_of_basis(kind: str, degrees: float) -> None:
    # a square lattice looks the same after a quarter turn; the smaller angle is taken
    angle = math.radians(degrees % 90 if kind == "square" and degrees == 90.0 else degrees)
    second = angle + math.radians(60 if kind == "hexagonal" else 90)
    basis = 9.0 * np.array([[math.cos(angle), math.sin(angle)], [math.cos(second), math.sin(second)]])
    # other bases of the same lattice with vectors of the shortest length
    turns = [((0, 1), (-1, 0)), ((-1, 0), (0, -1)), ((1, 0), (0, 1)), ((0, -1), (1, 0))]
    if kind == "hexagonal":
        turns += [((0, 1), (-1, 1)), ((1, -1), (1, 0)), ((-1, 1), (-1, 0))]
    for choice in turns:
        assert upright(np.array(choice) @ basis, kind) == pytest.approx(basis)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_neither_a_finer_nor_a_coarser_lattice_is_taken(kind: str) -> None:
    """Touching discs have weak first-order peaks; three types add peaks of a coarser lattice."""
    edges = (0.6, 1.4, 2.2) if kind == "hexagonal" else (0.4,)
    truth = draw_white(kind=kind, fill=1.0, edges=edges, pitch=18.0)
    rough = guess_lattice(truth.frame.astype(np.float32), None, None)
    assert rough.kind == kind
    assert np.allclose(rough.basis, truth.basis, atol=0.05)
    assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 0.1 * 18.0


@pytest.mark.parametrize("shape", [(140, 140), (160, 170)])
@pytest.mark.parametrize("pupil", [0.75, 0.9, 0.95])
@pytest.mark.parametrize("snr", [20.0, 1e6])
def test_overlapping_micro_images_are_centred_though_their_rims_are_brightest(
    shape: tuple[int, int], pupil: float, snr: float
) -> None:
    """What overlaps lights the rims: the lattice's points are where the mean micro-image looks alike all round."""
    frame, origin, basis = draw_pupils((0.5, 0.33, 0.2), pitch=11.0, pupil=pupil, shape=shape, snr=snr)
    rough = guess_lattice(frame, "hexagonal", None)
    assert np.allclose(rough.basis, basis, atol=0.1)
    steps = (rough.centre - np.array(origin)[::-1]) @ np.linalg.inv(basis)
    assert np.hypot(*((steps - np.rint(steps)) @ basis)) < 0.05 * 11.0


def test_only_the_middle_of_a_large_frame_is_looked_at() -> None:
    truth = draw_white((1700, 60), kind="square", pitch=10.0, rotation=0.0)
    rough = guess_lattice(truth.frame.astype(np.float32), None, None)
    assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 1.0


def test_a_wide_blur_keeps_planes_and_removes_ripple() -> None:
    y, x = np.mgrid[:200, :300].astype(np.float32)
    plane = (3 * x + y).astype(np.float32)
    inner = (slice(70, 130), slice(80, 220))
    ripple = (50 * np.sin(x)).astype(np.float32)
    assert np.abs(blurred(plane + ripple, 20.0) - plane)[inner].max() < 2.0


def test_of_the_two_places_of_a_square_cell_that_are_alike_the_bright_one_is_taken() -> None:
    """Lenslets, not the gaps between four of them, wherever the middle of the frame lies."""
    for offset in ((0.0, 0.0), (7.5, 7.5), (3.0, -4.0)):
        truth = draw_white(kind="square", pitch=15.0, offset=offset)
        rough = guess_lattice(truth.frame.astype(np.float32), "square", None)
        assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 1.5


UNEQUAL = {
    "checkered": lambda q, r: (q + r) % 2 == 0,
    "alternate rows": lambda q, r: r % 2 == 0,
    "alternate columns": lambda q, r: q % 2 == 0,
    "all but one of four": lambda q, r: (q % 2 == 1) | (r % 2 == 1),
    "one of four": lambda q, r: (q % 2 == 0) & (r % 2 == 0),
    "one type of three": lambda q, r: (q - r) % 3 == 0,
    "two types of three": lambda q, r: (q - r) % 3 != 0,
}
"""Lenslets of full brightness; the others are dimmer."""


@pytest.mark.few(2)
@pytest.mark.parametrize("dim", [0.3, 0.5, 0.6, 0.7, 0.85])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("bright", UNEQUAL)
def test_lenslets_of_unequal_brightness_are_all_found(bright: str, kind: str, dim: float) -> None:
    """Coatings, polarisers and types repeat over a coarser lattice, whose peaks are as strong as the array's own."""
    if kind == "square" and "three" in bright:
        pytest.skip("three types are of hexagonal arrays")
    truth = draw_white(
        (300, 340),
        pitch=16.4,
        kind=kind,
        rotation=0.01,
        fill=0.85,
        dead=0.0,
        dark=0.0,
        share=lambda q, r: np.where(UNEQUAL[bright](q, r), 1.0, dim),
    )
    fit = fit_lattice(truth.frame)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(16.4, abs=0.02)
    assert np.hypot(*truth.errors(fit.centres_px(*fit.index.T)).T).max() < 0.15
    assert fit.dead.mean() < 0.01, "a dim class is not dead"
    assert len(fit.index) > 0.75 * 300 * 340 / (truth.pitch * truth.row_pitch), "none is left out"


def test_a_mosaic_of_four_polarisers_is_found() -> None:
    share = np.array([[1.0, 0.85], [0.7, 0.55]])
    truth = draw_white(
        (300, 340), pitch=16.4, kind="square", fill=0.85, dead=0.0, dark=0.0, share=lambda q, r: share[q % 2, r % 2]
    )
    fit = fit_lattice(truth.frame)
    assert fit.pitch_px == pytest.approx(16.4, abs=0.02) and not fit.dead.any()


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("fill", [0.15, 0.3, 0.6, 0.95])
def test_gaps_are_no_lenslets(kind: str, fill: float) -> None:
    """A stopped-down main lens leaves small spots: the places of a finer lattice between them are dark."""
    truth = draw_white((300, 340), pitch=24.8, kind=kind, rotation=0.009, fill=fill, dead=0.0, dark=0.0)
    fit = fit_lattice(truth.frame)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(24.8, abs=0.02)


def test_a_stated_pitch_decides_between_lattices_that_contain_each_other() -> None:
    """Of a nearly dark half of the lenslets the image alone cannot tell."""
    truth = draw_white(
        (300, 340),
        pitch=16.4,
        kind="square",
        fill=0.85,
        dead=0.0,
        dark=0.0,
        share=lambda q, r: np.where((q + r) % 2 == 0, 1.0, 0.12),
    )
    frame = truth.frame.astype(np.float32)
    assert np.linalg.norm(guess_lattice(frame, None, 16.4).basis[0]) == pytest.approx(16.4, abs=0.1)
    assert np.linalg.norm(guess_lattice(frame, None, 16.4 * math.sqrt(2)).basis[0]) == pytest.approx(23.19, abs=0.1)
    with pytest.raises(InputError, match=r"a pitch within 10 % of 19 px"):
        guess_lattice(frame, None, 19.0)
