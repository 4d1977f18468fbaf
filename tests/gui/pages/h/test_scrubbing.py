"""What a step from one position of HT to the next does, and what it leaves alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal.psf import PSFMatrix
from lfcal_gui.models import shot
from lfcal_gui.pages.h.model import LoadedPlane
from lfcal_gui.widgets import contrast, picture
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Any:
    """Return the page with HT of an H in memory, drawn."""
    page = open_page("h")
    values = np.random.default_rng(0).random((1, 7, 9, 21, 21)).astype(np.float32)
    page.context.matrices.put("plane", PSFMatrix(values))
    page.resize(1100, 760)
    page.show()
    page.context.project.update("open", psf="plane")
    idle(page.context.jobs, qtbot)
    page.set_intent(transposed=True)
    drawn(page)
    return page


def drawn(page: Any) -> None:
    for _ in range(5):
        QApplication.processEvents()
    for view in page.panel.findChildren(pg.GraphicsView):
        view.viewport().repaint()


def counted(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> list[str]:
    calls: list[str] = []
    function: Callable[..., Any] = getattr(owner, name)

    def call(*arguments: Any, **named: Any) -> Any:
        calls.append(name)
        return function(*arguments, **named)

    monkeypatch.setattr(owner, name, call)
    return calls


def test_a_step_cuts_one_slice_and_scales_two_pictures(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    slices = counted(monkeypatch, LoadedPlane, "transposed_pattern")
    scaled = counted(monkeypatch, picture, "to_uint8")
    searched = counted(monkeypatch, shot, "levels_of")
    colours = counted(monkeypatch, contrast, "ramp")
    page.panel.map.chosen.emit(3, 4)
    np.testing.assert_array_equal(page.panel.main_view.values, page.matrix.T[0, 3, 4])
    assert (len(slices), len(scaled)) == (1, 2)
    assert not searched, "all positions share the levels of their plane"
    assert not colours


def test_a_step_draws_no_axis_anew(page: Any) -> None:
    panel = page.panel
    axes = [panel.map.plot.getAxis(side) for side in ("left", "bottom")]
    before = [axis.picture for axis in axes]
    assert all(before)
    for step in range(3):
        panel.map.chosen.emit(1 + step, 2 * step)
        drawn(page)
    assert [axis.picture for axis in axes] == before
