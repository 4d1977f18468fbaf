"""Parts that simulate: each error and cost compared with whole simulations, closed forms or fits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks._fit_cameras import FULL, Truth, random_truth, recorded
from benchmarks.fit import measured_error
from lfcal.accuracy import PARTS, Curve, Subject, iter_measure_curve, measure_curve
from lfcal.accuracy.parts import aperture, averaging, interpolation, lattice, planes, recording, simulation
from lfcal.accuracy.parts.aperture import iris_diameter_px, noisy_sum
from lfcal.accuracy.parts.averaging import EFFECTS, dark_level, expected_noise
from lfcal.accuracy.parts.sampling import QUICK
from lfcal.base import InputError
from lfcal.camera import Camera, Forecast, ScanPlan, preset
from lfcal.fit import Fineness, fit_camera, predict
from lfcal.fit.design import next_positions
from lfcal.lattice import lattice_of
from lfcal.psf import PSFMatrix
from lfcal.simulate import ladder, plan_effects, scene_for, simulate_psf
from lfcal.simulate.accuracy import steps_for
from lfcal.simulate.sensor import temporal_noise
from tests.acquire.rigs import small_plan
from tests.fit.common import CORE
from tests.fit.common import small_plan as fit_plan


def test_the_diameter_is_that_of_a_ray_trace() -> None:
    """A ray from the pupil's rim through the image point, cut with the sensor's plane behind the lenslets."""
    camera = preset("bench")
    z = camera.depth_of(4.0)
    optics = camera.optics
    focus = optics.image_distance_um + camera.image_shift_um(z)  # from the main lens to the image of the point
    array, gap = optics.image_distance_um, camera.lattice.gap_um
    rim = optics.focal_length_um / optics.f_number / 2
    at_array = rim * (1 - array / focus)
    # a chief ray passes the centre of a lenslet undeviated: the cone continues behind the array
    at_sensor = rim + (0 - rim) / focus * (array + gap)
    assert abs(at_array) > 0
    assert iris_diameter_px(camera, z) == pytest.approx(2 * abs(at_sensor) / camera.sensor.pixel_um, rel=1e-9)


def test_what_has_no_iris_says_so() -> None:
    microscope = preset("lfm_20x05")
    plan = ScanPlan.for_camera(microscope, depths_um=(-10.0, 10.0))
    assert "the iris of a main lens" in measure_curve(PARTS.get("aperture"), Subject("lfm", plan)).stopped
    with pytest.raises(InputError, match="a shadow larger than a lenslet"):
        iris_diameter_px(preset("bench"), preset("bench").depth_of(1.2))


def test_noise_of_a_sum_is_that_of_its_photons_and_frames() -> None:
    sensor = replace(preset("bench").sensor, read_noise_e=30.0)
    total = np.full((300, 300), 0.05)
    found = noisy_sum(total, 100, sensor, np.random.default_rng(0))
    electrons = 0.05 * aperture.FULL * sensor.full_well_e
    assert found.mean() == pytest.approx(electrons, rel=0.01)
    assert found.std() == pytest.approx(math.sqrt(electrons + 100 * 30.0**2), rel=0.02)


@pytest.mark.long
def test_all_positions_show_the_iris_of_the_description() -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,))
    curve = measure_curve(PARTS.get("aperture"), Subject("bench", plan), 1000)
    frames = [r.cost for r in curve.points]
    assert frames == sorted(frames) and frames[0] == 9 and frames[-1] == 33 * 19
    whole = curve.points[-1]
    assert whole.error < 0.05 and whole.others["blades found"] == 7 and whole.note == ""
    assert curve.points[0].error > whole.error, "nine positions show spots, not an iris"


@pytest.fixture(scope="module")
def averaged(plan: ScanPlan) -> Curve:
    """Return the curve of H whose pixels are all alike: each of them receives `averaging.FULL` of the well."""
    even = Subject("even", plan, PSFMatrix(np.ones(plan.shape, np.float32)))
    return measure_curve(PARTS.get("averaging"), even, 100)


def test_noise_is_that_of_photons_and_reading_over_the_root_of_the_frames(averaged: Curve, plan: ScanPlan) -> None:
    sensor = plan.camera.sensor
    own = {r.settings["frames_averaged"]: r for r in averaged.points if r.settings["exposure_s"] == [0.02] * 3}
    assert set(own) == {1, 2, 4, 8, 16, 32, 64}
    assert any("do not compare it with the rms error" in note for note in averaged.notes), "it is another measure"
    electrons = averaging.FULL * sensor.full_well_e
    # the mean absolute deviate of a normal distribution is sqrt(2/pi) of its rms
    variance = electrons + sensor.read_noise_e**2 + sensor.electrons_per_count**2 / 12
    for count, point in own.items():
        wanted = math.sqrt(2 / math.pi * variance / count) / electrons
        assert point.error == pytest.approx(wanted, rel=0.05)
        assert point.others["error by the noise model (%)"] == pytest.approx(100 * wanted, rel=1e-3)
        assert point.cost == pytest.approx(3600 * Forecast.of(replace(plan, frames_averaged=count)).hours)
    # of 4 x 0.8 full wells one is kept, and averaging does not help
    for point in (r for r in averaged.points if r.settings["exposure_s"] == [0.08] * 3):
        assert point.error == pytest.approx(1 - 1 / (4 * averaging.FULL), rel=0.01)
        assert point.note == "100 % of the pixels are saturated"


def test_the_model_holds_for_dim_and_bright_pixels_together(plan: ScanPlan) -> None:
    light = np.array([[100.0, 4000.0]], np.float32)
    gain = plan.camera.sensor.electrons_per_count
    noise = temporal_noise(EFFECTS, plan.camera)
    rng = np.random.default_rng(0)
    read = math.hypot(plan.camera.sensor.read_noise_e, gain / math.sqrt(12))
    frames = rng.poisson(light, (40_000, 1, 2)) + rng.normal(0, read, (40_000, 1, 2))
    off = np.abs(frames.reshape(10_000, 4, 1, 2).mean(axis=1) - light).mean(axis=0).sum() / light.sum()
    assert expected_noise(light, noise, gain, 4) == pytest.approx(off, rel=0.02)


def test_the_dark_level_is_what_dark_frames_show(plan: ScanPlan) -> None:
    """Rounded and cut off at zero, by the probabilities of a normal deviate."""
    values = np.arange(0, 200)
    edges = np.concatenate([[-np.inf], values[:-1] + 0.5, [np.inf]])
    for black in (0.0, 64.0):
        sensor = replace(plan.camera.sensor, black_level=black, read_noise_e=20.0)
        shares = np.diff(norm.cdf(edges, black, 20.0 / sensor.electrons_per_count))
        assert dark_level(replace(plan.camera, sensor=sensor)) == pytest.approx(float(shares @ values), abs=0.03)


@pytest.mark.long
def test_a_black_level_within_the_noise_is_noted(plan: ScanPlan) -> None:
    low = replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, black_level=0.0)))
    noted, silent = (measure_curve(PARTS.get("averaging"), Subject("p", p), 0.1).notes for p in (low, plan))
    assert "the black level of 0 is within the read noise" in noted[-1] and len(noted) == len(silent) + 1


@pytest.mark.long
def test_moved_by_whole_pixels_nothing_is_lost(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lattice, source and cutout move the same way, or the pattern would be another."""
    monkeypatch.setattr(interpolation, "SHIFTS", ((2.0, -1.0),))
    curve = measure_curve(PARTS.get("interpolation"), subject, 100)
    assert {r.label for r in curve.points} == {"nearest", "linear", "cubic", "fourier"}
    assert all(r.error < 1e-3 for r in curve.points), curve.points


