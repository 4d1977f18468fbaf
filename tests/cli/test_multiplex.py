"""``lfcal multiplex`` against the library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.lattice import lattice_of
from lfcal.multiplex import (
    cfa,
    code_matrix,
    coding_gain,
    coding_pays,
    demultiplex,
    demultiplex_lattice,
    display_fit,
    display_frames,
    mask,
    multiplex,
    overlapping_patterns,
    s_matrix,
    sensor_noise,
)
from lfcal.psf import PSFMatrix, open_psf, save
from tests.cli.conftest import Lfcal
from tests.cli.writing import WRITERS

# -- ``lfcal multiplex coding`` against the library --
CAMERA = preset("bench")


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:9, :9] - 4
    core = np.exp(-(y**2 + x**2) / 2.0)
    values = (core * rng.uniform(0.5, 1, (2, 4, 5, 9, 9))).astype(np.float32)
    save(PSFMatrix(values, depths=(-20_000.0, -26_000.0), camera=CAMERA), tmp_path / "H.h5")
    return tmp_path / "H.h5"


def test_the_gains_are_the_library_s(lfcal: Lfcal, matrix: Path, tmp_path: Path) -> None:
    words = ("multiplex", "coding", matrix, "--plane", 1, "--points", 7, "--step", 2, "--at", "1,2", "--signal", 300)
    words = (*words, "--gain", 2, "--exposure", 0.1)
    done = lfcal(*words, "--monte-carlo", 200, "-o", tmp_path / "gain.png", "--json").ok()
    with open_psf(matrix) as H:
        light, _ = overlapping_patterns(H[1], 7, step=2, first=(1, 2))
    noise = sensor_noise(CAMERA.sensor, gain=2.0, exposure_s=0.1)
    found = coding_gain(light, s_matrix(7), noise, signal_e=300.0)
    for key, numbers in (("equal_time", found.time), ("equal_full_well", found.full_well)):
        assert done.json[key]["rms_db"] == pytest.approx(numbers.rms_db)
        assert done.json[key]["exposure"] == pytest.approx(numbers.exposure)
        assert done.json["measured_db"][key.removeprefix("equal_")] == pytest.approx(numbers.rms_db, abs=0.05)
    verdict = coding_pays(light, noise, signal_e=300.0)
    assert done.json["pays"]["time"] is verdict.pays and done.json["frames"] == 7
    assert done.json["break_even_e"] == pytest.approx(verdict.break_even_e)
    assert cv2.imread(str(tmp_path / "gain.png")).std() > 5
    table = lfcal(*words)
    assert table.code == 0 and "equal full well" in table.out and "coding" in table.err
    random = lfcal(*words, "--code", "random", "--frames", 14, "--density", 0.3, "--seed", 3, "--json")
    code = code_matrix("random", 7, frames=14, density=0.3, rng=np.random.default_rng(3))
    wanted = coding_gain(light, code, noise, signal_e=300.0).time.rms_db
    assert random.json["equal_time"]["rms_db"] == pytest.approx(wanted)
    corrected = lfcal(*words, "--json", "--uncorrected", "--workers", 1)
    assert corrected.code == 0 and corrected.json["full_e"] == pytest.approx(noise.full_e)


def test_patterns_for_a_display(lfcal: Lfcal, matrix: Path, tmp_path: Path) -> None:
    step = CAMERA.step_um(-20_000.0)
    display = f"64x48@{step / 2:.6f}"
    words = ("multiplex", "coding", matrix, "--points", 7, "--display", display)
    done = lfcal(*words, "--patterns", tmp_path / "code", "--repeat", 11, "--json")
    assert done.code == 0 and len(done.json["files"]) == 8, done.err
    assert done.json["display"]["fits"] and done.json["display"]["needed_um"] == pytest.approx(step)
    np.testing.assert_array_equal(np.load(tmp_path / "code/code.npy"), s_matrix(7))
    places = np.array([[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2], [2, 0]])
    fit = display_fit(step, float(display.partition("@")[2]))
    for k, shown in enumerate(display_frames(s_matrix(7), places, fit, (48, 64), repeat=(11, 11))):
        seen = cv2.imread(str(tmp_path / f"code/code_{k:03d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(seen, shown)
    lfcal(*words, "--patterns", tmp_path / "code").refused("--force")
    assert "too coarse" in lfcal("multiplex", "coding", matrix, "--display", "64x48@300").ok().err


def test_patterns_of_a_described_camera(lfcal: Lfcal) -> None:
    done = lfcal("multiplex", "coding", "bench", "--points", 3, "--virtual-depth", 3, "--signal", 100, "--json")
    assert done.code == 0 and "simulated" in done.json["source"], done.err
    assert done.json["equal_time"]["dark_db"] is not None


@pytest.mark.long
def test_patterns_of_a_described_camera_depend_on_depth_and_sensor(lfcal: Lfcal, tmp_path: Path) -> None:
    words = ("multiplex", "coding", "bench", "--points", 3, "--json")
    zero, default = lfcal(*words, "--virtual-depth", 0), lfcal(*words)
    assert zero.code == default.code == 0 and zero.json["source"] != default.json["source"], "0 is a depth"
    loud = replace(CAMERA, sensor=replace(CAMERA.sensor, read_noise_e=300.0))
    (tmp_path / "loud.json").write_text(loud.to_json())
    more = lfcal("multiplex", "coding", "bench", "--points", 3, "--sensor", tmp_path / "loud.json", "--json")
    assert more.code == 0 and more.json["additive_e2"] > 9e4


def test_what_is_refused(lfcal: Lfcal, matrix: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "bare.npy", np.ones((1, 2, 2, 3, 3), np.float32))
    for more, word in (
        (("--code", "H"), "code"),
        (("--points", 1), "points"),
        (("--plane", 7), "plane"),
        (("--depth", 5), "--depth"),
        (("--at", "1"), "y,x"),
        (("--at", "²,1"), "y,x"),
        (("--signal", "nan"), "electrons"),
        (("--signal", 1e9), "electrons"),
        (("--frames", 9), "frames"),
        (("--code", "random", "--density", 2), "fraction"),
        (("--display", "64@3"), "display"),
        (("--display", "64x48@nan"), "display"),
        (("--display", "64x48@-1"), "display"),
        (("--patterns", tmp_path / "code"), "--display"),
        (("--display", "2x2@1", "--patterns", tmp_path / "code"), "block"),
        (("--sensor", "nothing"), "camera"),
        (("-o", matrix, "--force"), "other than the input"),
    ):
        lfcal("multiplex", "coding", matrix, *more).refused(word)
    lfcal("multiplex", "coding", tmp_path / "bare.npy").refused("--sensor")
    lfcal("multiplex", "coding", tmp_path / "bare.npy", "--sensor", "r29", "--points", 2).ok()


# -- Options of ``lfcal multiplex`` against the library --
def test_demosaic_by_a_route(lfcal: Lfcal, tmp_path: Path) -> None:
    frame = np.random.default_rng(1).integers(0, 4000, (16, 18)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    command = ("multiplex", "demosaic", tmp_path / "frame.png", "--out", tmp_path / "rgb.tif", "--pattern", "GRBG")
    ways = {way: demultiplex(frame.astype(np.float32), cfa("GRBG"), route=way) for way in ("spatial", "fourier")}
    assert np.abs(ways["spatial"] - ways["fourier"]).max() > 10, "the routes differ"
    for route, wanted in ways.items():
        lfcal(*command, "--force", "--route", route).ok()
        np.testing.assert_allclose(tifffile.imread(tmp_path / "rgb.tif"), wanted, rtol=1e-4, atol=1e-2)
    lfcal(*command, "--force", "--route", "scenic").refused("spatial")


@pytest.mark.parametrize("pattern", ["GRBG", "X-Trans"])
def test_demosaic_interpolates_nan_and_masked_pixels(lfcal: Lfcal, tmp_path: Path, pattern: str) -> None:
    """A uniform colour is the same everywhere, also where pixels behind each filter of the pattern are lost."""
    light = np.array([300.0, 200, 100])[:, None, None] * np.ones((24, 30))
    frame = multiplex(light, cfa(pattern)).astype(np.float32)
    frame[5, 6:9], frame[11, 12], lost = np.nan, np.inf, [(16, 17), (16, 18), (17, 17)]
    for pixel in lost:
        frame[pixel] = 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("".join(f"{row},{column}\n" for row, column in lost))
    command = ("multiplex", "demosaic", tmp_path / "frame.tif", "-o", tmp_path / "rgb.tif", "--pattern", pattern)
    run = lfcal(*command, "--mask", tmp_path / "mask.csv", "--force").ok()
    assert "interpolated pixels (masked, or without a finite value): 7\n" in run.err
    np.testing.assert_allclose(tifffile.imread(tmp_path / "rgb.tif"), light, rtol=1e-4)
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 4), np.uint8))
    lfcal(*command, "--mask", tmp_path / "small.png", "--force").refused("small.png: expected 24 x 30 px")


def test_recover_leaves_out_nan_and_listed_pixels(lfcal: Lfcal, tmp_path: Path) -> None:
    frame = np.full((40, 44), 900, np.float32)
    frame[3, 4], frame[20, 21], frame[30, 31] = np.nan, -np.inf, 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("30,31\n")
    command = ("multiplex", "recover", tmp_path / "frame.tif", "--modulator", "nd:1", "-o", tmp_path / "found.tif")
    assert "excluded pixels (without a finite value): 2\n" in lfcal(*command, "--mask", tmp_path / "mask.csv").ok().err
    np.testing.assert_allclose(tifffile.imread(tmp_path / "found.tif"), 900, rtol=1e-5)
    plain = lfcal(*command, "--force", "--json").json
    assert plain["pixels_left_out"] == pytest.approx(2 / frame.size)
    lfcal(*command, "--force", "--route", "fourier").refused("NaN in the frame")


def test_views_leave_out_nan_and_listed_pixels(lfcal: Lfcal, tmp_path: Path) -> None:
    frame = np.full(preset("bench").sensor.shape, 500, np.float32)
    frame[100:103, 100:102], frame[200, 210] = np.nan, 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("200,210\n")
    command = ("multiplex", "views", tmp_path / "frame.tif", "--camera", "bench", "-o", tmp_path / "views.tif")
    done = lfcal(*command, "--mask", tmp_path / "mask.csv", "--size", 3, "--json").ok()
    assert done.json["pixels_left_out"] == pytest.approx(7 / frame.size)
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views.tif"), 500, rtol=1e-4)


def test_json_names_what_was_written(lfcal: Lfcal, tmp_path: Path) -> None:
    shown = lfcal("multiplex", "show", "MURA:5", "-o", tmp_path / "mura.png", "--json").json
    assert shown["side_px"] == [5, 5] and shown["rank"] == 25 and Path(shown["file"]).is_file()
    np.testing.assert_array_equal(shown["matrix"], mask("MURA", 5).matrix)
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((16, 18), 700, np.uint16))
    command = ("multiplex", "demosaic", tmp_path / "frame.png", "-o", tmp_path / "rgb.tif", "--pattern", "GRBG")
    told = lfcal(*command, "--dark", 50, "--json").json
    assert told["shape"] == list(tifffile.imread(tmp_path / "rgb.tif").shape) == [3, 16, 18]
    assert (told["pattern"], told["black_level"], told["samples"]) == ("GRBG", 50, ["R", "G", "B"])


@pytest.mark.long
def test_views_on_the_lattice_that_a_camera_states(lfcal: Lfcal, tmp_path: Path) -> None:
    camera = preset("bench")
    frame = np.random.default_rng(3).random(camera.sensor.shape).astype(np.float32)
    tifffile.imwrite(tmp_path / "field.tif", frame)
    command = ("multiplex", "views", tmp_path / "field.tif", "--camera", "bench", "-o", tmp_path / "views.tif")
    done = lfcal(*command, "--modulator", "MURA:5", "--route", "fourier", "--json").ok()
    wanted = demultiplex_lattice(frame, lattice_of(camera), mask("MURA", 5), route="fourier")
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views.tif"), wanted, rtol=1e-5, atol=1e-5)
    assert done.json["views"] == 25 and done.json["rows_columns"] == list(wanted.shape[1:])
    lfcal(*command, "--force", "--white", tmp_path / "field.tif").refused("--white and --camera")
    tifffile.imwrite(tmp_path / "field.tif", frame[:100])
    lfcal(*command, "--force").refused("of the lattice")


@pytest.mark.long
def test_json_lists_the_figures(lfcal: Lfcal, tmp_path: Path) -> None:
    files = lfcal("multiplex", "figures", tmp_path / "out", "--json").json["files"]
    assert len(files) == 9 and all(Path(path).is_file() for path in files)


def test_samples_and_their_deviation_are_two_files(lfcal: Lfcal, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((16, 18), 700, np.uint16))
    out = tmp_path / "out.tif"
    for name, *more in (("recover", "--modulator", "Bayer"), ("views", "--camera", "bench")):
        words = (name, tmp_path / "frame.png", *more, "-o", out, "--deviation", out)
        lfcal("multiplex", *words).refused("outputs: expected")
        assert not out.exists()


def test_the_number_of_workers_is_positive(lfcal: Lfcal) -> None:
    for name in ("compare", "search", "filters", "map", "design", "figures"):
        words = WRITERS[f"multiplex {name}"].words("--workers", "0")
        lfcal(*words).refused("--workers")
