"""Scan orders and file names give the positions they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import NamePattern, Position, scan_positions
from lfcal.frames.positions import natural_key

SMALL = st.integers(1, 5)


@given(SMALL, SMALL, SMALL, st.sampled_from(["serpentine", "raster"]))
@settings(derandomize=True, deadline=None)
def test_every_position_once_and_serpentine_moves_by_single_steps(nz: int, ny: int, nx: int, order: str) -> None:
    positions = scan_positions((nz, ny, nx), order)
    assert sorted(positions) == [Position(*p) for p in np.ndindex(nz, ny, nx)]
    if order == "raster":
        assert positions == sorted(positions)
    else:
        moves = np.abs(np.diff(np.array(positions), axis=0)).sum(axis=1)
        assert (moves == 1).all()


@pytest.mark.parametrize("order", ["serpentine", "raster"])
def test_order_is_that_of_the_scan_plan(order: str) -> None:
    plan = ScanPlan.for_camera(preset("bench"), depths_um=(-20.0, 0.0, 30.0), cutout=(3, 3))
    plan = replace(plan, order=order)
    assert scan_positions(plan.shape[:3], order) == [Position(*p) for p in plan.order_indices().tolist()]


@given(st.tuples(*[st.integers(0, 999)] * 3), st.integers(0, 99), st.integers(0, 1))
@settings(derandomize=True, deadline=None)
def test_names_round_trip(place: tuple[int, int, int], page: int, first: int) -> None:
    pattern = NamePattern("plane{z:03d}/y{y}_x{x:02d}_{page}.tif", first=first)
    assert pattern.parse(pattern.name(Position(*place), page)) == (Position(*place), page)


@pytest.mark.parametrize(
    ("template", "name", "position"),
    [
        ("z{z}_y{y}_x{x}.png", "z1_y02_x003.png", (1, 2, 3)),
        ("y{y}_x{x}.png", "y2_x3.png", (0, 2, 3)),
        ("*_y{y}_x{x}_*.tif", "run7_y2_x3_12h30.tif", (0, 2, 3)),
        ("z{z}/z{z}_y{y}_x{x}.png", "z4/z4_y2_x3.png", (4, 2, 3)),
        ("a+b(c)_{y}.{x}", "a+b(c)_5.6", (0, 5, 6)),
    ],
)
def test_names_that_fit(template: str, name: str, position: tuple[int, int, int]) -> None:
    assert NamePattern(template).parse(name) == (position, 0)


@pytest.mark.parametrize(
    ("template", "name"),
    [
        ("z{z}_y{y}_x{x}.png", "z1_y2_x3.tif"),
        ("z{z}_y{y}_x{x}.png", "z1_y2_x-3.png"),
        ("z{z}_y{y}_x{x}.png", "dir/z1_y2_x3.png"),
        ("z{z}/z{z}_y{y}_x{x}.png", "z4/z5_y2_x3.png"),
        ("*_y{y}_x{x}.png", "a/b_y2_x3.png"),
    ],
)
def test_names_that_do_not_fit(template: str, name: str) -> None:
    assert NamePattern(template).parse(name) is None


def test_names_counted_from_one() -> None:
    assert NamePattern("y{y}_x{x}.png", first=1).parse("y1_x4.png") == ((0, 0, 3), 0)
    with pytest.raises(InputError, match="numbers from 1, got 0"):
        NamePattern("y{y}_x{x}.png", first=1).parse("y0_x4.png")


@pytest.mark.parametrize(
    "template", ["", "z{z}.png", "/y{y}_x{x}.png", "../y{y}_x{x}.png", "y{y}\\x{x}.png", "y{y}_x{x}_{t}.png"]
)
def test_unusable_patterns(template: str) -> None:
    with pytest.raises(InputError, match="name pattern: expected"):
        NamePattern(template)


@pytest.mark.parametrize("shape", [(2, 3), (0, 3, 4), (2, 3, 2.5), (10**5, 10**5, 10)])
def test_unusable_scan_shapes(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"scan|positions"):
        scan_positions(shape)


def test_natural_order() -> None:
    names = ["img10.png", "img2.png", "img1.png", "b.png", "2_1.png"]
    assert sorted(names, key=natural_key) == ["2_1.png", "b.png", "img1.png", "img2.png", "img10.png"]
