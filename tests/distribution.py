"""Other packages, made for a test: a module and its entry points, found like installed ones."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"


def text_of(page: str, section: str = "") -> str:
    """Return a page of the documentation, or one of its sections (``## section``)."""
    text = (DOCS / page).read_text(encoding="utf-8")
    if not section:
        return text
    (found,) = (part for part in re.split(r"(?m)^## ", text)[1:] if part.startswith(f"{section}\n"))
    return found


def code_of(page: str, section: str = "") -> list[str]:
    """Return the Python blocks of a page of the documentation, or of its section (``## section``)."""
    return re.findall(r"```python\n(.*?)```", text_of(page, section), re.DOTALL)


def names_of(page: str, section: str = "") -> dict[str, Any]:
    """Return the names that the only Python block of a page or section defines."""
    (block,) = code_of(page, section)
    names: dict[str, Any] = {}
    exec(block, names)
    return names


def install(monkeypatch: pytest.MonkeyPatch, folder: Path, module: str, source: str, points: dict[str, str]) -> None:
    """Put a package on the path, with the entry points ``points``: ``{"group": "name = module:object"}``."""
    (folder / f"{module}.py").write_text(source, encoding="utf-8")
    about = folder / f"{module}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("".join(f"[{group}]\n{line}\n" for group, line in points.items()))
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, module, raising=False)
    importlib.invalidate_caches()


def in_a_new_process(folder: Path, code: str) -> str:
    """Return the output of ``code`` in a process in which the packages in ``folder`` are installed."""
    root = str(Path(__file__).parents[1])
    env = {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), root))}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr
    return done.stdout
