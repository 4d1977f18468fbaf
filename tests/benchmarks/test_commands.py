"""Every benchmark of the command line on a small problem: the options reach what is measured."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmarks import _r29, _reduced, acquire, aperture
from benchmarks import multiplex as multiplex_bench
from benchmarks import reconstruct as reconstruct_bench
from benchmarks.__main__ import main
from benchmarks._solver_scenes import CAMERAS, problem_of, subject_of
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors.device import ArrayDevice
from tests.reconstruct.oracles import lenslet_psf
from tests.strict import strict_json


class Bench:
    """Runs ``python -m benchmarks`` in this process and returns what it prints."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: object, code: int = 0) -> str:
        self._monkeypatch.setattr(sys, "argv", ["benchmarks", *map(str, arguments)])
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        printed = self._capsys.readouterr()
        assert int(stop.value.code or 0) == code, printed.err
        return printed.out + printed.err

    def json(self, *arguments: object) -> Any:
        return strict_json(self(*arguments, "--json"))


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Bench:
    monkeypatch.setitem(sys.modules, "pyolaf", None)  # whether it is installed or not
    return Bench(monkeypatch, capsys)


@pytest.mark.long
def test_accuracy_says_what_comes_of_a_tolerance(bench: Bench, tmp_path: Path) -> None:
    chart = tmp_path / "c.png"
    said = bench("accuracy", "lfm_20x05", "--depth", "5", "--positions", "1", "--asked", "30,10", "-o", chart)
    assert "picked" in said and "reference" in said and chart.exists()
    asked = said.split("what comes of a tolerance")[1]
    assert "30 %" in asked and "10 %" in asked and "px" in asked
    chart.write_text("old")
    assert "exists; add --force" in bench("accuracy", "bench", "--positions", 1, "-o", chart, code=2)


@pytest.mark.long
def test_accuracy_of_a_plane_in_micrometres(bench: Bench, tmp_path: Path) -> None:
    chart = tmp_path / "curve.png"
    options = ("--depth", -20000, "--positions", 1, "--tolerance", 0.2, "--out", chart)
    found = bench.json("accuracy", "bench", *options)
    assert found["plan"]["depths_um"] == [-20000] and found["check"] is None
    assert found["ladder"]["positions"] == 1 and chart.stat().st_size > 10_000


