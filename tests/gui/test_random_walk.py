"""Random walks: seeded actions in a window, which is checked after each; memory is released."""

from __future__ import annotations

import ctypes
import gc
import random
import shutil
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6 import QtWidgets as qt
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt
from PySide6.QtGui import QWheelEvent
from PySide6.QtTest import QTest
from pytestqt.qtbot import QtBot

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save
from lfcal_gui.app import make_window, parse
from lfcal_gui.models.project import ProjectState
from lfcal_gui.palette import offered
from lfcal_gui.window import MainWindow
from tests.cli.conftest import small_plan
from tests.gui.invariants import check_window
from tests.gui.recorded import write_recorded
from tests.gui.waiting import GUARD_MS

TEXTS = (
    *("", "0", "1", "2", "7", "0.5", "-1", "1e9", "1e-9", "1e400", "inf", "nan", "abc", "none", "12 px", "é"),
    *("3, 4", "1, nan", "9" * 40),
)
KEYS = [
    getattr(Qt.Key, f"Key_{name}")
    for name in (*"ABCDFGHLPRTZ", *"Left Right Up Down PageUp PageDown Home End Space Escape Delete".split())
]
LEFT_ALONE = ("Quit", "Open log folder", "About lfcal", "Send")
"""Actions that end the walk or start another program."""

PATIENCE = 25
"""Actions after which jobs are stopped, so that the walk does not wait for minutes."""


