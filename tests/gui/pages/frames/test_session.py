"""A recorded session as frames: white and dark beside it are found."""

from __future__ import annotations

from pathlib import Path

from lfcal.acquire.session import record
from lfcal_gui.pages.frames.model import FrameSettings, import_folder
from tests.acquire.rigs import CAREFUL, rig_for, small_plan

PLAN = small_plan((3, 4), 2)


def test_the_white_image_of_a_session_is_found(tmp_path: Path) -> None:
    """Record > Rig writes them there; Frames took the session without them."""
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL)
    plain = import_folder(str(tmp_path), FrameSettings(), None)
    assert (plain.settings.white, plain.settings.dark) == ("", "")
    plain.close()
    (tmp_path / "dark").mkdir()
    alone = import_folder(str(tmp_path), FrameSettings(use_white=False), None)
    assert alone.settings.dark == "", "a recording has darks of its own"
    alone.close()
    (tmp_path / "white").mkdir()
    found = import_folder(str(tmp_path), FrameSettings(use_white=False, use_dark=False), None)
    assert found.settings.white == str(tmp_path / "white") and found.settings.dark == str(tmp_path / "dark")
    found.close()
