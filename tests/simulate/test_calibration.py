"""The speed of a machine: measured once, stored whole or not at all, and corrected by the median of recent planes."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from lfcal.simulate.accuracy import calibration, machine_speed
from lfcal.simulate.accuracy.calibration import MAX_CORRECTION, PLANES, MachineSpeed


class Timings:
    """Rates that a machine shows one after the other, and how often it was asked."""

    def __init__(self, *rates: float) -> None:
        self.rates, self.count = rates, 0

    def __call__(self) -> float:
        self.count += 1
        return self.rates[(self.count - 1) % len(self.rates)]


@pytest.fixture
def timings(monkeypatch: pytest.MonkeyPatch) -> Timings:
    found = Timings(2e7, 1e10, 3e9)
    monkeypatch.setattr(calibration, "_timed_rate", found)
    return found


def test_the_speed_is_measured_once_for_all_processes(tmp_path: Path, timings: Timings) -> None:
    """Of several timings the fastest: a slow moment says nothing of the machine."""
    file = tmp_path / "new" / "speed.json"
    assert not MachineSpeed(file).measured
    assert MachineSpeed(file).rate() == 1e10 and timings.count == calibration.TIMINGS
    again = MachineSpeed(file)
    assert again.measured and again.rate() == 1e10 and timings.count == calibration.TIMINGS


def test_corrections_are_kept_and_one_wrong_plane_is_not_believed(tmp_path: Path, timings: Timings) -> None:
    file = tmp_path / "speed.json"
    speed = MachineSpeed(file)
    speed.rate()
    for plane, took in enumerate((1.4, 1.5, 1000.0, 1.6, 1.5, 1.5)):
        assert (plane > 2) == (speed.ratio("wave") != 1.0), "few planes are no median"
        speed.correct("wave", f"plane {plane}", 1.0, took)
    for stored in (speed, MachineSpeed(file)):
        assert stored.ratio("wave") == 1.5 and stored.ratio("debye") == 1.0
        assert stored.engines == ("wave",) and stored.planes("wave") == 6
    for plane in range(PLANES):
        speed.correct("wave", f"slow {plane}", 1.0, 100.0)
    assert speed.ratio("wave") == MAX_CORRECTION and speed.planes("wave") == PLANES
    speed.correct("wave", "plane", 0.0, 1.0)
    speed.correct("wave", "plane", 1.0, 0.0)
    assert MachineSpeed(file).planes("wave") == PLANES


def test_runs_of_the_same_plane_count_once(tmp_path: Path, timings: Timings) -> None:
    """They err alike, and would otherwise decide the forecasts of all other planes."""
    speed = MachineSpeed(tmp_path / "speed.json")
    speed.rate()
    for took in (4.0, 4.0, 5.0, 4.0, 4.0, 3.0):
        speed.correct("wave", "plane", 1.0, took)
    assert speed.ratio("wave") == 1.0 and speed.planes("wave") == 1
    for plane in range(4):
        speed.correct("wave", f"other {plane}", 1.0, 1.0 + plane)
    assert speed.ratio("wave") == pytest.approx(1.5), "1, 1, 1, 1, 2, 3, 3 (the last of the plane), 4"
    assert MachineSpeed(speed.file).ratio("wave") == speed.ratio("wave")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("10000000000.0", "-1"),
        *(('{"plane": 1.5}', other) for other in ('{"plane": 0}', "[1.5]", "{}", '{"plane": "a"}')),
        ('"machine": "', '"machine": "another '),
        *((None, text) for text in ("", "[]", "7", '{"rate": 1e10}')),
    ],
)
def test_a_damaged_or_foreign_file_is_replaced(old: str | None, new: str, tmp_path: Path, timings: Timings) -> None:
    file = tmp_path / "speed.json"
    speed = MachineSpeed(file)
    speed.rate()
    speed.correct("wave", "plane", 1.0, 1.5)
    whole = file.read_text(encoding="utf-8")
    damaged = whole.replace(old, new) if old else new or whole[: len(whole) // 2]
    assert damaged != whole
    file.write_text(damaged, encoding="utf-8")
    found = MachineSpeed(file)
    assert not found.measured and found.ratio("wave") == 1.0
    found.rate()
    assert MachineSpeed(file).measured


def test_without_a_writable_folder_the_process_keeps_the_speed(tmp_path: Path, timings: Timings) -> None:
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    for file in (tmp_path / "file" / "speed.json", None):
        speed = MachineSpeed(file)
        assert speed.rate() == 1e10
        for plane in range(4):
            speed.correct("wave", f"plane {plane}", 1.0, 2.0)
        assert speed.rate() == 1e10 and speed.ratio("wave") == 2.0
    assert [one.name for one in tmp_path.iterdir()] == ["file"]


def test_the_folder_is_chosen_by_a_variable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFCAL_CACHE", str(tmp_path))
    assert machine_speed().file == tmp_path / "speed.json"
    assert machine_speed() is machine_speed()
    monkeypatch.setenv("LFCAL_CACHE", "")
    assert machine_speed().file is None
    monkeypatch.delenv("LFCAL_CACHE")
    there = calibration.speed_file()
    assert there is not None and there.name == "speed.json" and "lfcal" in there.parts


def test_other_programs_do_not_slow_the_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on the wall that runs a thousand times too fast, as it does for a process that rarely gets its turn."""
    monkeypatch.setattr(time, "perf_counter", lambda: 1000 * time.monotonic())
    assert 1e8 < MachineSpeed(None).rate() < 1e13
