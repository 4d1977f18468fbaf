"""``lfcal reconstruct`` as a user runs it, also with solvers of other packages."""

from __future__ import annotations

import json

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.cli import main
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from lfcal.reconstruct.solvers import choice
from lfcal.reconstruct.solvers.choice import find_solvers, iter_reconstruct
from lfcal.reconstruct.solvers.multiplicative import richardson_lucy
from lfcal.reconstruct.solvers.solver import OPTIONS, Solver, SolverRun
from lfcal.reconstruct.volumes import load_volume
from tests.distribution import code_of, in_a_new_process, install
from tests.reconstruct.oracles import dense, lenslet_psf


@pytest.fixture
def run(capfd, monkeypatch):
    def call(*arguments):
        words = arguments if arguments == ("solvers",) else ("reconstruct", *arguments)
        monkeypatch.setattr("sys.argv", ["lfcal", *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        return (int(end.value.code or 0), *capfd.readouterr())

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
    given = ("--dark", folder / "dark.png", "--white", folder / "white.png", "--solver", "rl", "--margin", 0, "-n", 5)
    code, out, err = run(folder / "H.h5", folder / "frames" / "t0.tif", "-o", tmp_path / "v.tif", *given)
    assert code == 0 and "residual" in out, err
    volume = tifffile.imread(tmp_path / "v.tif")
    expected = richardson_lucy(P, clean[0].astype(float), 5).volume
    assert np.allclose(volume, expected, rtol=1e-3, atol=1e-3 * expected.max())
    assert not list(tmp_path.glob("*.part"))


def test_a_series_to_hdf5_as_json(files, run, tmp_path):
    folder, _, P = files
    given = ("--format", ".h5", "--warm", "--json", "--dark", folder / "dark.png", "--solver", "rl-biggs", "-n", 4)
    code, out, err = run(folder / "H.h5", folder / "frames", "-o", tmp_path / "out", *given)
    assert code == 0, err
    assert [v["name"] for v in json.loads(out)["volumes"]] == ["t0", "t1", "t2"]
    volumes = [load_volume(tmp_path / "out" / f"t{k}.h5") for k in range(3)]
    assert {volume.shape for volume in volumes} == {P.volume_shape}
    assert np.unravel_index(volumes[0].argmax(), P.volume_shape) == (0, 12, 15)
    with h5py.File(tmp_path / "out" / "t1.h5") as file:
        details = json.loads(file.attrs["details"])
        assert details["solver"]["name"] == "rl-biggs" and details["anchor"] == [1, 2]


def test_forecast_and_list_of_solvers_write_nothing(files, run):
    folder = files[0]
    code, out, _ = run(folder / "H.h5", folder / "frames" / "t0.tif", "--forecast")
    assert code == 0 and "polyphase" in out and "iterations" in out and "solver" in out.splitlines()[-1]
    code, out, _ = run(folder / "H.h5", folder / "frames" / "t0.tif", "--forecast", "--json")
    found = json.loads(out)
    assert found["memory_bytes"] == sum(found["memory"].values()) > found["memory"]["solver"] > 0
    code, out, _ = run("solvers")
    assert code == 0 and "Richardson" in out and "phase-space" in out


def test_wrong_input_is_refused_in_one_line_with_code_2(files, run, monkeypatch):
    monkeypatch.chdir(files[0])
    out = ["frames/t0.tif", "-o", "v.tif"]
    for arguments, message in (
        (["frames/t0.tif"], "--out"),
        ([], "FRAMES"),
        (["frames/none.tif", "-o", "v.tif"], "no such file"),
        (["frames/t0.tif", "-o", "v.jpg"], "volume file"),
        ([*out, "--solver", "magic"], "solver"),
        ([*out, "--solver", "isra", "--read-noise", 3], "--read-noise"),
        ([*out, "--strength", 0.1], "rl-tv"),
        ([*out, "--anchor", "left"], "--anchor"),
        ([*out, "--resample", "always"], "--resample"),
        ([*out, "--memory", "0.000001"], "memory for the reconstruction"),
        ([*out, "--solver", "rl", "--margin", 0, "--memory", "0.00008"], "memory limit"),
    ):
        code, _, err = run("H.h5", *arguments)
        assert code == 2 and message in err and len(err.strip().splitlines()) == 1, (arguments, err)
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


PAGE = code_of("extending.md", "A solver")


@pytest.fixture
def foreign(tmp_path, monkeypatch):
    """Install a solver of another package for one test."""

    def put(source, name="SOLVER"):
        install(monkeypatch, tmp_path, "their_solver", source, {"lfcal.solvers": f"theirs = their_solver:{name}"})
        solvers = find_solvers()
        monkeypatch.setattr(choice, "SOLVERS", solvers)
        monkeypatch.setattr("lfcal.reconstruct.SOLVERS", solvers)

    return put


def test_the_documented_solver_minimises_squares(foreign):
    foreign(PAGE[0])
    rng = np.random.default_rng(0)
    H = rng.random((1, 2, 2, 3, 3))
    P, A = Projector(H, (9, 8), dtype=np.float64), dense(H, (9, 8))
    truth = rng.uniform(1, 5, A.shape[1])
    image = (A @ truth + 2.0).reshape(9, 8)
    step = 1 / (A.T @ (A @ np.ones(A.shape[1]))).max()
    g = np.zeros(A.shape[1])
    for _ in range(200):
        g = np.maximum(g + step * A.T @ (image.ravel() - 2.0 - A @ g), 0)
    names = {"P": P, "image": image, "reconstruct": reconstruct, "SolverChoice": SolverChoice}
    exec(PAGE[1], names)  # the section's second block
    result = names["result"]
    assert np.allclose(result.volume.ravel(), g, rtol=1e-10)
    assert result.history[-1].residual < 0.1 * result.history[0].residual and len(result.history) == 200


def test_the_documented_solver_stops_resumes_and_masks(foreign):
    foreign(PAGE[0])
    P = Projector(lenslet_psf(2, 5, 15), (30, 31))
    rng = np.random.default_rng(1)
    image = rng.poisson(50, (30, 31)).astype(float)
    image[4, 4], image[9, 9] = np.nan, 1e9
    whole = reconstruct(P, image, SolverChoice("landweber", 6, saturation=1e6))
    work = iter_reconstruct(P, image, SolverChoice("landweber", 6, saturation=1e6))
    records = [next(work) for _ in range(4)]
    work.close()
    rest = reconstruct(P, image, SolverChoice("landweber", 2, saturation=1e6), resume=records[-1].state)
    assert np.array_equal(rest.volume, whole.volume) and rest.history[-1].iteration == 6
    assert np.isfinite(whole.volume).all() and len(whole.notes) == 2
    assert len(reconstruct(P, image, SolverChoice("landweber", 6, tolerance=9.0)).history) == 1


def test_options_it_does_not_honour_are_refused(foreign):
    foreign(PAGE[0])
    with pytest.raises(InputError, match=r"read noise: expected none for solver landweber.*or choose rl"):
        SolverChoice("landweber", read_noise=2.0)
    P = Projector(lenslet_psf(2, 5, 15), (30, 31))
    with pytest.raises(InputError, match=r"initial: expected none for solver landweber"):
        reconstruct(P, np.ones((30, 31)), SolverChoice("landweber"), initial=np.ones(P.volume_shape))


def test_the_command_line_runs_it(foreign, run, tmp_path):
    foreign(PAGE[0])
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H), tmp_path / "H.h5")
    frame = np.maximum(Projector(H, (30, 31)).forward(np.full((2, 30, 31), 900.0)), 0).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frame.tif", frame)
    arguments = (tmp_path / "H.h5", tmp_path / "frame.tif", "-o", tmp_path / "v.tif")
    code, out, err = run(*arguments, "--solver", "landweber", "-n", 3)
    assert code == 0, err
    assert "3 iterations" in out and tifffile.imread(tmp_path / "v.tif").max() > 0
    code, out, _ = run("solvers")
    assert code == 0 and "landweber" in out and "Landweber 1951" in out
    code, _, err = run(*arguments, "--solver", "landweber", "--read-noise", 3)
    assert code == 2 and "--read-noise: expected --solver sieve, rl, " in err and len(err.strip().splitlines()) == 1


