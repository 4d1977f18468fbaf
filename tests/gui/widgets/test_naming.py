"""Every control has words for those who do not see it."""

from __future__ import annotations

import pyqtgraph as pg
from PySide6.QtWidgets import QComboBox, QFormLayout, QLineEdit, QSlider, QSpinBox, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.naming import name_controls, unnamed
from lfcal_gui.widgets.plots import LinePlot
from lfcal_gui.window import MainWindow


def test_every_control_of_every_page_has_a_name(window: MainWindow) -> None:
    nameless = {
        spec.key: [(type(w).__name__, w.toolTip()) for w in unnamed(window.page(spec.key))] for spec in window.specs
    }
    assert {key: found for key, found in nameless.items() if found} == {}
    for dialog in (window.tools.verify(), window.tools.doctor(), window.tools.preferences(), window.tools.welcome()):
        assert unnamed(dialog) == [], dialog.windowTitle()
        dialog.close()
    window.jobs.close()


def test_names_come_from_label_tip_axes_and_placeholder(qtbot: QtBot) -> None:
    root = QWidget()
    qtbot.addWidget(root)
    form = QFormLayout(root)
    number, box, line, slider, plot = QSpinBox(), QComboBox(), QLineEdit(), QSlider(), LinePlot("x (px)", "y (counts)")
    box.setToolTip("How intensity becomes colour; log shows four decades")
    line.setPlaceholderText("folder")
    form.addRow("Threads", number)
    for widget in (box, line, slider, plot):
        form.addRow(widget)
    assert slider in unnamed(root) and number in unnamed(root)
    name_controls(root)
    assert number.accessibleName() == "Threads" and box.accessibleName() == "How intensity becomes colour"
    assert line.accessibleName() == "folder"
    (graphics,) = plot.findChildren(pg.GraphicsView)
    assert graphics.accessibleName() == "y (counts) over x (px)"
    assert unnamed(root) == [slider]
