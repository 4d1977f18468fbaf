"""Demultiplexing filters: the error of each, worked out beside it, and the sensor's own pattern."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts import filters
from lfcal.camera import ScanPlan
from lfcal.multiplex.scenes import zone_plate


def test_nearest_errs_as_written_out(plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    """The nearest red sample is that of the 2 x 2 cell, of green the mean of its two: by hand on the inner part."""
    monkeypatch.setattr(filters, "SIDE", 64)
    coloured = replace(plan.camera, sensor=replace(plan.camera.sensor, cfa="RGGB"))
    curve = measure_curve(PARTS.get("filters"), Subject("rggb", replace(plan, camera=coloured)), 100)
    assert "the sensor's RGGB pattern" in curve.notes[0]
    errors = {r.settings["filter"] if r.settings["route"] == "spatial" else "fourier": r.error for r in curve.points}
    assert errors["cubic"] < errors["linear"] < errors["nearest"]
    scene = zone_plate((64, 64), filters.HIGHEST)
    level = filters.FULL * coloured.sensor.full_well_e
    rms = math.sqrt(level / 2 + coloured.sensor.read_noise_e**2) / level
    noise = rms * np.random.default_rng(0).standard_normal((64, 64))
    seen = np.empty((3, 64, 64))
    for row in range(0, 64, 2):
        for column in range(0, 64, 2):
            cell = noise[row : row + 2, column : column + 2]
            light = scene[:, row : row + 2, column : column + 2]
            green = (light[1, 0, 1] + cell[0, 1] + light[1, 1, 0] + cell[1, 0]) / 2
            colours = light[0, 0, 0] + cell[0, 0], green, light[2, 1, 1] + cell[1, 1]
            seen[:, row : row + 2, column : column + 2] = np.array(colours)[:, None, None]
    inner = (slice(None), slice(8, -8), slice(8, -8))
    wanted = math.sqrt(np.mean((seen - scene)[inner] ** 2)) / np.ptp(scene)
    assert errors["nearest"] == pytest.approx(wanted, rel=0.15)


def test_a_sensor_without_filters_is_compared_with_bayer(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filters, "SIDE", 64)
    monkeypatch.setattr(filters, "WAYS", (("spatial", "linear"),))
    curve = measure_curve(PARTS.get("filters"), subject, 100)
    assert curve.notes[0].startswith("a Bayer pattern, because the sensor has no filters; noise")
    assert curve.points[0].settings == {"route": "spatial", "filter": "linear", "pattern": "Bayer"}
