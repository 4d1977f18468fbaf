"""Which way frames lie, from the path of the pattern; frames made here with numpy alone, and simulated sessions."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import ORIENTATIONS, ArraySource, Dark, FrameSource, OrientedSource, Position, corrected, open_frames
from lfcal.frames.corrections.chain import CorrectionChain
from lfcal.frames.formats.image_file import read_image
from lfcal.psf._spot_path import path_frames
from lfcal.psf.orientation import FoundOrientation, find_orientation
from tests.frames.test_orientation import NUMPY

SESSION = Path(__file__).resolve().parents[2] / "sample_data" / "session"
UNDONE = {"rot90": "rot270", "rot270": "rot90"}


def a_plan(
    shape: tuple[int, int] = (90, 120),
    period: tuple[int, int] = (19, 33),
    anchor: tuple[float, float] = (25.0, 30.0),
    planes: int = 2,
    cutout: tuple[int, int] = (45, 45),
) -> ScanPlan:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=shape, bit_depth=16))
    return ScanPlan(camera, period, cutout, tuple(-20e3 - 3e3 * z for z in range(planes)), anchor)


def upright(
    plan: ScanPlan,
    *,
    width: float = 8.0,
    noise: float = 0.0,
    moves: np.ndarray | None = None,
    every: int = 1,
    seed: int = 0,
) -> tuple[np.ndarray, list[Position]]:
    """Return frames of a pattern of spots under a disc, which moves by ``moves`` (2, 2) times the planned way."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: plan.camera.sensor.shape[0], : plan.camera.sensor.shape[1]]
    places = [Position(z, y, x) for z, y, x in np.ndindex(*plan.shape[:3])][::every]
    places += [p for p in map(Position._make, _corners(plan)) if p not in places]
    middle = (np.array(plan.period) - 1) / 2
    frames = []
    for place in places:
        move = np.array(place[1:]) - middle
        r, c = np.array(plan.anchor) + middle + (move if moves is None else moves @ move)
        spots = np.cos(rows * 2 * math.pi / 9.5) ** 2 * np.cos((columns + rows / 2) * 2 * math.pi / 11) ** 2
        disc = 1 / (1 + np.exp((np.hypot(rows - r, columns - c) - width * (1 + place.z)) / 0.5))
        frames.append(1200 * spots * disc + 100 + noise * rng.standard_normal(rows.shape))
    return np.stack(frames).astype(np.float32), places


