"""A camera that changes samples automatically: refused before anything moves, or recorded with what it does."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.acquire._forecast import forecast
from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.options import Options
from lfcal.acquire.session import record
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import RegionPlan
from lfcal.devices.protocols import Setting
from lfcal.devices.rig import Rig
from tests.acquire.rigs import CAREFUL, frames_of, rig_for, small_plan, stopped
from tests.cli.conftest import Run

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


@pytest.mark.parametrize(
    ("automatic", "options"), [(("GainAuto", "Gamma"), ALLOWED), ((), CAREFUL)], ids=["allowed", "off"]
)
def test_settings_are_recorded_with_the_session_and_with_h(
    tmp_path: Path, automatic: tuple[str, ...], options: Options
) -> None:
    with rig_for(PLAN, automatic=automatic) as rig:
        assert forecast(PLAN, rig, options, tmp_path / "s").positions == PLAN.n_positions
        assert record(tmp_path / "s", PLAN, rig, options).how == "complete"
    gain, gamma = ("Continuous", "2.2") if automatic else ("Off", "1")
    settings = {"ExposureAuto": "Off", "GainAuto": gain, "Gamma": gamma, "Gain": "0"}
    session = SessionFile.read(tmp_path / "s")
    assert session.options.allow_automatic is bool(automatic) and session.devices.automatic == automatic
    with drain(iter_assemble_session(tmp_path / "s", tmp_path / "H.h5")).matrix as matrix:
        for noted in (devices_in(tmp_path / "s"), matrix.provenance["devices"]):
            assert noted["settings"] == settings and tuple(noted.get("automatic", ())) == automatic


def test_a_camera_without_the_method_is_recorded(tmp_path: Path) -> None:
    stopped(tmp_path / "s", PLAN, 1, rig=rig_with(None))
    assert not {"settings", "automatic"} & set(devices_in(tmp_path / "s"))
    assert SessionFile.read(tmp_path / "s").devices.settings == {}
    # as were sessions of older versions: they are resumed with a camera that states its settings
    with pytest.raises(InputError, match="GainAuto = Continuous"):
        record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=("GainAuto",)), resume=True)
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), resume=True).how == "complete"


@pytest.mark.parametrize(
    ("before", "now", "named"),
    [
        ((), ("GainAuto",), r"devices\.settings\.GainAuto: expected Off as recorded, got Continuous"),
        (("GainAuto",), (), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
        (("GainAuto",), ("Gamma",), r"devices\.settings\.GainAuto: expected Continuous as recorded, got Off"),
    ],
)
def test_a_session_is_resumed_with_the_settings_and_permission_it_began_with(
    tmp_path: Path, before: tuple[str, ...], now: tuple[str, ...], named: str
) -> None:
    stopped(tmp_path / "s", PLAN, 1, ALLOWED, rig_for(PLAN, automatic=before))
    with pytest.raises(InputError, match=named):
        record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=now), ALLOWED, resume=True)
    if before:
        with pytest.raises(InputError, match="expected frames proportional to light, got GainAuto = Continuous"):
            record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=before), CAREFUL, resume=True)
    assert record(tmp_path / "s", PLAN, rig_for(PLAN, automatic=before), resume=True).how == "complete"
    assert len(frames_of(tmp_path / "s")) == PLAN.n_positions


def test_only_automatic_values_may_differ_when_a_session_is_resumed(tmp_path: Path) -> None:
    def rig(automatic: str, gain: str) -> Rig:
        return rig_with({"GainAuto": Setting("Off", automatic), "Gain": Setting(None, gain)})

    stopped(tmp_path / "auto", PLAN, 1, ALLOWED, rig("Continuous", "3.1"))
    assert record(tmp_path / "auto", PLAN, rig("Continuous", "2.7"), resume=True).how == "complete"
    stopped(tmp_path / "off", PLAN, 1, CAREFUL, rig("Off", "3.1"))
    with pytest.raises(InputError, match=r"devices\.settings\.Gain: expected 3\.1 as recorded, got 2\.7"):
        record(tmp_path / "off", PLAN, rig("Off", "2.7"), resume=True)


def test_settings_of_a_crafted_session_are_refused(tmp_path: Path) -> None:
    stopped(tmp_path, PLAN, 1)
    whole = (tmp_path / "session.json").read_text()
    for change in ({"settings": [1]}, {"settings": {"Gain": 1}}, {"automatic": ["GainAuto", "Focus"]}):
        data = json.loads(whole)
        data["devices"] |= change
        (tmp_path / "session.json").write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match="settings: expected names"):
            SessionFile.read(tmp_path)


@pytest.mark.parametrize("regions", [False, True])
def test_acquire_refuses_and_records_with_permission(tmp_path: Path, lfcal: Callable[..., Run], regions: bool) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "s"
    two = RegionPlan(PLAN, ("a", "b"), (PLAN.anchor, (30.0, 30.0)))
    plan.write_text(two.to_json() if regions else PLAN.to_json())
    command = ("acquire", plan, "-o", out, "--darks", 0, "--on-suspect", "flag", "--no-check-origin")
    assert "ExposureAuto" in lfcal(*command, "--option", "automatic=Focus").err, "the option names its choices"
    automatic = ("--option", "optics=pattern", "--option", "automatic=GainAuto")
    for more in ((), ("--dry-run",), ("--no-check-stage",)):
        refused = lfcal(*command, *automatic, *more)
        assert refused.code == 2 and "got GainAuto = Continuous; switch this off" in refused.err
        assert "--allow-automatic" in refused.err and not out.exists()
    done = lfcal(*command, *automatic, "--allow-automatic", "--no-check-stage")
    assert done.code == 0 and "note: GainAuto = Continuous: frames, and an H made from them," in done.err
    folder = out / "a" if regions else out
    assert devices_in(folder)["automatic"] == ["GainAuto"]
    # the permission is of the session, which shows it
    assert lfcal(*command, *automatic, "--resume").code == 0
    assert "camera: GainAuto = Continuous: frames may not be proportional to light" in lfcal("status", folder).out
    assert lfcal("status", folder, "--json").json["automatic"] == {"GainAuto": "Continuous"}
