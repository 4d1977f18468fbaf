from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.camera import Marks, ScanPlan, StageAxes, preset
from lfcal.cli import main
from lfcal.frames import open_frames
from lfcal.tasks import load_camera

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Run ``lfcal`` in this process; return exit code, output and errors."""

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lfcal", *arguments])
        with pytest.raises(SystemExit) as stop:
            main()
            raise SystemExit(0)
        out, err = capsys.readouterr()
        return int(stop.value.code or 0), out, err

    return call


def test_the_table_shows_the_cell_and_the_cost(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    code, out, err = run("plan", "r29", "--virtual-depths", "1.1:5.5:0.44", "--cutout", "181", "-o", str(path))
    assert (code, err) == (0, "")
    for shown in ("95.100 × 54.906 px", "95 × 55 = 5225", "+0.100, -0.094 px", "57475", "181 × 181 px", "7.5 GB"):
        assert shown in out
    plan = ScanPlan.from_json(path.read_text(encoding="utf-8"))
    assert plan.shape == (11, 55, 95, 181, 181)
    assert list(tmp_path.iterdir()) == [path]


def test_the_native_plane_has_the_virtual_depth_0(run: Run) -> None:
    _, out, _ = run("plan", "lfm_20x05", "--depths", "0,20")
    assert re.search(r"virtual depth +0 … -3\.2", out), out


def test_a_time_without_readout_says_so(run: Run) -> None:
    words = ("plan", "r29", "--virtual-depths", "4")
    _, out, _ = run(*words)
    said = "7 min 54 s without readout (--frame-rate): the camera would deliver 635.2 MB/s"
    assert said in out and "reading out" not in out
    code, out, _ = run(*words, "--frame-rate", "5")
    assert code == 0 and "17 min 25 s at 5 frames/s" in out and "25 min 19 s" in out and "without readout" not in out
    told = [json.loads(run(*words, *more, "--json")[1])["forecast"] for more in ((), ("--frame-rate", "5"))]
    assert told[0]["readout_hours"] is None and told[1]["readout_hours"] * 3600 == pytest.approx(5225 / 5)
    assert told[1]["hours"] - told[0]["hours"] == pytest.approx(told[1]["readout_hours"])
    assert told[0]["bytes_per_s"] == pytest.approx(635.2e6, rel=1e-3)


def test_regions_and_positions_for_a_fit_are_read_out_too(run: Run, tmp_path: Path) -> None:
    words, rate = ("plan", "bench", "--virtual-depths", "4"), ("--frame-rate", "5")
    regions = (*words, "--regions", "2x1")
    assert "in all without readout (--frame-rate); one region" in run(*regions)[1]
    assert "without readout" not in run(*regions, *rate)[1]
    told = [json.loads(run(*regions, *more, "--json")[1]) for more in ((), rate)]
    assert told[0]["readout_hours"] is None
    assert (told[1]["hours"] - told[0]["hours"]) * 3600 == pytest.approx(told[1]["frames"] / 5)
    assert run(*words, "--cutout", "15", "-o", str(tmp_path / "plan.json"))[0] == 0
    fit = ("plan", "fit", str(tmp_path / "plan.json"), "-n", "4", "--candidates", "12")
    assert "without readout (--frame-rate)" in run(*fit)[1]
    told = [json.loads(run(*fit, *more, "--json")[1]) for more in ((), rate)]
    for few, many in zip(told[0]["curve"], told[1]["curve"], strict=True):
        assert (many["hours"] - few["hours"]) * 3600 == pytest.approx(few["positions"] / 5)
    assert told[1]["whole_scan"]["readout_hours"] * 3600 == pytest.approx(627 / 5)


def test_json_holds_numbers_and_the_plan(run: Run) -> None:
    code, out, _ = run("plan", "lfm_60x12", "--depths", "-10um:10um:5", "--resample", "--json")
    data: dict[str, Any] = json.loads(out)
    assert code == 0
    assert data["depths_um"] == [-10, -5, 0, 5, 10]
    assert data["resample_factors"] == pytest.approx([0.975, 0.975])
    assert data["forecast"]["positions"] == 5 * 15 * 15
    assert ScanPlan.from_dict(data["plan"]).resample


def test_options_reach_the_plan(run: Run) -> None:
    code, out, _ = run(
        *("plan", "bench", "--depths", "-2mm,1mm", "--cutout", "31,33", "--anchor", "60.5,70", "--order", "raster"),
        *("--stage", "-y,+x,-z", "--exposure", "0.3", "--settle", "0.2", "--average", "4", "--json"),
    )
    assert code == 0
    plan = ScanPlan.from_dict(json.loads(out)["plan"])
    assert plan.depths_um == (-2000.0, 1000.0) and plan.cutout == (31, 33) and plan.anchor == (60.5, 70.0)
    assert (plan.stage.right, plan.stage.down, plan.stage.away) == ("-y", "+x", "-z")
    assert plan.order == "raster" and plan.exposures == (0.3, 0.3)
    assert plan.settle_s == 0.2 and plan.frames_averaged == 4


def test_a_camera_from_a_file(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(preset("bench").to_json())
    assert load_camera(str(path)) == preset("bench")
    code, out, _ = run("plan", str(path), "--virtual-depths", "3")
    assert code == 0 and "33 × 19 = 627" in out


@pytest.mark.parametrize(
    "arguments",
    [
        ("r29",),
        ("r29", "--depths", "1", "--virtual-depths", "2"),
        ("nowhere", "--depths", "1"),
        ("r29", "--depths", "one"),
        ("r29", "--depths", "1:2"),
        ("r29", "--depths", "1:2:0"),
        ("r29", "--depths", "2:1:1"),
        ("r29", "--depths", "0:1e9:1"),
        ("r29", "--depths", "1,nan"),
        ("r29", "--virtual-depths", "2mm"),
        ("r29", "--virtual-depths", "-80"),
        ("r29", "--depths", "0", "--cutout", "180"),
        ("r29", "--depths", "0", "--cutout", "31.5"),
        ("r29", "--depths", "0", "--cutout", "a"),
        ("r29", "--depths", "0", "--anchor", "1,2,3"),
        ("r29", "--depths", "0", "--anchor", "0,0"),
        ("r29", "--depths", "0", "--stage", "+x,+y"),
        ("r29", "--depths", "0", "--stage", "+x,+x,+z"),
        ("r29", "--depths", "0", "--order", "spiral"),
        ("r29", "--depths", "0", "--exposure", "0"),
        ("r29", "--depths", "0", "--speed", "-1"),
        ("r29", "--depths", "0", "-o", "/proc/nowhere/plan.json"),
    ],
)
def test_bad_input_is_one_line_and_code_2(run: Run, arguments: tuple[str, ...]) -> None:
    code, out, err = run("plan", *arguments)
    assert code == 2 and out == ""
    assert len(err.strip().splitlines()) == 1 and err.startswith("lfcal: ")


def test_camera_files_that_are_none(run: Run, tmp_path: Path) -> None:
    for name, data in (("a.json", b"{}"), ("b.json", b"\xff\xfe\x00"), ("c.xml", b"<x/>"), ("d.json", b"[" * 90_000)):
        (tmp_path / name).write_bytes(data)
        code, _, err = run("plan", str(tmp_path / name), "--depths", "0")
        assert code == 2 and len(err.strip().splitlines()) == 1


def test_the_noise_of_h_is_forecast_where_the_sensor_is_described(run: Run, tmp_path: Path) -> None:
    code, out, err = run("plan", "bench", "--virtual-depths", "3,4", "--cutout", "55", "--peak", "80 %")
    assert (code, err) == (0, "") and re.search(r"expected noise of H \(rms\) +2\.\d %, worst plane 2\.\d %", out)
    four = run(
        "plan", "bench", "--virtual-depths", "3,4", "--cutout", "55", "--peak", "0.8", "--average", "4", "--json"
    )
    one = run("plan", "bench", "--virtual-depths", "3,4", "--cutout", "55", "--peak", "0.8", "--json")
    noise = [json.loads(found[1])["noise"] for found in (one, four)]
    assert [n / 2 for n in noise[0]] == pytest.approx(noise[1], rel=1e-2)
    camera = replace(preset("bench"), marks=Marks.of({"sensor.read_noise_e": "assumed"}))
    (tmp_path / "c.json").write_text(camera.to_json())
    code, out, err = run("plan", str(tmp_path / "c.json"), "--virtual-depths", "3,4", "--peak", "0.8")
    assert (
        code == 0
        and "noise of H is not predicted, because of assumed values: read noise" in err
        and "noise of H (" not in out
    )


SMALL = ("bench", "--virtual-depths", "3,4", "--cutout", "63", "--stage", "+x,-y,+z")


def test_a_table_of_stage_positions_places_the_frames_named_after_it(run: Run, tmp_path: Path) -> None:
    """A program that moves to each row and saves its frame under the name in it: the table is then their list."""
    for name, form in (("plan.json", "plan"), ("scan.csv", "csv")):
        code, _, err = run("plan", *SMALL, "--exposure", "0.02,0.05", "--as", form, "-o", str(tmp_path / name))
        assert code == 0, err
    assert "to assemble H, write the plan too" in err
    plan = ScanPlan.from_json((tmp_path / "plan.json").read_text())
    rows = list(csv.DictReader((tmp_path / "scan.csv").read_text().splitlines()))
    places = [[float(row[f"{axis}_um"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(places, plan.stage_um(), atol=1e-4)
    assert [float(row["exposure_s"]) for row in rows] == [plan.exposures[z] for z, _, _ in plan.positions()]
    shape = plan.camera.sensor.shape
    for k, row in enumerate(rows):
        frame = np.zeros(shape, np.uint16)
        frame.flat[:2] = k, 1
        tifffile.imwrite(tmp_path / f"{row['file']}.tif", frame)
    with open_frames(tmp_path, manifest=tmp_path / "scan.csv", plan=plan) as frames:
        assert len(frames) == len(rows)
        for k, position in list(enumerate(plan.positions()))[::97]:
            at = next(i for i in range(len(frames)) if frames.info(i).position == position)
            assert frames.read(at).flat[0] == k


def test_a_sequence_of_useq_schema(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "scan.json"
    code, _, _ = run("plan", *SMALL, "--as", "useq", "-o", str(path), "--json")
    assert code == 0
    said = json.loads(path.read_text())
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=63, stage=StageAxes.parse("+x,-y,+z"))
    places = [[one[axis] for axis in "xyz"] for one in said["stage_positions"]]
    np.testing.assert_allclose(places, plan.stage_um(), atol=1e-4)
    names = [f"z{z:03d}_y{y:03d}_x{x:03d}" for z, y, x in plan.positions()]
    assert [one["name"] for one in said["stage_positions"]] == names
    assert said["axis_order"][0] == "p" and said["metadata"]["lfcal"]["exposure_s"] == 0.02
    code, _, err = run("plan", *SMALL, "--exposure", "0.02,0.05", "--as", "useq", "-o", str(tmp_path / "b.json"))
    assert code == 2 and "one for all planes" in err and not (tmp_path / "b.json").exists()
    code, _, err = run("plan", *SMALL, "--as", "useq")
    assert code == 2 and "--as: expected --out" in err


def test_useq_itself_reads_the_sequence(run: Run, tmp_path: Path) -> None:
    useq = pytest.importorskip("useq", reason="useq-schema is not installed")
    run("plan", *SMALL, "--as", "useq", "-o", str(tmp_path / "scan.json"))
    run("plan", *SMALL, "-o", str(tmp_path / "plan.json"))
    plan = ScanPlan.from_dict(json.loads((tmp_path / "plan.json").read_text()))
    events = list(useq.MDASequence.from_file(tmp_path / "scan.json"))
    places = [(event.x_pos, event.y_pos, event.z_pos) for event in events]
    np.testing.assert_allclose(places, plan.stage_um(), atol=1e-4)
    assert [event.pos_name for event in events] == [f"z{z:03d}_y{y:03d}_x{x:03d}" for z, y, x in plan.positions()]
