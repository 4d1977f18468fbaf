"""Inspection: every route writes the same report, and what has no effect is refused in each."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.psf import PSFMatrix, save
from lfcal.tasks import Inspect, RunSettings, command_of, load_job
from tests.cli import conftest
from tests.cli._building import alike
from tests.judge.plain_report import undrawn
from tests.tasks.routes import Lfcal, go_every_route

lfcal = conftest.lfcal


@pytest.fixture
def H(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write an H of two planes of noisy spots."""
    undrawn(monkeypatch)
    rows, columns = np.mgrid[:15, :15] - 7.0
    spot = 100 * np.exp(-0.5 * (rows**2 + columns**2) / 2.5**2)
    path = tmp_path / "H.h5"
    save(PSFMatrix(spot + np.random.default_rng(5).random((2, 3, 3, 15, 15))), path)
    return path


def measured(folder: Path) -> Any:
    """Return all numbers of a report, without the time at which it was made."""
    return {**json.loads((folder / "quality.json").read_text()), "inspected": ""}


def test_every_route_writes_the_same_report(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    task = Inspect(source=H, report=tmp_path / "report", reference=H, seconds=0, every=True)
    first, *others = go_every_route(lfcal, task, tmp_path / "report")
    for path in others:
        assert alike(measured(path), measured(first)), path.name
    assert len(measured(first)["metrics"]) > 5, "all are listed"


def test_a_copied_command_names_what_differs_from_the_defaults(H: Path) -> None:
    task = Inspect(source=H, seconds=600, every=True, strict=True)
    assert command_of(task) == f"lfcal inspect {shlex.quote(str(H))} --seconds=600 --all --strict"


def test_what_has_no_effect_is_refused_in_every_route(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    cases: tuple[tuple[dict[str, Any], str], ...] = (
        ({"patterns": 30, "seconds": 0}, "expected {}seconds above 0, got 0"),
        ({"fit": "fit", "seconds": 0}, "expected {}seconds above 0, got 0"),
        ({"mat_order": "rows-first"}, "expected a .mat file, got H.h5"),
        ({"patterns": 0}, "expected a whole number ≥ 1, got 0"),
        ({"seconds": -1.0}, "expected a number ≥ 0, got -1"),
    )
    for more, message in cases:
        name = next(iter(more))
        said = re.escape(f"{name}: {message.format('')}")
        with pytest.raises(InputError, match=said):
            Inspect(source=H, **more)
        words = [f"--{key.replace('_', '-')}={value}" for key, value in more.items()]
        lfcal("inspect", H, *words).refused(f"--{name.replace('_', '-')}: {message.format('--')}")
        lines = [f"{key} = {json.dumps(value)}" for key, value in {"task": "inspect", "source": str(H), **more}.items()]
        (tmp_path / "job.toml").write_text("\n".join(lines))
        with pytest.raises(InputError, match=said):
            load_job(tmp_path / "job.toml")
    with pytest.raises(InputError, match="--resume: expected --report, got none"):
        Inspect(source=H).run(RunSettings(resume=True))


def test_strict_fails_in_a_job_too(lfcal: Lfcal, H: Path, tmp_path: Path) -> None:
    (made,) = Inspect(source=H, seconds=0, strict=True).run()
    assert made.failed and not Inspect(source=H, seconds=0).run()[0].failed
    (tmp_path / "job.toml").write_text('task = "inspect"\nsource = "H.h5"\nseconds = 0\nstrict = true\n')
    done = lfcal("run", tmp_path / "job.toml", "--json")
    assert done.code == 1 and done.json["merit"] == made.found.merit
