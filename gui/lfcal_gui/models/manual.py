"""Content of the menu Help: pages and sections of the manual, and the report of ``lfcal doctor``. No Qt."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import lfcal
from lfcal.base import StorageError

ATLAS = "faults.md"
"""Page of the manual with all faults that an inspection can report."""


def manual_folder() -> Path:
    """Return the folder of the manual, in a checkout or an installed package; raise if there is none."""
    package = Path(lfcal.__file__).resolve().parent
    for place in (package.parent / "docs", package / "_docs"):
        if (place / ATLAS).is_file():
            return place
    raise StorageError("manual: not part of this installation; read it in the docs folder of the lfcal source code")


def section_of(text: str, name: str) -> str:
    """Return the section of Markdown ``text`` that begins with ```name`.``, with its heading; else all of it."""
    for section in re.split(r"(?m)^(?=## )", text)[1:]:
        if re.match(rf"## [^\n]*\n\s*`{re.escape(name)}`\.", section):
            return section
    return text


def _sections(found: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return the heading and the pairs of name and value of each section."""
    devices = [(d["title"] or d["name"], d["version"] or f"absent: {d['reason']}") for d in found["devices"]]
    return [
        ("This machine", [(name, str(value)) for name, value in found["machine"].items()]),
        ("Libraries", [(name, version or "absent") for name, version in found["libraries"].items()]),
        ("Devices", devices),
        ("Plug-ins not loaded", [(f"{p['kind']} {p['name']}", p["reason"]) for p in found["plugins"]]),
    ]


def doctor_text(found: Mapping[str, Any]) -> str:
    """Return the report of ``lfcal doctor`` as plain text."""
    parts = [(title, rows) for title, rows in _sections(found) if rows]
    return "\n\n".join("\n".join((title, *(f"  {name}: {value}" for name, value in rows))) for title, rows in parts)


def doctor_html(found: Mapping[str, Any]) -> str:
    """Return the report of ``lfcal doctor`` as HTML."""
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
