"""``lfcal reconstruct --bars`` and ``--features``: uncertainty, tables of beads and lines."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base.progress import drain
from lfcal.fit import measured_of
from lfcal.fit.files import iter_write_fit
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.reconstruct import (
    BootstrapSettings,
    Feature,
    Projector,
    RlSolver,
    SolverChoice,
    VoxelGrid,
    error_bars,
    fit_features,
    load_volume,
)
from lfcal.reconstruct.volumes import volume_facts
from lfcal.tasks import ReconstructBars, command_of, python_of
from tests.cli.conftest import Lfcal
from tests.fit.commands import undrawn
from tests.fit.common import few_fit, few_patterns

# -- ``lfcal reconstruct --bars``: maps, sums over regions, refusals, and runs that continue --
SHAPE = (40, 44)
QUICK = ("--solver", "rl", "-n", 4, "--replicates", 3, "--margin", 0, "--gain", 1)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with H of two planes, a frame, and labels of two regions."""
    folder = tmp_path_factory.mktemp("bars")
    rng = np.random.default_rng(1)
    H = PSFMatrix(rng.random((2, 4, 4, 5, 5)), depths=[-200.0, -100.0], anchor=(2.0, 2.0))
    save(H, folder / "H.h5")
    volume = np.zeros((2, *SHAPE))
    volume[0, 10:20, 10:20], volume[1, 20:30, 20:30] = 40, 60
    tifffile.imwrite(folder / "frame.tif", rng.poisson(Projector(H, SHAPE).forward(volume) + 3).astype(np.uint16))
    tifffile.imwrite(folder / "labels.tif", np.where(volume.sum(0) > 0, 1 + (volume[1] > 0), 0).astype(np.uint8))
    return folder


def test_maps_and_sums_are_those_of_python(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    """The files contain the result of `error_bars`, and the printed table is that of the regions."""
    out = tmp_path / "v.tif"
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", out, "--bars", *QUICK)
    done = lfcal(*words, "--labels", place / "labels.tif", "--contrast", 0.7, "--seed", 3, "--background", 3).ok()
    cost = r"5 reconstructions with 4 iterations, about .* \(as long as 1 default reconstruction\), and .* of memory"
    assert re.search(cost, done.err)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        ["v.tif", "v_sigma.tif", "v_kappa.tif", "v_resolution.tif", "v_regions.csv"]
    )
    with open_psf(place / "H.h5") as H:
        P = Projector(H, SHAPE).prepare()
    choice = SolverChoice("rl", iterations=4, gain=1, background=3)
    settings = BootstrapSettings(replicates=3, contrast=0.7, seed=3)
    frame, labels = (tifffile.imread(place / name) for name in ("frame.tif", "labels.tif"))
    bars = error_bars(P, frame, choice, settings, labels=labels)
    for name, values in (("v", bars.volume), ("v_sigma", bars.sigma), ("v_kappa", bars.kappa)):
        np.testing.assert_allclose(load_volume(tmp_path / f"{name}.tif"), values, rtol=1e-4)
    for name in ("v", "v_sigma"):  # H states depths, although it has no camera
        depths = volume_facts(tmp_path / f"{name}.tif").depths_um
        assert depths is not None and depths.tolist() == [-200.0, -100.0]
    rows = list(csv.DictReader((tmp_path / "v_regions.csv").read_text().splitlines()))
    assert [int(row["label"]) for row in rows] == [1, 2] and rows[0]["first_plane"] == "0"
    for row, one in zip(rows, bars.regions, strict=True):
        low, high = one.interval(0.95)
        parts = ("sigma_noise", "sigma_h", "sigma_object")
        found = [float(row[key]) for key in ("sum", "sigma", *parts, "low_95", "high_95")]
        np.testing.assert_allclose(found, [one.total, one.sigma, one.noise, one.h, one.object, low, high], rtol=1e-3)
        assert f"{one.total:,.0f}" in done.out
    assert "3 replicates" in done.out and "Intervals were tested only with 60 iterations of rl-nesterov" in done.out


