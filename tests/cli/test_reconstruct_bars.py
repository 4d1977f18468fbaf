"""``lfcal reconstruct --bars``: maps, sums over regions, refusals, and runs that continue."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.reconstruct import BootstrapSettings, Projector, RlSolver, SolverChoice, VoxelGrid, error_bars, load_volume
from lfcal.reconstruct.volumes import volume_facts
from lfcal.tasks import ReconstructBars, command_of, python_of
from tests.cli.conftest import Run

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


def test_maps_and_sums_are_those_of_python(lfcal: Run, place: Path, tmp_path: Path) -> None:
    """The files contain the result of `error_bars`, and the printed table is that of the regions."""
    out = tmp_path / "v.tif"
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", out, "--bars", *QUICK)
    done = lfcal(*words, "--labels", place / "labels.tif", "--contrast", 0.7, "--seed", 3, "--background", 3)
    assert done.code == 0, done.err
    assert "error bars need 5 reconstructions with 4 iterations, about" in done.err
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
        found = [float(row[key]) for key in ("sum", "sigma", "sigma_noise", "low_95", "high_95")]
        np.testing.assert_allclose(found, [one.total, one.sigma, one.noise, low, high], rtol=1e-3)
        assert f"{one.total:,.0f}" in done.out
    assert "3 replicates" in done.out and "Intervals were tested only with 60 iterations of rl-nesterov" in done.out


def test_other_executors_formats_and_ways_agree(lfcal: Run, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars", *QUICK)
    assert lfcal(*words, "-o", tmp_path / "a.npy").code == 0
    done = lfcal(*words, "-o", tmp_path / "b.ome.tif", "--executor", "processes", "--workers", 2, "--json")
    assert done.code == 0, done.err
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


def test_a_stopped_run_continues(lfcal: Run, place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that was stopped after some replicates keeps them, and ends with the same result."""
    from lfcal.reconstruct import bar_run

    words = ("reconstruct", place / "H.h5", place / "frame.tif", "--bars", *QUICK, "--executor", "threads")
    assert lfcal(*words, "-o", tmp_path / "whole.npy").code == 0
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
    assert lfcal(*words, *out, "--resume").code == 0
    assert begun.count(0) == begun.count(1) == 1
    for name in ("", "_sigma", "_kappa"):
        np.testing.assert_array_equal(np.load(tmp_path / f"v{name}.npy"), np.load(tmp_path / f"whole{name}.npy"))
    assert not list(tmp_path.glob("*.parts"))


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ("--solver", "sieve", "-n", "auto"),
            "iterations of a reconstruction with error bars",
        ),
        (("--tolerance", 0.1), "tolerance of a reconstruction with error bars"),
        (("--voxel", 2), "--voxel"),
        (("--replicates", 2), "--replicates"),
        (("--labels", "frame.tif", "--margin", 0), "labels of regions"),
        (("-o", "v.jpg"), "volume file: expected .tif, .tiff"),
    ],
)
def test_settings_that_do_not_apply_are_refused(
    lfcal: Run, place: Path, tmp_path: Path, words: tuple[object, ...], expected: str
) -> None:
    places = {"frame.tif": place / "small.tif", "v.jpg": tmp_path / "v.jpg"}
    given = [places.get(str(word), word) for word in words]
    tifffile.imwrite(place / "small.tif", np.ones((3, 3), np.uint8))
    done = lfcal("reconstruct", place / "H.h5", place / "frame.tif", "-o", tmp_path / "v.tif", "--bars", *given)
    assert done.code == 2 and expected in done.err, done.err
    assert not list(tmp_path.iterdir())


def test_the_tests_of_intervals_are_quoted_for_the_default_settings(lfcal: Run, place: Path, tmp_path: Path) -> None:
    frame = tifffile.imread(place / "frame.tif").astype(np.float32)
    frame[3, 4:6] = np.nan
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    words = ("reconstruct", place / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.npy", "--bars", "--gain", 1)
    done = lfcal(*words, "--margin", 0)
    assert done.code == 0 and "95 % intervals contained the true value" in done.out
    assert "note: 2 non-finite pixels were left out" in done.err
    json_words = (*words[:4], tmp_path / "w.npy", *words[5:], "--replicates", 9, "--json")
    assert json.loads(lfcal(*json_words).out)["tested"] is False


def test_options_of_error_bars_need_bars(lfcal: Run, place: Path, tmp_path: Path) -> None:
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", tmp_path / "v.tif")
    done = lfcal(*words, "--labels", place / "labels.tif")
    assert done.code == 2 and "--labels: expected a frame with error bars" in done.err
    tifffile.imwrite(tmp_path / "two.tif", np.stack([tifffile.imread(place / "frame.tif")] * 2))
    done = lfcal("reconstruct", place / "H.h5", tmp_path / "two.tif", "-o", tmp_path / "v.tif", "--bars")
    assert done.code == 2 and "frames for error bars: expected one frame, got 2 frames" in done.err
