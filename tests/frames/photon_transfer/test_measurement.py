"""Photon transfer against a sensor of a few lines of numpy: values within their stated errors, or unknown."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from lfcal.base.errors import InputError
from lfcal.camera import Camera, Sensor, preset
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame
from lfcal.frames.photon_transfer.measurement import measure_sensor
from lfcal.frames.photon_transfer.result import SensorMeasurement, figures_of, sensor_differences

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
    lit, dark = array_frames(flats, exposures.get("lit_s")), array_frames(darks, exposures.get("dark_s"))
    return measure_sensor(lit, dark, cfa=cfa)


@functools.cache
def plain() -> SensorMeasurement:
    return measured(PLAIN.flats(LEVELS), PLAIN.darks(4))


ALL = "gain read_noise_e prnu dsnu_e"
# name to (sensor, levels, scene, frames a level, what must be known, what must be unknown)
GRID: dict[str, tuple[Truth, Any, Callable[..., Any] | None, int, str, str]] = {
    "even": (PLAIN, LEVELS, None, 2, f"{ALL} black_level", "saturation linearity"),
    "vignetting": (PLAIN, LEVELS, vignetting, 2, f"{ALL} black_level", ""),
    "one even pair": (PLAIN, [0.5], None, 2, "gain read_noise_e dsnu_e black_level", "saturation"),
    "one white image through lenslets": (PLAIN, [0.9], micro_images, 2, "gain read_noise_e dsnu_e", "prnu"),
    "eight white images": (PLAIN, [0.5], micro_images, 8, "gain read_noise_e dsnu_e", "prnu"),
    "odd number of frames": (PLAIN, [0.3, 0.6], vignetting, 3, ALL, ""),
    "many electrons a count": (
        PLAIN.but(bits=8, gain=0.0125, black=10.3, read_e=50.0, dsnu_e=30.0),
        *([*LEVELS, 1.3], vignetting, 2, "gain read_noise_e prnu saturation", ""),
    ),
    "rounding hides the read noise": (
        PLAIN.but(bits=8, gain=0.0125, black=10.0),
        *(LEVELS, vignetting, 2, "gain prnu", "read_noise_e dsnu_e"),
    ),
    "many counts an electron": (
        PLAIN.but(bits=16, gain=3.0, black=100.0, read_e=1.2),
        *(LEVELS, vignetting, 2, ALL, ""),
    ),
    "few electrons": (PLAIN.but(gain=20.0, black=300.0, read_e=2.0), LEVELS, vignetting, 2, "gain read_noise_e", ""),
    "black at zero": (PLAIN.but(black=0.0), LEVELS, None, 2, "gain read_noise_e prnu", "black_level dsnu_e"),
    "hot and dead pixels": (PLAIN.but(hot=40, dead=25), LEVELS, vignetting, 2, ALL, ""),
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
        if case in ("even", "one white image through lenslets", "few electrons"):
            assert found.gain is not None and found.gain.sigma < 0.02 * found.gain.value, "no wider than the scatter"
    assert np.abs(away).max() < 4.2, dict(zip(known * 3, away, strict=False))
    assert np.mean(np.square(away)) < 3.0


def near(found: Any, truth: float, sigmas: float = 4.0) -> bool:
    """Return whether a value is known and lies within its stated error."""
    return found is not None and abs(found.value - truth) < sigmas * found.sigma


def full_before_the_end() -> SensorMeasurement:
    """Measure a well that fills below the converter's end."""
    truth = PLAIN.but(well_e=12_000.0)
    return measured(truth.flats([0.1, 0.3, 0.5, 0.7, 0.9, 1.05, 1.3, 1.6]), truth.darks(4))


def test_defects_are_counted_and_left_out() -> None:
    _, found = found_of("hot and dead pixels", 0)
    assert (found.hot, found.dead) == (40, 25)
    _, clean = found_of("vignetting", 0)
    assert (clean.hot, clean.dead) == (0, 0)


