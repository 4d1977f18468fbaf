"""``lfcal multiplex`` and ``python -m benchmarks multiplex`` as a user runs them."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from benchmarks import multiplex as bench
from lfcal.base.errors import Cancelled
from lfcal.camera import preset
from lfcal.lattice import fit_lattice
from lfcal.multiplex import (
    camera_chi2,
    cfa,
    colour_error,
    demultiplex,
    demultiplex_generally,
    demultiplex_lattice,
    demultiplex_weighted,
    lattice_channels,
    lattice_channels_weighted,
    mask,
    mask_gain_bound,
    modulation_transfer,
    modulator_of,
    multiplex,
    neutral_density,
    paper,
    pixel_weights,
    sample_deviation,
    search,
    sensor_gain,
    sensor_noise,
    shipped_spectra,
    snr_gain,
)
from lfcal.multiplex import figures as pictures
from tests.frames.scenes import shared
from tests.lattice.white_frames import draw_white


def test_compare_prints_the_numbers(lfcal, tmp_path: Path) -> None:
    words = ("multiplex", "compare", "Bayer", "CYMG", "RRGG", "--camera", "r29", "--monte-carlo", 20000, "--json")
    done = lfcal(*words, "-o", tmp_path / "gain.png")
    assert done.code == 0, done.err
    found = done.json
    bayer, cymg, poor = found["modulators"]
    assert cymg["gain_additive_db"] == pytest.approx(0.645, abs=1e-3) and cymg["gain_photon_db"] < 0
    assert found["chi2"] == pytest.approx(137.0, abs=0.1) and bayer["amplification"] == pytest.approx(0.9129, abs=1e-4)
    assert poor["lost"] == {"B": pytest.approx(1.0)} and poor["gain_db"] is None
    assert found["monte_carlo_gain_db"][1][0] == pytest.approx(0.645, abs=0.05)
    assert cv2.imread(str(tmp_path / "gain.png")).shape[0] > 300
    table = lfcal("multiplex", "compare", "pinhole:5", "MURA:5", "lenslet:3*Bayer")
    assert table.code == 0 and "pinhole" in table.out


LIGHT = np.array([300.0, 200, 100])[:, None, None] * np.ones((12, 14))


@pytest.mark.long
def test_demosaic_writes_the_image_of_the_library(lfcal, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), (multiplex(LIGHT, cfa("CYMG")) + 50).astype(np.uint16))
    out, words = tmp_path / "rgb.tif", ("multiplex", "demosaic", tmp_path / "frame.png")
    done = lfcal(*words, "-o", out, "--pattern", "CYMG", "--dark", 50)
    assert done.code == 0 and done.out == f"written: {out}\n", done.err
    np.testing.assert_allclose(tifffile.imread(out), LIGHT, atol=1e-3)


def test_patterns_without_a_colour_are_refused(lfcal, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), (multiplex(LIGHT, cfa("CYMG")) + 50).astype(np.uint16))
    words = ("multiplex", "demosaic", tmp_path / "frame.png")
    for more, what in (
        ((), "pattern"),
        (("--pattern", "GG/GG"), "none for R, B;"),
        (("--pattern", "R"), "none for G, B;"),
        (("--pattern", "CY/CY"), "none for R, G, B;"),
    ):
        refused = lfcal(*words, "-o", tmp_path / "no.tif", *more)
        assert refused.code == 2 and what in refused.err and not (tmp_path / "no.tif").exists(), refused.err


@pytest.mark.long
def test_demosaic_of_any_page_by_any_route_and_filter(lfcal, tmp_path: Path) -> None:
    out = tmp_path / "rgb.tif"
    pages = np.random.default_rng(1).integers(0, 4000, (2, 16, 18)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "two.tif", pages, photometric="minisblack")
    for page, options in ((0, {"route": "fourier"}), (1, {"filter": "lanczos"}), (1, {"filter": "nearest"})):
        more = [word for key, value in options.items() for word in (f"--{key}", value)]
        files = (tmp_path / "two.tif", "-o", out, "--pattern", "GRBG", "--page", page, "--force")
        done = lfcal("multiplex", "demosaic", *files, *more)
        assert done.code == 0, done.err
        wanted = demultiplex(pages[page].astype(np.float32), cfa("GRBG"), **options)
        np.testing.assert_allclose(tifffile.imread(out), wanted, rtol=1e-4, atol=1e-2)


def test_views_of_a_measured_lattice(lfcal, tmp_path: Path) -> None:
    frame, white, dark = (
        shared("lfm_guv/Lightfield_GUVExperim1.tif").with_name(f"{name}_GUVExperim1.tif")
        for name in ("Lightfield", "Radiometry", "DarkFrame")
    )
    out = tmp_path / "views.tif"
    done = lfcal("multiplex", "views", frame, "--white", white, "--dark", dark, "-o", out)
    assert done.code == 0, done.err
    views = tifffile.imread(out)
    assert views.shape[0] == 15 * 15 and min(views.shape[1:]) >= 25


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a white frame of a turned square lattice, and a light-field frame."""
    folder = tmp_path_factory.mktemp("field")
    white = draw_white((150, 170), pitch=13.3, kind="square", rotation=0.02, dead=0.0).frame
    tifffile.imwrite(folder / "white.tif", white)
    tifffile.imwrite(folder / "field.tif", np.random.default_rng(0).integers(0, 4000, white.shape).astype(np.uint16))
    return folder


