"""``lfcal acquire --until-error``: a session that ends when H is as good as wanted, and goes on after an end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import InputError
from lfcal.campaign import Goal
from lfcal.fit.setup import described_effects
from lfcal.simulate.effects.described import Entry, entries_json
from lfcal.tasks import AcquireUntil
from tests.cli.conftest import Run
from tests.fit.common import small_plan

Lfcal = Callable[..., Run]
SIMULATED = ("--option", "optics=grid", "--option", "effects=effects.json", "--no-check-stage")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    plan = replace(small_plan(15, (2.2,)), period=(6, 8))
    (tmp_path / "plan.json").write_text(plan.to_json())
    entries = [Entry(one, one.name, {}, "on") for one in described_effects(plan.camera)]
    (tmp_path / "effects.json").write_text(entries_json(entries))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def until(lfcal: Lfcal, *more: str) -> Run:
    return lfcal("acquire", "plan.json", "-o", "s", "--unknowns", "geometry", "--workers", "1", *SIMULATED, *more)


@pytest.mark.long
def test_a_session_ends_by_the_error_of_h(lfcal: Lfcal, place: Path) -> None:
    run = until(lfcal, "--until-error", "0.3%")
    assert run.code == 0, run.err
    assert "the target error of H is reached" in run.out and "lfcal fit s -o fit/" in run.out
    assert "12 positions: expected error of H 0." in run.err
    session = SessionFile.read(place / "s")
    assert len(session.redo[0]) == 12 and session.kept_aside
    assert lfcal("verify", "s").code == 0


@pytest.mark.long
def test_a_session_goes_on_to_a_smaller_error_within_some_positions(lfcal: Lfcal, place: Path) -> None:
    assert until(lfcal, "--until-error", "0.3%").code == 0
    more = until(lfcal, "--resume", "--until-error", "0.0007", "--most", "18", "--json")
    assert more.code == 0 and isinstance(more.json, dict), more.err
    assert more.json["ended"] == "used up" and more.json["steps"][-1]["positions"] == 18
    errors = [step["expected_error"] for step in more.json["steps"]]
    assert errors[-1] < errors[0] < 0.003 and more.json["outcome"]["acknowledged"] == 18
    assert lfcal("verify", "s").code == 0


def test_a_dry_run_says_at_most(lfcal: Lfcal, place: Path) -> None:
    run = until(lfcal, "--until-error", "1%", "--most", "30", "--dry-run", "--json")
    assert run.code == 0 and isinstance(run.json, dict) and run.json["positions"] == 30
    assert "the forecast is for the largest number of positions" in run.err and not (place / "s").exists()


def test_goals_by_their_words() -> None:
    def goal_of(**given: Any) -> Goal:
        return AcquireUntil(plan="plan.json", out="s", **given).goal

    goal = goal_of(until_error="0.5%")
    assert goal.error == pytest.approx(0.005) and goal.most is None and goal.unknowns == "auto"
    named = goal_of(until_error="0.02", most=50, unknowns="iris,geometry,iris")
    assert named == replace(goal, error=0.02, most=50, unknowns=("iris", "geometry"))
    assert goal_of(until_error=0.01, unknowns="auto").unknowns == "auto"
    with pytest.raises(InputError, match="until_error: expected a number, or percent, got 'half'"):
        goal_of(until_error="half")


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("--until-error 0", "target error of H"),
        ("--until-error 200%", "target error of H"),
        ("--until-error 0.01%", "the simulation of patterns itself has an error of 0.06 %"),
        ("--until-error 1% --most 3", "largest number of positions"),
        ("--until-error 1% --unknowns gap", "--unknowns: expected auto, geometry, "),
        ("--until-error 1% --redo list.json", "got a scan until H is good enough (--until-error); leave --redo out"),
        (
            "--until-error 1% --positions list.json",
            "got a scan until H is good enough (--until-error); leave --positions out",
        ),
        ("--most 20", "--most: expected a scan until H is good enough (--until-error), got a scan of one region"),
        ("--unknowns iris", "--unknowns: expected a scan until H is good enough (--until-error)"),
        ("--until-error 1% --resume", "expected a session folder"),
        ("--until-error 1% --bracket 1,0.5", "single exposures, whose noise is known"),
    ],
)
def test_what_is_refused(lfcal: Lfcal, place: Path, words: str, what: str) -> None:
    run = lfcal("acquire", "plan.json", "-o", "s", "--no-check-stage", *words.split())
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    assert not (place / "s" / "session.json").exists()
