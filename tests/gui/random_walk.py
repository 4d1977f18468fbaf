"""A user who tries everything: seeded actions on a window, and what must hold after each of them."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyqtgraph as pg
import pytest
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractSpinBox,
    QApplication,
    QComboBox,
    QDialog,
    QFileDialog,
    QLineEdit,
    QMenu,
    QMessageBox,
    QSlider,
    QTableWidget,
    QTabWidget,
    QWidget,
)

from lfcal_gui.window import MainWindow
from tests.gui.invariants import check_window

__all__ = ["Walk"]

TEXTS = ("", "0", "1", "2", "7", "0.5", "-1", "1e9", "1e-9", "abc", "3, 4", "none", "nan", "12 px", "é", "9" * 40)
KEYS = (
    Qt.Key.Key_Left,
    Qt.Key.Key_Right,
    Qt.Key.Key_Up,
    Qt.Key.Key_Down,
    Qt.Key.Key_PageUp,
    Qt.Key.Key_PageDown,
    Qt.Key.Key_Home,
    Qt.Key.Key_End,
    Qt.Key.Key_Space,
    Qt.Key.Key_Escape,
    Qt.Key.Key_Delete,
    *(getattr(Qt.Key, f"Key_{letter}") for letter in "ABCDFGHLPRTZ"),
)
LEFT_ALONE = ("Quit", "Open log folder", "About lfcal", "Send")
"""Actions that end the walk, or start another program."""

PATIENCE = 25
"""Actions after which jobs are stopped, so that the walk does not wait for what takes minutes."""


class Walk:
    """Do random things to a window.

    Parameters
    ----------
    window
        What is walked in.
    seed
        Of the choices.
    files
        Offered wherever a file or folder is asked for: good, damaged and missing ones.
    out
        Folder for what is saved.
    patch
        Dialogs answer themselves for as long as it lasts.
    """

    def __init__(
        self, window: MainWindow, seed: int, files: Sequence[Path], out: Path, patch: pytest.MonkeyPatch
    ) -> None:
        self.window, self.files, self.out = window, [str(path) for path in files], out
        self.random = random.Random(seed)
        self.trail: list[str] = []
        self._count = 0
        self._actions: list[tuple[int, Callable[[], str]]] = [
            (10, self._press),
            (6, self._choose),
            (6, self._type),
            (4, self._slide),
            (6, self._key),
            (5, self._go),
            (4, self._row),
            (4, self._mouse),
            (2, self._menu),
            (2, self._drop),
            (2, self._undo),
            (1, self._resize),
            (1, self._tab),
        ]
        self._answer(patch)

    # -- dialogs ---------------------------------------------------------------------------------------
    def _answer(self, patch: pytest.MonkeyPatch) -> None:
        buttons = QMessageBox.StandardButton

        def asked(*arguments: Any, **_: Any) -> Any:
            offered = [one for one in arguments if isinstance(one, buttons)]
            choices = [b for b in buttons if offered and b & offered[0] and b.value & (b.value - 1) == 0]
            return self.random.choice(choices) if choices else buttons.Ok

        def saved(*_: Any, **__: Any) -> tuple[str, str]:
            suffix = self.random.choice((".h5", ".npy", ".json", ".png", ".csv", ".mat", ".lfcal", ".tif", ".svg", ""))
            name = self.random.choice(("", str(self.out / f"saved{suffix}"), "/no/such/folder/x.h5"))
            return name, ""

        for name in ("question", "information", "warning", "critical"):
            patch.setattr(QMessageBox, name, asked)
        patch.setattr(QMessageBox, "about", lambda *_: None)
        patch.setattr(QMessageBox, "exec", lambda *_: 0)
        patch.setattr(QFileDialog, "getOpenFileName", lambda *_, **__: (self._file(), ""))
        patch.setattr(QFileDialog, "getExistingDirectory", lambda *_, **__: self._file())
        patch.setattr(QFileDialog, "getSaveFileName", saved)
        patch.setattr(QDialog, "exec", lambda dialog: self._dialog(dialog))

    def _file(self) -> str:
        return self.random.choice(["", *self.files])

    def _dialog(self, dialog: QDialog) -> int:
        dialog.show()
        for _ in range(self.random.randrange(4)):
            self._press_in(dialog)
        dialog.hide()
        return self.random.randrange(2)

    def _of_menu(self, menu: QMenu) -> None:
        actions = [a for a in menu.actions() if a.isEnabled() and a.text() and a.menu() is None]
        if actions:
            self.random.choice(actions).trigger()

    # -- actions ---------------------------------------------------------------------------------------
    def step(self) -> None:
        """Do one thing, let the window work, and look whether all is as it must be."""
        self._count += 1
        (action,) = self.random.choices([a for _, a in self._actions], [w for w, _ in self._actions])
        self.trail.append(action.__name__)
        self.trail[-1] += f" {action()}"
        QApplication.processEvents()
        if self._count % PATIENCE == 0:
            for job in self.window.jobs.jobs():
                if job.active:
                    self.window.jobs.cancel(job.number)
        check_window(self.window)

    @property
    def _page(self) -> QWidget:
        dialogs = [d for d in self.window.findChildren(QDialog) if d.isVisible()]
        return dialogs[-1] if dialogs and self.random.random() < 0.7 else self.window.shown

    def _some(self, kind: type[Any]) -> Any:
        found = [w for w in self._page.findChildren(kind) if w.isVisible() and w.isEnabled()]
        return self.random.choice(found) if found else None

    def _press(self) -> str:
        return self._press_in(self._page)

    def _press_in(self, widget: QWidget) -> str:
        found = [
            b
            for b in widget.findChildren(QAbstractButton)
            if b.isVisible() and b.isEnabled() and not b.text().startswith(LEFT_ALONE)
        ]
        if not found:
            return "nothing"
        button = self.random.choice(found)
        words = button.text() or button.objectName()
        button.click()
        return words

    def _choose(self) -> str:
        box = self._some(QComboBox)
        if box is None or not box.count():
            return "nothing"
        index = self.random.randrange(box.count())
        box.setCurrentIndex(index)
        box.activated.emit(index)
        return f"{box.accessibleName() or box.toolTip()[:30]}: {box.currentText()}"

    def _type(self) -> str:
        line = self._some(QLineEdit)
        if line is None or line.isReadOnly():
            return "nothing"
        text = self.random.choice(TEXTS)
        line.setText(text)
        line.textEdited.emit(text)
        if self.random.random() < 0.7:
            QTest.keyClick(line, Qt.Key.Key_Return)
        return f"{line.accessibleName() or line.placeholderText()}: {text}"

    def _slide(self) -> str:
        slider = self._some(self.random.choice((QSlider, QAbstractSpinBox)))
        if slider is None:
            return "nothing"
        if isinstance(slider, QSlider):
            slider.setValue(self.random.randint(slider.minimum(), slider.maximum()))
        else:
            for _ in range(self.random.randrange(1, 5)):
                slider.stepBy(self.random.choice((-10, -1, 1, 10)))
        return str(slider.accessibleName())

    def _key(self) -> str:
        key = self.random.choice(KEYS)
        target = self._page.focusWidget() or self._page
        QTest.keyClick(
            target,
            key,
            self.random.choice((Qt.KeyboardModifier.NoModifier,) * 4 + (Qt.KeyboardModifier.ShiftModifier,)),
        )
        return key.name

    def _go(self) -> str:
        spec = self.random.choice(self.window.specs)
        self.window.go(spec.key)
        return str(spec.key)

    def _row(self) -> str:
        table = self._some(QTableWidget)
        if table is None or not table.rowCount() or not table.columnCount():
            return "nothing"
        row, column = self.random.randrange(table.rowCount()), self.random.randrange(table.columnCount())
        table.setCurrentCell(row, column)
        table.cellClicked.emit(row, column)
        return f"{row} {column}"

    def _mouse(self) -> str:
        view = self._some(pg.GraphicsView)
        if view is None:
            return "nothing"
        place = QPoint(self.random.randrange(max(1, view.width())), self.random.randrange(max(1, view.height())))
        what = self.random.choice(("move", "click", "wheel", "menu"))
        port = view.viewport()
        if what == "click":
            QTest.mouseClick(port, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, place)
        elif what == "wheel":
            turn = QPoint(0, self.random.choice((-240, -120, 120, 240)))
            event = QWheelEvent(
                QPointF(place),
                QPointF(port.mapToGlobal(place)),
                QPoint(),
                turn,
                Qt.MouseButton.NoButton,
                Qt.KeyboardModifier.NoModifier,
                Qt.ScrollPhase.NoScrollPhase,
                False,
            )
            QApplication.sendEvent(port, event)
        elif what == "menu" and view.parentWidget() is not None:
            owner = view.parentWidget()
            owner.customContextMenuRequested.emit(place)
            for menu in owner.findChildren(QMenu):
                if menu.isVisible():
                    self._of_menu(menu)
                    menu.close()
        else:
            QTest.mouseMove(port, place)
        return what

    def _menu(self) -> str:
        menus = [action.menu() for action in self.window.menuBar().actions()]
        menu = self.random.choice([m for m in menus if m is not None])
        actions = [
            a for a in menu.actions() if a.isEnabled() and a.text() and a.menu() is None and a.text() not in LEFT_ALONE
        ]
        if not actions:
            return "nothing"
        action = self.random.choice(actions)
        action.trigger()
        return action.text()

    def _drop(self) -> str:
        files = self.random.sample(self.files, self.random.choice((1, 1, 1, 2)))
        self.window.take_files(files)
        return " ".join(Path(file).name for file in files)

    def _undo(self) -> str:
        if self.random.random() < 0.6:
            return f"undo {self.window.project.undo()}"
        return f"redo {self.window.project.redo()}"

    def _resize(self) -> str:
        self.window.resize(self.random.randint(900, 2000), self.random.randint(600, 1200))
        return f"{self.window.width()} x {self.window.height()}"

    def _tab(self) -> str:
        tabs = self._some(QTabWidget)
        if tabs is None:
            return "nothing"
        tabs.setCurrentIndex(self.random.randrange(tabs.count()))
        return str(tabs.tabText(tabs.currentIndex()))
