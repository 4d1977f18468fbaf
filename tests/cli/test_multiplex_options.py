"""Options of ``lfcal multiplex`` against the library."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import preset
from lfcal.lattice import lattice_of
from lfcal.multiplex import cfa, demultiplex, demultiplex_lattice, mask, multiplex
from tests.cli.conftest import Run


@pytest.mark.parametrize("route", ["spatial", "fourier"])
def test_demosaic_by_a_route(lfcal: Callable[..., Run], tmp_path: Path, route: str) -> None:
    frame = np.random.default_rng(1).integers(0, 4000, (16, 18)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "frame.png"), frame)
    command = ("multiplex", "demosaic", tmp_path / "frame.png", "--out", tmp_path / "rgb.tif", "--pattern", "GRBG")
    done = lfcal(*command, "--route", route)
    assert done.code == 0, done.err
    ways = {way: demultiplex(frame.astype(np.float32), cfa("GRBG"), route=way) for way in ("spatial", "fourier")}
    made = tifffile.imread(tmp_path / "rgb.tif")
    np.testing.assert_allclose(made, ways.pop(route), rtol=1e-4, atol=1e-2)
    assert np.abs(made - ways.popitem()[1]).max() > 10, "the routes differ"
    refused = lfcal(*command, "--force", "--route", "scenic")
    assert refused.code == 2 and "spatial" in refused.err


@pytest.mark.parametrize("pattern", ["GRBG", "X-Trans"])
def test_demosaic_interpolates_nan_and_masked_pixels(lfcal: Callable[..., Run], tmp_path: Path, pattern: str) -> None:
    """A uniform colour is the same everywhere, also where pixels behind each filter of the pattern are lost."""
    light = np.array([300.0, 200, 100])[:, None, None] * np.ones((24, 30))
    frame = multiplex(light, cfa(pattern)).astype(np.float32)
    frame[5, 6:9], frame[11, 12], lost = np.nan, np.inf, [(16, 17), (16, 18), (17, 17)]
    for pixel in lost:
        frame[pixel] = 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("".join(f"{row},{column}\n" for row, column in lost))
    command = ("multiplex", "demosaic", tmp_path / "frame.tif", "-o", tmp_path / "rgb.tif", "--pattern", pattern)
    done = lfcal(*command, "--mask", tmp_path / "mask.csv", "--force")
    assert done.code == 0 and "interpolated pixels (masked, or without a finite value): 7\n" in done.err, done.err
    np.testing.assert_allclose(tifffile.imread(tmp_path / "rgb.tif"), light, rtol=1e-4)
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((4, 4), np.uint8))
    refused = lfcal(*command, "--mask", tmp_path / "small.png", "--force")
    assert refused.code == 2 and "small.png: expected 24 x 30 px" in refused.err


def test_recover_leaves_out_nan_and_listed_pixels(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    frame = np.full((40, 44), 900, np.float32)
    frame[3, 4], frame[20, 21], frame[30, 31] = np.nan, -np.inf, 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("30,31\n")
    command = ("multiplex", "recover", tmp_path / "frame.tif", "--modulator", "nd:1", "-o", tmp_path / "found.tif")
    done = lfcal(*command, "--mask", tmp_path / "mask.csv")
    assert done.code == 0 and "excluded pixels (without a finite value): 2\n" in done.err, done.err
    np.testing.assert_allclose(tifffile.imread(tmp_path / "found.tif"), 900, rtol=1e-5)
    plain = lfcal(*command, "--force", "--json").json
    assert plain["pixels_left_out"] == pytest.approx(2 / frame.size)
    refused = lfcal(*command, "--force", "--route", "fourier")
    assert refused.code == 2 and "NaN in the frame" in refused.err


def test_views_leave_out_nan_and_listed_pixels(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    camera = preset("bench")
    frame = np.full(camera.sensor.shape, 500, np.float32)
    frame[100:103, 100:102], frame[200, 210] = np.nan, 60000
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    (tmp_path / "mask.csv").write_text("200,210\n")
    command = ("multiplex", "views", tmp_path / "frame.tif", "--camera", "bench", "-o", tmp_path / "views.tif")
    done = lfcal(*command, "--mask", tmp_path / "mask.csv", "--size", 3, "--json")
    assert done.code == 0 and done.json["pixels_left_out"] == pytest.approx(7 / frame.size), done.err
    views = tifffile.imread(tmp_path / "views.tif")
    np.testing.assert_allclose(views[np.isfinite(views)], 500, rtol=1e-4)
    assert np.isfinite(views).all()


def test_what_was_written_is_told_to_scripts(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    shown = lfcal("multiplex", "show", "MURA:5", "-o", tmp_path / "mura.png", "--json").json
    assert shown["side_px"] == [5, 5] and shown["rank"] == 25 and Path(shown["file"]).is_file()
    np.testing.assert_array_equal(shown["matrix"], mask("MURA", 5).matrix)
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((16, 18), 700, np.uint16))
    command = ("multiplex", "demosaic", tmp_path / "frame.png", "-o", tmp_path / "rgb.tif", "--pattern", "GRBG")
    told = lfcal(*command, "--dark", 50, "--json").json
    assert told["shape"] == list(tifffile.imread(tmp_path / "rgb.tif").shape) == [3, 16, 18]
    assert (told["pattern"], told["black_level"], told["samples"]) == ("GRBG", 50, ["R", "G", "B"])


@pytest.mark.long
def test_views_on_the_lattice_that_a_camera_states(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    camera = preset("bench")
    frame = np.random.default_rng(3).random(camera.sensor.shape).astype(np.float32)
    tifffile.imwrite(tmp_path / "field.tif", frame)
    command = ("multiplex", "views", tmp_path / "field.tif", "--camera", "bench", "-o", tmp_path / "views.tif")
    done = lfcal(*command, "--modulator", "MURA:5", "--route", "fourier", "--json")
    assert done.code == 0, done.err
    wanted = demultiplex_lattice(frame, lattice_of(camera), mask("MURA", 5), route="fourier")
    np.testing.assert_allclose(tifffile.imread(tmp_path / "views.tif"), wanted, rtol=1e-5, atol=1e-5)
    assert done.json["views"] == 25 and done.json["rows_columns"] == list(wanted.shape[1:])
    both = lfcal(*command, "--force", "--white", tmp_path / "field.tif")
    assert both.code == 2 and "--white and --camera" in both.err
    tifffile.imwrite(tmp_path / "field.tif", frame[:100])
    other = lfcal(*command, "--force")
    assert other.code == 2 and "of the lattice" in other.err


@pytest.mark.long
def test_figures_are_listed_to_scripts(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    files = lfcal("multiplex", "figures", tmp_path / "out", "--json").json["files"]
    assert len(files) == 9 and all(Path(path).is_file() for path in files)


@pytest.mark.parametrize("words", [("recover", "--modulator", "Bayer"), ("views", "--camera", "bench")], ids=" ".join)
def test_samples_and_their_deviation_are_two_files(
    lfcal: Callable[..., Run], tmp_path: Path, words: tuple[str, ...]
) -> None:
    cv2.imwrite(str(tmp_path / "frame.png"), np.full((16, 18), 700, np.uint16))
    name, *more = words
    out = tmp_path / "out.tif"
    refused = lfcal("multiplex", name, tmp_path / "frame.png", *more, "-o", out, "--deviation", out)
    assert refused.code == 2 and "outputs: expected" in refused.err and not out.exists(), refused.err
