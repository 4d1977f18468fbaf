"""The window is tested offscreen, in a process of its own, and must leave no thread behind."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ["QT_QPA_PLATFORM"] = "offscreen"


@pytest.fixture(autouse=True)
def no_thread_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    left = [t for t in threading.enumerate() if t not in before and t.is_alive() and "lfcal" in t.name]
    assert not left, f"threads left behind: {left}"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Where the window keeps recent sessions and autosave."""
    folder = tmp_path / "state"
    folder.mkdir()
    return folder