def test_clipping_is_the_saturation_and_its_electrons_the_full_well() -> None:
    found = measured(PLAIN.flats([*LEVELS, 1.1, 1.5]), PLAIN.darks(4))
    assert near(found.full_well_e, PLAIN.full_e) and near(found.gain, 0.2)
    assert found.saturation is not None and found.saturation.value == 4095
    pair = measured(PLAIN.flats([1.2], 2, micro_images(SHAPE)), PLAIN.darks(4))  # through lenslets
    assert pair.saturation is not None and pair.saturation.value == 4095 and near(pair.gain, 0.2)
    # a well that fills below the converter's end is found where the variance breaks
    early = full_before_the_end()
    assert early.full_well_e is not None and near(early.saturation, 64 + 0.2 * 12_000, 2) and near(early.gain, 0.2)
    assert early.saturation is not None and early.saturation.sigma < 150


def flicker(rolling: bool) -> list[Any]:
    rng = np.random.default_rng(3)
    rows = np.arange(SHAPE[0])[:, None]
    frames = []
    for k, share in enumerate(LEVELS):
        for n in range(2):
            lamp = 1 + 0.05 * (np.sin(rows / 12 + 6 * rng.random()) if rolling else rng.standard_normal())
            frames.append(PLAIN.frame(share * PLAIN.full_e * micro_images(SHAPE) * lamp, key=10 * k + n))
    return frames


def test_light_that_flickers_or_drifts_is_allowed_for() -> None:
    for rolling, words in ((False, "within a pair"), (True, "row to row")):
        found = measured(flicker(rolling), PLAIN.darks(4))
        assert near(found.gain, 0.2) and found.gain.sigma < 0.0025 and found.doubts == ()  # type: ignore[union-attr]
        assert any(words in note for note in found.notes)
    # five per cent of the light are a fifth of all counts less a wrong black level
    truth = PLAIN.but(black=800.0)
    light = 1000.0 / truth.gain
    found = measured([truth.frame(light, key=0), truth.frame(1.05 * light, key=1)], truth.darks(4))
    assert near(found.gain, 0.2)


def test_samples_that_are_left_aligned_cut_or_stretched_are_noted() -> None:
    flats, darks = PLAIN.flats(LEVELS), PLAIN.darks(4)
    aligned = measured([f << 4 for f in flats], [f << 4 for f in darks])
    assert aligned.shift == 4 and aligned.bits == 12 and aligned.gain == plain().gain
    assert aligned.black_level == plain().black_level and "left-aligned by 4" in aligned.notes[0]
    # black at 4.0 between two values of 8 bits: all of the variance there is rounding
    cut = measured([f >> 4 for f in flats], [d >> 4 for d in darks])
    assert cut.read_noise_e is None and any("hidden by rounding" in note for note in cut.notes)
    truth = Truth(shape=SHAPE, bits=10, black=20.0, gain=0.05)
    wide = [[np.rint(f * (4095 / 1023)).astype(np.uint16) for f in of] for of in (truth.flats(LEVELS), truth.darks(4))]
    assert any("stretched" in note for note in measured(*wide).notes)
    found = measured([frame.astype(np.uint32) * 1000 for frame in PLAIN.flats([0.3, 0.5])], darks)
    assert found.bits > 16
    with pytest.raises(InputError, match="bit depth"):
        found.camera(preset("bench"))


def test_linearity_and_dark_current_from_exposures() -> None:
    truth = PLAIN.but(dark_e_s=20.0)
    times = [0.01, 0.1, 0.2, 0.3, 0.4, 0.5]
    flats = [truth.frame(t * 1.8 * truth.full_e, t, key=int(1000 * t) + n) for t in times for n in range(2)]
    seconds = [0.01] * 4 + [2.0] * 4 + [5.0] * 4
    darks = [truth.frame(0.0, t, key=7000 + k) for k, t in enumerate(seconds)]
    found = measured(flats, darks, lit_s=[t for t in times for _ in range(2)], dark_s=seconds)
    assert found.linearity is not None and found.linearity.value < 0.001
    assert near(found.dark_current_e_s, 20) and found.dark_current_e_s.sigma < 0.25  # type: ignore[union-attr]
    assert near(found.black_level, 64), "at no exposure, dark current subtracted"
    bent = [np.rint(64 + (f - 64.0) * (1 - 0.04 * (f - 64.0) / 4031)).astype(np.uint16) for f in flats]
    known = measured(bent, darks, lit_s=[t for t in times for _ in range(2)], dark_s=seconds)
    assert known.linearity is not None
    # the largest relative departure of x (1 - 0.04 x) from its own straight line, by hand
    x = np.array(times[1:]) * 1.8
    y = x * (1 - 0.04 * x)
    line = np.linalg.lstsq(np.stack([1 / y, x / y], axis=1), np.ones(5), rcond=None)[0]
    by_hand = np.abs(y - line[0] - line[1] * x) / (line[0] + line[1] * x)
    assert known.linearity.value == pytest.approx(by_hand.max(), rel=0.2)