def test_views_of_any_number_and_filter(lfcal, field: Path, tmp_path: Path) -> None:
    frame, white = (tifffile.imread(field / name).astype(np.float32) for name in ("field.tif", "white.tif"))
    lattice = fit_lattice(white)
    for size, name, axes in ((3, "nearest", "lattice"), (5, "linear", "frame")):
        out = tmp_path / f"{size}.tif"
        files = (field / "field.tif", "--white", field / "white.tif", "-o", out)
        run = lfcal("multiplex", "views", *files, "--size", size, "--filter", name, "--axes", axes)
        assert run.code == 0, run.err
        wanted = lattice_channels(frame, lattice, size, filter=name, axes=axes)
        assert f"{size * size} views: {wanted.shape[2]} x {wanted.shape[3]} of" in run.out
        np.testing.assert_allclose(tifffile.imread(out), wanted.reshape(-1, *wanted.shape[2:]), rtol=1e-6)


def test_views_on_a_lattice_measured_before(lfcal, field: Path, tmp_path: Path) -> None:
    assert lfcal("white", field / "white.tif", "-o", tmp_path / "out").code == 0
    command = ("multiplex", "views", field / "field.tif", "--size", 3)
    measured, white = ("--lattice", tmp_path / "out/lattice.json"), ("--white", field / "white.tif")
    for given, out in ((measured, "a.tif"), (white, "b.tif")):
        run = lfcal(*command, *given, "-o", tmp_path / out)
        assert run.code == 0, run.err
    one, other = (tifffile.imread(tmp_path / name) for name in ("a.tif", "b.tif"))
    np.testing.assert_allclose(one, other, atol=0.01)
    for given in ((), (*measured, *white)):
        refused = lfcal(*command, *given, "-o", tmp_path / "no.tif")
        assert refused.code == 2 and "--white, --lattice or --camera" in refused.err
        assert not (tmp_path / "no.tif").exists()


def test_views_through_a_mask(lfcal, field: Path, tmp_path: Path) -> None:
    frame, white = (tifffile.imread(field / name).astype(np.float32) for name in ("field.tif", "white.tif"))
    out = tmp_path / "mask.tif"
    files = ("multiplex", "views", field / "field.tif", "--white", field / "white.tif", "-o", out)
    assert lfcal(*files, "--modulator", "MURA:5", "--filter", "linear").code == 0
    lattice = fit_lattice(white)
    wanted = demultiplex_lattice(frame, lattice, mask("MURA", 5), filter="linear")
    np.testing.assert_allclose(tifffile.imread(out), wanted, rtol=1e-5, atol=1e-2)
    waves = lfcal(*files, "--modulator", "MURA:5", "--route", "fourier", "--force")
    assert waves.code == 0, waves.err
    wanted = demultiplex_lattice(frame, lattice, mask("MURA", 5), route="fourier")
    np.testing.assert_allclose(tifffile.imread(out), wanted, rtol=1e-5, atol=1e-2)
    assert lfcal(*files[:-1], tmp_path / "no.tif", "--route", "fourier").code == 2
    both = lfcal(*files[:-1], tmp_path / "no.tif", "--modulator", "MURA:5", "--size", 3)
    assert both.code == 2 and "--size and --modulator" in both.err and not (tmp_path / "no.tif").exists()


