"""Noise of H: measured on frames whose noise is known because it was drawn, and stated as it is between sessions."""

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
from lfcal.frames import (
    ArraySource,
    CorrectionChain,
    CorrectionRecipe,
    Dark,
    White,
    corrected,
    corrected_view,
    open_frames,
)
from lfcal.frames.described import sensor_noise
from lfcal.frames.source import Noise
from lfcal.psf import AssemblySettings, PSFMatrix, assemble, assemble_plan, open_psf, save
from lfcal.psf.cutout import Cutout
from lfcal.psf.measured_noise import scan_noise
from lfcal.psf.provenance import FrameNoise, noise_of
from lfcal.tasks._patterns import PatternReading, iter_patterns
from tests.simulate.common import small_camera

BLACK = 100.0
SHAPE = (96, 96)
PERIOD = (15, 20)
PLACES = list(np.ndindex(2, *PERIOD))


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
                box = tuple(slice(max(0, k - 7), k + 8) for k in centre)  # no light beyond 6.5 px
                row, column = rows[box], columns[box]
                r, c = row - centre[0] + shift * off[0], column - centre[1] + shift * off[1]
                edge = np.clip(6.5 - np.hypot(row - centre[0], column - centre[1]), 0, 1)
                out[z, y, x, *box] += edge * np.exp(-(r**2 + c**2) / (2 * wide**2)) * np.exp(-np.hypot(*off) / 15)
    return out


@cache
def frames(floor: float, slope: float, peak: float, seed: int = 0, repeats: int = 1) -> ArraySource:
    """Return raw frames of 12 to 16 bits, whole numbers, of known noise."""
    rng = np.random.default_rng(seed)
    signal = peak * np.repeat(light().reshape(-1, *SHAPE), repeats, axis=0)
    counts = BLACK + signal + np.sqrt(floor - 1 / 12 + slope * signal) * rng.standard_normal(signal.shape)
    positions = np.repeat(np.array(PLACES), repeats, axis=0)
    return ArraySource(np.rint(counts).astype(np.uint16), positions.tolist())


def usual() -> ArraySource:
    """Return frames of 12 bits, with at most 3000 counts of light."""
    return frames(4.0, 0.25, 3000.0)


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


def assembled(source: ArraySource, recipe: CorrectionRecipe | None = None, **settings: Any) -> PSFMatrix:
    view = corrected_view(source, recipe or CorrectionRecipe(black_level=BLACK), plan())
    return assemble_plan(view, plan(), settings=AssemblySettings(**settings)).matrix


def measured(source: ArraySource, recipe: CorrectionRecipe | None = None, **settings: Any) -> FrameNoise:
    """Return the noise that H states of its frames."""
    found = noise_of(assembled(source, recipe, **settings).provenance)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("floor", "slope", "peak"),
    # high gain, low noise, and photon-starved: at most 50 photons
    [
        (25.0, 1.5, 1500.0),
        *(pytest.param(*one, marks=pytest.mark.long) for one in ((1.2, 0.08, 12000.0), (9.0, 4.0, 200.0))),
    ],
)
def test_noise_is_measured_on_neighbouring_positions(floor: float, slope: float, peak: float) -> None:
    matrix = assembled(frames(floor, slope, peak))
    found = noise_of(matrix.provenance)
    assert found is not None and "neighbouring positions" in found.source
    assert found.floor == pytest.approx(floor, rel=0.1)
    assert found.slope == pytest.approx(slope, rel=0.1)
    known = matrix.facts.noise
    assert known is not None
    np.testing.assert_allclose(known, np.broadcast_to([found.floor, found.slope], known.shape), rtol=1e-5)


@pytest.mark.long
def test_noise_is_measured_on_repeated_frames() -> None:
    matrix = assembled(frames(6.0, 0.5, 2000.0, repeats=2))
    found = noise_of(matrix.provenance)
    assert found is not None and found.source == "floor from repeated frames, slope from repeated frames"
    assert found.floor == pytest.approx(6.0, rel=0.08) and found.slope == pytest.approx(0.5, rel=0.1)
    assert matrix.facts.noise is not None
    # each pattern is the mean of two frames
    np.testing.assert_allclose(matrix.facts.noise[1, 2, 3], [found.floor / 2, found.slope / 2], rtol=1e-5)