def test_the_window_lists_it(foreign, tmp_path):
    foreign(PAGE[0])
    code = """
from lfcal_gui.pages.reconstruct.model import FIELDS, ReconstructSettings, used_by
assert "landweber" in dict(FIELDS[0].choices) and "Landweber 1951" in FIELDS[0].tip
assert used_by("landweber", "background") and not used_by("landweber", "read_noise")
print(ReconstructSettings("landweber", read_noise=3.0).choice().solver.title)
"""
    assert "projected gradient" in in_a_new_process(tmp_path, code)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("SOLVER = 3", "expected a part with a name"),
        ("class SOLVER:\n    name = 'theirs'", "expected a Solver with a function"),
        (PAGE[0].replace('frozenset({"background",', 'frozenset({"backgrounds",'), "backgrounds"),
        ("import a_library_that_is_missing", "a_library_that_is_missing"),
    ],
)
def test_broken_solvers_are_left_out_with_a_reason(foreign, run, source, reason):
    own = find_solvers().names()
    foreign(source)
    assert choice.SOLVERS.names() == own
    assert reason in choice.SOLVERS.failures()["theirs"]
    code, out, err = run("solvers")
    assert code == 0 and "rl-tv" in out and "solver theirs" in err


def test_own_solvers_cannot_be_replaced(foreign):
    foreign(PAGE[0].replace('"landweber", "least', '"rl", "least'))
    assert "Eberhart" in choice.SOLVERS.get("rl").title


def test_a_run_has_every_option_at_its_idle_value():
    run = SolverRun(3)
    assert {name: getattr(run, name) for name in OPTIONS} == OPTIONS
    with pytest.raises(InputError, match="options of solver x"):
        Solver("x", "x", lambda P, image, run: iter(()), frozenset({"speed"}))
