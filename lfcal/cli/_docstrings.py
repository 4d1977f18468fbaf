"""Docstrings as the help of commands, also where compiled code has none."""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from typing import Any

__all__ = ["WITHOUT_DOCSTRINGS", "docstring"]

WITHOUT_DOCSTRINGS = 2
"""Level of optimisation (``python -OO``) from which compiled code has no docstrings."""


def docstring(thing: Any) -> str:
    """Return the docstring of a class or function, which ``python -OO`` leaves in the source only."""
    known = inspect.getdoc(thing) or ""
    # the docstring that a dataclass makes for itself is no help
    if sys.flags.optimize < WITHOUT_DOCSTRINGS or (known and not isinstance(thing, type)):
        return known
    node: Any = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
    return ast.get_docstring(node) or ""
