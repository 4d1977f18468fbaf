"""The program's files, read once for all rules."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path

__all__ = ["ROOT", "text_of", "tree_of"]

ROOT = Path(__file__).resolve().parents[2]


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
