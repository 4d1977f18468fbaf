"""Where views lie and what they hold, against plain loops over every sample, lenslet and box, at any angle."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice import extract_views, refocus, sample_views, view_grid
from lfcal.multiplex import lattice_channels
from tests.lattice.lattices import Bent, Straight

ANGLES, SLOW_ANGLES = (0.0, 0.25, 1.0, 7.0, 30.0, 45.0, 90.0), (-12.0,)
SHAPE, MARGIN = (131, 158), 5.0
ORIGINS = {"central": (63.2, 81.7), "cropped": (-40.3, 260.9)}
KINDS = ("square", "hexagonal")
Shares = dict[tuple[int, int], float]


@cache
def centres_of(lattice: Straight) -> dict[tuple[int, int], tuple[float, float]]:
    """Every lenslet that may matter: (q, r) -> (row, column)."""
    (ax, ay), (bx, by) = lattice.basis_px().tolist()
    row, column = lattice.origin
    return {
        (q, r): (row + q * ay + r * by, column + q * ax + r * bx)
        for q, r in itertools.product(range(-45, 46), repeat=2)
    }


@cache
def named(lattice: Straight) -> tuple[list[tuple[int, int]], np.ndarray]:
    """Return names and places of all lenslets as arrays are wanted."""
    centres = centres_of(lattice)
    return list(centres), np.array(list(centres.values()))


def inside(place: tuple[float, float]) -> bool:
    return all(MARGIN - 1e-6 <= p <= n - 1 - MARGIN + 1e-6 for p, n in zip(place, SHAPE, strict=True))


def upright(lattice: Straight) -> list[list[tuple[float, float]]]:
    """Places of the samples: equal steps about the lenslet nearest to the middle of the frame."""
    middle = ((SHAPE[0] - 1) / 2, (SHAPE[1] - 1) / 2)
    anchor = min(centres_of(lattice).values(), key=lambda c: math.dist(c, middle))
    step = lattice.pitch_px * (math.sqrt(3) / 2 if lattice.kind == "hexagonal" else 1.0)
    rows, columns = (
        [a + k * step for k in range(-40, 41) if MARGIN - 1e-6 <= a + k * step <= n - 1 - MARGIN + 1e-6]
        for a, n in zip(anchor, SHAPE, strict=True)
    )
    return [[(y, x) for x in columns] for y in rows]


def about(lattice: Straight, place: tuple[float, float]) -> Shares:
    """Lenslets about a place and their shares: the corners of a triangle (Cramer's rule) or a square (areas)."""
    centres = centres_of(lattice)
    if lattice.kind == "hexagonal":
        names, points = named(lattice)
        away = ((points - place) ** 2).sum(1)
        three = [names[n] for n in np.argsort(away)[:3]]
        if away.min() < 1e-12:
            return {three[0]: 1.0}
        corners = np.array([[*centres[k], 1.0] for k in three]).T
        found = np.linalg.solve(corners, np.array([*place, 1.0]))
        return {k: float(w) for k, w in zip(three, found, strict=True) if w > 1e-5}
    turn = lattice.rotation_rad
    y, x = place[0] - lattice.origin[0], place[1] - lattice.origin[1]
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    q, r = along / lattice.pitch_px, across / lattice.pitch_px
    # the area that a cell about the place shares with each lenslet's own
    shares = {
        (i, j): max(1 - abs(q - i), 0.0) * max(1 - abs(r - j), 0.0)
        for i, j in itertools.product(*([math.floor(v) - 1 + k for k in range(4)] for v in (q, r)))
    }
    return {k: w for k, w in shares.items() if w > 1e-5}


def in_row(lattice: Straight) -> list[list[Shares]]:
    """Return the samples along the lattice's own rows, as many as may matter."""
    lean, step = (0.5, math.sqrt(3) / 2) if lattice.kind == "hexagonal" else (0.0, 1.0)
    table = []
    for r in range(-40, 41):
        line = []
        for k in range(-45, 46):
            place = k * step - lean * r
            q = math.floor(place + 1e-5)
            line.append({(n, r): w for n, w in ((q, 1 - place + q), (q + 1, place - q)) if w > 1e-5})
        table.append(line)
    return table


def by_hand(lattice: Straight, axes: str) -> list[list[Shares]]:
    """Shares of every sample of the field, empty where it is not seen."""
    every = in_row(lattice) if axes == "lattice" else [[about(lattice, p) for p in line] for line in upright(lattice)]
    centres = centres_of(lattice)
    table = []
    for line in every:
        found = []
        for shares in line:
            good = {k: w for k, w in shares.items() if k in centres and inside(centres[k])}
            total = sum(good.values())
            found.append({k: w / total for k, w in good.items()} if total >= 0.5 - 1e-9 else {})
        table.append(found)
    return table


def trimmed(table: list[list[Shares]]) -> list[list[Shares]]:
    """Cut the table to the smallest box about all samples that are seen."""
    rows = [r for r, line in enumerate(table) if any(line)]
    columns = [c for c in range(len(table[0])) if any(line[c] for line in table)]
    return [line[min(columns) : max(columns) + 1] for line in table[min(rows) : max(rows) + 1]]


def most_samples(table: list[list[Shares]]) -> int:
    """Count the samples of the largest box, by trying every one."""
    best = 0
    for top, left in itertools.product(range(len(table)), range(len(table[0]))):
        width = len(table[0]) - left
        for bottom in range(top, len(table)):
            free = 0
            while free < width and table[bottom][left + free]:
                free += 1
            width = free
            best = max(best, width * (bottom - top + 1))
    return best


def between(pixels: list[list[float]], y: float, x: float) -> float:
    """Return a frame between its pixels, bilinear."""
    i, j = min(math.floor(y), SHAPE[0] - 2), min(math.floor(x), SHAPE[1] - 2)
    (a, b), (c, d) = pixels[i][j : j + 2], pixels[i + 1][j : j + 2]
    return (i + 1 - y) * ((j + 1 - x) * a + (x - j) * b) + (y - i) * ((j + 1 - x) * c + (x - j) * d)


@pytest.mark.few(3)
@pytest.mark.parametrize("where", ORIGINS)
@pytest.mark.parametrize("degrees", [*ANGLES, *(pytest.param(angle, marks=pytest.mark.long) for angle in SLOW_ANGLES)])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axes", ["frame", "lattice"])
def test_views_are_those_of_a_plain_loop(kind: str, degrees: float, where: str, axes: str) -> None:
    lattice = Straight(kind, degrees, ORIGINS[where])
    wanted = trimmed(by_hand(lattice, axes))
    grid = view_grid(lattice, SHAPE, MARGIN, axes=axes)
    assert grid.shape[0] * grid.shape[1] == most_samples(wanted)
    assert grid.mask.all()
    full = view_grid(lattice, SHAPE, MARGIN, axes=axes, full=True)
    assert full.shape == (len(wanted), len(wanted[0])) == grid.field_shape
    assert full.kept == 1.0 and grid.kept <= 1.0
    frame = np.random.default_rng(3).random(SHAPE)
    images = sample_views(frame, full, np.empty((3, 5, *full.shape)))
    centres = centres_of(lattice)
    pixels = frame.tolist()
    for (r, c), (v, u) in itertools.product(np.ndindex(full.shape), ((0, 0), (1, 2), (2, 3))):
        value = 0.0
        for lenslet, share in wanted[r][c].items():
            y, x = centres[lenslet]
            value += share * between(pixels, y + v - 1, x + u - 2)
        assert abs(images[v, u, r, c] - value) < 2e-4
        assert full.mask[r, c] == bool(wanted[r][c])


@pytest.mark.parametrize("axes", ["frame", "lattice"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_box_is_cut_out_of_the_full_field(kind: str, axes: str) -> None:
    lattice = Straight(kind, 30.0, ORIGINS["central"])
    box, full = (view_grid(lattice, SHAPE, MARGIN, axes=axes, full=full) for full in (False, True))
    c, s = math.cos(full.rotation_rad), math.sin(full.rotation_rad)
    turn = np.array([[c, -s], [s, c]])
    away = (np.array(box.corner_px) - np.array(full.corner_px)) @ turn.T / np.array(full.step_px)
    top, left = np.rint(away).astype(int)
    assert away == pytest.approx([top, left], abs=1e-9)
    frame = np.random.default_rng(3).random(SHAPE)
    images, whole = (sample_views(frame, grid, np.empty((3, 3, *grid.shape))) for grid in (box, full))
    rows, columns = box.shape
    np.testing.assert_allclose(images, whole[:, :, top : top + rows, left : left + columns], atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_views_keep_the_field_at_any_angle(kind: str) -> None:
    """Upright views of a frame of 80 x 95 micro-images lose a sample along a border at most, at any angle."""
    pitch = 13.37
    shape = (math.ceil(80 * pitch), math.ceil(95 * pitch))
    for degrees in (0.25, 1.0, 7.0, 30.0, 45.0):
        grid = view_grid(Straight(kind, degrees, (530.0, 640.0), pitch), shape, 5)
        most = [math.floor((n - 11) / grid.step_px[0]) + 1 for n in shape]
        assert all(0 <= m - n <= 2 for m, n in zip(most, grid.shape, strict=True)), (degrees, grid.shape, most)
        assert grid.kept > 0.97 and f"{grid.shape[0]} x {grid.shape[1]} of" in grid.described()


def test_every_lenslet_inside_is_in_the_full_field() -> None:
    for kind, degrees in itertools.product(KINDS, (0.0, 7.0, 30.0, 45.0)):
        lattice = Straight(kind, degrees, ORIGINS["central"])
        expected = sorted(c for c in centres_of(lattice).values() if inside(c))
        for axes in ("frame", "lattice"):
            grid = view_grid(lattice, SHAPE, MARGIN, axes=axes, full=True)
            found = sorted(map(tuple, grid.centres_px.tolist()))
            if kind == "square" and axes == "lattice":
                np.testing.assert_allclose(found, expected, atol=1e-9)
            # an upright sample at the border may see one lenslet of two by less than half
            assert len(expected) - 4 <= len(found) <= len(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_missing_lenslets_are_masked_and_leave_the_box(kind: str) -> None:
    lattice = Straight(kind, 0.0, ORIGINS["central"])
    plain = view_grid(lattice, SHAPE, MARGIN)
    grid = view_grid(lattice, SHAPE, MARGIN, missing=[(0, 0), (2, 1), (90, 0)])
    assert grid.shape == plain.shape
    lost = {tuple(np.round(lattice.centres_px(q, r), 6)) for q, r in ((0, 0), (2, 1))}
    assert not lost & {tuple(np.round(c, 6)) for c in grid.centres_px}
    rows, columns = (grid.corner_px[k] + grid.step_px[k] * np.arange(grid.shape[k]) for k in (0, 1))
    near = np.array([[min(math.dist((y, x), c) for c in lost) for x in columns] for y in rows])
    assert not grid.mask[near < 1e-6].any()
    assert grid.mask[near > lattice.pitch_px].all() and 1 <= (~grid.mask).sum() <= 4
    images = sample_views(np.ones(SHAPE), grid, np.empty((1, 1, *grid.shape)))
    np.testing.assert_allclose(images[0, 0], grid.mask, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bent_lattice_is_followed(kind: str) -> None:
    """3 px of radial distortion: what the lenslets see of a scene in their plane is the scene at upright places."""
    lattice = Bent(Straight(kind, 7.0, (200.4, 230.1)), 3.0, (400, 460))
    y, x = np.mgrid[:400, :460].astype(float)
    grid = view_grid(lattice, (400, 460), 5)
    unbent = np.rint(lattice.lenslet_at(*grid.centres_px.T))
    assert np.hypot(*(grid.centres_px - lattice.straight.centres_px(*unbent.T)).T).max() > 1.5
    rows, columns = (grid.corner_px[k] + grid.step_px[k] * np.arange(grid.shape[k]) for k in (0, 1))
    for scene, wanted in ((y, rows[:, None]), (x, columns[None, :])):
        seen = sample_views(scene, grid, np.empty((1, 1, *grid.shape)))[0, 0]
        # at the border a sample takes what lenslets inside see
        off = np.abs(seen - wanted)[1:-1, 1:-1]
        assert off.max() < 0.05


@pytest.mark.parametrize("kind", [pytest.param("square", marks=pytest.mark.long), "hexagonal"])
def test_super_pixels_are_cut_by_the_same_extractor(kind: str) -> None:
    frame = np.random.default_rng(3).random(SHAPE).astype(np.float32)
    for degrees, axes in itertools.product((0.0, 7.0, -12.0), ("lattice", "frame")):
        lattice = Straight(kind, degrees, (63.2, 81.7), shape=SHAPE)
        views = extract_views(frame, lattice, radius_px=5.0, axes=axes)
        assert views.shape == view_grid(lattice, SHAPE, 5, axes=axes).shape
        np.testing.assert_array_equal(lattice_channels(frame, lattice, 11, axes=axes), views.images)


@pytest.mark.parametrize("axes", ["frame", "lattice"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_turned_array_is_refocused(kind: str, axes: str) -> None:
    """A plane of slope 4 behind an array turned by 40 degrees: sharp at 4 and shifted nowhere."""
    lattice = Straight(kind, 40.0, (63.2, 81.7), shape=SHAPE)
    spot = lattice.centres_px(1, 1) + np.array([3.0, -4.0])
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    index = np.rint(lattice.lenslet_at(y, x))
    best, centres = np.full(SHAPE, np.inf), np.zeros((*SHAPE, 2))
    for i, j in itertools.product((-1, 0, 1), repeat=2):
        here = lattice.centres_px(index[..., 0] + i, index[..., 1] + j)
        distance = np.hypot(here[..., 0] - y, here[..., 1] - x)
        near = distance < best
        best[near], centres[near] = distance[near], here[near]
    seen = centres + 4.0 * (np.stack([y, x], -1) - centres)
    frame = 100 * np.exp(-((seen - spot) ** 2).sum(-1) / (2 * 10.0**2)).astype(np.float32)
    views = extract_views(frame, lattice, axes=axes)
    stack = refocus(views, [1.0, 2.5, 4.0, 5.5, 7.0], samples=4)
    assert int(np.argmax([image.max() for image in stack])) == 2
    image = np.where(stack[2] > 0.3 * stack[2].max(), stack[2], 0)
    down, right = (((float((image * k).sum() / image.sum()) + 0.5) / 4 - 0.5) for k in np.indices(image.shape))
    turn, step = views.rotation_rad, views.step_px
    found = (
        views.grid.corner_px[0] + down * step[0] * math.cos(turn) + right * step[1] * math.sin(turn),
        views.grid.corner_px[1] - down * step[0] * math.sin(turn) + right * step[1] * math.cos(turn),
    )
    assert found == pytest.approx(spot, abs=0.15 * step[0])


def test_a_frame_without_a_whole_micro_image_is_refused() -> None:
    lattice = Straight("square", 7.0, (4.0, 4.0), shape=(9, 9))
    for axes, full in itertools.product(("frame", "lattice"), (False, True)):
        assert view_grid(lattice, (9, 9), 5, axes=axes, full=full).shape == (0, 0)
        with pytest.raises(InputError, match="room for a micro-image of 11 x 11 px"):
            extract_views(np.ones((9, 9)), lattice, radius_px=5.0, axes=axes, full=full)
    # wide enough, but no lenslet in it
    assert view_grid(Straight("square", 0.0, (4.0, 4.0)), (15, 15), 7).shape == (0, 0)
    with pytest.raises(InputError, match="axes"):
        view_grid(lattice, (9, 9), 5, axes="up")
