"""The header: the menus, the project, and what leads on."""

from __future__ import annotations

from PySide6.QtWidgets import QFrame, QHBoxLayout, QMenu, QToolButton, QVBoxLayout, QWidget

from lfcal_gui.widgets import ElidedLabel

HEIGHT, NAME = 54, 190
"""Height of the header, and the most that the project's name takes (px)."""


class HeaderBar(QFrame):
    """Three lines that open the menus, name of the project, and room (``lead``) for what leads on."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("header")
        self.setFixedHeight(HEIGHT)
        self.menu = QMenu(self)
        self.button = QToolButton()
        self.button.setText("☰")
        self.button.setProperty("role", "bare")
        self.button.setAccessibleName("menus")
        self.button.setToolTip("Open the menu (F10)")
        self.button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
        self.button.setMenu(self.menu)
        self.name, self.saved = ElidedLabel(), ElidedLabel()
        self.name.setProperty("role", "heading")
        self.name.setMaximumWidth(NAME)
        self.saved.setProperty("role", "hint")
        self.saved.setProperty("size", "caption")
        names = QVBoxLayout()
        names.setSpacing(0)
        names.addStretch()
        for label in (self.name, self.saved):
            names.addWidget(label)
        names.addStretch()
        self.lead = QHBoxLayout()
        row = QHBoxLayout(self)
        row.setContentsMargins(14, 0, 16, 0)
        row.setSpacing(14)
        row.addWidget(self.button)
        row.addLayout(names)
        row.addSpacing(14)
        row.addLayout(self.lead, 1)

    def say(self, name: str, *, unsaved: bool) -> None:
        """Show the project's name, and whether all of it is in its file."""
        self.name.setText(name)
        self.saved.setText("not saved" if unsaved else "saved")
