"""Recording: predicted errors of a scan and of a fit, compared with simulated frames and with fits to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks._fit_cameras import FULL, Truth, random_truth, recorded
from benchmarks.fit import measured_error
from lfcal.accuracy import PARTS, Curve, Subject, measure_curve
from lfcal.accuracy.parts import recording
from lfcal.camera import Forecast
from lfcal.fit import fit_camera
from lfcal.fit.design import next_positions
from lfcal.fit.model import Fineness, predict
from tests.fit.common import CORE, small_plan

PLAN = replace(small_plan(15, (2.2,)), frames_averaged=3)
COUNT = 15


@pytest.fixture
def curve(monkeypatch: pytest.MonkeyPatch) -> Curve:
    monkeypatch.setattr(recording, "PATTERNS", COUNT)
    return measure_curve(PARTS.get("recording"), Subject("small", PLAN, workers=1), 600.0)


def test_the_curve_has_the_whole_scan_and_a_fit_in_frames(curve: Curve) -> None:
    scans = {p.settings["frames_averaged"]: p for p in curve.points if "fitted_patterns" not in p.settings}
    fits = {p.settings["fitted_patterns"]: p for p in curve.points if "fitted_patterns" in p.settings}
    assert sorted(scans) == [1, 2, 3, 4, 8, 16, 32, 64] and max(fits) == COUNT and min(fits) >= recording.FEWEST
    assert curve.in_use is scans[3]
    assert any("do not compare it with the L1 error" in note for note in curve.notes)
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
    plan = small_plan(15, (2.2,))
    curve = measure_curve(PARTS.get("recording"), Subject("small", plan, workers=1), 600.0)
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
    fitted = next(p for p in curve.points if p.settings.get("fitted_patterns") == COUNT)
    scanned = next(p for p in curve.points if p.in_use)
    assert fitted.error / 1.4 < np.sqrt(np.mean(np.square(errors))) < 1.4 * fitted.error
    assert np.mean(noise) == pytest.approx(scanned.error, rel=0.15)


def relative_noise(truth: Truth, rng: np.random.Generator) -> float:
    """Return the rms error of patterns recorded once, relative to the light without noise."""
    measured = recorded(truth, 60, rng)
    light = predict(truth.setup, truth.plan, measured.index, np.zeros((60, 2)), Fineness.finest).astype(float)
    light *= FULL * truth.plan.camera.sensor.full_well_e / light.max()
    return float(np.sqrt(((measured.patterns - light) ** 2).sum() / (light**2).sum()))
