"""JSON as its standard has it: Python's own reader takes NaN and infinity, others refuse the whole document."""

from __future__ import annotations

import json
from typing import Any

__all__ = ["strict_json"]


def strict_json(text: str) -> Any:
    """Return the value of one document of strict JSON."""

    def refuse(constant: str) -> object:
        raise ValueError(f"not strict JSON: {constant}")

    return json.loads(text, parse_constant=refuse)
