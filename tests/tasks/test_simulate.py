"""One record per simulation: command, Python, job file and an H file made again give the same bits."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import RegionPlan, ScanPlan, preset
from lfcal.psf import open_psf, simulated_planes
from lfcal.records import rows
from lfcal.tasks import (
    SimulateForecast,
    SimulateFrames,
    SimulateH,
    SimulatePasses,
    SimulateRegions,
    command_of,
    job_of,
    load_job,
    task_set,
)
from lfcal.tasks.task import RunSettings, Task
from lfcal.work import parts_folder
from tests.cli import conftest
from tests.cli.conftest import Lfcal
from tests.tasks.routes import check_every_route, go_every_route

lfcal = conftest.lfcal

KINDS = (SimulateH, SimulatePasses, SimulateRegions, SimulateFrames, SimulateForecast)
EFFECTS = ("coma=0.3@40deg", "bandwidth=off")


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(90, 100)))
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=41), period=(2, 3))
    path = tmp_path / "plan.json"
    path.write_text(plan.to_json())
    (tmp_path / "regions.json").write_text(RegionPlan.spread(replace(plan, period=(1, 2)), (1, 2)).to_json())
    (tmp_path / "effects.json").write_text('[{"name": "spherical", "waves": 0.4}]')
    return path


def made_by(kind: type[Task], plan: Path, out: Path) -> Task:
    """Return a task of a kind that takes little time."""
    given: dict[str, Any] = {
        "camera": str(plan),
        "tolerance": 0.1,
        "effects": (*EFFECTS, str(plan.parent / "effects.json")),
    }
    if kind is SimulateRegions:
        given["camera"] = str(plan.parent / "regions.json")
    if kind is SimulateH:
        given["store_tolerance"] = 0.005
    if kind is SimulateFrames:
        return kind(**given, frames=out, seed=3, peak=0.5)
    return kind(**given, out=out)


def values(out: Path) -> dict[str, np.ndarray]:
    """Return everything that was measured in the H file or the folder of frames ``out``."""
    if out.is_dir():
        return {
            str(p.relative_to(out)): np.fromfile(p, np.uint8) for p in out.rglob("*") if p.suffix not in ("", ".json")
        }
    found: dict[str, h5py.Dataset] = {}
    with h5py.File(out) as file:
        file.visititems(lambda name, one: found.update({name: one}) if isinstance(one, h5py.Dataset) else None)
        return {name: one[()] for name, one in found.items() if one.dtype.kind in "iuf"}


def test_every_route_makes_the_same_task(
    lfcal: Lfcal, plan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in (SimulatePasses, SimulateRegions):
        check_every_route(lfcal, monkeypatch, made_by(kind, plan, tmp_path / "made.h5"), tmp_path)


@pytest.mark.parametrize(
    "kind", [SimulateH, SimulateFrames, *(pytest.param(k, marks=pytest.mark.long) for k in KINDS[1:3])]
)
def test_every_route_gives_the_same_bits(lfcal: Lfcal, kind: type[Task], plan: Path, tmp_path: Path) -> None:
    out = tmp_path / ("made" if kind is SimulateFrames else "made.h5")
    first, *routes = go_every_route(lfcal, made_by(kind, plan, out), out)
    if out.suffix:
        routes.append(tmp_path / "again.h5")
        lfcal("run", first, "-o", routes[-1]).ok()
    assert values(first)
    for path in routes:
        same(values(path), values(first), path.name)


def same(one: dict[str, np.ndarray], two: dict[str, np.ndarray], name: str = "") -> None:
    assert one.keys() == two.keys()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=f"{name}: {key}")


@pytest.mark.long
def test_passes_in_units_of_processes_give_the_same_bits(plan: Path, tmp_path: Path) -> None:
    for name, run in (("here.h5", RunSettings()), ("there.h5", RunSettings(executor="processes", workers=2))):
        made_by(SimulatePasses, plan, tmp_path / name).run(run)[0].close()
    same(values(tmp_path / "here.h5"), values(tmp_path / "there.h5"))


@pytest.mark.long
def test_passes_that_were_stopped_are_resumed(lfcal: Lfcal, plan: Path, tmp_path: Path) -> None:
    task = made_by(SimulatePasses, plan, tmp_path / "H.h5")
    made_by(SimulatePasses, plan, tmp_path / "whole.h5").run()[0].close()
    work = task.work(RunSettings(executor="threads"))
    while "pass 2 of 3" not in next(work).stage:
        pass
    work.close()
    words = shlex.split(command_of(task))[1:]
    assert "--force" in lfcal(*words).refused().err and (tmp_path / "H.h5").exists()
    done = lfcal(*words, "--resume").ok()
    assert "complete with errors" in done.err
    assert done.err.count("; you can stop now") == 2, "the first pass is not made again"
    np.testing.assert_array_equal(values(tmp_path / "H.h5")["H"], values(tmp_path / "whole.h5")["H"])


def test_frames_keep_their_task_and_h_states_how_magnitudes_are_known(plan: Path, tmp_path: Path) -> None:
    task = made_by(SimulateFrames, plan, tmp_path / "session")
    task.run()
    truth = json.loads((tmp_path / "session" / "truth.json").read_text())
    assert truth["task"] == task.to_dict(absolute=True, outputs=False) and truth["seed"] == 3
    words = ("coma=waves:0.3 measured,angle:40deg", "bandwidth=0.02 measured", "bandwidth=off")
    (made,) = SimulateH(camera=str(plan), effects=words, level="geometric", out=tmp_path / "H.h5").run()
    with made.matrix as matrix:
        assert matrix.provenance["effect_sources"] == {"coma": {"waves": "measured", "angle_rad": "stated"}}


@pytest.mark.long
@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_the_result_names_engine_sampling_time_and_error_of_every_plane(
    plan: Path, tmp_path: Path, executor: str
) -> None:
    """It said the wave level where the grid engine computed, and the H file said auto."""
    two = ScanPlan.from_json(plan.read_text())
    camera = two.camera
    two = replace(two, depths_um=(camera.depth_of(3.0), camera.depth_of(4.0)), period=(1, 2), cutout=(31, 31))
    plan.write_text(two.to_json())
    task = SimulateH(camera=str(plan), tolerance=0.01, out=tmp_path / "H.h5")
    (made,) = task.run(RunSettings(executor=executor, workers=2))
    output = made.to_dict()
    made.close()
    assert output["level"] == "grid" and len(output["planes"]) == 2
    for plane, error in zip(output["planes"], output["error"], strict=True):
        assert plane["engine"] == "grid" and plane["sampling"]["samples_per_px"] >= 4
        assert plane["grid_side"] > two.cutout[0], "the grid contains the cutout"
        assert 0 < plane["processor_seconds"] and plane["seconds"] > 0 and plane["error"] == pytest.approx(error)
    with open_psf(tmp_path / "H.h5") as matrix:
        simulated = matrix.provenance["simulated"]
        assert (simulated["level"], simulated["requested_level"]) == ("grid", "auto")
        assert simulated["planes"] == list(output["planes"])
    (line,) = [words for words in made.reached if "grid" in words]
    per = f"{output['planes'][0]['sampling']['samples_per_px']:g} samples per pixel"
    assert line.startswith(f"planes 0 to 1: grid, {per}, ") and "of processor time; error at most" in line


def test_what_a_plane_took_is_kept_where_a_run_resumes(plan: Path, tmp_path: Path) -> None:
    two = ScanPlan.from_json(plan.read_text())
    camera = two.camera
    plan.write_text(replace(two, depths_um=(camera.depth_of(3.0), camera.depth_of(4.0)), period=(1, 2)).to_json())
    task = SimulateH(camera=str(plan), tolerance=0.1, out=tmp_path / "H.h5")
    work = task.work(RunSettings(executor="threads", workers=1))
    while not next(work).note.startswith("1 of"):
        pass
    work.close()
    with open_psf(next(parts_folder(task.out).glob("*.h5"))) as part:
        (first,) = part.provenance["simulated"]["planes"]
    (made,) = task.run(RunSettings(executor="threads", workers=1, resume=True))
    with made.matrix as matrix:
        planes = simulated_planes(matrix.provenance, 2)
    assert first in planes and all(one is not None and one["processor_seconds"] > 0 for one in planes)


def test_a_job_keeps_every_value(plan: Path, tmp_path: Path) -> None:
    for kind in KINDS:
        task = made_by(kind, plan, tmp_path / "made")
        (tmp_path / "job.toml").write_text(job_of(task))
        assert load_job(tmp_path / "job.toml")[0] == task
        said = (tmp_path / "job.toml").read_text()
        for row in rows(kind):
            assert f"{row.name} = " in said or row.default is None, "defaults are kept, too"
        (tmp_path / "job.json").write_text(json.dumps(task.to_dict()))
        assert load_job(tmp_path / "job.json")[0] == task


def test_a_field_of_another_kind_is_refused_in_python() -> None:
    assert task_set("simulate").kinds == KINDS
    for kind in KINDS:
        for name in {row.name for one in KINDS for row in rows(one)} - {row.name for row in rows(kind)}:
            with pytest.raises(TypeError, match=name):
                kind(camera="bench", **{name: 1})


def test_a_wrong_job_ends_in_one_sentence(plan: Path, tmp_path: Path) -> None:
    for text, words in (
        ('out = "H.h5"\nseed = 1', "seed: expected frames, got H in one pass"),
        ('frames = "f"\nprogressive = true', "progressive: expected H in passes, got frames"),
        ('out = "H.h5"\nplan_only = true\nseed = 1', "seed: expected frames, got a forecast"),
        ('out = "H.h5"\ntolerance = 5', "tolerance: expected a number > 0 and ≤ 4, got 5"),
        ('out = "H.h5"\nlevel = "waves"', "level: expected auto, geometric, "),
        ('out = "H.h5"\neffects = ["coma"]', "effects: expected NAME=on, off, auto or a magnitude"),
        ('out = "H.h5"\ndepths = "1 kg"', "depths: expected numbers"),
        ('out = "H.h5"\ndepths = [1, "a"]', "depths: expected numbers, in µm or with mm, got 'a'"),
        ('out = "H.h5"\ncutout = [41.5, 31]', "cutout: expected whole numbers of pixels"),
        ('out = "H.h5"\ncutout = [41, 31, 21]', "cutout: expected one number or two"),
        ("plan_only = true\npeak = 0.5", "peak: expected frames, got none"),
    ):
        (tmp_path / "job.toml").write_text(f'task = "simulate"\ncamera = "{plan}"\n{text}\n')
        with pytest.raises(InputError) as error:
            load_job(tmp_path / "job.toml")
        assert words in str(error.value) and "\n" not in str(error.value), text


def test_texts_of_planes_cutouts_and_paths_of_effects(tmp_path: Path) -> None:
    job, begun = tmp_path / "job.toml", 'task = "simulate"\ncamera = "bench"\nout = "H.h5"\n'
    job.write_text(f'{begun}virtual_depths = "3:4:0.5"\ncutout = "41x31"\ntolerance = "3%"\nprogressive = false\n')
    task, _ = load_job(job)
    out = tmp_path / "H.h5"
    assert task == SimulateH(camera="bench", virtual_depths=(3.0, 3.5, 4.0), cutout=(41, 31), out=out)
    assert task.files("in") == (), "a preset is not a file"
    assert task.to_dict(absolute=True)["camera"] == "bench"
    job.write_text(f'{begun}depths = 0\neffects = ["coma=0.3", "fit/effects.json"]\n')
    task, _ = load_job(job)
    assert task.files("in") == (tmp_path / "fit" / "effects.json",)
    assert task.to_dict(absolute=True)["effects"] == ["coma=0.3", str(tmp_path / "fit" / "effects.json")]


def test_kinds_that_do_not_fit_are_refused(lfcal: Lfcal, plan: Path) -> None:
    with pytest.raises(InputError, match="progressive: expected true, got false"):
        SimulatePasses(camera="bench", out="H.h5", progressive=False)
    assert command_of(SimulateForecast(camera="bench", depths=(0,))) == "lfcal simulate bench --depths=0 --plan-only"
    with pytest.raises(InputError, match="plan: expected a plan of several regions"):
        SimulateRegions(camera=str(plan), out="H.h5").run()
    lfcal("simulate", "bench", "--effects", "coma=on", "--plan-only").refused("Did you mean --effect?")
