"""Offsets that show all phases: recounted by brute force, against random offsets and the least number there can be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.targets import Pose, Target
from lfcal.targets import offsets as covering
from lfcal.targets.images import hole_images
from lfcal.targets.offsets import Covering, covered_by, iter_cover, line_offsets
from lfcal.targets.phases import Phases
from tests.targets.common import distorted, scan_of, small, turned

TOLERANCE = 0.1


def target_of(
    scan: ScanPlan, pitch_px: tuple[float, float], shape: tuple[int, int], pose: Pose | None = None
) -> Target:
    step = scan.camera.step_um(scan.depths_um[0])
    return Target("square", shape, (pitch_px[0] * step, pitch_px[1] * step), pose=pose or Pose())


def covering_of(scan: ScanPlan, target: Target, tolerance: float = TOLERANCE, most: int | None = None) -> Covering:
    images = hole_images(target, scan.camera, scan.depths_um[0])
    return drain(iter_cover(Phases.of(scan), images, tolerance, most=most))


def recounted(scan: ScanPlan, target: Target, offsets: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
    """Return which positions frames show ``(ny, nx)``, one position and one lenslet at a time.

    Every hole's image is compared with the positions of every cell: places of lenslets are asked of the lattice alone.
    """
    camera, lattice = scan.camera, scan.camera.lattice
    step = camera.step_um(scan.depths_um[0])
    shown = np.zeros(scan.period, np.bool_)
    # positions of the scan in lattice indices, and what a whole period is there
    rows, columns = np.indices(scan.period)
    places = np.stack([scan.anchor[0] + rows, scan.anchor[1] + columns], axis=-1)
    index = lattice.lenslet_at(camera.sensor_um(places)).reshape(-1, 2)
    pixel = lattice.basis_um() / camera.sensor.pixel_um
    for dy, dx in offsets:
        pose = replace(target.pose, down_um=target.pose.down_um + dy * step, right_um=target.pose.right_um + dx * step)
        images = hole_images(replace(target, pose=pose), camera, scan.depths_um[0])
        on = images.whole(camera.sensor.shape, scan.cutout)
        for seen in lattice.lenslet_at(camera.sensor_um(images.pixels[on])):
            q, r = (seen - index).T
            # whole periods away: rows in twos, each two a lenslet back; lenslets in threes
            turns = np.round(r / 2)
            q, r = q + turns, r - 2 * turns
            q -= 3 * np.round((q + r / 2) / 3)
            off = np.abs(np.stack([q, r], axis=-1) @ pixel)
            shown.flat[(off <= tolerance + 1e-6).all(axis=1)] = True
    return shown


CASES = {
    "vernier": (small(), (3 * 12.124 - 2, 41.0), (6, 6), Pose()),
    "any pitch": (small(), (41.37, 38.9), (6, 6), Pose()),
    "tilted target": (small(), (40.0, 40.0), (6, 6), Pose(0.01, math.radians(2), math.radians(-1))),
    "larger than the sensor": (small(), (40.0, 40.0), (9, 9), Pose(rotation_rad=0.02)),
    "turned array": (turned(small(), 0.01), (40.3, 40.0), (6, 6), Pose()),
}


@pytest.mark.parametrize("name", CASES)
def test_every_phase_is_shown(name: str) -> None:
    camera, pitch, shape, pose = CASES[name]
    scan = scan_of(camera)
    target = target_of(scan, pitch, shape, pose)
    found = covering_of(scan, target)
    assert found.coverage == 1.0 and found.shown.sum() == found.wanted == 252
    # a lattice that is turned has its rows off the axes: tolerances along them differ by that angle
    assert recounted(scan, target, found.offsets_px, TOLERANCE * 1.02).all()
    assert not recounted(scan, target, found.offsets_px[1:], TOLERANCE).all(), "each frame shows something"


def test_a_distorted_array_is_covered() -> None:
    scan = scan_of(distorted(small()))
    target = target_of(scan, (40.0, 40.0), (6, 6), Pose(rotation_rad=0.01))
    found = covering_of(scan, target)
    assert found.coverage == 1.0
    phases, images = Phases.of(scan), hole_images(target, scan.camera, scan.depths_um[0])
    shown = np.unique(np.concatenate([covered_by(phases, images, o, TOLERANCE) for o in found.offsets_px]))
    assert len(shown) == 252
    # offsets that take the array for straight leave phases out
    straight = covering_of(scan_of(small()), target)
    missed = np.unique(np.concatenate([covered_by(phases, images, o, TOLERANCE) for o in straight.offsets_px]))
    assert len(missed) < 0.9 * 252


def random_frames(scan: ScanPlan, target: Target, share: float, seed: int, most: int) -> int:
    """Return how many frames at random offsets show a share of all phases."""
    phases, rng = Phases.of(scan), np.random.default_rng(seed)
    images = hole_images(target, scan.camera, scan.depths_um[0])
    shown = np.zeros(phases.count, np.bool_)
    for k in range(most):
        shown[covered_by(phases, images, (rng.random(2) - 0.5) * phases.period, TOLERANCE)] = True
        if shown.mean() >= share:
            return k + 1
    return most


def test_random_offsets_need_many_times_the_frames() -> None:
    scan = scan_of(small())
    for pitch, factor in (((3 * 12.12436 - 2, 39.0), 25), ((41.37, 38.9), 6)):
        target = target_of(scan, pitch, (6, 6))
        most = factor * len(covering_of(scan, target).shown)
        for seed in (1, 2):
            assert random_frames(scan, target, 1.0, seed, most) == most, "complete with fewer frames"


def test_the_number_of_frames_by_pitch_and_tolerance() -> None:
    scan = scan_of(small())
    # 42 holes: at least 6 frames; six rows 2 apart tile 12, seven columns 3 apart tile 21
    found = covering_of(scan, target_of(scan, (3 * 12.12436 - 2, 39.0), (6, 7)))
    assert found.coverage == 1 and found.shown.tolist() == [42] * 6
    other = target_of(scan, (41.37, 38.9), (6, 6))
    found = [covering_of(scan, other, tolerance) for tolerance in (0.1, 0.25, 0.5)]
    frames = [len(one.shown) for one in found]
    assert found[0].coverage == 1 and frames == sorted(frames, reverse=True)
    assert frames[0] > 3 * 6 and frames[0] > 2 * frames[-1]
    # a single point needs a frame for each position, and holes on one phase count once
    assert covering_of(scan, Target()).shown.tolist() == [1] * 252
    assert covering_of(scan, target_of(scan, (3 * 12.12435565, 42.0), (5, 5)), most=9).shown.tolist() == [1] * 9
    for tolerance in (0.0, 0.001, 0.6, math.nan):
        with pytest.raises(InputError, match="tolerance"):
            covering_of(scan, Target(), tolerance)


def test_two_points_show_every_phase() -> None:
    scan = scan_of(small())
    # half a period apart in columns: the phases of one hole end where offsets end
    for rotation in (0.0, 0.3):
        found = covering_of(scan, target_of(scan, (40.0, 42.0 + 10.5), (1, 2), Pose(rotation_rad=rotation)))
        assert found.coverage == 1.0 and len(found.shown) <= 252, rotation


def test_separable_rows_and_columns_need_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(covering, "_greedy", None)
    scan = scan_of(small())
    assert covering_of(scan, target_of(scan, (3 * 12.12436 - 2, 39.0), (6, 7))).coverage == 1
    with pytest.raises(TypeError):
        covering_of(scan, target_of(scan, (40.0, 40.0), (6, 6), Pose(rotation_rad=math.radians(1))))


def test_the_shorter_of_two_equal_coverings_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = scan_of(small())
    target = target_of(scan, (40.0, 40.0), (6, 6), Pose(rotation_rad=math.radians(1)))
    searched = covering_of(scan, target)
    assert searched.coverage == 1.0 and (searched.shown > 1).any()
    one_each = Covering(np.zeros((searched.wanted, 2)), np.ones(searched.wanted, np.intp), searched.wanted)
    monkeypatch.setattr(covering, "_product", lambda *_: one_each.offsets_px)
    monkeypatch.setattr(covering, "_counted", lambda *_: one_each)
    assert covering_of(scan, target).shown.tolist() == searched.shown.tolist()


def test_frames_can_be_limited_and_the_first_show_most() -> None:
    scan = scan_of(small())
    target = target_of(scan, (41.37, 38.9), (6, 6), Pose(rotation_rad=0.01))
    whole, part = covering_of(scan, target), covering_of(scan, target, most=10)
    assert len(part.shown) == 10 and part.coverage < 1
    assert part.offsets_px.tolist() == whole.offsets_px[:10].tolist()
    assert (np.diff(whole.shown[:10]) <= 2).all() and part.coverage > 10 / len(whole.shown)


def test_offsets_along_a_line() -> None:
    for places, count, period, frames in (
        (np.arange(0, 54, 2.0), 55, 55.0, 3),
        # of two points half a pixel apart one is of use
        ([0.0, 5.5], 11, 11.0, 11),
        ([0.0, 5.0], 11, 11.0, 6),
        ([0.0], 5, 5.3, 5),
    ):
        offsets, whole = line_offsets(np.array(places), count, period, 0.1)
        assert whole and len(offsets) == frames, places