def test_dark_current_that_the_camera_subtracts_is_measured_by_its_noise() -> None:
    truth = PLAIN.but(dark_e_s=200.0)
    seconds = [0.01] * 6 + [4.0] * 6
    darks = [truth.frame(0.0, t, key=k) for k, t in enumerate(seconds)]
    held = [np.clip(np.rint(d - 0.2 * 200 * t), 0, None).astype(np.uint16) for d, t in zip(darks, seconds, strict=True)]
    found = measured(truth.flats(LEVELS), held, dark_s=seconds)
    assert near(found.dark_current_e_s, 200) and found.dark_current_e_s.sigma < 10  # type: ignore[union-attr]
    assert any("the camera subtracts dark current" in note for note in found.notes)


def test_colours_are_measured_at_their_own_levels() -> None:
    scene = np.tile(np.array([[0.4, 1.0], [1.0, 0.3]]), (SHAPE[0] // 2, SHAPE[1] // 2))
    found = measured(PLAIN.flats(LEVELS, scene=scene), PLAIN.darks(4), "RGGB")
    assert set(found.channels) == {"R", "G1", "G2", "B"} and found.doubts == ()
    assert all(near(gain, 0.2, 4.2) for gain in [found.gain, *found.channels.values()]) and near(found.prnu, 0.01)
    unknown = measured(PLAIN.flats(LEVELS, scene=scene), PLAIN.darks(4))
    assert near(unknown.gain, 0.2), "sorted by brightness"
    assert unknown.prnu is None, "a mosaic that is not stated is structure"


def test_copies_singles_and_swapped_folders_are_refused() -> None:
    flats, darks = PLAIN.flats([0.5]), PLAIN.darks(2)
    for lit, dark, words in (
        ([flats[0], flats[0]], darks, "remove the copies"),
        (flats, [darks[0], darks[0]], "remove the copies"),
        (flats, darks[:1], "record at least a pair"),
        (flats[:1], darks, "record pairs"),
        (darks, flats, "exchange flats and darks"),
        ([f[:-2] for f in flats], darks, "the same sensor settings"),
        ([f[:6, :6] for f in flats], [d[:6, :6] for d in darks], "1000 pixels"),
        ([np.where(f > 3, np.nan, f) for f in flats], darks, "finite"),
    ):
        with pytest.raises(InputError, match=words):
            measured(lit, dark)


# -- frames that are not the sensor's own ------------------------------------------------------------------------------


def gamma(frame: Any) -> Any:
    return np.rint(255 * np.clip((frame.astype(float) - 40) / 4055, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def smoothed(frame: Any) -> Any:
    return np.rint(ndimage.uniform_filter(frame.astype(float), 3)).astype(np.uint16)


def sharpened(frame: Any) -> Any:
    values = frame.astype(float)
    return np.clip(np.rint(2 * values - ndimage.gaussian_filter(values, 1.0)), 0, 4095).astype(np.uint16)


def median(frame: Any) -> Any:
    return ndimage.median_filter(frame, 3)


def test_processed_frames_are_doubted() -> None:
    lit, dark = PLAIN.flats(LEVELS, scene=vignetting(SHAPE)), PLAIN.darks(4)
    for process, words in (
        *((gamma, "not proportional to the light"), (smoothed, "smoothed"), (median, "smoothed")),
        *((sharpened, "sharpened"), (lambda frame: frame / 4095, "not whole numbers")),
    ):
        found = measured([process(f) for f in lit], [process(d) for d in dark])
        assert any(words in doubt for doubt in found.doubts), found.doubts
        with pytest.raises(InputError, match="record raw flats and darks"):
            found.camera(preset("bench"))
    balanced = PLAIN.but(white_balance=(1.9, 1.0, 1.0, 1.5))
    found = measured(balanced.flats(LEVELS * 0.5), balanced.darks(4), "RGGB")
    assert any("white balance" in doubt for doubt in found.doubts)


def means(frames: list[Any]) -> list[Any]:
    return [np.mean(frames[k : k + 4], axis=0) for k in range(0, len(frames), 4)]


def mixed(frames: list[Any]) -> list[Any]:
    """Return what a temporal filter makes of successive frames, once it has settled."""
    held = [frames[0].astype(float)]
    for frame in frames[1:]:
        held.append(0.5 * held[-1] + 0.5 * frame)
    return [np.rint(frame).astype(np.uint16) for frame in held[4:]]


def test_frames_that_were_mixed_or_averaged_are_doubted_and_darks_subtracted_before_are_not() -> None:
    flats = [f for k, share in enumerate(LEVELS[::2]) for f in mixed(PLAIN.flats([share], 8, key=1000 * k))]
    found = measured(flats, mixed(PLAIN.darks(8)))
    assert any("successive frames" in doubt for doubt in found.doubts), found.doubts
    assert measured(PLAIN.flats(LEVELS[::2], 4), PLAIN.darks(4)).doubts == ()
    found = measured(means(PLAIN.flats(LEVELS[::2], 8)), means(PLAIN.darks(8)))
    assert any("means of 4 frames" in doubt for doubt in found.doubts)
    level = np.mean(PLAIN.darks(4, key=60_000), axis=0)
    off = measured([f - level for f in PLAIN.flats(LEVELS)], [d - level for d in PLAIN.darks(4)])
    assert off.doubts == () and near(off.gain, 0.2)
    assert near(off.read_noise_e, 8), "darks about zero have no light to compare"
    assert off.black_level is not None and off.black_level.value == pytest.approx(0, abs=0.05)


def test_light_or_a_camera_that_moved_within_a_pair_is_doubted() -> None:
    waves = [1 + 0.1 * np.sin(np.arange(SHAPE[1]) / 10 + k) + np.zeros(SHAPE) for k in (0, 1)]
    scene = micro_images((SHAPE[0] + 4, SHAPE[1] + 4))
    shifted = [ndimage.shift(scene, (by, by), order=3)[2:-2, 2:-2] for by in (0.0, 0.05)]
    for share, light in ((0.5, waves), (0.8, shifted)):
        flats = [PLAIN.frame(share * PLAIN.full_e * one, key=k) for k, one in enumerate(light)]
        found = measured(flats, PLAIN.darks(4))
        assert any("moved between" in doubt for doubt in found.doubts)


def test_frames_scaled_in_one_folder_only_are_doubted() -> None:
    """Raw darks with scaled flats had the converter's end at the brightest dark."""
    for which in ("flats", "darks"):
        frames = {"flats": PLAIN.flats([0.3, 0.5]), "darks": PLAIN.darks(4)}
        frames[which] = [(frame * 1.37).astype(np.float32) for frame in frames[which]]
        found = measured(frames["flats"], frames["darks"])
        assert any("not whole numbers" in doubt for doubt in found.doubts)
        assert found.bits >= 11


def test_measured_values_become_the_cameras_with_their_mark() -> None:
    found = measured(PLAIN.flats([*LEVELS, 1.3]), PLAIN.darks(4))
    before = preset("bench")
    camera = found.camera(before)
    sensor = camera.sensor
    assert sensor.electrons_per_count == pytest.approx(5.0, rel=0.02)
    assert sensor.full_well_e == pytest.approx((4095 - sensor.black_level) * sensor.electrons_per_count)
    assert (sensor.bit_depth, sensor.saturation, sensor.shape) == (12, 4095.0, before.sensor.shape)
    assert sensor.read_noise_e == pytest.approx(8, rel=0.03) and sensor.dsnu_e == pytest.approx(3, rel=0.05)
    for name in ("full_well_e", "read_noise_e", "black_level", "prnu", "dsnu_e", "saturation"):
        assert camera.marks[f"sensor.{name}"] == "measured"
    assert sensor.dark_current_e_s == before.sensor.dark_current_e_s, "not measured here, so it stays"
    assert camera.marks["sensor.dark_current_e_s"] == "stated"


# -- what is reported, and what a camera takes over --------------------------------------------------------------------


BENCH: Camera = preset("bench")


@pytest.fixture(scope="module")
def dim() -> SensorMeasurement:
    """Return a measurement whose brightest flat is half full."""
    return measured(PLAIN.flats(LEVELS[:4], 2, vignetting(SHAPE)), PLAIN.darks(4))


@pytest.fixture(scope="module")
def clipped() -> SensorMeasurement:
    return full_before_the_end()


def rows(found: SensorMeasurement, known: Sensor | None = None) -> dict[str, str]:
    return dict(figures_of(found, known))


def test_a_full_well_that_no_flat_reached_is_said_with_what_it_is_above(dim: SensorMeasurement) -> None:
    said = rows(dim)
    assert dim.full_well_e is None and dim.electrons_per_count is not None
    assert said["full well"].startswith("above ") and said["full well"].endswith(" e⁻ (not reached)")
    above = float(said["full well"].split()[1].replace(",", ""))
    counts = float(said["saturated from"].split()[1].replace(",", ""))
    assert above == pytest.approx((counts - 64) * dim.electrons_per_count.value, rel=0.01) and 5_000 < above < 10_000
    assert any("not reached" in note for note in dim.notes)
    assert "  for the camera" not in said


def test_the_full_well_stated_for_the_camera_is_the_one_it_takes(
    dim: SensorMeasurement, clipped: SensorMeasurement
) -> None:
    """Also where pixels are full far below the highest sample value: both figures are stated, by their names."""
    for found in (dim, clipped):
        taken, _ = found.sensor(BENCH.sensor)
        said = rows(found, BENCH.sensor)["  for the camera"]
        assert said.startswith(f"{taken.full_well_e:.0f} ± ") and said.endswith("e⁻ at its highest count, 4095")
    assert clipped.full_well_e is not None
    assert rows(clipped, BENCH.sensor)["full well"] == f"{clipped.full_well_e} e⁻"


def test_nothing_is_stated_for_the_camera_where_nothing_is_taken(dim: SensorMeasurement) -> None:
    doubtful = replace(dim, doubts=("smoothed",))
    assert "  for the camera" not in rows(doubtful, BENCH.sensor)
    blind = rows(replace(dim, gain=None), BENCH.sensor)
    assert blind["full well"] == blind["saturated from"] == "unknown" and "  for the camera" not in blind


def test_a_stated_saturation_stays_unless_the_frames_contradict_it(
    dim: SensorMeasurement, clipped: SensorMeasurement
) -> None:
    known = replace(BENCH.sensor, bit_depth=12, saturation=3900.0)
    assert dim.sensor(known)[0].saturation == 3900.0
    assert dim.sensor(replace(known, saturation=dim.brightest - 1))[0].saturation is None
    assert dim.sensor(replace(known, bit_depth=10, saturation=900.0))[0].saturation is None
    assert clipped.saturation is not None and clipped.sensor(known)[0].saturation == clipped.saturation.value


def test_frames_of_another_size_or_gain_are_said(dim: SensorMeasurement) -> None:
    own = replace(BENCH.sensor, shape=SHAPE, black_level=64.0, full_well_e=4031 * 5.0)
    assert sensor_differences(dim, own) == []
    assert dim.shape == SHAPE
    (size,) = sensor_differences(dim, replace(own, shape=(320, 320)))
    assert "120 × 160" in size and "320 × 320" in size
    (gain,) = sensor_differences(dim, replace(own, full_well_e=4031 * 20.0))
    assert "times as many electrons per count" in gain and "averaged" in gain


def test_each_channel_has_its_gain() -> None:
    mosaic = PLAIN.but(white_balance=(1.0, 1.5, 1.5, 2.0))
    found = measured(mosaic.flats(LEVELS[:4], 2, vignetting(SHAPE)), mosaic.darks(4), "RGGB")
    said = rows(found)
    for name, factor in (("R", 1.0), ("B", 2.0)):
        assert float(said[f"  {name}"].split()[0]) == pytest.approx(0.2 * factor, rel=0.1)
        assert said[f"  {name}"].endswith("counts per e⁻")
