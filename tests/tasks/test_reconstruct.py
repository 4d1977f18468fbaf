"""One record of a reconstruction: every route gives the same bits, and a solver has the fields that it uses."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base import InputError
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import (
    METHODS,
    SOLVERS,
    LightFieldSettings,
    ProjectionSettings,
    RlTvSolver,
    Solver,
    VoxelGrid,
    load_volume,
)
from lfcal.reconstruct.solvers import GOALS, STOPS
from lfcal.records import OWN_SOLVERS, SOLVER_ENDS, rows
from lfcal.tasks import (
    Reconstruct,
    ReconstructBars,
    ReconstructFeatures,
    ReconstructForecast,
    ReconstructSeries,
    command_of,
    job_of,
    load_job,
    python_of,
    solver_settings,
    task_set,
)
from tests.cli import conftest
from tests.cli.conftest import Lfcal
from tests.reconstruct.oracles import lenslet_psf
from tests.tasks.routes import go_every_route

lfcal = conftest.lfcal


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Write H, a frame, and a stack of three."""
    H = PSFMatrix(lenslet_psf(2, 5, 15).astype(np.float32), anchor=(1.0, 2.0), depths=(-5.0, 5.0))
    save(H, tmp_path / "H.h5")
    frames = np.random.default_rng(0).poisson(50.0, (3, 30, 31)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frame.tif", frames[0])
    tifffile.imwrite(tmp_path / "stack.tif", frames, photometric="minisblack")
    tifffile.imwrite(tmp_path / "dark.tif", np.full((30, 31), 2, np.uint16))
    return tmp_path


def one(place: Path) -> Reconstruct:
    return Reconstruct(
        psf=place / "H.h5",
        frames=place / "frame.tif",
        out=place / "v.h5",
        solver=RlTvSolver(iterations=4, strength=0.01, background=1.5),
        light_field=LightFieldSettings(dark=place / "dark.tif"),
        grid=VoxelGrid(margin=2, anchor=(3.0, 1.5)),
        projection=ProjectionSettings(threshold=0.01, double=True),
    )


def series(place: Path) -> ReconstructSeries:
    return ReconstructSeries(
        psf=place / "H.h5",
        frames=place / "stack.tif",
        out=place / "v.npy",
        solver=solver_settings("osem", iterations=2, subsets=2),
        warm=True,
    )


@pytest.mark.parametrize("make", [one, series])
def test_every_route_gives_the_same_bits(lfcal: Lfcal, place: Path, make: Callable[[Path], Reconstruct]) -> None:
    task = make(place)
    first, *routes = go_every_route(lfcal, task, Path(task.out))
    assert load_job(place / "job.toml")[0].to_dict(outputs=False) == task.to_dict(outputs=False)
    words = shlex.split(command_of(task).replace(str(first), str(place / f"units{first.suffix}")))[1:]
    lfcal(*words, "--executor", "threads").ok()
    read = load_volume if first.suffix == ".h5" else np.load
    for path in (*routes, place / f"units{first.suffix}"):
        np.testing.assert_array_equal(read(path), read(first), err_msg=path.name)


def test_a_volume_keeps_its_task_and_is_made_again(lfcal: Lfcal, place: Path) -> None:
    task = one(place)
    task.run()
    with h5py.File(task.out) as file:
        said = json.loads(str(file.attrs["details"]))["task"]
    assert said == json.loads(json.dumps(task.to_dict(absolute=True, outputs=False)))
    assert said["solver"]["strength"] == 0.01 and "subsets" not in said["solver"] and "out" not in said
    lfcal("run", task.out, "-o", place / "again.h5").ok()
    np.testing.assert_array_equal(load_volume(place / "again.h5"), load_volume(task.out))


def test_options_that_do_not_apply_are_refused(lfcal: Lfcal, place: Path) -> None:
    kinds = "a frame with error bars or a frame with beads or lines, got a forecast; leave --out out"
    for options, said in (
        ("--strength 0.1", "--strength: expected --solver rl-tv or rl-tikhonov, got sieve; leave --strength out"),
        ("--solver isra --read-noise 0", "got isra; leave --read-noise out"),
        ("--solver rl --subsets 2", "--subsets: expected --solver sieve, osem or phase-space, got rl"),
        ("--solver list", "choose a name that lfcal solvers lists"),
        ("--solver magic", "solver: expected rl, "),
        ("--goal measure", "--goal: expected --iterations auto, got 15"),
        ("--warm", "--warm: expected a series of frames or a forecast, got one frame"),
        ("--format .h5", "--format: expected a series of frames, got one frame"),
        ("--forecast", kinds),
    ):
        words = (place / "H.h5", place / "frame.tif", "-o", place / "v.h5", *options.split())
        lfcal("reconstruct", *words).refused(said)
        assert not (place / "v.h5").exists(), options


def test_a_record_has_the_options_that_its_solver_uses(place: Path) -> None:
    """A new solver, or a new option of one, needs its record, or field."""
    every = {"background", "read_noise", "saturation", "strength", "subsets", "tolerance"}
    for solver in SOLVERS:
        found = {row.name for row in rows(SOLVER[solver.name])}
        assert found == {"name", "iterations", "goal", "gain"} | (every & solver.honours), solver.name
    assert SOLVER["sieve"] is OWN_SOLVERS[0] and tuple(SOLVER_ENDS.values()) == STOPS
    fields = {row.name: row for row in rows(Reconstruct)}
    assert fields["goal"].choices == GOALS and {"auto", *METHODS} <= set(fields["method"].offered)
    # fields of another solver are refused in a job and in Python
    (place / "job.toml").write_text(job_of(one(place)).replace('name = "rl-tv"', 'name = "rl"'))
    with pytest.raises(InputError, match=r"solver.strength: expected solver.name rl-tv or rl-tikhonov, got rl"):
        load_job(place / "job.toml")
    with pytest.raises(InputError, match=r"solver rl: expected only the settings iterations, goal.*, got strength"):
        solver_settings("rl", strength=0.1)
    with pytest.raises(TypeError):
        SOLVER["rl"](strength=0.1)
    with pytest.raises(InputError, match=r"name: expected 'rl', got 'rl-tv'"):
        SOLVER["rl"](name="rl-tv")


SOLVER: dict[str, Any] = {str(kind().name): kind for kind in OWN_SOLVERS}


def test_a_solver_of_another_distribution_has_the_fields_of_its_options(
    lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rl = SOLVERS.get("rl")
    theirs = Solver("theirs", "of theirs", rl.iterate, honours=frozenset({"background", "weights", "strength"}))
    known = {**{solver.name: solver for solver in SOLVERS}, "theirs": theirs}
    monkeypatch.setattr(SOLVERS, "_parts", known)
    task = Reconstruct(
        psf=place / "H.h5",
        frames=place / "frame.tif",
        out=place / "a.npy",
        solver=solver_settings("theirs", iterations=2, background=2.0),
    )
    assert [row.name for row in rows(type(task.solver))][4:] == ["background", "strength"]
    task.run()
    assert "solver=solver_settings(\n        'theirs',\n" in python_of(task)
    exec(python_of(task).replace("a.npy", "b.npy"), {})
    lfcal(*shlex.split(command_of(task).replace("a.npy", "c.npy"))[1:]).ok()
    (place / "job.toml").write_text(job_of(task).replace("a.npy", "d.npy"))
    lfcal("run", place / "job.toml").ok()
    for name in "bcd":
        np.testing.assert_array_equal(np.load(place / f"{name}.npy"), np.load(place / "a.npy"))
    with pytest.raises(InputError, match=r"solver theirs: expected only the settings .*, got subsets"):
        solver_settings("theirs", subsets=2)
    words = ("reconstruct", place / "H.h5", place / "frame.tif", "-o", place / "e.npy", "--solver", "theirs")
    lfcal(*words, "--tolerance", 0.1).refused("--tolerance: expected --solver sieve, rl, ", "got theirs")


def test_kinds_are_distinguished_by_the_input(place: Path) -> None:
    tasks = task_set("reconstruct")
    assert tasks.kinds == (Reconstruct, ReconstructSeries, ReconstructBars, ReconstructFeatures, ReconstructForecast)
    (place / "folder").mkdir()
    known = {"frame.tif": Reconstruct, "stack.tif": ReconstructSeries, "folder": ReconstructSeries}
    for name, kind in known.items():
        assert tasks.choose({"frames": place / name}) is kind
    assert tasks.choose({"frames": place / "frame.tif", "forecast": True}) is ReconstructForecast
    assert tasks.choose({"frames": place / "frame.tif", "bars": True}) is ReconstructBars
    assert tasks.choose({"frames": place / "frame.tif", "features": "auto"}) is ReconstructFeatures
    forecast = ReconstructForecast(psf=place / "H.h5", frames=place / "stack.tif")
    assert "--forecast" in command_of(forecast) and len(forecast.run()[0].run.frames) == 3
    with pytest.raises(InputError, match=r"grid.voxel: expected its default, got 'auto'"):
        ReconstructForecast(psf="H.h5", frames="f.tif", grid=VoxelGrid(voxel="auto"))
