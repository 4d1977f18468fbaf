"""Targets: described, read and written, in words."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.targets import Pose, Target, parse_target, target_words
from lfcal.targets.target import proposed_hole

TARGETS = {
    "point": Target(),
    "point,hole=50um": Target(hole_um=50.0),
    "array:12x12@1.2mm": Target("square", (12, 12), (1200.0, 1200.0)),
    "array:3x4@800umx1.5mm,hole=20": Target("square", (3, 4), (800.0, 1500.0), 20.0),
    "array:5x4@1mm,hex": Target("hexagonal", (5, 4), (1000 * math.sqrt(3) / 2, 1000.0)),
    "array:5x4@1mm,absent=0:0+0:1": Target("square", (5, 4), (1000.0, 1000.0), absent=((0, 0), (0, 1))),
}


@pytest.mark.parametrize("words", TARGETS)
def test_words_say_what_the_target_is(words: str) -> None:
    target = TARGETS[words]
    assert parse_target(words) == target
    again = parse_target(target_words(target))
    assert again.pitch_um == pytest.approx(target.pitch_um, rel=1e-9)
    assert (again.kind, again.shape, again.hole_um, again.absent) == (
        target.kind,
        target.shape,
        target.hole_um,
        target.absent,
    )


def test_a_pitch_may_be_left_to_be_proposed() -> None:
    assert proposed_hole("array") == 0 and proposed_hole("array,hole=20um") == 20
    assert proposed_hole("array:2x2@1mm") is None
    with pytest.raises(InputError, match="where the pitch is proposed"):
        proposed_hole("array,hex")


WRONG = (
    "",
    "line",
    "array:12x12",
    "array:12@1mm",
    "array:12x12@",
    "array:12x12@1cm",
    "array:0x12@1mm",
    "array:12x12@-1mm",
    "array:12x12@nan",
    "array:1x1@1mm",
    "array:999999x999999@1mm",
    "array:4x4@1mm,hole=1.1mm",
    "array:4x4@1mmx2mm,hex",
    "array:4x4@1mm,hex,hex",
    "array:4x4@1mm,absent=4:0",
    "array:4x4@1mm,absent=1:0+1:0",
    "array:4x4@1mm,size=3",
    "point,hex",
    "point,hole=-3",
)


@pytest.mark.parametrize("words", WRONG)
def test_wrong_words_are_refused_in_a_line(words: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_target(words)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)


def test_json_keeps_everything() -> None:
    pose = Pose(0.1, 0.02, -0.03, 5.0, -7.0, 100.0)
    target = Target("hexagonal", (7, 5), (900.0, 1000.0), 20.0, ((1, 2),), pose, Pose(rotation_rad=0.01))
    assert Target.from_json(target.to_json()) == target
    assert Target.from_json(Target().to_json()) == Target()


@pytest.mark.parametrize(
    "change",
    [
        {"format": "lfcal-plan"},
        {"version": 2},
        {"kind": "round"},
        {"shape": [3]},
        {"shape": [3.5, 2]},
        {"pitch_um": [1000.0]},
        {"hole_um": "20"},
        {"pose": {"rotation_rad": 0.1}},
        {"within": None},
        {"colour": "red"},
    ],
)
def test_files_that_are_none_are_refused(change: dict[str, Any]) -> None:
    data = {**json.loads(parse_target("array:3x4@1mm").to_json()), **change}
    with pytest.raises(InputError):
        Target.from_dict(data)


def test_bounds_of_a_pose_are_not_negative() -> None:
    with pytest.raises(InputError, match="bound"):
        Target(within=Pose(right_um=-1.0))


def test_holes_lie_about_the_middle() -> None:
    square = parse_target("array:3x4@2mmx1mm")
    flat = square.flat_um(square.holes)
    assert flat.mean(axis=0) == pytest.approx([0, 0])
    assert flat[0].tolist() == [-1500.0, -2000.0] and flat[1].tolist() == [-500.0, -2000.0]
    hexagonal = parse_target("array:4x4@1mm,hex")
    flat = hexagonal.flat_um(hexagonal.holes)
    assert flat.mean(axis=0) == pytest.approx([0, 0])
    # every hole but those of the rim has six neighbours at one pitch
    distance = np.hypot(*(flat[:, None] - flat[None]).transpose(2, 0, 1))
    assert (np.abs(distance - 1000) < 1e-6).sum(axis=1).max() == 6
    assert np.sort(distance, axis=1)[:, 1] == pytest.approx(1000.0)
    assert hexagonal.nearest_um == pytest.approx(1000.0) and Target().nearest_um == math.inf


def test_neighbours_of_one_row_or_column_are_along_it() -> None:
    pitch = (700.0, 1000.0)
    assert Target("square", (1, 5), pitch).nearest_um == 1000.0
    assert Target("square", (5, 1), pitch).nearest_um == Target("square", (5, 5), pitch).nearest_um == 700.0


def test_absent_holes_are_not_there() -> None:
    target = parse_target("array:2x3@1mm,absent=0:1")
    assert target.holes.tolist() == [[0, 0], [0, 2], [1, 0], [1, 1], [1, 2]]


def test_poses_in_words() -> None:
    pose = Pose.parse("rotation=90, tilt_right=30,right=1mm,down=-20um,away=5")
    assert pose.rotation_rad == pytest.approx(math.pi / 2) and pose.tilt_right_rad == pytest.approx(math.pi / 6)
    assert (pose.right_um, pose.down_um, pose.away_um, pose.tilt_down_rad) == (1000.0, -20.0, 5.0, 0.0)
    for wrong in ("turn=1", "rotation", "rotation=1,rotation=2", "tilt_down=80", "right=1m", "rotation=inf"):
        with pytest.raises(InputError):
            Pose.parse(wrong)


def test_turns_and_tilts_go_the_way_they_say() -> None:
    right = np.array([[1.0, 0.0]])
    assert Pose.parse("rotation=90").points(right)[0] == pytest.approx([0, 1, 0], abs=1e-12)
    assert Pose.parse("tilt_right=30").points(right)[0] == pytest.approx([math.sqrt(0.75), 0, 0.5])
    assert Pose.parse("tilt_down=30").points(np.array([[0.0, 1.0]]))[0] == pytest.approx([0, math.sqrt(0.75), 0.5])
    turn = Pose(0.3, 0.2, -0.1).turn()
    assert turn @ turn.T == pytest.approx(np.eye(3)) and np.linalg.det(turn) == pytest.approx(1.0)
