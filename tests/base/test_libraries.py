"""Libraries that are missing or damaged are named with the remedy: OpenCV, and those of the window."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from lfcal.base import opencv, window_libraries
from lfcal.base.window_libraries import NEEDED, ON_X11, missing_libraries, shows_on_x11, why_no_window, without
from tests.cli import conftest

ROOT = Path(__file__).parents[2]
SOURCES = [path for folder in ("lfcal", "gui") for path in (ROOT / folder).rglob("*.py")]

BROKEN = {
    "a folder without modules": "",
    "another program's module": "import sys",
    "a system library is missing": "raise ImportError('libGL.so.1: cannot open shared object file')",
    "parts of two versions": "import sys; sys.no_such_name",
}


@pytest.mark.long
@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN)
def test_a_broken_module_gives_one_line_with_the_remedy(tmp_path: Path, content: str) -> None:
    (tmp_path / "cv2").mkdir()
    (tmp_path / "cv2" / "__init__.py").write_text(content)
    about = tmp_path / "opencv_contrib_python-4.11.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: opencv-contrib-python\nVersion: 4.11.0\n")
    program = "import sys; sys.path.insert(0, sys.argv.pop()); from lfcal.cli import main; main()"
    words = ["demo", str(tmp_path / "out"), str(tmp_path)]
    done = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "opencv-contrib-python in the same environment" in line
    assert line.endswith("run: python -m pip install --force-reinstall --no-deps opencv-python-headless")


def test_every_module_takes_the_checked_one_and_every_function_is_checked() -> None:
    used = set()
    for path in SOURCES:
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "cv2" in text else ():
            if isinstance(node, ast.Import) and path.name != "opencv.py":
                assert "cv2" not in {alias.name for alias in node.names}, path
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "cv2":
                used.add(node.attr)
    assert {name for name in used if not name.isupper() and not name.endswith(("2", "101"))} <= set(opencv._FUNCTIONS)
    assert set(opencv._FUNCTIONS) <= used


# -- the window --------------------------------------------------------------------------------------------------------


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


def test_where_windows_are_shown() -> None:
    x11, wayland = {"DISPLAY": ":0"}, {"WAYLAND_DISPLAY": "wayland-0"}
    for environment, shown in (
        *((x11, True), (x11 | wayland, False), (x11 | {"QT_QPA_PLATFORM": "offscreen"}, False)),
        *((wayland | {"QT_QPA_PLATFORM": "xcb"}, True), ({}, False)),
    ):
        assert shows_on_x11(environment) == shown


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
