"""Points of a target: their places, brightness and noise, and the positions of a scan that they show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import Finding
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.campaign.point_assembly import PointFrames, iter_assemble_points, shown_positions, target_facts
from lfcal.campaign.points import Points, measured_modulo, measured_points, points_of, tiles_of
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view
from lfcal.frames.source import FrameSource
from lfcal.multiplex import s_matrix
from lfcal.psf import AssemblySettings, PSFMatrix
from lfcal.psf.picked import iter_pick
from lfcal.simulate.effects import Quantisation, ReadNoise, ShotNoise
from lfcal.targets import Display, TargetCamera, TargetPlan, Wishes, coded_plan, decoded, iter_plan_display
from lfcal.targets.frames import TargetFrames
from lfcal.targets.phases import Phases
from lfcal.targets.sampling import coarsest_pixel_um, may_resample, resampling_words
from tests.campaign.points import SCAN, array_of, frames_of_drawn, moved, plan_of, view_of
from tests.targets.common import scan_of, small
from tests.targets.drawn import places

OFFSETS = [(0.0, 0.0), (3.0, -2.0), (0.0, 0.0)]


@pytest.fixture(scope="module")
def view() -> FrameSource:
    plan = plan_of(OFFSETS)
    return view_of(plan, frames_of_drawn(plan, spread=0.0, light={(2, 2): 1.4}))


@pytest.fixture(scope="module")
def points(view: FrameSource) -> Points:
    return points_of(view, plan_of(OFFSETS))


def test_points_have_the_places_they_were_drawn_at(points: Points) -> None:
    for k, offset in enumerate(OFFSETS):
        true = places(moved(array_of(), offset), SCAN.camera, SCAN.depths_um[0])
        own = points.frame == k
        away = [
            np.subtract(at, true[tuple(h)])
            for h, at in zip(points.holes[own].tolist(), points.pixels[own], strict=True)
        ]
        assert own.sum() >= 18 and np.abs(away).max() < 0.1
    assert np.abs(points.residuals).max() <= 0.5
    bright = points.brightness[(points.holes == 2).all(1)]
    assert bright == pytest.approx(1.4, rel=0.03)


def test_patterns_of_parts_lie_at_their_pixels(view: FrameSource, points: Points) -> None:
    measured = measured_points(view, points, (2, 2))
    # the first and third frame show the same: repeats are one pattern
    assert len(measured) <= len(points) - 0.8 * (points.frame == 2).sum()
    for plan, own, _ in measured.parts():
        for k in own.tolist():
            place = np.array(plan.anchor) + measured.index[k, 1:] + measured.places_px[k]
            nearest = np.linalg.norm(points.pixels - place, axis=1)
            assert nearest.min() < 0.05
            j = int(nearest.argmin())
            raw = view.samples(int(points.frame[j]), points.region(j)).values / points.brightness[j]
            assert np.corrcoef(measured.patterns[k].ravel(), raw.ravel())[0, 1] > 0.98
    assert set(measured.region.tolist()) == {0, 1, 2, 3}
    assert 0 < measured.held_out.sum() < len(measured) / 3


def test_noise_is_that_of_averaged_repeats_and_of_equalised_brightness(view: FrameSource, points: Points) -> None:
    once = measured_points(view, points.only(points.frame < 2), (1, 1))
    twice = measured_points(view, points, (1, 1))
    assert (twice.noise[:, 0] < 0.6 * np.median(once.noise[:, 0])).sum() >= 18, "the variance of a mean of two"
    measured = measured_points(view, points.only(points.frame == 0), (1, 1))
    totals = measured.patterns.sum((1, 2))
    assert totals.std() / totals.mean() < 0.05
    assert measured.noise[:, 1].min() == pytest.approx(np.median(measured.noise[:, 1]) / 1.4, rel=0.05)


def test_pixels_that_neighbours_reach_are_not_used(view: FrameSource, points: Points) -> None:
    wide = replace(points, plan=replace(points.plan, scan=replace(SCAN, cutout=(81, 81))))
    k = int(np.flatnonzero((wide.holes == 2).all(1))[0])
    alone = wide.alone(k)
    assert alone[40, 40] and not alone[40, 0] and not alone[0, 40] and alone.mean() < 0.92
    assert points.alone(k).all()


def test_points_are_spread_over_the_parts(view: FrameSource, points: Points) -> None:
    measured = measured_points(view, points, (2, 2), most=12)
    assert np.bincount(measured.region).tolist() == [3, 3, 3, 3]
    assert np.array_equal(measured.index, measured_points(view, points, (2, 2), most=12).index)
    with pytest.raises(InputError, match="number of points to fit"):
        measured_points(view, points, most=1)
    counts = np.zeros((100, 90), int)
    for rows, columns in tiles_of((100, 90), (21, 31), (3, 2)):
        counts[rows, columns] += 1
    assert (counts[10:90, 15:75] == 1).all() and counts.sum() == 80 * 60, "each whole cutout is in one part"
    measured = measured_modulo(view, points)
    assert measured.plan == SCAN and not measured.places_px.any()
    assert (measured.index[:, 1:] < np.array(SCAN.period)).all()


def test_single_frames_of_points_are_positions_of_the_scan(view: FrameSource, points: Points) -> None:
    index, off = shown_positions(points, 0.5)
    phases = Phases.of(SCAN)
    wanted, own = phases.wanted(), phases.at(points.pixels)
    for k in range(len(points)):
        away = own[k] - wanted
        away -= phases.period * np.round(away / phases.period)
        nearest = int(np.abs(away).max(1).argmin())
        if index[k, 0] >= 0:
            assert np.ravel_multi_index(tuple(index[k, 1:]), SCAN.period) == nearest
    assert np.abs(off[(index >= 0).all(1)]).max() <= 0.5
    single = PointFrames(view, points, 0.5)
    assert len(single) + single.unused == len(points) and len(single) > 5
    for k in (0, len(single) - 1):
        info = single.info(k)
        # the position's cutout is the point's
        row, column = (np.floor(np.array(SCAN.anchor) + 0.5).astype(int) + info.position[1:]).tolist()
        own_row, own_column = single.points.middles[k].tolist()
        assert (row - info.origin[0], column - info.origin[1]) == (own_row, own_column)
        assert max(map(abs, info.drift)) <= 0.5
    strict = shown_positions(points, 0.1)[0]
    assert ((strict >= 0).all(1)).sum() < len(single)


def test_patterns_are_moved_by_parts_of_a_pixel_only_where_the_pixels_hold_them() -> None:
    plan = plan_of([(0.3, 0.4)])
    view = view_of(plan, frames_of_drawn(plan))
    points = points_of(view, plan)
    assert not may_resample(SCAN.camera) and not PointFrames(view, points, 0.5).resampled
    assert "pixels of 5.5 µm are too coarse" in resampling_words(SCAN)
    index, _ = shown_positions(points, 0.3)
    more, aside = shown_positions(points, 0.3, resampled=True)
    assert ((more >= 0).all(1) | (index < 0).any(1)).all() and (more >= 0).sum() >= (index >= 0).sum() > 0
    wanted = points.pixels - np.array(SCAN.anchor)
    np.testing.assert_allclose(aside, wanted - np.round(wanted), atol=1e-9)
    single = PointFrames(view, points, 0.3, resampled=True)
    assert single.info(0).drift == pytest.approx(tuple(aside[(more >= 0).all(1)][0]))
    fine = replace(SCAN.camera, sensor=replace(SCAN.camera.sensor, pixel_um=1.0))
    assert may_resample(fine) and coarsest_pixel_um(fine) == pytest.approx(
        fine.wavelength_um * fine.lattice.gap_um / fine.lattice.pitch_um / 2
    )


def test_points_are_assembled_as_positions(view: FrameSource, points: Points) -> None:
    single = PointFrames(view, points, 0.5)
    index = np.unique([single.info(k).position for k in range(len(single))], axis=0)
    H = drain(iter_pick(single, SCAN, index))
    assert int((H.recorded > 0).sum()) == len(index) and int(H.recorded.sum()) == len(single)
    twice = np.argwhere(H.recorded == 2)
    assert len(twice) > 5
    z, y, x = twice[0].tolist()
    own = [k for k in range(len(single)) if tuple(single.info(k).position) == (z, y, x)]
    cuts = [single.samples(k, single.points.region(k)).values for k in own]
    assert np.asarray(H[z, y, x]) == pytest.approx(np.mean(cuts, axis=0), abs=0.1 * float(np.max(cuts)))
    with pytest.raises(InputError, match="none of"):
        PointFrames(view, points, 1e-6)


def test_faults_of_a_target_and_its_stage_are_found_in_its_frames(points: Points) -> None:
    plan = plan_of(OFFSETS[:2])
    gone = tuple((2, c) for c in range(5))
    bad = points_of(view_of(plan, frames_of_drawn(plan, without=gone, light={(4, 3): 3.0, (4, 4): 2.5})), plan)
    said = {one.kind: count for one, count in bad.mistakes}
    assert said["missing row"] == 2 and said["bright"] >= 1
    facts = target_facts(bad)
    assert facts["missing"] == 5 and facts["points"] == len(bad)
    assert facts["crosstalk"] == pytest.approx(0.004 * 3.0, rel=0.1)
    assert facts["stage_px"] < 0.1 and facts["pose_rms_px"] < 0.3 and facts["doubtful"] < 0.2
    plan, really = plan_of([(0.0, 0.0), (6.0, 6.0)]), plan_of([(0.0, 0.0), (4.0, 6.0)])
    moving = points_of(view_of(plan, frames_of_drawn(really)), plan)
    assert target_facts(moving)["stage_px"] == pytest.approx(1.0, abs=0.1)
    # what most frames show is first
    once, often = (
        Finding(kind=kind, what=kind, positions=(hole,)) for kind, hole in (("missing", (1, 1)), ("bright", (2, 2)))
    )
    a, b, *_ = points.found
    seen = {a: replace(points.found[a], mistakes=(once, often)), b: replace(points.found[b], mistakes=(often,))}
    assert replace(points, found=seen).mistakes == ((often, 2), (once, 1))


def test_frames_of_another_plan_are_refused() -> None:
    plan = plan_of(OFFSETS[:2])
    frames = frames_of_drawn(plan)
    dark = np.stack([frames[0], 64 + (np.arange(360 * 360) % 3).astype(np.uint16).reshape(360, 360)])
    for other, seen, words in (
        (plan_of(OFFSETS), frames, "as in the plan"),
        (plan, frames[:, :300], "whole sensor"),
        (plan, dark, r"^frames\[1\]: points of light"),
    ):
        with pytest.raises(InputError, match=words):
            points_of(view_of(other, seen), plan)


# -- frames that show several subsets of a display's points at once --------------------------------------
SMALL, PEAK = scan_of(small(160)), 0.01
"""200 electrons in a point's brightest pixel, 8 of read noise."""


