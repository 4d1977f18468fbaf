"""What all tests of recordings share."""

from __future__ import annotations

from tests.acquire.recording.sessions import _whole, copied, kept

__all__ = ["_whole", "copied", "kept"]
