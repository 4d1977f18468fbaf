"""A session holds while a gauge is out of bounds, and goes on by itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.acquire.options import Options
from lfcal.acquire.session import iter_record, record
from lfcal.acquire.session_file import SessionFile
from lfcal.acquire.suspending import Bound, Suspender
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.devices.errors import DeviceError
from lfcal.devices.protocols import Gauge
from lfcal.devices.rig import FileGauge
from lfcal.devices.simulated.faults import DeviceFault
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan

PLAN = small_plan()
WARM = replace(CAREFUL, suspend=("temperature=20:22",), steady_s=3.0)


@pytest.mark.parametrize(
    ("text", "bound"),
    [
        ("temperature=20:22", Bound("temperature", 20, 22)),
        ("lamp=95:", Bound("lamp", low=95)),
        ("/lab/a=b.csv=:0.5", Bound("/lab/a=b.csv", high=0.5)),
    ],
)
def test_a_bound_is_read(text: str, bound: Bound) -> None:
    assert Bound.parse(text) == bound


@pytest.mark.parametrize("text", ["", "temperature", "temperature=20", "=1:2", "t=:", "t=2:1", "t=nan:1", "t=a:b"])
def test_what_says_no_bound_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"GAUGE=LOW:HIGH"):
        Options(suspend=(text,))


@pytest.mark.parametrize(("gauge", "fault"), [("temperature=20:22", "too warm"), ("lamp=95:105", "lamp low")])
def test_a_session_holds_and_goes_on_by_itself(tmp_path: Path, gauge: str, fault: str) -> None:
    record(tmp_path / "usual", PLAN, rig_for(PLAN), CAREFUL)
    rig = rig_for(PLAN, DeviceFault(fault, 1, 5))
    assert all(isinstance(one, Gauge) for one in rig.gauges)
    held: list[tuple[int, str]] = []
    options = replace(WARM, suspend=(gauge,))
    work = iter_record(tmp_path / "held", PLAN, rig, options)
    while True:
        try:
            progress = next(work)
        except StopIteration as end:
            outcome = end.value
            break
        if progress.note:
            held.append((progress.done, progress.note))
    assert outcome.how == "complete"
    # what is under way when it begins to hold is acknowledged then
    assert held and 0 < held[1][0] < 27, "it began, held in between, and went on"
    assert len({done for done, _ in held[1:]}) == 1, "nothing is recorded while it holds"
    assert gauge.partition("=")[0] in held[0][1] and "outside" in held[0][1]
    assert "continues in" in held[-1][1]
    assert_same_frames(frames_of(tmp_path / "held"), frames_of(tmp_path / "usual"))
    # a reading each second: five bad ones, then three seconds within
    assert outcome.seconds < 8 < rig.time.monotonic(), "the time that was held is no recording time"


def test_a_file_that_a_logger_writes_is_a_gauge(tmp_path: Path) -> None:
    file = tmp_path / "room.csv"
    file.write_text("time, T\n2026-05-04 12:00:03, 21.5\n2026-05-04 12:00:04, 2")
    assert FileGauge(file).read() == 21.5, "the last line is half written"
    rig = rig_for(PLAN)
    suspended = Suspender(rig, (Bound(str(file), 20, 22),), 0.0)
    assert suspended() == ""
    for text, words in (("27.5\n", "27.5, outside 20 to 22"), ("no number\n", "a last line with a number")):
        file.write_text(text)
        rig.time.sleep(2)
        assert words in suspended()
    file.unlink()
    rig.time.sleep(2)
    assert "cannot be read" in suspended()
    file.write_text("21\n")
    rig.time.sleep(2)
    assert suspended() == ""
    with pytest.raises(DeviceError, match="cannot be read"):
        FileGauge(tmp_path / "none").read()


def test_a_gauge_that_is_not_there_is_told_before_anything_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"temperature, lamp.*humidity"):
        record(tmp_path / "s", PLAN, rig_for(PLAN), replace(CAREFUL, suspend=("humidity=0:50",)))
    assert not (tmp_path / "s").exists()


def test_a_session_keeps_its_suspenders(tmp_path: Path) -> None:
    drain(iter_record(tmp_path, PLAN, rig_for(PLAN), WARM))
    assert SessionFile.read(tmp_path).options == WARM
