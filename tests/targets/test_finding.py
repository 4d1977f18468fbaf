"""Holes found in a frame: labels and places against those it was drawn with, faults by name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.targets import FoundPoints, Pose, Target, find_points
from lfcal.targets.finding import _shown
from tests.targets.common import bench, scan_of
from tests.targets.drawn import drawn, places

CAMERA = bench(480)
Z = scan_of(CAMERA).depths_um[0]
PX = CAMERA.step_um(Z)
MARKS = ((0, 0), (0, 1), (1, 0))
MOUNT = Pose.parse("rotation=3,tilt_right=4,tilt_down=4")


def array(rows: int = 7, columns: int = 7, pitch: float = 57.0, **more: object) -> Target:
    return Target("square", (rows, columns), (pitch * PX, pitch * PX), **more)


def found(frame: np.ndarray, target: Target, **more: object) -> FoundPoints:
    return find_points(frame, target, CAMERA, Z, **more)


def kinds(points: FoundPoints) -> set[str]:
    return {one.kind for one in points.mistakes}


def errors(points: FoundPoints, target: Target) -> np.ndarray:
    """Return the distance of each found place from the true one of its label."""
    true = places(target, CAMERA, Z)
    return np.linalg.norm(points.pixels - np.array([true[tuple(h)] for h in points.holes.tolist()]), axis=1)


def test_places_are_counted_to_the_edges_of_the_frame() -> None:
    """A lattice of 20 px whose place (0, 0) is at row 70, column 90 of 100 x 120 px."""
    indices = np.array([(0, 0), (0, 1), (1, 0), (-1, 0)])
    pitch = np.diag([20.0, 20.0])
    spots = SimpleNamespace(pixels=indices @ pitch + (70, 90))
    whole, before = _shown(spots, indices, pitch, (100, 120), 3.0)  # type: ignore[arg-type]
    shown = {(i - before[0], j - before[1]) for i, j in np.argwhere(whole).tolist()}
    assert shown == {(i, j) for i in range(-3, 2) for j in range(-4, 2)}


def test_a_target_as_described_is_found_whole() -> None:
    target = array(absent=MARKS)
    points = found(drawn(target, CAMERA, Z, spread=0.1), target)
    assert points.holes.tolist() == target.holes.tolist()
    assert errors(points, target).max() < 0.1 and not points.mistakes
    assert points.fit.rms_px < 0.25 and points.confidence.min() > 0.8


def test_an_unknown_pose_is_measured() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        angles, shifts = rng.uniform(-1, 1, 3) * [0.04, 0.05, 0.05], rng.uniform(-1, 1, 2) * 15 * PX
        pose = Pose(*angles.tolist(), *shifts.tolist())
        true = array(absent=MARKS, pose=pose)
        points = found(drawn(true, CAMERA, Z, spread=0.1, seed=seed), array(absent=MARKS, within=MOUNT))
        assert errors(points, true).max() < 0.15
        got, sigma = points.fit.pose, points.fit.sigma
        for name in ("rotation_rad", "tilt_right_rad", "tilt_down_rad", "right_um", "down_um"):
            assert abs(getattr(got, name) - getattr(pose, name)) < 5 * getattr(sigma, name), (seed, name)
        assert abs(got.rotation_rad - pose.rotation_rad) < 2e-3


def test_a_hexagonal_target_and_one_of_two_pitches() -> None:
    hexagonal = Target("hexagonal", (7, 6), (52.0 * PX, 60.0 * PX), absent=((0, 0),), pose=Pose(rotation_rad=0.02))
    other = Target("square", (6, 5), (55.0 * PX, 70.0 * PX), pose=Pose(rotation_rad=-0.03))
    for target in (hexagonal, other):
        points = found(drawn(target, CAMERA, Z), replace(target, pose=Pose()))
        assert points.holes.tolist() == target.holes.tolist() and errors(points, target).max() < 0.1


def test_a_moved_target_has_the_same_labels() -> None:
    target = array(absent=MARKS)
    moved = replace(target, pose=Pose(right_um=20 * PX, down_um=-26 * PX))
    points = found(drawn(moved, CAMERA, Z), target, offset_px=(-26.0, 20.0))
    assert points.holes.tolist() == target.holes.tolist() and errors(points, moved).max() < 0.1
    # also a target farther away than stated, if one labelling explains it
    really = replace(target, pose=Pose(right_um=-50 * PX))
    assert errors(found(drawn(really, CAMERA, Z), target), really).max() < 0.1


def test_distortion_of_the_lens_is_not_taken_for_a_pitch() -> None:
    target = array()
    points = found(drawn(target, CAMERA, Z, bend=-0.01), target)
    assert points.fit.bend == pytest.approx(-0.01, abs=1e-3)
    assert "pitch" not in kinds(points) and points.deviation.std() < 0.15


def test_a_missing_row_is_named() -> None:
    target = array(absent=MARKS)
    for row in (3, 6):
        gone = tuple((row, c) for c in range(7))
        points = found(drawn(target, CAMERA, Z, without=gone), target)
        assert [m.kind for m in points.mistakes] == ["missing row"] and points.mistakes[0].positions == gone
        assert f"row {row} is missing" in str(points.mistakes[0])
        assert errors(points, target).max() < 0.1
    column = tuple((r, 4) for r in range(7))
    assert kinds(found(drawn(target, CAMERA, Z, without=column), target)) == {"missing column"}
    points = found(drawn(target, CAMERA, Z, without=((3, 3), (5, 1))), target)
    assert [(m.kind, m.positions) for m in points.mistakes] == [("missing holes", ((3, 3), (5, 1)))]


def test_two_bright_neighbours_are_named_together() -> None:
    target = array()
    points = found(drawn(target, CAMERA, Z, light={(2, 3): 2.9, (2, 4): 2.5}, spread=0.1), target)
    assert [(m.kind, m.positions) for m in points.mistakes] == [("bright", ((2, 3), (2, 4)))]
    assert "neighbours" in str(points.mistakes[0])
    # their own light does not move the places of others
    assert errors(points, target).max() < 0.1


def test_dirt_ghosts_and_displaced_holes_do_not_change_labels() -> None:
    target = array(absent=MARKS)
    true = places(target, CAMERA, Z)
    ghost = tuple(np.add(true[3, 1], (0.5 * 57, 0.45 * 57)).tolist())
    frame = drawn(target, CAMERA, Z, light={(5, 5): 0.3}, ghosts=(ghost,), aside={(2, 5): (3.0, -2.0)}, spread=0.1)
    points = found(frame, target)
    named = {one.kind: one.positions for one in points.mistakes}
    assert named["dim"] == ((5, 5),) and (2, 5) in named["displaced"]
    assert set(map(tuple, points.holes.tolist())) <= set(true)
    assert len(points) >= len(true) - 4
    labelled = {tuple(h) for h in points.holes.tolist()} - {(3, 1), (3, 2), (4, 1), (4, 2), (5, 5), (2, 5)}
    true_of = dict(zip(map(tuple, points.holes.tolist()), errors(points, target), strict=True))
    assert max(true_of[h] for h in labelled) < 0.15


def test_a_turned_or_mirrored_target_is_refused_by_name() -> None:
    target = array(absent=((0, 0), (0, 1), (2, 6)))
    there = np.ones((7, 7), bool)
    there[tuple(np.transpose(target.absent))] = False
    for turn, seen in (
        ("mirrored left to right", there[:, ::-1]),
        ("mirrored top to bottom", there[::-1]),
        ("turned by 180°", there[::-1, ::-1]),
        ("turned by 90°", np.rot90(there)),
    ):
        really = replace(target, absent=tuple(map(tuple, np.argwhere(~seen).tolist())))
        with pytest.raises(InputError, match=turn):
            found(drawn(really, CAMERA, Z), target)


def test_a_pitch_wrong_by_three_percent_is_named() -> None:
    target = array(absent=MARKS)
    for share in (0.97, 1.03):
        really = array(pitch=57.0 * share, absent=MARKS)
        points = found(drawn(really, CAMERA, Z), target)
        assert kinds(points) == {"pitch"} and "3.0 %" in str(points.mistakes[0])
        assert errors(points, really).max() < 0.1
    one_axis = Target("square", (7, 7), (57.0 * PX, 57.0 * 1.03 * PX), absent=MARKS)
    said = str(found(drawn(one_axis, CAMERA, Z), target).mistakes[0])
    assert "holes in a row 3.0 %" in said and "nearer" not in said
    # a distance that may be wrong explains it
    points = found(drawn(really, CAMERA, Z), array(absent=MARKS, within=Pose(away_um=30e3)))
    assert points.fit.pose.away_um < -2e3 and errors(points, really).max() < 0.1


@pytest.mark.long
def test_an_ambiguous_labelling_is_refused() -> None:
    # more holes than the frame shows, no marks, and an unknown position
    vast = array(20, 20, within=Pose(right_um=200 * PX, down_um=200 * PX))
    with pytest.raises(InputError, match="a unique assignment"):
        found(drawn(array(20, 20), CAMERA, Z), vast)
    # known to half a pitch, the labelling is unique
    points = found(drawn(array(20, 20, pose=Pose(right_um=9 * PX)), CAMERA, Z), replace(vast, within=Pose()))
    assert len(points) > 40 and errors(points, array(20, 20, pose=Pose(right_um=9 * PX))).max() < 0.1
    # a missing first row looks like a missing last one, unless the position is known
    target = array(within=Pose(down_um=80 * PX))
    with pytest.raises(InputError, match="one way to lay"):
        found(drawn(target, CAMERA, Z, without=tuple((0, c) for c in range(7))), target)
    # three marks of which two could be missing holes are not enough, six are
    few = array(absent=MARKS, within=Pose(down_um=80 * PX))
    with pytest.raises(InputError, match="one way to lay"):
        found(drawn(few, CAMERA, Z, without=tuple((6, c) for c in range(7))), few)
    with_marks = replace(few, absent=(*MARKS, (0, 2), (2, 2), (3, 5)))
    points = found(drawn(with_marks, CAMERA, Z, without=tuple((6, c) for c in range(7))), with_marks)
    assert kinds(points) == {"missing row"}


def test_frames_without_points_and_other_lattices_are_refused() -> None:
    dark = np.full(CAMERA.sensor.shape, 64.0) + np.random.default_rng(0).normal(0, 2, CAMERA.sensor.shape)
    nearest = r"neighbours at \d+\.\d px within 15° of .*, got none; .* nearest neighbour is \d+\.\d px"
    for frame, target, what in (
        (dark, array(), "none"),
        (drawn(array(5, 5, 80.0), CAMERA, Z), array(9, 9, 48.0), nearest),
        (dark[:100], array(), "480"),
    ):
        with pytest.raises(InputError, match=what):
            found(frame, target)


def test_a_single_point_and_a_row_are_found() -> None:
    point = Target("point", pose=Pose(right_um=30 * PX, down_um=-50.4 * PX))
    points = found(drawn(point, CAMERA, Z), point)
    assert points.holes.tolist() == [[0, 0]] and errors(points, point).max() < 0.35
    row = array(1, 6, pose=Pose(rotation_rad=0.03))
    points = found(drawn(row, CAMERA, Z), replace(row, pose=Pose()))
    assert points.holes.tolist() == row.holes.tolist() and errors(points, row).max() < 0.15
