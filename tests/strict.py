"""Strict JSON: the reader of Python accepts NaN and infinity, but other readers refuse such a document."""

from __future__ import annotations

import json
from typing import Any

__all__ = ["strict_json"]


def strict_json(text: str) -> Any:
    """Return the value of a document of strict JSON."""

    def refuse(constant: str) -> object:
        raise ValueError(f"not strict JSON: {constant}")

    return json.loads(text, parse_constant=refuse)
