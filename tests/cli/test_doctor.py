"""``lfcal doctor`` and ``lfcal install-desktop``."""

from __future__ import annotations

import configparser
import json
import os
import shlex
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from lfcal.base.errors import InputError
from lfcal.cli import install_desktop
from lfcal.cli.install_desktop import data_home, desktop_files, window_program
from lfcal.simulate.accuracy import calibration
from tests.cli.conftest import Lfcal
from tests.distribution import in_a_new_process, install

# -- ``lfcal doctor`` names every part of another package that could not be loaded, with the reason --
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


def test_every_plugin_that_fails_is_named_with_the_reason(broken: Path) -> None:
    found = json.loads(in_a_new_process(broken, DOCTOR.format('"--json"')))["plugins"]
    assert {(p["name"], p["kind"]) for p in found} == {
        (f"{group.split('.')[1]}_of_theirs", kind) for group, kind in KINDS.items()
    }
    assert all("RuntimeError: their [driver] is missing" in p["reason"] for p in found)


@pytest.mark.long
def test_plugins_that_fail_are_shown_with_the_reason(broken: Path) -> None:
    shown = in_a_new_process(broken, DOCTOR.format("").replace(", ]", "]"))
    rows = [line for line in shown.splitlines() if "their [driver] is missing" in line]
    assert "plug-in not loaded" in shown and len(rows) >= len(KINDS)
    assert any("solver solvers_of_theirs: RuntimeError" in line for line in rows)


def test_parts_that_load_are_not_listed(lfcal: Lfcal) -> None:
    assert lfcal("doctor", "--json").ok().json["plugins"] == [] and "plug-in" not in lfcal("doctor").out
    assert lfcal("--version").out.startswith("lfcal ")


def test_the_speed_for_forecasts_is_shown(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def shown() -> str:
        return str(lfcal("doctor", "--json").json["machine"]["speed for forecasts"])

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


# -- ``lfcal install-desktop`` writes a menu entry, an icon and a file type, and takes away what it wrote --
NAMES = ("applications/lfcal.desktop", "icons/hicolor/scalable/apps/lfcal.svg", "mime/packages/lfcal.xml")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where the files of a user's desktop go, on Linux with the program of the window installed."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setattr(sys, "executable", str(program_in(tmp_path / "bin").with_name("python")))
    return tmp_path / "data"


def program_in(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "lfcal-gui"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    return program


def entry_of(text: str) -> configparser.SectionProxy:
    parser = configparser.RawConfigParser(delimiters=("=",))
    parser.optionxform = str  # type: ignore[method-assign,assignment]
    parser.read_string(text)
    return parser["Desktop Entry"]


def test_the_entry_is_written_and_removed(lfcal: Lfcal, place: Path) -> None:
    others = place / "applications" / "other.desktop"
    others.parent.mkdir(parents=True)
    others.write_text("[Desktop Entry]\n")
    for _ in range(2):
        run = lfcal("install-desktop")
        assert run.code == 0 and all(str(place / name) in run.out for name in NAMES), run.err
    entry = entry_of((place / NAMES[0]).read_text())
    program = shlex.split(entry["Exec"])[0]
    assert os.access(program, os.X_OK) and program.endswith("lfcal-gui") and entry["Exec"].endswith(" %f")
    assert entry["Type"] == "Application" and entry["Icon"] == Path(NAMES[1]).stem
    assert ElementTree.parse(place / NAMES[1]).getroot().tag.endswith("svg")
    kind = ElementTree.parse(place / NAMES[2]).getroot()[0]
    assert entry["MimeType"] == f"{kind.get('type')};" and kind[-1].get("pattern") == "*.lfcal"
    run = lfcal("install-desktop", "--uninstall", "--json")
    assert run.json == {"uninstalled": [str(place / name) for name in NAMES]}
    assert not any((place / name).exists() for name in NAMES) and others.exists()
    again = lfcal("install-desktop", "--uninstall")
    assert again.code == 0 and again.out == f"nothing of lfcal in {place}\n"


def test_the_window_is_found_next_to_python_or_by_its_name(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Path(sys.executable).with_name("lfcal-gui")
    assert window_program() == str(beside)
    elsewhere = program_in(place / "tools")
    beside.unlink()
    monkeypatch.setenv("PATH", str(elsewhere.parent))
    assert window_program() == str(elsewhere)
    elsewhere.unlink()
    with pytest.raises(InputError, match=r"lfcal-gui: not found; install lfcal"):
        window_program()


def test_only_linux_has_such_files(lfcal: Lfcal, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install_desktop, "sys", type("sys", (), {"platform": "win32"}))
    lfcal("install-desktop").refused("expected a Linux desktop, got win32")
    assert not place.exists()


def test_paths_are_those_of_the_specification() -> None:
    home = Path.home() / ".local" / "share"
    assert data_home({}) == data_home({"XDG_DATA_HOME": "relative"}) == home
    assert data_home({"XDG_DATA_HOME": "/data"}) == Path("/data")
    for folder, written in (
        ("/opt/lfcal", '"/opt/lfcal/lfcal-gui" %f'),
        ("/home/a b", '"/home/a b/lfcal-gui" %f'),
        ("/x/50%", '"/x/50%%/lfcal-gui" %f'),
        ('/x/$a"`', '"/x/\\\\$a\\\\"\\\\`/lfcal-gui" %f'),
    ):
        assert f"\nExec={written}\n" in desktop_files(f"{folder}/lfcal-gui")[NAMES[0]].decode()
