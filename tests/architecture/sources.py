"""The program's files, read once for all rules."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path

__all__ = [
    "FILES",
    "MODULES",
    "PACKAGES",
    "ROOT",
    "WINDOW",
    "face_of",
    "is_package",
    "name_of",
    "origin",
    "text_of",
    "tree_of",
]

ROOT = Path(__file__).resolve().parents[2]
WINDOW = ROOT / "gui" / "lfcal_gui"
PACKAGES = {"lfcal": ROOT / "lfcal", "lfcal_gui": WINDOW}
"""The packages that are installed, and their folders."""


def name_of(path: Path) -> str:
    """Return the name by which a file of the packages is imported."""
    folder = WINDOW.parent if path.is_relative_to(WINDOW) else ROOT
    parts = path.relative_to(folder).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = sorted(path for folder in PACKAGES.values() for path in folder.rglob("*.py"))
MODULES = {name_of(path): path for path in FILES}


@cache
def text_of(path: Path) -> str:
    """Return what is in a file."""
    return path.read_text(encoding="utf-8")


@cache
def tree_of(path: Path) -> ast.Module:
    """Return a file's syntax tree."""
    collecting = gc.isenabled()
    gc.disable()  # of millions of nodes none is garbage: to look for it takes three times as long as to parse
    try:
        return ast.parse(text_of(path))
    finally:
        if collecting:
            gc.enable()


def is_package(module: str) -> bool:
    """Return whether a module of ours is a package."""
    return module in MODULES and MODULES[module].name == "__init__.py"


@cache
def face_of(package: str) -> dict[str, tuple[str, str]]:
    """Return the names that a package gives: the module that each is imported from, and its name there."""
    files = [MODULES[face] for face in (f"{package}._face", f"{package}._shared") if face in MODULES]
    return {
        alias.asname or alias.name: (str(node.module), alias.name)
        for path in files
        for node in tree_of(path).body
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    }


def origin(module: str, name: str) -> str:
    """Return the module that a name comes from which is imported from a package or module."""
    while name in face_of(module):
        module, name = face_of(module)[name]
    inner = f"{module}.{name}"
    return inner if inner in MODULES else module
