"""Record > Folder takes frames that are a part of the sensor once their place is stated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.frames.part import parse_origin
from lfcal.psf import open_psf
from lfcal_gui.context import Context
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.frames.step import step
from tests.frames.test_part import ORIGIN, PLAN, write_part
from tests.gui.waiting import idle


def test_the_first_pixel_is_stated_on_the_page(open_page: Any, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    write_part(tmp_path / "f")
    (tmp_path / "f" / "plan.json").write_text(PLAN.to_json())
    page = open_page("frames")
    page.open_folder(str(tmp_path / "f"))
    idle(context.jobs, qtbot)
    edit = page.panel.choices.editor("origin")
    assert edit.text() == "" and "origin" not in " ".join(step(context.state).arguments)
    QTest.keyClicks(edit, "5,")
    QTest.keyClick(edit, Qt.Key.Key_Return)
    assert edit.property("invalid") and not FrameSettings.of(context.state).origin
    QTest.keyClicks(edit, " 6")
    assert not FrameSettings.of(context.state).origin, "it is reported when typing ends"
    QTest.keyClick(edit, Qt.Key.Key_Return)
    idle(context.jobs, qtbot)
    assert FrameSettings.of(context.state).origin == "5, 6"
    assert page.opened.source.info(0).origin == ORIGIN
    made = step(context.state)
    assert "origin='5, 6'" in made.python and any("origin" in word and "5, 6" in word for word in made.arguments)
    page.panel.choices.editor("use_background").setChecked(True)
    idle(context.jobs, qtbot)
    page.assemble(str(tmp_path / "H.h5"))
    idle(context.jobs, qtbot)
    with open_psf(tmp_path / "H.h5") as H:
        assert H.shape[:3] == PLAN.shape[:3] and not len(H.missing)


def test_a_place_that_is_none() -> None:
    assert parse_origin(" ") is None and parse_origin("5, 6") == ORIGIN
    for text in ("5", "5,6,7", "-5,6", "a,b", "٥,6"):
        with pytest.raises(InputError, match="ROW,COLUMN"):
            parse_origin(text)
