"""Defect pixels: found over the frames, interpolated from their own colour."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress
from lfcal.frames import ArraySource, CorrectionChain, Defects, find_defects, iter_find_defects
from lfcal.frames.cfa import channel_names, channel_phase, check_cfa, same_colour_offsets

SHAPE = (90, 120)
HOT = [(0, 0), (10, 11), (40, 40), (41, 41), (88, 118)]
DEAD = [(45, 60), (50, 70)]
STUCK = [(42, 66)]


def spots(count: int, cfa: str, *, lit: bool = True, seed: int = 3) -> ArraySource:
    """Return frames of a grid of spots that moves, on a sensor with known defects."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices(SHAPE)
    frames = np.empty((count, *SHAPE))
    for k in range(count):
        frame = 100 + rng.normal(0, 3, SHAPE)
        y, x = 45 + 8 * np.sin(1.7 * k), 65 + 10 * np.cos(2.3 * k)
        if lit:
            for dy, dx in np.ndindex(7, 9):
                frame += 2000 * np.exp(-((rows - y - 10 * dy + 30) ** 2 + (columns - x - 10 * dx + 40) ** 2) / 4.5)
        for p in HOT:
            frame[p] += 500
        for p in DEAD:
            frame[p] = 100 + rng.normal(0, 3)
        for p in STUCK:
            frame[p] = 900
        frames[k] = frame
    metadata = {"cfa": cfa} if cfa else {}
    return ArraySource(frames.round().astype(np.uint16), [(0, 0, k) for k in range(count)], metadata=metadata)


@pytest.mark.parametrize("cfa", ["", "GRBG"])
@pytest.mark.parametrize("count", [24, 40])
def test_every_defect_is_found_and_nothing_else(count: int, cfa: str) -> None:
    found = find_defects(spots(count, cfa))
    kinds = {tuple(p): kind for p, kind in zip(np.asarray(found.pixels).tolist(), found.kinds, strict=True)}
    assert kinds == {**dict.fromkeys(HOT, "hot"), **dict.fromkeys(DEAD, "dead"), **dict.fromkeys(STUCK, "stuck")}
    assert found.cfa == cfa
    assert found.describe()["hot"] == len(HOT)


def test_dark_frames_show_hot_pixels_only() -> None:
    found = find_defects(spots(8, "", lit=False))
    assert np.asarray(found.pixels).tolist() == sorted(map(list, HOT + STUCK))
    assert set(found.kinds) == {"hot"}


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_sensor_without_defects(dtype: type) -> None:
    frames = np.random.default_rng(1).poisson(300, (12, 150, 160)).astype(dtype)
    assert len(find_defects(ArraySource(frames, [(0, 0, k) for k in range(12)]))) == 0


def test_frames_of_one_position_would_show_spots_as_hot_pixels() -> None:
    """The defects stay while the spots move; where nothing moves they cannot be told apart."""
    frame = np.random.default_rng(1).poisson(300, SHAPE)
    frame[30, 40] = 3000
    still = ArraySource(np.stack([frame] * 8).astype(np.uint16), [(0, 0, 0)] * 8)
    assert np.asarray(find_defects(still).pixels).tolist() == [[30, 40]]


def test_search_reports_progress_and_reads_no_more_than_asked() -> None:
    source = spots(24, "")
    read: list[int] = []
    chosen = [0, 5, 9, 14, 18, 23]
    plain = source.read
    source.read = lambda k: (read.append(k), plain(k))[1]  # type: ignore[method-assign]
    work = iter_find_defects(source, frames=6)
    records = list(work)
    assert all(isinstance(r, Progress) for r in records) and records[-1].fraction == 1
    assert read == chosen * 2


def test_pixels_that_no_spot_covers_are_not_taken_for_dead() -> None:
    """Between the few places where sharp spots stood, pixels see nothing while their neighbours do."""
    rows, columns = np.indices(SHAPE)
    frames = np.random.default_rng(4).normal(100, 3, (8, *SHAPE))
    for k, (y, x) in enumerate([(40, 40), (44, 40), (40, 44), (44, 44), (40, 42), (44, 42), (42, 40), (42, 44)]):
        frames[k] += 3000 * np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / (2 * 0.6**2))
    frames = frames.round().astype(np.uint16)
    span = np.ptp(frames, axis=0)
    assert span[42, 42] < 0.1 * np.sort(span[41:44, 41:44].ravel())[2], "it looks dead by its span alone"
    assert len(find_defects(ArraySource(frames, [(0, 0, k) for k in range(8)]))) == 0


def test_too_few_frames() -> None:
    with pytest.raises(InputError, match="frames to find defects in: expected at least 3, got 2"):
        find_defects(ArraySource(np.ones((2, 9, 9)), [(0, 0, 0), (0, 0, 1)]))