class Walk:
    """Do random things to a window.

    Parameters
    ----------
    window
        The window.
    seed
        Seed of all choices.
    files
        Good, damaged and missing files, which the dialogs return.
    out
        Folder for files that are saved.
    patch
        Replaces the dialogs by random answers.
    """

    def __init__(
        self, window: MainWindow, seed: int, files: Sequence[Path], out: Path, patch: pytest.MonkeyPatch
    ) -> None:
        self.window, self.files, self.out = window, [str(path) for path in files], out
        self.random = random.Random(seed)
        self.trail: list[str] = []
        self._count = 0
        self._actions: dict[Callable[[], str], int] = {
            **{
                self._press: 10,
                self._choose: 6,
                self._type: 6,
                self._slide: 4,
                self._key: 6,
                self._go: 5,
                self._row: 4,
            },
            **{self._mouse: 4, self._menu: 2, self._drop: 2, self._undo: 2, self._resize: 1, self._tab: 1},
        }
        self._answer(patch)

    # -- dialogs ---------------------------------------------------------------------------------------
    def _answer(self, patch: pytest.MonkeyPatch) -> None:
        buttons = qt.QMessageBox.StandardButton

        def asked(*arguments: Any, **_: Any) -> Any:
            offered = [one for one in arguments if isinstance(one, buttons)]
            choices = [b for b in buttons if offered and b & offered[0] and b.value & (b.value - 1) == 0]
            return self.random.choice(choices) if choices else buttons.Ok

        def saved(*_: Any, **__: Any) -> tuple[str, str]:
            suffix = self.random.choice((".h5", ".npy", ".json", ".png", ".csv", ".mat", ".lfcal", ".tif", ".svg", ""))
            name = self.random.choice(("", str(self.out / f"saved{suffix}"), f"{__file__}/x.h5"))
            return name, ""

        for name in ("question", "information", "warning", "critical"):
            patch.setattr(qt.QMessageBox, name, asked)
        patch.setattr(qt.QMessageBox, "about", lambda *_: None)
        patch.setattr(qt.QMessageBox, "exec", lambda *_: 0)
        patch.setattr(qt.QFileDialog, "getOpenFileName", lambda *_, **__: (self._file(), ""))
        patch.setattr(qt.QFileDialog, "getOpenFileNames", lambda *_, **__: (self.random.sample(self.files, 2), ""))
        patch.setattr(qt.QFileDialog, "getExistingDirectory", lambda *_, **__: self._file())
        patch.setattr(qt.QFileDialog, "getSaveFileName", saved)
        patch.setattr(qt.QDialog, "exec", lambda dialog: self._dialog(dialog))

    def _file(self) -> str:
        return self.random.choice(["", *self.files])

    def _dialog(self, dialog: qt.QDialog) -> int:
        dialog.show()
        for _ in range(self.random.randrange(4)):
            self._press_in(dialog)
        dialog.hide()
        return self.random.randrange(2)

    def _of_menu(self, menu: qt.QMenu) -> str:
        actions = [a for a in offered(menu) if a.text() not in LEFT_ALONE]
        if not actions:
            return "nothing"
        action = self.random.choice(actions)
        action.trigger()
        return str(action.text())

    # -- actions ---------------------------------------------------------------------------------------
    def step(self) -> None:
        """Do one action, process the events, and check the window."""
        self._count += 1
        (action,) = self.random.choices([*self._actions], [*self._actions.values()])
        self.trail.append(action.__name__)
        self.trail[-1] += f" {action()}"
        qt.QApplication.processEvents()
        if self._count % PATIENCE == 0:
            for job in self.window.jobs.jobs():
                if job.active:
                    self.window.jobs.cancel(job.number)
        check_window(self.window)

    @property
    def _page(self) -> qt.QWidget:
        dialogs = [d for d in self.window.findChildren(qt.QDialog) if d.isVisible()]
        return dialogs[-1] if dialogs and self.random.random() < 0.7 else self.window.shown

    def _some(self, kind: type[Any]) -> Any:
        found = [w for w in self._page.findChildren(kind) if w.isVisible() and w.isEnabled()]
        return self.random.choice(found) if found else None

    def _press(self) -> str:
        return self._press_in(self._page)

    def _press_in(self, widget: qt.QWidget) -> str:
        buttons = [b for b in widget.findChildren(qt.QAbstractButton) if b.isVisible() and b.isEnabled()]
        found = [b for b in buttons if not b.text().startswith(LEFT_ALONE)]
        if not found:
            return "nothing"
        button = self.random.choice(found)
        words = button.text() or button.objectName()
        button.click()
        return words

    def _choose(self) -> str:
        box = self._some(qt.QComboBox)
        if box is None or not box.count():
            return "nothing"
        index = self.random.randrange(box.count())
        box.setCurrentIndex(index)
        box.activated.emit(index)
        return f"{box.accessibleName() or box.toolTip()[:30]}: {box.currentText()}"

    def _type(self) -> str:
        line = self._some(qt.QLineEdit)
        if line is None or line.isReadOnly():
            return "nothing"
        text = self.random.choice(TEXTS)
        line.setText(text)
        line.textEdited.emit(text)
        if self.random.random() < 0.7:
            QTest.keyClick(line, Qt.Key.Key_Return)
        return f"{line.accessibleName() or line.placeholderText()}: {text}"

    def _slide(self) -> str:
        slider = self._some(self.random.choice((qt.QSlider, qt.QAbstractSpinBox)))
        if slider is None:
            return "nothing"
        if isinstance(slider, qt.QSlider):
            slider.setValue(self.random.randint(slider.minimum(), slider.maximum()))
        else:
            for _ in range(self.random.randrange(1, 5)):
                slider.stepBy(self.random.choice((-10, -1, 1, 10)))
        return str(slider.accessibleName())

    def _key(self) -> str:
        key, keys = self.random.choice(KEYS), Qt.KeyboardModifier
        modifier = self.random.choice((keys.NoModifier,) * 4 + (keys.ShiftModifier,))
        QTest.keyClick(self._page.focusWidget() or self._page, key, modifier)
        return key.name

    def _go(self) -> str:
        spec = self.random.choice(self.window.specs)
        self.window.go(spec.key)
        return str(spec.key)

    def _row(self) -> str:
        table = self._some(qt.QTableWidget)
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
        what, port, owner = self.random.choice(("move", "click", "wheel", "menu")), view.viewport(), view.parentWidget()
        if what == "click":
            QTest.mouseClick(port, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, place)
        elif what == "wheel":
            turn = QPoint(0, self.random.choice((-240, -120, 120, 240)))
            buttons, modifiers = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier
            at, phase = (QPointF(place), QPointF(port.mapToGlobal(place))), Qt.ScrollPhase.NoScrollPhase
            qt.QApplication.sendEvent(port, QWheelEvent(*at, QPoint(), turn, buttons, modifiers, phase, False))
        elif what == "menu" and owner is not None:
            owner.customContextMenuRequested.emit(place)
            for menu in owner.findChildren(qt.QMenu):
                if menu.isVisible():
                    self._of_menu(menu)
                    menu.close()
        else:
            QTest.mouseMove(port, place)
        return what

    def _menu(self) -> str:
        return self._of_menu(self.random.choice(self.window.menus.menus))

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
        tabs = self._some(qt.QTabWidget)
        if tabs is None:
            return "nothing"
        tabs.setCurrentIndex(self.random.randrange(tabs.count()))
        return str(tabs.tabText(tabs.currentIndex()))


