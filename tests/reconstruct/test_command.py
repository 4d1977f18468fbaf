from __future__ import annotations

import json

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan, preset
from lfcal.cli import main
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector
from lfcal.reconstruct.solvers.multiplicative import richardson_lucy
from lfcal.reconstruct.volumes import load_volume
from tests.reconstruct.oracles import lenslet_psf


@pytest.fixture
def run(capfd, monkeypatch):
    def call(*arguments):
        words = arguments if arguments == ("solvers",) else ("reconstruct", *arguments)
        monkeypatch.setattr("sys.argv", ["lfcal", *map(str, words)])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        out, err = capfd.readouterr()
        return code, out, err

    return call


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with H, three frames, dark and white, and the clean frames."""
    folder = tmp_path_factory.mktemp("light_field")
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, anchor=(1.0, 2.0), depths=(-5.0, 5.0)), folder / "H.h5")
    P = Projector(H, (30, 31), (1, 2))
    rng = np.random.default_rng(0)
    clean = []
    (folder / "frames").mkdir()
    for k in range(3):
        truth = np.zeros(P.volume_shape)
        truth[k % 2, 12 + k, 15] = 4000
        frame = rng.poisson(np.maximum(P.forward(truth), 0)).astype(np.uint16)
        clean.append(frame)
        cv2.imwrite(str(folder / "frames" / f"t{k}.tif"), frame + np.uint16(50))
    cv2.imwrite(str(folder / "dark.png"), np.full((30, 31), 50, np.uint16))
    cv2.imwrite(str(folder / "white.png"), np.full((30, 31), 20050, np.uint16))
    return folder, clean, P


def test_one_frame_to_a_stack(files, run, tmp_path):
    folder, clean, P = files
    code, out, err = run(
        folder / "H.h5",
        folder / "frames" / "t0.tif",
        "-o",
        tmp_path / "v.tif",
        "--dark",
        folder / "dark.png",
        "--white",
        folder / "white.png",
        "--solver",
        "rl",
        "--margin",
        0,
        "-n",
        5,
    )
    assert code == 0, err
    assert "residual" in out
    volume = tifffile.imread(tmp_path / "v.tif")
    expected = richardson_lucy(P, clean[0].astype(float), 5).volume
    assert np.allclose(volume, expected, rtol=1e-3, atol=1e-3 * expected.max())
    assert not list(tmp_path.glob("*.part"))


def test_a_series_to_hdf5_as_json(files, run, tmp_path):
    folder, _, P = files
    code, out, err = run(
        folder / "H.h5",
        folder / "frames",
        "-o",
        tmp_path / "out",
        "--format",
        ".h5",
        "--warm",
        "--json",
        "--dark",
        folder / "dark.png",
        "--solver",
        "rl-biggs",
        "-n",
        4,
    )
    assert code == 0, err
    answer = json.loads(out)
    assert [v["name"] for v in answer["volumes"]] == ["t0", "t1", "t2"]
    for k in range(3):
        volume = load_volume(tmp_path / "out" / f"t{k}.h5")
        assert volume.shape == P.volume_shape
    assert np.unravel_index(load_volume(tmp_path / "out" / "t0.h5").argmax(), P.volume_shape) == (0, 12, 15)
    with h5py.File(tmp_path / "out" / "t1.h5") as file:
        details = json.loads(file.attrs["details"])
        assert details["solver"]["name"] == "rl-biggs" and details["anchor"] == [1, 2]


def test_forecast_and_list_of_solvers_write_nothing(files, run):
    folder = files[0]
    code, out, _ = run(folder / "H.h5", folder / "frames" / "t0.tif", "--forecast")
    assert code == 0 and "polyphase" in out and "iterations" in out and "solver" in out.splitlines()[-1]
    code, out, _ = run(folder / "H.h5", folder / "frames" / "t0.tif", "--forecast", "--json")
    told = json.loads(out)
    assert told["memory_bytes"] == sum(told["memory"].values()) > told["memory"]["solver"] > 0
    code, out, _ = run("solvers")
    assert code == 0 and "Richardson" in out and "phase-space" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["frames/t0.tif"], "--out"),
        ([], "FRAMES"),
        (["frames/none.tif", "-o", "v.tif"], "no such file"),
        (["frames/t0.tif", "-o", "v.jpg"], "volume file"),
        (["frames/t0.tif", "-o", "v.tif", "--solver", "magic"], "solver"),
        (["frames/t0.tif", "-o", "v.tif", "--solver", "isra", "--read-noise", 3], "--read-noise"),
        (["frames/t0.tif", "-o", "v.tif", "--strength", 0.1], "rl-tv"),
        (["frames/t0.tif", "-o", "v.tif", "--anchor", "left"], "--anchor"),
        (["frames/t0.tif", "-o", "v.tif", "--resample", "always"], "--resample"),
        (["frames/t0.tif", "-o", "v.tif", "--memory", "0.000001"], "memory for the reconstruction"),
        (["frames/t0.tif", "-o", "v.tif", "--solver", "rl", "--margin", 0, "--memory", "0.00008"], "memory limit"),
    ],
)
def test_bad_input_is_one_line_and_code_2(files, run, monkeypatch, arguments, message):
    monkeypatch.chdir(files[0])
    code, _, err = run("H.h5", *arguments)
    assert code == 2
    assert message in err and len(err.strip().splitlines()) == 1
    assert not (files[0] / "v.tif").exists()


def test_all_planes_with_voxels_of_one_size(run, tmp_path):
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=[3.0, 6.0], cutout=15)
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, camera=camera, depths=plan.depths_um, anchor=(1.0, 2.0)), tmp_path / "H.h5")
    tifffile.imwrite(tmp_path / "f.tif", np.random.default_rng(0).poisson(50, (30, 31)).astype(np.uint16))
    common = (tmp_path / "H.h5", tmp_path / "f.tif", "-n", 2, "--solver", "rl")
    assert run(*common, "-o", tmp_path / "plain.h5")[0] == 0
    code, out, _ = run(*common, "-o", tmp_path / "metric.h5", "--voxel", "auto")
    assert code == 0
    plain, metric = (load_volume(tmp_path / name) for name in ("plain.h5", "metric.h5"))
    assert metric.shape[1] > plain.shape[1] and f"volume {metric.shape}" in out
    np.testing.assert_allclose(metric.sum((1, 2)), plain.sum((1, 2)), rtol=1e-4)
    small = min(camera.step_um(float(z)) for z in plan.depths_um)
    with h5py.File(tmp_path / "metric.h5") as file:
        assert file.attrs["voxel_um"] == pytest.approx([small, small])
        said = json.loads(file.attrs["details"])
        assert said["voxel_um"] == pytest.approx(small) and len(said["origin_um"]) == 2
    tifffile.imwrite(tmp_path / "g.tif", np.full((2, 30, 31), 50, np.uint16), photometric="minisblack")
    assert run(tmp_path / "H.h5", tmp_path / "g.tif", "-n", 1, "-o", tmp_path / "s.tif", "--voxel", 500)[0] == 0
    assert tifffile.imread(tmp_path / "s.tif").shape[:2] == (2, 2)
    code, _, err = run(*common, "-o", tmp_path / "x.h5", "--voxel", "large")
    assert code == 2 and "a number of µm, or auto" in err
