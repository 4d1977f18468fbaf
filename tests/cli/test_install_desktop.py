"""``lfcal install-desktop`` writes a menu entry, an icon and a file type, and takes away what it wrote."""

from __future__ import annotations

import configparser
import os
import shlex
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import pytest

from lfcal.base.errors import InputError
from lfcal.cli import install_desktop
from lfcal.cli.install_desktop import data_home, desktop_files, window_program
from tests.cli.conftest import Run

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


def test_it_is_written_again_and_taken_away(lfcal: Callable[..., Run], place: Path) -> None:
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


def test_only_linux_has_such_files(lfcal: Callable[..., Run], place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install_desktop, "sys", type("sys", (), {"platform": "win32"}))
    run = lfcal("install-desktop")
    assert run.code == 2 and "expected a Linux desktop, got win32" in run.err and not place.exists()


def test_the_window_is_found_beside_or_by_its_name(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Path(sys.executable).with_name("lfcal-gui")
    assert window_program() == str(beside)
    elsewhere = program_in(place / "tools")
    beside.unlink()
    monkeypatch.setenv("PATH", str(elsewhere.parent))
    assert window_program() == str(elsewhere)
    elsewhere.unlink()
    with pytest.raises(InputError, match=r"lfcal-gui: not found; install lfcal"):
        window_program()


@pytest.mark.parametrize(
    ("folder", "written"),
    [
        ("/opt/lfcal", '"/opt/lfcal/lfcal-gui" %f'),
        ("/home/a b", '"/home/a b/lfcal-gui" %f'),
        ("/x/50%", '"/x/50%%/lfcal-gui" %f'),
        ('/x/$a"`', '"/x/\\\\$a\\\\"\\\\`/lfcal-gui" %f'),
    ],
)
def test_paths_are_quoted_as_the_specification_says(folder: str, written: str) -> None:
    text = desktop_files(f"{folder}/lfcal-gui")[NAMES[0]].decode()
    assert f"\nExec={written}\n" in text


def test_the_folder_is_that_of_the_specification() -> None:
    home = Path.home() / ".local" / "share"
    assert data_home({}) == data_home({"XDG_DATA_HOME": "relative"}) == home
    assert data_home({"XDG_DATA_HOME": "/data"}) == Path("/data")
