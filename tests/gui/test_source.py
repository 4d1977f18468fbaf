"""The source code of the window: what each page folder has, what may import what, and which words it uses."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
GUI = ROOT / "gui" / "lfcal_gui"
FILES = sorted(GUI.rglob("*.py"))
PAGES = sorted(path.parent for path in (GUI / "pages").glob("*/__init__.py"))
FREE = [
    *(GUI / "models").glob("*.py"),
    *(GUI / "pages").glob("*/*model*.py"),
    *(GUI / "pages").glob("*/step*.py"),
    *(GUI / "pages").glob("*/__init__.py"),
]
"""Files without Qt."""


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports(path: Path) -> set[str]:
    """Return the names of modules that a file imports, anywhere in it."""
    found: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = str(node.module)
            found |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return found


def test_every_page_has_the_same_files() -> None:
    for folder in PAGES:
        assert {"__init__.py", "page.py", "panel.py", "model.py"} <= {path.name for path in folder.glob("*.py")}
        assert "Layout" not in (folder / "page.py").read_text(encoding="utf-8"), "page.py has no layout code"


def test_models_and_specs_have_no_qt_and_are_checked_by_mypy() -> None:
    assert len(FREE) > 20
    for path in FREE:
        bad = [name for name in imports(path) if re.match(r"PySide6|pyqtgraph|lfcal_gui\.(widgets|theme)", name)]
        assert not bad, f"{path.relative_to(ROOT)} imports {bad}"
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mypy"]
    checked = {path for pattern in settings["files"] for path in ROOT.glob(pattern)}
    folders = {path for path in checked if path.is_dir()}
    assert settings["strict"] and ROOT / "lfcal" in folders
    assert not [path for path in FREE if path not in checked and not folders & set(path.parents)]


def test_scripts_are_composed_of_their_parts() -> None:
    """A replacement in a finished script silently does nothing once the words of the script change."""
    paths = [GUI / "models" / "step.py", *sorted((GUI / "pages").glob("*/step*.py"))]
    assert len(paths) > 10
    for path in paths:
        calls = [node for node in ast.walk(tree(path)) if isinstance(node, ast.Call)]
        called = {node.func.attr for node in calls if isinstance(node.func, ast.Attribute)}
        assert not called & {"replace", "sub", "removeprefix", "removesuffix", "partition"}, path.relative_to(ROOT)


def test_no_file_imports_from_the_folder_of_another_page() -> None:
    for path in FILES:
        parts = path.relative_to(GUI).parts
        own = parts[1] if parts[0] == "pages" and len(parts) > 2 else ""
        used = {name.split(".")[2] for name in imports(path) if name.startswith("lfcal_gui.pages.")}
        # the sample project is one of frames, whose settings it sets
        assert used <= ({"frames"} if path.name == "_welcome.py" else {own}), path.relative_to(ROOT)


def test_functions_are_short() -> None:
    for path in FILES:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.FunctionDef):
                first = node.body[0] if ast.get_docstring(node) else None
                docstring = (first.end_lineno or 0) - first.lineno + 1 if first else 0
                assert (node.end_lineno or 0) - node.lineno + 1 - docstring <= 40, (path.relative_to(ROOT), node.name)


# -- one term for each concept, as in the glossary -----------------------------------------------------------
ELSEWHERE = {"lamp", "tile", "rest", "solver", "backend", "engine", "operator", "slice", "objective"}
"""Words that the glossary refuses for one concept and that are right for another."""

ALLOWED = {
    "gui/lfcal_gui/pages/frames/orientation.py": {"cropped"},  # by other programs, before lfcal read the frames
}


def refused() -> set[str]:
    """Return the words that the glossary says are not used."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    said = (entry.split(" except ")[0] for entry in re.findall(r"\(not: ([^)]*)\)", text))
    words = {word.strip() for entry in said for word in entry.split(",")}
    return {word for word in words if word and not word.startswith(("which", "for a"))} - ELSEWHERE


def sentences(path: Path) -> Iterator[str]:
    """Yield the strings of a file that people read: those with a space in them, no docstrings."""
    quiet = set()
    for node in ast.walk(tree(path)):
        for one in getattr(node, "body", []) if isinstance(getattr(node, "body", None), list) else []:
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant):
                quiet.add(id(one.value))
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in quiet:
            if " " in node.value.strip():
                yield node.value


def test_the_window_uses_no_word_that_the_glossary_refuses() -> None:
    words = refused()
    assert {"crop", "diaphragm", "microlens", "flat field", "single PSF"} <= words
    pattern = re.compile(rf"\b({'|'.join(map(re.escape, sorted(words)))})(ped|s|es)?\b", re.IGNORECASE)
    found = []
    for path in sorted((ROOT / "gui").rglob("*.py")):
        name = str(path.relative_to(ROOT))
        for text in sentences(path):
            hits = {hit.group(0) for hit in pattern.finditer(text)} - ALLOWED.get(name, set())
            found += [f"{name}: {hit!r} in {text!r}" for hit in hits]
    assert not found, "\n".join(found)
