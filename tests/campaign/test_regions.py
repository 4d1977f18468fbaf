"""Several regions of the field in one session, and H of all of them in one file."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal import assemble
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import RegionPlan
from lfcal.campaign.regions import first_begun, is_regions, iter_record_regions, read_regions
from lfcal.devices.simulated.faults import DeviceFault
from lfcal.frames import open_frames
from lfcal.judge.region_loss import region_loss
from lfcal.psf import open_psf, regions_of
from lfcal.tasks import AssembleRegions, job_of, load_job
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan
from tests.cli.conftest import Run

SCAN = small_plan((3, 3), 2)
PLAN = RegionPlan(
    replace(SCAN, anchor=(48.0, 48.0)), ("centre", "left", "low"), ((48.0, 48.0), (48.0, 20.0), (70.0, 48.0))
)


Lfcal = Callable[..., Run]


def record(folder: Path, *faults: DeviceFault, plan: RegionPlan = PLAN, resume: bool = False) -> int:
    work = iter_record_regions(folder, plan, rig_for(plan.scan, *faults), CAREFUL, resume=resume)
    outcome = drain(work)
    assert outcome.how == "complete" and outcome.total == 54
    return outcome.acknowledged


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("regions") / "s"
    assert record(folder) == 54
    return folder


def test_every_region_is_recorded_at_its_place_and_progress_is_that_of_all(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    work = iter_record_regions(folder, PLAN, rig_for(PLAN.scan), CAREFUL)
    shown = [one for one in work if one.stage.startswith("record")]
    assert {one.stage for one in shown} == {f"record {name}" for name in PLAN.names}
    assert {one.total for one in shown} == {54} and shown[-1].done == 54
    assert [one.done for one in shown] == sorted(one.done for one in shown)
    assert is_regions(folder) and read_regions(folder) == PLAN
    for k, name in enumerate(PLAN.names):
        assert SessionFile.read(folder / name).plan == PLAN.plan(k)
        row, column = PLAN.anchors[k]
        assert open_frames(folder / name).info(0).origin == (row - 10, column - 10)
    for name in PLAN.names:
        assert first_begun(folder) == folder / name
        shutil.rmtree(folder / name)
    assert first_begun(folder) is None


@pytest.mark.parametrize("at", [5, *(pytest.param(at, marks=pytest.mark.long) for at in (25, 50))])
def test_an_interrupted_session_is_resumed(recorded: Path, tmp_path: Path, at: int) -> None:
    with pytest.raises(Exception, match=r"vanish|no answer"):
        record(tmp_path / "s", DeviceFault("vanishes", at))
    assert record(tmp_path / "s", resume=True) == 54
    for name in PLAN.names:
        assert_same_frames(frames_of(recorded / name), frames_of(tmp_path / "s" / name))


def test_only_the_same_plan_is_resumed_and_nothing_is_overwritten(recorded: Path, tmp_path: Path) -> None:
    other = RegionPlan(PLAN.scan, PLAN.names, (*PLAN.anchors[:2], (69.0, 48.0)))
    for folder, more, words in (
        (recorded, {}, "a new folder"),
        (recorded, {"plan": other, "resume": True}, "the plan of the recorded session"),
        (tmp_path / "none", {"resume": True}, "a session of regions"),
    ):
        with pytest.raises(InputError, match=words):
            record(folder, **more)


def test_from_the_plan_to_h_of_all_regions(tmp_path: Path, lfcal: Lfcal) -> None:
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    out, H = tmp_path / "s", tmp_path / "H.h5"
    words = ("acquire", tmp_path / "plan.json", "-o", out, "--darks", 2, "--reference-every", 0)
    words = (*words, "--no-check-stage", "--option", "optics=pattern")
    assert lfcal(*words, "--dry-run", "--json").json["positions"] == 54
    made = lfcal(*words, "--assemble", H, "--json").json
    assert made["outcome"]["acknowledged"] == 54 and made["bytes_gained"] > 0
    assert regions_of(H) == PLAN.names
    again = tmp_path / "again.h5"
    assert lfcal("assemble", out, "-o", again).code == 0
    assert "centre: This session is intact in 19 of 19 frames." in lfcal("verify", out).out
    for k, name in enumerate(PLAN.names):
        with open_psf(H, region=name, check=True) as one, open_psf(again, region=name) as other:
            assert one.shape == SCAN.shape and one.anchor == PLAN.anchors[k] and one.recorded.all()
            np.testing.assert_array_equal(one.plane(0), other.plane(0))
    # no other files are left
    assert sorted(p.name for p in tmp_path.iterdir()) == ["H.h5", "again.h5", "plan.json", "s"]


@pytest.mark.long
def test_the_loss_between_regions_is_that_of_their_patterns(recorded: Path, tmp_path: Path, lfcal: Lfcal) -> None:
    H = tmp_path / "H.h5"
    assert lfcal("assemble", recorded, "-o", H, "--keep-pedestal").code == 0
    found = region_loss(H)
    assert found.error.shape == (3, 2, 3, 3) and found.losses[0] == 0
    with open_psf(H) as first, open_psf(H, region="low") as low:
        errors = []
        for place in np.ndindex(2, 3, 3):
            a, b = low[place].astype(float), first[place].astype(float)
            errors.append(np.linalg.norm(a * b.sum() / a.sum() - b) / np.linalg.norm(b))
        assert found.losses[2] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-4)
    assert found.worst == pytest.approx(max(found.losses))
    inspect = ("inspect", H, "--seconds", 0)
    assert "patterns compared with those of centre" in lfcal(*inspect, "--report", tmp_path / "report").out
    assert (tmp_path / "report" / "regions.png").stat().st_size > 1000
    assert lfcal(*inspect, "--json").json["regions"]["worst"] == pytest.approx(found.worst)


def test_options_of_one_region_are_refused(tmp_path: Path, lfcal: Lfcal) -> None:
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    for words in (("--redo", "x.json"), ("--positions", "x.json"), ("--until-error", "1%")):
        done = lfcal("acquire", tmp_path / "plan.json", "-o", tmp_path / "s", *words)
        assert done.code == 2 and f"got several regions; leave {words[0]} out" in done.err
        assert not (tmp_path / "s").exists()
    done = lfcal("plan", "bench", "--virtual-depths", "4", "--regions", "3x3", "--half-cell")
    assert done.code == 2
    assert "--half-cell: expected a scan of one region, got a scan of several regions" in done.err


PLACES = {"G1": (0, 0), "R": (0, 1), "B": (1, 0), "G2": (1, 1)}
COLOURS = replace(SCAN, period=(2, 4), camera=replace(SCAN.camera, sensor=replace(SCAN.camera.sensor, cfa="GRBG")))
COLOURED = RegionPlan(replace(COLOURS, anchor=(48.0, 48.0)), ("centre", "left"), ((48.0, 48.0), (47.0, 21.0)))


@pytest.fixture(scope="module")
def coloured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("coloured") / "s"
    options = replace(CAREFUL, darks=2)
    drain(iter_record_regions(folder, COLOURED, rig_for(COLOURED.scan), options))
    return folder


@pytest.mark.parametrize("dark", [pytest.param(False, marks=pytest.mark.long), True])
def test_each_colour_has_a_file_of_all_regions(coloured: Path, tmp_path: Path, dark: bool) -> None:
    """Cutouts of a mosaic contain the pixels of a colour at the positions whose image is on one of them."""
    how = {} if dark else {"dark": "none"}
    out = tmp_path / "H.h5"
    made = assemble(coloured, out, channel="each", dtype="float32", keep_pedestal=True, **how)
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


def test_a_colour_of_regions_is_assembled_by_command(coloured: Path, tmp_path: Path, lfcal: Lfcal) -> None:
    done = lfcal("assemble", coloured, "-o", tmp_path / "R.h5", "--channel", "R", "--keep-pedestal")
    assert done.code == 0 and "R.h5: H of 2 regions" in done.out
    made = lfcal("assemble", coloured, "-o", tmp_path / "H.h5", "--channel", "each", "--keep-pedestal", "--json").json
    assert [(one["name"], Path(one["out"]).name) for one in made][2:4] == [("centre", "H_R.h5"), ("left", "H_R.h5")]
    with open_psf(tmp_path / "R.h5", region="left") as one, open_psf(tmp_path / "H_R.h5", region="left") as other:
        np.testing.assert_array_equal(one.plane(1), other.plane(1))