@pytest.mark.long
def test_other_executors_formats_and_ways_agree(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars", *QUICK)
    lfcal(*words, "-o", tmp_path / "a.npy").ok()
    done = lfcal(*words, "-o", tmp_path / "b.ome.tif", "--executor", "processes", "--workers", 2, "--json").ok()
    names = [Path(name).name for name in json.loads(done.out)["files"]]
    assert names == ["b.ome.tif", "b_sigma.ome.tif", "b_kappa.ome.tif", "b_resolution.ome.tif"]
    task = ReconstructBars(
        psf=place / "H.h5",
        frames=place / "frame.tif",
        out=tmp_path / "c.npy",
        solver=RlSolver(iterations=4, gain=1.0),
        bootstrap=BootstrapSettings(replicates=3),
        grid=VoxelGrid(margin=0),
    )
    (made,) = task.run()
    assert json.loads(json.dumps(made.to_dict()))["files"][0] == str(tmp_path / "c.npy")
    for name in ("b_sigma.ome.tif", "c_sigma.npy"):
        np.testing.assert_allclose(load_volume(tmp_path / name), load_volume(tmp_path / "a_sigma.npy"), rtol=1e-4)
    assert "--bars" in command_of(task) and "ReconstructBars(" in python_of(task)


def test_a_stopped_run_continues(lfcal: Lfcal, place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that was stopped after some replicates keeps them, and ends with the same result."""
    from lfcal.reconstruct import bar_run

    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars", *QUICK, "--executor", "threads")
    lfcal(*words, "-o", tmp_path / "whole.npy").ok()
    begun: list[int] = []
    usual = bar_run.Replicates.iter_replicate

    def stopping(self, clock, done, model, noise, key, **how):
        begun.append(key[1])
        if key[1] == 2 and begun.count(2) == 1:
            raise KeyboardInterrupt
        return usual(self, clock, done, model, noise, key, **how)

    monkeypatch.setattr(bar_run.Replicates, "iter_replicate", stopping)
    out = ("-o", tmp_path / "v.npy", "--workers", 1)
    assert lfcal(*words, *out).code != 0
    assert not (tmp_path / "v.npy").exists() and not (tmp_path / "v_sigma.npy").exists()
    assert "--resume" in lfcal(*words, *out).err
    lfcal(*words, *out, "--resume").ok()
    assert begun.count(0) == begun.count(1) == 1
    for name in ("", "_sigma", "_kappa"):
        np.testing.assert_array_equal(np.load(tmp_path / f"v{name}.npy"), np.load(tmp_path / f"whole{name}.npy"))
    assert not list(tmp_path.glob("*.parts"))


def test_far_from_the_regions_there_is_no_map(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "near.tif", np.pad(np.ones((6, 7), np.uint8), ((12, 22), (11, 26))))
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars")
    regions = ("--labels", tmp_path / "near.tif", "--crop")
    lfcal(*words, *QUICK, *regions, "-o", tmp_path / "part.npy").ok()
    sigma = np.load(tmp_path / "part_sigma.npy")
    # the cutout has 5 pixels
    known = np.zeros(SHAPE, bool)
    known[7:23, 6:23] = True
    np.testing.assert_array_equal(np.isfinite(sigma), np.broadcast_to(known, sigma.shape))
    lfcal(*words, "--crop", "-o", tmp_path / "v.npy").refused("--crop: expected regions")


@pytest.mark.long
@pytest.mark.parametrize("margin", [0, 6])
def test_around_the_regions_the_bars_are_those_of_the_whole_frame(
    lfcal: Lfcal, place: Path, tmp_path: Path, margin: int
) -> None:
    """--crop computes the same volume, and similar uncertainties of sums; far from the regions, there is no map."""
    tifffile.imwrite(tmp_path / "near.tif", np.pad(np.ones((6, 7), np.uint8), ((12, 22), (11, 26))))
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars", "--labels", tmp_path / "near.tif")
    # after fewer iterations, the volume depends on the mean of the frame
    how = ("--solver", "rl-nesterov", "-n", 40, "--replicates", 20, "--margin", margin, "--gain", 1)
    rows = {}
    for name, more in (("whole", ()), ("part", ("--crop",))):
        lfcal(*words, *how, *more, "-o", tmp_path / f"{name}.npy").ok()
        (rows[name],) = csv.DictReader((tmp_path / f"{name}_regions.csv").read_text().splitlines())
    np.testing.assert_allclose(np.load(tmp_path / "part.npy"), np.load(tmp_path / "whole.npy"), rtol=1e-4, atol=1e-4)
    sigma, other = np.load(tmp_path / "part_sigma.npy"), np.load(tmp_path / "whole_sigma.npy")
    # the cutout has 5 pixels
    known = np.zeros(SHAPE, bool)
    known[7:23, 6:23] = True
    np.testing.assert_array_equal(np.isfinite(sigma), np.broadcast_to(known, sigma.shape))
    assert rows["part"]["sum"] == rows["whole"]["sum"]
    for key in ("sigma", "sigma_noise"):
        assert float(rows["part"][key]) == pytest.approx(float(rows["whole"][key]), rel=0.4), key
    inner = (slice(None), slice(12, 18), slice(11, 18))
    assert np.median(sigma[inner] / other[inner]) == pytest.approx(1, abs=0.15)


def test_settings_that_do_not_apply_are_refused(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    frame = tifffile.imread(place / "frame.tif")
    tifffile.imwrite(place / "small.tif", np.ones((3, 3), np.uint8))
    tifffile.imwrite(place / "two.tif", np.stack([frame] * 2))
    out = ("-o", tmp_path / "v.tif")
    for frames, words, said in (
        (
            "frame.tif",
            (*out, "--bars", "--solver", "sieve", "-n", "auto"),
            "iterations of a reconstruction with error bars",
        ),
        ("frame.tif", (*out, "--bars", "--tolerance", 0.1), "tolerance of a reconstruction with error bars"),
        ("frame.tif", (*out, "--bars", "--voxel", 2), "--voxel"),
        ("frame.tif", (*out, "--bars", "--replicates", 2), "--replicates"),
        ("frame.tif", (*out, "--bars", "--labels", place / "small.tif", "--margin", 0), "labels of regions"),
        ("frame.tif", ("-o", tmp_path / "v.jpg", "--bars"), "volume file: expected .tif, .tiff"),
        ("frame.tif", (*out, "--labels", place / "labels.tif"), "--labels: expected a frame with error bars"),
        ("two.tif", (*out, "--bars"), "frames for error bars: expected one frame, got 2 frames"),
    ):
        run = lfcal("reconstruct", place / "H.h5", place / frames, *words)
        assert run.code == 2 and said in run.err and not list(tmp_path.iterdir()), (words, run.err)


@pytest.mark.long
def test_the_tests_of_intervals_are_quoted_for_the_default_settings(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    frame = tifffile.imread(place / "frame.tif").astype(np.float32)
    frame[3, 4:6] = np.nan
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    words = ("reconstruct", place / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.npy", "--bars", "--gain", 1)
    done = lfcal(*words, "--margin", 0)
    assert done.code == 0 and "95 % intervals contained the true value" in done.out
    assert "note: 2 non-finite pixels were left out" in done.err
    json_words = (*words[:4], tmp_path / "w.npy", *words[5:], "--replicates", 9, "--json")
    assert json.loads(lfcal(*json_words).out)["tested"] is False


# -- ``lfcal reconstruct --features``: tables of beads and lines, the rest of the volume, and refusals --
FIELD = (44, 48)
DEPTHS = (-300.0, -200.0, -100.0)
FAST = ("--replicates", 3, "--solver", "rl-nesterov", "-n", 12, "--margin", 0, "--gain", 1, "--background", 5)


@pytest.fixture(scope="module")
def beads(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with H of three planes that differ, and a frame of two beads and a line."""
    folder = tmp_path_factory.mktemp("features")
    H = PSFMatrix(np.random.default_rng(1).random((3, 4, 4, 5, 5)), depths=list(DEPTHS), anchor=(2.0, 2.0))
    save(H, folder / "H.h5")
    y, x = np.indices(FIELD)
    volume = np.zeros((3, *FIELD))
    for plane, row, column in ((0, 12.3, 12.8), (2, 30.6, 14.1)):
        volume[plane] += 900 * np.exp(-((y - row) ** 2 + (x - column) ** 2) / 2)
    for column in np.linspace(26, 40, 80):
        volume[1] += 20 * np.exp(-((y - 22) ** 2 + (x - column) ** 2) / 2)
    frame = np.random.default_rng(2).poisson(Projector(H, FIELD).forward(volume) + 5)
    tifffile.imwrite(folder / "frame.tif", frame.astype(np.uint16))
    (folder / "given.csv").write_text(
        "row;column;depth_um;width;end_row;end_column;remark\n"
        "12;13;-300,0;1,0;;;left\n30,5;14;;1,0;;;\n22;26;-200;;22;40;a line\n"
    )
    return folder


def test_table_and_rest_are_those_of_python(lfcal: Lfcal, beads: Path, tmp_path: Path) -> None:
    """The files contain the result of `fit_features`, for a table of a spreadsheet with decimal commas."""
    out = tmp_path / "rest.ome.tif"
    words = ("reconstruct", beads / "H.h5", beads / "frame.tif", "-o", out, *FAST)
    done = lfcal(*words, "--features", beads / "given.csv", "--contrast", 0.7, "--seed", 3).ok()
    maps = [f"rest_{name}.ome.tif" for name in ("kappa", "resolution", "sigma")]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["rest.ome.tif", *maps, "rest_features.csv"])
    with open_psf(beads / "H.h5") as H:
        P = Projector(H, FIELD).prepare()
    features = [Feature(12, 13, 0, width=1.0), Feature(30.5, 14, width=1.0), Feature(22, 26, 1, end=(22, 40))]
    choice = SolverChoice("rl-nesterov", iterations=12, gain=1, background=5)
    frame = tifffile.imread(beads / "frame.tif")
    fit = fit_features(P, frame, features, choice, contrast=0.7, seed=3, replicates=3)
    np.testing.assert_allclose(load_volume(out), fit.rest, rtol=1e-4, atol=1e-6)
    assert fit.bars is not None
    np.testing.assert_allclose(load_volume(tmp_path / "rest_sigma.ome.tif"), fit.bars.sigma, rtol=1e-3)
    rows = list(csv.DictReader((tmp_path / "rest_features.csv").read_text().splitlines()))
    for row, one in zip(rows, fit.features, strict=True):
        assert float(row["row"]) == pytest.approx(one.feature.row, rel=1e-4)
        assert float(row["depth_um"]) == pytest.approx(one.depth_um, rel=1e-4)
        if one.fits:
            assert float(row["sigma_row"]) == pytest.approx(one.sigmas["row"], rel=1e-2)
        assert (row["end_row"] == "") == (one.feature.end is None)
    assert "bead" in done.out and "line" in done.out and "rest_features.csv" in done.out


@pytest.mark.long
def test_beads_are_found_and_the_table_can_be_used_again(lfcal: Lfcal, beads: Path, tmp_path: Path) -> None:
    words = ("reconstruct", beads / "H.h5", beads / "frame.tif", *FAST)
    done = lfcal(*words, "-o", tmp_path / "a.tif", "--features", "auto", "--json").ok()
    made = json.loads(done.out)
    assert [Path(name).name for name in made["files"]][::4] == ["a.tif", "a_features.csv"]
    bright = sorted((one["feature"]["row"], one["feature"]["column"]) for one in made["features"][:2])
    np.testing.assert_allclose(bright, [(12.3, 12.8), (30.6, 14.1)], atol=0.3)
    lfcal(*words, "-o", tmp_path / "b.tif", "--features", tmp_path / "a_features.csv").ok()


def test_tables_that_cannot_be_used_are_refused(lfcal: Lfcal, beads: Path, tmp_path: Path) -> None:
    words = ("reconstruct", beads / "H.h5", beads / "frame.tif", "-o", tmp_path / "v.tif", *FAST, "--features")
    for text, said in (
        ("x,y\n3,4\n", "columns row and column"),
        ("row,column\n3,left\n", "column in .* line 2: expected a number"),
        ("row,column\n3,\n", "line 2: expected a row and a column"),
        ("row,column\n300,4\n", "inside of the frame"),
        ("row,column,depth_um\n10,10,50\n", "depth of a feature"),
        ("row,column,end_row\n10,10,20\n", "line 2: expected a row and a column"),
        ("", "empty"),
    ):
        (tmp_path / "wrong.csv").write_text(text)
        run = lfcal(*words, tmp_path / "wrong.csv").refused()
        assert re.search(said, run.err) and [p.name for p in tmp_path.iterdir()] == ["wrong.csv"], text
    lfcal(*words, "auto", "-n", "auto").refused("iterations of a fit of features: expected a fixed number")


@pytest.mark.long
def test_a_place_without_a_bead_has_no_uncertainty(lfcal: Lfcal, beads: Path, tmp_path: Path) -> None:
    """A fit that wandered away from an empty place claimed that its column and depth were exact."""
    y, x = np.indices(FIELD)
    volume = np.zeros((3, *FIELD))
    volume[0] = 900 * np.exp(-((y - 12.3) ** 2 + (x - 12.8) ** 2) / 2)
    with open_psf(beads / "H.h5") as H:
        frame = np.random.default_rng(2).poisson(Projector(H, FIELD).forward(volume) + 5)
    tifffile.imwrite(tmp_path / "frame.tif", frame.astype(np.uint16))
    (tmp_path / "empty.csv").write_text("row,column\n35,40\n")
    words = ("reconstruct", beads / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.npy", "--features")
    lfcal(*words, tmp_path / "empty.csv", "--gain", 1, "-n", 5).ok()
    (row,) = csv.DictReader((tmp_path / "v_features.csv").read_text().splitlines())
    free = [row[f"sigma_{name}"] for name in ("row", "column", "depth_um", "brightness", "width")]
    assert all(value == "" for value in free) or all(float(value) > 0 for value in free), row


# -- ``--fit``: the uncertainty of a fitted H --
@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a fit with its H, a bright frame of a bead on a wide square, and labels of the square."""
    folder = tmp_path_factory.mktemp("fitted")
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch)
        drain(iter_write_fit(few_fit(), measured_of(few_patterns()), folder / "fit", {}))
    y, x = np.indices(SHAPE)
    volume = 400 * np.exp(-((y - 18.2) ** 2 + (x - 21.7) ** 2) / 2)[None]
    volume[0, 8:30, 10:34] += 1
    with open_psf(folder / "fit" / "H.h5") as H:
        light = Projector(H, SHAPE, workers=1).forward(volume)
    frame = np.random.default_rng(3).poisson(5e4 * light / light.max())
    tifffile.imwrite(folder / "frame.tif", frame.astype(np.uint16))
    tifffile.imwrite(folder / "labels.tif", (volume[0] > 0.5).astype(np.uint8))
    (folder / "bead.csv").write_text("row,column,width\n18,22,1\n")
    return folder


@pytest.mark.long
def test_the_uncertainty_of_a_fit_lengthens_the_bars(lfcal: Lfcal, fitted: Path, tmp_path: Path) -> None:
    """With --fit, sums have a part that is due to H, and features are less certain; H is varied only once."""
    words = ("reconstruct", fitted / "fit" / "H.h5", fitted / "frame.tif", "--margin", 0, "--gain", 1)
    bars = ("--bars", "--labels", fitted / "labels.tif", "--solver", "rl", "-n", 4, "--replicates", 3)
    rows = {}
    for name, more in (("exact", ()), ("fitted", ("--fit", fitted / "fit"))):
        done = lfcal(*words, "-o", tmp_path / f"{name}.npy", *bars, *more).ok()
        assert ("assumed to be exact" in done.out) == (name == "exact")
        (rows[name],) = csv.DictReader((tmp_path / f"{name}_regions.csv").read_text().splitlines())
    assert float(rows["exact"]["sigma_h"]) == 0 < float(rows["fitted"]["sigma_h"])
    sums = [rows[name]["sum"] for name in rows]
    assert sums[0] == sums[1]
    made = (fitted / "fit" / "deviations.h5").stat().st_mtime_ns
    beads, sigmas = ("--features", fitted / "bead.csv", "-n", 5, "--replicates", 3), []
    for more in ((), ("--fit", fitted / "fit")):
        done = lfcal(*words, "-o", tmp_path / "rest.npy", *beads, *more, "--json")
        (one,) = json.loads(done.ok().out)["features"]
        sigmas.append(one["sigmas"]["row"])
        for file in tmp_path.glob("rest*"):
            file.unlink()
    assert 0 < sigmas[0] < sigmas[1]
    assert (fitted / "fit" / "deviations.h5").stat().st_mtime_ns == made


def test_a_fit_that_does_not_apply_is_refused(lfcal: Lfcal, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", tmp_path / "v.npy", "--fit", place)
    lfcal(*words).refused("--fit: expected")
    lfcal(*words, "--bars", "--region", place / "H.h5").refused("--fit: expected H of one region")


@pytest.mark.long
def test_a_fit_of_another_scan_is_refused(lfcal: Lfcal, fitted: Path, place: Path, tmp_path: Path) -> None:
    out = ("-o", tmp_path / "v.npy", "--fit", fitted / "fit")
    lfcal("reconstruct", fitted / "fit" / "H.h5", fitted / "frame.tif", *out).refused("--fit: expected")
    words = ("reconstruct", place / "H.h5", place / "frame.tif", *out, "--bars")
    lfcal(*words).refused("the folder of the fit of this scan")
