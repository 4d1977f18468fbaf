"""What the window lacks on this system is named with its remedy, by ``lfcal doctor --gui`` and by the window itself."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lfcal.base import window_libraries
from lfcal.base.window_libraries import NEEDED, ON_X11, missing_libraries, shows_on_x11, why_no_window, without
from tests.cli import conftest

lfcal = conftest.lfcal
ABSENT = ("libEGL.so.1", "libxcb-cursor.so.0")


def loaded(name: str) -> object:
    """Load nothing; two libraries are not there."""
    if name in ABSENT:
        raise OSError(f"{name}: cannot open shared object file")
    return object()


@pytest.fixture
def two_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(names: dict[str, str]) -> dict[str, str]:
        return missing_libraries(names, loaded, "linux")

    monkeypatch.setattr(window_libraries, "missing_libraries", missing)
    monkeypatch.setattr("lfcal.base.missing_libraries", missing)


def test_missing_libraries_are_found_on_linux_only() -> None:
    found = missing_libraries({**NEEDED, **ON_X11}, loaded, "linux")
    assert found == {"libEGL.so.1": "libegl1", "libxcb-cursor.so.0": "libxcb-cursor0"}
    assert missing_libraries(NEEDED, loaded, "win32") == missing_libraries(NEEDED, loaded, "darwin") == {}
    assert missing_libraries({"libnosuch-of-lfcal.so.9": "x"}, platform="linux") == {"libnosuch-of-lfcal.so.9": "x"}
    assert without(found).endswith("run: sudo apt install libegl1 libxcb-cursor0 (Debian, Ubuntu)")


@pytest.mark.parametrize(
    ("environment", "x11"),
    [
        ({"DISPLAY": ":0"}, True),
        ({"DISPLAY": ":0", "WAYLAND_DISPLAY": "wayland-0"}, False),
        ({"DISPLAY": ":0", "QT_QPA_PLATFORM": "offscreen"}, False),
        ({"WAYLAND_DISPLAY": "wayland-0", "QT_QPA_PLATFORM": "xcb"}, True),
        ({}, False),
    ],
)
def test_where_windows_are_shown(environment: dict[str, str], x11: bool) -> None:
    assert shows_on_x11(environment) == x11


def test_the_doctor_names_them(lfcal: Callable[..., conftest.Run], two_missing: None) -> None:
    run = lfcal("doctor", "--gui")
    assert run.code == 1 and "libxcb-cursor0" in run.out and "sudo apt install libegl1 libxcb-cursor0" in run.err
    found = lfcal("doctor", "--gui", "--json").json
    assert isinstance(found, dict) and found["missing"] == dict(zip(ABSENT, ("libegl1", "libxcb-cursor0"), strict=True))
    assert set(found["libraries"]) == {"PySide6-Essentials", "pyqtgraph"}


def test_why_there_is_no_window(monkeypatch: pytest.MonkeyPatch, two_missing: None) -> None:
    error = ImportError("libEGL.so.1: cannot open shared object file")
    monkeypatch.setattr(window_libraries, "find_spec", lambda name: None)
    assert why_no_window(error) == 'PySide6 is not installed; run: pip install "lfcal[gui]"'
    monkeypatch.setattr(window_libraries, "find_spec", lambda name: object())
    assert why_no_window(error).endswith("run: sudo apt install libegl1 (Debian, Ubuntu)")
    monkeypatch.setattr(window_libraries, "missing_libraries", lambda names: {})
    assert why_no_window(ImportError("no shiboken")) == (
        "PySide6 is installed but cannot be loaded: no shiboken; lfcal doctor --gui shows details"
    )
