"""Pages of the manual and sections of them, as Markdown. No Qt."""

from __future__ import annotations

import re
from pathlib import Path

import lfcal
from lfcal.base import StorageError

ATLAS = "faults.md"
"""Page that shows every fault that an inspection may name."""


def manual_folder() -> Path:
    """Return where the manual lies: in a checkout, or inside an installed package; raises where it is nowhere."""
    package = Path(lfcal.__file__).resolve().parent
    for place in (package.parent / "docs", package / "_docs"):
        if (place / ATLAS).is_file():
            return place
    raise StorageError("the manual: not part of this installation; it is in the folder docs of lfcal's source")


def section_of(text: str, name: str) -> str:
    """Return the section of Markdown ``text`` whose first words are ```name`.``, heading and all; else all of it."""
    for section in re.split(r"(?m)^(?=## )", text)[1:]:
        if re.match(rf"## [^\n]*\n\s*`{re.escape(name)}`\.", section):
            return section
    return text
