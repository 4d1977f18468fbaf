"""Parts that process patterns and images: storage, projection, solvers, filters and bases."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Curve, Subject, iter_measure_curve, measure_curve
from lfcal.accuracy.parts import filters, projection, solvers
from lfcal.accuracy.parts.bases import FULL, sample_noise
from lfcal.accuracy.parts.projection import PointByPoint
from lfcal.accuracy.parts.storage import HALF
from lfcal.camera import ScanPlan, Sensor
from lfcal.multiplex import amplification, mask, transmission, zone_plate
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import SOLVERS, phantom
from tests.reconstruct.oracles import dense, lenslet_psf


def test_errors_are_those_of_rounding_and_bytes_those_of_the_samples() -> None:
    values = (np.random.default_rng(3).random((1, 4, 5, 9, 11)) ** 4).astype(np.float32)
    curve = measure_curve(PARTS.get("storage"), Subject.of_matrix(PSFMatrix(values), "H"), 100)
    assert curve.stopped == ""
    by = {(r.settings["dtype"], r.settings["compression"]): r for r in curve.points}
    true = values.astype(np.float64)
    step = 2.0 ** np.floor(np.log2(true.max() / 65535))
    off = np.abs(np.round(true / step) * step - true).sum() / true.sum()
    assert by["rounded", "gzip"].error == pytest.approx(off, rel=2e-3)
    assert by["rounded", "gzip"].cost < 0.8 * by["float32", "gzip"].cost
    assert by["float32", "gzip"].error == by["float64", "zstd"].error == 0
    for dtype, size in (("rounded", 4), ("float32", 4), ("float64", 8)):
        assert by[dtype, "none"].cost == size * values.size, "all patterns are in the sample"
        assert by[dtype, "gzip"].cost < by[dtype, "none"].cost * 1.1
    # eleven bits of digits: between half and none of the last one is lost
    assert 2**-14 < by["float16", "gzip"].error < 2**-11 and by["float16", "gzip"].note == HALF
    assert {r.unit for r in curve.points} == {"bytes"} and curve.best is not None and curve.best.error == 0


def test_bytes_are_scaled_to_the_whole_h() -> None:
    H = PSFMatrix(np.ones((2, 30, 40, 3, 3), np.float32))
    curve = measure_curve(PARTS.get("storage"), Subject.of_matrix(H, "H"), 100)
    assert next(r for r in curve.points if r.label == "float32, none").cost == 4 * H.size


def test_point_by_point_is_the_operator() -> None:
    rng = np.random.default_rng(0)
    H, shape, anchor = rng.random((2, 3, 4, 5, 7)), (11, 13), (2, 5)
    matrix = dense(H, shape, anchor)
    points = PointByPoint(PSFMatrix(H), anchor, shape)
    voxels = [(0, 0, 0), (1, 10, 12), (0, 5, 6), (1, 4, 1)]
    values = rng.random(4)
    volume = np.zeros((2, *shape))
    volume[tuple(np.array(voxels).T)] = values
    np.testing.assert_allclose(points.forward(voxels, values).ravel(), matrix @ volume.ravel(), rtol=1e-12)
    image = rng.random(shape)
    back = (matrix.T @ image.ravel()).reshape(volume.shape)
    np.testing.assert_allclose(points.adjoint(voxels, image), back[tuple(np.array(voxels).T)], rtol=1e-12)


@pytest.mark.long
def test_precision_is_that_of_its_type_and_thresholds_cost_accuracy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection, "SIDE", 40)
    H = PSFMatrix(lenslet_psf(1, cutout=21).astype(np.float32), anchor=(1.0, 3.0))
    curve = measure_curve(PARTS.get("projection"), Subject.of_matrix(H, "H", 1), 1000)
    exact = [r for r in curve.points if not r.settings["threshold"]]
    # sums over some hundreds of entries
    assert all(r.error < (1e-12 if r.settings["double"] else 1e-4) for r in exact) and len(exact) >= 4
    assert {r.settings["method"] for r in exact} == {"polyphase", "direct", "sparse"} and curve.stopped == ""
    cut = {r.settings["threshold"]: r.error for r in curve.points if r.settings["method"] == "sparse"}
    assert cut[0.0] < cut[1e-4] <= cut[1e-3] < cut[1e-2] < cut[5e-2] < 0.3


def test_an_entry_below_the_threshold_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two entries, 1 and 0.004: without the second the image of a point lacks 0.4 % of its norm."""
    monkeypatch.setattr(projection, "SIDE", 40)
    values = np.zeros((1, 2, 2, 5, 5), np.float32)
    values[..., 2, 2], values[..., 2, 3] = 1, 0.004
    monkeypatch.setattr(projection, "SETTINGS", (("sparse", True, 0.0), ("sparse", True, 0.01)))
    monkeypatch.setattr(projection, "POINTS", 1)
    points = measure_curve(PARTS.get("projection"), Subject.of_matrix(PSFMatrix(values), "H", 1), 1000).points
    errors = {r.settings["threshold"]: r.error for r in points}
    assert errors[0.0] < 1e-7 and errors[0.01] == pytest.approx(0.004, rel=0.6)


