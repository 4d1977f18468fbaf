"""``lfcal doctor`` names every part of another distribution that could not be loaded, with the reason."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from lfcal.simulate.accuracy import calibration
from tests.cli.conftest import Run
from tests.distribution import in_a_new_process, install

KINDS = {
    "lfcal.formats": "image format",
    "lfcal.sources": "frame source",
    "lfcal.effects": "effect",
    "lfcal.solvers": "solver",
    "lfcal.metrics": "check of H",
    "lfcal.faults": "fault",
    "lfcal.findings": "source of findings",
    "lfcal.devices": "device backend",
}

DOCTOR = 'import sys; sys.argv = ["lfcal", "doctor", {}]; from lfcal.cli import main; main()'


@pytest.fixture
def broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install a distribution that fails when it is loaded, with an entry point for every kind of part."""
    points = {group: f"{group.split('.')[1]}_of_theirs = broken_parts:PART" for group in KINDS}
    install(monkeypatch, tmp_path, "broken_parts", "raise RuntimeError('their [driver] is missing')", points)
    return tmp_path


def test_json_holds_every_plugin_that_fails(broken: Path) -> None:
    found = json.loads(in_a_new_process(broken, DOCTOR.format('"--json"')))["plugins"]
    assert {(p["name"], p["kind"]) for p in found} == {
        (f"{group.split('.')[1]}_of_theirs", kind) for group, kind in KINDS.items()
    }
    assert all("RuntimeError: their [driver] is missing" in p["reason"] for p in found)


def test_the_table_tells_the_reason(broken: Path) -> None:
    shown = in_a_new_process(broken, DOCTOR.format("").replace(", ]", "]"))
    rows = [line for line in shown.splitlines() if "their [driver] is missing" in line]
    assert "plug-in not loaded" in shown and len(rows) >= len(KINDS)
    assert any("solver solvers_of_theirs: RuntimeError" in line for line in rows)


def test_parts_that_load_are_not_listed(lfcal: Callable[..., Run]) -> None:
    done = lfcal("doctor", "--json")
    assert done.code == 0 and done.json["plugins"] == []  # type: ignore[index, call-overload]
    assert "plug-in" not in lfcal("doctor").out
    assert lfcal("--version").out.startswith("lfcal ")


def test_the_speed_for_forecasts_is_shown(
    lfcal: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def shown() -> str:
        return str(lfcal("doctor", "--json").json["machine"]["speed for forecasts"])  # type: ignore[index, call-overload]

    monkeypatch.setattr(calibration, "_timed_rate", lambda: 1e10)
    assert "LFCAL_CACHE is empty" in shown()
    monkeypatch.setenv("LFCAL_CACHE", str(tmp_path))
    assert "not measured yet" in shown() and str(tmp_path) in shown()
    assert not list(tmp_path.iterdir()), "to show it measures nothing"
    speed = calibration.machine_speed()
    speed.rate()
    for plane in range(4):
        speed.correct("wave", f"plane {plane}", 1.0, 1.5)
    assert "1e+10 complex multiply-adds" in shown() and "wave: 1.50 times the forecast (4)" in shown()
