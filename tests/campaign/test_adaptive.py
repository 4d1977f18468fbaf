"""Adaptive sessions of the simulated camera: they end by the error of H, resume after a crash, and state why."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.options import Options
from lfcal.acquire.recording._verify import verify
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, drain
from lfcal.camera import ScanPlan
from lfcal.campaign import Adapted, AdaptiveStep, Goal, adaptive, iter_adaptive
from lfcal.campaign.adaptive import FEWEST, _gained_nothing, iter_session_patterns
from lfcal.devices.registry import open_rig
from lfcal.devices.rig import Rig
from lfcal.fit.design import CurvePoint, PositionDesign
from lfcal.fit.model_error import ModelError
from lfcal.fit.nuisance import Spread
from lfcal.fit.setup import described_effects
from lfcal.frames.source import Position
from lfcal.simulate.effects.described import Entry, entries_json
from tests.acquire.rigs import frames_of, rig_for
from tests.fit.common import small_plan

PLAN = replace(small_plan(15, (2.2,)), period=(10, 21))
GOAL = Goal(0.0027, first=6, unknowns=("geometry",), candidates=20)
OPTIONS = Options(darks=2, keep_free_bytes=0, retries=0)
GAP = 1.01
"""True gap over the described one."""


@contextmanager
def rig(place: Path, **more: str) -> Iterator[Rig]:
    """Give the rig of a camera whose gap is not as described."""
    camera, effects = PLAN.camera, place / "effects.json"
    place.mkdir(exist_ok=True)
    effects.write_text(entries_json(Entry(one, one.name, {}, "on") for one in described_effects(camera)))
    true = replace(camera, lattice=replace(camera.lattice, gap_um=GAP * camera.lattice.gap_um))
    with open_rig(replace(PLAN, camera=true), "sim", {"optics": "grid", "effects": str(effects), **more}) as found:
        yield found


def adapted(place: Path, goal: Goal = GOAL, *, resume: bool = False, faults: str = "", **more: Any) -> Adapted:
    options = None if resume else OPTIONS
    with rig(place, faults=faults) as own:
        return drain(iter_adaptive(place / "s", PLAN, own, goal, options, resume=resume, workers=1, **more))


class Whole(NamedTuple):
    """A session from its beginning to its end: folder, result, and the steps and notes shown on the way."""

    place: Path
    found: Adapted
    seen: list[AdaptiveStep]
    notes: list[str]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    place, seen, shown = tmp_path_factory.mktemp("whole"), list[AdaptiveStep](), list[Progress]()
    with rig(place) as own:
        work = iter_adaptive(place / "s", PLAN, own, GOAL, OPTIONS, workers=1, seen=seen.append)
        found = drain(work, shown.append)
    return Whole(place, found, seen, [one.note for one in shown if one.stage == "error of H"])


@pytest.mark.long
def test_a_session_ends_when_h_reaches_its_error(whole: Whole) -> None:
    place, found, seen, notes = whole
    assert found.how == "reached" and found.outcome.how == "complete" and tuple(seen) == found.steps
    assert len(seen) > 1 and seen[0].positions == 6 and seen[-1].positions == found.outcome.acknowledged < 40
    assert seen[0].expected_error > GOAL.error >= seen[-1].expected_error
    assert "positions: expected error of H 0." in str(seen[-1])
    assert seen[-1].complete and seen[-1].groups == ("geometry",)
    assert notes == [str(step) for step in seen] and notes[0].startswith("6 positions: expected error of H")
    fit = found.fit
    assert fit is not None and fit.camera.lattice.gap_um == pytest.approx(GAP * PLAN.camera.lattice.gap_um, rel=2e-3)
    # everything is in the session: some kept aside in each part, never fitted
    session = SessionFile.read(place / "s")
    assert len(session.recordings) == len(seen) and verify(place / "s").ok
    measured = drain(iter_session_patterns(place / "s"))
    assert len(measured) == seen[-1].positions and measured.held_out.sum() == len(session.kept_aside) >= len(seen)
    aside = {tuple(p) for p in measured.index[measured.held_out].tolist()}
    assert aside == set(session.kept_aside) and fit.held_out_error.patterns == len(aside)


def test_a_session_ends_when_no_position_is_left(tmp_path: Path) -> None:
    seen, options = list[AdaptiveStep](), replace(OPTIONS, check_stage=False, reference_every=0)
    goal = replace(GOAL, error=1e-3, most=6)
    with rig(tmp_path) as own:
        work = iter_adaptive(tmp_path / "s", PLAN, own, goal, options, workers=1, seen=seen.append)
        found = drain(work)
    assert found.how == "used up" and found.outcome.how == "complete" and found.outcome.acknowledged == 6
    assert tuple(seen) == found.steps and [step.positions for step in seen] == [6] and found.fit is not None
    session = SessionFile.read(tmp_path / "s")
    assert len(session.recordings) == 1 and verify(tmp_path / "s").ok
    measured = drain(iter_session_patterns(tmp_path / "s"))
    assert len(measured) == 6
    assert set(map(tuple, measured.index[measured.held_out].tolist())) == set(session.kept_aside)


@pytest.mark.long
def test_after_a_crash_it_resumes_from_the_recorded_positions(tmp_path: Path) -> None:
    with pytest.raises(AcquisitionStopped):
        adapted(tmp_path, faults="times out@12*99")
    before, session = frames_of(tmp_path / "s"), SessionFile.read(tmp_path / "s")
    assert 6 <= len(before) and len(verify(tmp_path / "s").never_taken) > 0
    planned = {p for part in session.redo for p in part}
    found = adapted(tmp_path, resume=True)
    assert found.how == "reached" and planned <= set(map(tuple, frames_of(tmp_path / "s")))
    after = frames_of(tmp_path / "s")
    assert all(np.array_equal(after[p], before[p]) for p in before), "what was recorded stays"


@pytest.mark.long
def test_it_can_be_stopped_between_positions_and_during_fits(tmp_path: Path) -> None:
    control = Control()
    found = adapted(tmp_path, control=control, seen=lambda _: control.stop())
    assert found.how == "stopped" and found.outcome.how == "stopped" and len(found.steps) == 1
    assert found.outcome.acknowledged == 6 and len(frames_of(tmp_path / "s")) == 6
    early = Control()
    early.stop()
    none = adapted(tmp_path / "other", control=early)
    assert none.how == "stopped" and none.outcome.acknowledged == 0 and none.fit is None
    again = adapted(tmp_path, replace(GOAL, most=6), resume=True)
    assert again.how == "used up" and again.outcome.how == "complete" and len(again.steps) == 1


@pytest.mark.long
def test_an_incomplete_model_ends_it(whole: Whole) -> None:
    """Focal lengths are not among the unknowns: the gap alone does not explain the patterns."""
    found = adapted(whole.place, Goal(1e-3, first=6, unknowns=("iris",), candidates=40), resume=True)
    assert found.how == "incomplete" and not found.steps[-1].complete and "model incomplete" in str(found.steps[-1])
    assert len(found.steps) <= 3


def step_of(expected: float, squared: float, sigma: float, groups: tuple[str, ...] = ()) -> AdaptiveStep:
    return AdaptiveStep(9, expected, ModelError(squared, sigma, expected, 2), 1.0, True, groups, 0)


def test_further_patterns_gain_something_by_the_last_two_steps() -> None:
    for errors, groups, nothing in (
        ((0.2,), "a", False),
        ((0.2, 0.19), "aa", True),
        ((0.2, 0.1), "aa", False),
        ((0.2, 0.1, 0.03), "aaa", False),
        ((0.2, 0.03, 0.03), "aaa", True),
        ((0.2, 0.03, 0.03), "aab", False),
        ((0.2, 0.03, 0.03), "baa", True),
    ):
        steps = [step_of(0.1, e**2, 1e-9, (group,)) for e, group in zip(errors, groups, strict=True)]
        assert _gained_nothing(steps) is nothing, (errors, groups)
    # a change within its standard deviation is none
    assert _gained_nothing([step_of(0.1, 1e-2, 1e-4), step_of(0.1, 0.98e-2, 1e-4)])


def test_a_goal_is_reached_only_if_patterns_kept_aside_agree() -> None:
    assert step_of(0.004, 0.0, 1e-6).reaches(0.005) and not step_of(0.006, 0.0, 1e-6).reaches(0.005)
    assert not step_of(0.004, 0.01**2, 1e-6).reaches(0.005), "patterns kept aside differ"
    assert not replace(step_of(0.004, 0.0, 1e-6), complete=False).reaches(0.005)


def test_as_many_positions_are_added_as_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """No fewer than a step needs, and no more than are left of 40."""
    asked: list[int] = []

    def chosen(plan: ScanPlan, count: int, **_: object) -> Iterator[None]:
        asked.append(count)
        yield

    class Patterns(list[None]):
        patterns = np.ones((1, 2, 2))

    monkeypatch.setattr(adaptive, "iter_next_positions", chosen)
    monkeypatch.setattr(adaptive, "Earlier", SimpleNamespace(of=lambda fit: None))
    for there in (1, 12, 30):
        recorded = Patterns([None] * there)
        own = SimpleNamespace(_most=40, _recorded=lambda r=recorded: r, _plan=PLAN, _goal=GOAL, _workers=None)
        list(adaptive._Campaign.choice(own, SimpleNamespace(spread=Spread()), recorded))
    assert asked == [FEWEST, 12, 10]


def ideal_rig(plan: ScanPlan) -> Rig:
    """Return a rig with ideal optics: a fit refuses frames of the quick pattern."""
    return open_rig(plan, "sim", {"optics": "auto"})


def test_what_is_refused_before_anything_moves(tmp_path: Path) -> None:
    def refused(what: str, plan: ScanPlan, options: Options, **more: Any) -> None:
        with pytest.raises(InputError, match=what):
            drain(iter_adaptive(tmp_path / "s", plan, ideal_rig(plan), GOAL, options, **more))

    refused("single exposures, whose noise is known", PLAN, replace(OPTIONS, bracket=(1.0, 0.5)))
    assumed = replace(PLAN.camera, marks=PLAN.camera.marks.marked(["sensor.read_noise_e"], "assumed"))
    refused("noise of the camera: expected a stated or measured noise", replace(PLAN, camera=assumed), OPTIONS)
    refused(r"at most the 627 left|expected", replace(PLAN, period=(1, 2)), OPTIONS)
    assert not (tmp_path / "s").exists()
    small = replace(PLAN, period=(2, 2))
    record(tmp_path / "s", small, rig_for(small), OPTIONS)
    refused("a new folder, got a session", small, OPTIONS)
    refused("a session of chosen positions, got a scan of all", small, OPTIONS, resume=True)


def test_impossible_goals_are_refused() -> None:
    for values, what in (
        ({"error": 0.0}, "target error of H"),
        ({"error": 1.5}, "target error of H"),
        ({"error": 1e-4}, "itself has an error of 0.06 %"),
        ({"error": 0.01, "first": 3}, "before the first fit"),
        ({"error": 0.01, "most": 7}, "largest number of positions"),
    ):
        with pytest.raises(InputError, match=what):
            Goal(**values)


@pytest.mark.parametrize("black", [64.0, 0.0])
def test_patterns_without_darks_keep_an_unstated_level_and_need_a_known_noise(tmp_path: Path, black: float) -> None:
    """A stated level is subtracted; an unstated one is part of the background."""
    only = [Position(0, y, x) for y in (0, 9) for x in (0, 9, 20)]
    camera = replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, black_level=black))
    record(tmp_path / "s", replace(PLAN, camera=camera), ideal_rig(PLAN), replace(OPTIONS, darks=0), only=only)
    measured = drain(iter_session_patterns(tmp_path / "s"))
    assert len(measured) == 6 and (measured.noise[:, 0] > 0).all()
    assert measured.patterns.min() == pytest.approx(64.0 - black, abs=6.0)
    if black:
        record(tmp_path / "t", PLAN, rig_for(PLAN), replace(OPTIONS, bracket=(1.0, 0.5)), only=only)
        with pytest.raises(InputError, match="noise of the frames: expected a known variance, got none"):
            drain(iter_session_patterns(tmp_path / "t"))


def test_no_more_positions_are_recorded_than_the_goal_is_expected_to_need() -> None:
    """Of 40 that were chosen; a fifth of them are kept aside."""
    index = np.stack([np.zeros(40, int), np.arange(40) // 8, np.arange(40) % 8], 1)
    curve = tuple(CurvePoint(n, error, error, 0.0) for n, error in ((8, 0.008), (20, 0.004), (40, 0.001)))
    design = PositionDesign(index[:32], index[32:], curve, 0.01, 0.02, {}, 40)
    for goal, recorded in ((0.01, 8), (0.004, 20), (0.0008, 40)):
        asked: dict[str, list[Position]] = {}

        def record_them(asked: dict[str, list[Position]] = asked, **parts: list[Position]) -> Iterator[None]:
            asked.update(parts)
            yield

        own = SimpleNamespace(_goal=replace(GOAL, error=goal), _record=record_them)
        list(adaptive._Campaign.more(own, design, step_of(0.02, 0.0, 1e-6)))
        assert len(asked["redo"]) == recorded, goal
        assert asked["redo"][-recorded // 5 :] == asked["kept_aside"] and asked["redo"][0] == Position(0, 0, 0)
