"""Location of the sample data, in a checkout or in an installed package."""

from __future__ import annotations

from pathlib import Path

from lfcal.base.errors import StorageError

__all__ = ["sample_recording", "sample_session"]


def sample_session() -> Path:
    """Return the folder of the sample session: frames in image files, with plan, dark frames and a white image."""
    return _place("session", "plan.json")


def sample_recording() -> Path:
    """Return the folder of the sample session that was recorded by lfcal."""
    return _place("recorded", "session.json")


def _place(name: str, holds: str) -> Path:
    package = Path(__file__).resolve().parents[1]
    for place in (package.parent / "sample_data" / name, package / f"_sample_{name}"):
        if (place / holds).is_file():
            return place
    raise StorageError(
        f"sample data ({name}): not part of this installation; run sample_data/make.py of the source code"
    )
