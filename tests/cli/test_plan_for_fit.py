"""``lfcal plan fit``: few positions chosen, recorded, fitted, and further ones chosen from that fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from lfcal.acquire.redo import RedoList
from lfcal.acquire.session_file import SessionFile
from lfcal.camera import ScanPlan
from lfcal.fit.setup import described_effects
from lfcal.psf import open_psf
from lfcal.simulate.effects.described import Entry, entries_json
from tests.cli.conftest import Run
from tests.fit.common import small_camera

Lfcal = Callable[..., Run]
SOME = "geometry,iris"
SIMULATED = ("--option", "optics=grid", "--option", "effects=effects.json", "--no-check-stage")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    camera = small_camera()
    (tmp_path / "camera.json").write_text(camera.to_json())
    entries = [Entry(one, one.name, {}, "on") for one in described_effects(camera)]
    (tmp_path / "effects.json").write_text(entries_json(entries))
    plan = ScanPlan.for_camera(camera, virtual_depths=(2.2,), cutout=15)
    (tmp_path / "plan.json").write_text(plan.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def planned(lfcal: Lfcal, *more: str) -> Run:
    return lfcal("plan", "fit", "plan.json", "--count", "10", "--candidates", "40", *more)


@pytest.mark.long
def test_positions_are_chosen_recorded_and_fitted(lfcal: Lfcal, place: Path) -> None:
    run = planned(lfcal, "-o", "list.json", "--draw", "curve.png", "--unknowns", SOME)
    assert run.code == 0 and "8 positions to fit, 2 held out" in run.out and "the complete scan instead: 627" in run.out
    assert (place / "curve.png").stat().st_size > 5000
    listed = RedoList.read(place / "list.json")
    assert len(listed.positions) == 10 and len(listed.kept_aside) == 2 and "held out" in listed.reasons[-1]
    dry = lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", "--dry-run", "--json")
    assert dry.code == 0 and isinstance(dry.json, dict) and dry.json["positions"] == 10 and dry.json["seconds"] < 10
    run = lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", "--assemble", "H.h5", *SIMULATED)
    assert run.code == 0 and "complete, 10 of 10" in run.out, run.err
    session = SessionFile.read(place / "s")
    assert sorted(session.redo[0]) == sorted(map(tuple, listed.positions)) and len(session.kept_aside) == 2
    with open_psf(place / "H.h5") as H:
        assert (H.recorded > 0).sum() == 10 and all(H.recorded[p] for p in listed.positions)
    checked = lfcal("verify", "s", "--json")
    assert checked.code == 0 and isinstance(checked.json, dict)
    assert "13 of 13 frames are whole" in lfcal("verify", "s").out and "never" not in lfcal("verify", "s").out

    run = lfcal("fit", "s", "-o", "fit", "--unknowns", SOME, "--no-h", "--workers", "1")
    assert run.code == 0, run.err
    found = json.loads((place / "fit" / "fit.json").read_text())
    assert found["patterns"] == 10 and found["left_out_error"]["patterns"] == 2 and found["complete"]
    assert {tuple(p) for p in found["positions"]} == set(map(tuple, listed.positions))

    # H knows which ones are kept aside, too
    assert lfcal("fit", "H.h5", "-o", "fitH", "--unknowns", "iris", "--no-h").code == 0
    ofh = json.loads((place / "fitH" / "fit.json").read_text())
    assert ofh["patterns"] == 10 and ofh["left_out_error"]["patterns"] == 2

    # further positions, from what the fit knows: added to the same session
    more = lfcal(
        "plan",
        "fit",
        "plan.json",
        "--count",
        "4",
        "--from",
        "fit",
        "-o",
        "next.json",
        "--position-error",
        "0",
        "--full",
        "0.7",
        "--candidates",
        "30",
        "--workers",
        "1",
        "--json",
    )
    assert more.code == 0 and isinstance(more.json, dict), more.err
    assert more.json["curve"][-1]["error"] < more.json["start_error"] < more.json["pattern_error"]
    assert len(more.json["positions"]) == 4 and more.json["files"] == ["next.json"]
    run = lfcal("acquire", "plan.json", "--redo", "next.json", "-o", "s", *SIMULATED)
    assert run.code == 0, run.err
    session = SessionFile.read(place / "s")
    assert len(session.recordings) == 2 and len(session.kept_aside) == 3
    assert "never" not in lfcal("verify", "s").out
    with open_psf(place / "H.h5") as H:
        assert not any(H.recorded[tuple(p)] for p in more.json["positions"])


def test_errors_below_that_of_the_computation_are_named(lfcal: Lfcal, place: Path) -> None:
    run = planned(lfcal, "--unknowns", "iris", "--full", "1", "--position-error", "0", "--count", "20")
    assert run.code == 0 and "computed patterns have an error of about 0.06 %" in run.err, run.out
    assert "computed patterns" not in planned(lfcal, "--unknowns", SOME, "--full", "0.1").err


@pytest.mark.long
def test_all_positions_of_such_a_session_can_be_thinned(lfcal: Lfcal, place: Path) -> None:
    assert planned(lfcal, "-o", "list.json").code == 0
    assert lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", *SIMULATED).code == 0
    run = lfcal("fit", "s", "-o", "fit", "--unknowns", "iris", "--no-h", "--positions", "6")
    assert run.code == 0, run.err
    found = json.loads((place / "fit" / "fit.json").read_text())
    assert found["patterns"] == 6 and found["left_out_error"]["patterns"] == 1


@pytest.mark.few(6)
@pytest.mark.parametrize(
    ("words", "what"),
    [
        ("plan camera.json --virtual-depths 2.2 --from fit", "type lfcal plan fit PLAN --count N --from"),
        ("plan camera.json --for-fit 9", "--for-fit: expected another spelling; type lfcal plan fit PLAN --count N"),
        ("plan fit plan.json --for-fit 9", "--for-fit: expected another spelling; type --count"),
        ("plan fit plan.json --count 9 --list a.json", "--list: expected another spelling; type --out"),
        ("plan fit plan.json --count 9 --beside 0", "--beside: expected another spelling; type --position-error"),
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
        ("acquire plan.json --positions list.json --resume -o s", "--positions: is of a new session"),
        ("acquire plan.json --positions camera.json -o s", "lfcal-redo"),
        ("acquire plan.json --positions far.json -o s", "inside (1, 19, 33)"),
        ("acquire plan.json --positions none.json -o s", "positions to record: expected at least one"),
        ("acquire plan.json --positions apart.json -o s", "a list of [z, y, x]"),
    ],
)
def test_what_is_refused(lfcal: Lfcal, place: Path, words: str, what: str) -> None:
    RedoList.of([(0, 0, 0)]).write(place / "list.json")
    RedoList.of([(0, 0, 99)]).write(place / "far.json")
    RedoList.of([]).write(place / "none.json")
    RedoList.of([(0, 0, 0)], kept_aside=[(0, 1, 1)]).write(place / "apart.json")
    run = lfcal(*words.split())
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    assert not (place / "s" / "session.json").exists()
