"""Noise that nobody states, measured on frames whose noise is known because it was drawn."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.acquire import Options, record
from lfcal.base.progress import drain
from lfcal.camera import Marks, ScanPlan
from lfcal.devices import simulated_rig
from lfcal.frames import ArraySource, CorrectionRecipe, corrected_view, open_frames
from lfcal.frames.described import sensor_noise
from lfcal.psf import AssemblySettings, PSFMatrix, assemble_plan, open_psf, save
from lfcal.psf.measured_noise import scan_noise
from lfcal.psf.provenance import noise_of
from lfcal.tasks._patterns import PatternReading, iter_patterns
from tests.simulate.common import small_camera

BLACK = 100.0
SHAPE = (96, 96)
PERIOD = (15, 20)


def plan() -> ScanPlan:
    """Return a plan of two planes, of a camera whose noise is not stated."""
    camera = small_camera(*SHAPE, black_level=BLACK, bit_depth=16)
    camera = replace(camera, marks=Marks.of(dict.fromkeys(("sensor.read_noise_e", "sensor.full_well_e"), "assumed")))
    depths = (camera.depth_of(3.0), camera.depth_of(4.0))
    return ScanPlan(camera, PERIOD, (31, 31), depths, anchor=(40.0, 38.0))


@cache
def light() -> NDArray[np.float64]:
    """Return sharp-edged micro-images under a moving point: discs of a fixed array, lit from one side to the other."""
    rows, columns = np.indices(SHAPE)
    out = np.zeros((2, *PERIOD, *SHAPE))
    for z, (shift, wide) in enumerate(((0.4, 2.0), (0.3, 3.0))):
        for y, x in np.ndindex(*PERIOD):
            for i, j in np.ndindex(8, 8):
                centre = 6 + 12 * i, 6 + 12 * j + 6 * (i % 2)
                off = 40 + y - centre[0], 38 + x - centre[1]
                if np.hypot(*off) > 22:
                    continue
                r, c = rows - centre[0] + shift * off[0], columns - centre[1] + shift * off[1]
                edge = np.clip(6.5 - np.hypot(rows - centre[0], columns - centre[1]), 0, 1)
                out[z, y, x] += edge * np.exp(-(r**2 + c**2) / (2 * wide**2)) * np.exp(-np.hypot(*off) / 15)
    return out


def frames(floor: float, slope: float, peak: float, seed: int = 0, repeats: int = 1) -> ArraySource:
    """Return raw frames of 12 to 16 bits, whole numbers, of known noise."""
    rng = np.random.default_rng(seed)
    signal = peak * np.repeat(light().reshape(-1, *SHAPE), repeats, axis=0)
    counts = BLACK + signal + np.sqrt(floor - 1 / 12 + slope * signal) * rng.standard_normal(signal.shape)
    positions = np.repeat(np.array(list(np.ndindex(2, *PERIOD))), repeats, axis=0)
    return ArraySource(np.rint(counts).astype(np.uint16), positions.tolist())


def stack(source: ArraySource) -> NDArray[np.float32]:
    return np.stack([source.read(k) for k in range(len(source))]).astype(np.float32)


def darks(folder: Path, floor: float, count: int, seed: int = 9) -> Path:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    fixed = BLACK + rng.normal(0, 3, SHAPE)  # a pattern that all darks share is no noise
    for k in range(count):
        frame = fixed + np.sqrt(floor - 1 / 12) * rng.standard_normal(SHAPE)
        tifffile.imwrite(folder / f"{k}.tif", np.rint(frame).astype(np.uint16))
    return folder


def assembled(source: ArraySource, recipe: CorrectionRecipe, **settings: Any) -> PSFMatrix:
    return assemble_plan(corrected_view(source, recipe, plan()), plan(), settings=AssemblySettings(**settings)).matrix


@pytest.mark.parametrize(
    ("floor", "slope", "peak"),
    # at most 200 photons, and 50
    [(4.0, 0.25, 3000.0), (1.2, 0.08, 12000.0), (25.0, 1.5, 1500.0), (9.0, 4.0, 800.0), (9.0, 4.0, 200.0)],
    ids=["12 bits", "low noise", "high gain", "few photons", "photon-starved"],
)
def test_noise_is_measured_on_neighbouring_positions(floor: float, slope: float, peak: float) -> None:
    matrix = assembled(frames(floor, slope, peak), CorrectionRecipe(black_level=BLACK))
    found = noise_of(matrix.provenance)
    assert found is not None and "neighbouring positions" in found.source
    assert found.floor == pytest.approx(floor, rel=0.1)
    assert found.slope == pytest.approx(slope, rel=0.1)
    known = matrix.facts.noise
    assert known is not None
    np.testing.assert_allclose(known, np.broadcast_to([found.floor, found.slope], known.shape), rtol=1e-5)


def test_noise_is_measured_on_repeated_frames() -> None:
    matrix = assembled(frames(6.0, 0.5, 2000.0, repeats=2), CorrectionRecipe(black_level=BLACK))
    found = noise_of(matrix.provenance)
    assert found is not None and found.source == "floor from repeated frames, slope from repeated frames"
    assert found.floor == pytest.approx(6.0, rel=0.08) and found.slope == pytest.approx(0.5, rel=0.1)
    assert matrix.facts.noise is not None
    # each pattern is the mean of two frames
    np.testing.assert_allclose(matrix.facts.noise[1, 2, 3], [found.floor / 2, found.slope / 2], rtol=1e-5)


@pytest.mark.parametrize("count", [2, 8])
def test_the_floor_is_measured_on_darks(tmp_path: Path, count: int) -> None:
    """The mean of the darks brings their noise into every pattern: its share is part of the floor."""
    recipe = CorrectionRecipe(dark=darks(tmp_path / "dark", 4.0, count))
    found = noise_of(assembled(frames(4.0, 0.25, 3000.0), recipe).provenance)
    assert found is not None and found.source.startswith("floor from dark frames, slope from neighbouring")
    assert found.floor == pytest.approx(4.0 * (1 + 1 / count), rel=0.03)
    assert found.slope == pytest.approx(0.25, rel=0.15)


def test_one_dark_says_nothing_of_the_floor(tmp_path: Path) -> None:
    recipe = CorrectionRecipe(dark=darks(tmp_path / "dark", 4.0, 1))
    found = noise_of(assembled(frames(4.0, 0.25, 3000.0), recipe).provenance)
    assert found is not None and "darks" not in found.source
    assert found.floor == pytest.approx(8.0, rel=0.15), "the frame's own noise and that of the dark"


def test_noise_of_frames_that_are_divided_by_a_white_image(tmp_path: Path) -> None:
    """A uniform gain of 2, left of the frame, where a fifth of the light is."""
    white = np.full(SHAPE, 2000.0)
    white[:, :48] = 4000.0
    tifffile.imwrite(tmp_path / "white.tif", (white + BLACK).astype(np.uint16))
    recipe = CorrectionRecipe(black_level=BLACK, white=tmp_path / "white.tif", white_mode="pixels")
    source = frames(4.0, 0.25, 3000.0)
    matrix = assembled(source, recipe)
    found = noise_of(matrix.provenance)
    assert found is not None and 4.0 < found.floor < 16.0 and 0.25 < found.slope < 0.5


def test_frames_that_somebody_averaged_have_less_noise() -> None:
    mean = np.mean([stack(frames(4.0, 0.25, 3000.0, seed)) for seed in range(4)], axis=0, dtype=np.float32)
    averaged = ArraySource(mean, list(np.ndindex(2, *PERIOD)))
    found = noise_of(assembled(averaged, CorrectionRecipe(black_level=BLACK)).provenance)
    assert found is not None
    assert found.floor == pytest.approx(1.0, rel=0.15) and found.slope == pytest.approx(0.25 / 4, rel=0.15)


def test_flicker_of_the_lamp_is_not_taken_for_photon_noise() -> None:
    source = frames(4.0, 0.25, 3000.0)
    rng = np.random.default_rng(5)
    raw = stack(source)
    lit = BLACK + (raw - BLACK) * (1 + 0.01 * rng.standard_normal((len(raw), 1, 1)))
    steady = ArraySource(np.rint(lit).astype(np.uint16), list(np.ndindex(2, *PERIOD)))
    found = noise_of(assembled(steady, CorrectionRecipe(black_level=BLACK)).provenance)
    assert found is not None and found.slope == pytest.approx(0.25, rel=0.1)


def test_a_pedestal_that_is_kept_is_not_taken_for_light() -> None:
    matrix = assembled(frames(4.0, 0.25, 3000.0), CorrectionRecipe(dark="none"), keep_pedestal=True)
    found = noise_of(matrix.provenance)
    assert found is not None and found.floor == pytest.approx(4.0, rel=0.12)
    assert found.slope == pytest.approx(0.25, rel=0.15)
    assert matrix.provenance["noise"]["black"] == pytest.approx(BLACK, abs=1)


def test_interpolated_patterns_have_the_noise_that_is_left() -> None:
    """Noise that is measured goes the way of noise that is stated: interpolation leaves the sum of w²."""
    source = frames(4.0, 0.25, 3000.0)
    moved = ArraySource(
        np.stack([source.read(k) for k in range(len(source))]),
        list(np.ndindex(2, *PERIOD)),
        drifts=[(0.5, 0.0)] * len(source),
    )
    matrix = assembled(moved, CorrectionRecipe(black_level=BLACK), interpolation="linear")
    found = noise_of(matrix.provenance)
    assert found is not None and matrix.facts.noise is not None
    np.testing.assert_allclose(matrix.facts.noise[0, 3, 4], [found.floor / 2, found.slope / 2], rtol=1e-3)


def test_what_too_few_frames_do_not_show_is_unknown() -> None:
    """Positions far from each other: nothing repeats, and no neighbours are there."""
    source = frames(4.0, 0.25, 3000.0)
    chosen = [k for k in range(len(source)) if tuple(np.array(source.info(k).position)[1:] % 4) == (0, 0)]
    few = ArraySource(np.stack([source.read(k) for k in chosen]), [source.info(k).position for k in chosen])
    matrix = assembled(few, CorrectionRecipe(black_level=BLACK))
    assert matrix.facts.noise is None and "noise" not in matrix.provenance


def test_noise_that_is_stated_is_kept() -> None:
    described = replace(plan(), camera=small_camera(*SHAPE, black_level=BLACK, bit_depth=16))
    source = frames(4.0, 0.25, 3000.0)
    matrix = assemble_plan(corrected_view(source, CorrectionRecipe(black_level=BLACK), described), described).matrix
    sensor = described.camera.sensor
    found = noise_of(matrix.provenance)
    assert found is not None and found.source == "as in the camera description"
    assert found.slope == pytest.approx(1 / sensor.electrons_per_count)


def test_fit_takes_the_noise_that_was_measured(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """After ``assemble --dark``, ``fit`` needs no --noise, and says where the noise is known from."""
    recipe = CorrectionRecipe(dark=darks(tmp_path / "dark", 4.0, 8))
    view = corrected_view(frames(4.0, 0.25, 3000.0), recipe, plan())
    assemble_plan(view, plan(), tmp_path / "H.h5").matrix.close()
    how = PatternReading()
    caplog.set_level("INFO", logger="lfcal")
    measured, known = drain(iter_patterns(tmp_path / "H.h5", how))
    np.testing.assert_allclose(measured.noise, np.broadcast_to([4.5, 0.25], measured.noise.shape), rtol=0.15)
    assert "noise of the frames: floor from dark frames, slope from neighbouring positions" in caplog.text
    assert known["noise"]["floor"] == pytest.approx(4.5, rel=0.05)
    with open_psf(tmp_path / "H.h5") as H:  # the facts of another program's H may lack it
        other = PSFMatrix(H[:], depths=H.depths, camera=H.camera, anchor=H.anchor, provenance=H.provenance)
        save(other, tmp_path / "other.h5")
    assert drain(iter_patterns(tmp_path / "other.h5", how))[0].noise[0, 0] == pytest.approx(4.5, rel=0.05)


def recorded(folder: Path) -> ScanPlan:
    """Record six positions, among which the first is taken seven times again, as a reference."""
    camera = small_camera(64, 64, black_level=BLACK, bit_depth=12)
    camera = replace(camera, marks=Marks.of(dict.fromkeys(("sensor.read_noise_e", "sensor.full_well_e"), "assumed")))
    scan = ScanPlan(camera, (2, 3), (41, 41), (camera.depth_of(3.0),), anchor=(32.0, 32.0))
    record(folder, scan, simulated_rig(scan), Options(darks=4, reference_every=1))
    return scan


@pytest.mark.parametrize("independent", [True, False])
def test_the_reference_frames_of_a_session_show_its_noise(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, independent: bool
) -> None:
    """Six positions have too few neighbours. Copies of a frame, which the simulator makes, say nothing of its noise."""
    if independent:
        draw = itertools.count(1)
        simulated = SimpleNamespace(crc32=lambda *_: next(draw) * 2654435761 % 2**32)
        monkeypatch.setattr("lfcal.devices.simulated._camera.zlib", simulated)
    scan = recorded(tmp_path / "session")
    with open_frames(tmp_path / "session") as source:
        found = scan_noise(corrected_view(source, CorrectionRecipe(), scan), scan)
    if not independent:
        assert found is None
        return
    assert found is not None and found.source == "floor from repeated frames, slope from repeated frames"
    wanted = sensor_noise(scan.camera.sensor)
    # the mean of four darks is subtracted
    assert found.floor == pytest.approx(1.25 * float(wanted.constant), rel=0.1)
    assert found.slope == pytest.approx(float(wanted.slope), rel=0.1)
