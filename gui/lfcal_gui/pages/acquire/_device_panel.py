"""Which devices to use: backend, its options, why one is absent; connect and disconnect."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QStandardItemModel
from PySide6.QtWidgets import QComboBox, QFormLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.widgets import card, line, set_role

__all__ = ["DevicePanel"]

CONNECT = "Take hold of camera and stage, to see live frames and to record; nothing moves yet"
SHORT = re.compile(r"[.;,(\[@]| of the | after | the image| separated ")
"""Where the first words of what an option means end; its tip has them all."""
LET_GO = "Let camera and stage go, for another program or other settings; the stage stays where it is"


class DevicePanel(QWidget):
    """Choose a backend and connect.

    Signals
    -------
    connect_asked(), disconnect_asked()
        A button was pressed; the choice is in the project by then.
    edited(backend, options, stage)
        The choice changed: name, pairs of name and text, name of the stage's backend or empty.
    """

    connect_asked = Signal()
    disconnect_asked = Signal()
    edited = Signal(str, object, str)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._options: dict[str, Mapping[str, str]] = {}
        self._has_stage: dict[str, bool] = {}
        self._reasons: dict[str, str] = {}
        self._editors: dict[str, QLineEdit] = {}
        self._connected = False
        self._make_choices()
        self._make_options()
        self.reason = QLabel("looking for devices …")
        self.reason.setProperty("role", "hint")
        self.reason.setWordWrap(True)
        self.button = QPushButton("Connect")
        self.button.setToolTip(CONNECT)
        self.button.clicked.connect(self._pressed)
        self.button.setEnabled(False)
        frame, column = card("Devices")
        column.addWidget(self.backend)  # its names are long
        column.addLayout(line(self.stage_label, self.stage, stretch=1))
        column.addWidget(self.reason)
        column.addWidget(self.options_box)
        column.addLayout(line(self.more, self.button, stretch=1))
        self.options_box.hide()
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(frame)

    # -- building --------------------------------------------------------------------------------------
    def _make_choices(self) -> None:
        policy = QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
        self.backend = QComboBox()
        self.backend.setAccessibleName("camera")
        self.backend.setToolTip("Driver of the camera; one that is not available says why")
        self.backend.setMinimumContentsLength(10)
        self.backend.setSizeAdjustPolicy(policy)
        self.backend.activated.connect(self._backend_chosen)
        self.stage = QComboBox()
        self.stage.setToolTip("Driver of the stage, where the driver of the camera brings none")
        self.stage.setSizeAdjustPolicy(policy)
        self.stage.activated.connect(lambda _: self._emit())
        self.stage_label = QLabel("Stage")

    def _make_options(self) -> None:
        self.options_box = QWidget()
        self.options_form = QFormLayout(self.options_box)
        self.options_form.setContentsMargins(0, 0, 0, 0)
        self.options_form.setVerticalSpacing(4)
        self.options_form.setLabelAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.more = QPushButton("Options")
        self.more.setCheckable(True)
        self.more.setToolTip("Settings of this driver; empty ones take their default")
        self.more.toggled.connect(self.options_box.setVisible)

    # -- showing ---------------------------------------------------------------------------------------
    def set_backends(
        self, findings: Sequence[Any], options: Mapping[str, Mapping[str, str]], has_stage: Mapping[str, bool]
    ) -> None:
        """Show what was found: `lfcal.devices.registry.BackendStatus` records, and the options of each backend."""
        self._options, self._has_stage = dict(options), dict(has_stage)
        self._reasons = {f.name: f.reason for f in findings}
        self.backend.clear()
        self.stage.clear()
        self.stage.addItem("the camera's own", "")
        for finding in findings:
            self.backend.addItem(finding.title or finding.name, finding.name)
            index = self.backend.count() - 1
            tip = finding.reason or f"{finding.name}: {finding.version}"
            self.backend.setItemData(index, tip, Qt.ItemDataRole.ToolTipRole)
            model = self.backend.model()
            if finding.reason and isinstance(model, QStandardItemModel):
                model.item(index).setText(f"{finding.title or finding.name} (absent)")
            if not finding.reason and has_stage.get(finding.name):
                self.stage.addItem(finding.title or finding.name, finding.name)

    def set_choice(self, backend: str, options: Mapping[str, str], stage: str) -> None:
        """Show a choice without reporting it."""
        self.backend.setCurrentIndex(max(0, self.backend.findData(backend)))
        self.stage.setCurrentIndex(max(0, self.stage.findData(stage)))
        self._show_options(backend, options)
        self._show_reason()

    def set_connected(self, words: str, *, connected: bool, busy: bool = False) -> None:
        """Show whether devices are connected, with their names or what went wrong."""
        self._connected = connected
        self.button.setText("Disconnect" if connected else "Connecting …" if busy else "Connect")
        self.button.setToolTip(LET_GO if connected else CONNECT)
        for widget in (self.backend, self.stage, self.options_box):
            widget.setEnabled(not connected and not busy)
        self._show_reason()
        if words:
            self._say(words, bad=not connected and not busy)
        if busy:
            self.button.setEnabled(False)

    def set_free(self, free: bool) -> None:
        """Allow disconnecting, or not while devices are at work."""
        self.button.setEnabled(free)
        self.button.setToolTip(LET_GO if free else "The devices are in use; stop that first")

    # -- inside ----------------------------------------------------------------------------------------
    def _say(self, words: str, *, bad: bool) -> None:
        set_role(self.reason, "error" if bad else "hint")
        self.reason.setText(words)

    def _show_reason(self) -> None:
        name = self.backend.currentData()
        reason = self._reasons.get(name, "")
        alone = not self._has_stage.get(name, True)
        for widget in (self.stage, self.stage_label):
            widget.setVisible(alone)
        self.button.setEnabled(self._connected or (bool(self._reasons) and not reason))
        if reason:
            self._say(reason, bad=True)
        elif alone and not self.stage.currentData() and name != "folder":
            self._say("This camera has no stage: choose one.", bad=False)
        elif not self._connected:
            self._say("The simulator needs no hardware." if name == "sim" else "Ready to connect.", bad=False)

    def _show_options(self, backend: str, given: Mapping[str, str]) -> None:
        if set(self._editors) == set(self._options.get(backend, {})):
            for key, editor in self._editors.items():
                if editor.text() != given.get(key, ""):
                    editor.setText(given.get(key, ""))
            return
        while self.options_form.rowCount():
            self.options_form.removeRow(0)
        self._editors = {}
        for key, meaning in self._options.get(backend, {}).items():
            editor = QLineEdit(given.get(key, ""))
            editor.setPlaceholderText(SHORT.split(meaning.replace(" really", ""), maxsplit=1)[0])
            editor.setToolTip(meaning)
            editor.setAccessibleName(key)
            editor.setMinimumWidth(60)
            editor.editingFinished.connect(self._emit)
            self.options_form.addRow(key, editor)
            self._editors[key] = editor
        self.more.setVisible(bool(self._editors))

    def _backend_chosen(self, _: int) -> None:
        self._show_options(self.backend.currentData(), {})
        self._show_reason()
        self._emit()

    def _emit(self) -> None:
        given = tuple((key, e.text().strip()) for key, e in self._editors.items() if e.text().strip())
        self.edited.emit(self.backend.currentData() or "sim", given, self.stage.currentData() or "")

    def _pressed(self) -> None:
        if self._connected:
            self.disconnect_asked.emit()
        else:
            self._emit()
            self.connect_asked.emit()
