"""Frames nobody here made: a camera's RAW, a light-field microscope; and Bayer plenoptic frames for the core."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from lfcal.frames import ArraySource, channel_source, open_frames, open_image, read_image
from lfcal.lattice import extract_views, fit_lattice
from lfcal.multiplex import SuperPixelLattice, cfa, demultiplex, lattice_channels, multiplex
from lfcal.psf import Cutout, assemble
from tests.frames.scenes import shared

ROOT = Path(__file__).resolve().parents[2]
COLOURS = np.array([0.6, 1.0, 0.4])


def kodak() -> tuple[NDArray[np.uint16], str]:
    image = open_image(shared("bayer_raw/RAW_KODAK_DC50.KDC"))
    return image.read(), str(image.metadata["cfa"])


def test_linear_route_on_a_raw_frame_is_opencvs_bilinear_demosaic() -> None:
    frame, pattern = kodak()
    assert pattern == "GRBG"
    ours = demultiplex(frame, cfa(pattern), filter="linear")
    theirs = cv2.demosaicing(frame, cv2.COLOR_BayerGRBG2RGB).transpose(2, 0, 1).astype(float)
    inner = (slice(4, -4), slice(4, -4))
    for k in (0, 2):  # red and blue: the same bilinear interpolation, OpenCV rounds to whole numbers
        assert np.abs(ours[k] - theirs[k])[inner].max() <= 0.76
    # green: OpenCV takes the four neighbours and keeps recorded greens; here both green channels are averaged
    green = np.zeros(frame.shape, bool)
    green[0::2, 0::2] = green[1::2, 1::2] = True
    smooth = cv2.sepFilter2D(
        np.where(green, 4.0, 0.0) * frame, -1, np.array([1, 2, 1]) / 4.0, np.array([1, 2, 1]) / 4.0
    )
    mean = cv2.sepFilter2D(np.where(green, 4.0, 0.0), -1, np.array([1, 2, 1]) / 4.0, np.array([1, 2, 1]) / 4.0)
    np.testing.assert_allclose(ours[1][inner], (smooth / mean)[inner], rtol=1e-4)
    wrong = demultiplex(frame, cfa("RGGB"), filter="linear")
    assert np.abs(wrong[0] - theirs[0])[inner].mean() > 10 * np.abs(ours[0] - theirs[0])[inner].mean()


def test_routes_on_a_raw_frame() -> None:
    frame, pattern = kodak()
    cubic, fourier, bilateral = (
        demultiplex(frame.astype(np.float32), cfa(pattern), **o)
        for o in ({}, {"route": "fourier"}, {"filter": "bilateral"})
    )
    span = np.ptp(frame)
    assert np.sqrt(np.mean((cubic - fourier) ** 2)) / span < 0.03
    # a real frame is not band-limited: the Fourier route runs beyond the recorded values more often
    beyond = [np.mean((r > frame.max()) | (r < frame.min())) for r in (bilateral, cubic, fourier)]
    assert beyond[0] < 1e-6 and beyond[0] <= beyond[1] < beyond[2]
    with rawpy.imread(str(shared("bayer_raw/RAW_KODAK_DC50.KDC"))) as raw:
        settings = {
            "demosaic_algorithm": rawpy.DemosaicAlgorithm.LINEAR,
            "output_bps": 16,
            "gamma": (1, 1),
            "no_auto_bright": True,
            "use_camera_wb": False,
            "user_wb": [1, 1, 1, 1],
            "output_color": rawpy.ColorSpace.raw,
        }
        libraw = raw.postprocess(**settings).transpose(2, 0, 1).astype(float)
    for ours, theirs in zip(demultiplex(frame, cfa(pattern), filter="linear"), libraw, strict=True):
        if ours.shape == theirs.shape:
            assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.98


def test_views_of_a_measured_light_field() -> None:
    light, white, dark = (
        read_image(shared(f"lfm_guv/{name}_GUVExperim1.tif")).astype(np.float32)
        for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    lattice = fit_lattice(white - dark)
    assert lattice.pitch_px == pytest.approx(15.39, abs=0.03)
    views = lattice_channels(light - dark, lattice, 13, filter="cubic")
    middle = views[6, 6]
    theirs = extract_views(light, lattice, dark=dark, radius_px=6.0, axes="lattice")
    linear = lattice_channels(light - dark, lattice, 13)
    np.testing.assert_allclose(linear, theirs.images, atol=1e-4 * float(np.ptp(theirs.images)))
    # neighbouring views show the same vesicle
    near = np.corrcoef(middle.ravel(), views[6, 7].ravel())[0, 1]
    far = np.corrcoef(middle.ravel(), views[0, 0].ravel())[0, 1]
    assert near > 0.95 and near > far
    # a view of the white frame is even; of the nominal pitch it shows the lattice drifting by
    off = SuperPixelLattice("square", lattice.origin_px, (15.0, 0.0), (0.0, 15.0))
    even, uneven = (lattice_channels(white - dark, at, 13)[6, 6] for at in (lattice, off))
    assert even.std() / even.mean() < 0.1 < 3 * even.std() / even.mean() < uneven.std() / uneven.mean()


def bayer_session(step: int, blur_px: float) -> tuple[ArraySource, ArraySource, tuple[int, int, int]]:
    """Return frames of the sample session, every ``step``-th position, as a mono and as a Bayer sensor see them."""
    folder = ROOT / "sample_data" / "session"
    if not folder.exists():
        pytest.skip("needs sample_data/session")
    recorded = open_frames(folder / "frames")
    shape = (1, 2, 3)
    frames = np.empty((*shape, *recorded.shape))
    for k in range(len(recorded)):
        z, y, x = recorded.info(k).position
        if z == 0 and y % step == x % step == 0 and y < 2 * step and x < 3 * step:
            frame = recorded.read(k) - 64.0
            frames[z, y // step, x // step] = cv2.GaussianBlur(frame, (0, 0), blur_px) if blur_px else frame
    mosaics = np.empty_like(frames)
    for at in np.ndindex(shape):
        mosaics[at] = multiplex(COLOURS[:, None, None] * frames[at], cfa("GRBG"))
    return ArraySource(frames), ArraySource(mosaics, metadata={"cfa": "GRBG"}), shape


def test_bayer_plenoptic_frames_feed_the_core_by_channel() -> None:
    """Steps of two pixels are steps of one in a channel: H of each channel is that of the mono sensor, thinned."""
    mono, mosaic, shape = bayer_session(2, 0.0)
    for k, (channel, row, column) in {1: ("G1", 0, 0), 0: ("R", 0, 1), 2: ("B", 1, 0)}.items():
        H = np.asarray(assemble(channel_source(mosaic, channel), shape, Cutout((21, 21), anchor=(20, 22))).matrix)
        for y, x in np.ndindex(2, 3):
            frame = mono.read(3 * y + x)[row::2, column::2]
            cut = frame[20 + y - 10 : 20 + y + 11, 22 + x - 10 : 22 + x + 11]
            np.testing.assert_allclose(H[0, y, x], COLOURS[k] * cut, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize(("blur_px", "most"), [(1.5, 0.1), (2.0, 0.045)])
def test_bayer_plenoptic_frames_feed_the_core_demosaiced(blur_px: float, most: float) -> None:
    """By a linear filter that mixes no colours: right where spots are wider than the pattern, not for sharp ones."""
    cutout = Cutout((41, 41), anchor=(39, 47))

    def errors(blur: float) -> list[float]:
        mono, mosaic, shape = bayer_session(1, blur)
        truth = np.asarray(assemble(mono, shape, cutout).matrix)
        frames = [mosaic.read(k).astype(np.float32) for k in range(len(mosaic))]
        light = [demultiplex(frame, cfa("GRBG"), filter="cubic") for frame in frames]
        found = [
            np.asarray(assemble(ArraySource(np.stack(c).reshape(*shape, *mosaic.shape)), shape, cutout).matrix)
            for c in zip(*light, strict=True)
        ]
        return [
            float(np.linalg.norm(H / w - truth) / np.linalg.norm(truth)) for H, w in zip(found, COLOURS, strict=True)
        ]

    assert max(errors(blur_px)) < most
    assert min(errors(0.0)) > 0.5, "spots of one pixel fall between the samples of a colour"
