"""Recorded files pass through readers and corrections on any machine: what `test_real_files` looks at in measured ones.

The files are those of the sample data, which the simulator wrote through export and recording as users' files are
written: frames, darks and whites in a folder, and a packed session.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from lfcal.acquire.recording.source import read_checks
from lfcal.base.errors import FileFormatError
from lfcal.camera import Camera, ScanPlan
from lfcal.frames import (
    CorrectionChain,
    CorrectionRecipe,
    Dark,
    FrameEntry,
    Manifest,
    Position,
    White,
    balanced_source,
    channel_source,
    corrected,
    corrected_view,
    open_frames,
    open_image,
    read_image,
)
from lfcal.frames.source import observed
from lfcal.lattice import fit_lattice
from lfcal.simulate import sample_session
from tests.frames.scenes import write_dng

SAMPLE = sample_session()
FULL = 1023
"""Where the samples of `write_dng` end."""


def mean(name: str) -> NDArray[np.float64]:
    frames = [read_image(path).astype(float) for path in sorted((SAMPLE / name).glob("*.png"))]
    assert len(frames) > 3
    return np.mean(frames, axis=0)


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """Return a RAW file: recorded light behind a mosaic that begins with green and red, some of it saturated."""
    light = read_image(sorted((SAMPLE / "frames").glob("*.png"))[40])
    write_dng(tmp_path / "y0_x0.dng", np.minimum(light, FULL).astype(np.uint16))
    return tmp_path / "y0_x0.dng"


def test_a_raw_mosaic_is_untouched(raw: Path) -> None:
    image = open_image(raw)
    assert image.metadata["cfa"] == "GRBG" and image.shape == (80, 96) and image.dtype == np.uint16
    with rawpy.imread(str(raw)) as opened:
        visible = opened.raw_image_visible.copy()
        colours = opened.raw_colors_visible
    assert visible.max() == FULL and image.read().tobytes() == visible.tobytes()
    np.testing.assert_array_equal(image.read_region(0, slice(5, 70), slice(7, 8)), visible[5:70, 7:8])
    letters = np.array(list("GRBG")).reshape(2, 2)
    assert (
        letters[np.indices(visible.shape)[0] % 2, np.indices(visible.shape)[1] % 2] == np.array(list("RGBG"))[colours]
    ).all()


def test_a_raw_frame_feeds_the_core_by_channel(raw: Path) -> None:
    source = open_frames(raw.parent, pattern="y{y}_x{x}.dng")
    frame = source.read(0)
    for name, (r, c) in {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}.items():
        np.testing.assert_array_equal(channel_source(source, name).read(0), frame[r::2, c::2])
    assert balanced_source(source).read(0).shape == frame.shape
    assert source.metadata.saturation == FULL
    assert source.samples(0).saturated == np.count_nonzero(frame == FULL) > 0


@pytest.mark.parametrize("keep", [0.9, 0.5, 0.2, 0.01])
def test_a_raw_file_that_ends_early(raw: Path, keep: float) -> None:
    data = raw.read_bytes()
    raw.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(FileFormatError, match=r"y0_x0\.dng: expected an intact camera RAW file, got "):
        read_image(raw)


def test_a_raw_file_against_a_wrong_pattern(raw: Path) -> None:
    for wrong in ("RGGB", "BGGR", "GBRG"):
        manifest = Manifest((FrameEntry(raw.name, Position(0, 0, 0)),), cfa=wrong)
        with pytest.raises(FileFormatError, match=f"colour filter: expected {wrong}, got GRBG"):
            open_frames(raw.parent, manifest=manifest)


def test_light_white_and_dark_are_corrected() -> None:
    light = read_image(sorted((SAMPLE / "frames").glob("*.png"))[40])
    white, dark = mean("white"), mean("dark")
    chain = CorrectionChain((Dark(dark), White(white, dark)))
    clean = chain.apply(light)
    gain = 1 / np.maximum((white - dark) / np.percentile(white - dark, 99), 0.05)
    np.testing.assert_allclose(clean, (light.astype(float) - dark) * gain, rtol=1e-5, atol=1e-2)
    assert clean.min() < 0, "below the dark level stays negative"
    # The same correction turns the white frame itself flat, and what the lenslets print on it goes.
    flat = chain.apply(white)
    assert np.ptp(white - dark) / (white - dark).mean() > 0.3 and np.ptp(flat) / flat.mean() < 1e-5
    assert observed(light, 4095).saturated == 0


def test_a_folder_as_a_session() -> None:
    plan = ScanPlan.from_json((SAMPLE / "plan.json").read_text(encoding="utf-8"))
    with open_frames(SAMPLE / "frames", plan_shape=plan.shape[:3]) as source:
        dark = mean("dark")
        view = corrected(source, CorrectionChain((Dark(dark),)))
        np.testing.assert_allclose(view.read(7), source.read(7).astype(np.float64) - dark, atol=1e-3)
        part = (slice(10, 65), slice(21, 76))
        np.testing.assert_array_equal(view.read(7, part), view.read(7)[part])
        made = corrected_view(source, CorrectionRecipe(dark=SAMPLE / "dark"), plan)
        np.testing.assert_allclose(made.read(7), view.read(7), atol=1e-3)


def test_a_recorded_session_brings_its_places_and_its_darks() -> None:
    recorded = SAMPLE.parent / ("recorded" if SAMPLE.name == "session" else "_sample_recorded")
    with open_frames(recorded) as source:
        info, frame = source.info(3), source.read(3)
        assert info.points and info.origin is not None and info.exposure_s and info.saturated == 0
        assert frame.shape == source.shape and frame.dtype == np.uint16 and frame.max() > 1000
        plan = ScanPlan.from_dict(json.loads((recorded / "session.json").read_text(encoding="utf-8"))["plan"])
        view = corrected_view(source, CorrectionRecipe(), plan)
        # the darks that the session brings: what is left where no light falls is noise about zero
        assert abs(np.median(view.read(3))) < 3 < np.median(frame) < 100
    assert len(read_checks(recorded)) > 0


def test_the_lattice_of_a_recorded_white_image_is_the_cameras() -> None:
    camera = Camera.from_json((SAMPLE / "camera.json").read_text(encoding="utf-8"))
    found = fit_lattice(mean("white"), dark=mean("dark"))
    assert found.kind == camera.lattice.kind == "hexagonal" and found.form == "affine"
    pitch = camera.lattice.pitch_um / camera.sensor.pixel_um
    assert found.pitch_px == pytest.approx(pitch, abs=4 * found.pitch_error_px) and found.pitch_error_px < 0.01
    assert abs(found.rotation_rad - camera.lattice.rotation_rad) < 1e-3 and found.residual_rms_px < 0.05
    middle = (np.array(camera.sensor.shape) - 1) / 2
    np.testing.assert_allclose(found.origin_px, middle, atol=0.25)
