"""Lattice fit: micro-images lie where the camera says, and the fit finds them better the more there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts import lattice
from lfcal.camera import Camera, ScanPlan, preset
from lfcal.lattice import lattice_of


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
