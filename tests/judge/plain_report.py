"""Quality reports without what takes longest: their pictures and the paper, where neither is the matter."""

from __future__ import annotations

import pytest

from lfcal.judge.report import write
from lfcal.judge.report._pictures import ReportPicture


def undrawn(patch: pytest.MonkeyPatch) -> None:
    """Let a report have one empty picture, and no paper; page and lists are as ever."""
    patch.setattr(write, "pictures", lambda *_: [lambda: ReportPicture("slices", "none.png", "", b"")])
    patch.setattr(write, "pdf", lambda *_: b"")