@pytest.fixture
def h(monkeypatch: pytest.MonkeyPatch) -> Subject:
    monkeypatch.setattr(solvers, "SIDE", 48)
    return Subject.of_matrix(PSFMatrix(lenslet_psf(3, cutout=21).astype(np.float32)), "H", 1)


def by_solver(curve: Curve) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = {}
    for point in curve.points:
        found.setdefault(point.settings["solver"], {})[point.settings["iterations"]] = point.error
    return found


@pytest.mark.long
def test_every_solver_comes_nearer_to_the_truth(h: Subject) -> None:
    curve = measure_curve(PARTS.get("solvers"), h, 1000)
    found = by_solver(curve)
    assert set(found) == set(SOLVERS.names()) and curve.stopped == ""
    for name, errors in found.items():
        assert errors[20] < errors[1] < 2, name
    seconds = [r.cost for r in curve.points if r.settings["solver"] == "rl"]
    assert sorted(seconds) == seconds and len(seconds) == len(solvers.SHOWN)


def test_the_first_iteration_is_that_of_richardson_and_lucy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Written out: x A'(b / Ax) / A'1 from an even start, with the operator as a matrix."""
    monkeypatch.setattr(solvers, "SIDE", 12)
    monkeypatch.setattr(solvers, "SHOWN", (1,))
    small = lenslet_psf(2, cutout=11)
    H = PSFMatrix(small.astype(np.float32))
    curve = measure_curve(PARTS.get("solvers"), Subject.of_matrix(H, "H", 1), 1000)
    shape = (16, 16)
    A = dense(small, shape)
    truth = phantom("vesicle", (2, *shape)).ravel()
    clean = A @ truth
    scale = solvers.FULL * 20e3 / clean.max()
    rng = np.random.default_rng(1)
    image = rng.poisson(clean * scale) + rng.normal(0, 12.0, shape).ravel()
    image = np.maximum(image, 0)
    even = A.T @ np.ones(image.size)
    start = np.full(truth.size, image.sum() / (A @ np.ones(truth.size)).sum())
    x = start * (A.T @ (image / (A @ start))) / even
    off = np.linalg.norm(x - scale * truth) / np.linalg.norm(scale * truth)
    assert by_solver(curve)["rl"][1] == pytest.approx(off, rel=0.02)


def test_solvers_closed_early_keep_their_points(h: Subject) -> None:
    work = iter_measure_curve(PARTS.get("solvers"), h, 1000)
    record = next(r for r in work if len(r.curve.points) == 3)
    work.close()
    assert by_solver(record.curve) == {"rl": by_solver(record.curve)["rl"]}
    assert [r.settings["iterations"] for r in record.curve.points] == [1, 2, 5]


@pytest.mark.long
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


SENSOR = Sensor(read_noise_e=10.0, full_well_e=20e3)


def noise(kind: str, electrons: float) -> float:
    modulator = mask(kind, 5)
    return sample_noise(modulator, modulator.inverse(), electrons, SENSOR, np.random.default_rng(0))


def test_noise_of_samples_is_that_of_the_modulator() -> None:
    """By hand where the modulator is simple, and by equation 12 of the paper."""
    n = 25
    for electrons in (50.0, 16e3):
        # behind a pinhole a pixel has a share 1/n of the light, behind a lenslet as much as without one
        wanted = n / electrons * math.sqrt(electrons / n + 100)
        assert noise("pinhole", electrons) == pytest.approx(wanted, rel=0.02)
        assert noise("lenslet", electrons) == pytest.approx(math.sqrt(electrons + 100) / electrons, rel=0.02)
    for kind in ("MURA", "sum_of_sinusoids"):
        modulator, electrons = mask(kind, 5), 16e3
        variance = (transmission(modulator) * electrons + 100) / electrons**2
        assert noise(kind, electrons) == pytest.approx(n * amplification(modulator) * math.sqrt(variance), rel=0.05)


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
