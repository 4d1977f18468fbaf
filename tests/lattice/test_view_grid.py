"""The box of view pixels against a search over every lenslet and every box, at any angle."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.lattice import LatticeFit, extract_views, fit_lattice, refocus, view_grid
from lfcal.multiplex import SuperPixelLattice, lattice_channels
from tests.lattice.white_frames import draw_white

ANGLES = (0.0, 0.25, 1.0, 7.0, 30.0, 45.0, -12.0, 90.0)
SHAPE, MARGIN = (131, 158), 5.0
ORIGINS = {"central": (63.2, 81.7), "cropped": (-40.3, 260.9)}


def basis_of(kind: str, degrees: float, pitch: float = 12.37) -> NDArray[np.float64]:
    turn = math.radians(degrees)
    along = np.array([math.cos(turn), math.sin(turn)])
    across = np.array([-along[1], along[0]])
    if kind == "square":
        return pitch * np.array([along, across])
    return pitch * np.array([along, along / 2 + math.sqrt(3) / 2 * across])


def inside(basis: NDArray[np.float64], origin: tuple[float, float]) -> set[tuple[int, int]]:
    """Every lenslet (q, r) whose centre keeps the margin: from a list of all there may be."""
    found = set()
    for q, r in itertools.product(range(-60, 61), repeat=2):
        x, y = q * basis[0] + r * basis[1] + np.array(origin)[::-1]
        if MARGIN <= x <= SHAPE[1] - 1 - MARGIN and MARGIN <= y <= SHAPE[0] - 1 - MARGIN:
            found.add((q, r))
    return found


def most_pixels(kind: str, good: set[tuple[int, int]]) -> int:
    """Largest box by trying every pair of rows and every start; columns are checked one by one."""
    lean, step = (0.5, math.sqrt(3) / 2) if kind == "hexagonal" else (0.0, 1.0)
    rows = sorted({r for _, r in good})
    best = 0
    for top in rows:
        starts = {q + lean * r for q, r in good if top <= r}
        for left in starts:
            bottom, width = top, 10**6
            while width:
                width = min(width, _columns(good, lean, step, bottom, left))
                best = max(best, width * (bottom - top + 1))
                bottom += 1
    return best


def _columns(good: set[tuple[int, int]], lean: float, step: float, row: int, left: float) -> int:
    """How many samples from ``left`` on lie on a lenslet of the row, or between two of them."""
    n = 0
    while True:
        place = left + n * step - lean * row
        nearest = round(place)
        needed = {nearest} if abs(place - nearest) < 1e-7 else {math.floor(place), math.floor(place) + 1}
        if not all((q, row) in good for q in needed):
            return n
        n += 1


@pytest.mark.parametrize("where", ORIGINS)
@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_box_is_the_largest_there_is(kind: str, degrees: float, where: str) -> None:
    basis, origin = basis_of(kind, degrees), ORIGINS[where]
    good = inside(basis, origin)
    grid = view_grid(kind, basis, origin, SHAPE, MARGIN)
    assert grid.shape[0] * grid.shape[1] == most_pixels(kind, good)
    left, share = grid.neighbours()
    assert np.abs(left + share + grid.lean * grid.rows[:, None] - grid.columns).max() < 1e-6
    for r, q, s in zip(np.repeat(grid.rows, grid.shape[1]), left.ravel(), share.ravel(), strict=True):
        assert (q, r) in good and (s == 0 or (q + 1, r) in good)


@pytest.mark.parametrize("degrees", ANGLES)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_both_ways_to_cut_views_use_it(kind: str, degrees: float) -> None:
    frame = np.random.default_rng(3).random(SHAPE).astype(np.float32)
    basis = basis_of(kind, degrees)
    fit = fit_of(kind, basis, (63.2, 81.7))
    views = extract_views(frame, fit, radius_px=5.0)
    channels = lattice_channels(frame, SuperPixelLattice.of_fit(fit), 11)
    assert views.shape == view_grid(kind, basis, (63.2, 81.7), SHAPE, 5).shape
    np.testing.assert_allclose(channels, views.images, atol=2e-5)


def fit_of(kind: str, basis: NDArray[np.float64], origin: tuple[float, float]) -> LatticeFit:
    """Return the fit of a known lattice; which lenslets were placed does not matter to views."""
    drawn = draw_white((200, 210), kind=kind, dead=0.0)
    pitch = float(np.hypot(*basis[0]))
    row_pitch = float(basis[0, 0] * basis[1, 1] - basis[0, 1] * basis[1, 0]) / pitch
    return replace(
        fit_lattice(drawn.frame),
        shape=SHAPE,
        pitch_px=pitch,
        row_pitch_px=row_pitch,
        rotation_rad=math.atan2(basis[0, 1], basis[0, 0]),
        origin_px=origin,
    )


@pytest.mark.parametrize("degrees", [0.25, 1.0, 7.0])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_a_slightly_turned_lattice_keeps_its_field(kind: str, degrees: float) -> None:
    """A rectangle turned by an angle t inside a frame of w x h leaves less than (w + h) tan t of each side."""
    shape, pitch = (1100, 1300), 12.4
    straight, turned = (
        view_grid(kind, basis_of(kind, d, pitch), (550.0, 650.0), shape, 5).shape for d in (0.0, degrees)
    )
    kept = turned[0] * turned[1] / (straight[0] * straight[1])
    assert kept > (1 - 1.1 * math.tan(math.radians(degrees)) * shape[1] / shape[0]) ** 2


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_a_turned_array_is_refocused_in_its_own_axes(kind: str) -> None:
    """A plane of slope 4 behind an array turned by 40 degrees: sharp at 4 and shifted nowhere."""
    basis = basis_of(kind, 40.0)
    fit = fit_of(kind, basis, (63.2, 81.7))
    spot = fit.centres_px(1, 1) + np.array([3.0, -4.0])
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    index = np.rint(fit.lenslet_at(y, x))
    best, centres = np.full(SHAPE, np.inf), np.zeros((*SHAPE, 2))
    for i, j in itertools.product((-1, 0, 1), repeat=2):
        here = fit.centres_px(index[..., 0] + i, index[..., 1] + j)
        distance = np.hypot(here[..., 0] - y, here[..., 1] - x)
        near = distance < best
        best[near], centres[near] = distance[near], here[near]
    seen = centres + 4.0 * (np.stack([y, x], -1) - centres)
    frame = 100 * np.exp(-((seen - spot) ** 2).sum(-1) / (2 * 10.0**2)).astype(np.float32)
    views = extract_views(frame, fit)
    stack = refocus(views, [1.0, 2.5, 4.0, 5.5, 7.0], samples=4)
    assert int(np.argmax([image.max() for image in stack])) == 2
    grid = view_grid(kind, basis, fit.origin_px, SHAPE, math.floor(views.radius_px))
    at = np.linalg.solve(basis.T, (spot - np.array(fit.origin_px))[::-1])
    step = views.step_px[1] / fit.pitch_px
    want = (at[1] - grid.rows[0], (at[0] + grid.lean * at[1] - grid.columns[0]) / step)
    image = np.where(stack[2] > 0.3 * stack[2].max(), stack[2], 0)
    rows, columns = np.indices(image.shape)
    found = [(float((image * k).sum() / image.sum()) + 0.5) / 4 - 0.5 for k in (rows, columns)]
    assert found == pytest.approx(want, abs=0.15)


def test_a_frame_without_a_whole_micro_image_is_refused() -> None:
    grid = view_grid("square", basis_of("square", 7.0), (4.0, 4.0), (9, 9), 5)
    assert grid.shape == (0, 0)
    fit = replace(fit_of("square", basis_of("square", 7.0), (4.0, 4.0)), shape=(9, 9))
    with pytest.raises(InputError, match="micro-image of 11 x 11 px wholly inside"):
        extract_views(np.ones((9, 9)), fit, radius_px=5.0)
