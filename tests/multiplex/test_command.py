"""``lfcal multiplex`` and ``python -m benchmarks multiplex`` as a user runs them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.lattice import fit_lattice
from lfcal.multiplex import (
    camera_chi2,
    cfa,
    demultiplex,
    demultiplex_lattice,
    lattice_channels,
    lattice_channels_weighted,
    mask,
    mask_gain_bound,
    multiplex,
    pixel_weights,
    snr_gain,
)
from tests.cli.conftest import lfcal  # noqa: F401  the fixture
from tests.frames.scenes import shared
from tests.lattice.white_frames import draw_white


def test_compare_tells_the_numbers(lfcal, tmp_path: Path) -> None:  # noqa: F811
    done = lfcal(
        "multiplex",
        "compare",
        "Bayer",
        "CYMG",
        "RRGG",
        "--camera",
        "r29",
        "--monte-carlo",
        20000,
        "--json",
        "-o",
        tmp_path / "gain.png",
    )
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


def test_demosaic_writes_what_the_library_gives(lfcal, tmp_path: Path) -> None:  # noqa: F811
    light = np.array([300.0, 200, 100])[:, None, None] * np.ones((12, 14))
    cv2.imwrite(str(tmp_path / "frame.png"), (multiplex(light, cfa("CYMG")) + 50).astype(np.uint16))
    out = tmp_path / "rgb.tif"
    done = lfcal("multiplex", "demosaic", tmp_path / "frame.png", "-o", out, "--pattern", "CYMG", "--dark", 50)
    assert done.out == f"written: {out}\n"
    assert done.code == 0, done.err
    np.testing.assert_allclose(tifffile.imread(out), light, atol=1e-3)
    bad = lfcal("multiplex", "demosaic", tmp_path / "frame.png", "-o", tmp_path / "no.tif")
    assert bad.code == 2 and "pattern" in bad.err and not (tmp_path / "no.tif").exists()


@pytest.mark.parametrize(("pattern", "lost"), [("GG/GG", "R, B"), ("R", "G, B"), ("CY/CY", "R, G, B")])
def test_demosaic_refuses_a_pattern_that_misses_a_colour(lfcal, tmp_path: Path, pattern: str, lost: str) -> None:  # noqa: F811
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((12, 14), 300, np.uint16))
    out = tmp_path / "rgb.tif"
    refused = lfcal("multiplex", "demosaic", tmp_path / "frame.png", "-o", out, "--pattern", pattern)
    assert refused.code == 2 and f"none for {lost};" in refused.err and not out.exists(), refused.err


def test_views_of_a_measured_lattice(lfcal, tmp_path: Path) -> None:  # noqa: F811
    folder = shared("lfm_guv/Lightfield_GUVExperim1.tif").parent
    out = tmp_path / "views.tif"
    done = lfcal(
        "multiplex",
        "views",
        folder / "Lightfield_GUVExperim1.tif",
        "--white",
        folder / "Radiometry_GUVExperim1.tif",
        "--dark",
        folder / "DarkFrame_GUVExperim1.tif",
        "-o",
        out,
    )
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


def test_views_of_any_number_and_filter(lfcal, field: Path, tmp_path: Path) -> None:  # noqa: F811
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


def test_views_on_a_lattice_measured_before(lfcal, field: Path, tmp_path: Path) -> None:  # noqa: F811
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
        assert (
            refused.code == 2 and "--white, --lattice or --camera" in refused.err and not (tmp_path / "no.tif").exists()
        )


def test_views_through_a_mask(lfcal, field: Path, tmp_path: Path) -> None:  # noqa: F811
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
def test_views_from_pixels_with_weights(lfcal, field: Path, tmp_path: Path) -> None:  # noqa: F811
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
    for more, word in (
        (
            (*known, "--filter", "cubic"),
            "pixels have weights (--sensor, --mask, or NaN in the frame), got spatial and cubic",
        ),
        (
            (*known, "--modulator", "MURA:5", "--route", "fourier"),
            "pixels have weights (--sensor, --mask, or NaN in the frame), got fourier and linear",
        ),
        (("--deviation", sd), "pixels with weights"),
        (("--mask", field / "none.tif"), "none.tif"),
        (("--route", "both"), "spatial for lenslets"),
        (("--route", "scenic"), "route"),
    ):
        refused = lfcal(*words, *more)
        assert refused.code == 2 and word in refused.err and "Traceback" not in refused.err, refused.err


def test_demosaic_by_every_route_and_of_any_page(lfcal, tmp_path: Path) -> None:  # noqa: F811
    pages = np.random.default_rng(1).integers(0, 4000, (2, 16, 18)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "two.tif", pages, photometric="minisblack")
    for page, options in ((0, {"route": "fourier"}), (1, {"filter": "lanczos"}), (1, {"filter": "nearest"})):
        words = [word for key, value in options.items() for word in (f"--{key}", value)]
        files = (tmp_path / "two.tif", "-o", tmp_path / "rgb.tif", "--pattern", "GRBG", "--page", page, "--force")
        done = lfcal("multiplex", "demosaic", *files, *words)
        assert done.code == 0, done.err
        wanted = demultiplex(pages[page].astype(np.float32), cfa("GRBG"), **options)
        np.testing.assert_allclose(tifffile.imread(tmp_path / "rgb.tif"), wanted, rtol=1e-4, atol=1e-2)


def test_compare_over_any_reference_at_any_noise(lfcal) -> None:  # noqa: F811
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


def test_search_filters_and_pictures(lfcal, tmp_path: Path) -> None:  # noqa: F811
    found = lfcal("multiplex", "search", "--chi2", 0, "--json", "-o", tmp_path / "front.png").json
    assert found["frontier"][0]["gain_db"] == pytest.approx(0.645, abs=1e-3)
    masks = lfcal("multiplex", "search", "3", "--chi2", 1)
    limit = mask_gain_bound(3, 1.0)
    assert f"no mask of this size gains more than {limit:+.3f} dB" in masks.err + masks.out
    assert masks.code == 0 and "pinhole" in masks.out
    trials = lfcal("multiplex", "filters", "--size", 64, "--json", "-o", tmp_path / "filters.png").json
    assert {t["filter"] for t in trials["sharp edges"]} >= {"nearest", "cubic", "bilateral", "sinc"}
    assert lfcal("multiplex", "show", "MURA:5", "-o", tmp_path / "mura.png").code == 0
    for name in ("front", "filters", "mura"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 5
    assert lfcal("multiplex", "search", "--chi2", 1, "--camera", "r29").code == 2
    assert lfcal("multiplex", "show", "MURA:9", "-o", tmp_path / "no.png").code == 2


@pytest.mark.long
def test_more_starts_find_better_masks(lfcal) -> None:  # noqa: F811
    few, many = (
        lfcal("multiplex", "search", "5", "--chi2", 10, "--starts", n, "--json").json["frontier"][0]["gain_db"]
        for n in (0, 1)
    )
    assert few < many < mask_gain_bound(5, 10.0)


@pytest.mark.long
def test_the_papers_figures(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    from lfcal.multiplex import figures as pictures
    from lfcal.multiplex import paper

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
def test_the_seed_of_the_figures(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    from lfcal.multiplex import figures as pictures
    from lfcal.multiplex import paper

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
def test_figure_3_of_a_raw_frame(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    from lfcal.multiplex import figures as pictures

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
    from benchmarks import multiplex as bench

    monkeypatch.setattr(bench, "FULL", (256, 384))
    bench.command(quick=False, filters="cubic", rounds=1, workers=1, json=True)
    rows = json.loads(capsys.readouterr().out)
    assert [r["name"] for r in rows] == ["demosaic, cubic", "31 x 31 views, linear", "31 x 31 views, cubic"]
    assert all(r["ratio"] > 0 and r["bound"] == 5 for r in rows)
    assert rows[0]["psnr_db"] > 25 and rows[1]["psnr_db"] is None, "quality beside the time"
    assert mask("lenslet", 31).count == 961


@pytest.mark.parametrize("told", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_search_that_is_stopped_shows_the_best_so_far_and_says_so(
    lfcal,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    told: bool,
) -> None:
    from lfcal.base.errors import Cancelled
    from lfcal.multiplex import search

    real, made = search.best_mask, []

    def stopped(*args, **how):
        if len(made) == 2:
            raise Cancelled("stopped")
        made.append(args)
        return real(*args, **how)

    monkeypatch.setattr(search, "best_mask", stopped)
    words = ("--json",) if told else ()
    done = lfcal("multiplex", "search", 3, "--chi2", 1, "-o", tmp_path / "found.png", *words)
    assert done.code == 130 and "stopped after 2 of 8 searches; the best found so far" in done.err
    assert cv2.imread(str(tmp_path / "found.png")).std() > 5
    if told:
        assert done.json["stopped"] and done.json["frontier"] and done.json["best"]
    else:
        assert "best mask" in done.out
