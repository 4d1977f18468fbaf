"""What the doctor found, as text and as a page. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any


def _sections(found: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return heading and pairs of name and value of every part."""
    devices = [(d["title"] or d["name"], d["version"] or f"absent: {d['reason']}") for d in found["devices"]]
    return [
        ("This machine", [(name, str(value)) for name, value in found["machine"].items()]),
        ("Libraries", [(name, version or "absent") for name, version in found["libraries"].items()]),
        ("Devices", devices),
        ("Plug-ins left out", [(f"{p['kind']} {p['name']}", p["reason"]) for p in found["plugins"]]),
    ]


def doctor_text(found: Mapping[str, Any]) -> str:
    """Return all of it as plain text."""
    parts = [(title, rows) for title, rows in _sections(found) if rows]
    return "\n\n".join("\n".join((title, *(f"  {name}: {value}" for name, value in rows))) for title, rows in parts)


def doctor_html(found: Mapping[str, Any]) -> str:
    """Return all of it as a page."""
    return "".join(
        f"<h3>{title}</h3><table>"
        + "".join(
            f"<tr><td style='padding-right:14px'>{escape(name)}</td><td>{escape(value)}</td></tr>"
            for name, value in rows
        )
        + "</table>"
        for title, rows in _sections(found)
        if rows
    )
