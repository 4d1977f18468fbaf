"""Where the sample session lies: in a checkout, or inside an installed package."""

from __future__ import annotations

from pathlib import Path

import lfcal
from lfcal.errors import StorageError

__all__ = ["sample_session"]


def sample_session() -> Path:
    """Return the folder of the recorded sample session."""
    package = Path(lfcal.__file__).resolve().parent
    for place in (package.parent / "sample_data" / "session", package / "_sample_session"):
        if (place / "plan.json").is_file():
            return place
    raise StorageError("sample session: not part of this installation; make it with sample_data/make.py")
