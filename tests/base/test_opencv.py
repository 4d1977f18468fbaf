"""OpenCV: one line with the remedy if another distribution replaced or damaged it, and nothing of contrib is used."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from lfcal.base import opencv

ROOT = Path(__file__).parents[2]
SOURCES = [path for folder in ("lfcal", "gui") for path in (ROOT / folder).rglob("*.py")]

BROKEN = {
    "a folder without modules": "",
    "another program's module": "import sys",
    "a system library is missing": "raise ImportError('libGL.so.1: cannot open shared object file')",
    "parts of two versions": "import sys; sys.no_such_name",
}


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
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import) and path.name != "opencv.py":
                assert "cv2" not in {alias.name for alias in node.names}, path
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "cv2":
                used.add(node.attr)
    assert {name for name in used if not name.isupper() and not name.endswith(("2", "101"))} <= set(opencv._FUNCTIONS)
    assert set(opencv._FUNCTIONS) <= used
