"""Measured files of others pass through readers and corrections."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rawpy

from lfcal.base.errors import FileFormatError
from lfcal.frames import (
    CorrectionChain,
    Dark,
    FrameEntry,
    Manifest,
    Position,
    White,
    balanced_source,
    channel_source,
    corrected,
    open_frames,
    open_image,
    read_image,
)
from lfcal.frames.source import observed
from tests.frames.scenes import shared

RAW = "bayer_raw/RAW_KODAK_DC50.KDC"


def test_kodak_mosaic_is_untouched() -> None:
    path = shared(RAW)
    image = open_image(path)
    assert image.metadata["cfa"] == "GRBG" and image.shape == (512, 768) and image.dtype == np.uint16
    with rawpy.imread(str(path)) as raw:
        visible = raw.raw_image_visible.copy()
        colours = raw.raw_colors_visible
    assert image.read().tobytes() == visible.tobytes()
    np.testing.assert_array_equal(image.read_region(0, slice(5, 90), slice(7, 8)), visible[5:90, 7:8])
    letters = np.array(list("GRBG")).reshape(2, 2)
    assert (
        letters[np.indices(visible.shape)[0] % 2, np.indices(visible.shape)[1] % 2] == np.array(list("RGBG"))[colours]
    ).all()


def test_kodak_frame_feeds_the_core_by_channel(tmp_path: Path) -> None:
    shutil.copy(shared(RAW), tmp_path / "y0_x0.kdc")
    source = open_frames(tmp_path, pattern="y{y}_x{x}.kdc")
    frame = source.read(0)
    for name, (r, c) in {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}.items():
        np.testing.assert_array_equal(channel_source(source, name).read(0), frame[r::2, c::2])
    np.testing.assert_array_equal(balanced_source(source).read(0), frame.astype(np.float32))
    assert source.metadata.saturation == 16383
    assert source.samples(0).saturated == np.count_nonzero(frame == 16383)


@pytest.mark.parametrize("keep", [0.999, 0.5, 0.2, 0.01])
def test_truncated_kodak_raw(tmp_path: Path, keep: float) -> None:
    data = shared(RAW).read_bytes()
    (tmp_path / "a.kdc").write_bytes(data[: int(keep * len(data))])
    with pytest.raises(FileFormatError, match=r"a\.kdc: expected an intact camera RAW file, got damaged data \("):
        read_image(tmp_path / "a.kdc")


def test_kodak_raw_against_a_wrong_pattern(tmp_path: Path) -> None:
    shutil.copy(shared(RAW), tmp_path / "a.kdc")
    for wrong in ("RGGB", "BGGR", "GBRG"):
        manifest = Manifest((FrameEntry("a.kdc", Position(0, 0, 0)),), cfa=wrong)
        with pytest.raises(FileFormatError, match=f"colour filter: expected {wrong}, got GRBG"):
            open_frames(tmp_path, manifest=manifest)


def test_microscope_trio_dark_and_white_corrected() -> None:
    light, white, dark = (
        read_image(shared(f"lfm_guv/{name}_GUVExperim1.tif")) for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    assert [f.shape for f in (light, white, dark)] == [(436, 436)] * 3 and white.dtype == np.uint16
    chain = CorrectionChain((Dark(dark), White(white, dark)))
    clean = chain.apply(light)

    gain = 1 / np.maximum((white.astype(float) - dark) / np.percentile(white.astype(float) - dark, 99), 0.05)
    np.testing.assert_allclose(clean, (light.astype(float) - dark) * gain, rtol=1e-5, atol=1e-2)
    assert clean.min() < 0, "below the dark level stays negative"
    # The same correction turns the white frame itself flat wherever it is not too dim to divide by.
    flat = chain.apply(white)
    bright = ~chain.steps[1].dim  # type: ignore[union-attr]
    assert bright.mean() > 0.9
    assert np.ptp(flat[bright]) / flat[bright].mean() < 1e-5
    assert observed(light, 65535).saturated == 0
    # What the lenslets' vignetting prints on the light field goes: it no longer looks like the white frame.
    lit = white.astype(float) - dark
    before, after = (np.corrcoef(f.ravel(), lit.ravel())[0, 1] for f in (light.astype(float) - dark, clean))
    assert 0.6 < before < 0.7 and after < 0.75 * before


def test_microscope_trio_as_a_session() -> None:
    root = shared("lfm_guv")
    manifest = Manifest(
        (FrameEntry("Lightfield_GUVExperim1.tif", Position(0, 0, 0)),), shape=(436, 436), dtype="uint16"
    )
    source = open_frames(root, manifest=manifest)
    dark = read_image(root / "DarkFrame_GUVExperim1.tif")
    view = corrected(source, CorrectionChain((Dark(dark),)))
    np.testing.assert_array_equal(view.read(0), source.read(0).astype(np.float32) - dark)
    np.testing.assert_array_equal(view.read(0, (slice(100, 281), slice(50, 231))), view.read(0)[100:281, 50:231])
