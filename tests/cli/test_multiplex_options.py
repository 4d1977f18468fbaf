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
from lfcal.multiplex import cfa, demultiplex, demultiplex_lattice, mask
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
