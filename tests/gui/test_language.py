"""One term for each concept: what the window says holds to the glossary."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "gui").rglob("*.py"))

ELSEWHERE = {"lamp", "tile", "rest", "solver", "backend", "engine", "operator", "slice", "objective"}
"""Refused for one concept, and the right word for another: the lamp itself, a solver of volumes, a microscope."""

ALLOWED = {
    "gui/lfcal_gui/pages/frames/orientation.py": {"cropped"},  # by others, before lfcal saw the frames
}


def refused() -> set[str]:
    """Return the words that the glossary says are not used."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    said = (entry.split(" except ")[0] for entry in re.findall(r"\(not: ([^)]*)\)", text))
    words = {word.strip() for entry in said for word in entry.split(",")}
    return {word for word in words if word and not word.startswith(("which", "for a"))} - ELSEWHERE


def sentences(path: Path) -> Iterator[str]:
    """Yield the strings of a file that people read: those with a space in them, no docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    quiet = set()
    for node in ast.walk(tree):
        for one in getattr(node, "body", []) if isinstance(getattr(node, "body", None), list) else []:
            if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant):
                quiet.add(id(one.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in quiet:
            if " " in node.value.strip():
                yield node.value


def test_the_window_says_no_word_that_the_glossary_refuses() -> None:
    words = refused()
    assert {"crop", "diaphragm", "microlens", "flat field", "single PSF"} <= words
    pattern = re.compile(rf"\b({'|'.join(map(re.escape, sorted(words)))})(ped|s|es)?\b", re.IGNORECASE)
    found = []
    for path in FILES:
        name = str(path.relative_to(ROOT))
        for text in sentences(path):
            hits = {hit.group(0) for hit in pattern.finditer(text)} - ALLOWED.get(name, set())
            found += [f"{name}: {hit!r} in {text!r}" for hit in hits]
    assert not found, "\n".join(found)
