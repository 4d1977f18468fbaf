"""Several regions of the field in one session, and H of all of them in one file."""

from __future__ import annotations

import itertools
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lfcal
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import RegionPlan
from lfcal.campaign.regions import first_begun, is_regions, iter_record_regions, read_regions
from lfcal.cli import main
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames import open_frames
from lfcal.judge.region_loss import region_loss
from lfcal.psf import open_psf, regions_of
from lfcal.tasks import AssembleRegions, job_of, load_job
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

SCAN = small_plan((3, 3), 2)
PLAN = RegionPlan(
    replace(SCAN, anchor=(48.0, 48.0)), ("centre", "left", "low"), ((48.0, 48.0), (48.0, 20.0), (70.0, 48.0))
)


def run(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def record(folder: Path, *faults: DeviceFault, plan: RegionPlan = PLAN, resume: bool = False) -> int:
    work = iter_record_regions(folder, plan, rig_for(plan.scan, *faults), CAREFUL, resume=resume)
    outcome = drain(work)
    assert outcome.how == "complete" and outcome.total == 54
    return outcome.acknowledged


def test_progress_is_that_of_all_regions(tmp_path: Path) -> None:
    work = iter_record_regions(tmp_path / "s", PLAN, rig_for(PLAN.scan), CAREFUL)
    shown = [one for one in work if one.stage.startswith("record")]
    assert {one.stage for one in shown} == {f"record {name}" for name in PLAN.names}
    assert {one.total for one in shown} == {54} and shown[-1].done == 54
    assert [one.done for one in shown] == sorted(one.done for one in shown)


def test_every_region_is_recorded_at_its_place(tmp_path: Path) -> None:
    assert record(tmp_path / "s") == 54
    assert is_regions(tmp_path / "s") and read_regions(tmp_path / "s") == PLAN
    for k, name in enumerate(PLAN.names):
        session = SessionFile.read(tmp_path / "s" / name)
        assert session.plan == PLAN.plan(k)
        source = open_frames(tmp_path / "s" / name)
        row, column = PLAN.anchors[k]
        assert source.info(0).origin == (row - 10, column - 10)


def test_the_first_region_that_was_begun_is_found(tmp_path: Path) -> None:
    record(tmp_path / "s")
    for folder in (tmp_path / "s" / name for name in PLAN.names):
        assert first_begun(tmp_path / "s") == folder
        shutil.rmtree(folder)
    assert first_begun(tmp_path / "s") is None


@pytest.mark.parametrize("at", [5, 25, 50])
def test_an_interrupted_session_goes_on_where_it_was(tmp_path: Path, at: int) -> None:
    record(tmp_path / "whole")
    with pytest.raises(Exception, match=r"vanish|no answer"):
        record(tmp_path / "s", DeviceFault("vanishes", at))
    assert record(tmp_path / "s", resume=True) == 54
    for name in PLAN.names:
        assert_same_frames(frames_of(tmp_path / "whole" / name), frames_of(tmp_path / "s" / name))


def test_only_the_same_plan_goes_on_and_nothing_is_written_over(tmp_path: Path) -> None:
    record(tmp_path / "s")
    with pytest.raises(InputError, match="a new folder"):
        record(tmp_path / "s")
    other = RegionPlan(PLAN.scan, PLAN.names, (*PLAN.anchors[:2], (69.0, 48.0)))
    with pytest.raises(InputError, match="the plan of the recorded session"):
        record(tmp_path / "s", plan=other, resume=True)
    with pytest.raises(InputError, match="a session of regions"):
        record(tmp_path / "none", resume=True)


def test_from_the_plan_to_h_of_all_regions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    out, H = tmp_path / "s", tmp_path / "H.h5"
    words = ("acquire", tmp_path / "plan.json", "-o", out, "--darks", 2, "--reference-every", 0)
    assert run(*words, "--dry-run", "--json", monkeypatch=monkeypatch) == 0
    assert json.loads(capsys.readouterr().out)["positions"] == 54
    assert run(*words, "--assemble", H, "--json", monkeypatch=monkeypatch) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outcome"]["acknowledged"] == 54 and told["bytes_gained"] > 0
    assert regions_of(H) == PLAN.names
    again = tmp_path / "again.h5"
    assert run("assemble", out, "-o", again, monkeypatch=monkeypatch) == 0
    assert run("verify", out, monkeypatch=monkeypatch) == 0
    assert "centre: This session is intact in 19 of 19 frames." in capsys.readouterr().out
    for k, name in enumerate(PLAN.names):
        with open_psf(H, region=name, check=True) as one, open_psf(again, region=name) as other:
            assert one.shape == SCAN.shape and one.anchor == PLAN.anchors[k] and one.recorded.all()
            np.testing.assert_array_equal(one.plane(0), other.plane(0))
    # no files are left beside it
    assert sorted(p.name for p in tmp_path.iterdir()) == ["H.h5", "again.h5", "plan.json", "s"]


@pytest.mark.long
def test_the_loss_between_regions_is_that_of_their_patterns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    words = ("--darks", 0, "--reference-every", 0, "--assemble", tmp_path / "H.h5")
    assert run("acquire", tmp_path / "plan.json", "-o", tmp_path / "s", *words, monkeypatch=monkeypatch) == 0
    found = region_loss(tmp_path / "H.h5")
    assert found.error.shape == (3, 2, 3, 3) and found.losses[0] == 0
    with open_psf(tmp_path / "H.h5") as first, open_psf(tmp_path / "H.h5", region="low") as low:
        errors = []
        for place in np.ndindex(2, 3, 3):
            a, b = low[place].astype(float), first[place].astype(float)
            errors.append(np.linalg.norm(a * b.sum() / a.sum() - b) / np.linalg.norm(b))
        assert found.losses[2] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-4)
    assert found.worst == pytest.approx(max(found.losses))
    capsys.readouterr()
    folder = tmp_path / "report"
    assert run("inspect", tmp_path / "H.h5", "--seconds", 0, "--report", folder, monkeypatch=monkeypatch) == 0
    assert "patterns compared with those of centre" in capsys.readouterr().out
    assert (folder / "regions.png").stat().st_size > 1000
    assert run("inspect", tmp_path / "H.h5", "--seconds", 0, "--json", monkeypatch=monkeypatch) == 0
    assert json.loads(capsys.readouterr().out)["regions"]["worst"] == pytest.approx(found.worst)


