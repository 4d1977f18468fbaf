"""Options of ``lfcal acquire`` that the recorded session keeps, or that decide how it is recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.options import Options
from lfcal.acquire.session_file import SessionFile
from lfcal.camera import Marks
from tests.acquire.rigs import frames_of, small_plan
from tests.cli.conftest import Run

Acquire = Callable[..., Run]

PLAN = small_plan((2, 3), 2)


@pytest.fixture
def acquire(lfcal: Callable[..., Run], tmp_path: Path) -> Acquire:
    """Record six positions in two planes by the simulator, without darks and references."""
    (tmp_path / "plan.json").write_text(PLAN.to_json())

    def record(*options: object, out: str = "s") -> Run:
        alone = ("--darks", 0, "--reference-every", 0, "--no-check-stage")
        return lfcal("acquire", tmp_path / "plan.json", "--out", tmp_path / out, *alone, *options)

    return record


@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        (("--overshoot", "0,0,5"), "overshoot_um", (0.0, 0.0, 5.0)),
        (("--tolerance", "3,3,9"), "tolerance_um", (3.0, 3.0, 9.0)),
        (("--retries", 4), "retries", 4),
        (("--no-check-origin",), "origin_tolerance_px", None),
        (("--order", "coarse"), "order", "coarse"),
        (("--bracket", "1,0.25"), "bracket", (1.0, 0.25)),
        (("--margin", 3), "margin_px", 3),
        (("--suspend", "temperature=20:22", "--suspend", "lamp=90:"), "suspend", ("temperature=20:22", "lamp=90:")),
        (("--suspend", "temperature=20:22", "--steady", 2), "steady_s", 2.0),
    ],
)
def test_the_session_keeps_how_it_is_recorded(
    acquire: Acquire, tmp_path: Path, options: tuple[object, ...], name: str, value: object
) -> None:
    done = acquire(*options)
    assert done.code == 0, done.err
    kept = SessionFile.read(tmp_path / "s").options
    assert getattr(kept, name) == value != getattr(Options(), name)
    assert len(frames_of(tmp_path / "s")) == PLAN.n_positions


def test_what_is_assumed_of_the_camera_is_said_once(acquire: Acquire, tmp_path: Path) -> None:
    guessed = replace(PLAN, camera=replace(PLAN.camera, marks=Marks.of({"lattice.gap_um": "assumed"})))
    (tmp_path / "plan.json").write_text(guessed.to_json())
    done = acquire("--assemble", tmp_path / "H.h5", "--option", "optics=pattern")
    assert done.code == 0 and done.err.count("assumed values of the camera") == 1, done.err


def test_retries_decide_whether_a_fault_ends_the_session(acquire: Acquire, tmp_path: Path) -> None:
    fault = ("--option", "faults=times out@2*1")
    stopped = acquire(*fault, "--retries", 0)
    assert stopped.code == 2 and "positions are safe" in stopped.err
    assert acquire(*fault, "--retries", 1, out="t").code == 0
    assert len(frames_of(tmp_path / "t")) == PLAN.n_positions


def test_frames_of_one_backend_and_the_stage_of_another(acquire: Acquire, tmp_path: Path) -> None:
    (tmp_path / "watched").mkdir()
    camera = ("--backend", "folder", "--option", f"path={tmp_path / 'watched'}", "--dry-run", "--json")
    found: Any = acquire(*camera, "--stage", "sim").json
    assert "sim" in found["stage"] and "sim" not in found["camera"]
    assert found["positions"] == PLAN.n_positions
    refused = acquire("--stage", "aravis")
    assert refused.code == 2 and "a backend with a stage" in refused.err


def test_resume_compares_the_last_position_unless_told_not_to(acquire: Acquire, tmp_path: Path) -> None:
    """A stage that goes elsewhere than in the run before is found out, or accepted with --no-check-origin."""
    stopped = acquire("--option", "faults=times out@6*9")
    assert stopped.code == 2 and "positions are safe" in stopped.err
    moved = ("--resume", "--option", "axes=-x,+y,+z")
    refused = acquire(*moved)
    assert refused.code == 2 and "last recorded position" in refused.err
    accepted = acquire(*moved, "--no-check-origin")
    assert accepted.code == 0, accepted.err
    assert all(np.asarray(frame).any() for frame in frames_of(tmp_path / "s").values())