@pytest.mark.long
def test_views_from_pixels_with_weights(lfcal, field: Path, tmp_path: Path) -> None:
    frame, white = (tifffile.imread(field / name) for name in ("field.tif", "white.tif"))
    dead = (np.random.default_rng(1).random(frame.shape) < 0.02).astype(np.uint8)
    tifffile.imwrite(tmp_path / "dead.tif", dead)
    sensor = replace(preset("r29").sensor, shape=frame.shape, black_level=40.0)
    (tmp_path / "camera.json").write_text(replace(preset("r29"), sensor=sensor).to_json())
    lattice, light = fit_lattice(white.astype(np.float32)), frame.astype(np.float32) - 40
    weights = pixel_weights(frame, sensor, dead=dead, gain=2.0, exposure_s=0.1)
    out, sd = tmp_path / "views.tif", tmp_path / "sd.tif"
    words = ("multiplex", "views", field / "field.tif", "--white", field / "white.tif", "-o", out, "--force")
    known = ("--sensor", tmp_path / "camera.json", "--mask", tmp_path / "dead.tif", "--gain", 2, "--exposure", 0.1)
    done = lfcal(*words, *known, "--size", 5, "--deviation", sd, "--json")
    assert done.code == 0, done.err
    wanted = lattice_channels_weighted(light, lattice, 5, weights)
    shape = (25, *wanted.samples.shape[2:])
    np.testing.assert_allclose(tifffile.imread(out), wanted.samples.reshape(shape), rtol=1e-4, atol=1e-2)
    np.testing.assert_allclose(tifffile.imread(sd), wanted.deviation.reshape(shape), rtol=1e-4)
    assert done.json["black_level"] == 40 and done.json["pixels_left_out"] == pytest.approx((weights == 0).mean())
    both = lfcal(*words, *known, "--modulator", "MURA:5", "--route", "both")
    assert both.code == 0, both.err
    found = demultiplex_lattice(light, lattice, mask("MURA", 5), weights=weights)
    np.testing.assert_allclose(tifffile.imread(out), found, rtol=1e-4, atol=0.1)
    fourier = demultiplex_lattice(light, lattice, mask("MURA", 5), route="fourier")
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views_fourier.tif"), fourier, rtol=1e-4, atol=0.1)
    have = "pixels have weights (--sensor, --mask, or NaN in the frame), got"
    for more, word in (
        ((*known, "--filter", "cubic"), f"{have} spatial and cubic"),
        ((*known, "--modulator", "MURA:5", "--route", "fourier"), f"{have} fourier and linear"),
        (("--deviation", sd), "pixels with weights"),
        (("--mask", field / "none.tif"), "none.tif"),
        (("--route", "both"), "spatial for lenslets"),
        (("--route", "scenic"), "route"),
    ):
        refused = lfcal(*words, *more)
        assert refused.code == 2 and word in refused.err and "Traceback" not in refused.err, refused.err


def test_compare_over_any_reference_at_any_noise(lfcal) -> None:
    command = ("multiplex", "compare", "Bayer", "RGBW", "--json", "--reference", "CYMG")
    found = lfcal(*command, "--chi2", 2.5).json
    assert (found["reference"], found["chi2"]) == ("CYMG", 2.5)
    for line, name in zip(found["modulators"], ("Bayer", "RGBW"), strict=True):
        assert line["gain_db"] == pytest.approx(snr_gain(cfa(name), cfa("CYMG"), 2.5))
    sensor = preset("r29").sensor
    found = lfcal(*command, "--camera", "r29", "--gain", 4).json
    assert found["chi2"] == pytest.approx(camera_chi2(sensor, gain=4))
    found = lfcal("multiplex", "search", "filters", "--camera", "r29", "--gain", 4, "--json").json
    assert found["chi2"] == pytest.approx(camera_chi2(sensor, gain=4))
    assert lfcal(*command, "--camera", "r29", "--chi2", 1).code == 2