@pytest.mark.long
def test_the_floor_is_measured_on_two_darks_or_more(tmp_path: Path) -> None:
    """The mean of the darks brings their noise into every pattern: its share is part of the floor."""
    for count in (2, 8):
        found = measured(usual(), CorrectionRecipe(dark=darks(tmp_path / f"{count}", 4.0, count)))
        assert found.source.startswith("floor from dark frames, slope from neighbouring")
        assert found.floor == pytest.approx(4.0 * (1 + 1 / count), rel=0.03)
        assert found.slope == pytest.approx(0.25, rel=0.15)
    found = measured(usual(), CorrectionRecipe(dark=darks(tmp_path / "1", 4.0, 1)))
    assert "darks" not in found.source
    assert found.floor == pytest.approx(8.0, rel=0.15), "the frame's own noise and that of the dark"


def test_noise_of_frames_that_are_divided_by_a_white_image(tmp_path: Path) -> None:
    """A uniform gain of 2, left of the frame, where a fifth of the light is."""
    white = np.full(SHAPE, 2000.0)
    white[:, :48] = 4000.0
    tifffile.imwrite(tmp_path / "white.tif", (white + BLACK).astype(np.uint16))
    recipe = CorrectionRecipe(black_level=BLACK, white=tmp_path / "white.tif", white_mode="pixels")
    found = measured(usual(), recipe)
    assert 4.0 < found.floor < 16.0 and 0.25 < found.slope < 0.5


@pytest.mark.long
def test_frames_that_were_averaged_before_have_less_noise() -> None:
    rng, mean = np.random.default_rng(1), stack(usual())
    for _ in range(3):
        signal = 3000.0 * light().reshape(-1, *SHAPE)
        mean += np.rint(BLACK + signal + np.sqrt(4.0 - 1 / 12 + 0.25 * signal) * rng.standard_normal(signal.shape))
    found = measured(ArraySource(mean / 4, PLACES))
    assert found.floor == pytest.approx(1.0, rel=0.15) and found.slope == pytest.approx(0.25 / 4, rel=0.15)


@pytest.mark.long
def test_flicker_of_the_lamp_is_not_taken_for_photon_noise() -> None:
    raw = stack(usual())
    lit = BLACK + (raw - BLACK) * (1 + 0.01 * np.random.default_rng(5).standard_normal((len(raw), 1, 1)))
    assert measured(ArraySource(np.rint(lit).astype(np.uint16), PLACES)).slope == pytest.approx(0.25, rel=0.1)


def test_a_pedestal_that_is_kept_is_not_taken_for_light() -> None:
    matrix = assembled(usual(), CorrectionRecipe(dark="none"), keep_pedestal=True)
    found = noise_of(matrix.provenance)
    assert found is not None and found.floor == pytest.approx(4.0, rel=0.12)
    assert found.slope == pytest.approx(0.25, rel=0.15)
    assert matrix.provenance["noise"]["black"] == pytest.approx(BLACK, abs=1)


@pytest.mark.long
def test_interpolated_patterns_have_the_noise_that_is_left() -> None:
    """Noise that is measured is treated as noise that is stated: interpolation leaves the sum of w²."""
    moved = ArraySource(stack(usual()).astype(np.uint16), PLACES, drifts=[(0.5, 0.0)] * len(PLACES))
    matrix = assembled(moved, interpolation="linear")
    found = noise_of(matrix.provenance)
    assert found is not None and matrix.facts.noise is not None
    np.testing.assert_allclose(matrix.facts.noise[0, 3, 4], [found.floor / 2, found.slope / 2], rtol=1e-3)


def test_what_too_few_frames_do_not_show_is_unknown() -> None:
    """Positions far from each other: nothing repeats, and no neighbours are there."""
    chosen = [k for k, place in enumerate(PLACES) if place[1] % 4 == place[2] % 4 == 0]
    few = ArraySource(np.stack([usual().read(k) for k in chosen]), [PLACES[k] for k in chosen])
    matrix = assembled(few)
    assert matrix.facts.noise is None and "noise" not in matrix.provenance


