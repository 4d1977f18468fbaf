"""``lfcal plan``, ``lfcal plan fit`` and ``lfcal plan target``."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.acquire.redo import RedoList
from lfcal.camera import Marks, ScanPlan, StageAxes, preset
from lfcal.frames import open_frames
from lfcal.tasks import load_camera
from tests.cli.conftest import Lfcal
from tests.fit.common import small_camera

# -- plan --


def test_the_table_shows_the_cell_and_the_cost(lfcal: Lfcal, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    done = lfcal("plan", "r29", "--virtual-depths", "1.1:5.5:0.44", "--cutout", "181", "-o", path).ok()
    for shown in ("95.100 × 54.906 px", "95 × 55 = 5225", "+0.100, -0.094 px", "57475", "181 × 181 px", "7.5 GB"):
        assert shown in done.out
    assert ScanPlan.from_json(path.read_text(encoding="utf-8")).shape == (11, 55, 95, 181, 181)
    assert not done.err and list(tmp_path.iterdir()) == [path]
    # the native plane has the virtual depth 0
    assert re.search(r"virtual depth +0 … -3\.2", lfcal("plan", "lfm_20x05", "--depths", "0,20").out)


RATE = ("--frame-rate", "5")


def test_a_time_without_readout_says_so(lfcal: Lfcal) -> None:
    words = ("plan", "r29", "--virtual-depths", "4")
    out = lfcal(*words).out
    said = "7 min 54 s without readout (--frame-rate): the camera would deliver 635.2 MB/s"
    assert said in out and "reading out" not in out
    out = lfcal(*words, *RATE).ok().out
    assert "17 min 25 s at 5 frames/s" in out and "25 min 19 s" in out and "without readout" not in out
    told = [lfcal(*words, *more, "--json").json["forecast"] for more in ((), RATE)]
    assert told[0]["readout_hours"] is None and told[1]["readout_hours"] * 3600 == pytest.approx(5225 / 5)
    assert told[1]["hours"] - told[0]["hours"] == pytest.approx(told[1]["readout_hours"])
    assert told[0]["bytes_per_s"] == pytest.approx(635.2e6, rel=1e-3)


def test_regions_and_positions_for_a_fit_are_read_out_too(lfcal: Lfcal, tmp_path: Path) -> None:
    words = ("plan", "bench", "--virtual-depths", "4")
    regions = (*words, "--regions", "2x1")
    assert "in all without readout (--frame-rate); one region" in lfcal(*regions).out
    assert "without readout" not in lfcal(*regions, *RATE).out
    told = [lfcal(*regions, *more, "--json").json for more in ((), RATE)]
    assert told[0]["readout_hours"] is None
    assert (told[1]["hours"] - told[0]["hours"]) * 3600 == pytest.approx(told[1]["frames"] / 5)
    lfcal(*words, "--cutout", "15", "-o", tmp_path / "plan.json").ok()
    fit = ("plan", "fit", tmp_path / "plan.json", "-n", "4", "--candidates", "12")
    assert "without readout (--frame-rate)" in lfcal(*fit).out
    told = [lfcal(*fit, *more, "--json").json for more in ((), RATE)]
    for few, many in zip(told[0]["curve"], told[1]["curve"], strict=True):
        assert (many["hours"] - few["hours"]) * 3600 == pytest.approx(few["positions"] / 5)
    assert told[1]["whole_scan"]["readout_hours"] * 3600 == pytest.approx(627 / 5)


def test_options_reach_the_plan_and_its_numbers(lfcal: Lfcal) -> None:
    data = lfcal("plan", "lfm_60x12", "--depths", "-10um:10um:5", "--resample", "--json").ok().json
    assert data["depths_um"] == [-10, -5, 0, 5, 10] and data["forecast"]["positions"] == 5 * 15 * 15
    assert data["resample_factors"] == pytest.approx([0.975, 0.975]) and ScanPlan.from_dict(data["plan"]).resample
    words = "--depths -2mm,1mm --cutout 31,33 --anchor 60.5,70 --order raster --stage -y,+x,-z --exposure 0.3"
    done = lfcal("plan", "bench", *words.split(), "--settle", "0.2", "--average", "4", "--json").ok()
    plan = ScanPlan.from_dict(done.json["plan"])
    assert plan.depths_um == (-2000.0, 1000.0) and plan.cutout == (31, 33) and plan.anchor == (60.5, 70.0)
    assert (plan.stage.right, plan.stage.down, plan.stage.away) == ("-y", "+x", "-z")
    assert plan.order == "raster" and plan.exposures == (0.3, 0.3)
    assert plan.settle_s == 0.2 and plan.frames_averaged == 4


def test_a_camera_from_a_file(lfcal: Lfcal, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(preset("bench").to_json())
    assert load_camera(str(path)) == preset("bench")
    assert "33 × 19 = 627" in lfcal("plan", path, "--virtual-depths", "3").ok().out


def test_bad_input_is_one_line(lfcal: Lfcal, tmp_path: Path) -> None:
    for words in (
        "r29",
        "r29 --depths 1 --virtual-depths 2",
        "nowhere --depths 1",
        *(f"r29 --depths {text}" for text in ("one", "a,b", "1:2", "1:2:0", "2:1:1", "0:1e9:1", "1,nan")),
        *(f"r29 --virtual-depths {text}" for text in ("2mm", "-80")),
        *(f"r29 --depths 0 --cutout {text}" for text in ("180", "31.5", "a")),
        *(f"r29 --depths 0 --anchor {text}" for text in ("1,2,3", "0,0")),
        *(f"r29 --depths 0 --stage {text}" for text in ("+x,+y", "+x,+x,+z")),
        *(f"r29 --depths 0 {option}" for option in ("--order spiral", "--exposure 0", "--speed -1")),
        "r29 --depths 0 -o /proc/nowhere/plan.json",
    ):
        done = lfcal("plan", *words.split()).refused()
        assert done.out == "" and done.err.startswith("lfcal: "), words
    for name, data in (("a.json", b"{}"), ("b.json", b"\xff\xfe\x00"), ("c.xml", b"<x/>"), ("d.json", b"[" * 90_000)):
        (tmp_path / name).write_bytes(data)
        lfcal("plan", tmp_path / name, "--depths", "0").refused()


def test_the_noise_of_h_is_forecast_where_the_sensor_is_described(lfcal: Lfcal, tmp_path: Path) -> None:
    words = ("plan", "bench", "--virtual-depths", "3,4", "--cutout", "55", "--peak")
    done = lfcal(*words, "80 %").ok()
    assert not done.err and re.search(r"expected noise of H \(rms\) +2\.\d %, worst plane 2\.\d %", done.out)
    one, four = (lfcal(*words, "0.8", *more, "--json").ok().json["noise"] for more in ((), ("--average", "4")))
    assert [n / 2 for n in one] == pytest.approx(four, rel=1e-2)
    camera = replace(preset("bench"), marks=Marks.of({"sensor.read_noise_e": "assumed"}))
    (tmp_path / "c.json").write_text(camera.to_json())
    done = lfcal("plan", tmp_path / "c.json", "--virtual-depths", "3,4", "--peak", "0.8").ok()
    assert "noise of H is not predicted, because of assumed values: read noise" in done.err
    assert "noise of H (" not in done.out


SMALL = ("bench", "--virtual-depths", "3,4", "--cutout", "63", "--stage", "+x,-y,+z")


def test_a_table_of_stage_positions_places_the_frames_named_after_it(lfcal: Lfcal, tmp_path: Path) -> None:
    """A program that moves to each row and saves its frame under the name in it: the table is then their list."""
    for name, form in (("plan.json", "plan"), ("scan.csv", "csv")):
        done = lfcal("plan", *SMALL, "--exposure", "0.02,0.05", "--as", form, "-o", tmp_path / name).ok()
    assert "to assemble H, write the plan too" in done.err
    plan = ScanPlan.from_json((tmp_path / "plan.json").read_text())
    rows = list(csv.DictReader((tmp_path / "scan.csv").read_text().splitlines()))
    places = [[float(row[f"{axis}_um"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(places, plan.stage_um(), atol=1e-4)
    assert [float(row["exposure_s"]) for row in rows] == [plan.exposures[z] for z, _, _ in plan.positions()]
    frame = np.zeros(plan.camera.sensor.shape, np.uint16)
    for k, row in enumerate(rows):
        frame.flat[:2] = k, 1
        tifffile.imwrite(tmp_path / f"{row['file']}.tif", frame)
    with open_frames(tmp_path, manifest=tmp_path / "scan.csv", plan=plan) as frames:
        assert len(frames) == len(rows)
        for k, position in list(enumerate(plan.positions()))[::97]:
            at = next(i for i in range(len(frames)) if frames.info(i).position == position)
            assert frames.read(at).flat[0] == k


def test_a_sequence_of_useq_schema(lfcal: Lfcal, tmp_path: Path) -> None:
    path = tmp_path / "scan.json"
    lfcal("plan", *SMALL, "--as", "useq", "-o", path, "--json").ok()
    said = json.loads(path.read_text())
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3, 4], cutout=63, stage=StageAxes.parse("+x,-y,+z"))
    places = [[one[axis] for axis in "xyz"] for one in said["stage_positions"]]
    np.testing.assert_allclose(places, plan.stage_um(), atol=1e-4)
    names = [f"z{z:03d}_y{y:03d}_x{x:03d}" for z, y, x in plan.positions()]
    assert [one["name"] for one in said["stage_positions"]] == names
    assert said["axis_order"][0] == "p" and said["metadata"]["lfcal"]["exposure_s"] == 0.02
    words = ("plan", *SMALL, "--as", "useq")
    lfcal(*words, "--exposure", "0.02,0.05", "-o", tmp_path / "b.json").refused("one for all planes")
    assert not (tmp_path / "b.json").exists()
    lfcal(*words).refused("--as: expected --out")
    useq = pytest.importorskip("useq", reason="useq-schema is not installed")
    events = list(useq.MDASequence.from_file(path))
    np.testing.assert_allclose(
        [(event.x_pos, event.y_pos, event.z_pos) for event in events], plan.stage_um(), atol=1e-4
    )
    assert [event.pos_name for event in events] == names


# -- ``lfcal plan target``: whether showing several frames of a target at once pays, and a display that does --


# -- ``lfcal plan fit``: few positions chosen, recorded, fitted, and further ones chosen from that fit --


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    camera = small_camera()
    (tmp_path / "camera.json").write_text(camera.to_json())

    plan = ScanPlan.for_camera(camera, virtual_depths=(2.2,), cutout=15)
    (tmp_path / "plan.json").write_text(plan.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.usefixtures("place")
def test_errors_below_that_of_the_computation_are_named(lfcal: Lfcal) -> None:
    words = ("plan", "fit", "plan.json", "--candidates", "40", "--count")
    run = lfcal(*words, "20", "--unknowns", "iris", "--full", "1", "--position-error", "0").ok()
    assert "computed patterns have an error of about 0.06 %" in run.err


@pytest.mark.long
@pytest.mark.usefixtures("place")
def test_errors_above_that_of_the_computation_are_not_named(lfcal: Lfcal) -> None:
    words = ("plan", "fit", "plan.json", "--candidates", "40", "--count")
    assert "computed patterns" not in lfcal(*words, "10", "--unknowns", "geometry,iris", "--full", "0.1").err


REFUSED = (
    ("plan camera.json --virtual-depths 2.2 --from fit", "use lfcal plan fit PLAN --count N --from"),
    ("plan camera.json --for-fit 9", "--for-fit: expected an option of lfcal plan; use lfcal plan fit PLAN --count N"),
    ("plan fit plan.json --for-fit 9", "--for-fit: expected an option of lfcal plan fit; use --count"),
    ("plan fit plan.json --count 9 --list a.json", "--list: expected an option of lfcal plan fit; use --out"),
    ("plan fit plan.json --count 9 --beside 0", "--beside: expected an option of lfcal plan fit; use --position-error"),
    ("plan fit plan.json", "Missing option '--count'"),
    ("plan fit plan.json --count 2", "positions to record: expected"),
    ("plan fit plan.json --count 9 --from nowhere", "the folder of a fit"),
    ("plan fit plan.json --count 9 --unknowns gap", "--unknowns: expected geometry, "),
    ("plan fit plan.json --count 9 --unknowns depths", "needs at least two planes"),
    ("plan fit plan.json --count 9 --full 2", "--full: expected a number > 0 and ≤ 1"),
    ("plan fit plan.json --count 9 --speed 0", "--speed: expected a number > 0"),
    ("plan fit plan.json --count 9 -o list.json", "exists"),
    ("plan fit plan.json --count 9 -o plan.json --force", "a file other than the input"),
    ("plan fit plan.json --count 9 -o a.json --draw a.json", "a different name for each"),
    ("plan fit camera.json --count 9", "PLAN: expected a scan plan (.json), got camera.json"),
    ("plan fit bench --count 9", "PLAN: expected a scan plan (.json), got the camera bench"),
    ("acquire plan.json --positions list.json --resume -o s", "--positions: expected a new session, got --resume"),
    ("acquire plan.json --positions camera.json -o s", "lfcal-redo"),
    ("acquire plan.json --positions far.json -o s", "inside (1, 19, 33)"),
    ("acquire plan.json --positions none.json -o s", "positions to record: expected at least one"),
    ("acquire plan.json --positions apart.json -o s", "a list of [z, y, x]"),
)


def test_positions_that_cannot_be_chosen_or_recorded_are_refused(lfcal: Lfcal, place: Path) -> None:
    RedoList.of([(0, 0, 0)]).write(place / "list.json")
    RedoList.of([(0, 0, 99)]).write(place / "far.json")
    RedoList.of([]).write(place / "none.json")
    RedoList.of([(0, 0, 0)], kept_aside=[(0, 1, 1)]).write(place / "apart.json")
    for words, said in REFUSED:
        lfcal(*words.split()).refused(said)
        assert not (place / "s" / "session.json").exists(), words


# -- ``lfcal plan target``: a target compared with the scan of a single point --