@pytest.mark.long
def test_search_finds_the_known_frontiers(lfcal, tmp_path: Path) -> None:
    found = lfcal("multiplex", "search", "--chi2", 0, "--json", "-o", tmp_path / "front.png").json
    assert found["frontier"][0]["gain_db"] == pytest.approx(0.645, abs=1e-3)
    masks = lfcal("multiplex", "search", "3", "--chi2", 1)
    limit = mask_gain_bound(3, 1.0)
    assert f"no mask of this size gains more than {limit:+.3f} dB" in masks.err + masks.out
    assert masks.code == 0 and "pinhole" in masks.out
    assert cv2.imread(str(tmp_path / "front.png")).std() > 5


def test_filters_and_pictures(lfcal, tmp_path: Path) -> None:
    trials = lfcal("multiplex", "filters", "--size", 64, "--json", "-o", tmp_path / "filters.png").json
    assert {t["filter"] for t in trials["sharp edges"]} >= {"nearest", "cubic", "bilateral", "sinc"}
    assert lfcal("multiplex", "show", "MURA:5", "-o", tmp_path / "mura.png").code == 0
    for name in ("filters", "mura"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 5
    assert lfcal("multiplex", "search", "--chi2", 1, "--camera", "r29").code == 2
    assert lfcal("multiplex", "show", "MURA:9", "-o", tmp_path / "no.png").code == 2


@pytest.mark.long
def test_more_starts_find_better_masks(lfcal) -> None:
    few, many = (
        lfcal("multiplex", "search", "5", "--chi2", 10, "--starts", n, "--json").json["frontier"][0]["gain_db"]
        for n in (0, 1)
    )
    assert few < many < mask_gain_bound(5, 10.0)


@pytest.mark.long
def test_the_figures_of_the_paper(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "SIDE", 5)
    for name, value in (("SIDE", 5), ("LIGHT_FIELD", ("MURA", "pinhole")), ("UPSAMPLED", 3)):
        monkeypatch.setattr(paper, name, value)
    monkeypatch.setattr(pictures, "PICTURED", ("X-Trans",))
    done = lfcal("multiplex", "figures", tmp_path / "out", "--camera", "bench")
    assert done.code == 0, done.err
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {f"figure{n}.png" for n in (3, 5, 6, 7)} <= names and "modulator_X-Trans.png" in names
    for path in (tmp_path / "out").iterdir():
        assert cv2.imread(str(path)).std() > 5


@pytest.mark.long
def test_the_seed_of_the_figures(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "LIGHT_FIELD", ("pinhole",))
    monkeypatch.setattr(paper, "SIDE", 3)
    monkeypatch.setattr(pictures, "PICTURED", ())
    for name in ("_figure3", "_figure5", "_figure6"):
        monkeypatch.setattr(pictures, name, lambda path, *_: None)
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert lfcal("multiplex", "figures", tmp_path / folder, "--seed", seed).code == 0
    a, b, c = (cv2.imread(str(tmp_path / folder / "figure7.png")) for folder in "abc")
    assert np.array_equal(a, b) and not np.array_equal(a, c)


@pytest.mark.long
def test_figure_3_of_a_raw_frame(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = shared("bayer_raw/RAW_KODAK_DC50.KDC")
    for name in ("_figure5", "_figure6", "_figure7"):
        monkeypatch.setattr(pictures, name, lambda path, *_: None)
    monkeypatch.setattr(pictures, "PICTURED", ())
    assert lfcal("multiplex", "figures", tmp_path / "drawn").code == 0
    assert lfcal("multiplex", "figures", tmp_path / "raw", "--raw", raw).code == 0
    shown = [cv2.imread(str(tmp_path / folder / "figure3.png")) for folder in ("drawn", "raw")]
    assert shown[1].std() > 5 and (shown[0].shape != shown[1].shape or not np.array_equal(*shown))


@pytest.mark.long
def test_benchmark(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(bench, "FULL", (256, 384))
    bench.command(quick=False, filters="cubic", rounds=1, workers=1, json=True)
    rows = json.loads(capsys.readouterr().out)
    assert [r["name"] for r in rows] == ["demosaic, cubic", "31 x 31 views, linear", "31 x 31 views, cubic"]
    assert all(r["ratio"] > 0 and r["bound"] == 5 for r in rows)
    assert rows[0]["psnr_db"] > 25 and rows[1]["psnr_db"] is None, "quality and time"
    assert mask("lenslet", 31).count == 961


@pytest.mark.parametrize("json_asked", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_stopped_search_shows_the_best_so_far(
    lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, json_asked: bool
) -> None:
    real, made = search.best_mask, []

    def stopped(*args, **how):
        if len(made) == 2:
            raise Cancelled("stopped")
        made.append(args)
        return real(*args, **how)

    monkeypatch.setattr(search, "best_mask", stopped)
    words = ("--json",) if json_asked else ()
    done = lfcal("multiplex", "search", 3, "--chi2", 1, "-o", tmp_path / "found.png", *words)
    assert done.code == 130 and "stopped after 2 of 8 searches; the best found so far" in done.err
    assert cv2.imread(str(tmp_path / "found.png")).std() > 5
    if json_asked:
        assert done.json["stopped"] and done.json["frontier"] and done.json["best"]
    else:
        assert "best mask" in done.out


def test_merits_of_a_camera(lfcal) -> None:
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


def test_the_transfer_of_large_masks_is_not_measured(lfcal) -> None:
    done = lfcal("multiplex", "merits", "lenslet:17", "--camera", "r29", "--json")
    assert done.code == 0, done.err
    (row,) = done.json["modulators"]
    assert row["mtf_0.1"] is None and row["false_detail_0.25"] is None and row["gain_plain_db"] == 0


def test_map_of_gains(lfcal, tmp_path: Path) -> None:
    words = ("multiplex", "map", "bands:CM/YG:3", "--reference", "bands:RG/GB:3")
    found = lfcal(*words, "--json", "--out", tmp_path / "map.png").json
    assert found["samples"] == ["450 nm", "550 nm", "650 nm"] and len(found["gains"][0]) == len(found["chi2"])
    assert cv2.imread(str(tmp_path / "map.png")).std() > 5
    assert "450 nm" in lfcal(*words).out
    assert lfcal("multiplex", "map", "Bayer", "--reference", "RRGG").code == 2


def test_designs(lfcal, tmp_path: Path) -> None:
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


def test_recover_a_frame_with_saturation(lfcal, tmp_path: Path) -> None:
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


def test_recover_by_a_filter_and_by_both_routes(lfcal, tmp_path: Path) -> None:
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


def test_a_black_level_of_0_is_used(lfcal, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    camera = replace(preset("r29"), sensor=replace(preset("r29").sensor, shape=(8, 8), black_level=100.0))
    (tmp_path / "camera.json").write_text(camera.to_json())
    words = ("multiplex", "recover", tmp_path / "frame.png", "--modulator", "nd:1", "--out", tmp_path / "a.tif")
    for more, light in (((), 400), (("--dark", 0), 500), (("--dark", 50), 450)):
        done = lfcal(*words, "--camera", tmp_path / "camera.json", "--force", *more)
        assert done.code == 0, done.err
        np.testing.assert_allclose(tifffile.imread(tmp_path / "a.tif"), light)


def test_recover_by_iterations(lfcal, tmp_path: Path) -> None:
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


def test_samples_that_no_pixel_measures_are_refused(lfcal, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((8, 8), 500, np.uint16))
    dead = np.zeros((8, 8), np.uint8)
    dead[::2, ::2] = 1  # every red pixel
    cv2.imwrite(str(tmp_path / "dead.png"), dead)
    dark, wide, out = tmp_path / "dark.npy", tmp_path / "wide.npy", tmp_path / "found.tif"
    np.save(dark, np.zeros((4, 2)))
    np.save(wide, np.eye(4, 6))
    what = "some that measure every sample"
    for modulator, more, words in (
        *((one, more, what) for one in (dark, wide) for more in ((), ("--filter", "cubic"), ("--route", "fourier"))),
        (dark, ("--spacing", 2), "expected some light"),
        ("Bayer", ("--mask", tmp_path / "dead.png"), "frame behind Bayer"),
    ):
        given = ("--modulator", modulator, "--out", out)
        refused = lfcal("multiplex", "recover", tmp_path / "frame.png", *given, *more)
        assert refused.code == 2 and words in refused.err and not out.exists(), refused.err