def test_noise_that_is_stated_is_kept() -> None:
    described = replace(plan(), camera=small_camera(*SHAPE, black_level=BLACK, bit_depth=16))
    source = usual()
    matrix = assemble_plan(corrected_view(source, CorrectionRecipe(black_level=BLACK), described), described).matrix
    sensor = described.camera.sensor
    found = noise_of(matrix.provenance)
    assert found is not None and found.source == "as in the camera description"
    assert found.slope == pytest.approx(1 / sensor.electrons_per_count)


def test_fit_takes_the_noise_that_was_measured(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """After ``assemble --dark``, ``fit`` needs no --noise, and says where the noise is known from."""
    recipe = CorrectionRecipe(dark=darks(tmp_path / "dark", 4.0, 8))
    view = corrected_view(usual(), recipe, plan())
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


# -- stated variance ---------------------------------------------------------------------------------------------------


SESSIONS = 60
NOISE = Noise(4.0, 0.5, 64.0)


def spot(row: float, column: float, shape: tuple[int, int]) -> np.ndarray:
    rows, columns = np.indices(shape)
    return 800 * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / (2 * 3.0**2))


def session(
    seed: int, cutout: Cutout, repeats: int, drift: tuple[float, float], white: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pattern of one position and its stated variance."""
    rng, shape = np.random.default_rng(seed), (61, 61)
    light = spot(30 + drift[0], 30 + drift[1], shape)
    fall = np.linspace(0.3, 1.0, shape[1])[None] * np.ones(shape)
    light = light * fall if white else light
    counts = light + 64 + np.sqrt(NOISE.constant + NOISE.slope * light) * rng.standard_normal((repeats, *shape))
    known: dict[str, Any] = {"drifts": [drift] * repeats, "metadata": {"noise": NOISE}}
    source = ArraySource(counts.astype(np.float32), [(0, 0, 0)] * repeats, **known)
    steps = (Dark(level=64.0), White(1000 * fall, 0.0)) if white else (Dark(level=64.0),)
    matrix = assemble(corrected(source, CorrectionChain(steps)), (1, 1, 1), cutout).matrix
    stated = matrix.variance(0, 0, 0)
    assert stated is not None
    return np.asarray(matrix[0, 0, 0]), stated


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("interpolation", "drift", "repeats", "white"),
    [
        ("nearest", (0.0, 0.0), 1, False),
        ("nearest", (0.0, 0.0), 3, False),
        ("linear", (0.5, 0.25), 1, False),
        ("cubic", (0.5, 0.25), 2, False),
        ("fourier", (0.3, 0.5), 1, False),
        ("nearest", (0.0, 0.0), 2, True),
    ],
)
def test_stated_variance_is_that_between_sessions(
    interpolation: str, drift: tuple[float, float], repeats: int, white: bool
) -> None:
    cutout = Cutout((21, 21), (30.0, 30.0), interpolation)
    found = [session(seed, cutout, repeats, drift, white) for seed in range(SESSIONS)]
    values, stated = (np.array([pair[k] for pair in found]) for k in (0, 1))
    ratio = values.var(axis=0, ddof=1) / stated.mean(axis=0)
    assert values.var(axis=0, ddof=1).sum() / stated.mean(axis=0).sum() == pytest.approx(1.0, abs=0.05)
    if interpolation == "fourier":
        return  # it spreads the noise of bright pixels over dark ones, which no function of the signal can say
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    bright = stated.mean(axis=0) > np.median(stated.mean(axis=0))
    # a pattern under a white image has two numbers for all its pixels, which fit to some per cent
    assert ratio[bright].mean() == pytest.approx(ratio[~bright].mean(), abs=0.15 if white else 0.06)


def test_resampled_frames_keep_their_variance() -> None:
    """A cutout whose pixels are larger than the sensor's holds more light a pixel, and its noise."""
    cutout = Cutout((21, 21), (30.0, 30.0), "linear", "error", (0.9, 0.8))
    found = [session(seed, cutout, 1, (0.0, 0.0), False) for seed in range(SESSIONS)]
    values, stated = (np.array([pair[k] for pair in found]) for k in (0, 1))
    assert (values.var(axis=0, ddof=1) / stated.mean(axis=0)).mean() == pytest.approx(1.0, abs=0.08)
