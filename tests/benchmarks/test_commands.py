"""Benchmarks of the command line on small problems: their options reach what is measured."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks import _r29, _reduced, acquire, aperture, debye, faults, fourier
from benchmarks import multiplex as multiplex_bench
from benchmarks import reconstruct as reconstruct_bench
from benchmarks._fault_list import FAULTS
from benchmarks._fault_recordings import CAMERAS as FAULT_CAMERAS
from benchmarks._fault_recordings import Recording
from benchmarks._solver_scenes import CAMERAS, problem_of, subject_of
from benchmarks.faults import Tried
from benchmarks.frames import iter_compare
from lfcal.base.progress import drain
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors.device import ArrayDevice
from tests.benchmarks.conftest import Bench
from tests.reconstruct.oracles import lenslet_psf


def test_wrong_options_are_refused(bench: Bench, tmp_path: Path) -> None:
    old = tmp_path / "old.png"
    old.write_bytes(b"old")
    for words, message in (
        (f"acquire --folder {tmp_path}/none", f"{tmp_path}/none"),
        ("cold --commands nothing", "got 'nothing'"),
        ("inspect --preset nikon", "expected r29, "),
        ("debye --cutout 30", "odd"),
        ("demosaic none.png", "none.png"),
        ("faults --cameras none", "some of bench, r29-like"),
        ("faults --strengths 4", "some of 1, 2, 3"),
        ("fit lfm_20x05", "camera: expected bench or r29, got 'lfm_20x05'"),
        ("fit --depths 3,x", "--depths: expected numbers, got '3,x'"),
        ("project --r29 --tolerance 2", "tolerance of the projection"),
        ("retrieve --counts 6,x", "--counts: expected whole numbers of at least 3, got '6,x'"),
        (f"retrieve --chart {old}", "exists"),
        ("solvers --solver magic", "--solver: expected"),
        (f"storage --chart {old}", "exists"),
        ("storage --tolerances 2", "a fraction above 0 and below 1"),
        ("transpose --workers 0", ""),
        ("work bench --executors magic", "dask, processes or threads"),
        # options of another projection were ignored
        ("project --frame", "--frame: expected --r29 with it, got none"),
        ("project --device cpu", "--device: expected --r29 with it"),
        ("project --tolerance 0.005", "--tolerance: expected --r29 with it"),
        ("project --r29 --image 300", "--image: expected no --r29 with it, got it"),
        ("project --r29 --frame --side 100", "--side: expected no --frame with it"),
        ("project --r29 --tolerance 0.01 --full", "--full: expected no --tolerance with it"),
    ):
        shown = bench(*words.split(), code=2)
        assert message in shown and shown.strip().count("\n") == 0, words


# -- simulation and accuracy -------------------------------------------------------------------------------
@pytest.mark.long
def test_accuracy(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chart = tmp_path / "c.png"
    shown = bench("accuracy", "lfm_20x05", "--depth", "5", "--positions", "1", "--asked", "30,10", "-o", chart)
    assert "chosen" in shown and "reference" in shown and chart.stat().st_size > 10_000
    tolerances = shown.split("results of tolerances")[1]
    assert "30 %" in tolerances and "10 %" in tolerances and "px" in tolerances
    assert "exists; add --force" in bench("accuracy", "bench", "--positions", 1, "-o", chart, code=2)
    # the whole H takes minutes: what is predicted and run is replaced, what is said of it is not
    monkeypatch.setattr("lfcal.simulate.predict_seconds", lambda *_, **__: 4.0)
    monkeypatch.setattr("lfcal.simulate.simulate_psf", lambda *_, **__: sum(range(10**6)))
    options = ("--depth", -20000, "--positions", 1, "--tolerance", 0.2)
    found = bench.json("accuracy", "bench", *options, "--check")
    assert found["plan"]["depths_um"] == [-20000] and found["ladder"]["positions"] == 1
    assert found["check"]["predicted"] == 4 and found["check"]["ratio"] == pytest.approx(4 / found["check"]["measured"])
    shown = bench("accuracy", "bench", "--virtual-depth", 2.2, "--positions", 1, "--check")
    assert "whole H: predicted 4 s, took" in shown


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
    assert "3 irises of" in table and "2 round stops with ripple" in table
    assert "1 irises with a stuck blade, pixel SNR 2" in table


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
def test_the_error_of_debye_integrals_falls_with_the_nodes() -> None:
    rows = debye.measure(5.0, 31, 1)
    errors = [row.error for row in rows if row.name.startswith("lfcal")]
    assert [row.positions for row in rows if row.name.startswith("lfcal")] == [225] * 4
    assert errors[1] < 0.03
    assert errors[0] > errors[1] > errors[2]
    assert all(row.seconds > 0 for row in rows)
    theirs = [row.error for row in rows if row.name.startswith("pyolaf")]
    assert all(error > errors[0] for error in theirs)


@pytest.mark.long
def test_debye(bench: Bench) -> None:
    found = bench.json("debye", "--depth", 0, "--cutout", 31, "--repeat", 1)
    assert [row["positions"] for row in found][:4] == [225] * 4


# -- recording, lattice and frames -------------------------------------------------------------------------


def test_acquire(bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan_of = acquire.bench_plan
    monkeypatch.setattr(acquire, "bench_plan", lambda cutout: replace(plan_of(cutout), period=(4, 5)))
    found = bench.json("acquire", "--folder", tmp_path, "--cutout", 21, "--rounds", 2)
    assert found["cutout"] == 21 and found["positions"] == 40 and len(found["ratios"]) == 2
    assert found["ratio"] == pytest.approx(np.median(found["ratios"]))
    assert list(tmp_path.iterdir()) == [], "what was written is gone"


def test_assemble(bench: Bench) -> None:
    found = bench.json("assemble", "--rows", 2, "--columns", 3, "--size", 64, "--cutout", 21, "--repeats", 1)
    assert found["frames"] == 6 and found["overhead"] == pytest.approx(found["assemble_s"] / found["decode_s"] - 1)
    table = bench("assemble", "--rows", 1, "--columns", 2, "--size", 48, "--cutout", 11, "--repeats", 1)
    assert "2 frames of 48 x 48 px, 16-bit PNG, cutout 11 x 11" in table


@pytest.mark.long
def test_cold(bench: Bench, tmp_path: Path) -> None:
    (found,) = bench.json("cold", "--commands", "transpose", "--folder", tmp_path)
    assert found["command"] == "transpose"
    assert found["cold_s"] > found["warm_s"] > 0 and found["cold_cpu_s"] > found["warm_cpu_s"] > 0
    assert list(tmp_path.iterdir()) == []


def test_lattice(bench: Bench) -> None:
    (found,) = bench.json("lattice", "--cameras", 1, "--workers", 1)
    assert found["form"] == found["called"] == "radial" and found["kind"] == "hexagonal"
    assert found["rms_px"] < 0.01 and found["largest_px"] < 0.05 and 0.1 < found["pull"] < 2 and found["seconds"] > 0


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


def test_frames_are_corrected_and_read_next_to_other_programs(bench: Bench) -> None:
    rows = drain(iter_compare(0.02, 1))
    assert len(rows) == 9
    assert all(row.seconds > 0 and row.reference_s > 0 for row in rows)
    assert {row.what for row in rows} >= {"dark + white", "read a.png, checked", "read deflate.tif, checked"}
    assert bench.json("frames", "--megapixels", 0.02, "--repeats", 1)[0]["ratio"] > 0


# -- H -----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_transpose_file(bench: Bench) -> None:
    found = bench.json("transpose-file", "--gigabytes", 0.002, "--planes", 2)
    assert found["bytes"] == 2 * found["plane_bytes"] == pytest.approx(2e6, rel=0.5)
    assert found["seconds"] > 0 and found["peak_bytes"] > found["plane_bytes"]


@pytest.mark.long
def test_inspect(bench: Bench, tmp_path: Path) -> None:
    common = ("--preset", "bench", "--cutout", 41, "--folder", tmp_path, "--workers", 1)
    quiet = bench.json("inspect", *common, "--planes", 2, "--noise", 0, "--compression", "zstd")
    assert quiet["planes"] == 2 and quiet["plane_bytes"] == 4 * 33 * 19 * 41**2
    noisy = bench.json("inspect", *common, "--planes", 1, "--noise", 0.01, "--compression", "none")
    assert noisy["file_bytes"] > noisy["plane_bytes"] > quiet["file_bytes"] / 2
    assert noisy["ratio"] == pytest.approx(noisy["inspect_s"] / noisy["read_s"])
    assert list(tmp_path.iterdir()) == []


def test_project(bench: Bench) -> None:
    size = ("--image", 60, "--period", 5, "--cutout", 21, "--planes", 2, "--repeats", 1, "--workers", 1)
    found = bench.json("project", *size)
    assert [found[name] for name in ("image", "period", "cutout", "planes", "workers")] == [60, 5, 21, 2, 1]
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
    shown = " ".join(bench(*options, "--device", "cpu").split())
    assert "speed-up" in shown and "no accelerator took part" in shown
    # the memory of the processor replaces that of an accelerator
    monkeypatch.setattr(_reduced, "find_device", lambda text: ArrayDevice("numpy"))
    rows = bench.json(*options, "--device", "cuda")["rows"]
    assert [row["device"] for row in rows] == ["cpu"] * 3 + ["cpu (numpy)"] * 3
    assert rows[3]["error"][0] < 1e-6 and rows[5]["error"] == pytest.approx(rows[2]["error"], rel=1e-2)
    assert "no accelerator" not in bench(*options, "--device", "cuda")


def test_the_projection_of_a_fourier_microscope_is_timed_and_right(bench: Bench) -> None:
    found = bench.json("fourier", "--image", 64, "--cutout", 31, "--planes", 2, "--repeats", 1)
    assert found["transforms"] == 6 and found["method"] == "fft"
    assert found["error"] < 1e-5 and found["ratio"] > 0 and found["step_ratio"] > 0
    assert "FFTs alone" in bench("fourier", "--image", 64, "--cutout", 31, "--planes", 2, "--repeats", 1)


@pytest.mark.long
def test_an_iteration_takes_at_most_a_fifth_more_than_its_ffts() -> None:
    found = fourier.measure(1200, 859, 9, 9)
    assert found.ratio < 1.2 and found.step_ratio < 1.2


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
    assert "11 planes, within 2 %" in bench("storage", "bench", *options, "--planes", 11, "--workers", 1)


@pytest.mark.long
def test_work_by_executors(bench: Bench, tmp_path: Path) -> None:
    options = ("--planes", 2, "--rows", 2, "--cutout", 21, "--tolerance", 0.3, "--rounds", 1, "--folder", tmp_path)
    found = bench.json("work", "bench", *options, "--executors", "threads,processes", "--many", 64)
    assert set(found["seconds"]) == {f"{name} {n}" for name in ("threads", "processes") for n in (1, 2)}
    assert found["overhead"] == {} and set(found["scaling"]) == {"threads", "processes"}
    spent = found["cpu_seconds"]  # a process also takes its start
    assert set(spent) == set(found["seconds"]) and 0 < spent["threads 1"] < spent["processes 1"]
    assert found["forecast"]["units"] == 2 and found["forecast"]["workers"] == 64
    shown = bench("work", "bench", *options, "--executors", "threads")
    assert "2 units" in shown and "64 workers by forecast: 2 units of " in shown
    assert not list(tmp_path.iterdir())


# -- fits and reconstructions --------------------------------------------------------------------------------


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


@pytest.mark.long
def test_fit(bench: Bench) -> None:
    options = ("--cameras", 1, "--patterns", 12, "--cutout", 21, "--positions", 4, "--workers", 1)
    (found,) = bench.json("fit", "bench", *options, "--seed", 3)
    assert found["seed"] == 3 and found["error_l1"] < 0.02 < found["described_l1"] and len(found["pulls"]) > 8
    shown = bench("fit", *options, "--seed", 3, "--stage", 0.05)
    assert "camera 3: error of H" in shown and "of 1" in shown


@pytest.mark.long
def test_retrieve(bench: Bench, tmp_path: Path) -> None:
    options = ("--counts", "6,18", "--cameras", 1, "--cutout", 21, "--positions", 4, "--workers", 1, "--seed", 3)
    found = bench.json("retrieve", *options, "--chart", tmp_path / "frames.png")
    few, more = (one["errors"][0] for one in found["fitted"])
    assert more < few < found["recorded"]["errors"][0] and found["recorded"]["frames"] == 1254
    assert (tmp_path / "frames.png").stat().st_size > 5000
    shown = bench("retrieve", *options, "--per-frame", 6, "--force")
    assert "recorded, every position" in shown and "125" in shown  # 1254 frames of 6 s


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


@pytest.mark.long
def test_solvers_longer(bench: Bench, tmp_path: Path, small_cameras: None, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(
        "benchmarks._solver_scenes.subject_of", lambda name, side=0: asked.append(side) or subject_of(name, 40)
    )
    shown = bench("solvers", "--full", "--camera", "bench", "--scene", "shell", "--solver", "rl", "--force")
    assert asked == [132] and "wins or ties after 2 iterations of rl" in shown


@pytest.mark.long
def test_scenes_are_not_made_by_what_is_inverted() -> None:
    """Sources are between the planes and voxels; the coarse H fits the frame within its noise."""
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


# -- faults ------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_fault_is_tried_with_its_costs(bench: Bench) -> None:
    number = next(k for k, one in enumerate(FAULTS) if one.name == "offsets of columns")
    part = ("--cameras", "bench", "--first", number, "--faults", 1, "--strengths", "3", "--patterns", 24)
    found = bench.json("faults", *part)
    (one,) = found["faults"]
    assert one["fault"] == "offsets of columns" and one["strength"] == 15 and one["rank"] == 1
    assert one["true"] / 2 < one["reported"] < 2 * one["true"]
    assert (found["dear"], found["first_or_second"], found["named"], found["within_2"]) == (1, 1, 1, 1)


def test_trials_of_faults_are_kept(bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    once = Tried("bench", FAULTS[0].name, FAULTS[0].strengths[2], FAULTS[0].unit, 0.2, 0.15, 1, ("a 0.150",), 1.0)
    answers = iter([once])
    monkeypatch.setattr(faults, "_truth", lambda recording: None)
    monkeypatch.setattr(faults, "tried", lambda *_: next(answers))
    part = ("--cameras", "bench", "--faults", 1, "--strengths", "3", "--patterns", 24, "--keep", tmp_path / "kept")
    found = bench.json("faults", *part)
    assert found["faults"][0]["reported"] == 0.15 and found["first_or_second"] == 1
    assert bench.json("faults", *part) == found, "nothing is done again"
    with (tmp_path / "kept").open("a") as more:
        more.write("none\n")
    assert "line 2 of kept" in bench("faults", *part, code=2)


@pytest.mark.long
def test_cameras_without_a_fault_raise_no_alarm(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(faults, "CLEAN", 2)
    found = bench.json("faults", "--clean", "--patterns", 24)
    assert [one["camera"] for one in found["cameras"]] == ["bench", "bench, 1 % PRNU"] and found["bad"] == 0


def test_every_fault_has_its_own_name_and_changes_a_recording(pytestconfig: pytest.Config) -> None:
    assert len(FAULTS) >= 60 and len({one.name for one in FAULTS}) == len(FAULTS) and len(FAULT_CAMERAS) == 4
    recording = Recording(FAULT_CAMERAS["bench"]())
    clean = recording.clean()
    for fault in FAULTS if pytestconfig.getoption("--long") else FAULTS[:: len(FAULTS) // 2]:
        values = fault.put_in(recording, fault.strengths[2])
        assert values.shape == recording.plan.shape and np.isfinite(values).all(), fault.name
        assert not np.allclose(values, clean), fault.name
