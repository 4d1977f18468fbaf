"""Photon transfer against a sensor of a few lines of numpy: values within their stated errors, or unknown."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame
from lfcal.frames.photon_transfer.measurement import measure_sensor
from lfcal.frames.photon_transfer.result import SensorMeasurement

from .sensor_model import Truth, micro_images, vignetting

LEVELS = np.linspace(0.05, 0.9, 8)
SHAPE = (120, 160)
PLAIN = Truth(shape=SHAPE)
NAMES = {
    "gain": lambda t: t.gain,
    "read_noise_e": lambda t: t.read_e,
    "prnu": lambda t: t.prnu,
    "dsnu_e": lambda t: t.dsnu_e,
    "black_level": lambda t: t.black,
}


def array_frames(frames: Iterable[Any], exposures_s: Any = None) -> list[CalibrationFrame]:
    """Return frames in memory as a series; ``exposures_s`` of each, or of all."""
    held = [np.asarray(frame) for frame in frames]
    stated = [exposures_s] * len(held) if exposures_s is None or isinstance(exposures_s, int | float) else exposures_s
    return [CalibrationFrame(frame, k, seconds) for k, (frame, seconds) in enumerate(zip(held, stated, strict=True))]


def measured(flats: list[Any], darks: list[Any], cfa: str = "", **exposures: Any) -> SensorMeasurement:
    return measure_sensor(
        array_frames(flats, exposures.get("lit_s")), array_frames(darks, exposures.get("dark_s")), cfa=cfa
    )


# name to (sensor, levels, scene, frames a level, what must be known, what must be unknown)
GRID: dict[str, tuple[Truth, Any, Callable[..., Any] | None, int, str, str]] = {
    "even": (PLAIN, LEVELS, None, 2, "gain read_noise_e prnu dsnu_e black_level", "saturation linearity"),
    "vignetting": (PLAIN, LEVELS, vignetting, 2, "gain read_noise_e prnu dsnu_e black_level", ""),
    "one even pair": (PLAIN, [0.5], None, 2, "gain read_noise_e dsnu_e black_level", "saturation"),
    "one white image through lenslets": (PLAIN, [0.9], micro_images, 2, "gain read_noise_e dsnu_e", "prnu"),
    "eight white images": (PLAIN, [0.5], micro_images, 8, "gain read_noise_e dsnu_e", "prnu"),
    "odd number of frames": (PLAIN, [0.3, 0.6], vignetting, 3, "gain read_noise_e prnu dsnu_e", ""),
    "many electrons a count": (
        PLAIN.but(bits=8, gain=0.0125, black=10.3, read_e=50.0, dsnu_e=30.0),
        [*LEVELS, 1.3],
        vignetting,
        2,
        "gain read_noise_e prnu saturation",
        "",
    ),
    "rounding hides the read noise": (
        PLAIN.but(bits=8, gain=0.0125, black=10.0),
        LEVELS,
        vignetting,
        2,
        "gain prnu",
        "read_noise_e dsnu_e",
    ),
    "many counts an electron": (
        PLAIN.but(bits=16, gain=3.0, black=100.0, read_e=1.2),
        LEVELS,
        vignetting,
        2,
        "gain read_noise_e prnu dsnu_e",
        "",
    ),
    "few electrons": (PLAIN.but(gain=20.0, black=300.0, read_e=2.0), LEVELS, vignetting, 2, "gain read_noise_e", ""),
    "black at zero": (PLAIN.but(black=0.0), LEVELS, None, 2, "gain read_noise_e prnu", "black_level dsnu_e"),
    "hot and dead pixels": (PLAIN.but(hot=40, dead=25), LEVELS, vignetting, 2, "gain read_noise_e prnu dsnu_e", ""),
}


@functools.cache
def found_of(case: str, seed: int) -> tuple[Truth, SensorMeasurement]:
    truth, levels, scene, count, _, _ = GRID[case]
    truth = truth.but(seed=seed)
    light = 1.0 if scene is None else scene(truth.shape)
    return truth, measured(truth.flats(levels, count, light), truth.darks(4))


@pytest.mark.parametrize("case", GRID)
@pytest.mark.few(6)
def test_values_lie_within_their_stated_errors(case: str) -> None:
    """Of three sensors each; chi^2 of all values at once, and none farther off than chance makes of so many."""
    known, unknown = (text.split() for text in GRID[case][4:])
    away = []
    for seed in range(3):
        truth, found = found_of(case, seed)
        assert found.doubts == ()
        for name in known:
            if name == "saturation":
                assert found.saturation is not None and found.saturation.value == truth.top
                continue
            value = getattr(found, name)
            assert value is not None, (name, found.notes)
            away.append((value.value - NAMES[name](truth)) / value.sigma)
        for name in unknown:
            assert getattr(found, name) is None, name
            said = {"saturation": "expose longer", "linearity": "three or more", "prnu": "structure"}
            assert name not in said or any(said[name] in note for note in found.notes)
    assert np.abs(away).max() < 4.2, dict(zip(known * 3, away, strict=False))
    assert np.mean(np.square(away)) < 3.0


@pytest.mark.parametrize("case", ["even", "one white image through lenslets", "few electrons"])
def test_stated_errors_are_no_wider_than_the_figures_scatter(case: str) -> None:
    """Errors that are far too wide would pass every test above."""
    gains = [found_of(case, seed)[1].gain for seed in range(3)]
    assert all(gain is not None and gain.sigma < 0.02 * gain.value for gain in gains)


def test_defects_are_counted_and_left_out() -> None:
    _, found = found_of("hot and dead pixels", 0)
    assert (found.hot, found.dead) == (40, 25)
    _, clean = found_of("vignetting", 0)
    assert (clean.hot, clean.dead) == (0, 0)


def test_clipping_is_the_saturation_and_its_electrons_the_full_well() -> None:
    found = measured(PLAIN.flats([*LEVELS, 1.1, 1.5]), PLAIN.darks(4))
    assert found.saturation is not None and found.full_well_e is not None and found.gain is not None
    assert found.saturation.value == 4095
    assert abs(found.full_well_e.value - PLAIN.full_e) < 4 * found.full_well_e.sigma
    assert abs(found.gain.value - 0.2) < 4 * found.gain.sigma


def test_a_well_that_fills_below_the_converters_end_is_found_where_the_variance_breaks() -> None:
    truth = PLAIN.but(well_e=12_000.0)
    found = measured(truth.flats([0.1, 0.3, 0.5, 0.7, 0.9, 1.05, 1.3, 1.6]), truth.darks(4))
    assert found.saturation is not None and found.full_well_e is not None and found.gain is not None
    assert abs(found.saturation.value - (64 + 0.2 * 12_000)) < 2 * found.saturation.sigma < 300
    assert abs(found.gain.value - 0.2) < 4 * found.gain.sigma


def test_one_pair_through_lenslets_finds_saturation_too() -> None:
    found = measured(PLAIN.flats([1.2], 2, micro_images(SHAPE)), PLAIN.darks(4))
    assert found.saturation is not None and found.saturation.value == 4095 and found.gain is not None
    assert abs(found.gain.value - 0.2) < 4 * found.gain.sigma


def flicker(rolling: bool) -> list[Any]:
    rng = np.random.default_rng(3)
    rows = np.arange(SHAPE[0])[:, None]
    frames = []
    for k, share in enumerate(LEVELS):
        for n in range(2):
            lamp = 1 + 0.05 * (np.sin(rows / 12 + 6 * rng.random()) if rolling else rng.standard_normal())
            frames.append(PLAIN.frame(share * PLAIN.full_e * micro_images(SHAPE) * lamp, key=10 * k + n))
    return frames


@pytest.mark.parametrize("rolling", [False, True])
def test_a_flickering_lamp_is_allowed_for_and_said(rolling: bool) -> None:
    found = measured(flicker(rolling), PLAIN.darks(4))
    assert found.gain is not None and found.doubts == ()
    assert abs(found.gain.value - 0.2) < 4 * found.gain.sigma < 0.01
    assert any(("row to row" if rolling else "within a pair") in note for note in found.notes)


def test_left_aligned_samples_are_moved_down_and_said() -> None:
    plain = measured(PLAIN.flats(LEVELS), PLAIN.darks(4))
    aligned = measured([f << 4 for f in PLAIN.flats(LEVELS)], [f << 4 for f in PLAIN.darks(4)])
    assert aligned.shift == 4 and aligned.bits == 12 and aligned.gain == plain.gain
    assert aligned.black_level == plain.black_level and "left-aligned by 4" in aligned.notes[0]


def test_linearity_and_dark_current_from_exposures() -> None:
    truth = PLAIN.but(dark_e_s=20.0)
    times = [0.01, 0.1, 0.2, 0.3, 0.4, 0.5]
    flats = [truth.frame(t * 1.8 * truth.full_e, t, key=int(1000 * t) + n) for t in times for n in range(2)]
    seconds = [0.01] * 4 + [2.0] * 4 + [5.0] * 4
    darks = [truth.frame(0.0, t, key=7000 + k) for k, t in enumerate(seconds)]
    found = measured(flats, darks, lit_s=[t for t in times for _ in range(2)], dark_s=seconds)
    assert found.linearity is not None and found.linearity.value < 0.001
    assert found.dark_current_e_s is not None and found.black_level is not None
    assert abs(found.dark_current_e_s.value - 20) < 4 * found.dark_current_e_s.sigma < 1
    assert abs(found.black_level.value - 64) < 4 * found.black_level.sigma, "at no exposure, dark current taken off"
    bent = [np.rint(64 + (f - 64.0) * (1 - 0.04 * (f - 64.0) / 4031)).astype(np.uint16) for f in flats]
    known = measured(bent, darks, lit_s=[t for t in times for _ in range(2)], dark_s=seconds)
    assert known.linearity is not None
    # the largest relative departure of x (1 - 0.04 x) from its own straight line, by hand
    x = np.array(times[1:]) * 1.8
    y = x * (1 - 0.04 * x)
    line = np.linalg.lstsq(np.stack([1 / y, x / y], axis=1), np.ones(5), rcond=None)[0]
    by_hand = np.abs(y - line[0] - line[1] * x) / (line[0] + line[1] * x)
    assert known.linearity.value == pytest.approx(by_hand.max(), rel=0.2)


def test_dark_current_that_the_camera_subtracts_is_told_from_its_noise() -> None:
    truth = PLAIN.but(dark_e_s=200.0)
    seconds = [0.01] * 6 + [4.0] * 6
    darks = [truth.frame(0.0, t, key=k) for k, t in enumerate(seconds)]
    held = [np.clip(np.rint(d - 0.2 * 200 * t), 0, None).astype(np.uint16) for d, t in zip(darks, seconds, strict=True)]
    found = measured(truth.flats(LEVELS), held, dark_s=seconds)
    assert found.dark_current_e_s is not None
    assert abs(found.dark_current_e_s.value - 200) < 4 * found.dark_current_e_s.sigma < 40
    assert any("the camera subtracts dark current" in note for note in found.notes)


def test_colours_are_measured_at_their_own_levels() -> None:
    scene = np.tile(np.array([[0.4, 1.0], [1.0, 0.3]]), (SHAPE[0] // 2, SHAPE[1] // 2))
    found = measured(PLAIN.flats(LEVELS, scene=scene), PLAIN.darks(4), "RGGB")
    assert set(found.channels) == {"R", "G1", "G2", "B"} and found.doubts == ()
    for gain in [found.gain, *found.channels.values()]:
        assert gain is not None and abs(gain.value - 0.2) < 4.2 * gain.sigma
    assert found.prnu is not None and found.prnu.value == pytest.approx(0.01, abs=4 * found.prnu.sigma)
    untold = measured(PLAIN.flats(LEVELS, scene=scene), PLAIN.darks(4))
    assert untold.gain is not None and abs(untold.gain.value - 0.2) < 4 * untold.gain.sigma, "sorted by brightness"
    assert untold.prnu is None, "a mosaic that nobody stated is structure"


def test_copies_singles_and_swapped_folders_are_refused() -> None:
    flats, darks = PLAIN.flats([0.5]), PLAIN.darks(2)
    with pytest.raises(InputError, match="remove the copies"):
        measured([flats[0], flats[0]], darks)
    with pytest.raises(InputError, match="remove the copies"):
        measured(flats, [darks[0], darks[0]])
    with pytest.raises(InputError, match="record at least a pair"):
        measured(flats, darks[:1])
    with pytest.raises(InputError, match="record pairs"):
        measured(flats[:1], darks)
    with pytest.raises(InputError, match="exchange flats and darks"):
        measured(darks, flats)
    with pytest.raises(InputError, match="the same sensor settings"):
        measured([f[:-2] for f in flats], darks)
    with pytest.raises(InputError, match="1000 pixels"):
        measured([f[:6, :6] for f in flats], [d[:6, :6] for d in darks])
    with pytest.raises(InputError, match="finite"):
        measured([np.where(f > 3, np.nan, f) for f in flats], darks)


def test_flats_whose_light_drifts_are_one_level_however_high_the_black_level() -> None:
    """Five per cent of the light are a fifth of it where the black level is not told from it rightly."""
    truth = PLAIN.but(black=800.0)
    light = 1000.0 / truth.gain
    found = measured([truth.frame(light, key=0), truth.frame(1.05 * light, key=1)], truth.darks(4))
    assert found.gain is not None and abs(found.gain.value - 0.2) < 4 * found.gain.sigma
