"""Frames that are not the sensor's own are told from those that are, and do not become a camera's figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from lfcal.base.errors import InputError
from lfcal.camera import preset

from .sensor_model import Truth, micro_images, vignetting
from .test_measurement import LEVELS, PLAIN, SHAPE, measured


def gamma(frame: Any) -> Any:
    return np.rint(255 * np.clip((frame.astype(float) - 40) / 4055, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def smoothed(frame: Any) -> Any:
    return np.rint(ndimage.uniform_filter(frame.astype(float), 3)).astype(np.uint16)


def sharpened(frame: Any) -> Any:
    values = frame.astype(float)
    return np.clip(np.rint(2 * values - ndimage.gaussian_filter(values, 1.0)), 0, 4095).astype(np.uint16)


def median(frame: Any) -> Any:
    return ndimage.median_filter(frame, 3)


@pytest.mark.parametrize(
    ("processed", "words"),
    [(gamma, "not proportional to the light"), (smoothed, "smoothed"), (median, "smoothed"), (sharpened, "sharpened")],
)
def test_processed_frames_are_doubted(processed: Callable[[Any], Any], words: str) -> None:
    flats = [processed(f) for f in PLAIN.flats(LEVELS, scene=vignetting(SHAPE))]
    found = measured(flats, [processed(d) for d in PLAIN.darks(4)])
    assert any(words in doubt for doubt in found.doubts), found.doubts
    with pytest.raises(InputError, match="record raw flats and darks"):
        found.camera(preset("bench"))


def mixed(frames: list[Any]) -> list[Any]:
    """Return what a temporal filter makes of successive frames, once it has settled."""
    held = [frames[0].astype(float)]
    for frame in frames[1:]:
        held.append(0.5 * held[-1] + 0.5 * frame)
    return [np.rint(frame).astype(np.uint16) for frame in held[4:]]


def test_a_temporal_noise_filter_is_doubted() -> None:
    flats = [f for k, share in enumerate(LEVELS[::2]) for f in mixed(PLAIN.flats([share], 8, key=1000 * k))]
    found = measured(flats, mixed(PLAIN.darks(8)))
    assert any("successive frames" in doubt for doubt in found.doubts), found.doubts
    raw = measured(PLAIN.flats(LEVELS[::2], 4), PLAIN.darks(4))
    assert raw.doubts == ()


def test_averaged_frames_are_doubted() -> None:
    def means(frames: list[Any]) -> list[Any]:
        return [np.mean(frames[k : k + 4], axis=0) for k in range(0, len(frames), 4)]

    found = measured(means(PLAIN.flats(LEVELS[::2], 8)), means(PLAIN.darks(8)))
    assert any("means of 4 frames" in doubt for doubt in found.doubts)


def test_scaled_floats_are_doubted_and_darks_taken_off_before_are_not() -> None:
    flats, darks = PLAIN.flats(LEVELS), PLAIN.darks(4)
    scaled = measured([f / 4095 for f in flats], [d / 4095 for d in darks])
    assert any("not whole numbers" in doubt for doubt in scaled.doubts)
    level = np.mean(PLAIN.darks(4, key=60_000), axis=0)
    off = measured([f - level for f in flats], [d - level for d in darks])
    assert off.doubts == () and off.gain is not None and off.black_level is not None
    assert off.read_noise_e is not None
    assert abs(off.read_noise_e.value - 8) < 4 * off.read_noise_e.sigma, "darks about zero have no light to compare"
    assert abs(off.gain.value - 0.2) < 4 * off.gain.sigma and off.black_level.value == pytest.approx(0, abs=0.05)


def test_samples_cut_to_8_bits_do_not_show_their_read_noise() -> None:
    """Black at 4.0 between two values: all of the variance there is rounding."""
    found = measured([f >> 4 for f in PLAIN.flats(LEVELS)], [d >> 4 for d in PLAIN.darks(4)])
    assert found.read_noise_e is None and any("hidden by rounding" in note for note in found.notes)


def test_light_that_moves_over_the_frame_is_doubted() -> None:
    columns = np.arange(SHAPE[1])
    flats = [
        PLAIN.frame(0.5 * PLAIN.full_e * (1 + 0.1 * np.sin(columns / 10 + k)) + np.zeros(SHAPE), key=k) for k in (0, 1)
    ]
    found = measured(flats, PLAIN.darks(4))
    assert any("moved between" in doubt for doubt in found.doubts)


def test_a_camera_that_moved_within_a_pair_is_doubted() -> None:
    scene = micro_images((SHAPE[0] + 4, SHAPE[1] + 4))
    flats = [
        PLAIN.frame(0.8 * PLAIN.full_e * ndimage.shift(scene, (by, by), order=3)[2:-2, 2:-2], key=k)
        for k, by in enumerate((0.0, 0.05))
    ]
    found = measured(flats, PLAIN.darks(4))
    assert any("moved between" in doubt for doubt in found.doubts)


def test_digital_white_balance_is_doubted() -> None:
    truth = PLAIN.but(white_balance=(1.9, 1.0, 1.0, 1.5))
    found = measured(truth.flats(LEVELS * 0.5), truth.darks(4), "RGGB")
    assert any("white balance" in doubt for doubt in found.doubts)


def test_stretched_samples_are_noted() -> None:
    truth = Truth(shape=SHAPE, bits=10, black=20.0, gain=0.05)

    def stretch(frame: Any) -> Any:
        return np.rint(frame * (4095 / 1023)).astype(np.uint16)

    found = measured([stretch(f) for f in truth.flats(LEVELS)], [stretch(d) for d in truth.darks(4)])
    assert any("stretched" in note for note in found.notes)


@pytest.mark.parametrize("which", ["flats", "darks"])
def test_frames_scaled_in_one_folder_only_are_doubted(which: str) -> None:
    """Raw darks beside scaled flats had the converter's end at the brightest dark."""
    frames = {"flats": PLAIN.flats([0.3, 0.5]), "darks": PLAIN.darks(4)}
    frames[which] = [(frame * 1.37).astype(np.float32) for frame in frames[which]]
    found = measured(frames["flats"], frames["darks"])
    assert any("not whole numbers" in doubt for doubt in found.doubts)
    assert found.bits >= 11


def test_samples_of_more_bits_than_a_camera_has_are_not_taken() -> None:
    found = measured([frame.astype(np.uint32) * 1000 for frame in PLAIN.flats([0.3, 0.5])], PLAIN.darks(4))
    assert found.bits > 16
    with pytest.raises(InputError, match="bit depth"):
        found.camera(preset("bench"))


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
