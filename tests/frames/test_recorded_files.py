"""Recorded files pass through readers and corrections: those of the sample data, and measured ones of others.

The simulator wrote the sample data through export and recording, as users' files are written: frames, darks and whites
in a folder, and a packed session. Tests of measured files are skipped where the folder of shared data is absent.
"""

from __future__ import annotations

import json
import shutil
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
from tests.frames.scenes import shared, write_dng

SAMPLE = sample_session()
FULL = 1023
"""Where the samples of `write_dng` end."""


def mean(name: str) -> NDArray[np.float64]:
    frames = [read_image(path).astype(float) for path in sorted((SAMPLE / name).glob("*.png"))]
    assert len(frames) > 3
    return np.mean(frames, axis=0)


@pytest.fixture(params=["recorded", "measured"])
def raw(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """Return a RAW file of Kodak, or recorded light behind a mosaic; some of it is saturated."""
    if request.param == "measured":
        return Path(shutil.copy(shared("bayer_raw/RAW_KODAK_DC50.KDC"), tmp_path / "y0_x0.kdc"))
    light = read_image(sorted((SAMPLE / "frames").glob("*.png"))[40])
    write_dng(tmp_path / "y0_x0.dng", np.minimum(light, FULL).astype(np.uint16))
    return tmp_path / "y0_x0.dng"


def test_a_raw_mosaic_is_untouched(raw: Path) -> None:
    image = open_image(raw)
    assert image.metadata["cfa"] == "GRBG" and image.dtype == np.uint16
    assert image.shape == ((80, 96) if raw.suffix == ".dng" else (512, 768))
    with rawpy.imread(str(raw)) as opened:
        visible = opened.raw_image_visible.copy()
        colours = opened.raw_colors_visible
    assert image.read().tobytes() == visible.tobytes()
    np.testing.assert_array_equal(image.read_region(0, slice(5, 70), slice(7, 8)), visible[5:70, 7:8])
    letters = np.tile(np.array(list("GRBG")).reshape(2, 2), np.array(visible.shape) // 2)
    assert (letters == np.array(list("RGBG"))[colours]).all()


def test_a_raw_frame_is_read_channel_by_channel(raw: Path) -> None:
    source = open_frames(raw.parent, pattern=f"y{{y}}_x{{x}}{raw.suffix}")
    frame, full = source.read(0), FULL if raw.suffix == ".dng" else 16383
    for name, (r, c) in {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}.items():
        np.testing.assert_array_equal(channel_source(source, name).read(0), frame[r::2, c::2])
    balanced = balanced_source(source).read(0)
    assert balanced.shape == frame.shape and (raw.suffix == ".dng" or np.array_equal(balanced, frame))
    assert source.metadata.saturation == full
    assert source.samples(0).saturated == np.count_nonzero(frame == full) and (raw.suffix == ".kdc" or full in frame)
    for wrong in ("RGGB", "BGGR", "GBRG"):
        manifest = Manifest((FrameEntry(raw.name, Position(0, 0, 0)),), cfa=wrong)
        with pytest.raises(FileFormatError, match=f"colour filter: expected {wrong}, got GRBG"):
            open_frames(raw.parent, manifest=manifest)


def test_a_raw_file_that_ends_early_is_refused(raw: Path) -> None:
    data = raw.read_bytes()
    for keep in (0.9 if raw.suffix == ".dng" else 0.999, 0.5, 0.2, 0.01):
        raw.write_bytes(data[: int(keep * len(data))])
        with pytest.raises(FileFormatError, match=rf"{raw.name}: expected an intact camera RAW file, got "):
            read_image(raw)


@pytest.mark.parametrize("files", ["recorded", "measured"])
def test_light_white_and_dark_are_corrected(files: str) -> None:
    if files == "recorded":
        light, white, dark = read_image(sorted((SAMPLE / "frames").glob("*.png"))[40]), mean("white"), mean("dark")
    else:
        names = ("Lightfield", "Radiometry", "DarkFrame")
        light, white, dark = (read_image(shared(f"lfm_guv/{name}_GUVExperim1.tif")) for name in names)
    lit = white.astype(float) - dark
    chain = CorrectionChain((Dark(dark), White(white, dark)))
    clean = chain.apply(light)
    gain = 1 / np.maximum(lit / np.percentile(lit, 99), 0.05)
    np.testing.assert_allclose(clean, (light.astype(float) - dark) * gain, rtol=1e-5, atol=1e-2)
    assert clean.min() < 0, "below the dark level stays negative"
    # the same correction turns the white frame itself flat wherever it is not too dim to divide by
    flat, bright = chain.apply(white), ~chain.steps[1].dim  # type: ignore[union-attr]
    assert np.ptp(lit) / lit.mean() > 0.3 and bright.mean() > 0.9 and np.ptp(flat[bright]) / flat[bright].mean() < 1e-5
    if files == "measured":
        assert observed(light, 65535).saturated == 0
        # the vignetting of the lenslets goes: the light field no longer looks like the white frame
        before, after = (np.corrcoef(f.ravel(), lit.ravel())[0, 1] for f in (light.astype(float) - dark, clean))
        assert 0.6 < before < 0.7 and after < 0.75 * before
    else:
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