@pytest.mark.long
def test_smooth_spots_are_moved_the_right_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the wrong direction, interpolation would be worse than none (twice as far off)."""
    monkeypatch.setattr(interpolation, "SHIFTS", ((0.4, 0.4),))
    plan = ScanPlan.for_camera(preset("lfm_20x05"), depths_um=(-10.0,), cutout=61)
    errors = {r.label: r.error for r in measure_curve(PARTS.get("interpolation"), Subject("lfm", plan), 100).points}
    assert 0 < errors["cubic"] < errors["linear"] < 0.85 * errors["nearest"]


def test_seconds_are_those_of_all_positions(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpolation, "SHIFTS", ((0.5, 0.5),))
    curve = measure_curve(PARTS.get("interpolation"), subject, 100)
    for point in curve.points:
        assert point.cost == pytest.approx(27 * point.others["pattern (ms)"] / 1e3)
    assert np.isfinite([r.cost for r in curve.points]).all()


@pytest.fixture
def turned() -> Camera:
    camera = preset("bench")
    array = replace(camera.lattice, rotation_rad=0.02, offset_um=(13.0, -7.0))
    return replace(camera, lattice=array, sensor=replace(camera.sensor, shape=(120, 140)))


def test_the_light_of_a_disc_lies_about_its_lenslet(turned: Camera) -> None:
    light = lattice.white_discs(turned).astype(float)
    assert light.max() == pytest.approx(1, abs=1e-3) and light.min() < 0.6
    true = lattice_of(turned)
    y, x = np.mgrid[:120, :140]
    for q, r in ((0, 0), (2, -3), (-4, 3)):
        row, column = true.centres_px(q, r)
        near = np.hypot(y - row, x - column) < turned.pitch_px / 2
        weight = light * near
        centre = (weight * y).sum() / weight.sum(), (weight * x).sum() / weight.sum()
        assert np.hypot(centre[0] - row, centre[1] - column) < 0.06, (q, r)


def test_more_lenslets_are_found_better(turned: Camera, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lattice, "SIDES", (8, 12))
    plan = ScanPlan.for_camera(turned, virtual_depths=(3.0,), cutout=21)
    curve = measure_curve(PARTS.get("lattice"), Subject("turned", plan), 100)
    assert all(0 < r.error < 0.05 for r in curve.points), curve.points
    counts = [r.others["lenslets"] for r in curve.points]
    assert len(counts) == 2 and min(counts) > 30
    assert all(r.others["pitch error (px)"] < 0.02 for r in curve.points)


@pytest.mark.long
def test_it_ends_with_the_whole_sensor(turned: Camera) -> None:
    plan = ScanPlan.for_camera(turned, virtual_depths=(3.0,), cutout=21)
    curve = measure_curve(PARTS.get("lattice"), Subject("turned", plan), 1000)
    assert curve.stopped == "" and [120, 140] in [[r.settings["rows"], r.settings["columns"]] for r in curve.points]
    assert max(r.settings["rows"] for r in curve.points) == 120


def pattern(plan: ScanPlan, depth: float) -> np.ndarray:
    one = replace(plan, depths_um=(depth,), exposure_s=0.02)
    effects = plan_effects(plan, planes.TOLERANCE)
    return simulate_psf(one, effects, tolerance=planes.TOLERANCE)[0, 1, 1].astype(float)


@pytest.mark.long
def test_the_error_of_planes_is_that_of_the_nearest_one(subject, plan, monkeypatch):
    monkeypatch.setattr(planes, "COUNTS", (2, 5))
    monkeypatch.setattr(planes, "DEPTHS", 1)
    curve = measure_curve(PARTS.get("planes"), subject, 100)
    low, high = min(plan.depths_um), max(plan.depths_um)
    depths = [low + (high - low) * ((k + 1) * 0.6180339887498949 % 1) for k in range(1)]
    assert [point.in_use for point in curve.points] == [False, True, False], "the plan has three planes"
    for point, count in zip(curve.points, (2, 3, 5), strict=True):
        steps = np.array(plan.depths_um) if count == 3 else np.linspace(low, high, count)
        near = [float(steps[np.abs(steps - depth).argmin()]) for depth in depths]
        true = [pattern(plan, depth) for depth in depths]
        off = sum(np.abs(pattern(plan, at) - one).sum() for at, one in zip(near, true, strict=True))
        # each pattern is computed to 5 % only, here and there in another way
        assert point.error == pytest.approx(off / sum(one.sum() for one in true), abs=0.06)
        assert point.cost == count * 9 and len(point.settings["depths_um"]) == count
    assert curve.points[1].error < curve.points[0].error


def test_one_plane_bounds_no_range(plan: ScanPlan) -> None:
    one = replace(plan, depths_um=plan.depths_um[:1], exposure_s=0.02)
    curve = measure_curve(PARTS.get("planes"), Subject("one", one))
    expected = "depth planes: expected at least two planes, as the ends of the depth range, got one; add a plane"
    assert not curve.points and curve.stopped == expected


PLAN = replace(fit_plan(15, (2.2,)), frames_averaged=3)
COUNT = 15


@pytest.fixture
def recorded_curve(monkeypatch: pytest.MonkeyPatch) -> Curve:
    monkeypatch.setattr(recording, "PATTERNS", COUNT)
    return measure_curve(PARTS.get("recording"), Subject("small", PLAN, workers=1), 600.0)


def test_the_curve_has_the_whole_scan_and_a_fit_in_frames(recorded_curve: Curve) -> None:
    scans = {p.settings["frames_averaged"]: p for p in recorded_curve.points if "fitted_patterns" not in p.settings}
    fits = {p.settings["fitted_patterns"]: p for p in recorded_curve.points if "fitted_patterns" in p.settings}
    assert sorted(scans) == [1, 2, 3, 4, 8, 16, 32, 64] and max(fits) == COUNT and min(fits) >= recording.FEWEST
    assert recorded_curve.in_use is scans[3]
    assert any("do not compare it with the L1 error" in note for note in recorded_curve.notes)
    for count, point in scans.items():
        assert point.cost == PLAN.n_positions * count == Forecast.of(replace(PLAN, frames_averaged=count)).frames
        # photon and read noise average out
        assert point.error == pytest.approx(scans[1].error / count**0.5, rel=0.05)
    for count, point in fits.items():
        assert point.cost == 3 * count and point.label == f"{count} patterns and a fit"
    # a few per cent of the scan and a fit compare with many times the frames
    assert fits[COUNT].error < scans[3].error and fits[COUNT].efficient and not scans[64].error < fits[COUNT].error / 4
    assert "% of the scan" in fits[COUNT].note


@pytest.mark.long
def test_both_predictions_agree_with_simulated_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    """The noise of simulated patterns, and the true error of H from fits to the designed positions."""
    monkeypatch.setattr(recording, "PATTERNS", COUNT)
    plan = fit_plan(15, (2.2,))
    recorded_curve = measure_curve(PARTS.get("recording"), Subject("small", plan, workers=1), 600.0)
    design = next_positions(plan, COUNT, expected=recording.EXPECTED, candidates=recording.CANDIDATES, workers=1)
    aside = np.arange(COUNT) >= len(design.fitted)
    errors, noise = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        truth = random_truth(plan, rng, size=0.0)
        measured = recorded(truth, COUNT, rng, stage_px=recording.EXPECTED.stage_px, index=design.positions)
        fit = fit_camera(replace(measured, held_out=aside), unknowns=CORE, workers=1)
        errors.append(measured_error(fit, truth, 40)["error_l2"])
        noise.append(relative_noise(truth, rng))
    fitted = next(p for p in recorded_curve.points if p.settings.get("fitted_patterns") == COUNT)
    scanned = next(p for p in recorded_curve.points if p.in_use)
    assert fitted.error / 1.4 < np.sqrt(np.mean(np.square(errors))) < 1.4 * fitted.error
    assert np.mean(noise) == pytest.approx(scanned.error, rel=0.15)


def relative_noise(truth: Truth, rng: np.random.Generator) -> float:
    """Return the rms error of patterns recorded once, relative to the light without noise."""
    measured = recorded(truth, 60, rng)
    light = predict(truth.setup, truth.plan, measured.index, np.zeros((60, 2)), Fineness.finest).astype(float)
    light *= FULL * truth.plan.camera.sensor.full_well_e / light.max()
    return float(np.sqrt(((measured.patterns - light) ** 2).sum() / (light**2).sum()))


@pytest.fixture
def single() -> Subject:
    """Return a plan of one position, so that the positions compared are all of H."""
    return Subject("one", small_plan((1, 1), 1), workers=1)


@pytest.mark.long
def test_a_point_errs_as_the_h_that_its_tolerance_gives(single: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "TOLERANCES", (0.3, 0.06))
    curve = measure_curve(PARTS.get("simulation"), single, 100)
    plan = single.planned
    assert [r.settings["tolerance"] for r in sorted(curve.points, key=lambda r: -r.error)] == [0.3, 0.06]
    finest = plan_effects(plan, simulation.FINEST)
    true = simulate_psf(plan, finest, "reference", tolerance=simulation.FINEST)[0].astype(float)
    for point in curve.points:
        tolerance = point.settings["tolerance"]
        assert 0 < point.error < tolerance and point.cost > 0
        H = simulate_psf(plan, tolerance=tolerance)[0]
        assert point.error == pytest.approx(np.abs(H - true).sum() / true.sum(), rel=0.02)
        assert point.settings["effects"] == [e.name for e in plan_effects(plan, tolerance).effects]


def test_closed_after_the_first_point_it_is_kept(single: Subject) -> None:
    work = iter_measure_curve(PARTS.get("simulation"), single, 10)
    record = next(r for r in work if r.curve.points)
    work.close()
    assert len(record.curve.points) == 1 and "reference" in record.curve.truth


@pytest.mark.long
def test_samplings_are_those_of_the_ladder(single: Subject) -> None:
    plan = single.planned
    work = iter_measure_curve(PARTS.get("sampling"), single, 50.0)
    curve = next(record.curve for record in work if len(record.curve.points) == 3)
    work.close()
    effects = plan_effects(plan, 0.03).effects
    two = [s.sampling for s in steps_for(scene_for(plan, 0, effects), "wave")][:2]
    found = ladder(plan, effects=effects, positions=1, samplings=two, reference=QUICK)
    errors = {r.label: r.error for r in found.rungs}
    assert {r.label: r.error for r in curve.points} == {r.label: errors[r.label] for r in curve.points}
    assert set(errors) == {r.label for r in curve.points} and curve.truth == found.reference