# -- repair ----------------------------------------------------------------------------------------------------


def test_bayer_repair_uses_the_same_colour() -> None:
    mosaic = np.zeros((12, 12), np.float32)
    for k, value in enumerate((10, 20, 30, 10)):  # green, red, blue, green
        mosaic[k // 2 :: 2, k % 2 :: 2] = value
    broken = mosaic.copy()
    pixels = [(4, 4), (4, 5), (5, 4), (5, 5), (0, 0), (11, 11)]
    for p in pixels:
        broken[p] = 9999
    np.testing.assert_array_equal(CorrectionChain((Defects(pixels, (12, 12), "GRBG"),)).apply(broken), mosaic)
    wrong = CorrectionChain((Defects(pixels, (12, 12)),)).apply(broken)
    assert np.abs(wrong - mosaic).max() > 5, "neighbours of another colour give another value"


def test_repair_of_a_plane_is_exact() -> None:
    rows, columns = np.indices((30, 40))
    plane = (3.0 * rows - 2.0 * columns + 500).astype(np.float32)
    broken = plane.copy()
    pixels = [(10, 10), (20, 30), (5, 6)]
    for p in pixels:
        broken[p] = 0
    np.testing.assert_allclose(CorrectionChain((Defects(pixels, (30, 40)),)).apply(broken), plane, atol=1e-3)


def test_masked_values_are_repaired_without_being_listed() -> None:
    rows, columns = np.indices((30, 40))
    plane = (3.0 * rows - 2.0 * columns + 500).astype(np.float32)
    broken = plane.copy()
    broken[10, 10] = np.nan
    broken[20:25, 20:25] = np.nan
    result = CorrectionChain((Defects([], (30, 40)),)).apply(broken)
    assert result[10, 10] == plane[10, 10]
    assert np.isfinite(result[20, 20:25]).all() and np.isnan(result[21:24, 21:24]).all(), "too far from a good pixel"
    assert np.isnan(CorrectionChain().apply(broken)).sum() == 26, "without the step they stay marked"


@pytest.mark.parametrize(
    ("pixels", "more", "words"),
    [
        ([(30, 5)], {}, "on the sensor of 30 x 40 px, got"),
        ([(-1, 5)], {}, "on the sensor"),
        ([(5, 5)], {"kinds": ("hot", "dead")}, "kinds of defects: expected as many as defective pixels (1), got 2"),
        ([(5, 5)], {"cfa": "GRB"}, "colour filter pattern"),
        ([(r, c) for r in range(10) for c in range(10)], {}, "at most 5 % of the sensor, got 8.33 %"),
        ([(r, c) for r in range(7) for c in range(7)], {}, "only defective ones within two periods"),
    ],
)
def test_unusable_defects(pixels: list[tuple[int, int]], more: dict, words: str) -> None:
    with pytest.raises(InputError) as caught:
        Defects(pixels, (30, 40), **more)
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_defects_are_sorted_and_counted_once() -> None:
    found = Defects([(5, 6), (1, 2), (5, 6)], (30, 40), kinds=("hot", "dead", "hot"))
    assert np.asarray(found.pixels).tolist() == [[1, 2], [5, 6]] and found.kinds == ("dead", "hot")
    assert len(found) == 2 and found.mask().sum() == 2
    assert len(Defects([], (30, 40))) == 0


# -- colour filter patterns ------------------------------------------------------------------------------------


def test_channel_names_are_numbered_by_rows() -> None:
    assert channel_names("GRBG") == ("G1", "R", "B", "G2")
    assert channel_names("RGGB") == ("R", "G1", "G2", "B")
    assert channel_names("RGBW") == ("R", "G", "B", "W")
    assert channel_phase("GRBG", "G2") == (1, 1)
    with pytest.raises(InputError, match="expected G1, R, B or G2, got 'G'"):
        channel_phase("GRBG", "G")
    with pytest.raises(InputError, match="monochrome"):
        channel_phase("", "G")
    for cfa in ("RGB", "XYZW", 7):
        with pytest.raises(InputError, match="colour filter pattern"):
            check_cfa(cfa)  # type: ignore[arg-type]


def test_nearest_same_colour_neighbours() -> None:
    mono = same_colour_offsets("")[0][0]
    assert sorted(map(tuple, mono[0].tolist())) == [(-1, 0), (0, -1), (0, 1), (1, 0)]
    green, red = same_colour_offsets("GRBG")[0]
    assert sorted(map(tuple, green[0].tolist())) == [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    assert sorted(map(tuple, red[0].tolist())) == [(-2, 0), (0, -2), (0, 2), (2, 0)]
