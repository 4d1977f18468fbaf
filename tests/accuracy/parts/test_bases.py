"""Multiplexing bases: the noise of a recovered sample by hand, where the modulator is simple, and by equation 12."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts.bases import FULL, sample_noise
from lfcal.camera import Sensor
from lfcal.multiplex import amplification, mask, transmission

SENSOR = Sensor(read_noise_e=10.0, full_well_e=20e3)


def noise(kind: str, electrons: float) -> float:
    modulator = mask(kind, 5)
    return sample_noise(modulator, modulator.inverse(), electrons, SENSOR, np.random.default_rng(0))


@pytest.mark.parametrize("electrons", [50.0, 16e3])
def test_pinhole_and_lenslet_by_hand(electrons: float) -> None:
    n = 25
    # behind a pinhole a pixel has a share 1/n of the light, behind a lenslet as much as without one
    assert noise("pinhole", electrons) == pytest.approx(n / electrons * math.sqrt(electrons / n + 100), rel=0.02)
    assert noise("lenslet", electrons) == pytest.approx(math.sqrt(electrons + 100) / electrons, rel=0.02)


@pytest.mark.parametrize("kind", ["MURA", "sum_of_sinusoids"])
def test_masks_by_the_papers_equation(kind: str) -> None:
    modulator, electrons = mask(kind, 5), 16e3
    variance = (transmission(modulator) * electrons + 100) / electrons**2
    assert noise(kind, electrons) == pytest.approx(25 * amplification(modulator) * math.sqrt(variance), rel=0.05)


def test_longer_exposures_are_better_for_every_mask(subject: Subject) -> None:
    curve = measure_curve(PARTS.get("bases"), subject, 100)
    sensor = subject.planned.camera.sensor
    assert f"{FULL:.0%}".replace("%", " %") in curve.notes[1]
    for kind in ("pinhole", "lenslet", "MURA", "sum_of_sinusoids"):
        points = [r for r in curve.points if r.settings["mask"] == kind]
        assert len(points) == 4 and [r.cost for r in points] == pytest.approx([0.02 / 64, 0.02 / 16, 0.005, 0.02])
        assert [r.error for r in points] == sorted((r.error for r in points), reverse=True)
    lenslet = next(r for r in curve.points if r.label == "lenslet, 20 ms")
    electrons = FULL * sensor.full_well_e
    assert lenslet.error == pytest.approx(math.sqrt(electrons + sensor.read_noise_e**2) / electrons, rel=0.02)
