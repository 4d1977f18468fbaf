"""``lfcal multiplex merits``, ``map``, ``design`` and ``recover`` as a user runs them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.multiplex import (
    cfa,
    colour_error,
    demultiplex,
    demultiplex_generally,
    demultiplex_weighted,
    mask,
    modulation_transfer,
    modulator_of,
    multiplex,
    neutral_density,
    pixel_weights,
    sample_deviation,
    sensor_gain,
    sensor_noise,
    shipped_spectra,
    snr_gain,
)
from tests.cli.conftest import lfcal  # noqa: F401  the fixture


def test_merits_of_a_camera(lfcal) -> None:  # noqa: F811
    words = ("multiplex", "merits", "Bayer", "RGBW 4x4", "polarisers:0,45/135,90", "--json", "--camera", "r29")
    done = lfcal(*words[:4], *words[5:], "--gain", 2, "--exposure", 0.5, "--reference", "RG/GB")
    assert done.code == 0, done.err
    noise = sensor_noise(preset("r29").sensor, gain=2, exposure_s=0.5)
    bayer, clear = done.json["modulators"]
    assert done.json["chi2"] == pytest.approx(noise.chi2) and bayer["gain_plain_db"] == pytest.approx(0)
    assert clear["gain_optimal_db"] == pytest.approx(
        sensor_gain(cfa("RGBW 4x4"), cfa("Bayer"), noise, decorrelation="optimal")
    )
    assert bayer["mtf_0.25"] == pytest.approx(modulation_transfer(cfa("Bayer"), 0.25).transfer.mean())
    wanted = colour_error("RG/GB", efficiency=shipped_spectra("silicon"), noise=noise)
    assert bayer["delta_e_mean"] == pytest.approx(wanted.mean) and bayer["delta_e_noise"] == pytest.approx(wanted.noise)
    rough = lfcal(*words[:3], *words[5:], "--uncorrected", "--filter", "linear").json["modulators"][0]
    left = sensor_noise(preset("r29").sensor, flat_corrected=False)
    assert rough["worst_noise_percent"] == pytest.approx(100 * sample_deviation(cfa("Bayer"), left).max())
    assert rough["mtf_0.25"] == pytest.approx(modulation_transfer(cfa("Bayer"), 0.25, filter="linear").transfer.mean())
    lone = lfcal("multiplex", "merits", "polarisers:0,45/135,90", "--camera", "r29")
    assert lone.code == 0 and "ΔE00" in lone.out
    unlike = lfcal("multiplex", "merits", "Bayer", "nd:1,0.5", "--camera", "r29")
    assert unlike.code == 2 and "number of samples" in unlike.err


def test_of_large_masks_no_transfer_is_measured(lfcal) -> None:  # noqa: F811
    done = lfcal("multiplex", "merits", "lenslet:17", "--camera", "r29", "--json")
    assert done.code == 0, done.err
    (row,) = done.json["modulators"]
    assert row["mtf_0.1"] is None and row["false_detail_0.25"] is None and row["gain_plain_db"] == 0


def test_map_of_gains(lfcal, tmp_path: Path) -> None:  # noqa: F811
    words = ("multiplex", "map", "bands:CM/YG:3", "--reference", "bands:RG/GB:3")
    found = lfcal(*words, "--json", "--out", tmp_path / "map.png").json
    assert found["samples"] == ["450 nm", "550 nm", "650 nm"] and len(found["gains"][0]) == len(found["chi2"])
    assert cv2.imread(str(tmp_path / "map.png")).std() > 5
    assert "450 nm" in lfcal(*words).out
    assert lfcal("multiplex", "map", "Bayer", "--reference", "RRGG").code == 2


def test_designs(lfcal, tmp_path: Path) -> None:  # noqa: F811
    out = tmp_path / "own.npy"
    done = lfcal("multiplex", "design", "2x2", "--chi2", 0, "--letters", "RGBCMY", "--out", out, "--json")
    assert done.code == 0 and done.json["exhaustive"], done.err
    assert done.json["gain_db"] == pytest.approx(snr_gain(cfa("CYMG"), cfa("Bayer"), 0.0))
    assert snr_gain(modulator_of(str(out)), cfa("Bayer"), 0.0) == pytest.approx(done.json["gain_db"])
    few = lfcal("multiplex", "design", "2x2", "--camera", "r29", "--gain", 100, "--kinds", 3, "--crosstalk", 0.1)
    assert few.code == 0 and "best of all" in few.err + few.out
    light = ("--least-light", 0.2, "--most-light", 0.6, "--levels", 3, "--starts", 0)
    mask = lfcal("multiplex", "design", 3, "--chi2", 1, *light, "--json").json
    assert 0.2 <= np.mean(mask["pattern"]) <= 0.6 and mask["tried"] == 3**9
    for words in (
        ("2x2",),
        ("2x", "--chi2", 1),
        ("2x2", "--chi2", 1, "--camera", "r29"),
        ("2x2", "--chi2", 1, "-o", "x.tif"),
        ("2x²", "--chi2", 1),
        ("²", "--chi2", 1),
        ("2x2", "--chi2", 1, "--crosstalk", "nan"),
    ):
        assert lfcal("multiplex", "design", *words).code == 2


def test_recover_a_frame_with_saturation(lfcal, tmp_path: Path) -> None:  # noqa: F811
    nd = neutral_density([[1.0, 0.25], [0.25, 0.0625]])
    light = np.full((1, 40, 44), 9000.0)
    raw = np.minimum(np.rint(multiplex(light, nd)), 4095).astype(np.uint16)
    dead = np.zeros(raw.shape, np.uint8)
    dead[4, 7], raw[4, 7] = 1, 4000
    tifffile.imwrite(tmp_path / "pages.tif", np.stack([raw * 0, raw]), photometric="minisblack")
    cv2.imwrite(str(tmp_path / "dead.png"), dead)
    camera = json.loads(preset("r29").to_json())
    camera["sensor"]["shape"] = list(raw.shape)
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    words = ("multiplex", "recover", tmp_path / "pages.tif", "--page", 1, "--modulator", "nd:1,0.25/0.25,0.0625")
    options = ("--camera", tmp_path / "camera.json", "--mask", tmp_path / "dead.png", "--gain", 1, "--exposure", 0.1)
    outs = ("--out", tmp_path / "found.tif", "--deviation", tmp_path / "sd.tif")
    done = lfcal(*words, *options, *outs, "--json")
    assert done.code == 0 and done.json["places_not_recovered"] == 0, done.err
    found = tifffile.imread(tmp_path / "found.tif")
    np.testing.assert_allclose(found, 9000, rtol=2e-3)
    weights = pixel_weights(raw, preset("r29").sensor, dead=dead, exposure_s=0.1)
    wanted = demultiplex_weighted(raw, nd, weights)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "sd.tif"), wanted.deviation[0], rtol=1e-4)
    plain = lfcal(*words, "--dark", 10, "--out", tmp_path / "plain.tif")
    assert plain.code == 0 and "samples: light\npixels left out: 0\n" in plain.out, plain.out
    assert np.median(tifffile.imread(tmp_path / "plain.tif")) < 8000
    for more in (("--transmissions", "x.npy"), ("--spacing", 2, "--deviation", tmp_path / "no.tif")):
        refused = lfcal(*words, "--out", tmp_path / "no2.tif", *more)
        assert refused.code == 2 and not (tmp_path / "no2.tif").exists(), refused.err


def test_recover_by_a_filter_and_by_both_routes(lfcal, tmp_path: Path) -> None:  # noqa: F811
    frame = np.random.default_rng(2).integers(0, 4000, (22, 33)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", "MURA:11", "--force")
    out, second, light = tmp_path / "found.tif", tmp_path / "found_fourier.tif", frame.astype(float)
    done = lfcal(*words, "--filter", "cubic", "--route", "both", "--out", out, "--json")
    assert done.code == 0 and done.json["black_level"] == 0, done.err
    fourier = demultiplex(light, mask("MURA", 11), route="fourier")
    plain = demultiplex(light, mask("MURA", 11), filter="cubic")
    np.testing.assert_allclose(tifffile.imread(out), plain, rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(tifffile.imread(second), fourier, rtol=1e-5, atol=1e-2)
    assert lfcal(*words, "--route", "fourier", "--out", out).code == 0
    np.testing.assert_allclose(tifffile.imread(out), fourier, rtol=1e-5, atol=1e-2)
    cv2.imwrite(str(tmp_path / "dead.png"), (frame > 3990).astype(np.uint8))
    known = ("--mask", tmp_path / "dead.png")
    for more, word in (
        ((*known, "--filter", "cubic"), "--filter: expected linear, because"),
        ((*known, "--route", "fourier"), "--route: expected spatial or both, because"),
        (("--filter", "cubic", "--deviation", tmp_path / "sd.tif"), "deviation"),
        (("--route", "scenic"), "route"),
        (("--filter", "scenic"), "filter"),
        (("--spacing", 2, "--route", "both"), "route"),
        (("--spacing", 0), "spacing"),
    ):
        refused = lfcal(*words, *more, "--out", out)
        assert refused.code == 2 and word in refused.err and "Traceback" not in refused.err, (more, refused.err)


def test_a_level_of_0_is_a_level(lfcal, tmp_path: Path) -> None:  # noqa: F811
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    camera = replace(preset("r29"), sensor=replace(preset("r29").sensor, shape=(8, 8), black_level=100.0))
    (tmp_path / "camera.json").write_text(camera.to_json())
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", "nd:1", "--out", tmp_path / "a.tif")
    for more, light in (((), 400), (("--dark", 0), 500), (("--dark", 50), 450)):
        done = lfcal(*words, "--camera", tmp_path / "camera.json", "--force", *more)
        assert done.code == 0, done.err
        np.testing.assert_allclose(tifffile.imread(tmp_path / "a.tif"), light)


def test_recover_by_iterations(lfcal, tmp_path: Path) -> None:  # noqa: F811
    shares = np.random.default_rng(0).random((2, 30, 36))
    light = np.array([100.0, 300.0])[:, None, None] * np.ones((30, 36))
    frame = np.rint((shares * light).sum(0) * 10).astype(np.uint16)
    np.save(tmp_path / "shares.npy", shares)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    words = ("multiplex", "recover", tmp_path / "frame.png", "--transmissions", tmp_path / "shares.npy", "--json")
    options = ("--spacing", 3, "--smoothness", 1e-3, "--iterations", 50)
    done = lfcal(*words, *options, "--out", tmp_path / "found.tif")
    assert done.code == 0, done.err
    wanted = demultiplex_generally(frame, shares, 3.0, smoothness=1e-3, most=50)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "found.tif"), wanted.samples, rtol=1e-4)
    assert done.json["iterations"] == wanted.iterations and math.isfinite(done.json["residual"])


@pytest.mark.parametrize(
    "more", [(), ("--filter", "cubic"), ("--route", "fourier")], ids=["weighed", "cubic", "fourier"]
)
@pytest.mark.parametrize("matrix", [np.zeros((4, 2)), np.eye(4, 6)], ids=["dark", "more samples than pixels"])
def test_samples_that_no_pixel_tells_are_refused(lfcal, tmp_path: Path, matrix, more: tuple[str, ...]) -> None:  # noqa: F811
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    np.save(tmp_path / "own.npy", matrix)
    out = tmp_path / "found.tif"
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", tmp_path / "own.npy", "--out", out)
    refused = lfcal(*words, *more)
    assert refused.code == 2 and "some that measure every sample" in refused.err and not out.exists(), refused.err


def test_iterations_refuse_a_dark_modulator(lfcal, tmp_path: Path) -> None:  # noqa: F811
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    np.save(tmp_path / "own.npy", np.zeros((4, 2)))
    out = tmp_path / "found.tif"
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", tmp_path / "own.npy", "--out", out)
    refused = lfcal(*words, "--spacing", 2)
    assert refused.code == 2 and "expected some light" in refused.err and not out.exists(), refused.err


def test_a_frame_that_tells_no_place_is_refused(lfcal, tmp_path: Path) -> None:  # noqa: F811
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    dead = np.zeros((8, 8), np.uint8)
    dead[::2, ::2] = 1  # every red pixel
    cv2.imwrite(str(tmp_path / "dead.png"), dead)
    out = tmp_path / "found.tif"
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", "Bayer", "--out", out)
    refused = lfcal(*words, "--mask", tmp_path / "dead.png")
    assert refused.code == 2 and "frame behind Bayer" in refused.err and not out.exists(), refused.err
