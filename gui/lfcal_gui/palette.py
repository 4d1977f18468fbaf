"""Command palette: search all available actions by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

from PySide6.QtCore import QEvent, QObject, Qt
from PySide6.QtGui import QAction, QKeyEvent, QKeySequence
from PySide6.QtWidgets import QDialog, QLineEdit, QListWidget, QMenu, QPushButton, QVBoxLayout, QWidget
from shiboken6 import isValid

from lfcal_gui.theme import style_sheet

SIZE = (520, 420)
TITLE = "Command palette"
STEPS = {Qt.Key.Key_Down: 1, Qt.Key.Key_Up: -1}


@dataclass(frozen=True)
class PaletteEntry:
    """Entry of the palette: name, key (if any), function, and whether it is enabled."""

    name: str
    key: str
    do: Callable[[], object]
    can_be_done: Callable[[], bool]

    def matches(self, typed: str) -> bool:
        """Return whether the name contains every word of ``typed``."""
        return all(word in self.name.lower() for word in typed.lower().split())


def doable(menus: Iterable[QMenu], page: QWidget, title: str) -> list[PaletteEntry]:
    """Return palette entries for the enabled buttons of ``page`` and the enabled actions of ``menus``.

    Names of buttons begin with ``title``, the title of the page.
    """
    # an entry may be gone when it is chosen: a job's row, a file of the menu
    entries = [
        PaletteEntry(f"{title}: {name}", "", button.click, partial(_pressable, button, page))
        for button in page.findChildren(QPushButton)
        if _pressable(button, page) and (name := _name_of(button))
    ]
    for menu in menus:
        for action in offered(menu):
            shortcut = action.shortcut().toString(QKeySequence.SequenceFormat.NativeText)
            name = f"{menu.title()}: {action.text()}".replace("&", "")
            entries.append(PaletteEntry(name, shortcut, action.trigger, partial(_triggerable, action)))
    return entries


def offered(menu: QMenu) -> list[QAction]:
    """Return the enabled entries of a menu that open no other menu.

    ``QAction.menu`` is not called, because it deletes the menu in PySide6 before 6.11.3.
    """
    heads = [other.menuAction() for other in menu.findChildren(QMenu)]
    actions = (one for one in menu.actions() if one.text() and not one.isSeparator())
    return [one for one in actions if one.isEnabled() and one not in heads]


def _name_of(button: QPushButton) -> str:
    """Return the name of a button: its text or, if this is not a word, its accessible name or tooltip."""
    names = (button.text().replace("&", ""), button.accessibleName(), button.toolTip())
    return next((name for name in names if any(letter.isalpha() for letter in name)), "")


def _pressable(button: QPushButton, page: QWidget) -> bool:
    return isValid(button) and isValid(page) and button.isEnabled() and button.isVisibleTo(page)


def _triggerable(action: QAction) -> bool:
    return isValid(action) and action.isEnabled()


class Palette(QDialog):
    """Input line with the list of matching entries; Enter runs the selected one."""

    def __init__(self, parent: QWidget, entries: Sequence[PaletteEntry]) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle(TITLE)
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        self._entries = tuple(entries)
        self.line = QLineEdit(placeholderText="Type part of a command")
        self.line.setAccessibleName("Command")
        self.line.setToolTip("Part of the name of a command. Arrow keys select a match, Enter runs it")
        self.line.textChanged.connect(self._show)
        self.line.returnPressed.connect(self._do)
        self.line.installEventFilter(self)
        self.list = QListWidget()
        self.list.setAccessibleName("Commands that match")
        self.list.setToolTip("Commands that are available now. Double-click to run one")
        self.list.itemActivated.connect(lambda _: self._do())
        column = QVBoxLayout(self)
        column.addWidget(self.line)
        column.addWidget(self.list, 1)
        self._show("")
        self.line.setFocus()

    @property
    def shown(self) -> list[PaletteEntry]:
        """The entries that match the input."""
        return [entry for entry in self._entries if entry.matches(self.line.text())]

    def _show(self, _: str) -> None:
        self.list.clear()
        self.list.addItems([f"{entry.name}    {entry.key}".rstrip() for entry in self.shown])
        self.list.setCurrentRow(0)

    def _do(self) -> None:
        row, shown = self.list.currentRow(), self.shown
        if not 0 <= row < len(shown):
            return
        if not shown[row].can_be_done():
            self.setWindowTitle(f"{TITLE}: “{shown[row].name}” is no longer available")
            self._entries = tuple(entry for entry in self._entries if entry.can_be_done())
            self._show("")
            return
        self.accept()
        shown[row].do()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Move the selection with the arrow keys while the input line has the focus."""
        if event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            step = STEPS.get(Qt.Key(event.key()))
            if step is not None:
                row = self.list.currentRow() + step
                self.list.setCurrentRow(max(0, min(self.list.count() - 1, row)))
                return True
        return super().eventFilter(watched, event)
