"""Positions that are chosen for a fit, recorded, fitted and complemented; sessions that end by the error of H."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.acquire.redo import RedoList
from lfcal.acquire.session_file import SessionFile
from lfcal.camera import ScanPlan
from lfcal.fit.setup import described_effects
from lfcal.psf import open_psf
from lfcal.simulate.effects.described import Entry, entries_json
from tests.cli.conftest import Lfcal, Run
from tests.fit.common import small_camera

UNKNOWNS = "geometry,iris"


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
    run = planned(lfcal, "-o", "list.json", "--draw", "curve.png", "--unknowns", UNKNOWNS)
    assert run.code == 0 and "8 positions to fit, 2 held out" in run.out and "the complete scan instead: 627" in run.out
    assert (place / "curve.png").stat().st_size > 5000
    listed = RedoList.read(place / "list.json")
    assert len(listed.positions) == 10 and len(listed.kept_aside) == 2 and "held out" in listed.reasons[-1]
    dry = lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", "--dry-run", "--json")
    assert dry.code == 0 and dry.json["positions"] == 10 and dry.json["seconds"] < 10
    run = lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", "--assemble", "H.h5", *SIMULATED).ok()
    assert "complete, 10 of 10" in run.out
    session = SessionFile.read(place / "s")
    assert sorted(session.redo[0]) == sorted(map(tuple, listed.positions)) and len(session.kept_aside) == 2
    with open_psf(place / "H.h5") as H:
        assert (H.recorded > 0).sum() == 10 and all(H.recorded[p] for p in listed.positions)
    checked = lfcal("verify", "s", "--json")
    assert checked.code == 0
    assert "13 of 13 frames are whole" in lfcal("verify", "s").out and "never" not in lfcal("verify", "s").out

    lfcal("fit", "s", "-o", "fit", "--unknowns", UNKNOWNS, "--no-h", "--workers", "1").ok()
    found = json.loads((place / "fit" / "fit.json").read_text())
    assert found["patterns"] == 10 and found["left_out_error"]["patterns"] == 2 and found["complete"]
    assert {tuple(p) for p in found["positions"]} == set(map(tuple, listed.positions))

    # H knows which ones are kept aside, too
    lfcal("fit", "H.h5", "-o", "fitH", "--unknowns", "iris", "--no-h").ok()
    ofh = json.loads((place / "fitH" / "fit.json").read_text())
    assert ofh["patterns"] == 10 and ofh["left_out_error"]["patterns"] == 2

    # further positions, from what the fit knows: added to the same session
    more = lfcal(
        *("plan", "fit", "plan.json", "--count", "4", "--from", "fit", "-o", "next.json", "--position-error", "0"),
        *("--full", "0.7", "--candidates", "30", "--workers", "1", "--json"),
    )
    assert more.code == 0, more.err
    assert more.json["curve"][-1]["error"] < more.json["start_error"] < more.json["pattern_error"]
    assert len(more.json["positions"]) == 4 and more.json["files"] == ["next.json"]
    lfcal("acquire", "plan.json", "--redo", "next.json", "-o", "s", *SIMULATED).ok()
    session = SessionFile.read(place / "s")
    assert len(session.recordings) == 2 and len(session.kept_aside) == 3 and "never" not in lfcal("verify", "s").out
    with open_psf(place / "H.h5") as H:
        assert not any(H.recorded[tuple(p)] for p in more.json["positions"])


@pytest.mark.long
def test_all_positions_of_such_a_session_can_be_thinned(lfcal: Lfcal, place: Path) -> None:
    assert planned(lfcal, "-o", "list.json").code == 0
    lfcal("acquire", "plan.json", "--positions", "list.json", "-o", "s", *SIMULATED).ok()
    lfcal("fit", "s", "-o", "fit", "--unknowns", "iris", "--no-h", "--positions", "6").ok()
    found = json.loads((place / "fit" / "fit.json").read_text())
    assert found["patterns"] == 6 and found["left_out_error"]["patterns"] == 1


@pytest.mark.long
def test_a_session_ends_by_the_error_of_h_and_continues_to_a_smaller_one(lfcal: Lfcal, place: Path) -> None:
    scan = replace(ScanPlan.from_json((place / "plan.json").read_text()), period=(6, 8))
    (place / "plan.json").write_text(scan.to_json())
    words = ("acquire", "plan.json", "-o", "s", "--unknowns", "geometry", "--workers", "1", *SIMULATED, "--until-error")
    run = lfcal(*words, "0.3%").ok()
    assert "the target error of H is reached" in run.out and "lfcal fit s -o fit/" in run.out
    assert "12 positions: expected error of H 0." in run.err
    session = SessionFile.read(place / "s")
    assert len(session.redo[0]) == 12 and session.kept_aside
    lfcal("verify", "s").ok()
    more = lfcal(*words, "0.0007", "--resume", "--most", "18", "--json").ok().json
    assert more["ended"] == "used up" and more["steps"][-1]["positions"] == 18
    errors = [step["expected_error"] for step in more["steps"]]
    assert errors[-1] < errors[0] < 0.003 and more["outcome"]["acknowledged"] == 18
    lfcal("verify", "s").ok()
