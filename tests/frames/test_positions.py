"""Scan orders and file names give the positions they stand for."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames import NamePattern, Position, open_frames, scan_positions
from lfcal.frames.positions import guess_pattern, natural_key
from tests.frames.scenes import session, write_pngs

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


SHAPE = (2, 3, 4)
ALL = list(product(range(2), range(3), range(4)))
FORMS = {
    "img_x{x}_y{y}_z{z}.tif": "img_x{x:03d}_y{y:03d}_z{z}.tif",
    "plane{z}/row-{y}_col-{x}.png": "plane{z}/row-{y}_col-{x}.png",
    "run7_Z{z}Y{y}X{x}.tiff": "run7_Z{z:02d}Y{y:02d}X{x:02d}.tiff",
    "z{z}r{y}c{x}.pgm": "z{z}r{y}c{x}.pgm",
}


@pytest.mark.parametrize("template", list(FORMS))
def test_words_before_the_numbers_tell(template: str) -> None:
    names = [FORMS[template].format(z=z, y=y, x=x) for z, y, x in ALL]
    guess = guess_pattern(names, SHAPE)
    assert guess.certain and guess.templates == (template,)
    form = NamePattern(template)
    assert [form.parse(name)[0] for name in names] == [Position(*p) for p in ALL]  # type: ignore[index]


@pytest.mark.parametrize(
    ("shape", "templates"),
    [(SHAPE, ("pos-{z}-{y}-{x}.png",)), ((2, 4, 3), ("pos-{z}-{x}-{y}.png",)), ((4, 2, 3), ("pos-{y}-{x}-{z}.png",))],
)
def test_numbers_without_words_are_told_by_the_scan(shape: tuple[int, int, int], templates: tuple[str, ...]) -> None:
    names = [f"pos-{z:03d}-{y:03d}-{x:03d}.png" for z, y, x in ALL]
    assert guess_pattern(names, shape).templates == templates
    assert len(guess_pattern(names).templates) == 6 and not guess_pattern(names).certain
    assert guess_pattern(names, (5, 5, 5)).templates == ()


def test_a_square_scan_does_not_tell() -> None:
    names = [f"pos-{y}-{x}.png" for y, x in product(range(3), range(3))]
    assert guess_pattern(names, (1, 3, 3)).templates == ("pos-{y}-{x}.png", "pos-{x}-{y}.png")


def test_one_plane_and_constant_numbers() -> None:
    names = [f"run12_z1_y{y}_x{x}.png" for y, x in product(range(3), range(4))]
    assert guess_pattern(names, (1, 3, 4)).templates == ("run12_z1_y{y}_x{x}.png",)
    assert guess_pattern(names, SHAPE).templates == ("run12_z{z}_y{y}_x{x}.png",)


@pytest.mark.parametrize("names", [[], ["dark.png"], ["a{1}_{2}.png", "a{2}_{2}.png"], ["a.png", "b.png"]])
def test_names_that_hold_no_position(names: list[str]) -> None:
    guess = guess_pattern(names, SHAPE)
    assert guess.templates == () and not guess.certain and guess.numbered == 0


def test_numbered_files_are_in_an_order() -> None:
    assert guess_pattern([f"img_{k:05d}.tif" for k in range(24)], SHAPE).numbered == 24


def test_what_is_said_of_a_folder(tmp_path: Path) -> None:
    frames = session((1, 3, 3, 20, 30))
    for name, (y, x) in zip(write_pngs(tmp_path, frames), product(range(3), range(3)), strict=True):
        (tmp_path / name).rename(tmp_path / f"pos-{y}-{x}.png")
    with pytest.raises(InputError, match=r"'pos-\{y\}-\{x\}\.png' or 'pos-\{x\}-\{y\}\.png'; give --pattern"):
        open_frames(tmp_path, plan_shape=(1, 3, 3))
    for k, path in enumerate(sorted(tmp_path.iterdir())):
        path.rename(tmp_path / f"frame{k:03d}.png")
    with pytest.raises(
        InputError, match=r"9 numbered files such as frame\d+\.png; name their list .* their order: --order serpentine"
    ):
        open_frames(tmp_path, plan_shape=(1, 3, 3))


def test_a_stray_image_makes_the_guess_a_question(tmp_path: Path) -> None:
    names = write_pngs(tmp_path, session((1, 2, 3, 20, 30)))
    (tmp_path / "overview.png").write_bytes((tmp_path / names[0]).read_bytes())
    with pytest.raises(InputError, match=r"6 of 7 names that look like 'z0_y\{y\}_x\{x\}\.png'"):
        open_frames(tmp_path)


def test_names_count_from_one_or_nought(tmp_path: Path) -> None:
    names = write_pngs(tmp_path, session((1, 2, 3, 20, 30)))
    for name in names:
        y, x = int(name[4]) + 1, int(name[7]) + 1
        (tmp_path / name).rename(tmp_path / f"y{y}x{x}.png")
    assert open_frames(tmp_path).info(5).position == Position(0, 1, 2)
    assert open_frames(tmp_path, first=0).info(5).position == Position(0, 2, 3)
    (tmp_path / "y1x1.png").unlink()
    assert open_frames(tmp_path, plan_shape=(1, 2, 3)).info(0).position == Position(0, 0, 1)
    # one number beyond the scan that starts at 1 fits: this is a scan from nought whose first rows are missing
    assert open_frames(tmp_path, plan_shape=(1, 4, 4)).info(0).position == Position(0, 1, 2)
