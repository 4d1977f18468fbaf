"""A camera that changes samples automatically: refused before anything moves, or recorded with what it does."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire._forecast import forecast
from lfcal.acquire.control import Control
from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import RegionPlan
from lfcal.cli import main
from lfcal.devices.protocols import Setting
from lfcal.devices.rig import Rig
from tests.acquire.rigs import CAREFUL, frames_of, rig_for, small_plan

PLAN = small_plan(planes=1)
ALLOWED = replace(CAREFUL, allow_automatic=True, on_suspect="flag")
REFUSED = r"of simulated camera: expected frames proportional to light, got GainAuto = Continuous, Gamma = 2\.2; switch"


def devices_in(folder: Path) -> dict[str, Any]:
    devices: dict[str, Any] = json.loads((folder / "session.json").read_text())["devices"]
    return devices


def rig_with(settings: dict[str, Setting[str | None]] | None) -> Rig:
    """Return a simulated rig whose camera gives these settings, or has no such method."""
    rig = rig_for(PLAN)
    camera: Any = rig.camera
    camera.device.fixed_settings = None if settings is None else lambda: settings
    return rig


def interrupted(folder: Path, rig: Rig, **options: Any) -> None:
    """Begin a session and stop it after the first frame."""
    control = Control()
    outcome = record(folder, PLAN, rig, control=control, observers=(lambda *_: control.stop(),), **options)
    assert outcome.how == "stopped" and outcome.acknowledged < PLAN.n_positions


def test_a_camera_that_stays_automatic_is_refused_before_anything_moves(tmp_path: Path) -> None:
    with rig_for(PLAN, automatic=("GainAuto", "Gamma")) as rig:
        for refused in (
            lambda: record(tmp_path / "s", PLAN, rig, CAREFUL),
            lambda: forecast(PLAN, rig, CAREFUL, tmp_path / "s"),
        ):
            with pytest.raises(InputError, match=REFUSED):
                refused()
        assert not (tmp_path / "s").exists()
        assert rig.stage.moves == 0  # type: ignore[attr-defined]


def test_what_stays_automatic_is_recorded_where_it_is_allowed(tmp_path: Path) -> None:
    with rig_for(PLAN, automatic=("GainAuto", "Gamma")) as rig:
        assert forecast(PLAN, rig, ALLOWED, tmp_path / "s").positions == PLAN.n_positions
        assert record(tmp_path / "s", PLAN, rig, ALLOWED).how == "complete"
    settings = {"ExposureAuto": "Off", "GainAuto": "Continuous", "Gamma": "2.2", "Gain": "0"}
    noted = devices_in(tmp_path / "s")
    assert noted["settings"] == settings and noted["automatic"] == ["GainAuto", "Gamma"]
    session = SessionFile.read(tmp_path / "s")
    assert session.options.allow_automatic and session.devices.automatic == ("GainAuto", "Gamma")
    with drain(iter_assemble_session(tmp_path / "s", tmp_path / "H.h5")).matrix as matrix:
        said = matrix.provenance["devices"]
    assert said["settings"] == settings and said["automatic"] == ["GainAuto", "Gamma"]


def test_settings_that_are_off_are_recorded_with_h(tmp_path: Path) -> None:
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL)
    settings = {"ExposureAuto": "Off", "GainAuto": "Off", "Gamma": "1", "Gain": "0"}
    assert devices_in(tmp_path / "s")["settings"] == settings
    assert "automatic" not in devices_in(tmp_path / "s")
    with drain(iter_assemble_session(tmp_path / "s", tmp_path / "H.h5")).matrix as matrix:
        assert matrix.provenance["devices"]["settings"] == settings


def test_a_camera_of_others_without_the_method_is_recorded_as_before(tmp_path: Path) -> None:
    assert record(tmp_path / "s", PLAN, rig_with(None), CAREFUL).how == "complete"
    assert not {"settings", "automatic"} & set(devices_in(tmp_path / "s"))
    assert SessionFile.read(tmp_path / "s").devices.settings == {}


def test_the_simulated_camera_shows_what_automatic_gain_and_gamma_do() -> None:
    def peaks(*automatic: str) -> np.ndarray[Any, Any]:
        with rig_for(PLAN, automatic=automatic) as rig:
            found = []
            for position in PLAN.positions():
                rig.stage.move(tuple(PLAN.stage_um(np.array(position)).tolist()))
                rig.time.sleep(60.0)
                rig.camera.set_exposure(0.004)
                found.append(int(rig.camera.grab(1.0).data.max()))
            return np.array(found)

    plain, gain, gamma = peaks(), peaks("GainAuto"), peaks("Gamma")
    full = PLAN.camera.sensor.max_value
    assert np.ptp(plain) > 0.1 * plain.mean()
    assert np.all(np.abs(gain / full - 0.7) < 0.1)  # whatever the light
    assert np.all(gamma > plain) and np.all(gamma <= full)


@pytest.mark.parametrize(
    ("before", "now", "named"),
    [
        ((), ("GainAuto",), r"devices\.settings\.GainAuto: expected Off as recorded, got Continuous"),
        (("GainAuto",), (), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
        (("GainAuto",), ("Gamma",), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
    ],
)
def test_a_session_goes_on_with_the_settings_it_began_with(
    tmp_path: Path, before: tuple[str, ...], now: tuple[str, ...], named: str
) -> None:
    interrupted(tmp_path / "s", rig_for(PLAN, automatic=before), options=ALLOWED)
    with pytest.raises(InputError, match=named):
        record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=now), ALLOWED, resume=True)
    assert record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=before), resume=True).how == "complete"
    assert len(frames_of(tmp_path / "s")) == PLAN.n_positions


def test_a_session_that_goes_on_needs_the_permission_it_was_given(tmp_path: Path) -> None:
    rig = rig_for(PLAN, automatic=("GainAuto", "Gamma"))
    interrupted(tmp_path / "s", rig, options=ALLOWED)
    with pytest.raises(InputError, match=REFUSED):
        record(tmp_path / "s", PLAN, rig, CAREFUL, resume=True)
    assert record(tmp_path / "s", PLAN, rig, resume=True).how == "complete"


def test_a_value_that_the_camera_changes_by_itself_may_differ_when_a_session_goes_on(tmp_path: Path) -> None:
    def rig(automatic: str, gain: str) -> Rig:
        return rig_with({"GainAuto": Setting("Off", automatic), "Gain": Setting(None, gain)})

    interrupted(tmp_path / "auto", rig("Continuous", "3.1"), options=ALLOWED)
    assert record(tmp_path / "auto", PLAN, rig("Continuous", "2.7"), resume=True).how == "complete"
    interrupted(tmp_path / "off", rig("Off", "3.1"), options=CAREFUL)
    with pytest.raises(InputError, match=r"devices\.settings\.Gain: expected 3\.1 as recorded, got 2\.7"):
        record(tmp_path / "off", PLAN, rig("Off", "2.7"), resume=True)


def test_a_session_of_an_older_version_goes_on(tmp_path: Path) -> None:
    interrupted(tmp_path / "s", rig_with(None), options=CAREFUL)
    with pytest.raises(InputError, match="GainAuto = Continuous"):
        record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=("GainAuto",)), resume=True)
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"


@pytest.mark.parametrize("change", [{"settings": [1]}, {"settings": {"Gain": 1}}, {"automatic": ["GainAuto", "Focus"]}])
def test_settings_of_a_crafted_session_are_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    record(tmp_path / "s", PLAN, rig_for(PLAN), CAREFUL)
    path = tmp_path / "s" / "session.json"
    data = json.loads(path.read_text())
    data["devices"] |= change
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="settings: expected names"):
        SessionFile.read(tmp_path / "s")


# -- as a user ---------------------------------------------------------------------------------------------
def run(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


@pytest.mark.parametrize("regions", [False, True])
def test_acquire_refuses_and_records_with_permission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], regions: bool
) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "s"
    two = RegionPlan(PLAN, ("a", "b"), (PLAN.anchor, (30.0, 30.0)))
    plan.write_text(two.to_json() if regions else PLAN.to_json())
    command = ("acquire", plan, "-o", out, "--darks", 0, "--on-suspect", "flag", "--no-check-origin")
    automatic = ("--option", "optics=pattern", "--option", "automatic=GainAuto")
    for more in ((), ("--dry-run",), ("--no-check-stage",)):
        assert run(*command, *automatic, *more, monkeypatch=monkeypatch) == 2
        said = capsys.readouterr().err
        assert "got GainAuto = Continuous; switch this off" in said and "--allow-automatic" in said
        assert not out.exists()
    assert run(*command, *automatic, "--allow-automatic", "--no-check-stage", monkeypatch=monkeypatch) == 0
    assert "note: GainAuto = Continuous: frames, and an H made from them," in capsys.readouterr().err
    folder = out / "a" if regions else out
    assert devices_in(folder)["automatic"] == ["GainAuto"]
    # the permission is of the session, which shows it
    assert run(*command, *automatic, "--resume", monkeypatch=monkeypatch) == 0
    capsys.readouterr()
    assert run("status", folder, monkeypatch=monkeypatch) == 0
    assert "camera: GainAuto = Continuous: frames may not be proportional to light" in capsys.readouterr().out
    assert run("status", folder, "--json", monkeypatch=monkeypatch) == 0
    assert json.loads(capsys.readouterr().out)["automatic"] == {"GainAuto": "Continuous"}


def test_the_option_of_the_simulator_names_its_choices(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.json"
    plan.write_text(PLAN.to_json())
    command = ("acquire", plan, "-o", tmp_path / "s", "--option", "automatic=Focus")
    assert run(*command, monkeypatch=monkeypatch) == 2
    assert "ExposureAuto" in capsys.readouterr().err