@pytest.mark.parametrize("words", [("--redo", "x.json"), ("--positions", "x.json"), ("--until-error", "1%")])
def test_options_of_one_region_are_refused(
    tmp_path: Path, words: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    assert run("acquire", tmp_path / "plan.json", "-o", tmp_path / "s", *words, monkeypatch=monkeypatch) == 2
    assert f"got several regions; leave {words[0]} out" in capsys.readouterr().err and not (tmp_path / "s").exists()
    begin = ("plan", "bench", "--virtual-depths", "4", "--regions", "3x3")
    assert run(*begin, "--half-cell", monkeypatch=monkeypatch) == 2
    assert "--half-cell: expected a scan of one region, got a scan of several regions" in capsys.readouterr().err


PLACES = {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}
COLOURS = replace(SCAN, period=(2, 4), camera=replace(SCAN.camera, sensor=replace(SCAN.camera.sensor, cfa="GRBG")))
COLOURED = RegionPlan(replace(COLOURS, anchor=(48.0, 48.0)), ("centre", "left"), ((48.0, 48.0), (47.0, 21.0)))


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("coloured") / "s"
    options = replace(CAREFUL, darks=2)
    drain(iter_record_regions(folder, COLOURED, rig_for(COLOURED.scan), options))
    return folder


@pytest.mark.parametrize("dark", [False, True])
def test_each_colour_has_a_file_of_all_regions(coloured: Path, tmp_path: Path, dark: bool) -> None:
    """Cutouts of a mosaic contain the pixels of a colour at the positions whose image is on one of them."""
    how = {} if dark else {"dark": "none"}
    out = tmp_path / "H.h5"
    made = lfcal.assemble(coloured, out, channel="each", dtype="float32", keep_pedestal=True, **how)
    found = [(one.name, one.out.name) for one in made]
    assert found == [(name, f"H_{colour}.h5") for colour in PLACES for name in COLOURED.names]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(f"H_{colour}.h5" for colour in PLACES)
    for (colour, place), name in itertools.product(PLACES.items(), COLOURED.names):
        with open_frames(coloured / name) as source, open_psf(tmp_path / f"H_{colour}.h5", region=name) as H:
            assert H.shape == (2, 1, 2, 11, 11) and H.recorded.all()
            (level,) = source.metadata.darks.values()
            for k in range(len(source)):
                info = source.info(k)
                point = np.array(info.origin) + 10
                if tuple(point % 2) != place:
                    continue
                values, (row, column) = source.read(k)[::2, ::2].astype(np.float32), info.origin
                if dark:
                    row, column = row - level.origin[0], column - level.origin[1]
                    values = values - level.frame[row : row + 21 : 2, column : column + 21 : 2]
                z, y, x = info.position
                np.testing.assert_array_equal(H[z, y // 2, x // 2], values)


def test_no_work_starts_if_a_colour_cannot_be_written(coloured: Path, tmp_path: Path) -> None:
    (tmp_path / "H_B.h5").write_bytes(b"mine")
    task = AssembleRegions(frames=coloured, out=tmp_path / "H.h5", channel="each")
    with pytest.raises(InputError, match=r"H_B.h5: exists; add --force"):
        next(task.work())
    assert [path.name for path in tmp_path.iterdir()] == ["H_B.h5"]
    (tmp_path / "job.toml").write_text(job_of(task))
    with pytest.raises(InputError, match=r"H_B.h5: exists"):
        load_job(tmp_path / "job.toml")[0].run()


def test_a_colour_of_regions(
    coloured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    how = ("--channel", "R", "--keep-pedestal")
    assert run("assemble", coloured, "-o", tmp_path / "R.h5", *how, monkeypatch=monkeypatch) == 0
    assert "R.h5: H of 2 regions" in capsys.readouterr().out
    how = ("--channel", "each", "--keep-pedestal", "--json")
    assert run("assemble", coloured, "-o", tmp_path / "H.h5", *how, monkeypatch=monkeypatch) == 0
    told = json.loads(capsys.readouterr().out)
    assert [(one["name"], Path(one["out"]).name) for one in told][2:4] == [("centre", "H_R.h5"), ("left", "H_R.h5")]
    with open_psf(tmp_path / "R.h5", region="left") as one, open_psf(tmp_path / "H_R.h5", region="left") as other:
        np.testing.assert_array_equal(one.plane(1), other.plane(1))
