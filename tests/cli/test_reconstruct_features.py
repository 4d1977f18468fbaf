"""``lfcal reconstruct --features``: tables of beads and lines, the rest of the volume, and refusals."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.reconstruct import Feature, Projector, SolverChoice, fit_features, load_volume
from tests.cli.conftest import Run

SHAPE = (44, 48)
DEPTHS = (-300.0, -200.0, -100.0)
QUICK = ("--solver", "rl-nesterov", "-n", 12, "--margin", 0, "--gain", 1, "--background", 5)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with H of three planes that differ, and a frame of two beads and a line."""
    folder = tmp_path_factory.mktemp("features")
    H = PSFMatrix(np.random.default_rng(1).random((3, 4, 4, 5, 5)), depths=list(DEPTHS), anchor=(2.0, 2.0))
    save(H, folder / "H.h5")
    y, x = np.indices(SHAPE)
    volume = np.zeros((3, *SHAPE))
    for plane, row, column in ((0, 12.3, 12.8), (2, 30.6, 14.1)):
        volume[plane] += 900 * np.exp(-((y - row) ** 2 + (x - column) ** 2) / 2)
    for column in np.linspace(26, 40, 80):
        volume[1] += 20 * np.exp(-((y - 22) ** 2 + (x - column) ** 2) / 2)
    frame = np.random.default_rng(2).poisson(Projector(H, SHAPE).forward(volume) + 5)
    tifffile.imwrite(folder / "frame.tif", frame.astype(np.uint16))
    (folder / "given.csv").write_text(
        "row;column;depth_um;width;end_row;end_column;remark\n"
        "12;13;-300,0;1,0;;;left\n30,5;14;;1,0;;;\n22;26;-200;;22;40;a line\n"
    )
    return folder


def test_table_and_rest_are_those_of_python(lfcal: Run, place: Path, tmp_path: Path) -> None:
    """The files contain the result of `fit_features`, for a table of a spreadsheet with decimal commas."""
    out = tmp_path / "rest.ome.tif"
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", out, *QUICK)
    done = lfcal(*words, "--features", place / "given.csv", "--contrast", 0.7, "--seed", 3)
    assert done.code == 0, done.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rest.ome.tif", "rest_features.csv"]
    with open_psf(place / "H.h5") as H:
        P = Projector(H, SHAPE).prepare()
    features = [
        Feature(12, 13, 0, width=1.0),
        Feature(30.5, 14, width=1.0),
        Feature(22, 26, 1, end=(22, 40)),
    ]
    choice = SolverChoice("rl-nesterov", iterations=12, gain=1, background=5)
    fit = fit_features(P, tifffile.imread(place / "frame.tif"), features, choice, contrast=0.7, seed=3)
    np.testing.assert_allclose(load_volume(out), fit.rest, rtol=1e-4, atol=1e-6)
    rows = list(csv.DictReader((tmp_path / "rest_features.csv").read_text().splitlines()))
    for row, one in zip(rows, fit.features, strict=True):
        assert float(row["row"]) == pytest.approx(one.feature.row, rel=1e-4)
        assert float(row["depth_um"]) == pytest.approx(one.depth_um, rel=1e-4)
        if one.fits:
            assert float(row["sigma_row"]) == pytest.approx(one.sigmas["row"], rel=1e-2)
        assert (row["end_row"] == "") == (one.feature.end is None)
    assert "bead" in done.out and "line" in done.out and "rest_features.csv" in done.out


def test_beads_are_found_and_the_table_can_be_used_again(lfcal: Run, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", *QUICK)
    done = lfcal(*words, "-o", tmp_path / "a.tif", "--features", "auto", "--json")
    assert done.code == 0, done.err
    made = json.loads(done.out)
    assert [Path(name).name for name in made["files"]] == ["a.tif", "a_features.csv"]
    bright = sorted((one["feature"]["row"], one["feature"]["column"]) for one in made["features"][:2])
    np.testing.assert_allclose(bright, [(12.3, 12.8), (30.6, 14.1)], atol=0.3)
    again = lfcal(*words, "-o", tmp_path / "b.tif", "--features", tmp_path / "a_features.csv")
    assert again.code == 0, again.err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y\n3,4\n", "columns row and column"),
        ("row,column\n3,left\n", "column in .* line 2: expected a number"),
        ("row,column\n3,\n", "line 2: expected a row and a column"),
        ("row,column\n300,4\n", "inside of the frame"),
        ("row,column,depth_um\n10,10,50\n", "depth of a feature"),
        ("row,column,end_row\n10,10,20\n", "line 2: expected a row and a column"),
        ("", "empty"),
    ],
)
def test_tables_that_cannot_be_used(lfcal: Run, place: Path, tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "wrong.csv").write_text(text)
    done = lfcal(
        *("reconstruct", place / "H.h5", place / "frame.tif", "-o", tmp_path / "v.tif", *QUICK),
        *("--features", tmp_path / "wrong.csv"),
    )
    assert done.code == 2 and len(done.err.strip().splitlines()) <= 2, done.err
    assert re.search(words, done.err), done.err
    assert [p.name for p in tmp_path.iterdir()] == ["wrong.csv"]


def test_a_place_without_a_bead_has_no_uncertainty(lfcal: Run, place: Path, tmp_path: Path) -> None:
    """A fit that wandered away from an empty place claimed that its column and depth were exact."""
    y, x = np.indices(SHAPE)
    volume = np.zeros((3, *SHAPE))
    volume[0] = 900 * np.exp(-((y - 12.3) ** 2 + (x - 12.8) ** 2) / 2)
    with open_psf(place / "H.h5") as H:
        frame = np.random.default_rng(2).poisson(Projector(H, SHAPE).forward(volume) + 5)
    tifffile.imwrite(tmp_path / "frame.tif", frame.astype(np.uint16))
    (tmp_path / "empty.csv").write_text("row,column\n35,40\n")
    words = ("reconstruct", place / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.npy", "--features")
    done = lfcal(*words, tmp_path / "empty.csv", "--gain", 1, "-n", 5)
    assert done.code == 0, done.err
    (row,) = csv.DictReader((tmp_path / "v_features.csv").read_text().splitlines())
    free = [row[f"sigma_{name}"] for name in ("row", "column", "depth_um", "brightness", "width")]
    assert all(value == "" for value in free) or all(float(value) > 0 for value in free), row


def test_an_automatic_stop_is_refused_for_a_fit(lfcal: Run, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", tmp_path / "v.npy", "--features", "auto")
    done = lfcal(*words, "--iterations", "auto")
    assert done.code == 2 and "iterations of a fit of features: expected a fixed number" in done.err
