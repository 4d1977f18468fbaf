"""The shape of the window's code: what each page folder has, and what may import what."""

from __future__ import annotations

import ast
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GUI = ROOT / "gui" / "lfcal_gui"
FILES = sorted(GUI.rglob("*.py"))
PAGES = sorted(path.parent for path in (GUI / "pages").glob("*/__init__.py"))
QT = ("PySide6", "pyqtgraph")


@cache
def imports(path: Path) -> set[str]:
    """Return the names of modules that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = str(node.module)
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def page_of(path: Path) -> str:
    """Return the page whose folder a file is in, or an empty string."""
    parts = path.relative_to(GUI).parts
    return parts[1] if parts[0] == "pages" and len(parts) > 2 else ""


@pytest.mark.parametrize("folder", PAGES, ids=lambda p: p.name)
def test_every_page_has_one_shape(folder: Path) -> None:
    assert {"__init__.py", "page.py", "panel.py", "model.py"} <= {path.name for path in folder.glob("*.py")}
    text = (folder / "page.py").read_text(encoding="utf-8")
    assert "Layout" not in text, "page.py has no layout code"


FREE = [
    *(GUI / "models").glob("*.py"),
    *(GUI / "pages").glob("*/*model*.py"),
    *(GUI / "pages").glob("*/step*.py"),
    *(GUI / "pages").glob("*/__init__.py"),
]
"""Files without Qt."""


def test_models_and_specs_have_no_qt() -> None:
    assert len(FREE) > 20
    for path in FREE:
        bad = {
            n for n in imports(path) if n.split(".")[0] in QT or n.startswith(("lfcal_gui.widgets", "lfcal_gui.theme"))
        }
        assert not bad, f"{path.relative_to(ROOT)} imports {bad}"


def test_models_and_specs_are_checked_by_mypy() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]
    assert settings["strict"]
    checked = {path for pattern in settings["files"] for path in ROOT.glob(pattern)}
    folders = {path for path in checked if path.is_dir()}
    assert ROOT / "lfcal" in folders
    assert not [path for path in FREE if path not in checked and not folders & set(path.parents)]


def test_scripts_are_made_of_their_parts() -> None:
    """A text that is replaced in a finished script is left as it was, silently, once the script's words change."""
    paths = [GUI / "models" / "step.py", *sorted((GUI / "pages").glob("*/step*.py"))]
    assert len(paths) > 10
    for path in paths:
        calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
        called = {node.func.attr for node in calls if isinstance(node.func, ast.Attribute)}
        assert not called & {"replace", "sub", "removeprefix", "removesuffix", "partition"}, path.relative_to(ROOT)


def others(path: Path) -> set[str]:
    """Return the pages that a file imports from outside their folders."""
    used = {name.split(".")[2] for name in imports(path) if name.startswith("lfcal_gui.pages.")}
    # the demo project is a project of the sample session's frames, whose settings it sets
    return used - ({"frames"} if path.name == "_welcome.py" else {page_of(path)})


def test_nothing_reaches_into_another_page_s_folder() -> None:
    assert not {str(path.relative_to(ROOT)): found for path in FILES if (found := others(path))}


def functions(path: Path) -> dict[str, int]:
    """Return the lines of a file's functions, their docstrings left out."""
    found = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            lines = (node.end_lineno or 0) - node.lineno + 1
            if ast.get_docstring(node):
                first = node.body[0]
                lines -= (first.end_lineno or first.lineno) - first.lineno + 1
            found[f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"] = lines
    return found


def test_functions_are_short() -> None:
    assert not {name: n for path in FILES for name, n in functions(path).items() if n > 40}