@pytest.mark.long
def test_accuracy_checks_the_prediction(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole H takes minutes: what is predicted and run is a stand-in, what is said of it is not."""
    monkeypatch.setattr("lfcal.simulate.predict_seconds", lambda *_, **__: 4.0)
    monkeypatch.setattr("lfcal.simulate.simulate_psf", lambda *_, **__: sum(range(10**6)))
    options = ("--virtual-depth", 2.2, "--positions", 1, "--check")
    check = bench.json("accuracy", *options)["check"]
    assert check["predicted"] == 4 and check["measured"] > 0
    assert check["ratio"] == pytest.approx(4 / check["measured"])
    assert "whole H: predicted 4 s, took" in bench("accuracy", *options)


def test_acquire(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan_of = acquire.bench_plan
    monkeypatch.setattr(acquire, "bench_plan", lambda cutout: replace(plan_of(cutout), period=(4, 5)))
    found = bench.json("acquire", "--folder", tmp_path, "--cutout", 21, "--rounds", 2)
    assert found["cutout"] == 21 and found["positions"] == 40 and len(found["ratios"]) == 2
    assert found["ratio"] == pytest.approx(np.median(found["ratios"]))
    assert list(tmp_path.iterdir()) == [], "what was written is gone"
    bench("acquire", "--folder", tmp_path / "nowhere", code=2)


@pytest.mark.long
def test_aperture(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(aperture, "BLADES", (6,))
    monkeypatch.setattr(aperture, "CURVATURES", (0.0,))
    monkeypatch.setattr(aperture, "SNRS", (20.0,))
    others = ("--rounds", 2, "--stuck", 1)
    found = bench.json("aperture", "--trials", 3, "--side", 95, "--workers", 1, *others)
    assert len(found) == 6 and {o["trial"]["side"] for o in found} == {95}
    assert all(o["right"] for o in found if o["trial"]["case"] == "iris")
    table = bench("aperture", "--trials", 3, "--workers", 1, *others)
    assert "3 irises of" in table and "2 round stops under ripple" in table
    assert "1 irises with a stuck blade, pixel SNR 2" in table


def test_assemble(bench: Bench) -> None:
    found = bench.json("assemble", "--rows", 2, "--columns", 3, "--size", 64, "--cutout", 21, "--repeats", 1)
    assert found["frames"] == 6 and found["overhead"] == pytest.approx(found["assemble_s"] / found["decode_s"] - 1)
    table = bench("assemble", "--rows", 1, "--columns", 2, "--size", 48, "--cutout", 11, "--repeats", 1)
    assert "2 frames of 48 x 48 px, 16-bit PNG, cutout 11 x 11" in table


@pytest.mark.long
def test_transpose_file(bench: Bench) -> None:
    found = bench.json("transpose-file", "--gigabytes", 0.002, "--planes", 2)
    assert found["bytes"] == 2 * found["plane_bytes"] == pytest.approx(2e6, rel=0.5)
    assert found["seconds"] > 0 and found["peak_bytes"] > found["plane_bytes"]


@pytest.mark.long
def test_cold(bench: Bench, tmp_path: Path) -> None:
    (found,) = bench.json("cold", "--commands", "transpose", "--folder", tmp_path)
    assert found["command"] == "transpose"
    assert found["cold_s"] > found["warm_s"] > 0 and found["cold_cpu_s"] > found["warm_cpu_s"] > 0
    assert "got 'nothing'" in bench("cold", "--commands", "nothing", code=2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_inspect(bench: Bench, tmp_path: Path) -> None:
    common = ("--preset", "bench", "--cutout", 41, "--folder", tmp_path, "--workers", 1)
    quiet = bench.json("inspect", *common, "--planes", 2, "--noise", 0, "--compression", "zstd")
    assert quiet["planes"] == 2 and quiet["plane_bytes"] == 4 * 33 * 19 * 41**2
    noisy = bench.json("inspect", *common, "--planes", 1, "--noise", 0.01, "--compression", "none")
    assert noisy["file_bytes"] > noisy["plane_bytes"] > quiet["file_bytes"] / 2
    assert noisy["ratio"] == pytest.approx(noisy["inspect_s"] / noisy["read_s"])
    assert list(tmp_path.iterdir()) == []
    assert "expected r29, " in bench("inspect", "--preset", "nikon", code=2)


def test_lattice(bench: Bench) -> None:
    (found,) = bench.json("lattice", "--cameras", 1, "--workers", 1)
    assert found["form"] == found["called"] == "radial" and found["kind"] == "hexagonal"
    assert found["rms_px"] < 0.01 and found["largest_px"] < 0.05 and 0.1 < found["pull"] < 2 and found["seconds"] > 0


@pytest.mark.long
def test_lattice_in_words(bench: Bench) -> None:
    assert "1 of 1 in the form drawn" in bench("lattice", "--cameras", 1)


def test_multiplex(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multiplex_bench, "FULL", (256, 384))
    small = bench.json("multiplex", "--quick", "--filters", "cubic", "--workers", 1)
    whole = bench.json("multiplex", "--rounds", 1, "--filters", "nearest,linear")
    assert [r["name"] for r in small if "demosaic" in r["name"]] == ["demosaic, cubic"]
    assert [r["name"] for r in whole if "demosaic" in r["name"]] == ["demosaic, nearest", "demosaic, linear"]
    assert whole[0]["output_megabytes"] == pytest.approx(4 * small[0]["output_megabytes"])
    assert "192 x 128 px, 1 threads" in bench("multiplex", "--quick", "--filters", "linear", "--workers", 1)


def test_demosaic(bench: Bench, tmp_path: Path) -> None:
    y, x = np.indices((160, 192))
    scene = np.stack([128 + 90 * np.sin(y / 9.0 + k / 5) * np.cos(x / 7.0) for k in range(3)], -1)
    cv2.imwrite(str(tmp_path / "waves.png"), np.rint(scene).astype(np.uint8))
    options = ("demosaic", tmp_path / "waves.png", "--rounds", 1, "--workers", 1)
    found = bench.json(*options, "--pattern", "RGGB")
    quality = {row["name"]: row["psnr_db"] for row in found["rows"]}
    assert found["images"] == ["waves.png"] and list(quality.values()) == sorted(quality.values(), reverse=True)
    assert quality["lfcal directional"] > quality["OpenCV bilinear"] and quality["OpenCV VNG"] > 20
    assert all(row["seconds_per_megapixel"] > 0 for row in found["rows"])
    others = bench.json(*options, "--pattern", "X-Trans")["rows"]
    assert {row["name"].split()[0] for row in others} == {"lfcal"}
    assert "grace_hopper" in bench("demosaic", "--rounds", 1, "--workers", 1)
    refused = bench("demosaic", tmp_path / "none.png", code=2)
    assert "none.png" in refused and refused.count("\n") == 1


def test_project(bench: Bench) -> None:
    size = ("--image", 60, "--period", 5, "--cutout", 21, "--planes", 2, "--repeats", 1, "--workers", 1)
    found = bench.json("project", *size)
    assert {name: found[name] for name in ("image", "period", "cutout", "planes", "workers")} == {
        "image": 60,
        "period": 5,
        "cutout": 21,
        "planes": 2,
        "workers": 1,
    }
    assert all(row["error"] < 1e-5 for row in found["rows"])
    assert "image 60 x 60, period 5 x 5, cutout 21 x 21, 2 plane(s), 1 threads" in bench("project", *size)


def test_projection_of_the_r29_on_a_small_copy(bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in {"PERIOD": (5, 7), "CUTOUT": (21, 21), "FRAME": (200, 300)}.items():
        monkeypatch.setattr(_r29, name, value)
    options = ("--r29", "--side", 64, "--folder", tmp_path, "--workers", 1)
    one = bench.json("project", *options, "--density", 0.1)
    assert (one["shape"], one["density"], one["planes_measured"]) == ([64, 64], 0.1, 1)
    every = bench.json("project", *options, "--full")
    assert every["planes_measured"] == 11 and every["forward_s"] > 0 and every["forecast_forward_s"] > 0
    assert every["forecast_bytes"] > 0 and every["all_planes"] != every["whole_frame"]
    # how wide the times are decides where a line breaks
    assert "(1 measured, scaled)" in " ".join(bench("project", *options).split())
    monkeypatch.setattr(_r29, "find_device", lambda text: ArrayDevice("numpy"))
    there = bench.json("project", "--r29", "--frame", "--device", "cuda", "--folder", tmp_path, "--workers", 1)
    assert (there["shape"], there["device"], one["device"]) == ([200, 300], "cpu (numpy)", "cpu")
    assert there["forecast_device_bytes"] > 0 == one["forecast_device_bytes"]
    assert list(tmp_path.iterdir()) == [], "the synthetic plane is gone"


@pytest.mark.long
def test_projection_within_tolerances(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_reduced, "CAMERA", "bench")
    monkeypatch.setattr(_reduced, "REPEATS", 1)
    monkeypatch.setattr(_reduced, "simulate_psf", cache(_reduced.simulate_psf))
    options = ("project", "--r29", "--side", 150, "--workers", 1, "--tolerance", "0.005,0.05")
    exact, fine, coarse = bench.json(*options)["rows"]
    assert (exact["tolerance"], fine["tolerance"], coarse["tolerance"]) == (0, 0.005, 0.05)
    assert (exact["method"], coarse["method"]) == ("direct", "reduced")
    assert exact["worst"] == 0 and 0 < coarse["worst"] <= 0.05 and fine["worst"] <= 0.005
    assert coarse["operand_bytes"] < exact["operand_bytes"]
    said = " ".join(bench(*options, "--device", "cpu").split())
    assert "times quicker" in said and "no accelerator took part" in said
    # the processor's memory stands in for that of an accelerator
    monkeypatch.setattr(_reduced, "find_device", lambda text: ArrayDevice("numpy"))
    rows = bench.json(*options, "--device", "cuda")["rows"]
    assert [row["device"] for row in rows] == ["cpu"] * 3 + ["cpu (numpy)"] * 3
    assert rows[3]["error"][0] < 1e-6 and rows[5]["error"] == pytest.approx(rows[2]["error"], rel=1e-2)
    assert "no accelerator" not in bench(*options, "--device", "cuda")
    assert "tolerance of the projection" in bench("project", "--r29", "--tolerance", "2", code=2)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--frame",), "--frame: expected --r29 beside it, got none"),
        (("--device", "cpu"), "--device: expected --r29 beside it"),
        (("--tolerance", "0.005"), "--tolerance: expected --r29 beside it"),
        (("--r29", "--image", 300), "--image: expected no --r29 beside it, got it"),
        (("--r29", "--frame", "--side", 100), "--side: expected no --frame beside it"),
        (("--r29", "--tolerance", "0.01", "--full"), "--full: expected no --tolerance beside it"),
    ],
)
def test_options_of_another_projection_are_refused(bench: Bench, options: tuple[object, ...], said: str) -> None:
    """They were ignored."""
    assert said in bench("project", *options, code=2)


@pytest.fixture
def psf(tmp_path: Path) -> Path:
    path = tmp_path / "H.h5"
    save(PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32), depths=(-5.0, 5.0)), path)
    return path


def test_reconstruct(bench: Bench, psf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = tuple(s for s in reconstruct_bench.SETTINGS if s.name in ("Richardson-Lucy", "float64"))
    monkeypatch.setattr(reconstruct_bench, "SETTINGS", (*chosen, *reconstruct_bench.SETTINGS[4:6]))
    monkeypatch.setattr(reconstruct_bench, "draw", lambda curves, chart: chart.write_text(str(len(curves))))
    common = ("--psf", psf, "--image", 64, "--iterations", 3, "--workers", 1, "--chart", tmp_path / "chart.png")
    found = bench.json("reconstruct", *common, "--photons", 500, "--phantom", "points")
    assert (tmp_path / "chart.png").read_text() == "4" and found["chart"] == str(tmp_path / "chart.png")
    assert all(curve["iterations"] == [1, 2, 3] for curve in found["curves"])
    bright = bench.json("reconstruct", *common, "--photons", 50000, "--phantom", "points")
    assert bright["curves"][0]["errors"] != found["curves"][0]["errors"]
    assert "vesicle, H (2, 5, 5, 15, 15), image 64 x 64, 2000 photons, 1 threads" in bench("reconstruct", *common)
    bench("reconstruct", *common, "--phantom", "dragon", code=2)


def test_resolution_of_two_points(bench: Bench, psf: Path, tmp_path: Path) -> None:
    common = ("reconstruct", "--psf", psf, "--image", 64, "--two-point", "--iterations", 2)
    found = bench.json(*common, "--chart", tmp_path / "r.png")
    assert [r["plane"] for r in found] == [0, 1] and [r["depth_um"] for r in found] == [-5, 5]
    assert "resolved from (voxels)" in bench(*common, "--chart", tmp_path / "r.png")
    assert (tmp_path / "r.png").stat().st_size > 5000


def test_transpose_with_a_number_of_threads(bench: Bench) -> None:
    size = ("transpose", "--sizes", "17/3", "--quick", "--memory", 0.01, "--workers", 1)
    assert "least seconds, 1 threads" in bench(*size)
    bench(*size[:-1], 0, code=2)


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "kind", "names"),
    [
        (11, "photographic", {"lenslet_diffraction", "crosstalk", "spherical"}),
        (36, "microscope", {"lenslet_diffraction", "pixel_fill", "lenslet_gap"}),
        (25, "photographic", {"lenslet_diffraction", "crosstalk", "spherical"}),
    ],
)
def test_effects(bench: Bench, scene: int, kind: str, names: set[str]) -> None:
    """Where no formula holds estimates are measured, and right at other positions."""
    found = bench.json("effects", "--scenes", "1", "--first", scene, "--tolerance", "0.05")
    assert found["within_tolerance"] == 1 and found["estimates"] >= 4
    assert found["within_2"] >= found["estimates"] - 1
    (judged,) = found["scenes"]
    assert judged["scene"].startswith(f"scene {scene}, {kind}") and 0 < judged["error"] <= 0.05
    assert {name for name, *_ in judged["pairs"]} >= names


def test_fit_of_another_camera(bench: Bench) -> None:
    assert "camera: expected bench or r29, got 'lfm_20x05'" in bench("fit", "lfm_20x05", code=2)
    assert "--depths: expected numbers, got '3,x'" in bench("fit", "--depths", "3,x", code=2)


@pytest.mark.long
def test_fit(bench: Bench) -> None:
    options = ("--cameras", 1, "--patterns", 12, "--cutout", 21, "--positions", 4, "--workers", 1)
    (found,) = bench.json("fit", "bench", *options, "--seed", 3)
    assert found["seed"] == 3 and found["error_l1"] < 0.02 < found["described_l1"] and len(found["pulls"]) > 8
    said = bench("fit", *options, "--seed", 3, "--stage", 0.05)
    assert "camera 3: H" in said and "of 1" in said


def test_retrieve_wants_numbers(bench: Bench, tmp_path: Path) -> None:
    assert "--counts: expected whole numbers from 3 on, got '6,x'" in bench("retrieve", "--counts", "6,x", code=2)
    (tmp_path / "old.png").write_bytes(b"old")
    assert "exists" in bench("retrieve", "--chart", tmp_path / "old.png", code=2)


@pytest.mark.long
def test_retrieve(bench: Bench, tmp_path: Path) -> None:
    options = ("--counts", "6,18", "--cameras", 1, "--cutout", 21, "--positions", 4, "--workers", 1, "--seed", 3)
    found = bench.json("retrieve", *options, "--chart", tmp_path / "frames.png")
    few, more = (one["errors"][0] for one in found["fitted"])
    assert more < few < found["recorded"]["errors"][0] and found["recorded"]["frames"] == 1254
    assert (tmp_path / "frames.png").stat().st_size > 5000
    said = bench("retrieve", *options, "--per-frame", 6, "--force")
    assert "recorded, every position" in said and "125" in said  # 1254 frames of 6 s


@pytest.fixture
def small_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    few = replace(CAMERAS["bench"], depths=(2.2, 2.8), cutout=25, side=48)
    monkeypatch.setitem(CAMERAS, "bench", few)
    monkeypatch.setattr("benchmarks._solver_trials.UNITS", (2, 5))
    monkeypatch.setattr("benchmarks._solver_tables.UNITS", (2, 5))


def test_solvers(bench: Bench, tmp_path: Path, small_cameras: None) -> None:
    options = ("--camera", "bench", "--scene", "beads,shell", "--solver", "rl,sieve", "--workers", 1)
    found = bench.json("solvers", *options, "--chart", tmp_path / "a.png", "--table", tmp_path / "t.md")
    assert [(one["scene"], one["solver"]) for one in found["trials"]] == [
        (scene, solver) for scene in ("beads", "shell") for solver in ("rl", "sieve")
    ]
    for one in found["trials"]:
        assert one["errors"][-1] < one["errors"][0] < 1.2 and one["stop"][0] > 0
        assert (one["width"] is None) == (one["scene"] == "shell")
    assert (tmp_path / "a.png").stat().st_size > 5000
    table = (tmp_path / "t.md").read_text(encoding="utf-8")
    assert "(a.png)" in table and f"--chart {tmp_path.as_posix()}/a.png --table {tmp_path.as_posix()}/t.md" in table
    assert table.count("\n| beads | ") == 2 and "sieve wins or ties after 5 iterations of rl: bench" in table
    assert "exists" in bench("solvers", *options, "--table", tmp_path / "t.md", code=2)
    assert "--solver: expected" in bench("solvers", "--solver", "magic", code=2)


@pytest.mark.long
def test_solvers_longer(bench: Bench, tmp_path: Path, small_cameras: None, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(
        "benchmarks._solver_scenes.subject_of", lambda name, side=0: asked.append(side) or subject_of(name, 40)
    )
    said = bench("solvers", "--full", "--camera", "bench", "--scene", "shell", "--solver", "rl", "--force")
    assert asked == [132] and "wins or ties after 2 iterations of rl" in said


@pytest.mark.long
def test_scenes_are_not_made_by_what_is_inverted() -> None:
    """Light between the planes and beside the voxels: the coarse H meets the frame to its noise, and not beyond."""
    few = replace(CAMERAS["bench"], depths=(2.6, 2.9, 3.2), cutout=41, side=60)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(CAMERAS, "bench", few)
        subject = subject_of("bench")
    assert subject.fine.shape[0] == 6 and not set(subject.fine.depths) & set(subject.sought.depths)
    assert subject.fine.anchor == tuple(at + 0.4 for at in subject.sought.anchor)
    problem = problem_of(subject, "shell")
    P = Projector(subject.sought, (60, 60), dtype=np.float64)
    clean = P.forward(problem.truth)
    noise = np.sqrt(np.maximum(clean, 0) + 5)
    assert np.sqrt(np.mean(((problem.image - 5 - clean) / noise) ** 2)) < 1.3
    moved = P.forward(np.roll(problem.truth, (1, 1), (1, 2)))
    assert np.linalg.norm(problem.image - 5 - moved) > 1.1 * np.linalg.norm(problem.image - 5 - clean)


def test_forecast(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.forecast.CUTOUTS", (21,))
    monkeypatch.setattr("benchmarks.forecast.DEPTHS_UM", (0.0, 5.0))
    found = bench.json("forecast", "lfm_20x05", "--tolerance", "0.1", "--rows", "3")
    assert [(one["depth_um"], one["cutout"]) for one in found] == [(0.0, 21), (5.0, 21)]
    assert all(one[key] > 0 for one in found for key in ("planned", "predicted", "taken"))
    assert "description/taken" in bench("forecast", "lfm_20x05", "--rows", "1")


def test_forecast_of_random_cameras(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.forecast.TOLERANCES", (0.3, 0.1))
    monkeypatch.setattr("benchmarks.forecast.WIDEST", 15)
    found = bench.json("forecast", "--random", 1, "--first", 8)
    assert [(one["scene"], one["tolerance"]) for one in found] == [(8, 0.1), (8, 0.3)]
    assert all(one["error"] <= one["tolerance"] for one in found)
    assert all(one[key] > 0 for one in found for key in ("planned", "predicted", "taken", "repeated", "error"))


def test_the_table_of_random_cameras_counts_what_is_kept() -> None:
    """A tolerance that is slower than a finer one counts once, and not if the finer one is of another camera."""
    from benchmarks.forecast import Kept, summary_rows

    one = Kept(1, 0.01, 0.005, planned=2.0, predicted=1.2, taken=1.0, repeated=1.0, engine="grid")
    found = [one, replace(one, tolerance=0.1, error=0.2, taken=1.2), replace(one, tolerance=0.3, taken=1.1)]
    found.append(replace(one, scene=2, tolerance=0.3, taken=9.0, repeated=0.1))
    shares = dict(summary_rows(found))
    assert shares["slower than a finer tolerance by more than 15 %"] == "50.0 % (1 of 2)"
    assert shares["error within the tolerance"] == "75.0 % (3 of 4)"
    assert shares["forecast by a short run within a factor of 1.5"] == "75.0 % (3 of 4)"
    assert shares["forecast from the description within a factor of 1.5"] == "0.0 % (0 of 4)"
    assert shares["forecast from the description within a factor of 2.5"] == "75.0 % (3 of 4)"


@pytest.mark.long
def test_work_by_threads(bench: Bench, tmp_path: Path) -> None:
    options = ("--planes", 2, "--rows", 2, "--cutout", 21, "--tolerance", 0.3, "--rounds", 1, "--folder", tmp_path)
    found = bench.json("work", "bench", *options, "--executors", "threads", "--many", 64)
    assert set(found["seconds"]) == {"threads 1", "threads 2"} and set(found["scaling"]) == {"threads"}
    assert found["forecast"]["units"] == 2 and found["forecast"]["workers"] == 64
    assert "dask, processes or threads" in bench("work", "bench", "--executors", "magic", code=2)
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_work_by_executors(bench: Bench, tmp_path: Path) -> None:
    options = ("--planes", 2, "--rows", 2, "--cutout", 21, "--tolerance", 0.3, "--rounds", 1, "--folder", tmp_path)
    found = bench.json("work", "bench", *options, "--executors", "threads,processes", "--many", 64)
    assert set(found["seconds"]) == {f"{name} {n}" for name in ("threads", "processes") for n in (1, 2)}
    assert found["overhead"] == {} and set(found["scaling"]) == {"threads", "processes"}
    spent = found["cpu_seconds"]  # a process of one's own takes its start beside what threads take
    assert set(spent) == set(found["seconds"]) and 0 < spent["threads 1"] < spent["processes 1"]
    assert found["forecast"]["units"] == 2 and found["forecast"]["workers"] == 64
    said = bench("work", "bench", *options, "--executors", "threads")
    assert "2 units" in said and "64 workers by forecast: 2 units of " in said
    assert not list(tmp_path.iterdir())


def test_storage_wants_shares_and_a_free_name(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "old.png").write_bytes(b"old")
    assert "exists" in bench("storage", "--chart", tmp_path / "old.png", code=2)
    assert "a fraction above 0 and below 1" in bench("storage", "--tolerances", "2", code=2)


@pytest.mark.long
def test_storage_in_words(bench: Bench, tmp_path: Path) -> None:
    options = ("--virtual-depths", "2,2.5", "--tolerances", "0.02,0.005", "--repeats", 1, "--folder", tmp_path)
    assert "11 planes, within 2 %" in bench("storage", "bench", *options, "--planes", 11, "--workers", 1)


@pytest.mark.long
def test_storage(bench: Bench, tmp_path: Path) -> None:
    options = ("--virtual-depths", "2,2.5", "--tolerances", "0.02,0.005", "--repeats", 1, "--folder", tmp_path)
    found = bench.json("storage", "bench", *options, "--planes", 11, "--chart", tmp_path / "storage.png")
    rows = found["rows"]
    assert len(rows) == 8 and (tmp_path / "storage.png").stat().st_size > 5000
    for row in rows:
        assert row["write_s"] > 0 and row["read_s"] > 0
        # an image of much light errs less than its worst voxel
        assert row["error"] <= row["worst"] + 1e-9
        if row["tolerance"]:
            assert row["tolerance"] / 2 < row["bound"] <= row["tolerance"]
            assert row["worst"] == pytest.approx(row["bound"], rel=1e-4)
    assert len(found["forecast_bytes"]) == 4
    exact, small = (found["forecast_bytes"][name] for name in ("float32", "within 0.5 %"))
    assert small < exact / 3
    (many,) = (row["bytes"] for row in rows if row["depth"] == 2.5 and row["tolerance"] == 0.005)
    assert small < 11 * many, "planes of less light take less"
    assert {path.name for path in tmp_path.iterdir()} == {"storage.png"}, "no H is left"