def decoded_view(plan: TargetPlan, frames: np.ndarray) -> FrameSource:
    source = ArraySource(frames, [(0, 0, k) for k in range(len(frames))])
    level = CorrectionRecipe(black_level=float(SMALL.camera.sensor.black_level))
    return decoded(corrected_view(TargetFrames(source, plan), level, plan.scan), plan)


@pytest.mark.long
def test_at_low_light_h_of_sums_is_better_at_equal_time(tmp_path: Path) -> None:
    plan = drain(iter_plan_display(SMALL, Display((2000, 2000), 5.0), Wishes(0.3, 0.02, 7)))
    coded = coded_plan(plan, s_matrix(7), 5.0)
    noise = (ShotNoise(), ReadNoise(), Quantisation())
    camera, other = (TargetCamera(plan, noise, level="geometric", peak=PEAK, seed=seed) for seed in (0, 1))
    lights = drain(camera.iter_lights(workers=1))
    sums = [sum(lights[m] for m in lit) for lit in coded.lit[0]]
    sensor = SMALL.camera.sensor
    recorded = {
        "one": (plan, np.stack([camera.exposed(light, k) for k, light in enumerate(lights)])),
        "many": (coded, np.stack([other.exposed(light, k) for k, light in enumerate(sums)])),
        "true": (plan, (lights / sensor.electrons_per_count + sensor.black_level).astype(np.float32)),
    }
    assert recorded["one"][1].shape == recorded["many"][1].shape, "as many frames, of the same exposure"
    found: dict[str, PSFMatrix] = {}
    for name, (own, frames) in recorded.items():
        settings = AssemblySettings(strict=False)
        work = iter_assemble_points(decoded_view(own, frames), own, tmp_path / f"{name}.h5", settings)
        found[name] = drain(work).report.matrix
    both = np.argwhere(np.logical_and.reduce([np.asarray(one.recorded) > 0 for one in found.values()]))
    assert len(both) > 15
    one, many, true = (np.stack([np.asarray(H[tuple(at)]) for at in both.tolist()]) for H in found.values())

    def error(patterns: np.ndarray) -> float:
        gain = float((patterns * true).sum() / np.square(patterns).sum())
        return float(np.sqrt(np.square(gain * patterns - true).mean() / np.square(true).mean()))

    assert error(many) < 0.85 * error(one)
    # and what is stated of the noise of a pattern is what it has
    stated = []
    for own, frames in (recorded["one"], recorded["many"]):
        view = decoded_view(own, frames)
        stated.append(measured_points(view, points_of(view, own), (1, 1)).noise[:, 0].mean())
    assert stated[1] < stated[0]