# -- walks -------------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Write files that are good, damaged and missing."""
    plan, session = small_plan(), write_recorded(tmp_path / "recorded")
    good = tmp_path / "H.h5"
    rng = np.random.default_rng(3)
    save(PSFMatrix(rng.random((2, 3, 4, 9, 11), np.float32), depths=plan.depths_um, camera=plan.camera), good)
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(good.read_bytes()[:3000])
    camera = tmp_path / "camera.json"
    camera.write_text(preset("bench").to_json())
    project = tmp_path / "project.lfcal"
    project.write_text(ProjectState("walk", plan.camera, plan, psf=str(good)).to_json())
    broken = tmp_path / "broken.lfcal"
    broken.write_text("{}")
    partly = tmp_path / "partly"
    shutil.copytree(session, partly)
    (partly / "frames" / "z0_y0_x0.png").write_bytes(b"no picture")
    np.save(tmp_path / "array.npy", np.zeros((3, 4)))
    empty = tmp_path / "empty"
    empty.mkdir()
    return [
        session, session / "frames", session / "plan.json", good, damaged, camera, project, broken, partly, empty,
        tmp_path / "array.npy", tmp_path / "missing.h5", tmp_path / "missing",
    ]  # fmt: skip


def walk(window: MainWindow, qtbot: QtBot, files: list[Path], out: Path, seed: int, steps: int) -> None:
    out.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch, qtbot.captureExceptions() as raised:
        patch.chdir(out)  # names that are typed are of files there
        made = Walk(window, seed, files, out, patch)
        for _ in range(steps):
            try:
                made.step()
                wrong = ""
            except AssertionError as error:
                wrong = f"{error}\n{traceback.format_exc()}"
            errors = [
                f"{kind.__name__}: {error}\n{''.join(traceback.format_tb(trace))}" for kind, error, trace in raised
            ]
            if errors or wrong:
                print("\n".join(made.trail[-40:]))
            assert not errors, "\n".join(errors)  # first: they may be the cause of what is wrong
            assert not wrong, wrong
        for job in window.jobs.jobs():
            window.jobs.cancel(job.number)
        qtbot.waitUntil(lambda: not window.jobs.busy, timeout=GUARD_MS)


def test_a_random_walk_meets_no_wrong_state(
    window: MainWindow, qtbot: QtBot, files: list[Path], tmp_path: Path
) -> None:
    walk(window, qtbot, files, tmp_path / "out", seed=1, steps=60)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_a_long_random_walk(window: MainWindow, qtbot: QtBot, files: list[Path], tmp_path: Path, seed: int) -> None:
    """20,000 actions in twenty windows."""
    walk(window, qtbot, files, tmp_path / "out", seed=100 + seed, steps=1000)


def resident() -> int:
    """Return the resident memory of this process (bytes) after free memory was released."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    words = Path("/proc/self/status").read_text().split()
    return 1024 * int(words[words.index("VmRSS:") + 1])


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_comes_back_and_windows_close(
    qapp: qt.QApplication, qtbot: QtBot, files: list[Path], place: Path, tmp_path: Path
) -> None:
    """The same actions in three windows leave the same memory within 20 %; modules stay loaded after the first."""
    left = []
    for _ in range(3):
        window = make_window(qapp, parse([]), folder=place)
        window.show()
        qtbot.waitExposed(window, timeout=GUARD_MS)
        walk(window, qtbot, files, tmp_path / "out", seed=200, steps=400)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(qt.QMessageBox, "question", lambda *_: qt.QMessageBox.StandardButton.Discard)
            assert window.close() and window.isHidden()
        assert not [thread for thread in threading.enumerate() if "lfcal-job" in thread.name]
        window.deleteLater()
        del window
        qt.QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        left.append(resident())
    print("left in memory (MB):", [round(bytes_ / 1e6) for bytes_ in left])
    assert left[-1] <= 1.2 * left[0]