def _corners(plan: ScanPlan) -> list[tuple[int, int, int]]:
    (ny, nx), nz = plan.period, plan.shape[0]
    return [(z, y, x) for z in range(nz) for y in {0, ny // 2, ny - 1} for x in {0, nx // 2, nx - 1}]


def solved(frames: np.ndarray, places: list[Position], plan: ScanPlan, lie: str = "as is") -> FoundOrientation:
    """Return what is found of frames that need ``lie``: they are delivered with its opposite done to them."""
    delivered = np.stack([NUMPY[UNDONE.get(lie, lie)](frame) for frame in frames])
    return find_orientation(ArraySource(delivered, places), plan)


@pytest.mark.parametrize("name", NUMPY)
def test_every_orientation_of_the_sample_session_is_recognised_from_twenty_frames(name: str) -> None:
    plan = ScanPlan.from_json((SESSION / "plan.json").read_text())
    with open_frames(SESSION / "frames", plan_shape=plan.shape[:3]) as frames:
        dark = read_image(next((SESSION / "dark").iterdir())).astype(np.float32)
        view = corrected(frames, CorrectionChain((Dark(dark),)))
        found = find_orientation(OrientedSource(view, ORIENTATIONS[name].inverse), plan)
    assert found.name == name
    assert found.frames <= 20
    assert found.margin == 10.0
    # its cell is in the middle of the frame, where a reversed scan looks the same; on its side nothing else does
    sides = {"as is": "", "mirror x": "either", "mirror y": "either", "rot180": "either"}
    assert found.cause == sides.get(name, "frames")


@pytest.mark.few(4)
@pytest.mark.parametrize("name", NUMPY)
def test_noise_background_drift_hot_pixels_and_dead_frames_do_not_mislead(name: str) -> None:
    plan = a_plan()
    frames, places = upright(plan, noise=40.0, every=37)
    rng = np.random.default_rng(3)
    rows, columns = np.mgrid[:90, :120]
    # twice the pattern's light in a slope, and a reflection that does not move
    frames += 4 * rows + 3 * columns + 3000 * np.exp(-((rows - 80) ** 2 + (columns - 15) ** 2) / 20)
    frames[:, rng.integers(0, 90, 40), rng.integers(0, 120, 40)] = 60_000
    for k in range(0, len(frames), 5):
        frames[k] = 120 + 30 * rng.standard_normal((90, 120))
    found = solved(frames, places, plan, name)
    assert found.name == name
    # the cell is off the middle: a reversed scan would show it elsewhere
    assert found.cause == ("" if name == "as is" else "frames")


@pytest.mark.parametrize("name", ["as is", "mirror y", "rot90"])
def test_a_pattern_larger_than_its_way_is_followed(name: str) -> None:
    plan = a_plan((160, 160), (19, 33), (50.0, 45.0), 1, (75, 75))
    frames, places = upright(plan, width=30.0, noise=30.0, every=41)
    assert solved(frames, places, plan, name).name == name


def test_a_scan_that_ran_backwards_is_named_and_in_the_middle_both_explanations_are() -> None:
    x = "the x axis of stage or scan is reversed relative to the plan"
    for anchor, cause, words in (
        ((25.0, 30.0), "scan", x),
        ((35.0, 43.0), "either", f"the frames are mirrored left to right, or {x}"),
    ):
        plan = a_plan(anchor=anchor)
        frames, places = upright(plan, moves=np.diag([1.0, -1.0]), every=37)
        found = solved(frames, places, plan)
        assert (found.name, found.cause, found.words) == ("mirror x", cause, words)


def test_a_wrong_step_does_not_hide_the_orientation() -> None:
    plan = a_plan()
    frames, places = upright(plan, moves=1.4 * np.eye(2), every=37)
    assert solved(frames, places, plan, "rot180").name == "rot180"


def test_a_single_position_shows_the_orientation_off_the_middle_only() -> None:
    plan = a_plan((100, 100), (1, 1), (49.0, 49.0), 3)
    frames, places = upright(plan)
    found = solved(frames, places, plan, "mirror x")
    assert not found.name
    assert "alike" in found.words
    plan = a_plan((100, 100), (1, 1), (36.0, 24.0), 3)
    frames, places = upright(plan)
    assert solved(frames, places, plan, "rot270").name == "rot270"


def test_one_row_in_the_middle_leaves_top_and_bottom_open() -> None:
    plan = a_plan((101, 130), (1, 33), (50.0, 30.0), 2)
    frames, places = upright(plan, every=3)
    found = solved(frames, places, plan, "mirror x")
    assert not found.name
    assert "mirror x" in found.reason


def test_an_image_that_stands_still_and_dark_frames_show_nothing() -> None:
    plan = a_plan((100, 100), anchor=(40.0, 33.0))
    frames, places = upright(plan, moves=np.zeros((2, 2)), noise=10.0, every=37)
    assert not solved(frames, places, plan).name
    dark = np.full_like(frames, 100.0)
    found = solved(dark, places, plan)
    assert not found.wrong
    assert "light in 0 of" in found.reason


@pytest.mark.parametrize("name", ["rot90", "transpose"])
def test_the_shape_of_the_frames_counts(name: str) -> None:
    # a scan counted along the other axis first cannot turn a frame on its side
    plan = a_plan()
    frames, places = upright(plan, every=37)
    assert solved(frames, places, plan, name).cause == "frames"
    square = a_plan((120, 120), anchor=(51.0, 44.0))
    frames, places = upright(square, every=37)
    assert solved(frames, places, square, name).cause == "either"
    on_side = ArraySource(np.stack([f.T for f in upright(plan, every=37)[0]]), upright(plan, every=37)[1])
    assert find_orientation(on_side, plan).name == "transpose"


# -- simulated sessions ------------------------------------------------------------------------------------------------


def looked_at(plan: ScanPlan, folder: Path) -> FrameSource:
    """Return the frames of a plan that are looked at, as the simulated camera records them, two of them dark."""
    (folder / "plan.json").write_text(plan.to_json())
    with open_frames(folder / "plan.json") as source:
        infos = [source.info(k) for k in range(len(source))]
        chosen = path_frames(infos, plan.shape[:3])
        frames = np.stack([source.read(k) for k in chosen]).astype(np.float32)
    frames += 4.0 * np.random.default_rng(0).standard_normal(frames.shape)
    frames[[1, 9]] = np.median(frames) + 4.0 * np.random.default_rng(1).standard_normal(frames[:2].shape)
    return ArraySource(frames, [infos[k].position for k in chosen])


def plan_of(name: str, shape: tuple[int, int], **options: Any) -> ScanPlan:
    camera = preset(name)
    return ScanPlan.for_camera(replace(camera, sensor=replace(camera.sensor, shape=shape)), **options)


SESSIONS = {
    "microscope": lambda: plan_of("lfm_20x05", (260, 340), depths_um=[-20.0, 0.0, 20.0], anchor=(100.0, 120.0)),
    "r29": lambda: plan_of("r29", (420, 520), virtual_depths=[-3.0, 2.2, 4.0], anchor=(110.0, 150.0)),
}


@pytest.mark.long
@pytest.mark.parametrize("session", ["microscope", "r29"])
def test_all_eight_are_recognised(session: str, tmp_path: Path) -> None:
    plan = SESSIONS[session]()
    frames = looked_at(plan, tmp_path)
    for name, one in ORIENTATIONS.items():
        found = find_orientation(OrientedSource(frames, one.inverse), plan)
        assert found.name == name, found
        assert found.cause == ("" if name == "as is" else "frames"), found
