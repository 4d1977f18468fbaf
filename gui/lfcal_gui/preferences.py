"""Preferences: settings stored between starts, and a reset to the defaults."""

from __future__ import annotations

import os

from PySide6.QtCore import QSettings, Qt, Signal
from PySide6.QtWidgets import QCheckBox, QDialog, QFormLayout, QPushButton, QSpinBox, QVBoxLayout, QWidget

from lfcal.base import WORKERS, processors
from lfcal_gui.theme import current_theme, style_sheet
from lfcal_gui.widgets import WrappedLabel, choice_box, line

THEMES = (("light", "light"), ("dark", "dark"), ("night", "red on black, for a dark lab"))


def welcome_wanted(settings: QSettings) -> bool:
    """Return whether the welcome dialog is shown at the start."""
    return bool(settings.value("welcome", True, type=bool))


def apply_threads(settings: QSettings) -> None:
    """Set the number of threads to the stored value, unless an environment variable sets it."""
    chosen = settings.value("threads", 0, type=int)
    if isinstance(chosen, int) and chosen > 0:
        os.environ.setdefault(WORKERS, str(chosen))


class Preferences(QDialog):
    """Dialog with theme, number of threads and welcome; a button resets them and the layout of the window."""

    theme_asked = Signal(str, arguments=["name"])
    """Request for a theme, by name."""
    layout_reset = Signal()
    """Request to reset docks and size of the window."""

    def __init__(self, settings: QSettings, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.settings = settings
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("Preferences")
        self.setStyleSheet(style_sheet())
        self.theme = choice_box(
            THEMES, "Use dark or night in a dark lab. Ctrl+T switches between light and dark", "theme"
        )
        self.threads = QSpinBox()
        self.threads.setRange(0, processors())
        self.threads.setSpecialValueText("all processors")
        self.threads.setAccessibleName("Threads")
        self.threads.setToolTip(
            "Largest number of threads for simulation, assembly and reconstruction. Takes effect at the next start"
        )
        self.welcome = QCheckBox("Show the welcome dialog at startup")
        self.welcome.setToolTip("Off: the window starts with an empty project")
        self.hint = WrappedLabel(role="hint")
        self.reset, close = QPushButton("Reset all"), QPushButton("Close")
        self.reset.setToolTip("Reset theme, threads, welcome dialog, panels and window size to the defaults")
        close.setToolTip("Close. Changes are already saved")
        form = QFormLayout()
        form.addRow("Theme", self.theme)
        form.addRow("Threads", self.threads)
        form.addRow("", self.welcome)
        column = QVBoxLayout(self)
        column.addLayout(form)
        column.addWidget(self.hint)
        column.addLayout(line(self.reset, QWidget(), close, stretch=1))
        self._show()
        self.theme.currentIndexChanged.connect(lambda _: self.theme_asked.emit(self.theme.currentData()))
        self.threads.valueChanged.connect(lambda count: settings.setValue("threads", count))
        self.welcome.toggled.connect(lambda on: settings.setValue("welcome", on))
        self.reset.clicked.connect(self._reset)
        close.clicked.connect(self.close)

    def _show(self) -> None:
        self.theme.setCurrentIndex(self.theme.findData(current_theme().name))
        count = self.settings.value("threads", 0, type=int)
        self.threads.setValue(count if isinstance(count, int) else 0)
        self.welcome.setChecked(welcome_wanted(self.settings))
        given = os.environ.get(WORKERS, "")
        said = (
            (f"The environment variable {WORKERS} is set to {given} and takes precedence until the next start. ")
            if given
            else ""
        )
        self.hint.setText(f"{said}Stored in {self.settings.fileName()}.")

    def _reset(self) -> None:
        self.settings.clear()
        self._show()
        self.theme.setCurrentIndex(0)
        self.layout_reset.emit()
