"""``python -m benchmarks faults``: what is put in is what is measured; cameras without a fault raise no alarm."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import faults
from benchmarks._fault_list import FAULTS, Injected
from benchmarks._fault_recordings import CAMERAS, Recording
from benchmarks.faults import Tried
from tests.benchmarks.test_commands import Bench, bench

__all__ = ["bench"]


@pytest.mark.long
def test_a_fault_is_tried_with_its_costs_and_what_was_tried_is_kept(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    number = next(k for k, one in enumerate(FAULTS) if one.name == "offsets of columns")
    part = ("--cameras", "bench", "--first", number, "--faults", 1, "--strengths", "3", "--patterns", 24)
    file = tmp_path / "tried.jsonl"
    found = json.loads(bench("faults", *part, "--json", "--keep", file))
    (one,) = found["faults"]
    assert one["fault"] == "offsets of columns" and one["strength"] == 15 and one["rank"] == 1
    assert one["true"] / 2 < one["told"] < 2 * one["true"]
    assert (found["dear"], found["first_or_second"], found["named"], found["within_2"]) == (1, 1, 1, 1)
    monkeypatch.setattr(faults, "tried", None)  # nothing is done again
    assert json.loads(bench("faults", *part, "--json", "--keep", file)) == found
    with file.open("a") as more:
        more.write("none\n")
    assert "line 2 of tried.jsonl" in bench("faults", *part, "--keep", file, code=2)


def test_what_was_tried_is_kept(bench: Bench, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    once = Tried("bench", FAULTS[0].name, FAULTS[0].strengths[2], FAULTS[0].unit, 0.2, 0.15, 1, ("a 0.150",), 1.0)
    answers = iter([once])
    monkeypatch.setattr(faults, "_truth", lambda recording: None)
    monkeypatch.setattr(faults, "tried", lambda *_: next(answers))
    part = ("--cameras", "bench", "--faults", 1, "--strengths", "3", "--patterns", 24, "--keep", tmp_path / "kept")
    found = bench.json("faults", *part)
    assert found["faults"][0]["told"] == 0.15 and found["first_or_second"] == 1
    assert bench.json("faults", *part) == found, "nothing is done again"
    with (tmp_path / "kept").open("a") as more:
        more.write("none\n")
    assert "line 2 of kept" in bench("faults", *part, code=2)


@pytest.mark.long
@pytest.mark.parametrize("names", [["bench"], ["bench", "bench, 1 % PRNU"]])
def test_cameras_without_a_fault(bench: Bench, monkeypatch: pytest.MonkeyPatch, names: list[str]) -> None:
    monkeypatch.setattr(faults, "CLEAN", len(names))
    found = bench.json("faults", "--clean", "--patterns", 24)
    assert [one["camera"] for one in found["cameras"]] == names
    assert found["bad"] == 0


def test_what_it_is_asked_for_is_checked(bench: Bench) -> None:
    assert "some of bench, r29-like" in bench("faults", "--cameras", "none", code=2)
    assert "some of 1, 2, 3" in bench("faults", "--strengths", "4", code=2)


def test_there_are_enough_faults_each_with_its_own_name() -> None:
    assert len(FAULTS) >= 60 and len({one.name for one in FAULTS}) == len(FAULTS)
    assert len(CAMERAS) == 4


@pytest.mark.long
@pytest.mark.parametrize("fault", FAULTS, ids=lambda one: one.name)
def test_every_fault_changes_a_recording(fault: Injected) -> None:
    recording = Recording(CAMERAS["bench"]())
    values = fault.put_in(recording, fault.strengths[2])
    assert values.shape == recording.plan.shape and np.isfinite(values).all()
    assert not np.allclose(values, recording.clean())
